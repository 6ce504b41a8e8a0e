"""Process, input and measurement noise.

Process noise (the paper, section IV): in every simulation each stiffness is off by a share of its nominal value, drawn
from a mixture of ten Gaussians whose means and standard deviations are themselves drawn once per study. Measurement
noise has zero mean and a standard deviation per sample, sigma^2 = (share * value)^2 + floor^2, and may be
autocorrelated (AR(1)) where it was estimated from a recording.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import lfilter, savgol_coeffs, savgol_filter

from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError, unknown

TINY = 1e-9  # [channel's unit], so that a channel that is fitted perfectly can still be divided by its noise
LARGEST_RHO = 0.999
FEWEST = 10  # samples of a channel from which its noise is estimated
# Window [s] and order of the local polynomial whose residual is taken for sensor noise.
SMOOTHING_S, SMOOTHING_ORDER = 0.25, 3
CORRELATIONS = np.linspace(0.0, 0.99, 100)  # of noise that is told by its fast scatter
# A channel reads in steps if at most this share of its readings differ, all by multiples of one step to this part of
# it; differences below this part of the channel's range are the file's decimals.
MOST_LEVELS, OFF_STEP, RESOLVED = 0.2, 0.05, 1e-6


@dataclass(frozen=True)
class Mixture:
    """An equally weighted mixture of Gaussians over relative deviations; empty means no noise."""

    means: Float[np.ndarray, " k"]
    stds: Float[np.ndarray, " k"]

    @property
    def mean(self) -> float:
        return float(self.means.mean()) if len(self.means) else 0.0

    @property
    def std(self) -> float:
        return float(np.sqrt(np.mean(self.stds**2) + self.means.var())) if len(self.means) else 0.0

    def sample(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        if not len(self.means):
            return np.zeros(shape)
        component = rng.integers(len(self.means), size=shape)
        return self.means[component] + self.stds[component] * rng.standard_normal(shape)


@dataclass(frozen=True, kw_only=True)
class ProcessNoise:
    """How stiffnesses and inputs deviate from what the parameters say, from simulation to simulation.

    `stiffness` and `inputs` are limits of the mixture's means and standard deviations, as shares of nominal; zero
    switches that noise off. `per_sample` draws anew at every sample instead of once per simulation.
    """

    stiffness: float = 0.05
    inputs: float = 0.0
    components: int = 10
    per_sample: bool = False

    def __post_init__(self) -> None:
        if not (0 <= self.stiffness < 0.3 and 0 <= self.inputs < 0.3 and self.components >= 1):
            raise InputError(
                f"noise.process: stiffness {self.stiffness:g} and inputs {self.inputs:g} must lie in [0, 0.3) "
                f"and components {self.components} be at least 1"
            )

    def draw(self, rng: np.random.Generator) -> "DrawnProcessNoise":
        """The study's mixtures: means uniform in +-limit, standard deviations uniform in 0 to limit."""

        def mixture(limit: float) -> Mixture:
            size = self.components if limit else 0
            return Mixture(rng.uniform(-limit, limit, size), rng.uniform(0.0, limit, size))

        return DrawnProcessNoise(mixture(self.stiffness), mixture(self.inputs), self.per_sample)


@dataclass(frozen=True)
class DrawnProcessNoise:
    """The process noise of one study."""

    stiffness: Mixture
    inputs: Mixture
    per_sample: bool


@dataclass(frozen=True)
class SensorNoise:
    """The noise that sensors have of their own: standard deviation [channel's unit] and lag-one correlation of each."""

    floor: Float[np.ndarray, " channels"]
    rho: Float[np.ndarray, " channels"]


@dataclass(frozen=True)
class MeasurementNoise:
    """Zero-mean noise of each channel: sigma^2 = (share * value)^2 + floor^2, correlated as rho^lag.

    share, floor, rho have one entry a channel, floors in the channel's unit. `window` is the number of samples after
    which the recording starts anew and so does the correlation. `sensor` is what of the floor a sensor can have made by
    its own fast scatter, the rest being misfit of the model; None: all of it.
    """

    share: Float[np.ndarray, " channels"]
    floor: Float[np.ndarray, " channels"]
    rho: Float[np.ndarray, " channels"]
    window: int
    sensor: "SensorNoise | None" = None

    @property
    def of_sensor(self) -> "MeasurementNoise":
        """The sensors' own noise, without what is misfit."""
        if self.sensor is None:
            return self
        larger = self.floor > self.sensor.floor
        floor, rho = np.minimum(self.floor, self.sensor.floor), np.where(larger, self.sensor.rho, self.rho)
        return MeasurementNoise(self.share, floor, rho, self.window)

    @property
    def innovations(self) -> "MeasurementNoise":
        """White noise as large as what is new in each sample, out of which a slow change stands the farthest."""
        return replace(self, floor=self.floor * np.sqrt(1.0 - self.rho**2), rho=np.zeros_like(self.rho))

    @property
    def misfit(self) -> Float[np.ndarray, " channels"]:
        """How many times the sensor's own noise each channel's floor is."""
        return self.floor / self.of_sensor.floor

    def std(self, y: Float[np.ndarray, "*n channels time"]) -> Float[np.ndarray, "*n channels time"]:
        """Standard deviation of each sample, in the channel's unit."""
        return np.sqrt((self.share[:, None] * y) ** 2 + self.floor[:, None] ** 2)

    def sample(self, shape: tuple[int, int], rng: np.random.Generator) -> Float[np.ndarray, "channels time"]:
        """Unit noise with the channels' correlation."""
        unit = rng.standard_normal(shape, dtype=np.float32)
        if not self.rho.any():
            return unit
        correlated = unit.reshape(shape[0], -1, self.window).astype(float)
        for channel, rho in enumerate(self.rho):
            first = correlated[channel, :, :1].copy()
            driven = np.sqrt(1.0 - rho**2) * correlated[channel]
            driven[:, :1] = first
            correlated[channel] = lfilter([1.0], [1.0, -rho], driven, axis=-1)
        return correlated.reshape(shape)

    def correlated(self, series: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, "n channels time"]:
        """R x for each series x, R being the noise's correlation: rho^lag inside a window and none between two."""
        if not self.rho.any():
            return series
        out = np.empty_like(series, dtype=float)
        for channel, rho in enumerate(self.rho):
            x = series[:, channel].reshape(len(series), -1, self.window)
            later, earlier = (np.asarray(lfilter([1.0], [1.0, -rho], one, axis=-1)) for one in (x, x[..., ::-1]))
            out[:, channel] = (later + earlier[..., ::-1] - x).reshape(len(series), -1)
        return out

    def whiten(
        self,
        residual: Float[np.ndarray, "*n channels time"],
        std: Float[np.ndarray, "channels time"],
        valid: np.ndarray,
    ) -> Float[np.ndarray, "*n channels time"]:
        """The residual in units of independent standard noise; zero where a sample is not valid.

        Across a masked stretch of g samples an AR(1) process keeps rho^g of its last value, which is what is
        subtracted (so windows and gaps need no special case).
        """
        scaled = np.where(valid, residual / std, 0.0)
        if not self.rho.any():
            return scaled
        white = scaled.copy()
        for channel, rho in enumerate(self.rho):
            kept = np.flatnonzero(valid[channel])
            before, now = kept[:-1], kept[1:]
            memory = np.where(before // self.window == now // self.window, rho ** (now - before), 0.0)
            white[..., channel, now] = (scaled[..., channel, now] - memory * scaled[..., channel, before]) / np.sqrt(
                1.0 - memory**2
            )
        return white


def _per_channel(values: Mapping[str, float], channels: tuple[str, ...], where: str) -> np.ndarray:
    """One value a channel, in their order; InputError for one that is missing, unknown or negative."""
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
            raise InputError(f"{where}: {name} = {value!r}; it must be a number that is not negative")
    missing = [name for name in channels if name not in values]
    if missing:
        raise unknown("channel", missing[0], values, where)
    return np.array([float(values[name]) for name in channels])


@dataclass(frozen=True, kw_only=True)
class ProportionalNoise:
    """The paper's: a share of the measured value, sample by sample, with a small floor [channel's unit]."""

    share: Mapping[str, float]
    floor: Mapping[str, float]
    process: ProcessNoise = ProcessNoise()

    def measurement(self, windows: Windows) -> MeasurementNoise:
        share = _per_channel(self.share, windows.channels, "noise.share")
        floor = _per_channel(self.floor, windows.channels, "noise.floor")
        if not floor.all():
            raise InputError("noise.floor: a floor must be positive, for where a signal crosses zero")
        return MeasurementNoise(share, floor, np.zeros(len(share)), windows.t.shape[1])


@dataclass(frozen=True, kw_only=True)
class ConstantNoise:
    """A stated standard deviation per channel [channel's unit]."""

    std: Mapping[str, float]
    process: ProcessNoise = ProcessNoise()

    def measurement(self, windows: Windows) -> MeasurementNoise:
        std = _per_channel(self.std, windows.channels, "noise.std")
        if not std.all():
            raise InputError("noise.std: a standard deviation must be positive")
        return MeasurementNoise(np.zeros(len(std)), std, np.zeros(len(std)), windows.t.shape[1])


@dataclass(frozen=True, kw_only=True)
class EstimatedNoise:
    """Estimated from the recording: standard deviation and lag-one correlation of each channel.

    At first from what a local polynomial leaves over (`measurement`), then, once a model has been fitted, from what
    the model leaves over (`from_residual`), so that slow misfit counts as correlated noise instead of as certainty.
    """

    process: ProcessNoise = ProcessNoise(stiffness=0.0)
    model_residual: bool = True

    def measurement(self, windows: Windows) -> MeasurementNoise:
        if not np.isfinite(windows.y).any():
            raise InputError("noise=estimated: there is no recording to estimate it from; use noise=paper or constant")
        length = _smoothed_over(windows.rate)
        # The polynomial takes (order + 1) of every `length` degrees of freedom.
        return from_residual(rough(windows.y, windows) / np.sqrt(1 - (SMOOTHING_ORDER + 1) / length), windows)


def _smoothed_over(rate: float) -> int:
    """Samples of the local polynomial, an odd number."""
    return max(SMOOTHING_ORDER + 2, round(SMOOTHING_S * rate)) | 1


def rough(y: Float[np.ndarray, "channels time"], windows: Windows) -> Float[np.ndarray, "channels time"]:
    """What a local polynomial leaves over of series, window by window; NaN counts as absent and is bridged."""
    length = min(_smoothed_over(windows.rate), windows.t.shape[1] - (1 - windows.t.shape[1] % 2))
    series = _bridged(y).reshape(len(y), -1, windows.t.shape[1])
    return (series - savgol_filter(series, length, SMOOTHING_ORDER, axis=-1)).reshape(y.shape)


def sensor_noise(y: Float[np.ndarray, "channels time"], windows: Windows, memory_s: float = np.inf) -> SensorNoise:
    """The AR(1) noise that leaves the fast scatter which each channel has, and no slow one, or its rounding if larger.

    Of unit noise with correlation rho^lag the polynomial's residual has the variance g' R g and the lag-one covariance
    g' R S g (g the filter, R_ij = rho^|i-j|, S a shift): their ratio tells rho, the variance then the noise's. The
    correlation time is memory_s [s] at most: a quick drive leaves something of itself, which reads like slow noise.
    """
    rest, floor, rho = rough(np.where(windows.valid, y, np.nan), windows), [], []
    ratios, shares = _left_by_filter(min(_smoothed_over(windows.rate), windows.t.shape[1]))
    for values, valid, read in zip(rest, windows.valid, y, strict=True):
        pairs = _neighbours(valid, windows.t.shape[1])
        square = float(np.mean(values[valid] ** 2)) if valid.any() else 0.0
        ratio = float(np.mean(values[pairs] * values[pairs + 1])) / max(square, TINY**2) if len(pairs) else 0.0
        rho.append(min(float(np.interp(ratio, ratios, CORRELATIONS)), largest_rho(windows.rate, memory_s)))
        share = float(np.interp(rho[-1], CORRELATIONS, shares))
        floor.append(max(np.sqrt(square / share), rounding(read[valid]), TINY))
    return SensorNoise(np.array(floor), np.array(rho))


def _left_by_filter(length: int) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Of unit AR(1) noise at each of CORRELATIONS: lag-one correlation and variance of what the polynomial leaves."""
    length -= 1 - length % 2
    kernel = -savgol_coeffs(length, min(SMOOTHING_ORDER, length - 1))
    kernel[length // 2] += 1.0
    lags = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    shifted = np.abs(np.subtract.outer(np.arange(length), np.arange(length) + 1))
    variance = np.array([kernel @ rho**lags @ kernel for rho in CORRELATIONS])
    return np.array([kernel @ rho**shifted @ kernel for rho in CORRELATIONS]) / variance, variance


def rounding(values: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of the rounding of a channel that reads in steps, a step over sqrt(12); 0 of any other."""
    distinct = np.unique(values)
    if len(distinct) < 2 or len(distinct) > MOST_LEVELS * len(values):
        return 0.0
    steps = np.diff(distinct)
    step = float(steps[steps > RESOLVED * np.ptp(distinct)].min(initial=np.inf))
    off = np.abs(steps / step - np.round(steps / step))
    return step / float(np.sqrt(12.0)) if np.isfinite(step) and np.mean(off) < OFF_STEP else 0.0


def _neighbours(valid: Bool[np.ndarray, " time"], window: int) -> np.ndarray:
    """Valid samples whose next one is valid and of the same window."""
    return np.flatnonzero(valid[:-1] & valid[1:] & (np.arange(1, len(valid)) % window > 0))


def _bridged(y: Float[np.ndarray, "channels time"]) -> Float[np.ndarray, "channels time"]:
    """Absent samples bridged linearly: a step to any constant would count as noise around a gap."""
    t = np.arange(y.shape[1])
    rows = zip(y, np.isfinite(y), strict=True)
    return np.stack([np.interp(t, t[known], row[known]) if known.any() else 0.0 * t for row, known in rows])


def largest_rho(rate: float, memory_s: float) -> float:
    """Lag-one correlation of noise with a correlation time of memory_s [s], sampled at a rate [Hz]."""
    return min(LARGEST_RHO, float(np.exp(-1.0 / (rate * memory_s))))


def from_residual(
    residual: Float[np.ndarray, "channels time"], windows: Windows, memory_s: float = np.inf
) -> MeasurementNoise:
    """Noise of a recording from a residual: lag-one correlation and standard deviation of each channel about zero.

    The correlation time is memory_s [s] at most; what is slower is no noise, and counts only by its innovations.
    Raises InputError for a channel with fewer than ten valid samples.
    """
    time, floor, rho = windows.t.shape[1], [], []
    largest = largest_rho(windows.rate, memory_s)
    for channel, name in enumerate(windows.channels):
        valid = windows.valid[channel]
        if valid.sum() < FEWEST:
            raise InputError(
                f"noise=estimated: channel {name} has {valid.sum()} valid samples; it needs at least {FEWEST}"
            )
        square = float(np.mean(residual[channel, valid] ** 2))
        pairs = _neighbours(valid, time)
        product = float(np.mean(residual[channel, pairs] * residual[channel, pairs + 1]))
        found = float(np.clip(product / max(square, TINY**2), 0.0, 1.0))
        rho.append(min(found, largest))
        left = square * (1.0 - 2.0 * rho[-1] * found + rho[-1] ** 2) / (1.0 - rho[-1] ** 2)
        floor.append(max(np.sqrt(left), TINY))
    return MeasurementNoise(np.zeros(len(floor)), np.array(floor), np.array(rho), time)
