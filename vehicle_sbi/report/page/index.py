"""index.html: many runs and diagnoses on one page, a row each, with a link to its report."""

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import pandas as pd

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.calibration import REPEATED
from vehicle_sbi.report import calibration
from vehicle_sbi.report.page.page import templates
from vehicle_sbi.report.page.run import headline
from vehicle_sbi.report.run_folder import FinishedRun, is_finished, read
from vehicle_sbi.report.tables.posterior import read_table
from vehicle_sbi.words import enumerated

DIAGNOSIS, RUN, CALIBRATION = "diagnosis", "run", "calibration"
PAGES = ("report.html", "calibration.md")
COMPLETE, UNFINISHED, BROKEN = "complete", "unfinished", "broken"


@dataclass(frozen=True)
class Row:
    """A run folder as the index shows it: what it found, or why that cannot be read; `report` is where its page is."""

    path: Path
    kind: str
    status: str
    headline: str
    started: str
    report: Path | None

    @classmethod
    def of(cls, path: Path) -> "Row":
        """What a folder says of itself, whatever state it is in."""
        page = next((path / name for name in PAGES if (path / name).exists()), None)
        kind = _kind(path)
        try:
            if not is_finished(path):
                return cls(path, kind, UNFINISHED, "The same command again continues it.", "", page)
            run = read(path)
            started = str(run.manifest.get("started", ""))[:16].replace("T", " ")
            return cls(path, kind, COMPLETE, _headline(run, kind), started, page)
        except (InputError, OSError, ValueError, LookupError, TypeError) as error:
            return cls(path, kind, BROKEN, _reason(error, path), "", page)


def rows(folders: Iterable[Path]) -> list[Row]:
    """A row for every folder that holds a run, at or below those given; InputError where there is none."""
    found = {file.parent.resolve(): None for folder in folders for file in _manifests(folder)}
    return [Row.of(path) for path in sorted(found)]


def write_index(path: Path, found: Sequence[Row], *, title: str = "Runs") -> None:
    """Write the page with links that hold as long as the folders stay where they are to each other."""
    base = Path(os.path.commonpath([row.path.parent for row in found]))
    shown = [
        {
            "name": row.path.relative_to(base).as_posix(),
            "link": _link(row.report, path.parent.resolve()),
            "headline": row.headline,
            "kind": row.kind,
            "status": row.status,
            "started": row.started,
        }
        for row in found
    ]
    template = templates().get_template("index.html.j2")
    write_text(path, template.render(title=title, said=_counted(found), rows=shown))


def _manifests(folder: Path) -> list[Path]:
    if not folder.exists():
        raise InputError(f"{folder}: no such folder")
    found = sorted(folder.rglob("manifest.json"))
    if not found:
        raise InputError(f"{folder}: no run folder here or below (none has a manifest.json)")
    return found


def _kind(path: Path) -> str:
    """A diagnosis keeps its stages, a calibration what it has repeated, a run its rounds alone."""
    if (path / calibration.TABLE).exists() or (path / REPEATED).exists():
        return CALIBRATION
    return DIAGNOSIS if (path / "verdict.json").exists() or (path / "stages").exists() else RUN


def _headline(run: FinishedRun, kind: str) -> str:
    if kind == DIAGNOSIS:
        return str(json.loads(run.file("verdict.json").read_bytes())["headline"])
    if kind == CALIBRATION:
        return calibration.headline(pd.read_csv(run.file(calibration.TABLE)))
    return headline(read_table(run.file("table.csv")))


def _reason(error: Exception, path: Path) -> str:
    """Why a folder cannot be read, in a line without what would be to be done in a run of one's own."""
    said = f"it lacks {error}" if isinstance(error, LookupError) else " ".join(str(error).split(";")[0].split())
    return f"Cannot be read: {said.replace(f'{path}/', '')}."


def _link(report: Path | None, base: Path) -> str:
    return "" if report is None else quote(Path(os.path.relpath(report, base)).as_posix())


def _counted(found: Sequence[Row]) -> str:
    """How many there are, and how many of them are not complete."""
    kinds = [
        f"{count} {kind if count == 1 else plural}"
        for kind, plural in ((DIAGNOSIS, "diagnoses"), (RUN, "runs"), (CALIBRATION, "calibrations"))
        if (count := sum(row.kind == kind for row in found))
    ]
    odd = [
        f"{count} {status}" for status in (UNFINISHED, BROKEN) if (count := sum(row.status == status for row in found))
    ]
    return enumerated(kinds) + (f", of which {enumerated(odd)}" if odd else "") + "."
