"""How concealed an effect is: the signal-to-noise ratio of what fitting the base model leaves of it.

    snr^2 = d' M d,   M = I - J (J'J + P)^-1 J' = (I + J_theta'J_theta + J_eta'J_eta)^-1

d is the change of the series, J the sensitivities of the fitted parameters theta (in units of their prior's standard
deviation) and of the initial states eta (of theirs), all whitened by the true noise; M is that of
`vehicle_sbi.mismatch.design.identifiability`, taken here in two steps: the initial states of a window act in that
window alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vehicle_sbi.data.cutting import cut
from vehicle_sbi.data.noise import DrawnProcessNoise, MeasurementNoise, Mixture
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.information import sensitivity
from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.simulation import substeps_for
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.vehicle import Vehicle

WINDOW_S, WARMUP_S = 10.0, 0.5  # [s], which the tool is told too
FIT_STEPS, FIT_GAIN = 20, 0.02  # at most, and the gain of chi-square below which a fit ends
NONE = Mixture(np.zeros(0), np.zeros(0))


@dataclass(frozen=True, kw_only=True)
class Given:
    """What the tool is told besides the recordings: the car, the model, what drives it, what is measured and fitted.

    `effect_prior` names what is believed before of how often things are missing.
    """

    vehicle: Vehicle
    model: str
    drive: str
    channels: tuple[str, ...]
    prior: Mapping[str, tuple[float, float]]
    v_min: float = 1.0
    effect_prior: str = "passenger_car"

    def simulator(self, recordings: Sequence[Recording], noise: "Noise | None" = None) -> Simulator:
        """The base model over the windows of all recordings at once."""
        space = parameter_space(self.prior, vehicle=self.vehicle, model=self.model)
        windows = joined([self.windows(one) for one in recordings])
        if noise:  # without it in the recordings, initial states would look better known than they are
            unsure = np.array([noise.std["v_x"], 0.0, noise.std["yaw_rate"]])
            windows = replace(windows, x0_std=np.hypot(windows.x0_std, unsure))
        zero = np.zeros(len(self.channels))
        blank = MeasurementNoise(zero, zero, zero, windows.t.shape[1])
        simulator = Simulator(
            nominal=nominal_record(self.vehicle, duration=float(windows.u[..., INPUTS.index("time")].max())),
            space=space,
            model=self.model,
            drive=self.drive,
            windows=windows,
            process=DrawnProcessNoise(NONE, NONE, False),
            noise=noise.measurement(windows) if noise else blank,
            uniform_start=False,
            substeps=1,
            seed=0,
        )
        slowest = max(2.0, float(min(windows.x0[:, 0].min(), *_given_speeds(windows, self.drive))))
        records = space.records(np.stack([space.low, (space.low + space.high) / 2, space.high]), simulator.nominal)
        return replace(
            simulator, substeps=substeps_for(records, self.drive, 0.7 * slowest, windows.rate, model=self.model)
        )

    def windows(self, recording: Recording) -> Windows:
        return cut(
            recording,
            drive=self.drive,
            channels=self.channels,
            length_s=WINDOW_S,
            warmup_s=WARMUP_S,
            steering_ratio=self.vehicle.steering_ratio,
            v_min=self.v_min,
            wheel_radius=self.vehicle.R_f,
        )


def _given_speeds(windows: Windows, drive: str) -> list[float]:
    return [float(windows.u[..., INPUTS.index("v_x")].min())] if drive == "speed" else [np.inf]


def joined(parts: Sequence[Windows]) -> Windows:
    """The windows of several recordings as those of one; initial states as uncertain as on average."""
    first = parts[0]
    return replace(
        first,
        u=np.concatenate([w.u for w in parts]),
        before=np.concatenate([w.before for w in parts]),
        y=np.concatenate([w.y for w in parts], axis=1),
        valid=np.concatenate([w.valid for w in parts], axis=1),
        x0=np.concatenate([w.x0 for w in parts]),
        x0_std=np.sqrt(np.mean([w.x0_std**2 for w in parts], axis=0)),
        t=np.concatenate([w.t for w in parts]),
        notes=(),
    )


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The true measurement noise: standard deviation and AR(1) correlation of each channel; `tail` is its shape."""

    std: Mapping[str, float]
    rho: Mapping[str, float]
    tail: str  # "normal" or "student", four degrees of freedom scaled to unit variance

    def measurement(self, windows: Windows) -> MeasurementNoise:
        std, rho = (np.array([table[name] for name in windows.channels]) for table in (self.std, self.rho))
        return MeasurementNoise(np.zeros(len(std)), std, rho, windows.t.shape[1])

    def draw(self, name: str, n: int, rng: np.random.Generator) -> np.ndarray:
        """A series of noise [channel's unit]."""
        unit = rng.standard_t(4, n) / np.sqrt(2.0) if self.tail == "student" else rng.standard_normal(n)
        rho = self.rho[name]
        for k in range(1, n if rho else 0):
            unit[k] = rho * unit[k - 1] + np.sqrt(1.0 - rho**2) * unit[k]
        return self.std[name] * unit

    def louder(self, factor: float) -> "Noise":
        return replace(self, std={name: factor * value for name, value in self.std.items()})


def remove(x: np.ndarray, absorbing: np.ndarray, *, entirely: bool = False) -> np.ndarray:
    """M^(1/2) x for the rows of x (..., k, n): what absorbing directions (..., e, n) of unit prior leave of them.

    `entirely`: without a prior, which leaves what is orthogonal to them.
    """
    if not absorbing.shape[-2]:
        return x
    _, s, V = np.linalg.svd(absorbing, full_matrices=False)
    share = (s > 1e-9 * s.max()).astype(float) if entirely else 1.0 - 1.0 / np.sqrt(1.0 + s**2)
    return x - ((x @ V.mT) * share[..., None, :]) @ V


class Projection:
    """M^(1/2) about one theta: changes of the series in, what fitting leaves of them out, in standard deviations."""

    def __init__(self, simulator: Simulator, theta: np.ndarray) -> None:
        self.simulator, self.theta = simulator, theta
        alone = replace(simulator, windows=replace(simulator.windows, x0_std=np.zeros(3)))
        at = sensitivity(alone, theta)
        self.y, self.valid = at.y, simulator.windows.valid
        states = []
        for state in ("v_x", "v_y", "r"):  # that of all windows at once
            moved = np.array([name.startswith(f"{state}_") for name in simulator.nuisances])
            if moved.any():
                up, down = 1e-3 * moved, -1e-3 * moved
                y = simulator.noise_free(np.stack([theta, theta]), np.stack([up, down]))
                states.append((y[0] - y[1]) / 2e-3)
        shape = (0, *self.y.shape)
        self._eta = self._blocks(
            self._white(np.array(states).reshape(-1, *self.y.shape) if states else np.empty(shape))
        )
        spread = simulator.space.prior_std[:, None, None]
        self._theta = self.without_states(at.jacobian * spread)

    def _white(self, changes: np.ndarray) -> np.ndarray:
        noise = self.simulator.noise
        return noise.whiten(np.nan_to_num(changes), noise.std(self.y), self.valid)

    def _blocks(self, white: np.ndarray) -> np.ndarray:
        """(windows, k, channels * time)"""
        k, channels, _ = white.shape
        windows = self.simulator.windows.t.shape[0]
        return white.reshape(k, channels, windows, -1).transpose(2, 0, 1, 3).reshape(windows, k, -1)

    def without_states(self, changes: np.ndarray) -> np.ndarray:
        """What the initial states leave of changes (k, channels, time), whitened: (k, n)."""
        blocks = remove(self._blocks(self._white(changes)), self._eta)
        return blocks.transpose(1, 0, 2).reshape(len(changes), -1)

    def left(self, changes: np.ndarray) -> np.ndarray:
        """What fitting leaves of changes (k, channels, time): (k, n)."""
        return remove(self.without_states(changes), self._theta)

    def shift(self, changed: np.ndarray) -> np.ndarray:
        """What a change (channels, time) moves theta by at first order, in standard deviations of its prior."""
        white, J = self.without_states(changed[None])[0], self._theta
        return np.linalg.solve(J @ J.T + np.eye(len(J)), J @ white)

    def step(self, residual: np.ndarray) -> np.ndarray:
        """The step of theta that a residual (channels, time) asks for, initial states allowed for, no prior."""
        white = self.without_states(residual[None])[0]
        return np.linalg.lstsq(self._theta.T, white, rcond=1e-9)[0] * self.simulator.space.prior_std


def snr(left: np.ndarray) -> float:
    return float(np.linalg.norm(left))


def residual(simulator: Simulator, theta: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Observed minus simulated, zero where nothing is fitted."""
    return np.where(simulator.windows.valid, np.nan_to_num(observed) - simulator.noise_free(theta[None])[0], 0.0)


def fit(simulator: Simulator, observed: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Gauss-Newton inside the prior's box, from theta; a step that makes it worse is halved.

    Derivatives are taken anew only where those of an earlier theta gain nothing more.
    """
    space = simulator.space
    projection, fresh = Projection(simulator, theta), True

    def misfit(r: np.ndarray) -> float:
        return snr(projection.without_states(r[None])) if np.isfinite(r).all() else np.inf

    rest = residual(simulator, theta, observed)
    now = misfit(rest)
    for _ in range(FIT_STEPS):
        step, gain = projection.step(rest), 0.0
        for halving in range(5):
            trial = np.clip(theta + 0.5**halving * step, space.low, space.high)
            left = residual(simulator, trial, observed)
            if (reached := misfit(left)) < now:
                theta, rest, gain, now = trial, left, now**2 - reached**2, reached
                break
        if gain < FIT_GAIN and fresh:
            return theta
        fresh = gain < FIT_GAIN
        if fresh:
            projection = Projection(simulator, theta)
            now = misfit(rest)
    return theta
