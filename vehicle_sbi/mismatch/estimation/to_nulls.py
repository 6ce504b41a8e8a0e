"""Derivatives of effects over all of the way back to their nulls, where it is asked whether they are missing.

An effect may change far less on that way than its slope at the fit says: a friction of half the stated one is steep
where tyres slide, and flat before. All other parameters take over what they can of it meanwhile, as they do where the
effect is not missing: base parameters, and effects that are hardly told from it. Alone on its way back, it would leave
what is of second order in it, and be named for that.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from vehicle_sbi.inference.information import PLAIN
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linear_gaussian import per_coefficient

LEAST = 0.1  # coefficient of a size, from which its derivative is taken over the way back

Steps = Float[np.ndarray, "k channels time"]


def to_nulls(expansion: Expansion, fits: Sequence[Fit]) -> list[Fit]:
    """Fits of one point of the expanded model to several recordings, with derivatives by some sizes over the way back
    to their nulls, a simulation each. What happened in the first recording alone stays out of the others' steps.

    Where a step is plain to see beside the base parameters, the effect is there in any case, and its slope at the fit
    says how large it is.
    """
    own, c = len(expansion.base), expansion.coefficients(fits[0].theta)
    away = own + np.flatnonzero(np.abs(c[own : own + len(expansion.sizes)]) > LEAST)
    if not len(away):
        return [*fits]
    nulls = _nulls(expansion, fits, away)
    steps = [_steps(one, np.where(one.theta == fits[0].theta, nulls, one.theta)) for one in fits]
    left = np.sum([_left(one, own, step) for one, step in zip(fits, steps, strict=True)], axis=0)
    hidden = left < PLAIN**2
    moved = (c - expansion.coefficients(nulls))[hidden]
    return [
        _with_derivatives(expansion, one, away[hidden], moved, step[hidden])
        for one, step in zip(fits, steps, strict=True)
    ]


def _nulls(expansion: Expansion, fits: Sequence[Fit], away: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k d"]:
    """Points with one size each at its null, and all others where they make up for it at first order, held as the fit
    holds them."""
    fit, c = fits[0], expansion.coefficients(fits[0].theta)
    unit, space = per_coefficient(expansion, fit), fit.simulator.space
    white = np.concatenate([one.white for one in fits], axis=1) * unit[:, None]
    held = unit**2 if fit.shrinkage is None else unit**2 * fit.shrinkage.precision
    covariance = np.linalg.inv(white @ white.T + np.diag(held))
    with_it = covariance[away] / covariance[away, away][:, None]
    theta = np.clip(expansion.theta(c - with_it * c[away, None]), space.low, space.high)
    theta[np.arange(len(away)), away] = expansion.rest[away]
    return theta


def _steps(fit: Fit, nulls: Float[np.ndarray, "k d"]) -> Steps:
    """What recordings change by from each point on to the fit."""
    return np.where(fit.simulator.windows.valid, fit.at.y - fit.simulator.noise_free(nulls), 0.0)


def _left(fit: Fit, own: int, steps: Steps) -> Float[np.ndarray, " k"]:
    """Sums of squares of what base parameters, the first of all, leave of steps; infinite where a simulation fails."""
    absorbing, _ = np.linalg.qr(fit.white[:own].T)
    white = fit.metric(steps).reshape(len(steps), -1)
    left = np.sum((white - (white @ absorbing) @ absorbing.T) ** 2, axis=1)
    return np.where(np.isfinite(steps).all(axis=(1, 2)), left, np.inf)


def _with_derivatives(
    expansion: Expansion, fit: Fit, sizes: Int[np.ndarray, " k"], moved: Float[np.ndarray, "k d"], steps: Steps
) -> Fit:
    """The fit with derivatives by sizes such that the linear model is exact at both ends of steps, along which
    coefficients move as said."""
    J, moves, step = fit.at.J.copy(), moved * per_coefficient(expansion, fit), np.arange(len(sizes))
    size = moves[step, sizes]
    moves[step, sizes] = 0.0
    J[sizes] = (steps - np.tensordot(moves, fit.at.J, axes=1)) / size[:, None, None]
    return replace(fit, at=replace(fit.at, J=J))
