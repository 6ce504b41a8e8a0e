"""The base model's fit, from many places: its prior, the vehicle file, and off the rims.

Where physics is missing, the likelihood has several optima, and the nearest one is often on the rims of the boxes.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.fit import Fit, descend, with_own_noise
from vehicle_sbi.mismatch.estimation.multistart import best
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import Parameter

SCREENED, STARTS = 32, 3  # points that are simulated, and of those the ones from which the base model is fitted
INWARDS = 0.25  # of a box's width, by which a start is moved off the rim
LIKELIER = 1.0  # log likelihood by which another optimum is one


def fitted(observation: Observation, rng: np.random.Generator) -> Fit:
    """From the best of many points of the prior (at the limit most of them spin out), from the vehicle file, and off
    the rims that it ends on."""
    simulator, observed = observation.simulator, observation.observed
    space, valid, stated = simulator.space, simulator.windows.valid, as_stated(simulator)
    points = np.concatenate(
        [(space.low + space.high)[None] / 2, rng.uniform(space.low, space.high, (SCREENED, len(space)))]
    )
    off = np.where(valid, (observed - simulator.noise_free(points)) / simulator.noise.floor[:, None], 0.0)
    misfit = np.nan_to_num(np.sum(off**2, axis=(1, 2)), nan=np.inf)
    fit = best(observation, np.concatenate([points[np.argsort(misfit)[:STARTS]], stated[None]]))
    return fit if fit.inside.all() else likelier(fit, [off_rims(fit)])


def likelier(fit: Fit, starts: Sequence[Float[np.ndarray, " d"]]) -> Fit:
    """The likeliest of a fit and those that start elsewhere, each under noise of its own."""
    found = [with_own_noise(one) for start in starts if (one := descend(fit.observation, start)) is not None]
    better = max(found, key=lambda one: one.log_likelihood, default=fit)
    return better if better.log_likelihood > fit.log_likelihood + LIKELIER else fit


def off_rims(fit: Fit) -> Float[np.ndarray, " d"]:
    """theta with what lies on the rim of its box moved inwards."""
    space = fit.simulator.space
    width = space.high - space.low
    room = np.where(fit.inside, 0.0, INWARDS) * width
    return np.clip(fit.theta, space.low + room, space.high - room)


def as_stated(simulator: Simulator) -> Float[np.ndarray, " d"]:
    """theta as the vehicle file has it, effects at their nulls; the middle of the box for what it leaves out."""
    return np.array([_stated(p, simulator.nominal) for p in simulator.space.parameters])


def _stated(p: Parameter, nominal: np.void) -> float:
    value = p.null
    if value is None:
        value = 0.0 if p.relative else float(np.mean([nominal[name] for name in p.fields]))
    return float(np.clip(value, p.low, p.high)) if np.isfinite(value) else 0.5 * (p.low + p.high)
