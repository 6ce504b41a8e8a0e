"""What was left out: sets of effects, their evidence, none and unknown, and what this recording cannot tell apart.

From the base model on, the most promising effects by their first-order scores are put into the model and all its
parameters are fitted again, under noise of its own. A model that still leaves something over is extended further.
Beside each stand laws that no effect of the catalogue has, fitted alike: those that do better make *unknown* probable,
and so does what the best set leaves over, by how often noise alone would leave as much. Probabilities follow from
Laplace's evidence and a prior that is reluctant to add effects.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.candidates import Direction, allowed, null, tile, within
from vehicle_sbi.mismatch.detect import Linearised, Scores, profile, score
from vehicle_sbi.mismatch.fit import Fit, descend, likeliest, with_own_noise
from vehicle_sbi.mismatch.laws import Law, under
from vehicle_sbi.mismatch.locate import Block
from vehicle_sbi.mismatch.repertoire import Inventory, Repertoire
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE

LEVEL = 0.05  # of the test whether anything is missing
TRIED = 8  # effects at most that are fitted fully beside each model
LEAST_SHARE, SLACK = 0.65, 8.0  # of the best one's first-order evidence that they need, and by how much it may be off
BEAM = 2  # models that are extended further
ALIKE = 0.98  # coherence with a direction of the catalogue from which a law says nothing new
LAWS_TRIED = 2  # that are fitted fully beside a model
SURPRISE = 0.2  # exponent of the density of p-values under something unknown, SURPRISE p^(SURPRISE - 1)
TEMPER = 0.6  # power of the evidence; it and UNKNOWN were set on 63 simulated diagnoses
TOLERANCE = 0.1  # of what a model explains may be left over: no effect is modelled perfectly
NOISE_ROUNDS, STEPS = 2, 6  # of the fit of an extended model
BENEFIT = 0.1  # of the doubt: what is kept of a set's probability that held-out recordings speak against
HOPELESS = 2.0  # first-order evidence below which no further effect outweighs the reluctance to add one
BELIEF = Belief()


@dataclass(frozen=True)
class Model:
    """The base model with a set of effects, fitted; `explained` is the score of all of them together.

    `law` is what it has beside them that the catalogue does not, `choice` the number of laws that it was chosen from.
    """

    effects: tuple[str, ...]
    fit: Fit
    explained: float
    law: Law | None = None
    choice: int = 1

    @property
    def log_evidence(self) -> float:
        return self.fit.log_evidence

    def weight(self, belief: Belief) -> float:
        """Log prior plus log evidence."""
        laws = None if self.law is None else self.choice
        return belief.log_prior(len(self.effects), laws) + self.log_evidence


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

    Each channel's blocks of time are scored together too; `joint` are effects that have several directions, `spans`
    where to start fitting those that come and go.
    """

    model: Model
    free: Inventory
    scores: Scores
    joint: dict[str, Joint]
    spans: dict[str, dict[Parameter, float]]

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

    An effect that comes and goes has two: the likeliest of all spans of time, and the best of those that were scored.
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
    return Examined(model, free.of, scores, _joint(about, free, scores), _spans(about, free))


def glance(model: Model, repertoire: Repertoire, rng: np.random.Generator) -> Examined:
    """The same of directions alone and without a null: enough to say which effects promise most."""
    free = repertoire.beyond(model.fit).alone()
    scores = score(model.fit, free.changes, *free.of.bounds, rng=rng, draws=0)
    about = Linearised.of(model.fit)
    return Examined(model, free.of, scores, _joint(about, free, scores), _spans(about, free))


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
    """Effects with several directions: all of them at once, under normal priors as wide as their boxes."""
    found, changes, nothing = free.of.directions, free.named, np.zeros((1, 0))
    base = profile(about, changes[None, :0], nothing, nothing).log_likelihood[0]
    together = {}
    for effect, by_parameter in _by_effect(found).items():
        if len(by_parameter) < 2:
            continue
        rows = [ks[int(np.argmax(scores.gain[ks]))] for ks in by_parameter.values()]
        low, high = (np.array([[getattr(found[k], end) for k in rows]]) for end in ("low", "high"))
        best = profile(about, changes[rows][None], low, high)
        gain = float(best.log_likelihood[0] - base)
        _, log_det = np.linalg.slogdet(np.eye(len(rows)) + best.information[0] * (high - low)[0] ** 2 / 12.0)
        together[effect] = Joint(rows, best.size[0], gain, gain - 0.5 * float(log_det))
    return together


def _spans(about: Linearised, free: Repertoire) -> dict[str, dict[Parameter, float]]:
    """Effects that come and go, from when to when and how large they are likeliest to be, of all whole tiles."""
    seconds = tile(about.fit.simulator)
    found: dict[str, tuple[float, dict[Parameter, float]]] = {}
    for rows in _tiled(free.of.directions, seconds):
        first = free.of.directions[rows[0]]
        sums = np.concatenate([np.zeros_like(free.named[:1]), np.cumsum(free.named[rows], axis=0)])
        pairs = itertools.combinations(range(len(sums)), 2)
        spans = [(start, stop) for start, stop in pairs if allowed(first, stop - start, seconds)]
        changes = np.array([sums[stop] - sums[start] for start, stop in spans])
        low, high = (np.full((len(spans), 1), end) for end in (first.low, first.high))
        tried = profile(about, changes[:, None], low, high)
        k = int(np.argmax(tried.log_likelihood))
        if first.effect not in found or tried.log_likelihood[k] > found[first.effect][0]:
            start, stop = spans[k]
            span = first.during(start * seconds, (stop - start) * seconds)
            found[first.effect] = float(tried.log_likelihood[k]), _sized([span], tried.size[k])
    return {effect: start for effect, (_, start) in found.items()}


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
    starts = [_start(examined, [k], scores.size[[k]])]
    if effect in examined.spans:
        starts.insert(0, examined.spans[effect])
    return Version(effect, starts, singles[best], float(np.abs(scores.z[k])))


def _start(examined: Examined, rows: list[int], sizes: Float[np.ndarray, " q"]) -> dict[Parameter, float]:
    """Where to start fitting: shapes as they were tried, sizes as they came out."""
    return _sized([examined.free.directions[k] for k in rows], sizes)


def _sized(chosen: Sequence[Direction], sizes: Float[np.ndarray, " q"]) -> dict[Parameter, float]:
    """Parameters of directions at some sizes, off the rim of their boxes."""
    start = {p: value for d in chosen for p, value in d.held.items()}
    for d, size in zip(chosen, sizes, strict=True):
        start[d.parameter] = null(d.parameter) + float(np.clip(size, 0.98 * d.low, 0.98 * d.high))
    return start


def extended(model: Model, version: Version) -> Model | None:
    """The model with one more effect, all parameters fitted under noise of its own; None if it cannot be simulated."""
    simulator = model.fit.simulator
    boxes = {p.name: p for p in within(simulator, CATALOGUE[version.effect]).parameters}
    added = [boxes[p.name] for p in version.starts[0]]
    wider = model.fit.observation.extended(
        replace(simulator, space=ParameterSpace((*simulator.space.parameters, *added)))
    )
    space = wider.simulator.space
    points = [
        np.clip(np.concatenate([model.fit.theta, list(start.values())]), space.low, space.high)
        for start in version.starts
    ]
    fits = [fit for point in points if (fit := likeliest(wider, point, STEPS)) is not None]
    if not fits:
        return None
    fit = with_own_noise(max(fits, key=lambda fit: fit.log_likelihood), NOISE_ROUNDS, STEPS)
    effects = tuple(sorted({*model.effects, version.effect}))  # another parameter of an effect is no further effect
    return Model(effects, fit, float(np.hypot(model.explained, version.score)))


def ruled(examined: Examined) -> Iterator[Model]:
    """The model with each of the few laws that promise most."""
    model, of_laws = examined.model, examined.free.of_laws
    evidence, size = examined.scores.log_evidence[of_laws], examined.scores.size[of_laws]
    for k in np.argsort(-evidence)[:LAWS_TRIED]:
        if evidence[k] < HOPELESS:
            return
        law = examined.free.laws[k]
        start = np.append(model.fit.theta, np.clip(size[k], 0.98 * law.target.size.low, 0.98 * law.target.size.high))
        found = descend(model.fit.observation.extended(under(model.fit.simulator, law)), start, STEPS)
        if found is not None:
            fit = with_own_noise(found, NOISE_ROUNDS, STEPS)
            yield Model(model.effects, fit, model.explained, law, len(examined.free.laws))


def without(model: Model, effect: str) -> Model | None:
    """The model with one effect fewer, all other parameters fitted; None if it cannot be simulated."""
    simulator, theta = model.fit.simulator, model.fit.theta
    kept = [k for k, name in enumerate(simulator.space.names) if name.split(".")[0] != effect]
    space = ParameterSpace(tuple(simulator.space.parameters[k] for k in kept))
    found = descend(model.fit.observation.extended(replace(simulator, space=space)), theta[kept], STEPS)
    if found is None:
        return None
    rest = tuple(name for name in model.effects if name != effect)
    return Model(rest, with_own_noise(found, NOISE_ROUNDS, STEPS), model.explained)


@dataclass(frozen=True)
class Explanation:
    """Sets of effects, the most probable first, beside the base model and the best one, which were examined.

    `unnamed` are models with a law that the catalogue does not have, the most probable first; `doubted` sets predict
    what was held out worse than the base model, so that most of their probability is that of something unknown.
    """

    models: list[Model]
    unnamed: list[Model]
    base: Examined
    best: Examined
    belief: Belief
    doubted: frozenset[tuple[str, ...]] = frozenset()

    def doubting(self, effects: Iterable[tuple[str, ...]]) -> "Explanation":
        """With doubts about some sets."""
        found = replace(self, doubted=frozenset(effects))
        order = np.argsort(-np.array(found.probability), kind="stable")
        return replace(found, models=[self.models[k] for k in order])

    @cached_property
    def _shares(self) -> Float[np.ndarray, " k"]:
        """Probabilities of all sets, of all with a law, of none and of what is left over, in this order.

        Evidence is tempered: it takes the noise for exactly what it was modelled as and the search for complete, and
        so comes out too sure. What is unknown is as probable as what the best model leaves over is surprising.
        """
        models = (*self.models, *self.unnamed, self.base.model, self.best.model)
        weights = TEMPER * np.array([model.weight(self.belief) for model in models])
        weights[-1] += np.log(self.belief.unknown * SURPRISE) + (SURPRISE - 1.0) * np.log(self.best.p_adequate)
        shares = np.exp(weights - np.logaddexp.reduce(weights))
        for k, model in enumerate(self.models):
            if model.effects in self.doubted:
                shares[-1] += (1.0 - BENEFIT) * shares[k]
                shares[k] *= BENEFIT
        return shares

    @property
    def probability(self) -> list[float]:
        """Of each set of effects."""
        return self._shares[: len(self.models)].tolist()

    @property
    def laws(self) -> list[tuple[Model, float]]:
        """Models with a law that the catalogue does not have, and their probabilities."""
        return list(zip(self.unnamed, self._shares[len(self.models) : -2].tolist(), strict=True))

    @cached_property
    def beside_unknown(self) -> dict[tuple[str, ...], float]:
        """How probable it is that a set of known effects and something unknown are missing, the most probable first.

        The empty set is among them. Laws are fitted beside the best set of a size alone; beside the others they are
        taken to do as well.
        """
        found: dict[tuple[str, ...], float] = {}
        for effects, share in [*((model.effects, p) for model, p in self.laws), (self.best.model.effects, self._left)]:
            for stand_in, part in self._stand_ins(effects).items():
                found[stand_in] = found.get(stand_in, 0.0) + share * part
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def _stand_ins(self, effects: tuple[str, ...]) -> dict[tuple[str, ...], float]:
        """Sets as large as this one, by how probable they are among themselves; itself if there are none."""
        alike = [model for model in self.models if len(model.effects) == len(effects)]
        if not alike:
            return {effects: 1.0}
        weight = TEMPER * np.array([model.weight(self.belief) for model in alike])
        parts = np.exp(weight - np.logaddexp.reduce(weight))
        return {model.effects: float(part) for model, part in zip(alike, parts, strict=True)}

    @property
    def _left(self) -> float:
        """Probability of what the best set leaves over being something that no law explains either."""
        return float(self._shares[-1])

    @property
    def p_none(self) -> float:
        """That nothing is missing."""
        return float(self._shares[-2])

    @property
    def p_unknown(self) -> float:
        """That something is missing which no set of known effects explains."""
        return min(float(sum(self.beside_unknown.values())), 1.0)

    @property
    def p_value(self) -> float:
        """How often noise alone would look as much as if something were missing."""
        return self.base.p_value

    @property
    def detected(self) -> bool:
        return self.p_value < LEVEL

    def indistinguishable(self, share: float = 0.9) -> list[tuple[str, ...]]:
        """The smallest set of explanations that holds `share` of the probability of all named ones."""
        total, kept = sum(self.probability), []
        for model, probability in zip(self.models, self.probability, strict=True):
            kept.append(model.effects)
            share -= probability / total if total > 0 else 1.0
            if share <= 0:
                break
        return kept


def explain(
    base: Fit,
    known: Sequence[Direction],
    *,
    rng: np.random.Generator,
    belief: Belief = BELIEF,
    tried: Callable[[str], None] = lambda name: None,
) -> Explanation:
    """Search sets of effects from the base model on, among the directions that are known to act at its fit.

    `tried` is told the name of each set once it is fitted.
    """

    def weight(model: Model) -> float:
        return model.weight(belief)

    none = Model((), base, 0.0)
    repertoire = Repertoire.around(base, known)
    first = examine(none, repertoire, rng)
    pool: dict[tuple[str, ...], Model] = {(): none}
    best = first
    frontier = [first] if first.p_value < LEVEL else []
    unnamed = [*ruled(first)] if frontier else []
    promising = {version.effect for version in versions(first)[:TRIED]}
    for _ in range(belief.most):
        grown: dict[tuple[str, ...], Model] = {}
        for model in (model for examined in frontier for model in _grow(examined)):
            tried(" + ".join(model.effects))
            known_already = grown.get(model.effects) or pool.get(model.effects)
            if known_already is None or weight(model) > weight(known_already):
                grown[model.effects] = model
        pool |= grown
        leading = sorted(grown.values(), key=weight, reverse=True)[:BEAM]
        if not leading or weight(leading[0]) <= weight(best.model):
            break
        best = examine(leading[0], repertoire, rng)
        if best.p_value > LEVEL:
            break
        frontier = [best, *(examine(model, repertoire, rng) for model in leading[1:])]
        unnamed += ruled(best)
        promising |= {version.effect for examined in frontier for version in versions(examined)[:TRIED]}
    unnamed.sort(key=weight, reverse=True)
    for model in _exchanged(best.model, repertoire.only(promising), rng):
        tried(" + ".join(model.effects))
        pool.setdefault(model.effects, model)
    named = sorted((model for model in pool.values() if model.effects), key=weight, reverse=True)
    if named and weight(named[0]) > weight(best.model):
        best = examine(named[0], repertoire, rng)
    return Explanation(named, unnamed, first, best, belief)


def _exchanged(model: Model, repertoire: Repertoire, rng: np.random.Generator) -> Iterator[Model]:
    """A set of several effects with each of them exchanged for others that promise as much in its place.

    The search has grown the set one by one, and so has not seen what could stand in for those that came first.
    """
    for effect in model.effects if len(model.effects) > 1 else ():
        if (rest := without(model, effect)) is not None:
            yield from _grow(glance(rest, repertoire, rng))


def _grow(examined: Examined) -> Iterator[Model]:
    """The model with each of its most promising effects."""
    promising = versions(examined)[:TRIED]
    for i, version in enumerate(promising):
        needed = max(LEAST_SHARE * promising[0].log_evidence - SLACK, HOPELESS)
        if version.log_evidence < needed and (i > 0 or examined.model.effects):
            return
        if version.score > 0 and (model := extended(examined.model, version)) is not None:
            yield model
