"""Racelogic VBO: latin-1 text whose [column names] and [data] are separated by blanks; `time` is HHMMSS.sss.

[channel units] lists, one a line, the units of the last columns, those after the ones that every VBO has. The units of
velocities and accelerations among the others stand in the long names of [header], line by line: `velocity kmh`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vehicle_sbi.data.formats.dates import across_midnight
from vehicle_sbi.data.formats.lines import check_widths, text_lines
from vehicle_sbi.data.formats.table import Table
from vehicle_sbi.errors import InputError

IN_HEADER = {"kmh": "km/h", "km/h": "km/h", "mph": "mph", "knots": "knot", "g": "g", "deg/s": "deg/s"}


def read(path: Path) -> tuple[Table, ...]:
    """The columns, with `time` turned into seconds since the first row, across midnight too."""
    lines = text_lines(path, "latin-1")
    sections = {line.strip().lower(): i for i, line in enumerate(lines) if line.startswith("[")}
    starts = [i for i, line in enumerate(lines, 1) if line.strip().lower() == "[data]"]
    if len(starts) > 1:
        raise InputError(f"{path}: row {starts[1]}: a second section [data]; it must be a file of its own")
    missing = [name for name in ("[column names]", "[data]") if name not in sections]
    if missing:
        raise InputError(f"{path}: is no VBO file, it has no section {' and no '.join(missing)}")
    names = lines[sections["[column names]"] + 1].split() if sections["[column names]"] + 1 < len(lines) else []
    start = sections["[data]"] + 1
    rows = [(i, line.split()) for i, line in enumerate(lines[start:], start + 1) if line.strip()]
    check_widths(path, [(i, len(row)) for i, row in rows], len(names))
    columns = dict(zip(names, np.array([row for _, row in rows]).reshape(-1, len(names)).T, strict=True))
    table = Table(
        path=path,
        columns=columns,
        time="time",
        first_row=rows[0][0] if rows else start + 1,
        units=_units(lines, sections, names),
    )
    if not rows:
        return (table,)
    clock = table.numbers("time")
    seconds = across_midnight(clock // 10000 * 3600 + clock // 100 % 100 * 60 + clock % 100)
    return (replace(table, columns={**columns, "time": np.round(seconds - seconds[0], 6)}),)


def _units(lines: Sequence[str], sections: Mapping[str, int], names: Sequence[str]) -> dict[str, str]:
    """The units that the file states, by column."""
    long_names = _section(lines, sections, "[header]")
    while long_names and not long_names[-1]:
        long_names.pop()
    found = {}
    for name, long_name in zip(names, long_names, strict=False):
        last = long_name.rsplit(" ", 1)[-1].lower()
        if len(long_names) == len(names) and last in IN_HEADER:
            found[name] = IN_HEADER[last]
    stated = _section(lines, sections, "[channel units]")[:-1]  # a blank line ends the section
    if 0 < len(stated) <= len(names):
        found |= {name: unit for name, unit in zip(names[-len(stated) :], stated, strict=True) if unit}
    return found


def _section(lines: Sequence[str], sections: Mapping[str, int], name: str) -> list[str]:
    """The lines between a section's name and the next section."""
    if name not in sections:
        return []
    start = sections[name] + 1
    stop = min((i for i in sections.values() if i >= start), default=len(lines))
    return [line.strip() for line in lines[start:stop]]
