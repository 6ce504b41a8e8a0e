"""The benchmark's page from a row per case: its table with 90 % intervals, simpler methods, each effect's misses.

Intervals: Clopper and Pearson (1934) for shares of yes and no, percentile bootstrap for everything else.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta

from concealed.scores import INTERVAL, NO_VERDICT
from vehicle_sbi.report.tables.text import markdown

LEVELS = ("L0", "L1", "L2")
EFFICIENT = math.sqrt(2.0 / math.pi)  # mean absolute error of a size, in its standard deviations, of which it is SNR
ABOUT = 1.0 / math.sqrt(2.0)  # of a signal-to-noise ratio that is drawn, from which cases are nearest to it
TELLING = 0.9  # of its answers right, from which recordings tell the observer what is missing
Middle = Callable[..., Any]  # np.mean or np.median


def interval(values: Sequence[float], middle: Middle = np.mean) -> tuple[float, float]:
    """90 % interval of the mean or median: Clopper and Pearson's for shares, else a percentile bootstrap."""
    n, hits, outside = len(values), float(np.sum(values)), (1 - INTERVAL) / 2
    if middle is np.mean and set(values) <= {0.0, 1.0}:
        low = float(beta.ppf(outside, hits, n - hits + 1)) if hits else 0.0
        return low, float(beta.ppf(1 - outside, hits + 1, n - hits)) if hits < n else 1.0
    drawn = middle(np.random.default_rng(0).choice(np.asarray(values), (2000, n)), axis=1)
    return float(np.quantile(drawn, outside)), float(np.quantile(drawn, 1 - outside))


def shown(values: Sequence[float], middle: Middle = np.mean) -> str:
    """Mean or median, interval and number, as `0.86 (0.79 to 0.91; 52)`."""
    kept = [float(v) for v in values if v is not None and math.isfinite(v)]
    if not kept:
        return ""
    low, high = interval(kept, middle)
    digits = 2 if max(abs(low), abs(high)) < 10 else 1
    return f"{middle(kept):.{digits}f} ({low:.{digits}f} to {high:.{digits}f}; {len(kept)})"


def calibration_error(table: pd.DataFrame, bins: int = 10) -> float:
    """Mean distance between stated probability and share of correct answers, over bins of the likeliest answer's."""
    if table.empty:
        return math.nan
    which = np.minimum((table["probability"].to_numpy(float) * bins).astype(int), bins - 1)
    gap = table["probability"].to_numpy(float) - table["correct"].to_numpy(float)
    return float(sum(abs(gap[which == b].sum()) for b in range(bins)) / len(table))


def calibrated(table: pd.DataFrame, draws: int = 300) -> float:
    """The error that chance alone leaves where stated probabilities are right: never 0, with so many cases a bin."""
    rng, stated = np.random.default_rng(0), table["probability"].to_numpy(float) if len(table) else np.zeros(0)
    drawn = [table.assign(correct=rng.uniform(size=len(stated)) < stated) for _ in range(draws if len(table) else 0)]
    return float(np.mean([calibration_error(one) for one in drawn])) if drawn else math.nan


@dataclass(frozen=True)
class Metric:
    """A row of the table: over which cases, of what, and what would be good."""

    label: str
    among: Callable[[pd.DataFrame], pd.Series]
    value: str
    good: str = ""
    middle: Middle = np.mean


def _detected(t: pd.DataFrame) -> pd.Series:
    """Cases in which a name is asked for: a diagnosis that ended without a verdict does not get out of it."""
    return t["detected"].eq(True) | t["answer"].eq(NO_VERDICT)  # None is neither


def _kind(*kinds: str, detected: bool = False) -> Callable[[pd.DataFrame], pd.Series]:
    def among(t: pd.DataFrame) -> pd.Series:
        kept = t["kind"].isin(kinds) & t["detectable"].astype(bool)
        return kept & _detected(t) if detected else kept

    return among


def _at(snr: float, column: str = "snr") -> Callable[[pd.DataFrame], pd.Series]:
    """Cases whose ratio is nearest to `snr` among those that are drawn."""
    return lambda t: _kind("single", "outside")(t) & (2 ** np.round(np.log2(t[column].clip(lower=1e-9))) == snr)


def _from(snr: float, kind: str, column: str) -> Callable[[pd.DataFrame], pd.Series]:
    """Detected cases of a kind with about that ratio or more; `snr_beyond` is that of the weaker effect of a pair."""
    return lambda t: _kind(kind, detected=True)(t) & (t[column] > ABOUT * snr)


def _told(kind: str) -> Callable[[pd.DataFrame], pd.Series]:
    """Detected cases of a kind whose recordings tell the observer what is missing."""
    return lambda t: _kind(kind, detected=True)(t) & (t["observer_fitted"] > TELLING)


def _only(levels: Sequence[str], among: Callable[[pd.DataFrame], pd.Series]) -> Callable[[pd.DataFrame], pd.Series]:
    return lambda t: among(t) & t["level"].isin(levels)


ALIKE = "half for what is said to be alike"
METRICS = (
    Metric("false alarms, nothing missing, p < 0.05", _only(("L0", "L1"), _kind("none")), "detected", "0.05 ± 0.015"),
    Metric("false alarms, nothing missing, p < 0.01", _only(("L0", "L1"), _kind("none")), "detected_at_1", "0.01"),
    Metric("mismatch seen in untouched real recordings", _only(("L2",), _kind("none")), "detected"),
    *(Metric(f"detected at SNR {snr}", _at(snr), "detected", good) for snr, good in ((4, ""), (8, "0.90"))),
    *(Metric(f"detected at SNR {snr}", _at(snr), "detected") for snr in (16, 32)),
    Metric(f"top-1, given detected, {ALIKE}", _kind("single", detected=True), "top1", "0.90 L0, 0.80 L1"),
    Metric("the same, nothing for what is alike", _kind("single", detected=True), "correct"),
    Metric("the observer, of single effects, from what is fitted", _kind("single", detected=True), "observer_fitted"),
    Metric("the observer, of single effects, held-out recordings too", _kind("single", detected=True), "observer_all"),
    Metric(f"this project's where the observer's from what is fitted is above {TELLING}", _told("single"), "correct"),
    Metric(f"top-1, SNR 8 and more, {ALIKE}", _from(8.0, "single", "snr"), "top1"),
    Metric(f"top-2, given detected, {ALIKE}", _kind("single", detected=True), "top2"),
    Metric("every true effect named above 0.5", _kind("single", "pair", detected=True), "named"),
    Metric("truth in the 90 % set", _kind("single", "pair", detected=True), "in_set", "0.90"),
    Metric("size of the 90 % set", _kind("single", "pair", detected=True), "set_size", "2"),
    Metric("wrong name, truth outside the catalogue", _kind("outside"), "wrong_name", "0.10"),
    Metric("called unknown, but a known effect named beside it", _kind("outside"), "named_beside"),
    Metric("unknown said, SNR 16 and more", lambda t: _kind("outside")(t) & (t["snr"] > 15), "said_unknown", "0.80"),
    Metric("both of a pair, given detected", _kind("pair", detected=True), "both", "0.80"),
    Metric("the observer, of pairs, from what is fitted", _kind("pair", detected=True), "observer_fitted"),
    Metric("the observer, of pairs, held-out recordings too", _kind("pair", detected=True), "observer_all"),
    Metric(f"both of a pair where the observer's from what is fitted is above {TELLING}", _told("pair"), "both"),
    Metric("both, the weaker at SNR 8 and more beyond the other", _from(8.0, "pair", "snr_beyond"), "both", "0.80"),
    Metric(f"the same, {ALIKE}", _from(8.0, "pair", "snr_beyond"), "top1"),
    Metric("at least half of a pair, given detected", _kind("pair", detected=True), "one_of_pair"),
    Metric("overlap (IoU) of a time-local effect", _kind("single", "outside", detected=True), "iou", "0.80"),
    Metric(
        "its onset's error where one is stated [s]", _kind("single", "outside", detected=True), "onset_error", "0.1"
    ),
    Metric("effect's parameters, relative error", _kind("single", detected=True), "size_error", "0.10"),
    Metric("their median", _kind("single", detected=True), "size_error", "0.10", np.median),
    Metric("that of an efficient estimator, 0.8 / SNR", _kind("single", detected=True), "size_efficient"),
    Metric("their mean without arms, lags and times", _kind("single", detected=True), "size_alone"),
    Metric("effect's parameters, coverage of 90 %", _kind("single", detected=True), "size_covered", "0.85 to 0.95"),
    Metric("base parameters' bias before [std]", _kind("single", "pair", detected=True), "bias_before"),
    Metric("base parameters' bias after [std]", _kind("single", "pair", detected=True), "bias_after", "0.8"),
    Metric("reducible held-out misfit removed", _kind("single", "pair", detected=True), "removed", "0.80 L1"),
    Metric("called missing, though not detectable", lambda t: ~t["detectable"].astype(bool), "detected"),
    Metric("seconds a diagnosis", lambda t: t["seconds"].notna(), "seconds", "60"),
)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row per metric; a column over all cases that were diagnosed and one per level."""
    judged = table[table["detected"].notna()].copy()
    judged["one_of_pair"] = [
        bool(set(a.split(" + ")) & set(b.split(" + ")))
        for a, b in zip(judged["answer"], judged["effects"], strict=True)
    ]
    judged["size_efficient"] = (EFFICIENT / judged["snr_beyond"]).where(judged["size_error"].notna())
    parts = {"all": judged} | {level: judged[judged["level"] == level] for level in LEVELS}
    rows = []
    for m in METRICS:
        cells = {
            name: shown(part.loc[m.among(part), m.value].tolist(), m.middle) if len(part) else ""
            for name, part in parts.items()
        }
        rows += [{"metric": m.label, **cells, "good": m.good}] if any(cells.values()) else []
    if judged["kind"].eq("none").all():
        return pd.DataFrame(rows)  # where nothing is ever missing, probabilities are not those of what is drawn
    parts = {name: part[part["answer"] != NO_VERDICT] for name, part in parts.items()}
    errors = {name: calibration_error(part) for name, part in parts.items()}
    cells = {name: "" if math.isnan(e) else f"{e:.3f}" for name, e in errors.items()}
    rows.append({"metric": "expected calibration error", **cells, "good": "0.05 L0, 0.08 L1"})
    ideal = {name: calibrated(part) for name, part in parts.items()}
    cells = {name: "" if math.isnan(e) else f"{e:.3f}" for name, e in ideal.items()}
    rows.append({"metric": "that of a calibrated forecaster, of as many cases", **cells, "good": ""})
    return pd.DataFrame(rows)


METHODS: Mapping[str, str] = {
    "this project": "", "forward selection by BIC": "bic_", "lasso, BIC": "lasso_",
    "largest residual correlation": "correlation_", "sbi's MMD test": "mmd_",
}  # fmt: skip
"""Methods by how they are called, with the prefix of their columns."""
NAMELESS = ("mmd_",)


def beside_baselines(table: pd.DataFrame, catalogue: int) -> pd.DataFrame:
    """First name right and anything seen among single effects that are detectable, alarms where nothing is missing, and
    the whole answer right in all simulated cases, also without those whose effect lies outside the catalogue.

    Of cases that every method has seen, where some have not.
    """
    if "bic_top1" in table:
        table = table[table["bic_top1"].notna()]
    single = table[_kind("single")(table)]
    simulated = table[(table["level"] != "L2") & table["detectable"].astype(bool)]
    nothing = simulated[simulated["kind"] == "none"]
    rows = []
    for method, prefix in METHODS.items():
        if f"{prefix}detected" not in table:
            continue
        cells = {}
        if prefix not in NAMELESS:
            named = single[f"{prefix}top1" if prefix else "first_right"]
            parts = {"all": named} | {level: named[single["level"] == level] for level in LEVELS}
            parts["L0 and L1, SNR 8 and more"] = named[(single["level"] != "L2") & (single["snr"] > ABOUT * 8.0)]
            cells = {name: shown(part.dropna().astype(float).tolist()) for name, part in parts.items()}
        if f"{prefix}correct" in table:
            right = simulated[f"{prefix}correct"].astype(float)
            cells["whole answer, L0 and L1"] = shown(right.tolist())
            cells["within the catalogue"] = shown(right[simulated["kind"] != "outside"].tolist())
        for column, part in (("seen", single), ("alarms where nothing is missing", nothing)):
            cells[column] = shown(part[f"{prefix}detected"].dropna().astype(float).tolist())
        rows.append({"method": method, **cells})
    rows.append({"method": "chance", "all": f"{1 / catalogue:.3f}"})
    return pd.DataFrame(rows).fillna("")


def misses(table: pd.DataFrame) -> pd.DataFrame:
    """Every effect: how often it was concealed alone, detected, named, and what was said in its place."""
    alone = table[table["kind"].isin(["single", "outside"]) & table["detected"].notna()] if "detected" in table else []
    rows = []
    for effect, part in pd.DataFrame(alone).groupby("effects", sort=True) if len(alone) else ():
        wrong = part.loc[_detected(part) & part["correct"].eq(False), "answer"]
        rows.append(
            {
                "effect": effect,
                "cases": len(part),
                "detectable": int(part["detectable"].sum()),
                "detected": int(part["detected"].sum()),
                "right": int(part["correct"].sum()),
                "said instead": ", ".join(f"{name} ({n})" for name, n in wrong.value_counts().items()),
            }
        )
    return pd.DataFrame(rows)


OBSERVER = """The observer is told the noise, the base model, that one effect of the catalogue is missing (or two) and
how strong effects are; it has only to name them."""
BESIDE = """## Beside simpler methods

Of single effects that are detectable the first name, and whether anything was seen. Of all simulated cases the whole
answer: nothing, that effect or pair alone, or something unknown, which simpler methods cannot say; also of those alone
in which nothing is unknown. False alarms. This project's first name is its most probable effect, whatever else is
missing, unless it answers that nothing is. Beyond what is fitted it sees half of the held-out recordings, which simpler
methods do not."""


def report(table: pd.DataFrame, command: str, where: str, catalogue: int) -> str:
    """The benchmark's page, by which command it was made, and where."""
    counts = table.groupby(["kind", "level"]).size().unstack(fill_value=0).reset_index()
    judged = int(table["detected"].notna().sum()) if "detected" in table else 0
    failed = int(table["answer"].eq(NO_VERDICT).sum()) if judged else 0
    weak, alone = int((~table["detectable"].astype(bool)).sum()), bool(table["kind"].eq("single").any())
    parts = [
        "# Concealed effects",
        f"`{command}`",
        f"{len(table)} cases, {judged} of them diagnosed, {failed} without a verdict, which counts as wrong in every "
        f"row that asks of such a case; mean (90 % interval; cases). {weak} are not detectable in any drive that was "
        "tried (SNR below 4 after projection) and are scored apart. L0: truth from the project's own models; L1: a "
        "twin and a multi-body car that the tool does not use; L2: real recordings with something injected.",
        OBSERVER if alone else "",
        markdown(summary(table)) if judged else "",
        BESIDE if alone else "",
        markdown(beside_baselines(table, catalogue)) if alone else "",
        "## Cases",
        markdown(counts.astype(str)),
        "## Effect by effect" if alone else "",
        markdown(misses(table).astype(str)) if alone and judged else "",
        where,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"
