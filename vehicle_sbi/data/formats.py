"""Formats of files: CSV, Parquet or Racelogic VBO text turned into a `Table` of named columns, as they stand there.

A file that is not what its suffix says is refused in one line that names the row; what a column means is for `readers`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.errors import InputError, unknown


@dataclass(frozen=True, kw_only=True)
class Table:
    """A file's columns, the name of its usual time column, and the number of its first data row for messages."""

    path: Path
    columns: Mapping[str, Any]
    time: str
    first_row: int

    def has(self, name: str) -> bool:
        return _plain(name) in map(_plain, self.columns)

    def numbers(self, name: str) -> Float[np.ndarray, " rows"]:
        """A column as floats, NaN where empty; trailing blanks and dots of names do not count."""
        found = {_plain(column): column for column in self.columns}.get(_plain(name))
        if found is None:
            raise unknown("column", name, [str(column) for column in self.columns], str(self.path))
        column = pd.Series(self.columns[found])
        if column.dtype.kind == "M":
            raise InputError(f"{self.path}: column '{found}' holds dates; it must hold numbers")
        values = pd.to_numeric(column, errors="coerce")
        wrong = np.flatnonzero(values.isna() & column.notna())
        if len(wrong):
            row = wrong[0]
            raise InputError(
                f"{self.path}: row {row + self.first_row}, column '{found}': '{column.iloc[row]}' is no number"
            )
        numbers = values.to_numpy(dtype=float, na_value=np.nan)
        return np.where(np.isfinite(numbers), numbers, np.nan)


def _plain(name: object) -> str:
    return str(name).strip().rstrip(". ")


def _text(path: Path, encoding: str) -> list[str]:
    """The file's lines without the empty ones at its end; InputError if it is empty, binary or a web page."""
    data = path.read_bytes()
    if b"\0" in data[:65536]:
        raise InputError(f"{path}: is binary, not the text that a {path.suffix} file holds")
    lines = data.decode(encoding, errors="replace").rstrip().splitlines()
    if not lines:
        raise InputError(f"{path}: is empty")
    if lines[0].lstrip().startswith("<"):
        raise InputError(f"{path}: is HTML or XML, not a {path.suffix} file")
    return lines


def _csv(path: Path) -> Table:
    """Text with a header line and one row a line, fields separated by commas, semicolons or tabs."""
    lines = _text(path, "utf-8-sig")
    separator = max(",;\t", key=lines[0].count)
    width = lines[0].count(separator)
    if width == 0:
        raise InputError(f"{path}: row 1: is no CSV, its header has no comma, semicolon or tab: '{lines[0][:40]}'")
    _check_widths(
        path, [(i, line.count(separator) + 1) for i, line in enumerate(lines, 1) if '"' not in line], width + 1
    )
    frame = pd.read_csv(StringIO("\n".join(lines)), sep=separator, skip_blank_lines=False, skipinitialspace=True)
    return Table(path=path, columns={str(name): frame[name] for name in frame}, time="time_s", first_row=2)


def _parquet(path: Path) -> Table:
    """Apache Parquet, through pyarrow; row numbers count from 1."""
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {str(error).splitlines()[0]}") from error
    return Table(path=path, columns={str(name): frame[name] for name in frame}, time="time_s", first_row=1)


def _vbo(path: Path) -> Table:
    """Racelogic VBO: latin-1 text whose [column names] and [data] are separated by blanks; `time` is HHMMSS.sss.

    `time` is turned into seconds since the first row, across midnight too.
    """
    lines = _text(path, "latin-1")
    sections = {line.strip().lower(): i for i, line in enumerate(lines) if line.startswith("[")}
    missing = [name for name in ("[column names]", "[data]") if name not in sections]
    if missing:
        raise InputError(f"{path}: is no VBO file, it has no section {' and no '.join(missing)}")
    names = lines[sections["[column names]"] + 1].split()
    start = sections["[data]"] + 1
    rows = [(i, line.split()) for i, line in enumerate(lines[start:], start + 1) if line.strip()]
    _check_widths(path, [(i, len(row)) for i, row in rows], len(names))
    columns = dict(zip(names, np.array([row for _, row in rows]).reshape(-1, len(names)).T, strict=True))
    table = Table(path=path, columns=columns, time="time", first_row=rows[0][0] if rows else start + 1)
    if not rows:
        return table
    clock = table.numbers("time")
    seconds = clock // 10000 * 3600 + clock // 100 % 100 * 60 + clock % 100
    seconds += 86400.0 * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -43200.0)
    return replace(table, columns={**columns, "time": np.round(seconds - seconds[0], 6)})


def _check_widths(path: Path, widths: Sequence[tuple[int, int]], expected: int) -> None:
    for row, width in widths:
        if width != expected:
            cut = " (is the file truncated?)" if row == widths[-1][0] and width < expected else ""
            raise InputError(f"{path}: row {row} has {width} fields, the header names {expected} columns{cut}")


READERS: Mapping[str, Callable[[Path], Table]] = MappingProxyType(
    {".csv": _csv, ".txt": _csv, ".parquet": _parquet, ".vbo": _vbo}
)
"""What reads a file, by its suffix."""


def read_table(path: Path) -> Table:
    """The file's columns; InputError if there is no such file, or none that its suffix promises."""
    if not path.is_file():
        raise InputError(f"{path}: {'is no file' if path.exists() else 'no such file'}")
    if path.suffix.lower() not in READERS:
        raise InputError(f"{path}: files ending in '{path.suffix}' are not read; those that are: {', '.join(READERS)}")
    return READERS[path.suffix.lower()](path)
