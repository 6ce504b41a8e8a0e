"""Contents of a file: its tables, each on its own clock, with rates and gaps, and the columns that hold numbers."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.formats.limits import TooLargeError
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.formats.table import Table, no_times
from vehicle_sbi.data.inspection.units import called, si, split
from vehicle_sbi.data.time_units import guessed
from vehicle_sbi.data.units import not_understood, without_brackets
from vehicle_sbi.errors import InputError

TIMES = r"(time|time_?stamp|t|elapsed.*|utc.*|header_stamp|.*_time|time_.*)"
FEWEST = 3  # times of a clock
GAP = 0.1, 2.5  # [s] and usual steps that a gap lasts at least, as the reading of recordings has it


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of numbers: unit in the words of `data.units` (None: not said), range, and share of empty rows [1].

    `odd_unit` is what the file or brackets in the name say that is no known unit.
    """

    name: str
    clock: str
    unit: str | None
    unit_from: str
    low: float
    high: float
    absent: float
    values: Float[np.ndarray, " rows"]
    odd_unit: str = ""

    @property
    def address(self) -> str:
        """How a mapping names it: with its clock where the file has several and the name does not begin with it."""
        return f"{self.clock}/{self.name}" if self.clock and self.field == self.name else self.name

    @property
    def field(self) -> str:
        """Its name within its clock: that of the message's field, of the group's channel."""
        return next((self.name.removeprefix(p) for p in _prefixes(self.clock) if self.name.startswith(p)), self.name)

    @property
    def varies(self) -> bool:
        return self.high > self.low

    @property
    def largest(self) -> float:
        """The largest size of 95 % of its values."""
        return float(np.nanquantile(np.abs(self.values), 0.95))


@dataclass(frozen=True, kw_only=True)
class Clock:
    """A table's times: column and unit, span [s], rate [Hz], and its gaps, each with start and length [s].

    `usual`: readers take this column by themselves; `understood`: so do they its unit, if the file states one. `back`
    counts steps that do not go on.
    """

    name: str
    time: str
    usual: bool
    understood: bool
    time_unit: str
    rows: int
    start: float
    span: float
    rate: float
    gaps: tuple[tuple[float, float], ...]
    back: int


@dataclass(frozen=True, kw_only=True)
class Contents:
    """What a table holds: its clock, its columns of numbers, and the names of those that hold none.

    `beyond` names columns that were not read, as together they unpack to more than a file may. Of a table with fewer
    than FEWEST times beside others, as of a topic that is sent once, no column is looked at.
    """

    clock: Clock
    columns: tuple[Column, ...]
    other: tuple[str, ...]
    beyond: tuple[str, ...] = ()


def _prefixes(clock: str) -> tuple[str, ...]:
    """What names of columns may begin with: `/topic.`, `Message.`, `Group/`."""
    return (f"{clock}.", f"{clock}/") if clock else ()


def contents(path: Path, *, time: str | None = None, dbc: str | None = None) -> tuple[Contents, ...]:
    """What a file holds, table by table, those with few times last; InputError if it cannot be read or a table has no
    times."""
    tables = read_tables(path, dbc)
    clocks = [_clock(table, time) for table in tables]
    if all(clock.rows < FEWEST for clock in clocks):
        few = clocks[0]
        raise InputError(f"{path}: column '{few.time}' holds {few.rows} times; a recording needs at least {FEWEST}")
    found = [_contents(table, clock) for table, clock in zip(tables, clocks, strict=True)]
    return tuple(sorted(found, key=lambda one: one.clock.rows < FEWEST))


def _contents(table: Table, clock: Clock) -> Contents:
    if clock.rows < FEWEST:
        return Contents(clock=clock, columns=(), other=())
    columns, other, beyond = [], [], []
    for column in map(str, table.columns):
        if column == clock.time:
            continue
        try:
            found = _column(table, column)
        except TooLargeError:
            beyond.append(column)
            continue
        other.append(column) if found is None else columns.append(found)
    return Contents(clock=clock, columns=tuple(columns), other=tuple(other), beyond=tuple(beyond))


def _column(table: Table, column: str) -> Column | None:
    """A column of numbers, None where it holds none; TooLargeError where it is not read."""
    try:
        values = table.numbers(column)
    except TooLargeError:
        raise
    except InputError:
        return None
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    unit, source = _unit(table, column)
    return Column(
        name=column, clock=table.clock, unit=unit, unit_from=source, low=float(known.min()), high=float(known.max()),
        absent=float(1.0 - len(known) / len(values)), values=values,
        odd_unit="" if unit else table.unit(column) or not_understood(column),
    )  # fmt: skip


def _unit(table: Table, column: str) -> tuple[str | None, str]:
    """A column's unit and who says so: the file or the name."""
    said = called(table.unit(column))
    if said is not None:
        return said, "in the file"
    named = split(column)[1]
    return named, "from the name" if named else "not said"


def _clock(table: Table, asked: str | None) -> Clock:
    """The clock of a table, its unit from the name or from the usual step."""
    time = asked or _time_column(table)
    dates = table.dates(time)
    values = table.numbers(time) if dates is None else dates
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    usual = float(np.median(steps)) if len(steps) else 0.0
    said = "s" if dates is not None else called(table.unit(time)) or split(time, is_time=True)[1]
    unit = said if said and si(said)[0] == "s" else guessed(usual)
    t, steps = values * si(unit)[1], steps * si(unit)[1]
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    long = np.flatnonzero(steps > max(GAP[0], GAP[1] * step))
    return Clock(
        name=table.clock,
        time=time,
        usual=time == table.time,
        understood=dates is not None or not table.unit(time) or called(table.unit(time)) is not None,
        time_unit=unit,
        rows=len(values),
        start=float(t[0]) if len(t) else 0.0,
        span=float(t[-1] - t[0]) if len(t) else 0.0,
        rate=1.0 / step,
        gaps=tuple((float(t[k]), float(steps[k])) for k in long),
        back=int((steps <= 0.0).sum()),
    )


def _time_column(table: Table) -> str:
    """The column of times: the format's own, else one that is called so."""
    if table.has(table.time):
        return table.time
    named = [
        name
        for name in map(str, table.columns)
        if re.fullmatch(TIMES, without_brackets(split(name, is_time=True)[0]).strip().lower())
    ]
    if not named:
        raise no_times(table)
    return named[0]
