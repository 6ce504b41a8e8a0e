"""What every format of text shares: its lines, and rows that must be as wide as their header."""

from collections.abc import Sequence
from pathlib import Path

from vehicle_sbi.errors import InputError


def text_lines(path: Path, encoding: str) -> list[str]:
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


def check_widths(path: Path, widths: Sequence[tuple[int, int]], expected: int) -> None:
    """Raise InputError for the first (row, width) that differs from the header's."""
    for row, width in widths:
        if width != expected:
            cut = " (is the file truncated?)" if row == widths[-1][0] and width < expected else ""
            raise InputError(f"{path}: row {row} has {width} fields, the header names {expected} columns{cut}")
