"""Files of a drive, of whatever names and units, read into one `Recording`.

A mapping says which column of a file's `Table` holds which channel and how it becomes SI:
value = sign (scale unit(column) + offset). Several files of one drive, each on its own clock in the same time base, are
then laid on one uniform grid by linear interpolation.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.formats import Table, read_table
from vehicle_sbi.data.plausibility import LIMITS, absurd, findings, spoken_runs
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import sha256

Built = TypeVar("Built")

SHORT_GAP_S = 0.1
"""Gaps up to this long [s] are filled linearly, longer ones masked (2.5 sample steps in slow files)."""

MOST_ABSENT = 0.5
"""Largest share of a column's rows that may hold no number."""

GROUPS = ("imu", "can", "wheel_speed")

UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "1": ("1", 1.0), "%": ("1", 0.01),
        "rad": ("rad", 1.0), "deg": ("rad", np.pi / 180.0),
        "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", np.pi / 180.0), "rpm": ("rad/s", np.pi / 30.0),
        "m/s": ("m/s", 1.0), "km/h": ("m/s", 1.0 / 3.6), "mph": ("m/s", 0.44704), "knot": ("m/s", 1852.0 / 3600.0),
        "m/s²": ("m/s²", 1.0), "m/s2": ("m/s²", 1.0), "g": ("m/s²", 9.80665),
        "N m": ("N m", 1.0), "Nm": ("N m", 1.0), "kNm": ("N m", 1000.0),
        "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
    }
)  # fmt: skip
"""Unit -> (SI unit, factor); the factors are exact by definition (SI brochure, 9th edition)."""


def factor(unit: str, si: str, where: str) -> float:
    """What a number in `unit` is multiplied by to be in `si`; InputError if the unit is unknown or of another kind."""
    if unit not in UNITS:
        raise unknown("unit", unit, UNITS, where)
    if UNITS[unit][0] != si:
        allowed = ", ".join(name for name, (kind, _) in UNITS.items() if kind == si)
        raise InputError(f"{where}: unit '{unit}' does not convert to {si}; allowed: {allowed}")
    return UNITS[unit][1]


@dataclass(frozen=True, kw_only=True)
class ChannelSource:
    """Where a channel comes from: a column, or several that are summed, and how its numbers become SI.

    value = sign (scale unit(column) + offset), the offset in SI. `unit` None: already SI. With `wheel_radius` [m] a
    wheel speed may be given as the linear speed of its rim. `group` names the sensors it belongs to.
    """

    column: str | Sequence[str]
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1
    unit: str | None = None
    group: str | None = None
    wheel_radius: float | None = None

    def to_si(self, name: str, values: Float[np.ndarray, " rows"], where: str) -> Float[np.ndarray, " rows"]:
        """The channel `name` in SI units; InputError for a unit, sign or group that is not allowed."""
        where = f"{where}: channel {name}"
        if self.sign not in (1, -1):
            raise InputError(f"{where}: sign {self.sign} is neither 1 nor -1")
        if self.group is not None and self.group not in GROUPS:
            raise unknown("group", self.group, GROUPS, where)
        si, divisor = CHANNELS[name].unit, 1.0
        if self.wheel_radius is not None:
            if si != "rad/s" or self.wheel_radius <= 0.0:
                raise InputError(f"{where}: a wheel_radius is a positive length [m] for a wheel speed [rad/s]")
            si, divisor = "m/s", self.wheel_radius
        scale = self.scale * (1.0 if self.unit is None else factor(self.unit, si, where)) / divisor
        return self.sign * (scale * values + self.offset)


@dataclass(frozen=True, kw_only=True)
class Series:
    """One channel as its file has it: times [s], values in SI (NaN where absent), and its sensor group."""

    t: Float[np.ndarray, " rows"]
    values: Float[np.ndarray, " rows"]
    group: str


@dataclass(frozen=True, kw_only=True)
class RecordingFile:
    """A recording on disk, what its columns mean, and how it is used unless the user says otherwise.

    `mapping` names the source of each channel (None: the native columns of `CHANNELS`); `time` is the time column
    [time_unit], whose values stay the recording's time (a VBO's starts at 0); `rate` [Hz] resamples (None: the file's
    own); `start_s` and `stop_s` cut; `also` are further files of the same drive in the same time base (path, mapping
    and time of theirs count), cut to the stretch that all of them cover. `drive`, `channels` and `v_min` [m/s] are
    defaults for `cutting.cut`.
    Mappings of settings stand for `ChannelSource` and `RecordingFile`, as a configuration file holds them.
    """

    path: str | Path
    mapping: Mapping[str, ChannelSource | Mapping[str, Any]] | None = None
    name: str | None = None
    time: str | None = None
    time_unit: str = "s"
    rate: float | None = None
    start_s: float | None = None
    stop_s: float | None = None
    also: Sequence["RecordingFile | Mapping[str, Any]"] = ()
    drive: str = "speed"
    channels: Sequence[str] = ("a_y", "yaw_rate")
    v_min: float = 1.0

    def load(self) -> Recording:
        """Read, convert, clean and resample; InputError, in one line, for whatever is wrong with the file."""
        files = [self, *(_built(RecordingFile, other, f"{self.path}: also") for other in self.also)]
        notes: list[str] = []
        series: dict[str, Series] = {}
        for file in files:
            found = file.series(notes)
            twice = sorted(found.keys() & series.keys())
            if twice:
                raise InputError(f"{file.path}: {', '.join(twice)} also comes from another file of this recording")
            series |= found
        t, rate = self._grid(series.values(), notes)
        resampled = {name: _resampled(name, one, t, notes) for name, one in series.items()}
        recording = Recording(
            name=self.name or Path(self.path).stem,
            rate=rate,
            t=t,
            channels={name: values for name, (values, _) in resampled.items()},
            valid={name: valid for name, (_, valid) in resampled.items()},
            groups={name: one.group for name, one in series.items()},
            source=" + ".join(str(file.path) for file in files),
            sha256=" + ".join(sha256(Path(file.path)) for file in files),
            notes=tuple(notes),
        )
        return replace(recording, warnings=findings(recording))

    def series(self, notes: list[str]) -> dict[str, Series]:
        """This file's channels in SI, each on the file's own clock and with its group; `notes` grows."""
        table = read_table(Path(self.path))
        t = _clock(table, self.time or table.time, self.time_unit, notes)
        sources = self._sources(table)
        channels = {}
        for name, source in sources.items():
            columns = [source.column] if isinstance(source.column, str) else list(source.column)
            values = np.sum([table.numbers(column) for column in columns], axis=0)[: len(t)]
            _check_absent(table, name, columns, values, t, notes)
            values = source.to_si(name, values, str(self.path))
            spikes = flag_spikes(values) if name != "brake" else np.zeros(len(t), dtype=bool)
            if spikes.any():
                notes.append(f"{name}: {spikes.sum()} single-sample spikes left out at {_listed(t[spikes])} s")
            values = np.where(spikes, np.nan, values)
            rate = 1.0 / float(np.median(np.diff(t)))
            beyond, runs = absurd(name, values, rate)
            limit = f"beyond {LIMITS.get(name, 0.0):g} {CHANNELS[name].unit}"
            for which, why in ((beyond, limit), (runs, "they jump out and back")):
                if which.any():
                    notes.append(f"{name}: {spoken_runs(which, t)} left out: {why}")
            group = source.group or CHANNELS[name].group
            channels[name] = Series(t=t, values=np.where(beyond | runs, np.nan, values), group=group)
        return channels

    def _sources(self, table: Table) -> dict[str, ChannelSource]:
        if self.mapping is None:
            native = {name: ChannelSource(column=c.column) for name, c in CHANNELS.items() if table.has(c.column)}
            if not native:
                columns = ", ".join(channel.column for channel in CHANNELS.values())
                raise InputError(f"{self.path}: no native column and no mapping; native columns: {columns}")
            return native
        strange = [name for name in self.mapping if name not in CHANNELS]
        if strange:
            raise unknown("channel", strange[0], CHANNELS, f"{self.path}: mapping")
        return {n: _built(ChannelSource, given, f"{self.path}: channel {n}") for n, given in self.mapping.items()}

    def _grid(self, series: Iterable[Series], notes: list[str]) -> tuple[Float[np.ndarray, " time"], float]:
        """The uniform grid [s] that all files cover, from a sample of the first, and its rate [Hz]."""
        clocks = [one.t for one in series]
        steps = np.diff(clocks[0])
        step = float(np.median(steps))
        uniform = bool(np.all(np.abs(steps - step) < 0.02 * step))
        own = float(f"{1.0 / (np.mean(steps) if uniform else step):.9g}")
        rate = own if self.rate is None else float(self.rate)
        if not rate > 0.0:
            raise InputError(f"{self.path}: rate {rate:g} Hz is not positive")
        start = max([t[0] for t in clocks] + ([] if self.start_s is None else [self.start_s]))
        stop = min([t[-1] for t in clocks] + ([] if self.stop_s is None else [self.stop_s]))
        inside = clocks[0][(clocks[0] >= start - 1e-6) & (clocks[0] <= stop + 1e-6)]
        if len(inside) < 2:
            spans = ", ".join(f"{low:.12g} to {high:.12g} s" for low, high in {(t[0], t[-1]) for t in clocks})
            raise InputError(
                f"{self.path}: holds no samples from {start:.12g} to {stop:.12g} s; its files hold {spans}"
            )
        if not uniform or rate != own or any(not np.array_equal(t, clocks[0]) for t in clocks):
            spread = f"{1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms"
            notes.append(f"resampled linearly to {rate:g} Hz from steps of {spread}, median {1e3 * step:.3g} ms")
        return inside[0] + np.arange(int((stop - inside[0]) * rate + 1e-3) + 1) / rate, rate


def read(path: str | Path, mapping: Mapping[str, ChannelSource | Mapping[str, Any]] | None = None) -> Recording:
    """The recording in one file: native columns, or those that `mapping` (channel -> source) names."""
    return RecordingFile(path=path, mapping=mapping).load()


def flag_spikes(values: Float[np.ndarray, " rows"]) -> Bool[np.ndarray, " rows"]:
    """Isolated single-sample spikes, by the distance of each sample to the mean of both its neighbours.

    Flags a sample whose distance is 4 times any other within 10 samples (a Hampel test with the largest in place of
    the median), 3 times the recording's 99th percentile and 5 usual changes, while its neighbours agree with each
    other. A step, whose neighbours differ, any wider pulse and any ringing are left alone.
    """
    flags = np.zeros(len(values), dtype=bool)
    known = np.flatnonzero(np.isfinite(values))
    x = values[known]
    changes = np.abs(np.diff(x))
    if len(x) < 5 or not changes.any():
        return flags
    distance = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:]))
    others = maximum_filter(distance, footprint=np.abs(np.arange(-10, 11)) > 1, mode="constant")
    usual = max(3.0 * float(np.quantile(distance, 0.99)), 5.0 * float(np.median(changes[changes > 0.0])))
    flags[known[1:-1]] = (distance > np.maximum(4.0 * others, usual)) & (np.abs(x[2:] - x[:-2]) < 0.25 * distance)
    return flags


def _built(kind: type[Built], given: Built | Mapping[str, Any], where: str) -> Built:
    """`given`, or what its settings construct; InputError for a setting that does not exist."""
    if not isinstance(given, Mapping):
        return given
    known = fields(kind)  # pyright: ignore[reportArgumentType]
    strange = [str(name) for name in given if name not in [one.name for one in known]]
    if strange:
        raise unknown("setting", strange[0], [one.name for one in known], where)
    missing = [one.name for one in known if one.default is MISSING and one.name not in given]
    if missing:
        raise InputError(f"{where}: no value for {', '.join(missing)}")
    return kind(**{str(name): value for name, value in given.items()})


def _clock(table: Table, name: str, unit: str, notes: list[str]) -> Float[np.ndarray, " rows"]:
    """The file's times [s], strictly increasing, without a stray last row; InputError names the row that is wrong."""
    t = table.numbers(name) * factor(unit, "s", f"{table.path}: column {name}")
    if len(t) < 3:
        raise InputError(f"{table.path}: has {len(t)} data rows; a recording needs at least 3")
    absent = np.flatnonzero(np.isnan(t))
    if len(absent):
        raise InputError(f"{table.path}: row {absent[0] + table.first_row}, column '{name}': no time")
    steps = np.diff(t)
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        what = "repeats the time of" if steps[back[0]] == 0.0 else "lies before"
        row = back[0] + 1 + table.first_row
        raise InputError(f"{table.path}: row {row}, column '{name}': {t[back[0] + 1]:.12g} s {what} the row above")
    if steps[-1] > max(1.0, 20.0 * float(np.median(steps))):
        notes.append(f"{table.path.name}: the last row, {steps[-1]:.2f} s after the one before, dropped")
        t = t[:-1]
    return t


def _check_absent(
    table: Table, name: str, columns: Sequence[str], values: Float[np.ndarray, " rows"], t: np.ndarray, notes: list[str]
) -> None:
    absent = np.isnan(values)
    if absent.mean() > MOST_ABSENT:
        raise InputError(
            f"{table.path}: row {np.argmax(absent) + table.first_row}, column '{' + '.join(columns)}': {name} holds no "
            f"number here and in {absent.mean():.0%} of the rows; at most {MOST_ABSENT:.0%} may be empty"
        )
    if absent.any():
        notes.append(f"{name}: {absent.sum()} rows hold no number, first at {t[absent][0]:.2f} s")


def _resampled(
    name: str, series: Series, grid: Float[np.ndarray, " time"], notes: list[str]
) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
    """Values and validity on the grid: linear between measured samples, filled in short gaps, absent in long ones."""
    steps = np.diff(series.t)
    usual, step = 1.5 * float(np.quantile(steps, 0.95)), float(np.median(steps))
    known = np.isfinite(series.values)
    t, values = series.t[known], series.values[known]
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    off_sample = np.minimum(np.abs(grid - t[after - 1]), np.abs(grid - t[after])) > 0.02 * step
    gap = np.where(off_sample, t[after] - t[after - 1], 0.0)
    absent = (gap > max(SHORT_GAP_S, 2.5 * step)) | (off_sample & ((grid < t[0]) | (grid > t[-1])))
    filled = (gap > usual) & ~absent
    if filled.any():
        notes.append(f"{name}: {filled.sum()} samples filled linearly in gaps up to {gap[filled].max():.3g} s")
    if absent.any():
        runs = grid[np.flatnonzero(absent & ~np.roll(absent, 1) | absent & (np.arange(len(grid)) == 0))]
        notes.append(f"{name}: {absent.sum()} samples missing in gaps that start at {_listed(runs)} s")
    return np.where(absent, np.nan, np.interp(grid, t, values)), ~(absent | filled)


def _listed(times: Float[np.ndarray, " n"]) -> str:
    return ", ".join(f"{t:.2f}" for t in times[:5]) + (", …" if len(times) > 5 else "")
