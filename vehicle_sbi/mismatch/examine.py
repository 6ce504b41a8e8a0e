"""A model, what it leaves over, and which effects promise to explain that, each in the way in which it is likeliest.

Everything here is of first order about the model's fit: one direction, all directions of an effect together, and, of
what comes and goes, every span of time.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.directions import STEPS, Direction, allowed, null, shared, tile
from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.beyond import Beyond
from vehicle_sbi.mismatch.detect import Scores, score
from vehicle_sbi.mismatch.fit import Fit, log_volume
from vehicle_sbi.mismatch.laws import Law
from vehicle_sbi.mismatch.linear import Linearised, profile
from vehicle_sbi.mismatch.locate import Block
from vehicle_sbi.mismatch.loose import Loose
from vehicle_sbi.mismatch.repertoire import Inventory, Repertoire
from vehicle_sbi.parameters import Parameter

LEVEL = 0.05  # of the test whether anything is missing
ALIKE = 0.98  # coherence with a direction of the catalogue from which a law says nothing new
NEAR = 8.0  # of evidence, within which another shape is worth a fit of its own
BEST_STEPS = 3  # larger steps along a parameter, from which it is fitted
AS_SIMULATED = 0.1  # part of them by which they may be off
TOLERANCE = 0.1  # of what a model explains may be left over: no effect is modelled perfectly
TOLD = 0.3  # power of the likelihood of what a model foretells, which whatever else is missing spoils


@dataclass(frozen=True)
class Model:
    """The base model with a set of effects, fitted; `explained` is the score of all of them together.

    `outside` is what it has beside them that the catalogue does not, one of so many `choice`; `told` how much likelier
    it makes recordings that it was not fitted to than the base model does (log likelihood), `posterior` draws of its
    parameters where a normal about the fit is not what is said of them, `base` the parameters that the base model
    has, which may be an effect's too.
    """

    effects: tuple[str, ...]
    fit: Fit
    explained: float
    outside: Law | Loose | Beyond | None = None
    choice: int = 1
    told: float = 0.0
    posterior: Float[np.ndarray, "n d"] | None = None
    base: tuple[str, ...] = ()

    @property
    def own(self) -> Bool[np.ndarray, " d"]:
        """Which parameters came with its effects."""
        names = self.fit.simulator.space.names
        return np.array([name.split(".")[0] in self.effects and name not in self.base for name in names])

    @property
    def log_evidence(self) -> float:
        return self.fit.log_evidence + (self.outside.gain if isinstance(self.outside, Loose) else 0.0)

    def weight(self, belief: Belief, power: float = 1.0) -> float:
        """Log prior plus log evidence, that of what is foretold included, the evidence to a power."""
        laws = None if self.outside is None else self.choice
        return belief.log_prior(len(self.effects), laws) + power * (self.log_evidence + TOLD * self.told)


@dataclass(frozen=True)
class Joint:
    """All directions of one effect together, each in its best shape: rows of the directions, sizes, log evidence."""

    rows: list[int]
    size: Float[np.ndarray, " q"]
    gain: float
    log_evidence: float


@dataclass(frozen=True)
class Examined:
    """A model with everything that it leaves out, and the scores of it all.

    Each channel's blocks of time are scored together too; `joint` are effects that have several directions, `starts`
    where else to start fitting along parameters that come and go or do not change in proportion, the likeliest first.
    """

    model: Model
    free: Inventory
    scores: Scores
    joint: dict[str, Joint]
    starts: dict[Parameter, list[dict[Parameter, float]]]

    @cached_property
    def p_value(self) -> float:
        """How often noise alone would leave as much over."""
        return self.scores.p_value()

    @cached_property
    def p_adequate(self) -> float:
        """The same, beyond what no model gets right."""
        return self.scores.p_value(tolerated=TOLERANCE * self.model.explained)

    @property
    def share_explained(self) -> float:
        """Of the squared score of everything that was found, what the model explains."""
        left = float(np.abs(self.scores.z).max(initial=0.0)) if self.p_value < LEVEL else 0.0
        return self.model.explained**2 / max(self.model.explained**2 + left**2, 1e-12)

    @property
    def largest_block(self) -> Block:
        """Where most is left over."""
        return self.free.blocks[int(np.argmax(np.abs(self.scores.z[self.free.of_blocks])))]


@dataclass(frozen=True)
class Version:
    """A way in which an effect may act: its parameters and where to start fitting them, with what speaks for it.

    It is fitted from each of its shapes (where a force attacks); if it comes and goes, from the likeliest of all spans
    of time as well as from the best of those that were scored; if it does not change in proportion, from larger steps.
    """

    effect: str
    starts: list[dict[Parameter, float]]
    log_evidence: float
    score: float


def examine(model: Model, repertoire: Repertoire, rng: np.random.Generator) -> Examined:
    """Scores of all in a repertoire that a model leaves out."""
    free = repertoire.beyond(model.fit)
    about = Linearised.of(model.fit)
    free = free.ruled_by(about.coherence(free.ruled, free.named).max(axis=1, initial=0.0) < ALIKE)
    scores = score(model.fit, free.changes, *free.of.bounds, rng=rng, together=_stretches(free.of))
    return Examined(model, free.of, scores, _joint(about, free, scores), _starts(about, free))


def glance(model: Model, repertoire: Repertoire, rng: np.random.Generator) -> Examined:
    """The same of directions alone and without a null: enough to say which effects promise most."""
    free = repertoire.beyond(model.fit).alone()
    scores = score(model.fit, free.changes, *free.of.bounds, rng=rng, draws=0)
    about = Linearised.of(model.fit)
    return Examined(model, free.of, scores, _joint(about, free, scores), _starts(about, free))


def _stretches(free: Inventory) -> list[list[int]]:
    """Rows of the blocks of time of each channel."""
    rows: dict[str, list[int]] = {}
    for k, block in enumerate(free.blocks, start=free.of_blocks.start):
        if not block.regime:
            rows.setdefault(block.channel, []).append(k)
    return [*rows.values()]


def _by_effect(found: Sequence[Direction]) -> dict[str, dict[str, list[int]]]:
    """Rows of the directions of each effect and of each of its parameters."""
    rows: dict[str, dict[str, list[int]]] = {}
    for k, direction in enumerate(found):
        rows.setdefault(direction.effect, {}).setdefault(direction.parameter.name, []).append(k)
    return rows


def _joint(about: Linearised, free: Repertoire, scores: Scores) -> dict[str, Joint]:
    """Effects with several directions: all of them at once, sizes as likely anywhere in their boxes."""
    found, changes, simulator = free.of.directions, free.named, about.fit.simulator
    together = {}
    for effect, every in _by_effect(found).items():
        by_parameter = {name: rows for name, rows in every.items() if not shared(simulator, name, [*every])}
        if len(by_parameter) < 2:
            continue
        rows = [ks[int(np.argmax(scores.gain[ks]))] for ks in by_parameter.values()]
        low, high = (np.array([[getattr(found[k], end) for k in rows]]) for end in ("low", "high"))
        best = profile(about, changes[rows][None], low, high)
        gain = float(best.log_likelihood[0] - about.alone)
        spread = (high - low)[0] / np.sqrt(12.0)
        volume = log_volume(best.information[0] * np.outer(spread, spread))
        together[effect] = Joint(rows, best.size[0], gain, gain + volume)
    return together


def _starts(about: Linearised, free: Repertoire) -> dict[Parameter, list[dict[Parameter, float]]]:
    """Where to start fitting, beside where directions are scored: the likeliest spans, and larger steps as they are."""
    spans, steps = _spans(about, free), _larger_steps(about, free)
    return {p: [*spans.get(p, []), *steps.get(p, [])] for p in spans.keys() | steps.keys()}


def _larger_steps(about: Linearised, free: Repertoire) -> dict[Parameter, list[dict[Parameter, float]]]:
    """Along parameters that do not change as much in proportion, the larger steps that are likeliest as they were
    simulated, and likelier than none: no other size follows from what they do."""
    rows = [k for k, d in enumerate(free.of.directions) if d.step > STEPS[0]]
    if not rows:
        return {}
    found = [free.of.directions[k] for k in rows]
    size = np.array([[d.away - null(d.parameter)] for d in found])
    reach = AS_SIMULATED * np.abs(size)
    likelihood = profile(about, free.named[rows][:, None], size - reach, size + reach).log_likelihood
    helpful = np.flatnonzero(likelihood > about.alone)
    starts: dict[Parameter, list[dict[Parameter, float]]] = {}
    for k in helpful[np.argsort(-likelihood[helpful])]:
        along = starts.setdefault(found[k].parameter, [])
        if len(along) < BEST_STEPS:
            along.append(_sized([found[k]], size[k]))
    return starts


def _spans(about: Linearised, free: Repertoire) -> dict[Parameter, list[dict[Parameter, float]]]:
    """Of what comes and goes, from when to when and how large they are likeliest to be in each of their other shapes,
    of all whole tiles; the likeliest shape first."""
    seconds = tile(about.fit.simulator)
    found: dict[Parameter, list[tuple[float, dict[Parameter, float]]]] = {}
    for rows in _tiled(free.of.directions, seconds):
        first = free.of.directions[rows[0]]
        sums = np.concatenate([np.zeros_like(free.named[:1]), np.cumsum(free.named[rows], axis=0)])
        pairs = itertools.combinations(range(len(sums)), 2)
        spans = [(start, stop) for start, stop in pairs if allowed(first, stop - start, seconds)]
        changes = np.array([sums[stop] - sums[start] for start, stop in spans])
        low, high = (np.full((len(spans), 1), end) for end in (first.low, first.high))
        tried = profile(about, changes[:, None], low, high)
        k = int(np.argmax(tried.log_likelihood))
        start, stop = spans[k]
        span = first.during(start * seconds, (stop - start) * seconds)
        found.setdefault(first.parameter, []).append((float(tried.log_likelihood[k]), _sized([span], tried.size[k])))
    return {along: _likeliest(each) for along, each in found.items()}


def _likeliest(found: list[tuple[float, dict[Parameter, float]]]) -> list[dict[Parameter, float]]:
    """Starts in the order of their likelihoods, as far as those come near the best."""
    best = max(likelihood for likelihood, _ in found)
    return [start for likelihood, start in sorted(found, key=lambda one: -one[0]) if likelihood > best - NEAR]


def _tiled(found: Sequence[Direction], seconds: float) -> list[list[int]]:
    """Rows of directions that last one tile, in order of time; a list for each shape that they have otherwise."""
    rows: dict[tuple[str, tuple[float, ...]], list[int]] = {}
    for k, d in enumerate(found):
        if d.clocked and np.isclose(d.held[d.clocked["duration"]], seconds):
            rows.setdefault(d.during(0.0, 0.0).key, []).append(k)
    return [*rows.values()]


def versions(examined: Examined) -> list[Version]:
    """The best way in which each effect may act, the most promising effect first."""
    found = [
        _version(examined, name, list(rows.values())) for name, rows in _by_effect(examined.free.directions).items()
    ]
    return sorted(found, key=lambda version: -version.log_evidence)


def _version(examined: Examined, effect: str, rows: Sequence[list[int]]) -> Version:
    """The likeliest of: one of the effect's parameters alone (averaged over its shapes), or all of them together."""
    scores = examined.scores
    evidence = scores.log_evidence
    singles = [float(np.logaddexp.reduce(evidence[ks]) - np.log(len(ks))) for ks in rows]
    leading = [ks[int(np.argmax(evidence[ks]))] for ks in rows]
    joint = examined.joint.get(effect)
    if joint is not None and joint.log_evidence > max(singles):
        start = _start(examined, joint.rows, joint.size)
        return Version(effect, [start], joint.log_evidence, np.sqrt(2 * joint.gain))
    best = int(np.argmax(singles))
    k = leading[best]
    scored = [_start(examined, [row], scores.size[[row]]) for row in _of_each_shape(examined, rows[best])]
    along = examined.free.directions[k].parameter
    others = [start for start in examined.starts.get(along, []) if start not in scored]
    return Version(effect, [*others, *scored], singles[best], float(np.abs(scores.z[k])))


def _of_each_shape(examined: Examined, rows: Sequence[int]) -> list[int]:
    """The row with the most evidence of each shape that a direction has, spans of time apart; of those that come near
    the best."""
    evidence, best = examined.scores.log_evidence, dict[tuple[float, ...], int]()
    for k in sorted(rows, key=lambda k: -evidence[k]):
        d = examined.free.directions[k]
        best.setdefault(tuple(value for p, value in d.held.items() if p not in d.clocked.values()), k)
    return [k for k in best.values() if evidence[k] > evidence[rows].max() - NEAR]


def _start(examined: Examined, rows: list[int], sizes: Float[np.ndarray, " q"]) -> dict[Parameter, float]:
    """Where to start fitting: shapes as they were tried, sizes as they came out."""
    return _sized([examined.free.directions[k] for k in rows], sizes)


def _sized(chosen: Sequence[Direction], sizes: Float[np.ndarray, " q"]) -> dict[Parameter, float]:
    """Parameters of directions at some sizes, off the rim of their boxes."""
    start = {p: value for d in chosen for p, value in d.held.items()}
    for d, size in zip(chosen, sizes, strict=True):
        start[d.parameter] = null(d.parameter) + float(np.clip(size, 0.98 * d.low, 0.98 * d.high))
    return start
