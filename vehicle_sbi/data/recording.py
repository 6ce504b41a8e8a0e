"""A recording: named channels in SI units on one uniform time grid, and the windows that a simulator is run on.

Axes are ISO 8855 (x forward, y left, z up; yaw and steering positive to the left). A sample may be in one of three
states: measured (finite and valid), filled (finite but not valid: it may drive the model, it is never fitted), or
absent (NaN and not valid).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.signal import savgol_filter

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.physics.single_track import INPUTS

SMOOTHING_S = 0.25
"""Length [s] of the Savitzky-Golay filter (order 2) behind v_x_dot, the initial states and the smoothed v_x."""

V_Y_LEVER, SIDESLIP = 1.5, 0.1
"""Where v_y is not recorded it may be wrong by 1.5 m times the yaw rate (about the rear axle's distance), at most by
0.1 rad times v_x; both root mean squares over the recording."""

STRETCHES = 3
"""Usable stretches that are named where none is long enough, at most."""

MOST_HELD = 20
"""Samples for which a held signal usually stays, at most: one that stays for longer is at rest."""

YAW_RATE_UNKNOWN = 0.2
"""Standard deviation [rad/s] of an initial yaw rate that nothing in the recording tells."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """What a channel's name means: unit, suffix of its column in a native file, and the sensors it comes with."""

    name: str
    suffix: str
    unit: str
    group: str

    @property
    def column(self) -> str:
        return f"{self.name}_{self.suffix}"


def _table(*rows: tuple[str, str, str, str]) -> Mapping[str, Channel]:
    return MappingProxyType({n: Channel(name=n, suffix=s, unit=u, group=g) for n, s, u, g in rows})


CHANNELS = _table(
    ("steering", "rad", "rad", "can"),
    ("steering_wheel", "rad", "rad", "can"),
    ("torque_front", "nm", "N m", "can"),
    ("torque_rear", "nm", "N m", "can"),
    ("brake", "flag", "1", "can"),
    ("v_x", "mps", "m/s", "can"),
    ("v_y", "mps", "m/s", "imu"),
    ("a_x", "mps2", "m/s²", "imu"),
    ("a_y", "mps2", "m/s²", "imu"),
    ("a_z", "mps2", "m/s²", "imu"),
    ("yaw_rate", "radps", "rad/s", "imu"),
    ("roll_rate", "radps", "rad/s", "imu"),
    ("pitch_rate", "radps", "rad/s", "imu"),
    ("roll", "rad", "rad", "imu"),
    ("wheel_speed_front", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rear", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_fl", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_fr", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rl", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rr", "radps", "rad/s", "wheel_speed"),
)

NEEDED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"torque": ("torque_front",), "wheel_speed": ("wheel_speed_front", "wheel_speed_rear"), "speed": ("v_x",)}
)
"""What each drive mode needs besides the steering; the rear torque is 0 where it is not recorded."""

DRIVEN_BY: Mapping[str, tuple[str, ...]] = MappingProxyType({**NEEDED, "torque": ()})
"""The measured speeds that drive the model, by drive mode."""

AXLE_MEANS = MappingProxyType(
    {
        "wheel_speed_front": ("wheel_speed_fl", "wheel_speed_fr"),
        "wheel_speed_rear": ("wheel_speed_rl", "wheel_speed_rr"),
    }
)


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Stretches of a recording of equal length, each simulated from its own initial state.

    u: inputs in the order of `INPUTS`, held over the padded end of a last window; x0: v_x [m/s], v_y [m/s] and
    yaw rate [rad/s] at each start, x0_std their standard deviations; y: measurements, window after window (NaN where
    there is none); valid: what is to be fitted; t: recording time [s]; groups: the sensors of each channel, speed_group
    those of the speeds that drive the model; recordings: which one each window is of.
    """

    rate: float
    u: Float[np.ndarray, "windows time 9"]
    y: Float[np.ndarray, "channels windows*time"]
    valid: Bool[np.ndarray, "channels windows*time"]
    x0: Float[np.ndarray, "windows 3"]
    x0_std: Float[np.ndarray, " 3"]
    channels: tuple[str, ...]
    groups: tuple[str, ...]
    t: Float[np.ndarray, "windows time"]
    notes: tuple[str, ...] = ()
    speed_group: str = "can"
    recordings: tuple[str, ...] = ()

    def sensed(self, drive: str) -> dict[str, str]:
        """The group of sensors of each channel that is recorded, and of the speeds that drive the model."""
        driving = dict.fromkeys(DRIVEN_BY[drive], self.speed_group)
        return driving | dict(zip(self.channels, self.groups, strict=True))


def one_after_another(recordings: Sequence[Sequence[Windows]]) -> list[float]:
    """What to add to the time of each recording [s], so that one clock runs through what is used of all, from 0 on.

    Of each recording all that is used of it: the windows that are fitted, those that are held out.
    """
    shifts, elapsed = list[float](), 0.0
    for parts in recordings:
        times = [part.u[..., INPUTS.index("time")] for part in parts]
        shifts.append(elapsed - min(float(time.min()) for time in times))
        elapsed = shifts[-1] + max(float(time.max()) for time in times) + 1.0 / parts[0].rate
    return shifts


def check_alike(parts: Sequence[Windows], names: Sequence[str]) -> None:
    """InputError for recordings of different rates, channels or sensor groups; `names` are what it calls them."""
    first = parts[0]
    for part, name in zip(parts, names, strict=True):
        for what in ("rate", "channels", "groups", "speed_group"):
            if getattr(part, what) != getattr(first, what):
                raise InputError(
                    f"recordings {names[0]} and {name} differ in their {what}: {getattr(first, what)} and "
                    f"{getattr(part, what)}; one diagnosis needs the same of all (recording.rate resamples)"
                )


def joined(parts: Sequence[Windows], names: Sequence[str], shifts: Sequence[float] | None = None) -> Windows:
    """Windows of several recordings as those of one, the time of each shifted, by default one after another.

    The spread of initial states is the largest of each. Raises InputError for recordings that are not alike.
    """
    check_alike(parts, names)
    first, u = parts[0], []
    for part, shift in zip(parts, shifts or one_after_another([[part] for part in parts]), strict=True):
        moved = part.u.copy()
        moved[..., INPUTS.index("time")] += shift
        u.append(moved)
    notes = tuple(f"{name}: {note}" for part, name in zip(parts, names, strict=True) for note in part.notes)
    return replace(
        first,
        u=np.concatenate(u),
        y=np.concatenate([part.y for part in parts], axis=1),
        valid=np.concatenate([part.valid for part in parts], axis=1),
        x0=np.concatenate([part.x0 for part in parts]),
        x0_std=np.max([part.x0_std for part in parts], axis=0),
        t=np.concatenate([part.t for part in parts]),
        recordings=tuple(name for part, name in zip(parts, names, strict=True) for _ in part.t),
        notes=notes if len(parts) > 1 else first.notes,
    )


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Channels on a uniform grid `t` [s] at `rate` [Hz]; `notes` lists what was filled, left out, resampled, flagged.

    `warnings` says what the drive contradicts: signs, units, axes, offsets.
    `source` and `sha256` name the file it was read from. Raises InputError for a channel that is not in
    `CHANNELS`.
    """

    name: str
    rate: float
    t: Float[np.ndarray, " time"]
    channels: Mapping[str, Float[np.ndarray, " time"]]
    valid: Mapping[str, Bool[np.ndarray, " time"]]
    groups: Mapping[str, str]
    source: str
    sha256: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.channels:
            if name not in CHANNELS:
                raise unknown("channel", name, CHANNELS, self.source)

    def series(self, name: str) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]] | None:
        """Values and validity of a channel, None if it is not recorded; an axle's speed is the mean of its wheels'."""
        if name in self.channels:
            return self.channels[name], self.valid[name]
        wheels = AXLE_MEANS.get(name, ())
        if wheels and all(wheel in self.channels for wheel in wheels):
            left, right = wheels
            return 0.5 * (self.channels[left] + self.channels[right]), self.valid[left] & self.valid[right]
        return None

    def group(self, name: str) -> str:
        """The sensor group of a channel ("imu", "can" or "wheel_speed")."""
        return self.groups.get(name) or self.groups.get(AXLE_MEANS.get(name, (name,))[0]) or CHANNELS[name].group

    def masked(self, keep: Bool[np.ndarray, " time"], note: str) -> "Recording":
        """The recording with every sample outside `keep` made absent, on the same grid."""
        return replace(
            self,
            channels={name: np.where(keep, values, np.nan) for name, values in self.channels.items()},
            valid={name: valid & keep for name, valid in self.valid.items()},
            notes=(*self.notes, note),
        )

    @property
    def present(self) -> Bool[np.ndarray, " time"]:
        """Where anything was recorded, and not left out."""
        return np.any([*self.valid.values()], axis=0)

    @property
    def present_s(self) -> float:
        """How long anything was recorded [s]."""
        return float(self.present.sum() / self.rate)

    def liveliest(self, share: float, *, stretch_s: float = 60.0) -> "Recording":
        """The recording with nothing but the stretches in which steering and speed change most, `share` of its time.

        A stretch is as lively as its variances of the two are large, in units of the whole recording's. The steering
        wheel stands for the steering and the wheels' speed for the car's where that is all there is.
        """
        if share >= 1.0:
            return self
        n = len(self.t)
        count = max(round(n / self.rate / stretch_s), math.ceil(1.0 / share))
        of = np.arange(n) * count // n
        lively = np.zeros(count)
        for names in (("steering", "steering_wheel"), ("v_x", "wheel_speed_rear", "wheel_speed_front")):
            recorded = next((series for name in names if (series := self.series(name)) is not None), None)
            if recorded is None:
                continue
            values, valid = np.nan_to_num(recorded[0]), recorded[1]
            each = pd.Series(values[valid]).groupby(of[valid]).var(ddof=0).reindex(range(count), fill_value=0.0)
            lively += np.nan_to_num(each.to_numpy()) / max(float(np.var(values[valid])), 1e-12)
        kept = np.isin(of, np.argsort(-lively, kind="stable")[: max(int(share * count), 1)])
        return self.masked(kept, f"{kept.mean():.0%} of the time used: where steering and speed change most")

    def holdout(
        self, *, share: float = 0.25, block_s: float = 10.0, buffer_s: float = 1.0
    ) -> tuple["Recording", "Recording"]:
        """(training, held out): alternating blocks in time, on the same grid, each with the other's samples absent.

        About `share` of the blocks of `block_s` (shorter ones in a short recording) is held out; the training part
        also lacks `buffer_s` on either side of them, so that nothing correlated lies in both. Raises InputError for
        a share outside (0, 1) or a buffer that leaves no training sample.
        """
        if not (0.0 < share < 1.0 and block_s > 0.0 and buffer_s >= 0.0):
            raise InputError(
                f"{self.source}: holdout needs 0 < share < 1, block_s > 0 and buffer_s >= 0, "
                f"given {share:g}, {block_s:g} and {buffer_s:g}"
            )
        n = len(self.t)
        blocks = max(round(n / self.rate / block_s), math.ceil(1.0 / min(share, 1.0 - share)))
        turn = np.floor(np.arange(blocks + 1) * share + 0.5)
        held = (np.diff(turn) > 0)[np.arange(n) * blocks // n]
        reach = round(buffer_s * self.rate)
        near = np.convolve(held, np.ones(2 * reach + 1))[reach : reach + n] > 0.5
        if near.all():
            raise InputError(f"{self.source}: a buffer of {buffer_s:g} s leaves nothing to train on; make it shorter")
        note = f"{held.mean():.0%} of the time held out in {int(turn[-1])} of {blocks} blocks, buffer {buffer_s:g} s"
        return self.masked(~near, f"training part: {note}"), self.masked(held, f"held-out part: {note}")

    def windows(
        self,
        *,
        drive: str,
        channels: Sequence[str],
        length_s: float,
        warmup_s: float = 0.5,
        start_s: float | None = None,
        stop_s: float | None = None,
        steering_ratio: float | None,
        v_min: float = 1.0,
        wheel_radius: float | None = None,
    ) -> Windows:
        """Cut the recording from `start_s` to `stop_s` [s] into windows of `length_s` for one drive mode.

        Windows never span absent inputs, speeds below `v_min` [m/s] or, where torque drives, braking (no brake
        torque is recorded). What is left of a stretch is padded to a window if it is at least half of one, else
        dropped. The first `warmup_s` of each window, the transient of an initial state that is known only roughly,
        is not fitted. The initial state is the smoothed measurement, its standard deviation the spread around it;
        v_x comes from the rear wheels and `wheel_radius` [m] where it is not recorded, and v_y is then 0.
        Raises InputError for a channel that is missing or an input itself, and where no window remains.
        """
        n, warmup = round(length_s * self.rate), round(warmup_s * self.rate)
        if not 0 <= warmup < n:
            raise InputError(
                f"{self.source}: windows of {length_s:g} s need a warm-up shorter than that, not {warmup_s:g} s"
            )
        inputs = self._inputs(drive, steering_ratio)
        measured = [self._measured(name, drive) for name in channels]
        state, state_std = self._initial_states(wheel_radius)
        usable, notes = self._usable(inputs, drive, state[:, 0], v_min, start_s, stop_s)
        index, real = _cut(usable, n)
        y = np.array([values for values, _ in measured]).reshape(len(channels), len(self.t))[:, index]
        valid = np.array([good for _, good in measured], dtype=bool).reshape(len(channels), len(self.t))[:, index]
        valid &= real & (np.arange(n) >= warmup)
        fitted = valid.any(axis=(0, 2)) if len(channels) else real.any(axis=1)
        if not fitted.any():
            said = "; ".join([_stretches(usable, self.t, self.rate, length_s), *notes])
            raise InputError(f"{self.source}: no window of {length_s:g} s is left; {said}")
        u = np.stack([inputs.get(name, np.zeros_like(self.t)) for name in INPUTS], axis=-1)[index]
        u[~real, INPUTS.index("v_x_dot")] = 0.0
        left_over = int(usable.sum() - real[fitted].sum())
        notes += [f"{left_over / self.rate:.2f} s usable but in no window"] if left_over else []
        return Windows(
            rate=self.rate,
            u=u[fitted],
            y=np.where(real & np.isfinite(y), y, np.nan)[:, fitted].reshape(len(channels), -1),
            valid=(valid & np.isfinite(y))[:, fitted].reshape(len(channels), -1),
            x0=state[index[fitted, 0]],
            x0_std=state_std,
            channels=tuple(channels),
            groups=tuple(self.group(name) for name in channels),
            speed_group=self.group(NEEDED[drive][0]),
            t=(self.t[index[:, :1]] + np.arange(n) / self.rate)[fitted],
            recordings=(self.name,) * int(fitted.sum()),
            notes=(*self.notes, *notes),
        )

    def _need(self, name: str, why: str) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
        series = self.series(name)
        if series is None:
            raise InputError(
                f"{self.source}: {why} needs channel '{name}' (column {CHANNELS[name].column}), which the recording "
                f"does not have; it has {', '.join(self.channels)}"
            )
        return series

    def _inputs(self, drive: str, steering_ratio: float | None) -> dict[str, Float[np.ndarray, " time"]]:
        if drive not in NEEDED:
            raise unknown("drive mode", drive, NEEDED, self.source)
        why = f"drive mode '{drive}'"
        inputs = {name: self._need(name, why)[0] for name in NEEDED[drive]} | {
            "time": np.arange(len(self.t)) / self.rate
        }
        if drive == "torque":
            inputs["torque_rear"] = self.channels.get("torque_rear", np.zeros_like(self.t))
        if drive == "speed":
            v_x = inputs["v_x"]
            smooth = smoothed(v_x, self.rate, self.source)
            inputs["v_x"] = np.where(np.isfinite(v_x), smooth, np.nan)
            # of the speed that drives the model: that of the measured one is rough
            inputs["v_x_dot"] = smoothed(smooth, self.rate, self.source, derivative=1)
        if drive == "wheel_speed":
            for name in NEEDED[drive]:
                held = inputs[name]
                inputs[name] = np.where(np.isfinite(held), smoothed(held, self.rate, self.source), np.nan)
        if "steering" not in self.channels and "steering_wheel" in self.channels:
            if steering_ratio is None:
                raise InputError(f"{self.source}: {why} has only steering_wheel and needs the vehicle's steering_ratio")
            inputs["steering"] = self.channels["steering_wheel"] / steering_ratio
        else:
            inputs["steering"] = self._need("steering", why)[0]
        inputs["steering"] = unheld(inputs["steering"])
        return inputs

    def _measured(self, name: str, drive: str) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
        if name not in CHANNELS:
            raise unknown("channel", name, CHANNELS, self.source)
        if name in NEEDED[drive]:
            raise InputError(f"{self.source}: {name} drives the model in drive mode '{drive}' and cannot be fitted")
        return self._need(name, "the fit")

    def _initial_states(
        self, wheel_radius: float | None
    ) -> tuple[Float[np.ndarray, "time 3"], Float[np.ndarray, " 3"]]:
        """(v_x, v_y, yaw rate) at every sample, and their standard deviations."""
        rear = self.series("wheel_speed_rear")
        if "v_x" not in self.channels and rear is not None and wheel_radius is not None:
            v_x = wheel_radius * rear[0]
        else:
            v_x, _ = self._need("v_x", "the initial state, without wheel_speed_rear and a wheel_radius,")
        v_x, v_x_std = self._estimate(v_x)
        r, r_std = np.zeros_like(v_x), YAW_RATE_UNKNOWN
        if "yaw_rate" in self.channels:
            r, r_std = self._estimate(self.channels["yaw_rate"])
        v_y = np.zeros_like(v_x)
        v_y_std = min(V_Y_LEVER * max(_rms(r), r_std), SIDESLIP * _rms(v_x))
        if "v_y" in self.channels:
            v_y, v_y_std = self._estimate(self.channels["v_y"])
        return np.stack([v_x, v_y, r], axis=-1), np.array([v_x_std, v_y_std, r_std])

    def _estimate(self, values: Float[np.ndarray, " time"]) -> tuple[Float[np.ndarray, " time"], float]:
        smooth = smoothed(values, self.rate, self.source)
        return smooth, float(np.nanstd(values - smooth))

    def _usable(
        self,
        inputs: Mapping[str, Float[np.ndarray, " time"]],
        drive: str,
        v_x: Float[np.ndarray, " time"],
        v_min: float,
        start_s: float | None,
        stop_s: float | None,
    ) -> tuple[Bool[np.ndarray, " time"], list[str]]:
        """Where the model may be run, and why not elsewhere, as far as anything is present there."""
        within = (self.t >= (self.t[0] if start_s is None else start_s)) & (
            self.t <= (self.t[-1] if stop_s is None else stop_s)
        )
        reasons = {
            "outside the chosen stretch": ~within,
            "without an input": ~np.all([np.isfinite(values) for values in inputs.values()], axis=0),
            f"below {v_min:g} m/s": v_x < v_min,
        }
        if drive == "torque" and "brake" in self.channels:
            reasons["braking"] = self.channels["brake"] > 0.5
        seconds = {reason: (bad & self.present).sum() / self.rate for reason, bad in reasons.items()}
        notes = [f"{bad:.2f} s {reason}: not used" for reason, bad in seconds.items() if bad > 0.0]
        return ~np.any(list(reasons.values()), axis=0), notes


def smoothed(
    values: Float[np.ndarray, " time"], rate: float, where: str, derivative: int = 0
) -> Float[np.ndarray, " time"]:
    """Savitzky-Golay smoothing (order 2, `SMOOTHING_S` and at least 5 samples) of `values`, or their derivative.

    Absent samples are bridged linearly. Exact for parabolas. Raises InputError for fewer samples than the filter has.
    (Savitzky and Golay, Analytical Chemistry 36, 1964.)
    """
    length = max(5, 2 * round(0.5 * SMOOTHING_S * rate) + 1)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) == 0 or len(values) < length:
        raise InputError(f"{where}: {len(known)} samples at {rate:g} Hz are too few; at least {length} are needed")
    bridged = np.interp(np.arange(len(values)), known, values[known])
    return np.asarray(savgol_filter(bridged, length, 2, deriv=derivative, delta=1.0 / rate))


def unheld(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """A signal that is updated more slowly than it is sampled, linear between its updates instead of in steps.

    Steps that the car did not make would excite the model. A signal counts as held if it usually stays for two samples
    or more while it moves; where it rests for longer than that it stays at rest until the last usual step. Absent
    samples remain absent, and any other signal as it is.
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 3:
        return values
    x = values[known]
    updates = np.concatenate([[0], np.flatnonzero(np.diff(x)) + 1])
    if len(updates) < MOST_HELD:
        return values
    usual = int(np.median(np.diff(updates)))
    if not 2 <= usual <= MOST_HELD:
        return values
    rests = updates[1:][np.diff(updates) > 2 * usual] - usual  # until when a long rest lasts
    knots = np.union1d(np.union1d(updates, rests), [len(x) - 1])
    smooth = values.copy()
    smooth[known] = np.interp(np.arange(len(x)), knots, x[knots])
    return smooth


def _rms(values: Float[np.ndarray, " time"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _stretches(usable: Bool[np.ndarray, " time"], t: Float[np.ndarray, " time"], rate: float, length_s: float) -> str:
    """Which stretches could be used, the longest first, and which window would fit the longest."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]]))).reshape(-1, 2)
    if not len(edges):
        return "no stretch can be used"
    longest = edges[np.argsort(-(edges[:, 1] - edges[:, 0]), kind="stable")]
    spoken = ", ".join(f"{t[start]:.2f} to {t[stop - 1]:.2f} s" for start, stop in longest[:STRETCHES])
    more = f" and {len(longest) - STRETCHES} shorter ones" if len(longest) > STRETCHES else ""
    seconds = float(longest[0, 1] - longest[0, 0]) / rate
    fits = f"window_s={math.floor(10.0 * seconds) / 10.0:g} fits the longest"
    short = "nothing that is to be fitted is measured there" if 2.0 * seconds >= length_s else fits
    return f"stretches that can be used: {spoken}{more}; {short}"


def _cut(usable: Bool[np.ndarray, " time"], n: int) -> tuple[np.ndarray, Bool[np.ndarray, "windows n"]]:
    """Sample indices (windows, n) of each window inside usable stretches, and which of them are not padding."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]])))
    rows = [
        (start, stop)
        for start, stop in edges.reshape(-1, 2)
        for start in range(start, stop, n)
        if 2 * (stop - start) >= n
    ]
    starts = np.array([start for start, _ in rows], dtype=int).reshape(-1, 1)
    stops = np.array([stop for _, stop in rows], dtype=int).reshape(-1, 1)
    index = starts + np.arange(n)
    return np.minimum(index, stops - 1), index < stops
