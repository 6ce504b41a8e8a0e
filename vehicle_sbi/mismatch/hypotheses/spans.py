"""When what comes and goes acts: the likeliest span of time of each such effect, about a fit of everything else."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import SPAN, Direction, shapes, slopes, tile
from vehicle_sbi.mismatch.estimation.fit import DAMPING, Fit
from vehicle_sbi.parameters import Parameter


def likeliest_spans(fit: Fit, known: Sequence[Direction]) -> list[Direction]:
    """Of directions that come and go, each in its likeliest shape, when it begins and how long it lasts being free
    within a tile of the recordings' time.

    It is the likeliest of many, all of which were as likely before. Its share is such that it weighs what all weigh
    together: the mean of their likelihoods over the largest.
    """
    seconds = tile(fit.simulator)
    return [_freed(_likeliest(fit, d), seconds) for d in known if d.clocked]


def _likeliest(fit: Fit, direction: Direction) -> Direction:
    tried = shapes(fit.simulator, direction)
    gains = _gains(fit, slopes(fit.simulator, fit.theta, tried))
    best = int(np.argmax(gains))
    return replace(tried[best], share=float(np.mean(np.exp(gains - gains[best]))))


def _gains(fit: Fit, changes: Float[np.ndarray, "k channels time"]) -> Float[np.ndarray, " k"]:
    """Log likelihood that each change of the series gains at its likeliest size, the fit's parameters following."""
    held = np.full(len(fit.theta), DAMPING) if fit.shrinkage is None else fit.shrinkage.precision
    J = fit.white
    G, r = fit.metric(np.nan_to_num(changes)).reshape(len(changes), -1), fit.metric(fit.residual).reshape(-1)
    absorbed = np.linalg.solve(J @ J.T + np.diag(held), J @ G.T)
    left = np.sum(G**2, axis=1) - np.sum((G @ J.T) * absorbed.T, axis=1)
    return 0.5 * (G @ r) ** 2 / np.maximum(left, 1e-9)


def _freed(direction: Direction, seconds: float) -> Direction:
    held = {_near(p, x, seconds) if p.name.split(".")[1] in SPAN else p: x for p, x in direction.held.items()}
    return replace(direction, held=held)


def _near(p: Parameter, value: float, reach: float) -> Parameter:
    """The parameter within reach of a value."""
    return replace(p, low=max(p.low, value - reach), high=min(p.high, value + reach))
