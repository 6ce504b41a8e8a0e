"""Verdicts held against the sealed truth: a row per case, and the benchmark's table with 90 % intervals.

An answer is a set of effects, `none` or `unknown`; the right one is the set that was concealed, `none` where nothing is
missing, `unknown` where what is missing lies outside the catalogue. On real recordings (L2) the right answer contains
the injected effect, alone or beside others or something unknown, for what else the car has that the model lacks is not
known; nor are their controls false alarms.
Intervals: Clopper and Pearson (1934) for shares of yes and no, percentile bootstrap for everything else.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy.stats import beta

from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.report.tables import markdown

LEVELS = ("L0", "L1", "L2")
INTERVAL = 0.9
NONE, UNKNOWN = frozenset(["none"]), frozenset(["unknown"])
REDUCIBLE = 0.05  # of the oracle's error, that the base model's has to exceed it by to count as reducible
Answer = frozenset[str]
Middle = Callable[..., Any]  # np.mean or np.median
Json = Mapping[str, Any]


# --- one case -------------------------------------------------------------------------------------------------------


def answers(verdict: Json, *, real: bool = False) -> list[tuple[Answer, float]]:
    """All answers with their probabilities, the likeliest first; of a real recording each known set with something
    unknown beside it is an answer of its own."""
    named = [(frozenset(e["effects"]), float(e["probability"])) for e in verdict["explanations"]]
    beside = [(frozenset(e["effects"]) | UNKNOWN, e.get("beside_unknown", 0.0)) for e in verdict["explanations"]]
    beside = beside if real else []
    unknown = max(float(verdict["p_unknown"]) - sum(p for _, p in beside), 0.0)
    rest = [(NONE, float(verdict["p_none"])), (UNKNOWN, unknown)]
    return sorted([*named, *beside, *rest], key=lambda one: -one[1])


def right(truth: Json) -> Answer:
    if truth["kind"] == "none":
        return NONE
    return UNKNOWN if truth["kind"] == "outside" else frozenset(truth["effects"])


def agrees(answer: Answer, truth: Json) -> bool:
    correct = right(truth)
    return correct <= answer if truth["level"] == "L2" and correct != NONE else answer == correct


def _half(answer: Answer, truth: Json, verdict: Json) -> bool:
    """Whether each true effect is among those that the verdict cannot tell from what it names."""
    groups = [{name.split(".")[0] for name in group} for group in verdict.get("indistinguishable", [])]
    groups = [group for group in groups if group & answer]
    return right(truth) <= answer.union(*groups) if truth["kind"] in ("single", "pair") else False


def score(truth: Json, verdict: Json, oracle: Mapping[str, float] | None = None) -> dict[str, Any]:
    """What one verdict is worth; None where a question does not arise. `oracle`: NRMSE of one who knows, by channel."""
    ranked = answers(verdict, real=truth["level"] == "L2")
    top, kind = ranked[0], truth["kind"]
    correct = [agrees(answer, truth) for answer, _ in ranked]
    likely = int(np.searchsorted(np.cumsum([p for _, p in ranked]), INTERVAL - 1e-9)) + 1
    named = [pair for pair in ranked if pair[0] not in (NONE, UNKNOWN)]
    best = named[0] if named else (NONE, 0.0)
    missing = verdict["p_none"], verdict["p_unknown"]
    half = 0.5 * _half(top[0], truth, verdict)
    row: dict[str, Any] = {
        "detected": bool(verdict["detected"]) and verdict["p_value"] < 0.05,
        "detected_at_1": verdict["p_value"] < 0.01,
        "p_value": verdict["p_value"],
        "answer": " + ".join(sorted(top[0])),
        "probability": top[1],
        "correct": correct[0],
        "p_none": missing[0],
        "p_unknown": missing[1],
        "top1": 1.0 if correct[0] else half,
        "top2": 1.0 if any(correct[:2]) else half,
        "in_set": any(correct[:likely]),
        "set_size": likely,
        "both": correct[0] if kind == "pair" else None,
        "wrong_name": best[1] > max(missing) if kind == "outside" else None,
        "said_unknown": top[0] == UNKNOWN if kind == "outside" else None,
    }
    return row | _place(truth, verdict) | _sizes(truth, verdict, best[0]) | _base(truth, verdict) | {
        "removed": _removed(verdict, oracle)
    }  # fmt: skip


def _place(truth: Json, verdict: Json) -> dict[str, Any]:
    """Overlap of the true span with the stated one (the named effect's, else the places of the misfit), and onset."""
    spans = [e["span"] for e in truth["effects"].values() if e["span"]]
    if not spans:
        return {"iou": None, "onset_error": None}
    start, stop = spans[0]
    said = [(m["from_s"], m["to_s"]) for m in verdict["mismatch"] if m.get("p_value", 0.0) < 0.05]
    for name, value in (verdict["explanations"][0]["parameters"] if verdict["explanations"] else {}).items():
        lasts = verdict["explanations"][0]["parameters"].get(name.replace(".start", ".duration"))
        if name.endswith(".start") and lasts:
            said = [(value["mean"], value["mean"] + lasts["mean"])]
    if not said:
        return {"iou": 0.0, "onset_error": None}
    edges = sorted({start, stop, *(edge for span in said for edge in span)})
    both = either = 0.0
    for low, high in pairwise(edges):
        middle = (low + high) / 2
        true, stated = start < middle < stop, any(a < middle < b for a, b in said)
        both, either = both + (true and stated) * (high - low), either + (true or stated) * (high - low)
    return {"iou": both / either if either else 0.0, "onset_error": abs(min(a for a, _ in said) - start)}


def _sizes(truth: Json, verdict: Json, best: Answer) -> dict[str, Any]:
    """Relative error (of the distance from null) and 90 % coverage of the parameters of effects that are named."""
    if not verdict["explanations"] or truth["kind"] not in ("single", "pair") or not right(truth) & best:
        return {"size_error": None, "size_covered": None}
    stated, errors, covered = verdict["explanations"][0]["parameters"], [], []
    for effect, facts in truth["effects"].items():
        for key in facts["active"]:
            name = f"{effect}.{key}"
            value, null = facts["parameters"][key], EFFECT_PARAMETERS[name].null or 0.0
            if name in stated and value != null:
                errors.append(abs(stated[name]["mean"] - value) / abs(value - null))
                covered.append(stated[name]["q05"] <= value <= stated[name]["q95"])
    if not errors:
        return {"size_error": None, "size_covered": None}
    return {"size_error": float(np.mean(errors)), "size_covered": float(np.mean(covered))}


def _base(truth: Json, verdict: Json) -> dict[str, Any]:
    """Mean distance of the base parameters from the truth, in their own standard deviations, before and after."""
    out: dict[str, Any] = {}
    for when in ("before", "after"):
        off = [
            abs(one[when]["mean"] - truth["base_parameters"][name]) / one[when]["std"]
            for name, one in verdict.get("base_parameters", {}).items()
            if name in truth["base_parameters"] and one.get(when) and one[when]["std"] > 0
        ]
        out[f"bias_{when}"] = float(np.mean(off)) if off and truth["level"] == "L0" else None
    return out


def _removed(verdict: Json, oracle: Mapping[str, float] | None) -> float | None:
    """Share of the held-out misfit beyond the oracle's that the extended model takes away, over channels."""
    fit = verdict.get("fit") or {}
    if not oracle or not fit.get("extended"):
        return None
    base, extended = fit["base"]["nrmse"], fit["extended"]["nrmse"]
    shared = [c for c in base if c in extended and c in oracle and base[c] > (1.0 + REDUCIBLE) * oracle[c]]
    over = sum(base[c] - oracle[c] for c in shared)
    return sum(base[c] - extended[c] for c in shared) / over if shared else None


# --- all cases ------------------------------------------------------------------------------------------------------


def row(folder: Path, index: int) -> dict[str, Any]:
    """One case: what it is, what was said of it, what the baselines say, how long it took."""
    case, name = folder / "cases" / f"{index:04d}", f"{index:04d}"
    truth = json.loads((folder / "sealed" / f"{name}.json").read_text())
    told = yaml.safe_load((case / "case.yaml").read_text())
    facts = list(truth["effects"].values())
    noise = truth.get("noise") or {}
    out: dict[str, Any] = {
        "case": index,
        **{key: truth[key] for key in ("level", "kind", "world", "regime")},
        "drive": told["drive"],
        "recordings": len(told["recordings"]),
        "noise": "" if not noise else "ar1" if any(noise["rho"].values()) else noise["tail"],
        "effects": " + ".join(truth["effects"]),
        "snr_drawn": truth["snr_drawn"],
        "snr": truth["snr"],
        "snr_beyond": min((one["snr_beyond"] for one in facts), default=None),
        "detectable": truth["detectable"],
    }
    run = case / "run.json"
    out["seconds"] = json.loads(run.read_text())["seconds"] if run.exists() else None
    verdict = case / "diagnosis" / "verdict.json"
    if verdict.exists():
        knowing = folder / "sealed" / f"{name}.oracle.json"
        oracle = json.loads(knowing.read_text()) if knowing.exists() else None
        out |= score(truth, json.loads(verdict.read_text()), oracle)
    said = json.loads((case / "baselines.json").read_text()) if (case / "baselines.json").exists() else {}
    for method, names in said.items():
        out[f"{method}_answer"] = names[0] if names else "none"
        out[f"{method}_top1"] = bool(names) and names[0] in truth["effects"]
        out[f"{method}_detected"] = bool(names)
    return out


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


@dataclass(frozen=True)
class Metric:
    """A row of the table: over which cases, of what, and what would be good."""

    label: str
    among: Callable[[pd.DataFrame], pd.Series]
    value: str
    good: str = ""
    middle: Middle = np.mean


def _kind(*kinds: str, detected: bool = False) -> Callable[[pd.DataFrame], pd.Series]:
    def among(t: pd.DataFrame) -> pd.Series:
        kept = t["kind"].isin(kinds) & t["detectable"].astype(bool)
        return kept & t["detected"].eq(True) if detected else kept  # None is neither

    return among


def _at(snr: float, column: str = "snr") -> Callable[[pd.DataFrame], pd.Series]:
    """Cases whose ratio is nearest to `snr` among those that are drawn."""
    return lambda t: _kind("single", "outside")(t) & (2 ** np.round(np.log2(t[column].clip(lower=1e-9))) == snr)


def _pair_at(snr: float) -> Callable[[pd.DataFrame], pd.Series]:
    """Detected pairs whose weaker effect has about `snr` or more beyond the other."""
    return lambda t: _kind("pair", detected=True)(t) & (t["snr_beyond"] > snr / math.sqrt(2.0))


def _only(levels: Sequence[str], among: Callable[[pd.DataFrame], pd.Series]) -> Callable[[pd.DataFrame], pd.Series]:
    return lambda t: among(t) & t["level"].isin(levels)


METRICS = (
    Metric("false alarms, nothing missing, p < 0.05", _only(("L0", "L1"), _kind("none")), "detected", "0.05 ± 0.015"),
    Metric("false alarms, nothing missing, p < 0.01", _only(("L0", "L1"), _kind("none")), "detected_at_1", "0.01"),
    Metric("mismatch seen in untouched real recordings", _only(("L2",), _kind("none")), "detected"),
    *(Metric(f"detected at SNR {snr}", _at(snr), "detected", good) for snr, good in ((4, ""), (8, "0.90"))),
    *(Metric(f"detected at SNR {snr}", _at(snr), "detected") for snr in (16, 32)),
    Metric("top-1, given detected", _kind("single", detected=True), "top1", "0.90 L0, 0.80 L1"),
    Metric("top-2, given detected", _kind("single", detected=True), "top2"),
    Metric("truth in the 90 % set", _kind("single", "pair", detected=True), "in_set", "0.90"),
    Metric("size of the 90 % set", _kind("single", "pair", detected=True), "set_size", "2"),
    Metric("wrong name, truth outside the catalogue", _kind("outside"), "wrong_name", "0.10"),
    Metric("unknown said, SNR 16 and more", lambda t: _kind("outside")(t) & (t["snr"] > 15), "said_unknown", "0.80"),
    Metric("both of a pair, given detected", _kind("pair", detected=True), "both", "0.80"),
    Metric("both, the weaker at SNR 8 and more beyond the other", _pair_at(8.0), "both", "0.80"),
    Metric("the same, half for what is said to be alike", _pair_at(8.0), "top1"),
    Metric("at least half of a pair, given detected", _kind("pair", detected=True), "one_of_pair"),
    Metric("overlap (IoU) of a time-local effect", _kind("single", "outside", detected=True), "iou", "0.80"),
    Metric("its onset's error [s]", _kind("single", "outside", detected=True), "onset_error", "0.1"),
    Metric("effect's parameters, relative error", _kind("single", detected=True), "size_error", "0.10"),
    Metric("their median", _kind("single", detected=True), "size_error", "0.10", np.median),
    Metric("effect's parameters, coverage of 90 %", _kind("single", detected=True), "size_covered", "0.85 to 0.95"),
    Metric("base parameters' bias before [std]", _kind("single", "pair", detected=True), "bias_before"),
    Metric("base parameters' bias after [std]", _kind("single", "pair", detected=True), "bias_after", "0.8"),
    Metric("reducible held-out misfit removed", _kind("single", "pair", detected=True), "removed", "0.80 L1"),
    Metric("called missing, though not detectable", lambda t: ~t["detectable"].astype(bool), "detected"),
    Metric("seconds a diagnosis", lambda t: t["seconds"].notna(), "seconds", "60"),
)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row per metric; a column over all cases and one per level."""
    judged = table[table["detected"].notna()].copy() if "detected" in table else table.iloc[:0].copy()
    judged["one_of_pair"] = [
        bool(set(a.split(" + ")) & set(b.split(" + ")))
        for a, b in zip(judged.get("answer", []), judged.get("effects", []), strict=True)
    ]
    parts = {"all": judged} | {level: judged[judged["level"] == level] for level in LEVELS}
    rows = []
    for m in METRICS:
        cells = {
            name: shown(part.loc[m.among(part), m.value].tolist(), m.middle) if len(part) else ""
            for name, part in parts.items()
        }
        rows.append({"metric": m.label, **cells, "good": m.good})
    errors = {name: calibration_error(part) for name, part in parts.items()}
    cells = {name: "" if math.isnan(e) else f"{e:.3f}" for name, e in errors.items()}
    rows.append({"metric": "expected calibration error", **cells, "good": "0.05 L0, 0.08 L1"})
    return pd.DataFrame(rows)


METHODS: Mapping[str, str] = {
    "this project": "", "forward selection by BIC": "bic_", "lasso, BIC": "lasso_",
    "largest residual correlation": "correlation_", "sbi's MMD test": "mmd_",
}  # fmt: skip
"""Methods by how they are called, with the prefix of their columns."""
NAMELESS = ("mmd_",)


def beside_baselines(table: pd.DataFrame, catalogue: int) -> pd.DataFrame:
    """First name right and anything seen among single effects that are detectable, alarms where nothing is missing.

    Of cases that every method has seen, where some have not.
    """
    if "bic_top1" in table:
        table = table[table["bic_top1"].notna()]
    single = table[_kind("single")(table)]
    nothing = table[(table["kind"] == "none") & (table["level"] != "L2")]
    rows = []
    for method, prefix in METHODS.items():
        if f"{prefix}detected" not in table:
            continue
        cells = {}
        if prefix not in NAMELESS:
            named = single[f"{prefix}top1"] if prefix else single["correct"].where(single["detected"].notna())
            parts = {"all": named} | {level: named[single["level"] == level] for level in LEVELS}
            cells = {name: shown(part.dropna().astype(float).tolist()) for name, part in parts.items()}
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
        wrong = part.loc[part["detected"].eq(True) & part["correct"].eq(False), "answer"]
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


def report(table: pd.DataFrame, where: str, catalogue: int) -> str:
    """The benchmark's page."""
    counts = table.groupby(["kind", "level"]).size().unstack(fill_value=0).reset_index()
    judged = int(table["detected"].notna().sum()) if "detected" in table else 0
    weak = int((~table["detectable"].astype(bool)).sum())
    parts = [
        "# Concealed effects",
        f"{len(table)} cases, {judged} of them diagnosed; mean (90 % interval; cases). {weak} are not detectable in "
        "any drive that was tried (SNR below 4 after projection) and are scored apart. L0: truth from the project's "
        "own models; L1: a twin and a multi-body car that the tool does not use; L2: real recordings with something "
        "injected.",
        markdown(summary(table)),
        "## Beside simpler methods\n\nOf single effects that are detectable the first name, and whether anything was "
        "seen; false alarms.",
        markdown(beside_baselines(table, catalogue)),
        "## Cases",
        markdown(counts.astype(str)),
        "## Effect by effect",
        markdown(misses(table).astype(str)) if judged else "",
        where,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"
