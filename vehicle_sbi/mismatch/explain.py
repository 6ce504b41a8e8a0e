"""What was left out: the search of sets of effects that could explain what the base model leaves over.

From the base model on, the most promising effects by their first-order scores are put into the model and all its
parameters are fitted again, under noise of its own. The best model is extended further, and the next one too where it
still leaves something over.
Beside each stand laws that no effect of the catalogue has, fitted alike, what follows no law, and base parameters that
are let out of their boxes. In the end each effect of the best set is taken out again, and exchanged for others.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.beyond import Beyond, let_out, on_rim
from vehicle_sbi.mismatch.candidates import Direction, within
from vehicle_sbi.mismatch.examine import LEVEL, Examined, Model, Version, examine, glance, versions
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.fit import Fit, descend, likeliest, with_own_noise
from vehicle_sbi.mismatch.laws import under
from vehicle_sbi.mismatch.loose import loose
from vehicle_sbi.mismatch.repertoire import Repertoire
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE

TRIED = 8  # effects at most that are fitted fully beside each model
LEAST_SHARE, SLACK = 0.65, 8.0  # of the best one's first-order evidence that they need, and by how much it may be off
BEAM = 2  # models that are extended further
LAWS_TRIED = 2  # that are fitted fully beside a model
NOISE_ROUNDS, STEPS = 2, 6  # of the fit of an extended model
EXCHANGES = 2  # of effects of the best set, at most: each may show a better set
HOPELESS = 2.0  # first-order evidence below which no further effect outweighs the reluctance to add one
KINDS = 5  # of what the catalogue does not have, that share its prior: laws, courses, steps, sticking and boxes
LET_OUT = 2  # times that boxes become wider, at most
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
    fit = _settled(likeliest(wider, points, STEPS))
    effects = tuple(sorted({*model.effects, version.effect}))  # another parameter of an effect is no further effect
    return None if fit is None else Model(effects, fit, float(np.hypot(model.explained, version.score)))


def _settled(found: Fit | None) -> Fit | None:
    """A fit under noise of its own, if there is one."""
    return None if found is None else with_own_noise(found, NOISE_ROUNDS, STEPS)


def ruled(examined: Examined) -> Iterator[Model]:
    """The model with each of the few laws that promise most."""
    model, of_laws = examined.model, examined.free.of_laws
    evidence, size = examined.scores.log_evidence[of_laws], examined.scores.size[of_laws]
    for k in np.argsort(-evidence)[:LAWS_TRIED]:
        if evidence[k] < HOPELESS:
            return
        law = examined.free.laws[k]
        start = np.append(model.fit.theta, np.clip(size[k], 0.98 * law.target.size.low, 0.98 * law.target.size.high))
        fit = _settled(descend(model.fit.observation.extended(under(model.fit.simulator, law)), start, STEPS))
        if fit is not None:
            yield Model(model.effects, fit, model.explained, law, KINDS * len(examined.free.laws))


def beyond_laws(model: Model) -> Iterator[Model]:
    """The model with something beside it that follows no law, and is more than the best of so many in noise."""
    for one in loose(model.fit):
        if one.gain > HOPELESS + np.log(one.choice):
            yield replace(model, outside=one, choice=KINDS * one.choice)


def beyond_boxes(model: Model, base: ParameterSpace) -> Iterator[Model]:
    """The model with those base parameters let out of their boxes that lie on the rim; none if none does."""
    fit, boxes = model.fit, dict[str, tuple[float, float]]()
    for _ in range(LET_OUT):
        held = on_rim(fit, base.names)
        found = _settled(descend(fit.observation.extended(let_out(fit, held)), fit.theta, STEPS)) if held else None
        if found is None:
            break
        fit, boxes = found, boxes | {p.name: (p.low, p.high) for p in base.parameters if p.name in held}
    if outside := {name: boxes[name] for name in boxes if not _inside(fit, name, *boxes[name])}:
        yield replace(model, fit=fit, outside=Beyond(outside), choice=KINDS * 2 * len(base))


def _inside(fit: Fit, name: str, low: float, high: float) -> bool:
    return low <= fit.theta[fit.simulator.space.column(name)] <= high


def unnamed_beside(examined: Examined, base: ParameterSpace) -> list[Model]:
    """The model with each thing that the catalogue does not have."""
    model = examined.model
    return [*ruled(examined), *beyond_laws(model), *beyond_boxes(model, base)]


def without(model: Model, effect: str) -> Model | None:
    """The model with one effect fewer, all other parameters fitted; None if it cannot be simulated."""
    simulator, theta = model.fit.simulator, model.fit.theta
    kept = [k for k, name in enumerate(simulator.space.names) if name.split(".")[0] != effect]
    space = ParameterSpace(tuple(simulator.space.parameters[k] for k in kept))
    fit = _settled(descend(model.fit.observation.extended(replace(simulator, space=space)), theta[kept], STEPS))
    rest = tuple(name for name in model.effects if name != effect)
    return None if fit is None else Model(rest, fit, model.explained)


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
    unnamed = unnamed_beside(first, base.simulator.space) if frontier else []
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
        others = leading[1:] if best.p_value < LEVEL else []
        frontier = [best, *(glance(model, repertoire, rng) for model in others)]
        unnamed += unnamed_beside(best, base.simulator.space)
        promising |= {version.effect for examined in frontier for version in versions(examined)[:TRIED]}
    unnamed.sort(key=weight, reverse=True)
    likely = repertoire.only(promising)
    named: list[Model] = []
    for _ in range(EXCHANGES):
        for model in exchanged(best.model, likely, rng):
            tried(" + ".join(model.effects))
            pool[model.effects] = max(model, pool.get(model.effects, model), key=weight)
        named = sorted((model for model in pool.values() if model.effects), key=weight, reverse=True)
        if not named or weight(named[0]) <= weight(best.model):
            break
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
