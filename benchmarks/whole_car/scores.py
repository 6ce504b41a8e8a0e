"""What one diagnosis of a whole car is worth, from its verdict, the sealed truth and what the oracle reached."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import norm

from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.physics.effects import CATALOGUE
from whole_car.cars import LIKE

STRONG = 8.0  # signal-to-noise ratio beyond all other effects, from which one should be named
SHOWS = 4.0  # signal-to-noise ratio after the base parameters, from which an effect excuses the name of what is like it
REDUCIBLE = 0.1  # of the oracle's error, by which a channel's has to exceed it for there to be anything to gain
Z90 = float(norm.ppf(0.95))
SIMPLER = {"bic": "forward selection by BIC", "lasso": "lasso, BIC"}
Json = Mapping[str, Any]


@dataclass(frozen=True)
class Parameters:
    """Base parameters against the truth: relative errors, whether 90 % intervals hold it, errors in own stds."""

    relative: np.ndarray
    held: np.ndarray
    in_std: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One case by one method; arrays that have nothing to say are empty."""

    case: int
    world: str
    drive: str
    truth: Sequence[str]
    outside: str
    names: Mapping[str, float]  # of effects that are named, with their probabilities
    wrong: Sequence[str]  # of those, what is not there and can be told from what is
    strong: Mapping[str, float]  # probabilities of the effects that should be named
    alike: Mapping[str, float]  # the largest among each of those and what cannot be told from it
    inclusion: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))  # (effects, probability and whether true)
    before: Parameters | None = None
    after: Parameters | None = None
    oracle: Parameters | None = None
    sizes: np.ndarray = field(default_factory=lambda: np.zeros(0))  # whether intervals hold the named effects' sizes
    gained: float = 0.0  # of held-out misfit, and what the oracle gains
    reducible: float = 0.0
    accepted: bool | None = None
    p_unknown: float | None = None
    seconds: float | None = None


def as_line(one: Scored) -> str:
    """A case as a line of JSON, from which `from_line` has it again."""
    return json.dumps(asdict(one), default=lambda x: np.round(np.asarray(x, dtype=float), 6).tolist())


def from_line(line: str) -> Scored:
    content = json.loads(line)
    for name in ("before", "after", "oracle"):
        if content[name] is not None:
            content[name] = Parameters(**{key: np.array(x) for key, x in content[name].items()})
    content.pop("at_once", None)  # of an earlier version
    inclusion = np.array(content.pop("inclusion")).reshape(-1, 2)
    return Scored(**content | {"inclusion": inclusion, "sizes": np.array(content["sizes"])})


def standing(truth: Json) -> set[str]:
    """Effects that are there, that the world has by itself, or that cannot be told from one that is there and shows."""
    alike = {name for one in truth["effects"].values() if one["snr"] >= SHOWS for name in one["alike"]}
    like = {name for one in truth["inherent"] for name in LIKE.get(one, ())}
    return {*truth["effects"], *truth["inherent"], *alike, *like}


def parameters(truth: Mapping[str, float], said: Mapping[str, Json]) -> Parameters | None:
    """Of an estimate of each parameter; a normal interval where none is stated."""
    names = [name for name in truth if name in said]
    if not names:
        return None
    true = np.array([truth[name] for name in names])
    mean, std = (np.array([said[name][key] for name in names]) for key in ("mean", "std"))
    low = np.array([said[name].get("q05", said[name]["mean"] - Z90 * said[name]["std"]) for name in names])
    high = np.array([said[name].get("q95", said[name]["mean"] + Z90 * said[name]["std"]) for name in names])
    return Parameters(np.abs(mean / true - 1.0), (low <= true) & (true <= high), (mean - true) / np.maximum(std, 1e-12))


def _sizes(truth: Json, verdict: Json, names: Mapping[str, float]) -> np.ndarray:
    """Whether the 90 % intervals of the true effects that are named hold each of their sizes."""
    held = []
    for name, one in truth["effects"].items():
        said = next((e["parameters"] for e in verdict["explanations"] if name in e["effects"]), None)
        if name not in names or said is None:
            continue
        stated = {key: said[f"{name}.{key}"] for key in one["parameters"] if f"{name}.{key}" in said}
        held += [e["q05"] <= one["parameters"][key] <= e["q95"] for key, e in stated.items()]
    return np.array(held, dtype=float)


def _gained(verdict: Json, oracle: Json | None) -> tuple[float, float]:
    """Held-out misfit that the extended model takes away and that the oracle does, over channels with any to gain."""
    base = (verdict["fit"] or {}).get("base")
    if not oracle or not base:
        return 0.0, 0.0
    extended = verdict["fit"].get("extended") or base
    best, before, after = oracle["nrmse"], base["nrmse"], extended["nrmse"]
    channels = [c for c in best if c in before and before[c] > (1.0 + REDUCIBLE) * best[c]]
    return (
        float(sum(max(before[c] - after[c], best[c] - before[c]) for c in channels)),  # a spoilt one costs no more
        float(sum(before[c] - best[c] for c in channels)),
    )


def _inclusion(truth: Json, said: Mapping[str, float]) -> np.ndarray:
    there = {*truth["effects"], *truth["inherent"]}
    return np.array([[said.get(name, 0.0), float(name in there)] for name in CATALOGUE])


def scored(folder: Path, index: int, diagnosis: str) -> Scored | None:
    """A case by the diagnosis, or the simpler method, of a name; None where there is no answer."""
    if diagnosis in SIMPLER:
        return _by_simpler(folder, index, diagnosis)
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed" / f"{index:04d}"
    path = case / diagnosis / "verdict.json"
    if not path.exists():
        return None
    truth, verdict = json.loads(sealed.with_suffix(".json").read_text()), json.loads(path.read_text())
    knowing = sealed.with_suffix(".oracle.json")
    oracle = json.loads(knowing.read_text()) if knowing.exists() else None
    said = {name: float(p) for name, p in verdict["effects"].items()}
    spent = case / f"{diagnosis}.json"
    gained, reducible = _gained(verdict, oracle)
    base = verdict["base_parameters"]
    fit = verdict["fit"] or {}
    return Scored(
        **_naming(truth, case, said),
        inclusion=_inclusion(truth, said),
        before=parameters(truth["base_parameters"], {k: v["before"] for k, v in base.items()}),
        after=parameters(truth["base_parameters"], {k: v.get("after") or v["before"] for k, v in base.items()}),
        oracle=parameters(truth["base_parameters"], oracle["parameters"]) if oracle else None,
        sizes=_sizes(truth, verdict, {name: p for name, p in said.items() if p > NAMED}),
        gained=gained,
        reducible=reducible,
        accepted=fit.get("accepted", fit.get("extended") is not None),
        p_unknown=float(verdict["p_unknown"]),
        seconds=json.loads(spent.read_text())["seconds"] if spent.exists() else None,
    )


def by_selection(truth: Json, case: Path, said: Mapping[str, float], after: Parameters | None) -> Scored:
    """A case by the probabilities of its effects and the base parameters alone."""
    return Scored(**_naming(truth, case, said), inclusion=_inclusion(truth, said), after=after)


def _by_simpler(folder: Path, index: int, method: str) -> Scored | None:
    """A case by forward selection or the lasso: what they name, they are sure of."""
    case = folder / "cases" / f"{index:04d}"
    if not (case / "baselines.json").exists():
        return None
    truth = json.loads((folder / "sealed" / f"{index:04d}.json").read_text())
    names = json.loads((case / "baselines.json").read_text())[method]
    return Scored(**_naming(truth, case, dict.fromkeys(names, 1.0)))


def _naming(truth: Json, case: Path, said: Mapping[str, float]) -> dict[str, Any]:
    there, names = standing(truth), {name: p for name, p in said.items() if p > NAMED}
    strong = {
        name: one for name, one in truth["effects"].items() if one["inside"] and one["snr_beyond"] >= STRONG
    }  # fmt: skip
    return {
        "case": truth["index"],
        "world": truth["world"],
        "drive": yaml.safe_load((case / "case.yaml").read_text())["drive"],
        "truth": [name for name, one in truth["effects"].items() if one["inside"]],
        "outside": " + ".join(name for name, one in truth["effects"].items() if not one["inside"]),
        "names": names,
        "wrong": sorted(set(names) - there),
        "strong": {name: said.get(name, 0.0) for name in strong},
        "alike": {name: max(said.get(k, 0.0) for k in (name, *one["alike"])) for name, one in strong.items()},
    }
