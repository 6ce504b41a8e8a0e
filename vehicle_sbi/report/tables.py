"""The numbers of a run: posterior beside prior and bound, as CSV, Markdown, LaTeX and text, and many runs in one table.

A parameter counts as identified when the recording both could have told (its Cramér-Rao bound is below the prior's
standard deviation) and did tell (the posterior is narrower than the prior). Files keep full precision; whatever is
shown to a person is rounded to what the posterior's standard deviation supports.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.report.run_folder import FinishedRun, is_finished, read
from vehicle_sbi.rounding import mean_and_std, rounded

COLUMNS = (
    "parameter", "unit", "prior_low", "prior_high", "true", "mean", "std", "q05", "q50", "q95",
    "bound_std", "contraction", "identified",
)  # fmt: skip
WIDENED = ("bound_std_alone", "bound_widened", "std_over_bound_alone")  # with plausible effects free
NOT_IDENTIFIED = "not identified by this recording"
NOT_LEARNED = "not learned by this run"  # though the recording tells it
LEARNABLE = 0.1  # of the prior's width, a bound below which a parameter ought to have been identified
# 1 - (posterior std / prior std)^2 from which the posterior is no longer just the prior: std below 0.87 of the prior's.
# The contraction of an untouched uniform prior scatters by 0.03 over 1000 samples, so chance does not reach it, and an
# estimator that is merely a little too narrow does not either.
IDENTIFIED_CONTRACTION = 0.25
MARKS = {NOT_IDENTIFIED: r"$^\dagger$", NOT_LEARNED: r"$^\ddagger$"}  # in LaTeX
EDGE = 0.05  # of the prior's width, within which a median counts as lying on its edge
CERTAIN = 2.0  # standard deviations off its null, from which a size that cannot cross it is something
SCREEN_WIDTH = 110
LEGEND = (
    "bound: Cramér-Rao bound of the standard deviation, which knows no prior: where that helps, a posterior may be "
    "narrower; contraction: 1 − (posterior std / prior std)²."
)

_GREEK = ("alpha", "beta", "gamma", "delta", "kappa", "lambda", "mu", "omega", "psi", "rho", "sigma", "tau", "zeta")


def on_edge(value: float, low: float, high: float, null: float | None) -> bool:
    """Whether a posterior's middle lies on an edge of a prior from low to high that could be wider.

    A bound at `null`, where an effect vanishes, could not: there is no negative delay.
    """
    margin = EDGE * (high - low)
    return (value - low < margin and low != null) or (high - value < margin and high != null)


def maybe_none(mean: float, std: float, low: float, high: float, null: float | None) -> bool:
    """Whether a size that has one side of its null alone may as well be nothing."""
    return null is not None and null in (low, high) and abs(mean - null) < CERTAIN * std


def posterior_table(
    space: ParameterSpace,
    samples: Float[np.ndarray, "n d"],
    *,
    true: Float[np.ndarray, " d"] | None = None,
    bound_std: Float[np.ndarray, " d"],
    bound_std_alone: Float[np.ndarray, " d"] | None = None,
) -> pd.DataFrame:
    """One row per parameter, `COLUMNS`; a truth that is not known is NaN, a bound where nothing is knowable inf.

    A bound that was not computed is NaN; contraction alone then decides what is identified. With the bound of a model
    without plausible effects, `bound_std_alone`, there are columns `WIDENED` too.
    """
    q05, q50, q95 = np.quantile(samples, (0.05, 0.5, 0.95), axis=0)
    std = samples.std(axis=0, ddof=1)
    contraction = 1.0 - (std / space.prior_std) ** 2
    columns = {
        "parameter": space.names,
        "unit": [p.unit for p in space.parameters],
        "prior_low": space.low,
        "prior_high": space.high,
        "true": np.full(len(space), np.nan) if true is None else np.asarray(true, dtype=float),
        "mean": samples.mean(axis=0),
        "std": std,
        "q05": q05,
        "q50": q50,
        "q95": q95,
        "bound_std": np.asarray(bound_std, dtype=float),
        "contraction": contraction,
        "identified": (contraction >= IDENTIFIED_CONTRACTION) & ~(bound_std >= space.prior_std),
    }
    table = pd.DataFrame(columns, columns=list(COLUMNS))
    return table if bound_std_alone is None else table.assign(**_widened(table, bound_std_alone))


def unidentified(table: pd.DataFrame) -> list[str]:
    """Why each parameter is not identified: the recording does not tell it, or the run has not learned it; empty where
    it is."""
    return [_why_not(row) for row in table.to_dict("records")]


def _why_not(row: Mapping) -> str:
    if row["identified"]:
        return ""
    learnable = row["bound_std"] < LEARNABLE * (row["prior_high"] - row["prior_low"])
    return NOT_LEARNED if learnable else NOT_IDENTIFIED


def _widened(table: pd.DataFrame, alone: Float[np.ndarray, " d"]) -> dict[str, np.ndarray]:
    """`WIDENED`: by which factor plausible effects widen the bound, and the posterior over the bound without them; NaN
    where the recording tells nothing even without them."""
    finite = np.where(np.isfinite(alone), alone, np.nan)
    return dict(zip(WIDENED, (alone, table["bound_std"] / finite, table["std"] / finite), strict=True))


def nominal_table(
    space: ParameterSpace, nominal: np.void | Mapping[str, float], *, noise_percent: Mapping[str, float]
) -> pd.DataFrame:
    """The paper's Table I: for every physical quantity that `space` sets its nominal value and process noise [%].

    A value has its parameter's unit (a stiffness of 1e5 N reads 1.0 in units of 1e5 N); `noise_percent` is by quantity,
    and a quantity it does not name has none.
    """
    rows = [
        (name, p.unit, float(nominal[name]) / (p.scale if p.relative else 1.0), noise_percent.get(name, np.nan))
        for p in space.parameters
        for name in p.fields
    ]
    return pd.DataFrame(rows, columns=["quantity", "unit", "nominal", "noise_percent"])


def symbol(name: str) -> str:
    r"""A parameter as mathematics where its name is a symbol (C_alpha_f: $C_{\alpha f}$), else in words.

    The result is valid mathtext and LaTeX. A leading `delta_` or `d` before a capital is an offset's Delta.
    """
    offset = re.match(r"(?:[dD]elta_|d)(?=[A-Z](?:_|$))", name)
    head, *below = name[offset.end() if offset else 0 :].split("_")
    if "." in name or (len(head) > 1 and head not in _GREEK):
        return name.replace(".", ": ").replace("_", " ")
    subscript = " ".join(_greek(part) if len(part) == 1 or part in _GREEK else rf"\mathrm{{{part}}}" for part in below)
    base = ("\\Delta " if offset else "") + _greek(head)
    return f"${base}_{{{subscript}}}$" if below else f"${base}$"


def _greek(word: str) -> str:
    return f"\\{word}" if word in _GREEK else word


def unit_symbol(unit: str) -> str:
    """A unit as mathtext and LaTeX, powers raised: "1e5 N/rad" is $10^5$ N/rad; "" for a pure number."""
    raised = re.sub(r"^1e(\d+)", r"$10^{\1}$", unit)
    return "" if unit == "1" else re.sub(r"\^(-?\d)", r"$^{\1}$", raised)


def minus(text: str, sign: str = "−") -> str:
    """The text with the hyphens before its numbers as minus signs; those in names and exponents stay."""
    return re.sub(r"(?<![\w.])-(?=[\d∞.])", lambda _: sign, text)


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


def terminal(table: pd.DataFrame) -> str:
    """The table as text of at most `SCREEN_WIDTH` columns; prior, then interval give way where names are long."""
    people = for_people(table)
    people = people.drop(columns="identified")
    people["parameter"] += [f" [{unit}]" if unit != "1" else "" for unit in people.pop("unit")]
    lines = _aligned(people)
    for column in ("prior", "5 % to 95 %", "contraction"):
        if max(map(len, lines)) > SCREEN_WIDTH:
            people = people.drop(columns=column)
            lines = _aligned(people)
    rule = "─" * max(map(len, lines))
    body = [text for line, why in zip(lines[1:], unidentified(table), strict=True) for text in _with_remark(line, why)]
    return "\n".join([lines[0], rule, *body])


def _with_remark(line: str, remark: str) -> Iterator[str]:
    yield line
    if remark:
        yield f"  {remark}"


def _aligned(people: pd.DataFrame) -> list[str]:
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
    are mostly numbers have the class `number`."""
    of_numbers = [bool(frame[column].astype(str).str.match(r"[+-]?\d(?!e\d)").mean() > 0.5) for column in frame]
    rows = [("th", [*frame.columns]), *(("td", row) for row in frame.astype(str).to_numpy().tolist())]
    lines = ["".join(map(_cell, row, [tag] * len(row), of_numbers)) for tag, row in rows]
    return "<table>\n" + "\n".join(f"<tr>{line}</tr>" for line in lines) + "\n</table>"


def _cell(text: str, tag: str, number: bool) -> str:
    """A cell of an HTML table, escaped, with minus signs and powers as such."""
    raised = re.sub(r"^1e(\d+)", r"10^\1", minus(text))
    shown = re.sub(r"\^(-?\d+)", r"<sup>\1</sup>", escape(raised))
    return f'<{tag} class="number">{shown}</{tag}>' if number else f"<{tag}>{shown}</{tag}>"


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


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """Many runs in one: `runs` has one row per run and parameter, `seeds` one per study and parameter.

    A study is all runs whose configuration differs in nothing but the seed; `left_out` lists runs not finished.
    """

    runs: pd.DataFrame
    seeds: pd.DataFrame
    left_out: tuple[Path, ...]

    def markdown(self) -> str:
        """Both tables for people, as the paper's Table II: a row per run and a column per parameter."""
        heading = ["run", "study", "estimator", "features", "seed"]
        rows = []
        for _, table in self.runs.groupby("run", sort=False):
            names = [f"{p} [{unit}]" for p, unit in zip(table["parameter"], table["unit"], strict=True)]
            rows.append({**table.iloc[0][heading].to_dict(), **dict(zip(names, _cells(table), strict=True))})
        parts = [
            "# Runs: posterior mean ± std (bound)\n", markdown(pd.DataFrame(rows).fillna("")),
            "# Over seeds\n", markdown(_seeds_for_people(self.seeds)),
        ]  # fmt: skip
        if self.left_out:
            parts += ["Not finished, left out:\n", *(f"- {path}" for path in self.left_out), ""]
        return "\n".join(parts)

    def write(self, folder: Path) -> None:
        """Write runs.csv, seeds.csv (full precision) and runs.md."""
        write_text(folder / "runs.csv", self.runs.to_csv(index=False))
        write_text(folder / "seeds.csv", self.seeds.to_csv(index=False))
        write_text(folder / "runs.md", self.markdown())


def _cells(table: pd.DataFrame) -> Iterator[str]:
    for mean, std, bound, identified in table[["mean", "std", "bound_std", "identified"]].to_numpy():
        yield f"{mean_and_std(mean, std)} ({rounded(bound, bound)}){'' if identified else ', not identified'}"


def _seeds_for_people(seeds: pd.DataFrame) -> pd.DataFrame:
    covered = [
        f"{row.covered} of {row.known}" if row.known else "truth not known" for row in seeds.itertuples(index=False)
    ]
    return pd.DataFrame(
        {
            "study": seeds["study"],
            "parameter": [f"{p} [{unit}]" for p, unit in zip(seeds["parameter"], seeds["unit"], strict=True)],
            "runs": seeds["runs"],
            "mean std": [rounded(std, std) for std in seeds["mean_std"]],
            "mean bound": [rounded(bound, bound) for bound in seeds["mean_bound"]],
            "std / bound": ["" if np.isnan(ratio) else f"{ratio:.2f}" for ratio in seeds["std_over_bound"]],
            "90 % interval holds the truth": covered,
            "identified": [f"{row.identified} of {row.runs}" for row in seeds.itertuples(index=False)],
        }
    )


def gather(paths: Iterable[Path]) -> Gathered:
    """One table of all run folders at or below `paths`; raises InputError if there is no finished run among them."""
    folders = list(dict.fromkeys(folder for path in paths for folder in _run_folders(path)))
    finished = {folder: is_finished(folder) for folder in folders}
    runs = [read(folder) for folder in folders if finished[folder]]
    if not runs:
        raise InputError(f"none of these runs has finished: {', '.join(map(str, folders))}")
    base = Path(os.path.commonpath([run.path for run in runs]))
    table = pd.concat([_run_table(run, base if len(runs) > 1 else run.path.parent) for run in runs], ignore_index=True)
    table = table.sort_values(["study", "seed", "run"], kind="stable", ignore_index=True)
    left_out = tuple(folder for folder in folders if not finished[folder])
    return Gathered(runs=table, seeds=_over_seeds(table), left_out=left_out)


def _run_folders(path: Path) -> list[Path]:
    """`path` if it is a run folder, else all run folders below it (a Hydra sweep's, say)."""
    if not path.exists():
        raise InputError(f"{path}: no such folder")
    found = sorted(file.parent.resolve() for file in path.rglob("manifest.json"))
    if not found:
        raise InputError(f"{path}: no run folder here or below (none has a manifest.json)")
    return found


def read_table(file: Path) -> pd.DataFrame:
    """The table.csv of a finished run; InputError if it is missing or none."""
    try:
        table = pd.read_csv(file)
    except FileNotFoundError:
        raise InputError(f"{file}: missing, though the run has finished") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError):
        raise InputError(f"{file}: not a table of comma-separated values") from None
    missing = [column for column in COLUMNS if column not in table]
    if missing:
        raise InputError(f"{file}: column {', '.join(missing)} missing; a run's table has {', '.join(COLUMNS)}")
    return table[list(COLUMNS)]


def _run_table(run: FinishedRun, base: Path) -> pd.DataFrame:
    table = read_table(run.file("table.csv"))
    # The seed and the folder say which run of a study it is, not which study.
    study = " ".join(sorted(o for o in run.overrides if not o.lstrip("+~").startswith(("seed=", "hydra."))))
    about = {
        "run": str(run.path.relative_to(base)),
        "study": study or "defaults",
        "estimator": run.choice("estimator"),
        "features": run.choice("features"),
        "seed": run.seed,
        "study_sha256": run.study,
    }
    for column, (name, value) in enumerate(about.items()):
        table.insert(column, name, value)
    return table


def _over_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Per study and parameter: number of runs, mean std, its ratio to the mean bound, runs that hold the truth."""
    known = runs["true"].notna()
    runs = runs.assign(known=known, covered=known & runs["true"].between(runs["q05"], runs["q95"]))
    seeds = (
        runs.groupby(["study_sha256", "study", "parameter", "unit"], sort=False)
        .agg(
            runs=("run", "size"),
            mean_std=("std", "mean"),
            mean_bound=("bound_std", "mean"),
            known=("known", "sum"),
            covered=("covered", "sum"),
            identified=("identified", "sum"),
        )
        .reset_index()
        .drop(columns="study_sha256")
    )
    seeds["std_over_bound"] = (seeds["mean_std"] / seeds["mean_bound"]).where(np.isfinite(seeds["mean_bound"]))
    seeds["coverage90"] = (seeds["covered"] / seeds["known"]).where(seeds["known"] > 0)
    return seeds
