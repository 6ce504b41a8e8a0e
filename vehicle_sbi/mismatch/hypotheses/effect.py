"""Effects of the catalogue: what a little of each does to the series, and how often and how large cars have it.

Changes are simulated at the base model's fit, in every shape of a direction, by steps as large as it takes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import STEPS, Direction, extent, shapes, slopes, tiles
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief, Hypothesis
from vehicle_sbi.parameters import Parameter

NONLINEAR = 0.3  # of the smaller change, by which those of two steps differ for both to be tried


def tested(fit: Fit, known: Sequence[Direction]) -> list[Hypothesis]:
    """Directions that are known to act, in each of their shapes, but along none of the parameters that the fit has.

    Larger steps are tried too where they do not change as much in proportion. For which parameters that may be so, what
    they do throughout the recordings says.
    """
    new = [d for d in known if not _fitted(fit, d)]
    latest = _changed(fit, [shape for d in new for shape in shapes(fit.simulator, d)])
    kept, bent = [*latest], _bent(fit, new)
    for step in STEPS:
        rows = [k for k, (d, _) in enumerate(latest) if d.step < step and d.parameter in bent]
        larger = _changed(fit, [replace(latest[k][0], step=step) for k in rows])
        for k, pair in zip(rows, larger, strict=True):
            if _differ(fit, pair[1], latest[k][1]):
                latest[k] = pair
                kept.append(pair)
    return [Hypothesis(_name(d), d.low, d.high, change) for d, change in kept]


def believed(expansion: Expansion, prior: EffectPrior) -> list[Belief]:
    """Each size by itself, profiles over time together, in the order of the expansion's sizes."""
    amplitude, share = np.array(prior.slabs).T
    share, (low, high) = share / share.sum(), expansion.bounds
    return [
        Belief(
            named=True,
            rate=float(expansion.rates[stop - 1]),
            nothing=prior.negligible,
            amplitude=amplitude,
            share=share,
            low=low[stop - n : stop],
            high=high[stop - n : stop],
        )
        for stop, n in zip(np.cumsum(expansion.groups), expansion.groups, strict=True)
    ]


def _name(d: Direction) -> str:
    """The parameter, its step as a part of its box, and what gives it its shape."""
    held = [f"{p.name} = {value:.6g}" for p, value in d.held.items()]
    return ", ".join([f"{d.parameter.name} by {d.step:g} of its box", *held])


def _fitted(fit: Fit, direction: Direction) -> bool:
    """Whether a fit has any of a direction's parameters."""
    return bool({direction.parameter.name, *(p.name for p in direction.held)} & set(fit.simulator.space.names))


def _bent(fit: Fit, known: Sequence[Direction]) -> set[Parameter]:
    """Parameters whose largest step does not change as much in proportion as their smallest."""
    throughout = [d.during(0.0, extent(fit.simulator)) if d.clocked else d for d in known]
    small = _changed(fit, throughout)
    large = _changed(fit, [replace(d, step=STEPS[-1]) for d in throughout])
    return {d.parameter for (d, a), (_, b) in zip(small, large, strict=True) if _differ(fit, a, b)}


def _differ(
    fit: Fit, change: Float[np.ndarray, "*k channels time"], other: Float[np.ndarray, "*k channels time"]
) -> bool:
    """Whether two changes differ by more than a part of the smaller one, in units of the noise."""
    a, b, off = (float(np.linalg.norm(fit.metric(one))) for one in (change, other, change - other))
    return off > NONLINEAR * min(a, b)


def _changed(fit: Fit, found: Sequence[Direction]) -> list[tuple[Direction, Float[np.ndarray, "channels time"]]]:
    """Directions with their changes of the series; by small steps, spans of time are put together from their tiles.

    What larger ones do in one tile changes what they do in the next.
    """
    made_of = [tiles(fit.simulator, d) if d.step == STEPS[0] else [d] for d in found]
    single = {one.key: one for parts in made_of for one in parts}
    change = dict(zip(single, slopes(fit.simulator, fit.theta, [*single.values()]), strict=True))
    whole = (np.sum([change[one.key] for one in parts], axis=0) for parts in made_of)
    return [*zip(found, whole, strict=True)]
