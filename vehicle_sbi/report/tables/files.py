"""The tables of a run's folder: CSV in full precision, Markdown and LaTeX for people."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from vehicle_sbi.files import write_text
from vehicle_sbi.report.tables.posterior import NOT_IDENTIFIED, NOT_LEARNED, unidentified
from vehicle_sbi.report.tables.symbols import minus, symbol, unit_symbol
from vehicle_sbi.report.tables.text import LEGEND, for_people, markdown, nominal_for_people
from vehicle_sbi.rounding import rounded

MARKS = {NOT_IDENTIFIED: r"$^\dagger$", NOT_LEARNED: r"$^\ddagger$"}  # in LaTeX


def write_tables(folder: Path, table: pd.DataFrame, nominal: pd.DataFrame, notes: Sequence[str] = ()) -> None:
    """Write table.csv (posterior, full precision), table.md and table.tex (posterior, nominal values and notes)."""
    write_text(folder / "table.csv", table.to_csv(index=False))
    parts = [
        "# Posterior\n", markdown(for_people(table)),
        LEGEND + "\n",
        "# Nominal values and process noise\n", markdown(nominal_for_people(nominal)),
    ]  # fmt: skip
    remarks = ["# Notes\n", "\n".join(f"- {note}" for note in notes) + "\n"] if notes else []
    write_text(folder / "table.md", "\n".join(parts + remarks))
    write_text(folder / "table.tex", _tex(table, nominal, notes))


def _tex(table: pd.DataFrame, nominal: pd.DataFrame, notes: Sequence[str]) -> str:
    """Two booktabs tables with the parameters as columns, as the paper's Tables I and II."""
    people = for_people(table)
    why = unidentified(table)
    rows = {"Unit": [unit_symbol(unit) for unit in table["unit"]]}
    if "true" in people:
        rows["True"] = list(people["true"])
    rows["Mean"] = [rounded(*pair) for pair in zip(table["mean"], table["std"], strict=True)]
    rows["Std"] = [rounded(std, std) for std in table["std"]]
    rows["Bound"] = [text.replace("∞", r"$\infty$") for text in people["bound"]]
    rows["Contraction"] = [text.replace(">", "$>$") for text in people["contraction"]]
    rows["Prior"] = [f"{low:g}, {high:g}" for low, high in zip(table["prior_low"], table["prior_high"], strict=True)]
    rows["Identified"] = [f"no{MARKS[one]}" if one else "yes" for one in why]
    posterior = _tabular([symbol(name) for name in table["parameter"]], rows)
    remarks = [f"{mark} {said}." for said, mark in MARKS.items() if said in why]
    shown = nominal_for_people(nominal)
    first = _tabular(
        [symbol(name) for name in nominal["quantity"]],
        {
            "Unit": [unit_symbol(unit) for unit in nominal["unit"]],
            "Nominal": list(shown["nominal"]),
            r"Noise mean, std [\%]": list(shown["noise, mean and std [%]"]),
        },
    )
    comments = "".join(f"% {' '.join(note.split())}\n" for note in notes)
    lines = ["% needs \\usepackage{booktabs}", comments + first, posterior, *remarks]
    return "\n\n".join(lines) + "\n"


def _tabular(head: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    cells = [[minus(cell, "$-$") for cell in row] for row in rows.values()]
    frame = pd.DataFrame(cells, index=list(rows), columns=list(head))
    return frame.style.to_latex(hrules=True, column_format=f"l{'r' * len(head)}").rstrip()
