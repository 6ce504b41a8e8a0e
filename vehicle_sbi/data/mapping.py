"""A mapping: which column of a file holds which channel, and how its numbers become SI.

value = sign (scale unit(column) + offset). A channel may have several candidates, of which the first that the file has
is taken, and may be optional.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from vehicle_sbi import plain_yaml
from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.formats.table import Table
from vehicle_sbi.data.units import UNITS, factor, known_unit, not_understood
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.plain_yaml import UnreadableYaml

Built = TypeVar("Built")

GROUPS = ("imu", "can", "wheel_speed")
LARGEST = 1e12  # of a scale or an offset
MOST_NAMES = 60  # columns that a message lists


@dataclass(frozen=True, kw_only=True)
class ChannelSource:
    """Where a channel comes from: a column, or several that are summed, and how its numbers become SI.

    value = sign (scale unit(column) + offset), the offset in SI. `unit` None: the file's own where it states one, else
    SI. With `wheel_radius` [m] a wheel speed may be given as the linear speed of its rim. `group` names the sensors it
    belongs to. A file may lack what is `optional`; `note` is said where the source is used.
    """

    column: str | Sequence[str]
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1
    unit: str | None = None
    group: str | None = None
    wheel_radius: float | None = None
    optional: bool = False
    note: str | None = None

    def __post_init__(self) -> None:
        listed = isinstance(self.column, Sequence) and len(self.column) > 0
        if not listed or not all(isinstance(one, str) for one in self.columns):
            raise InputError(f"column = {self.column!r}; it must be the name of a column, or a list of names")
        for name in ("scale", "offset", "wheel_radius"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST
            if not (number or (value is None and name == "wheel_radius")) or (name != "offset" and value == 0):
                raise InputError(
                    f"{name} = {value!r}; it must be a number" + ("" if name == "offset" else ", not zero")
                )
        for name in ("unit", "group", "note"):
            if not isinstance(getattr(self, name), str | None):
                raise InputError(f"{name} = {getattr(self, name)!r}; it must be text")

    @property
    def columns(self) -> list[str]:
        return [self.column] if isinstance(self.column, str) else list(self.column)

    def to_si(self, name: str, values: Float[np.ndarray, " rows"], where: str) -> Float[np.ndarray, " rows"]:
        """The channel `name` in SI units; InputError for a unit, sign or group that is not allowed."""
        where = f"{where}: channel {name}"
        if self.sign not in (1, -1):
            raise InputError(f"{where}: sign {self.sign} is neither 1 nor -1")
        if self.group is not None and self.group not in GROUPS:
            raise unknown("group", self.group, GROUPS, where)
        si, divisor = self._si(name, where), self.wheel_radius or 1.0
        scale = self.scale * (1.0 if self.unit is None else factor(self.unit, si, where)) / divisor
        return self.sign * (scale * values + self.offset)

    def read(self, name: str, table: Table) -> Float[np.ndarray, " rows"]:
        """The sum of the columns, in the file's unit where this source states none in its place; see `to_si`."""
        return np.sum([self._stated(name, table, one) * table.numbers(one) for one in self.columns], axis=0)

    def file_units(self, name: str, table: Table) -> list[str]:
        """The units, other than SI, that are taken from the file."""
        used = [table.unit(one) for one in self.columns if self._stated(name, table, one) != 1.0]
        return list(dict.fromkeys(used))

    def _stated(self, name: str, table: Table, column: str) -> float:
        """The factor of the unit that the file states; InputError if it is none of this channel."""
        stated = table.unit(column)
        if self.unit is not None or not stated or name == "brake":
            return 1.0
        where = f"{table.path}: channel {name}"
        si, found = self._si(name, where), known_unit(stated)
        if found is None or found[0] != si:
            allowed = ", ".join(one for one, (kind, _) in UNITS.items() if kind == si)
            why = "is not understood" if found is None else f"is no unit of {si}"
            raise InputError(
                f"{where}: column '{column}': unit '{stated}' {why}; a unit in the mapping counts instead: {allowed}"
            )
        return found[1]

    def overridden(self, name: str, table: Table) -> list[str]:
        """Columns of another quantity, by the unit that the file states, in whose place the mapping's unit counts."""
        found = {one: known_unit(table.unit(one)) for one in self.columns} if self.unit and name != "brake" else {}
        return [column for column, stated in found.items() if stated and stated[0] != self._si(name, str(table.path))]

    def assumed(self, name: str, table: Table) -> list[str]:
        """What stands in brackets after the columns' names and is not understood, where nothing states a unit."""
        if self.unit is not None or name == "brake":
            return []
        return [odd for one in self.columns if not table.unit(one) and (odd := not_understood(one))]

    def _si(self, name: str, where: str) -> str:
        """The SI unit of the column, which for a wheel may be that of its rim."""
        si = CHANNELS[name].unit
        if self.wheel_radius is None:
            return si
        if si != "rad/s" or self.wheel_radius <= 0.0:
            raise InputError(f"{where}: a wheel_radius is a positive length [m] for a wheel speed [rad/s]")
        return "m/s"


Candidates = ChannelSource | Mapping[str, Any] | Sequence[ChannelSource | Mapping[str, Any]]
"""A channel's source, its settings, or several of which the first that the file has is taken."""


def sources(
    tables: Sequence[Table], mapping: Mapping[str, Candidates], where: str, notes: list[str]
) -> dict[str, tuple[Table, ChannelSource]]:
    """Where each channel of the mapping comes from; InputError if one that is not optional is in no table."""
    strange = [name for name in mapping if name not in CHANNELS]
    if strange:
        raise unknown("channel", strange[0], CHANNELS, f"{where}: mapping")
    found = {}
    for name, given in mapping.items():
        candidates = candidates_of(given, f"{where}: channel {name}")
        chosen = next(((table, one) for one in candidates if (table := _table_of(tables, one, name))), None)
        if chosen is not None:
            found[name] = chosen
            notes += [f"{name}: {chosen[1].note}"] if chosen[1].note else []
        elif not candidates or not all(one.optional for one in candidates):
            raise _no_column(tables, candidates, name, where)
    if not found:
        wanted = ", ".join(name for name in mapping)
        raise InputError(f"{where}: has none of the columns of its mapping, which are all optional: {wanted}")
    return found


def candidates_of(given: Candidates, where: str) -> list[ChannelSource]:
    """What a mapping says of one channel, the first candidate first."""
    listed = [given] if isinstance(given, ChannelSource | Mapping) else [*given]
    return [built(ChannelSource, one, where) for one in listed]


def native(tables: Sequence[Table], where: str) -> dict[str, tuple[Table, ChannelSource]]:
    """The native columns that the tables have; InputError if there is none."""
    found = {
        name: (table, ChannelSource(column=channel.column))
        for table in reversed(tables)
        for name, channel in CHANNELS.items()
        if table.has(channel.column)
    }
    if not found:
        columns = ", ".join(channel.column for channel in CHANNELS.values())
        raise InputError(f"{where}: no native column and no mapping; native columns: {columns}")
    return {name: found[name] for name in CHANNELS if name in found}


def mapping_file(path: Path) -> Mapping[str, Candidates]:
    """The mapping in a YAML file; InputError if it is not there or is none."""
    if not path.is_file():
        raise InputError(f"mapping: {path}: no such file")
    try:
        content = plain_yaml.load(path)
    except UnreadableYaml as error:
        raise InputError(f"mapping: {path}: {error}") from None
    if not isinstance(content, Mapping) or not all(isinstance(one, Mapping | list) for one in content.values()):
        raise InputError(f"mapping: {path}: must hold lines such as `v_x: {{column: speed, unit: km/h}}`")
    return content


def built(kind: type[Built], given: Built | Mapping[str, Any], where: str) -> Built:
    """`given`, or what its settings construct; InputError for what is neither, or a setting that does not exist."""
    if isinstance(given, kind):
        return given
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: must be settings, {{name: value}}, not {given!r}")
    known = fields(kind)  # pyright: ignore[reportArgumentType]
    strange = [str(name) for name in given if name not in [one.name for one in known]]
    if strange:
        raise unknown("setting", strange[0], [one.name for one in known], where)
    missing = [one.name for one in known if one.default is MISSING and one.name not in given]
    if missing:
        raise InputError(f"{where}: no value for {', '.join(missing)}")
    try:
        return kind(**{str(name): value for name, value in given.items()})
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _table_of(tables: Sequence[Table], source: ChannelSource, name: str) -> Table | None:
    """The first table that has all columns of a source; InputError if they lie on several clocks."""
    whole = next((table for table in tables if all(map(table.has, source.columns))), None)
    if whole is None and all(any(table.has(one) for table in tables) for one in source.columns):
        listed = ", ".join(source.columns)
        raise InputError(f"{tables[0].path}: channel {name}: {listed} are on several clocks and cannot be summed")
    return whole


def _no_column(tables: Sequence[Table], candidates: Iterable[ChannelSource], name: str, where: str) -> InputError:
    """What a file lacks, beside the names that it has: all, or the nearest of many."""
    wanted = [column for one in candidates for column in one.columns if not any(table.has(column) for table in tables)]
    names = [str(column) for table in tables for column in table.columns]
    if not wanted:
        return InputError(f"{where}: channel {name}: no candidate is given")
    if len(names) <= MOST_NAMES:
        return unknown("column", wanted[0], names, where)
    nearest = get_close_matches(wanted[0], names, n=10, cutoff=0.3) or names[:10]
    return InputError(f"{where}: unknown column '{wanted[0]}'; nearest of {len(names)}: {', '.join(nearest)}")
