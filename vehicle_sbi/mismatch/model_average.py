"""Base parameters averaged over all explanations, each with its probability: intervals that hold whichever is right.

The average over sets of effects, none, and what is unknown is a mixture of each model's own posterior (Hoeting,
Madigan, Raftery and Volinsky 1999, Bayesian model averaging). What is left over without any explanation may lie beside
the best set, or be many of the catalogue's effects at once, as likely as not: then the full model's posterior counts.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import truncnorm

from vehicle_sbi.mismatch.answer import Estimate
from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.explanation import Explanation

POINTS = 200  # quantiles that stand for a model's posterior
LEAST = 1e-3  # probability of a model that counts
SPREAD = 0.5  # prior probability that what is left over is many of the catalogue's effects at once


def averaged(explanation: Explanation) -> dict[str, Estimate]:
    """Each parameter of the base model, averaged over all models and what they leave over."""
    space = explanation.base.model.fit.simulator.space
    counted = [(model, share) for model, share in _components(explanation) if share > LEAST]
    return {p.name: _mixed(p.name, p.unit, counted, explanation.temper) for p in space.parameters}


def _components(explanation: Explanation) -> list[tuple[Model, float]]:
    """Models with their probabilities, the full model for its part of what is left over."""
    *explained, (best, left) = explanation.shares
    if explanation.full is None:
        return explanation.shares
    return [*explained, (best, (1.0 - SPREAD) * left), (Model((), explanation.full, 0.0), SPREAD * left)]


def _mixed(name: str, unit: str, counted: Sequence[tuple[Model, float]], power: float) -> Estimate:
    values = np.concatenate([_quantiles(model, name, power) for model, _ in counted])
    weight = np.repeat([share for _, share in counted], POINTS)
    weight = weight / weight.sum()
    mean = float(weight @ values)
    order = np.argsort(values)
    low, high = np.interp([0.05, 0.95], np.cumsum(weight[order]) - 0.5 * weight[order], values[order])
    return Estimate(mean, float(np.sqrt(weight @ (values - mean) ** 2)), float(low), float(high), unit)


def _quantiles(model: Model, name: str, power: float) -> Float[np.ndarray, " points"]:
    """Equally probable values of a parameter of a model: as drawn, else normal about the fit within its box."""
    levels = (np.arange(POINTS) + 0.5) / POINTS
    space = model.fit.simulator.space
    k = space.column(name)
    if model.posterior is not None:
        return np.quantile(model.posterior[:, k], levels)
    mean, std = model.fit.theta[k], float(np.sqrt(model.fit.tempered(power)[k, k]))
    low, high = space.low[k], space.high[k]
    return np.asarray(truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std).ppf(levels))
