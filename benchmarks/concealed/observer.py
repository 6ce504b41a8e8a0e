"""How often one names what is missing who is told much of what the tool has to find out.

This observer is told the noise, the base model, that one effect of the catalogue is missing (or two), and how strongly
the benchmark conceals effects. To it every effect only grows with its size, from what it does where it changes as much
as the truth. What fitting leaves of the recordings is then

    r = sum_j a_j g_j + e,   e ~ N(0, 1),   a_j ~ N(0, s^2 / q),   |g_j| = 1

with the q directions of an effect and a signal-to-noise ratio s as likely any of those that are drawn, and it names the
set with the largest evidence. How often that is right follows for each case from noise that is drawn anew and a true
effect as it is there. Where an effect starts, or attacks, is tried at several values, the true ones among them.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

from concealed.baselines import given
from concealed.mix import SNRS
from concealed.responses import Direction, directions, far_end, null, off, slopes
from concealed.scores import SHAPES
from concealed.strength import Noise, Projection
from vehicle_sbi.data.readers import read
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS

DRAWS = 400  # of the noise
SAME = 1e-6  # of log evidence: sets that are one and the same share the first place
STARTS, LENGTHS_S = 7, (1.5, 5.0)  # at which what begins and ends is looked for
PLACES = (0.1, 0.5, 0.9)  # of the prior's width, at which any other parameter of an effect's shape is

Shape = Sequence[Direction]
Truth = Mapping[Parameter, float]


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
    """A set of effects, each in one shape: their names, the rows of all directions that are theirs, and the share of
    its effect's strength that each direction has."""

    effects: frozenset[str]
    rows: tuple[int, ...]
    shares: tuple[float, ...]


def hypotheses(names: Sequence[str], rows: Sequence[tuple[int, ...]], count: int) -> list[Hypothesis]:
    """Every set of `count` different effects among shapes that have these names and rows."""
    sets = combinations(range(len(names)), count)
    return [
        Hypothesis(
            frozenset(names[i] for i in one),
            tuple(row for i in one for row in rows[i]),
            tuple(1.0 / math.sqrt(len(rows[i])) for i in one for _ in rows[i]),
        )
        for one in sets
        if len({names[i] for i in one}) == count
    ]


def evidence(gram: np.ndarray, seen: np.ndarray, one: Hypothesis) -> np.ndarray:
    """Log evidence (draws,) of a set over that of nothing, the mean over strengths: `gram` (K, K) are directions'
    products with each other, `seen` (draws, K) those with what was recorded."""
    inside, b = gram[np.ix_(one.rows, one.rows)], seen[:, one.rows]
    each = []
    for snr in SNRS:
        scale = snr * np.array(one.shares)
        H = np.eye(len(scale)) + np.outer(scale, scale) * inside
        x = scale * b
        each.append(0.5 * np.einsum("di,id->d", x, np.linalg.solve(H, x.T)) - 0.5 * np.linalg.slogdet(H)[1])
    return np.asarray(logsumexp(each, axis=0)) - math.log(len(SNRS))


def rate(gram: np.ndarray, meant: np.ndarray, asked: Sequence[Hypothesis], true: frozenset[str]) -> float:
    """How often the true set has the largest evidence: `meant` (K,) is each direction's product with the true change.

    A set's evidence is the mean over its shapes.
    """
    size, axes = np.linalg.eigh(gram)
    root = axes * np.sqrt(np.clip(size, 0.0, None))
    seen = meant + np.random.default_rng(0).standard_normal((DRAWS, len(gram))) @ root.T
    found: dict[frozenset[str], list[np.ndarray]] = {}
    for one in asked:
        found.setdefault(one.effects, []).append(evidence(gram, seen, one))
    sets = list(found)
    total = np.array([np.asarray(logsumexp(found[one], axis=0)) - math.log(len(found[one])) for one in sets])
    first = total > total.max(axis=0) - SAME
    return float(np.mean(first[sets.index(true)] / first.sum(axis=0)))


@dataclass(frozen=True)
class Recorded:
    """The base model at its parameters over recordings: those that are fitted, and those with further ones behind."""

    fitted: Simulator
    all: Simulator
    theta: np.ndarray

    def rates(self, truth: Truth, snr: float) -> dict[str, float]:
        """How often effects with all their parameters are named, from the recordings that are fitted, where they have
        this signal-to-noise ratio, and from all. RuntimeError if they do not act or cannot be simulated."""
        true = frozenset(p.name.split(".")[0] for p in truth)
        asked = self._asked(truth)
        edges = np.cumsum([0, *(len(shape) for _, shape in asked)])
        rows = [tuple(range(low, high)) for low, high in pairwise(edges)]
        sets = hypotheses([name for name, _ in asked], rows, len(true))
        flat = [d for _, shape in asked for d in shape]
        sizes = np.array([_size(d, truth) for d in flat])
        if {d.effect for d, size in zip(flat, sizes, strict=True) if size} != true:
            raise RuntimeError(f"{', '.join(sorted(true))}: not all of it acts")
        changes = self._changes(flat, sizes)
        G = self._left(changes)
        sizes *= snr / float(np.linalg.norm(sizes @ G))
        found = {"fitted": rate_along(G, sizes, sets, true)}
        G = Projection(self.all, self.theta).left(changes)
        return found | {"all": rate_along(G, sizes, sets, true)}

    def _changes(self, flat: Shape, sizes: np.ndarray) -> np.ndarray:
        """Of all series (K, channels, time) per unit of each direction: the true ones at their sizes, others where they
        change as much as the truth or, if that cannot be simulated, from a small step."""
        ends = [null(d.parameter) + size if size else off(d.parameter) for d, size in zip(flat, sizes, strict=True)]
        small = slopes(self.all, self.theta, flat, ends)
        left = self._left(small)
        changed = sizes @ left
        large = [_as_large(d.parameter, g, changed) for d, g in zip(flat, left, strict=True)]
        changes = slopes(self.all, self.theta, flat, np.where(sizes, ends, large).tolist())
        if not self._simulated(small)[sizes != 0.0].all():
            raise RuntimeError("the truth cannot be simulated")
        return np.where(self._simulated(changes)[:, None, None], changes, small)

    @cached_property
    def _projection(self) -> Projection:
        return Projection(self.fitted, self.theta)

    def _left(self, changes: np.ndarray) -> np.ndarray:
        """What fitting leaves of changes of all series, in the recordings that are fitted."""
        return self._projection.left(changes[..., : self.fitted.windows.valid.shape[1]])

    def _simulated(self, changes: np.ndarray) -> np.ndarray:
        """Which of some changes are finite wherever something is fitted."""
        return np.asarray(np.isfinite(np.where(self.all.windows.valid, changes, 0.0)).all(axis=(1, 2)))

    def _asked(self, truth: Truth) -> list[tuple[str, Shape]]:
        """Every effect that acts and is not fitted in each of its shapes, the true ones in their own too."""
        last = float(self.fitted.windows.t.max())
        true = {p.name.split(".")[0] for p in truth}
        fitted = {name.split(".")[0] for name in self.fitted.space.names}
        asked: list[tuple[str, Shape]] = []
        for effect in CATALOGUE.values():
            found = directions(self.fitted, self.theta, effect) if effect.name not in fitted else []
            tried = shapes(found, last) if found else []
            if effect.name in true:
                own = [replace(d, held={p: truth.get(p, null(p)) for p in d.held}) for d in found]
                tried = [own, *tried] if len(tried) > 1 else [own]
            asked += [(effect.name, shape) for shape in tried]
        return asked


def _size(d: Direction, truth: Truth) -> float:
    """How far the truth goes along a direction."""
    same = d.parameter in truth and all(truth.get(p, null(p)) == value for p, value in d.held.items())
    return truth[d.parameter] - null(d.parameter) if same else 0.0


def rate_along(G: np.ndarray, sizes: np.ndarray, sets: Sequence[Hypothesis], true: frozenset[str]) -> float:
    """`rate` of directions (K, n) that have these sizes in truth."""
    norm = np.linalg.norm(G, axis=1, keepdims=True)
    unit = np.divide(G, norm, where=norm > 0.0, out=np.zeros_like(G))
    return rate(unit @ unit.T, unit @ (sizes @ G), sets, true)


def _as_large(p: Parameter, g: np.ndarray, changed: np.ndarray) -> float:
    """The value of a parameter at which it changes as much as was changed, in its box, on the side that looks alike."""
    norm = float(np.linalg.norm(g))
    if norm == 0.0 or not math.isfinite(norm):
        return far_end(p)
    size = math.copysign(float(np.linalg.norm(changed)) / norm, float(g @ changed))
    value = float(np.clip(null(p) + size, p.low, p.high))
    return value if abs(value - null(p)) > 1e-3 * (p.high - p.low) else off(p)


def named(case: Path, truth: Mapping[str, Any]) -> dict[str, float]:
    """How often the observer names all that is concealed in a case."""
    told, content = given(case)
    fitted, further = content["recordings"], content["heldout"] if truth["heldout_comparable"] else []
    noise = Noise(**truth["noise"])
    recordings = [read(case / name) for name in (*fitted, *further)]
    simulator, whole = (told.simulator(part, noise) for part in (recordings[: len(fitted)], recordings))
    base = truth["base_parameters"] if truth["level"] == "L0" else truth["base_fit"]
    recorded = Recorded(simulator, whole, np.array([base[name] for name in simulator.space.names]))
    effects = {
        EFFECT_PARAMETERS[f"{name}.{key}"]: float(value)
        for name, one in truth["effects"].items()
        for key, value in one["parameters"].items()
    }
    return recorded.rates(effects, truth["snr"])


def write(case: Path, truth: Path) -> None:
    """TRUTH's observer beside it, unless it stands already; none where an effect is unknown to the model, or in real
    recordings, of which not all that is missing is known."""
    sealed, path = json.loads(truth.read_text()), truth.with_suffix(".observer.json")
    known = sealed["effects"] and all(one["inside"] for one in sealed["effects"].values())
    if known and sealed["level"] != "L2" and not path.exists():
        write_text(path, json.dumps(named(case, sealed)))
