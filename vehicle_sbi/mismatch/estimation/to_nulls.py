"""Derivatives of effects over all of the way back to their nulls, where it is asked whether they are missing.

An effect may change far less on that way than its slope at the fit says: a friction of half the stated one is steep
where tyres slide, and flat before. Base parameters take over what they can of it meanwhile, as they do where the effect
is not missing. Stiffnesses take over a level of all of them exactly. Alone on its way back, the level would leave what
is of second order in it, and be named for that.
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
    steps = [_steps(one, np.where(nulls == fits[0].theta, one.theta, nulls)) for one in fits]
    left = np.sum([_left(one, own, step) for one, step in zip(fits, steps, strict=True)], axis=0)
    hidden = left < PLAIN**2
    moved = (c - expansion.coefficients(nulls))[hidden]
    return [
        _with_derivatives(expansion, one, away[hidden], moved, step[hidden])
        for one, step in zip(fits, steps, strict=True)
    ]


def _nulls(expansion: Expansion, fits: Sequence[Fit], away: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k d"]:
    """Points with one size each at its null, and base parameters where they make up for it at first order."""
    own, c, space = len(expansion.base), expansion.coefficients(fits[0].theta), fits[0].simulator.space
    white = np.concatenate([one.white for one in fits], axis=1) * per_coefficient(expansion, fits[0])[:, None]
    taken = np.linalg.solve(white[:own] @ white[:own].T + np.eye(own), white[:own] @ white[away].T)
    points = np.repeat(c[None], len(away), axis=0)
    points[:, :own] += (taken * c[away]).T
    theta = np.repeat(fits[0].theta[None], len(away), axis=0)
    theta[:, :own] = np.clip(expansion.theta(points), space.low, space.high)[:, :own]
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
    unit, own, J = per_coefficient(expansion, fit), len(expansion.base), fit.at.J.copy()
    base = np.tensordot(moved[:, :own] * unit[:own], fit.at.J[:own], axes=1)
    size = moved[np.arange(len(sizes)), sizes] * unit[sizes]
    J[sizes] = (steps - base) / size[:, None, None]
    return replace(fit, at=replace(fit.at, J=J))
