"""What was left out: sets of effects, their evidence, none and unknown, and what this recording cannot tell apart.

From the base model on, the most promising effects by their first-order scores are put into the model and all its
parameters are fitted again, under noise of its own. A model that still leaves something over is extended further.
Beside each stand laws that no effect of the catalogue has, fitted alike: those that do better make *unknown* probable,
and so does what the best set leaves over, by how often noise alone would leave as much. Probabilities follow from
Laplace's evidence and a prior that is reluctant to add effects. Further recordings, which nothing is fitted to, count
by how likely each model makes them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.candidates import Direction, within
from vehicle_sbi.mismatch.examine import LEVEL, Examined, Model, Version, examine, glance, versions
from vehicle_sbi.mismatch.fit import Fit, Observation, descend, likeliest, with_own_noise
from vehicle_sbi.mismatch.foretell import Foretold, foretold
from vehicle_sbi.mismatch.laws import under
from vehicle_sbi.mismatch.repertoire import Repertoire
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE

TRIED = 8  # effects at most that are fitted fully beside each model
LEAST_SHARE, SLACK = 0.65, 8.0  # of the best one's first-order evidence that they need, and by how much it may be off
BEAM = 2  # models that are extended further
LAWS_TRIED = 2  # that are fitted fully beside a model
SURPRISE = 0.2  # exponent of the density of p-values under something unknown, SURPRISE p^(SURPRISE - 1)
SURPRISE_TOLD = 0.5  # the same for the p-value of what is foretold
FAILED = -1e3  # log likelihood of what cannot be simulated
DOUBTED = -1.0  # log likelihood of what is foretold, beyond the base model's, below which a set is doubted
BENEFIT = 0.1  # of the doubt: what is kept of its odds
TEMPER = 0.5  # power of the evidence where the best set leaves nothing over
LAPSE = 0.05  # probability that search or noise model fail, which is something unknown's too
NOISE_ROUNDS, STEPS = 2, 6  # of the fit of an extended model
TOLD_APART = 3  # digits of a probability
LEAST_P = 1e-9  # that counts as one
HOPELESS = 2.0  # first-order evidence below which no further effect outweighs the reluctance to add one
BELIEF = Belief()


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

    `unnamed` are models with a law that the catalogue does not have, the most probable first; `p_told` is how often
    the best one's parameters would seem to move as much from one recording to another, if anything was foretold.
    """

    models: list[Model]
    unnamed: list[Model]
    base: Examined
    best: Examined
    belief: Belief
    p_told: float | None = None

    def foretelling(self, further: Observation, *, apart: bool) -> "Explanation":
        """With what further recordings say of each model; as it is where the base model fails there."""
        base = foretold(self.base.model, further, apart=apart)
        if base is None or not self.detected:
            return self
        best = _told(self.best.model, base, further, apart)
        models, unnamed = (
            [_told(model, base, further, apart)[0] for model in some] for some in (self.models, self.unnamed)
        )
        told = replace(self, models=models, unnamed=unnamed, best=replace(self.best, model=best[0]), p_told=best[1])
        return told.in_order()

    def in_order(self) -> "Explanation":
        """Sets by how probable they are; those that are hardly so alone by how probable beside something unknown."""
        ranked = sorted(
            zip(self.models, self.probability, self.standing, strict=True),
            key=lambda one: (-round(one[1], TOLD_APART), -one[2]),
        )
        return replace(self, models=[model for model, _, _ in ranked])

    @property
    def standing(self) -> list[float]:
        """How probable each set is, alone or beside something unknown."""
        beside = self.beside_unknown
        return [p + beside.get(model.effects, 0.0) for model, p in zip(self.models, self.probability, strict=True)]

    @cached_property
    def _shares(self) -> Float[np.ndarray, " k"]:
        """Probabilities of all sets, of all with a law, of none and of what is left over, in this order.

        Evidence is tempered: it takes the noise for exactly what it was modelled as, and so comes out too sure; the
        more so, the more the best set leaves over. What is unknown is as probable as what the best set leaves over, and
        how its parameters move from one recording to another, are surprising. What a right set adds to the base model
        does not harm it elsewhere; one that does is doubted.
        """
        models = (*self.models, *self.unnamed, self.base.model, self.best.model)
        weights = self._temper * np.array([model.weight(self.belief) for model in models])
        weights[: len(self.models)] += np.log([BENEFIT if doubted(model) else 1.0 for model in self.models])
        weights[-1] += np.log(self.belief.unknown) + _surprise(self.best.p_adequate, SURPRISE)
        if self.p_told is not None:
            weights[-1] += _surprise(self.p_told, SURPRISE_TOLD)
        shares = (1.0 - LAPSE) * np.exp(weights - np.logaddexp.reduce(weights))
        shares[-1] += LAPSE
        return shares

    @property
    def _temper(self) -> float:
        """Power of the evidence: deviations as large as what is left over would have come out by chance."""
        return TEMPER / self.best.scores.excess

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
        weight = self._temper * np.array([model.weight(self.belief) for model in alike])
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
        standing = np.array(self.standing)
        order = np.argsort(-standing, kind="stable")
        held = np.cumsum(standing[order]) / max(float(standing.sum()), 1e-300)
        return [self.models[k].effects for k in order[: int(np.searchsorted(held, share)) + 1]]


def doubted(model: Model) -> bool:
    """Whether further recordings are less likely under the model than under the base model."""
    return model.told < DOUBTED


def _told(model: Model, base: Foretold, further: Observation, apart: bool) -> tuple[Model, float]:
    """The model with what it foretells of further recordings beyond the base model, and the p-value of that."""
    found = foretold(model, further, apart=apart)
    if found is None:
        return replace(model, told=FAILED), LEAST_P
    return replace(model, told=found.log_likelihood - base.log_likelihood), found.p_value


def _surprise(p: float, exponent: float) -> float:
    """Log density of a p-value under something unknown, against that of nothing."""
    return float(np.log(exponent) + (exponent - 1.0) * np.log(max(p, LEAST_P)))


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
    for model in exchanged(best.model, repertoire.only(promising), rng):
        tried(" + ".join(model.effects))
        pool[model.effects] = max(model, pool.get(model.effects, model), key=weight)
    named = sorted((model for model in pool.values() if model.effects), key=weight, reverse=True)
    if named and weight(named[0]) > weight(best.model):
        best = examine(named[0], repertoire, rng)
    return Explanation(named, unnamed, first, best, belief).in_order()


def exchanged(model: Model, repertoire: Repertoire, rng: np.random.Generator) -> Iterator[Model]:
    """A set of several effects without each of them, and with others that promise as much in its place.

    The search has grown the set one by one, and so has not seen what could stand in for those that came first; nor what
    the base model's parameters can do without them once they are freed of what they had absorbed.
    """
    for effect in model.effects if len(model.effects) > 1 else ():
        if (rest := without(model, effect)) is not None:
            yield rest
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
