"""Text with a header line: CSV, and what data loggers write as CSV.

A native file is a header and numbers. Loggers (MoTeC i2, AiM Race Studio) put a preamble of `name, value` lines before
the header and a row of units after it; the numbers then begin at the first of two rows that are equally wide and hold
mostly numbers, the nearest row of that width above is the header, or the units if another one stands above it.
"""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import islice, pairwise
from pathlib import Path

import pandas as pd

from vehicle_sbi.data.formats.dates import seconds
from vehicle_sbi.data.formats.lines import check_widths, text_lines
from vehicle_sbi.data.formats.table import Table, foreign
from vehicle_sbi.data.units import in_brackets, known_unit, without_brackets
from vehicle_sbi.errors import InputError
from vehicle_sbi.words import enumerated

LONGEST_PREAMBLE = 500
"""Lines among which the first numbers are sought."""

FIRST_ROWS = 100
"""Rows of numbers that say which decimal mark they have."""

EMPTY = ("-", "--", "---")
"""What loggers write where they have no number, beside what pandas takes for that."""

TIMES = (
    "time_s", "time", "t", "timestamp", "elapsed time", "elapsed", "datetime", "zeit", "zeitstempel", "messzeit",
    "uhrzeit",
)  # fmt: skip
"""Names of the time column, the first that a file has, whatever their case."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where a text's parts lie: names and units of its columns, and the index of its first line of numbers."""

    separator: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    start: int


def read(path: Path) -> tuple[Table, ...]:
    """Rows of fields between commas, semicolons or tabs, below a header; InputError names the row that is wrong."""
    lines = text_lines(path, "utf-8-sig")
    layout = _logger(lines) or _plain(path, lines)
    names = _distinct(layout.names)
    rows = lines[layout.start :]
    check_widths(path, _widths(rows, layout), len(names))
    frame = _numbers(path, rows, names, layout.separator) if rows else pd.DataFrame(columns=names)
    columns = {str(name): frame[name] for name in frame}
    units = _units(names, layout.units)
    notes, first_row = _repeated(path, layout.names), layout.start + 1
    return (Table(path=path, columns=columns, time=_time(columns), first_row=first_row, units=units, notes=notes),)


def _numbers(path: Path, rows: Sequence[str], names: Sequence[str], separator: str) -> pd.DataFrame:
    """The rows as columns."""
    decimal = "," if separator != "," and _has_decimal_commas(rows[:FIRST_ROWS], separator) else "."
    text, columns = StringIO("\n".join(rows)), list(names)
    with foreign(path, "CSV"):
        return pd.read_csv(
            text, sep=separator, names=columns, header=None, index_col=False,
            skip_blank_lines=False, skipinitialspace=True, decimal=decimal, na_values=EMPTY,
        )  # fmt: skip


def _has_decimal_commas(rows: Sequence[str], separator: str) -> bool:
    """Whether numbers have commas and none has a point; dates, remarks and versions are no numbers."""
    numbers = [field for row in rows for field in _fields(row, separator) if _is_number(field)]
    return any("," in field for field in numbers) and not any("." in field for field in numbers)


def _units(names: Sequence[str], units: Sequence[str]) -> dict[str, str]:
    """The units by column: those of the row of units, or those in brackets at the end of a name."""
    named = {name: unit for name in names if (unit := in_brackets(name))}
    return named | {name: unit for name, unit in zip(names, units, strict=False) if unit}


def _plain(path: Path, lines: Sequence[str]) -> Layout:
    """A header in the first line and numbers below it."""
    separator = _separator(lines[0])
    names = _fields(lines[0], separator)
    if len(names) == 1:
        raise InputError(f"{path}: row 1: is no CSV, its header has no comma, semicolon or tab: '{lines[0][:40]}'")
    return Layout(separator=separator, names=tuple(names), units=(), start=1)


def _logger(lines: Sequence[str]) -> Layout | None:
    """The layout of a text with a preamble or a row of units; None if numbers follow its first line, or never do."""
    separator = _separator(max(islice(lines, LONGEST_PREAMBLE), key=lambda line: len(_fields(line, _separator(line)))))
    rows = [_fields(line, separator) for line in islice(lines, LONGEST_PREAMBLE)]
    start = _first_numbers(rows)
    if start is None or start == 1:
        return None
    width = len(rows[start])
    above = [i for i in range(start) if len(rows[i]) == width and any(rows[i])][-2:]
    if not above:
        return None
    has_units = len(above) == 2 and _are_units(rows[above[1]]) and not _are_units(rows[above[0]])
    names = rows[above[0]] if has_units else rows[above[-1]]
    if _are_numbers(names):  # a row of another width between numbers, which is named when widths are checked
        return None
    units = tuple(rows[above[1]]) if has_units else ()
    return Layout(separator=separator, names=tuple(names), units=units, start=start)


def _first_numbers(rows: Sequence[list[str]]) -> int | None:
    """The first of two rows that are equally wide and hold mostly numbers, blank rows between them left out."""
    filled = [i for i, row in enumerate(rows) if any(row)]
    for i, following in pairwise(filled):
        if len(rows[i]) == len(rows[following]) > 1 and _are_numbers(rows[i]) and _are_numbers(rows[following]):
            return i
    return None


def _are_numbers(row: Sequence[str]) -> bool:
    return 2 * sum(map(_is_number, row)) > sum(map(bool, row))


def _are_units(row: Sequence[str]) -> bool:
    """Whether a row is one of units: of time in its first field, or known ones in half of those that are filled."""
    filled = [field for field in row if field]
    first = known_unit(filled[0]) if filled else None
    known = sum(known_unit(field) is not None for field in filled)
    return bool(filled) and ((first is not None and first[0] == "s") or 2 * known >= len(filled))


def _is_number(field: str) -> bool:
    try:
        float(field.replace(",", "."))
    except ValueError:
        return False
    return True


def _separator(line: str) -> str:
    """The sign that separates most fields; where others separate too, a comma between digits is a decimal mark."""
    return max(",;\t", key=re.sub(r"(?<=\d),(?=\d)", "", line).count)


def _fields(line: str, separator: str) -> list[str]:
    try:
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), []) if '"' in line else None
    except csv.Error:  # a field longer than 128 KiB, which is no number
        fields = None
    return [field.strip() for field in (line.split(separator) if fields is None else fields)]


def _widths(rows: Sequence[str], layout: Layout) -> list[tuple[int, int]]:
    """The number and the fields of each row; separators between quotes separate nothing."""
    separator = layout.separator
    return [
        (i, len(_fields(line, separator)) if '"' in line else line.count(separator) + 1)
        for i, line in enumerate(rows, layout.start + 1)
    ]


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of which none comes twice: the second `x` is called `x (2)`."""
    counts: dict[str, int] = {}
    distinct = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        distinct.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return distinct


def _repeated(path: Path, names: Sequence[str]) -> tuple[str, ...]:
    """A note of the names that come more than once, if any do."""
    twice = [name for name, count in Counter(names).items() if name and count > 1]
    return (
        (f"{path}: {enumerated(twice)} comes twice; of a name the second column is called 'NAME (2)'",) if twice else ()
    )


def _time(columns: Mapping[str, pd.Series]) -> str:
    """The column of time: the first usual name that is there, else the first of dates, and `time_s` if none is."""
    lower = {without_brackets(name).strip().lower(): name for name in reversed(list(columns))}
    named = (lower[name] for name in TIMES if name in lower)
    dated = (name for name, column in columns.items() if seconds(column.dropna().head(1)) is not None)
    return next(itertools.chain(named, dated), "time_s")
