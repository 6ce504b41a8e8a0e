"""One table of a fleet: a row for each vehicle, with its parameters, what it lacks, and whether that was proven."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from vehicle_sbi.errors import InputError
from vehicle_sbi.fleet.diagnoses import VERDICT, Outcome
from vehicle_sbi.fleet.vehicles import Member
from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.report.run_folder import read
from vehicle_sbi.report.tables.text import markdown

Json = Mapping[str, Any]


def table(outcomes: Mapping[str, Outcome], members: Sequence[Member], folder: Path) -> pd.DataFrame:
    """Vehicles by name; `NAME`, `NAME_q05` and `NAME_q95` are a parameter with what is missing averaged over."""
    return pd.DataFrame([_row(one, outcomes[one.name], folder / one.name) for one in members])


def _row(member: Member, outcome: Outcome, folder: Path) -> dict[str, object]:
    row: dict[str, object] = {
        "vehicle": member.name,
        "recordings": len(member.recordings),
        "status": " ".join(["answered" if outcome.answered else "failed:", outcome.reason]).strip(),
        "seconds": outcome.seconds,
    }
    if not outcome.answered:
        return row
    try:
        verdict = json.loads(read(folder).file(VERDICT).read_bytes())
    except InputError as error:
        return row | {"status": f"failed: {error}"}
    return row | _found(verdict)


def _found(verdict: Json) -> dict[str, object]:
    named = [name for name, p in verdict["effects"].items() if p > NAMED]
    row: dict[str, object] = {
        "headline": verdict["headline"],
        "missing": ", ".join(named),
        "proven": bool((verdict["fit"] or {}).get("accepted", False)),
        "warnings": len(verdict["warnings"]),
    }
    for name, said in verdict["base_parameters"].items():
        best = said.get("after") or said["before"]
        row |= {name: best["mean"], f"{name}_q05": best.get("q05"), f"{name}_q95": best.get("q95")}
    return row


def shown(found: pd.DataFrame) -> str:
    """The table as Markdown, parameters as mean (q05 to q95)."""
    plain = ["vehicle", "recordings", "status", "seconds", "missing", "proven"]
    text = found[[name for name in plain if name in found]].copy()
    for name in (str(column).removesuffix("_q05") for column in found if str(column).endswith("_q05")):
        bounds = found[[name, f"{name}_q05", f"{name}_q95"]]
        text[name] = ["" if row.isna().any() else _spoken(*row) for _, row in bounds.iterrows()]
    return markdown(text.astype(object).where(text.notna(), "").astype(str))


def _spoken(mean: float, low: float, high: float) -> str:
    return f"{mean:.4g} ({low:.4g} to {high:.4g})"
