"""What a calibration leaves behind: a table with a verdict for each parameter, in three forms, and a picture."""

from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.stats import binom

from vehicle_sbi.files import write_text
from vehicle_sbi.inference.calibration import CONSISTENT, JUDGED, LEVELS, Calibration, proportion
from vehicle_sbi.report.figures import POSTERIOR, PRIOR, PRIOR_EDGE, STYLE, key, save
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.symbols import symbol
from vehicle_sbi.report.tables.text import markdown

LEGEND = (
    "hold 50 %, 80 %, 90 %: the share of truths that these central intervals held; in brackets its 95 % binomial "
    "interval.",
    "rank p: p-value of uniform ranks of the truths, by Kolmogorov and Smirnov; small values say shifted or misshapen.",
    "too narrow: 90 % intervals hold clearly fewer truths than 90 %, so stated uncertainties are too small.",
    "too wide: they hold clearly more, so stated uncertainties are larger than they need be.",
    "consistent: the bracket contains 90 %; the fewer recordings, the less that says.",
    "By chance about one in twenty parameters of a calibrated study is called too narrow or too wide.",
)
OF_CLASSIFIER = "rank c2st: how often a classifier tells the ranks from uniform ones; 0.5 is chance."
TABLE = "calibration.csv"
BAND = (0.025, 0.975)  # quantiles of what a calibrated posterior leads to
CURVE = np.linspace(0.02, 0.98, 49)  # nominal levels that are drawn
PER_BIN, MOST_BINS, LEAST_BINS = 10, 20, 4  # recordings in a bin of the histogram, and the number of bins


def table(found: Calibration) -> pd.DataFrame:
    """A row for each parameter: shares that are held with the ends of their binomial intervals, tests and verdict."""
    n = len(found.ranks)
    columns: dict[str, object] = {"name": found.names, "n": n}
    for level in LEVELS:
        held = found.held(level)
        low, high = np.transpose([proportion(int(count), n) for count in held])
        percent = f"{100 * level:.0f}"
        columns |= {f"hold{percent}": held / n, f"low{percent}": low, f"high{percent}": high}
    columns["ks_p"] = found.ks_p
    if found.c2st_ranks is not None:
        columns["c2st_ranks"] = found.c2st_ranks
    return pd.DataFrame({**columns, "verdict": found.verdicts, "uniform": found.uniform})


def for_people(table: pd.DataFrame) -> pd.DataFrame:
    """The table as text, shares in percent with their binomial intervals."""
    shown = {"parameter": table["name"], "recordings": table["n"].astype(str)}
    for level in LEVELS:
        percent = f"{100 * level:.0f}"
        rows = table[[f"hold{percent}", f"low{percent}", f"high{percent}"]].to_numpy()
        shown[f"hold {percent} %"] = [f"{100 * s:.0f} % ({100 * a:.0f} to {100 * b:.0f})" for s, a, b in rows]
    shown["rank p"] = [f"{p:.2g}" for p in table["ks_p"]]
    if "c2st_ranks" in table:
        shown["rank c2st"] = [f"{score:.2f}" for score in table["c2st_ranks"]]
    return pd.DataFrame({**shown, "verdict": table["verdict"]})


def said(table: pd.DataFrame) -> list[str]:
    """The verdict on each parameter, in a line."""
    percent = f"{100 * JUDGED:.0f}"
    return [
        f"{row['name']}: {row['verdict']}; {percent} % intervals hold {row[f'hold{percent}'] * row['n']:.0f} of "
        f"{row['n']} truths." + ("" if row["uniform"] else f" Its ranks are not uniform (p = {row['ks_p']:.2g}).")
        for row in table.to_dict("records")
    ]


def headline(table: pd.DataFrame) -> str:
    """How many parameters are calibrated, and which are not, of how many truths."""
    off = [f"{row['name']} {row['verdict']}" for row in table.to_dict("records") if row["verdict"] != CONSISTENT]
    told = f"; {', '.join(off)}" if off else ""
    return f"{len(table) - len(off)} of {len(table)} parameters consistent with {table['n'].max()} truths{told}."


def page(table: pd.DataFrame, name: str, notes: list[str]) -> str:
    """calibration.md: verdicts, table, what its columns mean, and what else was found."""
    legend = [*LEGEND, *([OF_CLASSIFIER] if "c2st_ranks" in table else [])]
    parts = [said(table), legend, notes]
    verdicts, meanings, remarks = ("\n".join(f"- {line}" for line in lines) + "\n" for lines in parts)
    heads = [f"# Calibration: {name}\n", verdicts, markdown(for_people(table)), "# Legend\n", meanings]
    return "\n".join([*heads, "# Notes\n", remarks, "![Ranks and coverage](calibration.png)\n"])


def report(folder: RunFolder, found: Calibration, name: str) -> None:
    """Write calibration.csv, .md and .png into the run folder, and mark it complete."""
    rows, notes = table(found), [*(found.joint.sentences() if found.joint else ()), *found.notes]
    folder.record(notes=notes)
    write_text(folder.path / TABLE, rows.to_csv(index=False))
    write_text(folder.path / "calibration.md", page(rows, name, notes))
    figure(found, folder.path / "calibration.png")
    folder.complete()


def show(folder: RunFolder) -> None:
    """Print the table of a finished calibration, its verdicts and notes, and the paths of what it wrote."""
    rows = pd.read_csv(folder.path / TABLE)
    print(markdown(for_people(rows)), *said(rows), sep="\n")
    for note in folder.manifest["facts"]["notes"]:
        print(f"  {note}")
    print(f"\n{folder.path}: calibration.md, calibration.csv, calibration.png")


def figure(found: Calibration, path: Path) -> None:
    """For each parameter the histogram of its truths' ranks, and the share that central intervals hold against their
    level; the bands hold 95 % of what calibrated posteriors lead to."""
    with matplotlib.rc_context(STYLE):
        drawn = Figure(figsize=(8.0, 1.6 * len(found.names) + 0.9), layout="constrained")
        axes = drawn.subplots(len(found.names), 2, sharex="col", squeeze=False, width_ratios=(1.7, 1.0))
        for column, (name, (left, right)) in enumerate(zip(found.names, axes, strict=True)):
            _histogram(left, (found.ranks[:, column] + 0.5) / (found.samples + 1))
            _coverage(right, found, column)
            left.set_title(f"{symbol(name)}: {found.verdicts[column]}", loc="left")
        axes[-1, 0].set_xlabel("rank of the truth / draws")
        axes[-1, 1].set_xlabel("level of the interval")
        save(
            drawn,
            path,
            [
                Patch(color=POSTERIOR, alpha=0.5, label="truths"),
                Patch(color=PRIOR, label="95 % of calibrated posteriors"),
                key("exactly calibrated", **PRIOR_EDGE),
            ],
        )


def _histogram(axis: Axes, position: np.ndarray) -> None:
    n = len(position)
    bins = int(np.clip(n // PER_BIN, LEAST_BINS, MOST_BINS))
    low, high = binom.ppf(BAND, n, 1 / bins)
    axis.axhspan(low, high, color=PRIOR, alpha=0.8, linewidth=0)
    axis.axhline(n / bins, **PRIOR_EDGE)
    axis.hist(position, bins=bins, range=(0.0, 1.0), color=POSTERIOR, alpha=0.5)
    axis.set(xlim=(0.0, 1.0), ylabel="truths")


def _coverage(axis: Axes, found: Calibration, column: int) -> None:
    n = len(found.ranks)
    low, high = (binom.ppf(quantile, n, CURVE) / n for quantile in BAND)
    axis.fill_between(CURVE, low, high, color=PRIOR, alpha=0.8, linewidth=0)
    axis.plot([0.0, 1.0], [0.0, 1.0], **PRIOR_EDGE)
    axis.plot(CURVE, [found.held(level)[column] / n for level in CURVE], color=POSTERIOR, linewidth=1.4)
    axis.set(xlim=(0.0, 1.0), ylim=(0.0, 1.02), ylabel="share held")
