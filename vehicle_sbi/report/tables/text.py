"""Tables for people: rounded to what the posterior's standard deviation supports, as text, Markdown and HTML."""

import re
from collections.abc import Iterator
from html import escape

import numpy as np
import pandas as pd

from vehicle_sbi.report.tables.posterior import unidentified
from vehicle_sbi.report.tables.symbols import minus
from vehicle_sbi.rounding import mean_and_std, rounded

SCREEN_WIDTH = 110
LONG = 40  # characters of a cell, from which its column is of prose
LEGEND = (
    "bound: Cramér-Rao bound of the standard deviation, which knows no prior: where that helps, a posterior may be "
    "narrower; contraction: 1 − (posterior std / prior std)²."
)


def for_people(table: pd.DataFrame) -> pd.DataFrame:
    """The table in words and rounded numbers; all columns are text, the truth's is left out where none is known."""
    shown = {
        "parameter": table["parameter"],
        "unit": table["unit"],
        "prior": [f"{low:g} to {high:g}" for low, high in zip(table["prior_low"], table["prior_high"], strict=True)],
        "true": [rounded(*pair) for pair in zip(table["true"], table["std"], strict=True)],
        "mean ± std": [mean_and_std(*pair) for pair in zip(table["mean"], table["std"], strict=True)],
        "5 % to 95 %": [
            f"{rounded(low, std)} to {rounded(high, std)}"
            for low, high, std in zip(table["q05"], table["q95"], table["std"], strict=True)
        ],
        "bound": [rounded(bound, bound) for bound in table["bound_std"]],
        **_widened_for_people(table),
        "contraction": [_contraction(value) for value in table["contraction"]],
        "identified": [why or "yes" for why in unidentified(table)],
    }
    people = pd.DataFrame(shown)
    return people.drop(columns="true") if table["true"].isna().all() else people


def _widened_for_people(table: pd.DataFrame) -> dict[str, list[str]]:
    """What plausible effects cost, as factors, where the table has it."""
    heads = {"bound_widened": "bound wider by", "std_over_bound_alone": "std / bound without effects"}
    return {head: [_factor(value) for value in table[key]] for key, head in heads.items() if key in table}


def _factor(value: float) -> str:
    return "" if np.isnan(value) else "∞" if np.isinf(value) else f"{value:.3g}" if value >= 100 else f"{value:.2g}"


def _contraction(value: float) -> str:
    """Two digits, but never a 1.00 that would claim a posterior without width."""
    return "> 0.99" if 0.995 <= value < 1.0 else f"{value + 0.0:.2f}".replace("-0.00", "0.00")


def nominal_for_people(nominal: pd.DataFrame) -> pd.DataFrame:
    """`nominal_table` as text."""
    noise = ["none" if np.isnan(value) else f"{value:.3g}" for value in nominal["noise_percent"]]
    return pd.DataFrame(
        {
            "quantity": nominal["quantity"],
            "unit": nominal["unit"],
            "nominal": [f"{value:g}" for value in nominal["nominal"]],
            "noise, mean and std [%]": noise,
        }
    )


def terminal(table: pd.DataFrame) -> str:
    """The table as text of at most `SCREEN_WIDTH` columns; prior, then interval give way where names are long."""
    people = for_people(table)
    people = people.drop(columns="identified")
    people["parameter"] += [f" [{unit}]" if unit != "1" else "" for unit in people.pop("unit")]
    lines = aligned(people)
    for column in ("prior", "5 % to 95 %", "contraction"):
        if max(map(len, lines)) > SCREEN_WIDTH:
            people = people.drop(columns=column)
            lines = aligned(people)
    rule = "─" * max(map(len, lines))
    body = [text for line, why in zip(lines[1:], unidentified(table), strict=True) for text in _with_remark(line, why)]
    return "\n".join([lines[0], rule, *body])


def _with_remark(line: str, remark: str) -> Iterator[str]:
    yield line
    if remark:
        yield f"  {remark}"


def aligned(people: pd.DataFrame) -> list[str]:
    """Header and rows with the first column to the left, the others to the right, two blanks between."""
    cells = [list(map(str, people.columns)), *people.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in cells]


def markdown(frame: pd.DataFrame) -> str:
    """A frame of text as a Markdown table."""
    rows = [list(map(str, frame.columns)), ["---"] * frame.shape[1], *frame.astype(str).to_numpy().tolist()]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows) + "\n"


def html(frame: pd.DataFrame) -> str:
    """A frame of text as an HTML table: escaped, with minus signs, and with powers (1e5 N, m^2) raised; columns that
    are mostly numbers have the class `number`, those with long text the class `prose`."""
    classes = [_class(frame[column].astype(str)) for column in frame]
    rows = [("th", [*frame.columns]), *(("td", row) for row in frame.astype(str).to_numpy().tolist())]
    lines = ["".join(map(_cell, row, [tag] * len(row), classes)) for tag, row in rows]
    return "<table>\n" + "\n".join(f"<tr>{line}</tr>" for line in lines) + "\n</table>"


def _class(column: pd.Series) -> str:
    if column.str.match(r"[+-]?\d(?!e\d)").mean() > 0.5:
        return "number"
    return "prose" if (column.str.len() > LONG).any() else ""


def _cell(text: str, tag: str, kind: str) -> str:
    """A cell of an HTML table, escaped, with minus signs and powers as such."""
    raised = re.sub(r"^1e(\d+)", r"10^\1", minus(text))
    shown = re.sub(r"\^(-?\d+)", r"<sup>\1</sup>", escape(raised))
    return f'<{tag} class="{kind}">{shown}</{tag}>' if kind else f"<{tag}>{shown}</{tag}>"
