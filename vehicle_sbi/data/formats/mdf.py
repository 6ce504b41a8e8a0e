"""ASAM MDF 4, through `asammdf`: a table a channel group, on the group's own master channel.

A channel keeps its name; where several groups have one of that name it is `Group/Channel`. Channels are read one by
one with `select` when they are asked for: `to_dataframe` would put all groups on the union of their times. Groups of
raw CAN frames are decoded with a database.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from asammdf import MDF

from vehicle_sbi.data.formats.limits import Budget
from vehicle_sbi.data.formats.mdf_blocks import check_blocks
from vehicle_sbi.data.formats.registry import CAN
from vehicle_sbi.data.formats.table import Table, foreign, one_line
from vehicle_sbi.errors import InputError

FRAME = "CAN_DataFrame"
MASTERS = (2, 3)  # channel types of masters and virtual masters
NUMBER = 8  # [bytes] of a time
DEEPEST = 8  # conversions that refer to others
FORMULA = re.compile(
    r"(?>\s+|\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|X1?\b|[-+*/(),]|(?:sin|cos|tan|exp|log|log10|sqrt|abs)\b)*+"
)
"""What a conversion's formula may hold: numbers, X and functions of numexpr."""


class Columns(Mapping[str, Any]):
    """The channels of a group, each read when it is asked for."""

    def __init__(self, path: Path, file: MDF, group: int, channels: Mapping[str, int]) -> None:
        self.path, self.file, self.group, self.channels = path, file, group, channels

    def __getitem__(self, name: str) -> np.ndarray:
        with foreign(self.path, "MDF"):
            signal = self.file.select(
                [(None, self.group, self.channels[name])], ignore_value2text_conversions=True, copy_master=False
            )[0]
        samples = np.asarray(signal.samples)
        if samples.ndim != 1 or samples.dtype.kind not in "biuf":
            raise InputError(f"{self.path}: channel '{name}' holds no numbers")
        invalid = signal.invalidation_bits
        return samples if invalid is None else np.where(np.asarray(invalid, dtype=bool), np.nan, samples)

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)


def read(path: Path, dbc: Path | None) -> tuple[Table, ...]:
    """A table a group that has a clock, or a CAN message; InputError if the file is damaged or holds none."""
    if dbc is not None:
        CAN.check_installed(path)
    with foreign(path, "MDF"):
        check_blocks(path)
        file = _opened(path)
        _check_formulas(path, file)
        _check_sizes(path, file)
        frames = [i for i, group in enumerate(file.groups) if any(one.name == FRAME for one in group.channels)]
        measured = tuple(_groups(path, file, set(frames)))
    if dbc is not None:
        return (*_decoded(path, file, frames, dbc, alone=not measured), *measured)
    if not measured:
        raw = "raw CAN frames only: recording.dbc=FILE.dbc says what they mean" if frames else "no group of numbers"
        raise InputError(f"{path}: holds {raw}")
    return measured


def _opened(path: Path) -> MDF:
    """The file, by its stream where it was closed properly; asammdf completes a copy of others, for which it asks the
    path, and leaves a broken object behind where that fails."""
    stream = path.open("rb")
    if stream.read(5) == b"UnFin":
        stream.close()
        return MDF(path)
    stream.seek(0)
    return MDF(stream)


def _groups(path: Path, file: MDF, frames: set[int]) -> Iterator[Table]:
    """The groups of measured channels that have a master."""
    usual = [i for i in range(len(file.groups)) if i not in frames and file.groups[i].channel_group.cycles_nr]
    often = Counter(one.name for i in usual for one in file.groups[i].channels if one.channel_type not in MASTERS)
    clocks = Counter(_clock(file, i) for i in usual)
    for i in usual:
        channels = file.groups[i].channels
        master = next((k for k, one in enumerate(channels) if one.channel_type in MASTERS), None)
        if master is None:
            continue
        clock = _clock(file, i) if clocks[_clock(file, i)] == 1 else f"Group{i}"
        names = {
            k: one_line(one.name if often[one.name] == 1 else f"{clock}/{one.name}") for k, one in enumerate(channels)
        }
        names[master] = "t"
        yield Table(
            path=path,
            columns=_Timed(path, file, i, {names[k]: k for k, one in enumerate(channels) if _holds_numbers(one)}),
            time="t",
            clock=clock,
            units={"t": "s", **{names[k]: _unit(one) for k, one in enumerate(channels) if k != master}},
        )


class _Timed(Columns):
    """The same with `t`, the group's master [s]."""

    def __getitem__(self, name: str) -> np.ndarray:
        if name != "t":
            return super().__getitem__(name)
        with foreign(self.path, "MDF"):
            return np.asarray(self.file.get_master(self.group), dtype=float)


def _holds_numbers(channel: Any) -> bool:
    """Whether a channel is of whole numbers or floats (data types 0 to 5), or a master."""
    return channel.data_type <= 5 or channel.channel_type in MASTERS


def _unit(channel: Any) -> str:
    """A channel's unit: its own, else that of its conversion, where writers put what a scaled value is in."""
    return channel.unit or getattr(channel.conversion, "unit", "") or ""


def _clock(file: MDF, group: int) -> str:
    """What a group is called: its acquisition's name, else its number."""
    return one_line(getattr(file.groups[group].channel_group, "acq_name", None) or "").strip() or f"Group{group}"


def _check_formulas(path: Path, file: MDF) -> None:
    """Raise InputError for a conversion whose formula is more than arithmetic: libraries would execute it."""
    for group in file.groups:
        for channel in group.channels:
            for formula in _formulas(path, channel.conversion, 0):
                if not FORMULA.fullmatch(formula) or "**" in formula:
                    said = f"has a conversion that is not evaluated: '{one_line(formula[:60])}'"
                    raise InputError(f"{path}: channel '{one_line(channel.name)}' {said}")


def _check_sizes(path: Path, file: MDF) -> None:
    """Raise InputError for groups that state more records than the file can hold: virtual channels need no data."""
    budget = Budget(path)
    for group in file.groups:
        of: Any = group.channel_group
        budget.take(of.cycles_nr * max(of.samples_byte_nr + of.invalidation_bytes_nr, NUMBER))


def _formulas(path: Path, conversion: Any, depth: int) -> Iterator[str]:
    """The formulas of a conversion and of those that it refers to."""
    if conversion is None:
        return
    if depth > DEEPEST:
        raise InputError(f"{path}: conversions refer to each other more than {DEEPEST} times: they are not evaluated")
    formula = getattr(conversion, "formula", "")
    if formula:
        yield str(formula)
    for other in (getattr(conversion, "referenced_blocks", None) or {}).values():
        if not isinstance(other, bytes | str):
            yield from _formulas(path, other, depth + 1)


def _decoded(path: Path, file: MDF, groups: Sequence[int], dbc: Path, *, alone: bool) -> tuple[Table, ...]:
    """The messages in groups of raw frames; `alone`, their time begins with the first frame, else with the file's."""
    from vehicle_sbi.data.formats.can_frames import Frames, decoded  # which measured channels do without

    with foreign(path, "MDF"):
        found = [Frames(**_frames(path, file, i)) for i in groups if file.groups[i].channel_group.cycles_nr]
    if not found:
        raise InputError(f"{path}: a dbc is given, but the file holds no raw CAN frames")
    joined = Frames.joined(found)
    return decoded(path, replace(joined, t=joined.t - (joined.t[0] if alone else 0.0)), dbc)


def _frames(path: Path, file: MDF, group: int) -> dict[str, np.ndarray]:
    """The CAN frames of a group, by the fields of `Frames`."""

    def channel(name: str) -> np.ndarray | None:
        indices = [k for k, one in enumerate(file.groups[group].channels) if one.name == f"{FRAME}.{name}"]
        return np.asarray(file.get(None, group, indices[0], raw=True).samples) if indices else None

    identifiers, data = channel("ID"), channel("DataBytes")
    if identifiers is None or data is None or data.ndim != 2:
        raise InputError(f"{path}: its CAN frames have no ID or no data bytes")
    lengths = channel("DataLength")
    bus = channel("BusChannel")
    return {
        "t": np.asarray(file.get_master(group), dtype=float),
        "identifiers": identifiers.astype(np.int64) & 0x1FFFFFFF,
        "data": data.astype(np.uint8),
        "lengths": np.full(len(identifiers), data.shape[1]) if lengths is None else lengths.astype(np.int64),
        "bus": np.zeros(len(identifiers), dtype=np.int64) if bus is None else bus.astype(np.int64),
    }
