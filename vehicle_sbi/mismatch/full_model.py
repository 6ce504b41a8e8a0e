"""The model with everything in: base parameters and those of all effects that act, free at once and shrunk to nothing.

Where several effects are missing, the base model's parameters stand where they have absorbed what they could, often on
the rims of their boxes, and a search that goes on from there stays. With all effects in, each held to its null by a
normal prior, the base parameters stand nearer the car's own: another place to start from.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import Direction, null
from vehicle_sbi.mismatch.fit import DAMPING, MOST_STEPS, NEAR_ROUNDS, Fit, Shrinkage, descend, with_own_noise
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE

SHRUNK = 0.3  # standard deviation of an effect's parameter about its null, in units of its box's
APART = 0.5  # standard deviations of the prior, from which another place to start is another one


def free_at_once(known: Sequence[Direction]) -> list[Parameter]:
    """Parameters along which known directions leave their nulls, but for what is tied to the clock."""
    return [*dict.fromkeys(d.parameter for d in known if not CATALOGUE[d.effect].timed)]


def full_model(base: Fit, known: Sequence[Direction]) -> Fit | None:
    """The fit with all effects in, under noise of its own; None where there are none or it cannot be simulated."""
    added = free_at_once(known)
    if not added:
        return None
    observation = base.observation.freeing([*base.simulator.space.parameters, *added])
    start = np.concatenate([base.theta, [null(p) for p in added]])
    precision = np.repeat([DAMPING, SHRUNK**-2], [len(base.theta), len(added)])
    fit = descend(observation, start, MOST_STEPS, Shrinkage(start, precision))
    return None if fit is None else with_own_noise(fit, NEAR_ROUNDS)


def elsewhere(full: Fit | None, fit: Fit) -> Float[np.ndarray, " d"] | None:
    """Where the full model has the parameters of a fit, if that is another place; its own where it has them not."""
    if full is None:
        return None
    at = dict(zip(full.simulator.space.names, full.theta, strict=True))
    space = fit.simulator.space
    theta = np.array([at.get(name, x) for name, x in zip(space.names, fit.theta, strict=True)])
    theta = np.clip(theta, space.low, space.high)
    return theta if np.any(np.abs(theta - fit.theta) > APART * space.prior_std) else None
