"""From what a user configured of a car and its recordings to a simulator that is driven and measured as they were."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from vehicle_sbi.data.channels import NEEDED
from vehicle_sbi.data.checks.drive import STEERINGS
from vehicle_sbi.data.checks.limits import refuse_impossible
from vehicle_sbi.data.cutting import cut
from vehicle_sbi.data.noise import ConstantNoise, EstimatedNoise, MeasurementNoise, ProportionalNoise, from_residual
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.inference.information import best_fit
from vehicle_sbi.inference.prior import parameter_space, typical
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.sensors import BODY_MEASUREMENTS
from vehicle_sbi.physics.simulation import MODELS, fastest_rate, substeps_for
from vehicle_sbi.physics.single_track import DRIVES, INPUTS
from vehicle_sbi.physics.vehicle import Vehicle
from vehicle_sbi.rng import Stream, generator
from vehicle_sbi.words import enumerated

Noise = ProportionalNoise | ConstantNoise | EstimatedNoise
FIRST_SUBSTEPS = 4  # before the slowest speed is known, which decides their number
CORNERS = 7  # from which the fastest mode in the prior is sought, beside its centre
STARTS = 3  # of the fit under which noise is estimated
NOISE_ROUNDS = 8  # of fit and estimate at most
ELSEWHERE = 32  # draws from the prior, where the simulation fails at its centre
CRAWL = 1.0  # [m/s], where the speed is not known because the simulation fails at all of them


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A vehicle, what of it is free, how the simulator is driven and how recordings are cut into windows [s]."""

    vehicle: Vehicle
    model: str
    drive: str
    prior: Mapping[str, Any]
    effects: Sequence[str] | str
    window_s: float
    warmup_s: float
    noise: Noise
    seed: int
    instead: ClassVar[tuple[str, ...]] = ()
    """Words that may stand in the place of a list of effects."""

    def __post_init__(self) -> None:
        listed = isinstance(self.effects, Sequence) and not isinstance(self.effects, str)
        if not listed and self.effects not in self.instead:
            words = "".join(f", or {word}" for word in self.instead)
            raise InputError(
                f"effects = {self.effects}; it must be a list, as in effects=[aero_drag,road_grade]{words}"
            )
        if self.drive not in DRIVES:
            raise unknown("drive mode", self.drive, DRIVES, "drive")
        if self.model not in MODELS:
            raise unknown("model", self.model, MODELS, "model")
        if not isinstance(self.seed, int) or isinstance(self.seed, bool) or self.seed < 0:
            raise InputError(f"seed = {self.seed!r}; it must be a whole number that is not negative")

    def space(self, windows: Windows) -> ParameterSpace:
        """The free parameters, as far as what is recorded depends on them."""
        return parameter_space(
            self.prior,
            vehicle=self.vehicle,
            model=self.model,
            effects=() if isinstance(self.effects, str) else self.effects,
            drive=self.drive,
            sensed=windows.sensed(self.drive),
        )

    def unheeded(self, space: ParameterSpace) -> tuple[str, ...]:
        """What the vehicle file states of a constant that is inferred does not count, said in a line, if it does."""
        free = [name for p in space.parameters if not p.relative for name in p.fields]
        names = [name for name in free if getattr(self.vehicle, name, None) is not None]
        if not names:
            return ()
        return (
            f"{enumerated(names)}: inferred within the prior, whatever the vehicle file states; "
            f"prior.{names[0]}=null takes what it states as exact, prior.{names[0]}=[low,high] is a range",
        )

    def windows(self, recording: Recording, source: RecordingFile) -> Windows:
        """The recording cut into windows, with the settings of the file it comes from.

        Raises InputError for a channel that mostly is what no car can be.
        """
        refuse_impossible(recording, [*STEERINGS, *NEEDED.get(self.drive, ()), *source.channels])
        return cut(
            recording,
            drive=self.drive,
            channels=source.channels,
            length_s=self.window_s,
            warmup_s=self.warmup_s,
            start_s=source.start_s,
            stop_s=source.stop_s,
            steering_ratio=self.vehicle.steering_ratio,
            v_min=source.v_min,
            wheel_radius=self.vehicle.R_f,
        )

    def simulator(
        self, space: ParameterSpace, windows: Windows, *, uniform_start: bool, stiffest: float = 1.0
    ) -> Simulator:
        """The vehicle driven through these windows, `stiffest` the largest step times rate that the integrator takes.

        Raises InputError for a channel that the model does not predict.
        """
        unseen = [name for name in windows.channels if name in BODY_MEASUREMENTS and self.model != "full_vehicle"]
        if unseen:
            raise InputError(f"model={self.model}: it does not predict {', '.join(unseen)}; model=full_vehicle does")
        simulator = Simulator(
            nominal=self._nominal(space, float(windows.u[..., INPUTS.index("time")].max())),
            space=space,
            model=self.model,
            drive=self.drive,
            windows=windows,
            process=self.noise.process.draw(generator(seed=self.seed, stream=Stream.STUDY)),
            noise=self.noise.measurement(windows),
            uniform_start=uniform_start,
            substeps=FIRST_SUBSTEPS,
            seed=self.seed,
        )
        return replace(simulator, substeps=substeps(simulator, stiffest))

    def _nominal(self, space: ParameterSpace, duration: float) -> np.void:
        """The vehicle's constants; one that is neither stated nor free, as nothing recorded depends on it, as of a
        typical car."""
        free = {name for p in space.parameters for name in p.fields}
        idle = {name: x for name, x in typical(self.vehicle, self.model).items() if name not in free}
        return nominal_record(replace(self.vehicle, **idle), duration=duration)


def slowest(simulator: Simulator, theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n windows"]:
    """The lowest speed [m/s] of each window, where modes are fastest; NaN where the simulation fails."""
    probe = replace(simulator, windows=replace(simulator.windows, channels=("v_x",), groups=("can",)))
    return probe.noise_free(theta).reshape(len(theta), *simulator.windows.t.shape).min(axis=2)


def _slowest_believed(simulator: Simulator) -> Float[np.ndarray, " windows"]:
    """The lowest speed [m/s] of each window at the prior's centre; where a car spins out there, the median of draws
    from the prior in which it does not."""
    space, rng = simulator.space, generator(seed=0, stream=Stream.STUDY)
    centre = slowest(simulator, (space.low + space.high)[None] / 2)[0]
    if np.isfinite(centre).all():
        return centre
    drawn = slowest(simulator, space.low + (space.high - space.low) * rng.random((ELSEWHERE, len(space))))
    driven = drawn[np.isfinite(drawn).all(axis=1)]
    return np.median(driven, axis=0) if len(driven) else np.full(drawn.shape[1], CRAWL)


def substeps(simulator: Simulator, stiffest: float = 1.0) -> Int[np.ndarray, " windows"]:
    """Steps of the integrator a sample in each window: as many as its lowest speed needs in all of the prior."""
    v_min = _slowest_believed(simulator)
    corners = [_fastest_corners(simulator, float(v)) for v in (v_min.min(), v_min.max())]
    return steps_at(simulator, np.concatenate(corners), v_min, stiffest)


def steps_at(
    simulator: Simulator, theta: Float[np.ndarray, "n d"], v_min: Float[np.ndarray, " windows"], limit: float
) -> Int[np.ndarray, " windows"]:
    """Steps of the integrator a sample at the lowest speed [m/s] of each window, enough for some parameters."""
    records, rate = simulator.space.records(theta, simulator.nominal), simulator.windows.rate
    levels, of = np.unique(v_min, return_inverse=True)
    steps = [substeps_for(records, simulator.drive, v, rate, limit=limit, model=simulator.model) for v in levels]
    return np.array(steps)[of]


def _fastest_corners(simulator: Simulator, v_min: float) -> Float[np.ndarray, "starts d"]:
    """Corners of the prior's box with the fastest modes, by ascent along one parameter after the other.

    Each start ends where no single parameter makes it faster. Several starts, because a car is quickest to turn about
    either of its axles, and no single parameter leads from one to the other.
    """
    space, nominal, rng = simulator.space, simulator.nominal, generator(seed=0, stream=Stream.STUDY)

    def rates(theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        records = space.records(theta, nominal)
        found = np.array([fastest_rate(record, simulator.drive, v_min, simulator.model) for record in records])
        return np.where(np.isnan(found), -np.inf, found)  # no such car

    def ascended(theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        reached = -np.inf
        while (fastest := rates(theta[None])[0]) > reached:
            reached = fastest
            for i, ends in enumerate(zip(space.low, space.high, strict=True)):
                pair = np.tile(theta, (2, 1))
                pair[:, i] = ends
                theta = pair[np.argmax(rates(pair))]
        return theta

    corners = np.where(rng.random((CORNERS, len(space))) < 0.5, space.low, space.high)
    return np.array([ascended(theta) for theta in ((space.low + space.high) / 2, *corners)])


def noise_under_model(simulator: Simulator, observed: np.ndarray, windows: Windows) -> MeasurementNoise:
    """Noise estimated from what the best fit of the model leaves over, until noise and fit agree with each other."""
    space = simulator.space
    rng = generator(seed=simulator.seed, stream=Stream.STUDY, index=1)
    corners = rng.uniform(space.low, space.high, (STARTS - 1, len(space)))
    starts = np.concatenate([(space.low + space.high)[None] / 2, corners])
    for _ in tqdm(range(NOISE_ROUNDS), desc="fit and noise", disable=None, leave=False):
        before = simulator.noise
        theta, residual = best_fit(simulator, observed, starts)
        simulator = simulator.with_noise(from_residual(residual, windows))
        starts = theta[None]
        if np.allclose(simulator.noise.floor, before.floor, rtol=0.02):
            break
    return simulator.noise
