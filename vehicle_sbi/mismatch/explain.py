"""What was left out: the search of sets of effects that could explain what the base model leaves over.

From the base model on, the most promising effects by their first-order scores are put into the model and all its
parameters are fitted again, under noise of its own. The best model is extended further, and the next one too where it
still leaves something over. Beside the base model and each best one stands what the catalogue does not have. In the
end each effect of the best set is taken out again, and exchanged for others.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from vehicle_sbi.inference.directions import Direction, within
from vehicle_sbi.mismatch.base_fit import as_stated, likelier, off_rims
from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.examine import LEVEL, Examined, Model, Version, examine, glance, versions
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.fit import NEAR_STEPS, Fit, descend, settled
from vehicle_sbi.mismatch.full_model import elsewhere
from vehicle_sbi.mismatch.repertoire import Repertoire
from vehicle_sbi.mismatch.search import likeliest
from vehicle_sbi.mismatch.unnamed import HOPELESS, beside
from vehicle_sbi.physics.effects import CATALOGUE

TRIED = 8  # effects at most that are fitted fully beside each model
LEAST_SHARE, SLACK = 0.65, 8.0  # of the best one's first-order evidence that they need, and by how much it may be off
BEAM = 2  # models that are extended further
EXCHANGES = 2  # of effects of the best set, at most: each may show a better set
BELIEF = Belief()


def extended(model: Model, version: Version, full: Fit | None = None) -> Model | None:
    """The model with one more effect, all parameters fitted under noise of its own; None if it cannot be simulated.

    It starts from where the model is, and from where the `full` model has its parameters, if that is elsewhere.
    """
    simulator = model.fit.simulator
    boxes = {p.name: p for p in within(simulator, CATALOGUE[version.effect]).parameters}
    added = [*version.starts[0]]
    wider = model.fit.observation.freeing([*simulator.space.parameters, *(boxes[p.name] for p in added)])
    space, away = wider.simulator.space, elsewhere(full, model.fit)
    points = [
        np.clip(np.concatenate([theta, [start[p] for p in added]]), space.low, space.high)
        for theta, starts in ((model.fit.theta, version.starts), (away, version.starts[:1]))
        if theta is not None
        for start in starts
    ]
    fit = settled(likeliest(wider, points, NEAR_STEPS))
    effects = tuple(sorted({*model.effects, version.effect}))  # another parameter of an effect is no further effect
    explained = float(np.hypot(model.explained, version.score))
    return None if fit is None else replace(model, effects=effects, fit=fit, explained=explained)


def without(model: Model, effect: str) -> Model | None:
    """The model with one effect fewer, all other parameters fitted; None if it cannot be simulated."""
    space, theta = model.fit.simulator.space, model.fit.theta
    kept = [k for k, name in enumerate(space.names) if name in model.base or name.split(".")[0] != effect]
    rest = model.fit.observation.freeing([space.parameters[k] for k in kept])
    fit = settled(descend(rest, theta[kept], NEAR_STEPS))
    others = tuple(name for name in model.effects if name != effect)
    return None if fit is None else replace(model, effects=others, fit=fit)


def explain(
    base: Fit,
    known: Sequence[Direction],
    *,
    rng: np.random.Generator,
    full: Fit | None = None,
    belief: Belief = BELIEF,
    tried: Callable[[str], None] = lambda name: None,
) -> Explanation:
    """Search sets of effects from the base model on, among the directions that are known to act at its fit.

    `full` is the fit with all of them in, where models also start; `tried` is told the name of each set once it is
    fitted.
    """

    def weight(model: Model) -> float:
        return model.weight(belief)

    none = Model((), base, 0.0, base=base.simulator.space.names)
    repertoire = Repertoire.around(base, known)
    first = examine(none, repertoire, rng)
    pool: dict[tuple[str, ...], Model] = {(): none}
    best = first
    frontier = [first] if first.p_value < LEVEL else []
    unnamed = beside(first, base.simulator.space) if frontier else []
    promising = {version.effect for version in versions(first)[:TRIED]}
    for _ in range(belief.most):
        grown: dict[tuple[str, ...], Model] = {}
        for model in (model for examined in frontier for model in _grow(examined, full)):
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
        unnamed += beside(best, base.simulator.space)
        promising |= {version.effect for examined in frontier for version in versions(examined)[:TRIED]}
    likely = repertoire.only(promising)
    named: list[Model] = []
    for _ in range(EXCHANGES):
        for model in exchanged(best.model, likely, rng, full):
            tried(" + ".join(model.effects))
            pool[model.effects] = max(model, pool.get(model.effects, model), key=weight)
        named = sorted((model for model in pool.values() if model.effects), key=weight, reverse=True)
        if not named or weight(named[0]) <= weight(best.model):
            break
        best = examine(named[0], repertoire, rng)
        unnamed += beside(best, base.simulator.space)
    if (freed := off_its_rims(best.model)) is not best.model:
        pool[freed.effects] = freed
        named = sorted((model for model in pool.values() if model.effects), key=weight, reverse=True)
        best = examine(freed, repertoire, rng)
    sizes = tuple(sorted({d.parameter.name for d in known}))
    return Explanation(named, unnamed, first, best, belief, sizes=sizes, full=full).supported()


def off_its_rims(model: Model) -> Model:
    """The model with a likelier fit from off the rims that it ends on and from the vehicle file, if there is one."""
    fit = model.fit
    if not model.effects or fit.inside.all():
        return model
    stated = np.where(model.own, fit.theta, as_stated(fit.simulator))
    found = likelier(fit, [off_rims(fit), stated])
    return model if found is fit else replace(model, fit=found)


def exchanged(
    model: Model, repertoire: Repertoire, rng: np.random.Generator, full: Fit | None = None
) -> Iterator[Model]:
    """A set of several effects without each of them, and with others that promise as much in its place.

    The search has grown the set one by one, and so has not seen what could stand in for those that came first; nor what
    the base model's parameters can do without them once they are freed of what they had absorbed.
    """
    for effect in model.effects if len(model.effects) > 1 else ():
        if (rest := without(model, effect)) is not None:
            yield rest
            yield from _grow(glance(rest, repertoire, rng), full)


def _grow(examined: Examined, full: Fit | None) -> Iterator[Model]:
    """The model with each of its most promising effects."""
    promising = versions(examined)[:TRIED]
    for i, version in enumerate(promising):
        needed = max(LEAST_SHARE * promising[0].log_evidence - SLACK, HOPELESS)
        if version.log_evidence < needed and (i > 0 or examined.model.effects):
            return
        if version.score > 0 and (model := extended(examined.model, version, full)) is not None:
            yield model
