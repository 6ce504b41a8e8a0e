"""What every format of text shares: its lines, and rows that must be as wide as their header."""

import codecs
from collections.abc import Sequence
from pathlib import Path

from vehicle_sbi.errors import InputError

WINDOWS = "cp1252"  # of western Windows, in which Latin-1 reads alike
UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE  # what a text of two bytes a letter begins with


def text_lines(path: Path, encoding: str) -> list[str]:
    """The file's lines without the empty ones at its end; InputError if it is empty, binary or a web page.

    What the encoding does not hold is read as that of Windows.
    """
    data = path.read_bytes()
    if data.startswith(UTF_16):
        data = data.decode("utf-16", errors="replace").encode()
    if b"\0" in data[:65536]:
        raise InputError(f"{path}: is binary, not the text that a {path.suffix} file holds")
    lines = _decoded(data, encoding).rstrip().splitlines()
    if not lines:
        raise InputError(f"{path}: is empty")
    if lines[0].lstrip().startswith("<"):
        raise InputError(f"{path}: is HTML or XML, not a {path.suffix} file")
    return lines


def _decoded(data: bytes, encoding: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        return data.decode(WINDOWS, errors="replace")


def check_widths(path: Path, widths: Sequence[tuple[int, int]], expected: int) -> None:
    """Raise InputError for the first (row, width) that differs from the header's."""
    for row, width in widths:
        if width != expected:
            cut = " (is the file truncated?)" if row == widths[-1][0] and width < expected else ""
            raise InputError(f"{path}: row {row} has {width} fields, the header names {expected} columns{cut}")
