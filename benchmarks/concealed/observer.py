"""How often one names what is missing who is told what the tool has to find out: about as often as one can be right.

This observer knows the noise, that one effect of the catalogue is missing (or two), how strongly the benchmark conceals
effects, and when and where the true one acts. To it every effect only grows with its size, from what it does where it
changes as much as the truth; what fitting leaves is then

    r = a g_k + e,   e ~ N(0, 1),   a ~ N(0, 1) with |g_k| = TYPICAL

for effect k, and the name with the largest evidence is right more often than any other. How often is drawn anew for
each case, of a true effect that is as large as it is there.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

from concealed.baselines import given
from concealed.responses import Direction, directions, far_end, null, off, slopes
from concealed.scores import SHAPES
from concealed.strength import Noise, Projection
from vehicle_sbi.data.readers import read
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS

DRAWS = 400  # of the noise
TYPICAL = 16.0  # signal-to-noise ratio of an effect, of those that are drawn from 4 to 32
SAME = 1e-6  # of log evidence: sets that are one and the same share the first place
STARTS, LENGTHS_S = 7, (1.5, 5.0)  # at which what begins and ends is looked for
PLACES = (0.1, 0.5, 0.9)  # of the prior's width, at which any other parameter of an effect's shape is

Shape = Sequence[Direction]


def shapes(found: Shape, last: float) -> list[Shape]:
    """Directions of one effect with what gives it its shape at several values each; `last` [s] is the latest time."""
    held = found[0].held
    shaping = [p for p in held if p.name in SHAPES]
    grids = [_grid(p, last) for p in shaping]
    at = [dict(held) | dict(zip(shaping, values, strict=True)) for values in product(*grids)]
    return [[replace(d, held=one) for d in found] for one in at]


def _grid(p: Parameter, last: float) -> Sequence[float]:
    if p.name.endswith(".start"):
        return [float(start) for start in np.linspace(0.0, last, STARTS, endpoint=False)]
    if p.name.endswith(".duration"):
        return LENGTHS_S
    return [p.low + place * (p.high - p.low) for place in PLACES]


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, each in one shape: their names, and the rows of all directions that are theirs."""

    effects: frozenset[str]
    rows: tuple[int, ...]


def hypotheses(names: Sequence[str], rows: Sequence[tuple[int, ...]], count: int) -> list[Hypothesis]:
    """Every set of `count` different effects among shapes that have these names and rows."""
    sets = combinations(range(len(names)), count)
    return [
        Hypothesis(frozenset(names[i] for i in one), tuple(row for i in one for row in rows[i]))
        for one in sets
        if len({names[i] for i in one}) == count
    ]


def evidence(gram: np.ndarray, seen: np.ndarray, rows: Sequence[int]) -> np.ndarray:
    """Log evidence (draws,) of directions of unit prior, over that of nothing: `gram` (K, K) their products with each
    other, `seen` (draws, K) those with what was recorded."""
    H = np.eye(len(rows)) + gram[np.ix_(rows, rows)]
    b = seen[:, rows]
    return 0.5 * np.einsum("di,id->d", b, np.linalg.solve(H, b.T)) - 0.5 * np.linalg.slogdet(H)[1]


def share_right(gram: np.ndarray, meant: np.ndarray, asked: Sequence[Hypothesis], true: frozenset[str]) -> float:
    """How often the true set has the largest evidence: `meant` (K,) is each direction's product with the true change.

    A set's evidence is the mean over its shapes.
    """
    size, axes = np.linalg.eigh(gram)
    root = axes * np.sqrt(np.clip(size, 0.0, None))
    seen = meant + np.random.default_rng(0).standard_normal((DRAWS, len(gram))) @ root.T
    found: dict[frozenset[str], list[np.ndarray]] = {}
    for one in asked:
        found.setdefault(one.effects, []).append(evidence(gram, seen, one.rows))
    sets = list(found)
    total = np.array([logsumexp(found[one], axis=0) - np.log(len(found[one])) for one in sets])
    first = total > total.max(axis=0) - SAME
    return float(np.mean(first[sets.index(true)] / first.sum(axis=0)))


def right(case: Path, truth: Mapping[str, Any], files: Sequence[str]) -> float:
    """How often the observer names all that is concealed in files of a case."""
    told, _ = given(case)
    simulator = told.simulator([read(case / name) for name in files], Noise(**truth["noise"]))
    base = truth["base_parameters"] if truth["level"] == "L0" else truth["base_fit"]
    theta = np.array([base[name] for name in simulator.space.names])
    effects = {
        EFFECT_PARAMETERS[f"{name}.{key}"]: float(value)
        for name, one in truth["effects"].items()
        for key, value in one["parameters"].items()
    }
    return share(simulator, theta, effects)


def share(simulator: Simulator, theta: np.ndarray, truth: Mapping[Parameter, float]) -> float:
    """The same of effects as they are in `truth`, all parameters of each."""
    true = frozenset(p.name.split(".")[0] for p in truth)
    asked = _asked(simulator, theta, truth)
    flat = [d for _, shape in asked for d in shape]
    here = np.array([d.effect in true for d in flat])
    projection = Projection(simulator, theta)

    def left(ends: Sequence[float]) -> np.ndarray:
        return projection.left(slopes(simulator, theta, flat, ends))

    ends = [truth[d.parameter] if d.effect in true else off(d.parameter) for d in flat]
    ends = [off(d.parameter) if end == null(d.parameter) else end for d, end in zip(flat, ends, strict=True)]
    G = left(ends)
    sizes = np.array([truth[d.parameter] - null(d.parameter) if d.effect in true else 0.0 for d in flat])
    changed = sizes @ G
    alike = [_as_large(d.parameter, g, changed) for d, g in zip(flat, G, strict=True)]
    G[~here] = left([end if own else other for own, end, other in zip(here, ends, alike, strict=True)])[~here]
    norm = np.linalg.norm(G, axis=1, keepdims=True)
    G = TYPICAL * np.divide(G, norm, where=norm > 0.0, out=np.zeros_like(G))
    edges = np.cumsum([0, *(len(shape) for _, shape in asked)])
    rows = [tuple(range(low, high)) for low, high in pairwise(edges)]
    names = [name for name, _ in asked]
    return share_right(G @ G.T, G @ changed, hypotheses(names, rows, len(true)), true)


def _asked(simulator: Simulator, theta: np.ndarray, truth: Mapping[Parameter, float]) -> list[tuple[str, Shape]]:
    """Every effect that acts and is not fitted, in each of its shapes; the true ones in their own alone."""
    last = float(simulator.windows.t.max())
    true = {p.name.split(".")[0] for p in truth}
    fitted = {name.split(".")[0] for name in simulator.space.names}
    asked: list[tuple[str, Shape]] = []
    for effect in CATALOGUE.values():
        found = directions(simulator, theta, effect) if effect.name not in fitted else []
        if effect.name in true:
            asked += [(effect.name, [replace(d, held={p: truth[p] for p in d.held}) for d in found])]
        elif found:
            asked += [(effect.name, shape) for shape in shapes(found, last)]
    return asked


def _as_large(p: Parameter, g: np.ndarray, changed: np.ndarray) -> float:
    """The value of a parameter at which it changes as much as was changed, in its box, on the side that looks alike."""
    far, norm = far_end(p), float(np.linalg.norm(g))
    if norm == 0.0:
        return far
    size = math.copysign(float(np.linalg.norm(changed)) / norm, float(g @ changed))
    value = float(np.clip(null(p) + size, p.low, p.high))
    return value if abs(value - null(p)) > 1e-3 * (p.high - p.low) else off(p)


def write(case: Path, truth: Path) -> None:
    """TRUTH's observer beside it, unless it stands already: how often it is right from the recordings that are fitted,
    and from those held out too. None where an effect is unknown to the model, or in real recordings, of which not all
    that is missing is known."""
    sealed, path = json.loads(truth.read_text()), truth.with_suffix(".observer.json")
    known = sealed["effects"] and all(one["inside"] for one in sealed["effects"].values())
    if not known or sealed["level"] == "L2" or path.exists():
        return
    _, content = given(case)
    fitted, further = content["recordings"], content["heldout"] if sealed["heldout_comparable"] else []
    found = {"fitted": right(case, sealed, fitted)}
    found["all"] = right(case, sealed, [*fitted, *further]) if further else found["fitted"]
    write_text(path, json.dumps(found))
