"""Files of a drive, of whatever names and units, read into one `Recording`.

A file is one `Table` a clock (a topic, a group of channels, a CAN message), and a mapping says which column of them
holds which channel. All clocks of a drive, of one file or several in the same time base, are then laid on one uniform
grid by linear interpolation, those that are faster after a low-pass; how they lie to each other is noted.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter

from vehicle_sbi.data.antialiasing import CUTOFF, is_faster, low_passed
from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.formats.table import Table, no_times
from vehicle_sbi.data.mapping import Candidates, ChannelSource, built, mapping_file, native, sources
from vehicle_sbi.data.plausibility import LIMITS, WRONG, absurd, examine, spoken_runs
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.time_units import FASTEST, guessed
from vehicle_sbi.data.units import factor, known_unit
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import sha256

SHORT_GAP_S = 0.1
"""Gaps up to this long [s] are filled linearly, longer ones masked (2.5 sample steps in slow files)."""

SMALL_GRID, LARGEST_GRID = 200_000, 20
"""Samples of the uniform grid that any file may have, and times the file's own samples, at most."""

MOST_ABSENT = 0.5
"""Largest share of a column's rows that may hold no number."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """One channel as its file has it: times [s], values in SI (NaN where absent), its sensor group, and its clock.

    `rows` are the file's numbers of the samples' rows.
    """

    t: Float[np.ndarray, " rows"]
    values: Float[np.ndarray, " rows"]
    group: str
    path: Path
    clock: str
    rows: Int[np.ndarray, " rows"]


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The times [s] of a table, strictly increasing, and the indices of the rows that they are of."""

    t: Float[np.ndarray, " rows"]
    kept: Int[np.ndarray, " rows"]


@dataclass(frozen=True, kw_only=True)
class RecordingFile:
    """A recording on disk, what its columns mean, and how it is used unless the user says otherwise.

    `mapping` names the source of each channel, or a YAML file that does (None or empty: the native columns of
    `CHANNELS`); `dbc` is the database of raw CAN frames; `time` is the time column [time_unit; None: as the file states
    it, else s], whose values stay the recording's time (dates become seconds since 1970; that of a VBO, a bag or a log
    starts at 0); `rate` [Hz] resamples (None: the file's own, of its fastest clock); `start_s` and `stop_s` cut; `also`
    are further files of the same drive in the same time base (path, mapping, dbc and time of theirs count), cut to the
    stretch that all of them cover. `drive`, `channels` and `v_min` [m/s] are defaults for `cutting.cut`.
    Mappings of settings stand for `ChannelSource` and `RecordingFile`, as a configuration file holds them.
    """

    path: str | Path
    mapping: str | Path | Mapping[str, Candidates] | None = None
    dbc: str | None = None
    name: str | None = None
    time: str | None = None
    time_unit: str | None = None
    rate: float | None = None
    start_s: float | None = None
    stop_s: float | None = None
    also: Sequence["RecordingFile | Mapping[str, Any]"] = ()
    drive: str = "speed"
    channels: Sequence[str] = ("a_y", "yaw_rate")
    v_min: float = 1.0

    def load(self) -> Recording:
        """Read, convert, clean and resample; InputError, in one line, for whatever is wrong with the file."""
        files = [self, *(built(RecordingFile, other, f"{self.path}: also") for other in self.also)]
        notes: list[str] = []
        series: dict[str, Series] = {}
        for file in files:
            found = file.series(notes)
            twice = sorted(found.keys() & series.keys())
            if twice:
                raise InputError(f"{file.path}: {', '.join(twice)} also comes from another file of this recording")
            series |= found
        notes += _clock_offsets(series.values())
        t, rate = self._grid(series.values(), notes)
        resampled = {name: _resampled(name, one, t, notes) for name, one in series.items()}
        sources = [Path(one) for file in files for one in (file.path, file.dbc) if one is not None]
        mappings = [Path(file.mapping) for file in files if isinstance(file.mapping, str | Path)]
        recording = Recording(
            name=self.name or Path(self.path).stem,
            rate=rate,
            t=t,
            channels={name: values for name, (values, _) in resampled.items()},
            valid={name: valid for name, (_, valid) in resampled.items()},
            groups={name: one.group for name, one in series.items()},
            source=" + ".join(map(str, sources)),
            files={str(path): sha256(path) for path in sources},
            mappings={str(path): sha256(path) for path in mappings},
            notes=tuple(_once(notes, series)),
        )
        found = examine(recording)
        return replace(
            recording,
            warnings=tuple(one.sentence for one in found),
            wrong=tuple(one.sentence for one in found if one.fault in WRONG),
        )

    def series(self, notes: list[str]) -> dict[str, Series]:
        """This file's channels in SI, each on the clock of its table and with its group; `notes` grows."""
        tables = read_tables(self.path, self.dbc)
        mapping = mapping_file(Path(self.mapping)) if isinstance(self.mapping, str | Path) else self.mapping
        chosen = sources(tables, mapping, str(self.path), notes) if mapping else native(tables, str(self.path))
        clocks = self._clocks(tables, [table for table, _ in chosen.values()], notes)
        stated = {name: source.file_units(name, table) for name, (table, source) in chosen.items()}
        if any(stated.values()):
            spoken = ", ".join(f"{name} {' + '.join(units)}" for name, units in stated.items() if units)
            notes.append(f"units as {Path(self.path).name} states them: {spoken}")
        notes += [
            f"{name}: unit '{odd}' is not understood, {CHANNELS[name].unit} assumed"
            for name, (table, source) in chosen.items()
            for odd in source.assumed(name, table)
        ]
        notes += [
            f"{name}: '{column}' is in {table.unit(column)} in the file, another quantity; {source.unit} counts"
            for name, (table, source) in chosen.items()
            for column in source.overridden(name, table)
        ]
        return {
            name: _series(name, source, table, clocks[table.clock], notes) for name, (table, source) in chosen.items()
        }

    def _clocks(self, tables: Sequence[Table], used: Sequence[Table], notes: list[str]) -> dict[str, Clock]:
        """The times of each table that is used, by the name of its clock."""
        if self.time is not None and len(tables) > 1 and not any(table.has(self.time) for table in tables):
            raise unknown("column", self.time, [name for table in used for name in table.columns], str(self.path))
        clocks = {}
        for table in used:
            if table.clock in clocks:
                continue
            column = self.time if self.time and (len(tables) == 1 or table.has(self.time)) else table.time
            if self.time is None and not table.has(column):
                raise no_times(table)
            own = self.time_unit if column == self.time or len(tables) == 1 else None
            unit = own or table.unit(column) or self.time_unit
            notes += [note for note in table.notes if note not in notes]
            clocks[table.clock] = _clock(table, column, unit, notes)
        return clocks

    def _grid(self, series: Iterable[Series], notes: list[str]) -> tuple[Float[np.ndarray, " time"], float]:
        """The uniform grid [s] that all clocks cover, from a sample of this file's fastest, and its rate [Hz]."""
        listed = list(series)
        own = [one.t for one in listed if one.path == listed[0].path]
        fastest = min(own, key=lambda t: float(np.median(np.diff(t))))
        clocks = [fastest, *(one.t for one in listed)]
        steps = np.diff(clocks[0])
        step = float(np.median(steps))
        uniform = bool(np.all(np.abs(steps - step) < 0.02 * step))
        usual = float(f"{1.0 / (np.mean(steps) if uniform else step):.9g}")
        rate = usual if self.rate is None else float(self.rate)
        if not rate > 0.0:
            raise InputError(f"{self.path}: rate {rate:g} Hz is not positive")
        if self.start_s is not None and self.stop_s is not None and self.start_s >= self.stop_s:
            raise InputError(f"{self.path}: start_s = {self.start_s:g} does not lie before stop_s = {self.stop_s:g}")
        start = max([t[0] for t in clocks] + ([] if self.start_s is None else [self.start_s]))
        stop = min([t[-1] for t in clocks] + ([] if self.stop_s is None else [self.stop_s]))
        inside = clocks[0][(clocks[0] >= start - 1e-6) & (clocks[0] <= stop + 1e-6)]
        if len(inside) < 2:
            spans = ", ".join(f"{low:.12g} to {high:.12g} s" for low, high in {(t[0], t[-1]) for t in clocks})
            raise InputError(
                f"{self.path}: holds no samples from {start:.12g} to {stop:.12g} s; its files hold {spans}, by which "
                "start_s and stop_s count"
            )
        if not uniform or rate != usual or any(not np.array_equal(t, clocks[0]) for t in clocks):
            longest = f"{1e3 * steps.max():.3g} ms" if steps.max() < 1.0 else f"{steps.max():.3g} s"
            spread = f"{1e3 * steps.min():.3g} ms to {longest}"
            notes.append(f"resampled linearly to {rate:g} Hz from steps of {spread}, median {1e3 * step:.3g} ms")
        rows = next(one.rows for one in listed if one.t is fastest)
        self._check_grid(inside, stop, rate, rows[np.searchsorted(fastest, inside[0]) :])
        return inside[0] + np.arange(int((stop - inside[0]) * rate + 1e-3) + 1) / rate, rate

    def _check_grid(self, t: Float[np.ndarray, " rows"], stop: float, rate: float, rows: np.ndarray) -> None:
        """Raise InputError for a grid that would hold many times the samples that there are, and why it would."""
        wanted, most = (stop - t[0]) * rate, max(SMALL_GRID, LARGEST_GRID * len(t))
        if wanted <= most:
            return
        steps = np.diff(t, append=stop)
        k, size = int(np.argmax(steps)), f"{len(t)} samples would become {wanted:.3g} at {rate:g} Hz"
        if (stop - t[0] - steps[k]) * rate > most:
            raise InputError(f"{self.path}: {size}, the rate of its usual step: state a lower one, recording.rate")
        raise InputError(
            f"{self.path}: time jumps by {steps[k]:.6g} s at row {rows[k] + 1}, and {size}: split the file "
            "there, or cut it with recording.start_s or recording.stop_s"
        )


def read(
    path: str | Path, mapping: str | Path | Mapping[str, Candidates] | None = None, dbc: str | None = None
) -> Recording:
    """The recording in one file: native columns, or those that `mapping` (channel -> source, or its file) names."""
    return RecordingFile(path=path, mapping=mapping, dbc=dbc).load()


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


def _series(name: str, source: ChannelSource, table: Table, times: Clock, notes: list[str]) -> Series:
    """A channel in SI on its table's clock, without what cannot be: NaN in its place, and a note."""
    t, rows = times.t, times.kept + table.first_row
    values = source.read(name, table)[times.kept]
    _check_absent(table, name, source.columns, values, t, rows, notes)
    values = source.to_si(name, values, str(table.path))
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
    clock = table.clock or table.path.name
    return Series(
        t=t,
        values=np.where(beyond | runs, np.nan, values),
        group=group,
        path=table.path,
        clock=clock,
        rows=rows,
    )


def _clock_offsets(series: Iterable[Series]) -> list[str]:
    """How the clocks of a recording begin and tick beside its first, a note each; they are kept as they are."""
    clocks = {(one.path, one.clock): one.t for one in series}
    (_, first), *others = clocks
    start = clocks[next(iter(clocks))]
    return [
        f"clock of {name} begins {abs(t[0] - start[0]):.3f} s {'after' if t[0] >= start[0] else 'before'} that of "
        f"{first}, in steps of {1e3 * np.median(np.diff(t)):.3g} ms against {1e3 * np.median(np.diff(start)):.3g} ms"
        for (name, t) in ((key[1], clocks[key]) for key in others)
    ]


def _clock(table: Table, name: str, unit: str | None, notes: list[str]) -> Clock:
    """The file's times, without a stray last row and rows that repeat a time; InputError names the row that is wrong.

    Of rows with equal times the first is kept, whatever the format.
    """
    t = _times(table, name, unit)
    absent = np.flatnonzero(np.isnan(t))
    if len(absent):
        raise InputError(f"{table.path}: row {absent[0] + table.first_row}, column '{name}': no time")
    kept = np.flatnonzero(np.diff(t, prepend=-np.inf) != 0.0)
    if len(kept) < 3:
        times = f" at {len(kept)} times" if len(kept) < len(t) else ""
        raise InputError(f"{table.path}: has {len(t)} data rows{times}; a recording needs at least 3")
    if len(kept) < len(t):
        said = (
            f"{len(t) - len(kept)} of {len(t)} rows repeat the time of the row above: of equal times the first is kept"
        )
        notes.append(f"{table.clock or table.path.name}: {said}")
    t = t[kept]
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        row = kept[back[0] + 1] + table.first_row
        raise InputError(f"{table.path}: row {row}, column '{name}': {t[back[0] + 1]:.12g} s lies before the row above")
    if steps[-1] > max(1.0, 20.0 * float(np.median(steps))):
        notes.append(f"{table.path.name}: the last row, {steps[-1]:.2f} s after the one before, dropped")
        return Clock(t=t[:-1], kept=kept[:-1])
    return Clock(t=t, kept=kept)


def _times(table: Table, name: str, unit: str | None) -> Float[np.ndarray, " rows"]:
    """A column of times [s]; InputError if nobody states its unit and its usual step is none of seconds."""
    dates = table.dates(name)
    if dates is not None:
        return dates
    t = table.numbers(name)
    step = float(np.median(np.diff(t[np.isfinite(t)]))) if np.isfinite(t).sum() > 1 else 0.0
    if unit is None and guessed(step) != "s":
        raise InputError(
            f"{table.path}: column '{name}' states no unit, and its usual step of {step:.6g} is too long for seconds: "
            f"recording.time_unit={guessed(step)} says what it looks like, recording.time_unit=s that it is right"
        )
    if unit is not None and unit == table.unit(name) and known_unit(unit) is None:
        raise InputError(
            f"{table.path}: column '{name}': unit '{unit}' is not understood; recording.time_unit counts instead: "
            f"s, {', '.join(name for name, _ in reversed(FASTEST))}"
        )
    return t * factor(unit or "s", "s", f"{table.path}: column {name}")


def _check_absent(
    table: Table, name: str, columns: Sequence[str], values: Float[np.ndarray, " rows"], t: np.ndarray,
    rows: np.ndarray, notes: list[str],
) -> None:  # fmt: skip
    absent = np.isnan(values)
    if absent.mean() > MOST_ABSENT:
        raise InputError(
            f"{table.path}: row {rows[np.argmax(absent)]}, column '{' + '.join(columns)}': {name} holds no "
            f"number here and in {absent.mean():.0%} of the rows; at most {MOST_ABSENT:.0%} may be empty"
        )
    if absent.any():
        notes.append(f"{name}: {absent.sum()} rows hold no number, first at {t[absent][0]:.2f} s")


def _resampled(
    name: str, series: Series, grid: Float[np.ndarray, " time"], notes: list[str]
) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
    """Values and validity on the grid: linear between measured samples, filled in short gaps, absent in long ones.

    Of a series that is faster than the grid, what the grid cannot show is taken off first; a flag stays a flag.
    """
    steps = np.diff(series.t)
    usual, step = 1.5 * float(np.quantile(steps, 0.95)), float(np.median(steps))
    known = np.isfinite(series.values)
    t, values = series.t[known], series.values[known]
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    off_sample = np.minimum(np.abs(grid - t[after - 1]), np.abs(grid - t[after])) > 0.02 * step
    gap = np.where(off_sample, t[after] - t[after - 1], 0.0)
    longest_gap = max(SHORT_GAP_S, 2.5 * step)
    absent = (gap > longest_gap) | (off_sample & ((grid < t[0]) | (grid > t[-1])))
    filled = (gap > usual) & ~absent
    rate = 1.0 / float(np.median(np.diff(grid))) if len(grid) > 1 else np.inf
    if name != "brake" and is_faster(step, rate):
        values = low_passed(t, values, rate, longest_gap)
        why = f"its {1.0 / step:.3g} Hz are more than the grid's {rate:.3g} Hz"
        notes.append(f"{name}: low-passed at {CUTOFF * rate:.3g} Hz without phase, as {why}")
    if filled.any():
        notes.append(f"{name}: {filled.sum()} samples filled linearly in gaps up to {gap[filled].max():.3g} s")
    if absent.any():
        runs = grid[np.flatnonzero(absent & ~np.roll(absent, 1) | absent & (np.arange(len(grid)) == 0))]
        notes.append(
            f"{name}: {absent.sum()} samples missing in gaps that start at {_listed(runs)} s; they are left out"
        )
    return np.where(absent, np.nan, np.interp(grid, t, values)), ~(absent | filled)


def _once(notes: Iterable[str], channels: Collection[str]) -> list[str]:
    """Notes on channels of which several say the same, as one on all of these."""
    named: dict[str, list[str]] = {}
    for note in notes:
        name, _, said = note.partition(": ")
        named.setdefault(said if name in channels else note, []).append(name)
    return [
        said if names[0] not in channels
        else f"{'all channels' if len(names) == len(channels) > 1 else ', '.join(names)}: {said}"
        for said, names in named.items()
    ]  # fmt: skip


def _listed(times: Float[np.ndarray, " n"]) -> str:
    return ", ".join(f"{t:.2f}" for t in times[:5]) + (", …" if len(times) > 5 else "")
