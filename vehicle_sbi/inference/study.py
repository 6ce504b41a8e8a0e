"""A study: from what a user configured to a problem that can be inferred, synthetic or recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data import together
from vehicle_sbi.data.manoeuvre import Synthetic
from vehicle_sbi.data.noise import EstimatedNoise
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.windows import Windows, from_zero, joined
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.estimator import DensityEstimator
from vehicle_sbi.inference.features import Features
from vehicle_sbi.inference.information import best_fit
from vehicle_sbi.inference.informative import affordable, chosen
from vehicle_sbi.inference.plausible import PLAUSIBLE, plausible, sentence
from vehicle_sbi.inference.prior import stated
from vehicle_sbi.inference.rounds import Problem
from vehicle_sbi.inference.setup import Setup, noise_under_model
from vehicle_sbi.inference.simulator import Simulator, succeeded
from vehicle_sbi.inference.training import Training
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.rng import Stream, generator

SPELLED = 3  # recordings whose names a study's name spells out at most
MOST_READINGS = 40_000  # of a recording that are used: 200 s of two channels at 100 Hz


@dataclass(frozen=True, kw_only=True)
class Study(Setup):
    """What one run infers: a vehicle's free parameters from a recording, or from a manoeuvre with a drawn truth.

    In a synthetic study `truth` (by name) is observed, or a truth drawn from the prior. With `effects` "plausible" all
    that can act of what the prior does not name is drawn from `effect_prior` in each simulation, the observed one too.
    `recordings` are used together in the place of `recording`, paths as that says. Of more than `most_readings`
    (samples times channels; None: no limit) those windows are used that tell most.
    """

    recording: RecordingFile | Synthetic
    recordings: Sequence[str | RecordingFile] = ()
    features: Features
    estimator: DensityEstimator
    training: Training
    truth: Mapping[str, float] | None
    effect_prior: EffectPrior = field(default_factory=EffectPrior)
    most_readings: int | None = MOST_READINGS
    instead: ClassVar[tuple[str, ...]] = (PLAUSIBLE,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.recording, RecordingFile) and self.truth is not None:
            raise InputError("truth: a recording has no stated truth; leave truth=null or recording=synthetic")
        if isinstance(self.recording, Synthetic) and self.recordings:
            raise InputError("recordings: a synthetic study has none; leave recordings=[] or recording=synthetic")
        most = self.most_readings
        if most is not None and (not isinstance(most, int) or isinstance(most, bool) or most < 1):
            raise InputError(f"most_readings = {most!r}; it must be a whole number above 0, or null for no limit")

    def prepare(self) -> "Prepared":
        """Load or simulate what is observed, estimate the noise, and put the problem together."""
        if isinstance(self.recording, Synthetic):
            return self._synthetic(self.recording)
        return self._recorded(self.recording)

    def _synthetic(self, source: Synthetic) -> "Prepared":
        if self.drive != "torque":
            raise InputError(f"drive={self.drive}: a synthetic manoeuvre states torques; it needs drive=torque")
        windows = source.manoeuvre.windows(self.vehicle)
        space = self.space(windows)
        simulator = self._freed(self.simulator(space, windows, uniform_start=True))
        truth = self._truth(space)
        y, outcomes = simulator.simulate(truth[None], np.array([1]), stream=Stream.TRUTH)
        if not succeeded(outcomes)[0]:
            raise InputError(f"manoeuvre '{source.manoeuvre.name}': the vehicle spins out with the true parameters")
        name = f"{self.vehicle.name} in {source.manoeuvre.name}"
        return Prepared(name, self._problem(simulator, y[0].astype(float)), truth)

    def _recorded(self, source: RecordingFile) -> "Prepared":
        files = together.read(self.recordings or [source], source)
        together.check_once(files, [])
        (files,) = together.under_own_names(files)
        recordings = tuple(recording for _, recording in files)
        parts = [self.windows(recording, file) for file, recording in files]
        windows = self._used(joined(parts, [recording.name for recording in recordings]))
        simulator = self._freed(self.simulator(self.space(windows), windows, uniform_start=False))
        observed = np.where(windows.valid, windows.y, 0.0)
        if isinstance(self.noise, EstimatedNoise) and self.noise.model_residual:
            simulator = simulator.with_noise(noise_under_model(simulator, observed, windows))
        name = f"{self.vehicle.name} from {_all_of([recording.name for recording in recordings])}"
        return Prepared(name, self._problem(simulator, observed), None, recordings, self.unheeded(simulator.space))

    def _used(self, windows: Windows) -> Windows:
        """The windows that tell most, as many as may be used, on a clock that begins with the first of them."""
        most, space, all_windows = self.most_readings, self.space(windows), len(windows.t)
        if most is None:
            return windows
        readings, states = windows.y.size // all_windows, int(np.sum(windows.x0_std > 0))
        count = affordable(all_windows, most, readings=readings, states=states, d=len(space))
        if count == all_windows:
            return windows
        found = chosen(self.simulator(space, windows, uniform_start=False), count)
        return from_zero(replace(windows.only(found.which), notes=(found.sentence(windows, most), *windows.notes)))

    def _freed(self, simulator: Simulator) -> Simulator:
        """The simulator with the plausible effects, if they are asked for."""
        if self.effects != PLAUSIBLE:
            return simulator
        return replace(simulator, plausible=plausible(simulator, self.effect_prior, stated(self.prior)))

    def _problem(self, simulator: Simulator, observed: Float[np.ndarray, "channels time"]) -> Problem:
        return Problem(simulator, observed, self.features, self.estimator, self.training)

    def _truth(self, space: ParameterSpace) -> Float[np.ndarray, " d"]:
        if self.truth is not None:
            return space.values(self.truth, "truth")
        return generator(seed=self.seed, stream=Stream.TRUTH).uniform(space.low, space.high)


@dataclass(frozen=True)
class Prepared:
    """A problem, the truth where it is known, the recordings where there are any, and what the vehicle file states in
    vain."""

    name: str
    problem: Problem
    truth: Float[np.ndarray, " d"] | None
    recordings: tuple[Recording, ...] = ()
    unheeded: tuple[str, ...] = ()

    @cached_property
    def point(self) -> Float[np.ndarray, " d"]:
        """Where information is taken: the truth of a synthetic study, or the best fit to a recording."""
        if self.truth is not None:
            return self.truth
        space = self.problem.simulator.space
        return best_fit(self.problem.simulator, self.problem.observed, (space.low + space.high)[None] / 2)[0]

    @property
    def notes(self) -> list[str]:
        """Which plausible effects were free, what does not count, and what was filled or left out on the way from file
        to windows."""
        simulator = self.problem.simulator
        free = [sentence(simulator.plausible)] if len(simulator.plausible) else []
        return [*free, *self.unheeded, *simulator.windows.notes]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the recordings contradict, with the name of each where there are several."""
        alone = len(self.recordings) == 1
        return tuple(line if alone else f"{one.name}: {line}" for one in self.recordings for line in one.warnings)

    @property
    def inputs(self) -> dict[str, str]:
        """SHA-256 of every file that the recordings are read from."""
        return {path: digest for one in self.recordings for path, digest in one.inputs.items()}


def _all_of(names: Sequence[str]) -> str:
    """Names in a row, of many the first of them and how many more there are."""
    more = [f"{len(names) - SPELLED} more"] if len(names) > SPELLED else []
    return ", ".join([*names[:SPELLED], *more])
