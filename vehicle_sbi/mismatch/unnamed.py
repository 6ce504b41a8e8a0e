"""What the catalogue does not have, beside a model: laws, what follows no law, base parameters beyond their boxes.

Laws that promise most are fitted like effects. What follows no law is weighed, not fitted. Base parameters that lie on
the rim of their box are let out of it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vehicle_sbi.mismatch.beyond import Beyond, let_out, on_rim
from vehicle_sbi.mismatch.examine import Examined, Model
from vehicle_sbi.mismatch.fit import NEAR_STEPS, Fit, descend, settled
from vehicle_sbi.mismatch.laws import under
from vehicle_sbi.mismatch.loose import loose
from vehicle_sbi.parameters import ParameterSpace

KINDS = 6  # that share the prior probability of something unknown: laws, courses, onsets, steps, sticking, boxes
LAWS_TRIED = 2  # that are fitted fully beside a model
HOPELESS = 2.0  # evidence below which nothing further outweighs the reluctance to add it
LET_OUT = 2  # times that boxes become wider, at most


def beside(examined: Examined, base: ParameterSpace) -> list[Model]:
    """The model with each such thing; `base` are the parameters of the base model."""
    model = examined.model
    return [*ruled(examined), *beyond_laws(model), *beyond_boxes(model, base)]


def ruled(examined: Examined) -> Iterator[Model]:
    """The model with each of the few laws that promise most."""
    model, of_laws = examined.model, examined.free.of_laws
    evidence, size = examined.scores.log_evidence[of_laws], examined.scores.size[of_laws]
    for k in np.argsort(-evidence)[:LAWS_TRIED]:
        if evidence[k] < HOPELESS:
            return
        law = examined.free.laws[k]
        start = np.append(model.fit.theta, np.clip(size[k], 0.98 * law.target.size.low, 0.98 * law.target.size.high))
        fit = settled(descend(model.fit.observation.extended(under(model.fit.simulator, law)), start, NEAR_STEPS))
        if fit is not None:
            yield replace(model, fit=fit, outside=law, choice=KINDS * len(examined.free.laws))


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
        found = settled(descend(fit.observation.extended(let_out(fit, held)), fit.theta, NEAR_STEPS)) if held else None
        if found is None:
            break
        fit, boxes = found, boxes | {p.name: (p.low, p.high) for p in base.parameters if p.name in held}
    if outside := {name: boxes[name] for name in boxes if not _inside(fit, name, *boxes[name])}:
        yield replace(model, fit=fit, outside=Beyond(outside), choice=KINDS * 2 * len(base))


def _inside(fit: Fit, name: str, low: float, high: float) -> bool:
    return low <= fit.theta[fit.simulator.space.column(name)] <= high
