"""What an injected effect changes in a diagnosis: names that come and go, its size, the base parameters."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from injected.cases import HALVES
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

NAMED = 0.5  # probability, from which an effect is named
Json = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One pair; arrays that have nothing to say are empty."""

    case: int
    source: str
    effect: str
    snr: float
    before: float  # probability of the effect, or of what cannot be told from it, without and with it injected
    after: float
    new: tuple[str, ...]  # names that came with it and are neither it nor like it
    gone: tuple[str, ...]  # names that went
    names: int  # without it, which no one can judge
    sizes: np.ndarray  # whether 90 % intervals of what it adds hold what was injected
    moved: np.ndarray  # base parameters after diagnosis, by how many of their standard deviations they differ
    moved_base: np.ndarray  # the same of the base model's fit
    seconds: float | None

    @property
    def found(self) -> bool:
        """Whether the injected effect, or what cannot be told from it, is named."""
        return self.after > NAMED


def difference(folder: Path, index: int, diagnosis: str) -> Difference | None:
    """A pair by the diagnosis of a name; None where an answer is missing."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed" / f"{index:04d}.json"
    paths = [case / half / diagnosis / "verdict.json" for half in HALVES]
    if not (sealed.exists() and all(path.exists() for path in paths)):
        return None
    truth = json.loads(sealed.read_text())
    without, with_it = (json.loads(path.read_text()) for path in paths)
    like = {truth["effect"], *truth["alike"]}
    names = [{name for name, p in one["effects"].items() if p > NAMED} for one in (without, with_it)]
    before, after = (max((one["effects"].get(name, 0.0) for name in like), default=0.0) for one in (without, with_it))
    spent = [case / half / f"{diagnosis}.json" for half in HALVES]
    return Difference(
        case=index,
        source=truth["source"],
        effect=truth["effect"],
        snr=truth["snr"],
        before=before,
        after=after,
        new=tuple(sorted(names[1] - names[0] - like)),
        gone=tuple(sorted(names[0] - names[1] - like)),
        names=len(names[0]),
        sizes=_sizes(truth, without, with_it),
        moved=_moved(without, with_it, "after"),
        moved_base=_moved(without, with_it, "before"),
        seconds=sum(json.loads(path.read_text())["seconds"] for path in spent if path.exists()) or None,
    )


def _size(verdict: Json, parameter: str) -> Json | None:
    """Of the likeliest set that has it."""
    return next((e["parameters"][parameter] for e in verdict["explanations"] if parameter in e["parameters"]), None)


def _sizes(truth: Json, without: Json, with_it: Json) -> np.ndarray:
    """Whether intervals of the difference hold what was injected; a car that is not said to have it has none of it."""
    held = []
    for key, value in truth["parameters"].items():
        name = f"{truth['effect']}.{key}"
        own, all_of_it = _size(without, name), _size(with_it, name)
        if all_of_it is None or with_it["effects"].get(truth["effect"], 0.0) <= NAMED:
            continue
        likely = own is not None and without["effects"].get(truth["effect"], 0.0) > NAMED
        mean, std = (own["mean"], own["std"]) if own is not None and likely else (_null(name), 0.0)
        total = combined(name, value, mean)
        spread = 1.645 * float(np.hypot(all_of_it["std"], std))
        held.append(abs(all_of_it["mean"] - total) <= spread)
    return np.array(held, dtype=float)


def _null(name: str) -> float:
    return EFFECT_PARAMETERS[name].null or 0.0


def combined(name: str, injected: float, own: float) -> float:
    """What two of an effect, one behind the other, come to: gains multiply, all else adds."""
    return injected * own if _null(name) == 1.0 else injected + own


def _moved(without: Json, with_it: Json, when: str) -> np.ndarray:
    """Differences of base parameters in standard deviations of both."""
    found = []
    for name, one in without["base_parameters"].items():
        other = with_it["base_parameters"].get(name)
        a, b = one.get(when) or one["before"], other and (other.get(when) or other["before"])
        if b:
            found.append((b["mean"] - a["mean"]) / max(float(np.hypot(a["std"], b["std"])), 1e-12))
    return np.array(found)
