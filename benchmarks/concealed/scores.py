"""Verdicts held against the sealed truth: a row per case.

An answer is a set of effects, `none` or `unknown`; the right one is the set that was concealed, `none` where nothing is
missing, `unknown` where what is missing lies outside the catalogue. On real recordings (L2) the right answer contains
the injected effect, alone or beside others or something unknown, for what else the car has that the model lacks is not
known; nor are their controls false alarms. A diagnosis that ended without a verdict is wrong about everything.
"""

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.sensors import MEASUREMENTS

INTERVAL = 0.9
NONE, UNKNOWN = frozenset(["none"]), frozenset(["unknown"])
REDUCIBLE = 0.05  # of the oracle's error, that the base model's has to exceed it by in some channel to be reducible
SHAPES = frozenset(
    name for name in EFFECT_PARAMETERS
    if name.split(".")[1] in ("arm", "duration", "front_share", "lag", "period", "start") or name == "payload.x"
)  # fmt: skip
"""Parameters that say where, when or how late an effect acts, and mean nothing without its size."""
OF_ONE_CHANNEL: Mapping[str, str] = {
    "accelerometer_bias.x": "a_x", "accelerometer_bias.y": "a_y", "accelerometer_scale.x": "a_x",
    "accelerometer_scale.y": "a_y", "accelerometer_scale.z": "a_z",
    **{f"gyro_{what}.{axis}": name for what in ("bias", "scale")
       for axis, name in (("x", "roll_rate"), ("y", "pitch_rate"), ("z", "yaw_rate"))},
    "speed_scale.gain": "v_x",
    **{f"sensor_{what}.{name}": name for what in ("lag", "delay") for name in MEASUREMENTS},
}  # fmt: skip
"""Parameters of sensors, which nothing shows where that channel is not recorded."""
Answer = frozenset[str]
Json = Mapping[str, Any]
Span = tuple[float, float]
SILENT: Json = {
    "detected": False, "p_value": 1.0, "explanations": [], "effects": {}, "p_none": 0.0, "p_unknown": 0.0,
    "p_unknown_alone": 0.0, "mismatch": [], "unknown": None,
}  # fmt: skip
"""A verdict that says nothing."""
CHOOSING = ("bic", "lasso")
"""Methods that say how many effects are missing, none among them."""
NO_VERDICT = "no verdict"  # the answer of a diagnosis that crashed or ran out of time


def answers(verdict: Json, *, apart: bool) -> list[tuple[Answer, float]]:
    """All answers with their probabilities, the likeliest first. `apart`: each known set with something unknown beside
    it is an answer of its own, as of real recordings; else it is part of *unknown*. Sets that a verdict does not list
    are no answers."""
    named = [(frozenset(e["effects"]), float(e["probability"])) for e in verdict["explanations"]]
    beside = [(frozenset(e["effects"]) | UNKNOWN, e.get("beside_unknown", 0.0)) for e in verdict["explanations"]]
    beside = beside if apart else []
    unknown = float(verdict["p_unknown_alone" if apart else "p_unknown"])
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


def _named(truth: Json, verdict: Json) -> bool:
    """Whether the verdict gives each true effect a probability above that from which its headline names it."""
    return min(verdict["effects"].get(effect, 0.0) for effect in truth["effects"]) > NAMED


def _names_beside(verdict: Json) -> bool:
    """Whether a set of known effects with something unknown is likelier than something unknown alone."""
    found = dict(answers(verdict, apart=True))
    return max((p for answer, p in found.items() if answer > UNKNOWN), default=0.0) > found[UNKNOWN]


def score(truth: Json, verdict: Json, oracle: Mapping[str, float] | None = None) -> dict[str, Any]:
    """What one verdict is worth; None where a question does not arise. `oracle`: NRMSE of one who knows, by channel.

    `first_right` is for comparison with methods that name one effect after the other: whether the single most probable
    effect is there, unless the answer is that nothing is missing.
    """
    real = truth["level"] == "L2"
    ranked = answers(verdict, apart=real)
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
        "first_right": top[0] != NONE and next(iter(verdict["effects"]), "none") in truth["effects"],
        "p_none": missing[0],
        "p_unknown": missing[1],
        "top1": 1.0 if correct[0] else half,
        "top2": 1.0 if any(correct[:2]) else half,
        "in_set": any(correct[:likely]),
        "set_size": likely,
        "both": correct[0] if kind == "pair" else None,
        "named": _named(truth, verdict) if kind in ("single", "pair") else None,
        "wrong_name": best[1] > max(missing) if kind == "outside" else None,
        "said_unknown": top[0] == UNKNOWN if kind == "outside" else None,
        "named_beside": _names_beside(verdict) if kind == "outside" and top[0] == UNKNOWN else None,
    }
    return row | _place(truth, verdict, top[0]) | _sizes(truth, verdict, best[0]) | _base(truth, verdict) | {
        "removed": _removed(verdict, oracle)
    }  # fmt: skip


def unsaid(truth: Json) -> dict[str, Any]:
    """What is scored where there is no verdict: wrong, whatever is asked of such a case; an alarm where none is due."""
    alarm = truth["kind"] == "none" or not truth["detectable"]
    wrong = {
        "detected": alarm, "detected_at_1": alarm, "answer": NO_VERDICT, "correct": False, "first_right": False,
        "top1": 0.0, "top2": 0.0, "in_set": False, "wrong_name": True if truth["kind"] == "outside" else None,
    }  # fmt: skip
    return score(truth, SILENT) | wrong | dict.fromkeys(["p_value", "probability", "p_none", "p_unknown", "set_size"])


def _place(truth: Json, verdict: Json, answer: Answer) -> dict[str, Any]:
    """Overlap of the true spans with the stated ones over all recordings, and the onset's error in the first.

    Stated are those of what the answer names, or of the likeliest law where it is unknown, if it says when it acts,
    else where in time the misfit is.
    """
    effect, true = next(((name, e["spans"]) for name, e in truth["effects"].items() if e["spans"]), ("", None))
    if true is None:
        return {"iou": None, "onset_error": None}
    acts = next((e["acts"] for e in verdict["explanations"] if set(e["effects"]) == answer), {})
    places = [m["within"] for m in verdict["mismatch"] if m["p_value"] < 0.05 and not m["regime"]]
    laws = (verdict["unknown"] or {}).get("laws", []) if answer == UNKNOWN else []
    acting = acts.get(effect) or next(iter(acts.values()), None) or next((law.get("acts") for law in laws), None)
    said: dict[str, list[Span]] = {}
    for stretch in acting or [stretch for within in places for stretch in within]:
        said.setdefault(stretch["recording"], []).append((stretch["from_s"], stretch["to_s"]))
    both, either = 0.0, 0.0
    for name in true.keys() | said.keys():
        common, any_of_them = _overlap([true[name]] if name in true else [], said.get(name, []))
        both, either = both + common, either + any_of_them
    first, (start, _) = next(iter(true.items()))
    onset = abs(min(begun for begun, _ in said[first]) - start) if first in said else None
    return {"iou": both / either if said else 0.0, "onset_error": onset}


def _overlap(true: Sequence[Span], said: Sequence[Span]) -> tuple[float, float]:
    """Seconds in which both are, and in which any of them is."""
    both = either = 0.0
    for low, high in pairwise(sorted({edge for span in (*true, *said) for edge in span})):
        inside = [any(start < (low + high) / 2 < stop for start, stop in spans) for spans in (true, said)]
        both, either = both + all(inside) * (high - low), either + any(inside) * (high - low)
    return both, either


def _sizes(truth: Json, verdict: Json, best: Answer) -> dict[str, Any]:
    """Relative error (of the distance from null) and 90 % coverage of the parameters of effects that are named, the
    former also without what only gives an effect its shape. What is not said of them counts as said to be null."""
    if truth["kind"] not in ("single", "pair") or not right(truth) & best:
        return {"size_error": None, "size_alone": None, "size_covered": None}
    stated = next(e["parameters"] for e in verdict["explanations"] if set(e["effects"]) == best - UNKNOWN)
    errors: list[float] = []
    alone: list[float] = []
    covered: list[bool] = []
    for effect, facts in truth["effects"].items():
        for names in _profiles(effect, facts["active"]) if effect in best else ():
            null = np.array([EFFECT_PARAMETERS[name].null or 0.0 for name in names])
            value = np.array([facts["parameters"][name.split(".")[1]] for name in names])
            if np.array_equal(value, null):
                continue
            means = [stated[name]["mean"] if name in stated else none for name, none in zip(names, null, strict=True)]
            errors.append(float(np.linalg.norm(means - value) / np.linalg.norm(value - null)))
            alone += [] if names[0] in SHAPES else errors[-1:]
            sizes = {name: x for name, x, none in zip(names, value, null, strict=True) if x != none}
            covered += [name in stated and stated[name]["q05"] <= x <= stated[name]["q95"] for name, x in sizes.items()]
    return {
        "size_error": float(np.mean(errors)) if errors else None,
        "size_alone": float(np.mean(alone)) if alone else None,
        "size_covered": float(np.mean(covered)) if covered else None,
    }


def _profiles(effect: str, keys: Sequence[str]) -> list[list[str]]:
    """Names of parameters, those of a profile (angle_0, angle_1, …) together: what is said of it has one error."""
    found: dict[str, list[str]] = {}
    for key in keys:
        found.setdefault(key.rstrip("0123456789"), []).append(f"{effect}.{key}")
    return list(found.values())


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
    """Share of the held-out misfit beyond the oracle's that the extended model takes away, over all channels: it loses
    by what it spoils in any, and one as good as the oracle takes away all."""
    fit = verdict.get("fit") or {}
    if not oracle or not fit.get("extended"):
        return None
    base, extended = fit["base"]["nrmse"], fit["extended"]["nrmse"]
    shared = [c for c in base if c in extended and c in oracle]
    if not any(base[c] > (1.0 + REDUCIBLE) * oracle[c] for c in shared):
        return None
    reducible = sum(max(base[c] - oracle[c], 0.0) for c in shared)
    return sum(base[c] - extended[c] for c in shared) / reducible


def _recorded(parameter: str, channels: Sequence[str]) -> bool:
    """Whether a parameter acts on anything that is recorded."""
    return OF_ONE_CHANNEL.get(parameter, channels[0]) in channels


def row(folder: Path, index: int, diagnosis: str = "diagnosis") -> dict[str, Any]:
    """One case: what it is, what was said of it, what the baselines say, how long it took."""
    case, name = folder / "cases" / f"{index:04d}", f"{index:04d}"
    truth = json.loads((folder / "sealed" / f"{name}.json").read_text())
    told = yaml.safe_load((case / "case.yaml").read_text())
    facts = list(truth["effects"].values())
    for effect, one in truth["effects"].items():
        one["active"] = [key for key in one["active"] if _recorded(f"{effect}.{key}", told["channels"])]
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
    run = case / f"{diagnosis}.json"
    out["seconds"] = json.loads(run.read_text())["seconds"] if run.exists() else None
    verdict = case / diagnosis / "verdict.json"
    if verdict.exists():
        knowing = folder / "sealed" / f"{name}.oracle.json"
        oracle = json.loads(knowing.read_text()) if knowing.exists() else None
        out |= score(truth, json.loads(verdict.read_text()), oracle)
    elif run.exists():
        out |= unsaid(truth)
    observer = folder / "sealed" / f"{name}.observer.json"
    named = json.loads(observer.read_text()) if observer.exists() else {}
    out |= {f"observer_{data}": named.get(data) for data in ("fitted", "all")}
    said = json.loads((case / "baselines.json").read_text()) if (case / "baselines.json").exists() else {}
    for method, names in said.items():
        out[f"{method}_answer"] = names[0] if names else "none"
        out[f"{method}_top1"] = bool(names) and names[0] in truth["effects"]
        out[f"{method}_detected"] = bool(names)
        if method in CHOOSING:
            out[f"{method}_correct"] = frozenset(names or NONE) == right(truth)
    return out
