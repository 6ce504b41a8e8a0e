"""Parameter files for other tools from a finished run or diagnosis."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import write_text
from vehicle_sbi.report.export.autoware import autoware
from vehicle_sbi.report.export.commonroad import commonroad
from vehicle_sbi.report.export.exported import Exported
from vehicle_sbi.report.export.openpilot import openpilot
from vehicle_sbi.report.export.plain_json import plain_json
from vehicle_sbi.report.export.reading import read

FORMATS: Mapping[str, Callable[[Exported], dict[str, str]]] = {
    "autoware": autoware,
    "openpilot": openpilot,
    "commonroad": commonroad,
    "json": plain_json,
}
"""What a format makes of what is known: the text of each of its files, by name; empty where nothing identified has a
key in it."""


@dataclass(frozen=True, kw_only=True)
class Written:
    """The files that were written, those that nothing identified has a key in, and what a user of them must know."""

    files: tuple[Path, ...]
    left_out: tuple[str, ...]
    caveats: tuple[str, ...]


def export(run: Path, format: str, to: Path | None = None) -> Written:
    """Write a run's or diagnosis's parameters as files of another tool, into `to` or RUN/export/FORMAT.

    Raises InputError, with nothing written, for an unknown format, a folder without a finished run, and where the
    format has no key for anything that was identified.
    """
    if format not in FORMATS:
        raise unknown("format", format, FORMATS, "export")
    known = read(run)
    texts = FORMATS[format](known)
    written = {name: text for name, text in texts.items() if text}
    if not written:
        found = ", ".join(known.identified)
        raise InputError(f"{run}: {format} has no key for what was identified ({found}); format=json has all of it")
    folder = to or run / "export" / format
    for name, text in written.items():
        write_text(folder / name, text)
    left_out = tuple(name for name in texts if name not in written)
    return Written(files=tuple(folder / name for name in written), left_out=left_out, caveats=known.caveats)
