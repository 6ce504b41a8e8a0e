"""What a finished run or diagnosis knows of a car, and numbers made of it.

A number y made of parameters p is taken to first order: its standard deviation is sqrt(g' S g), with g = dy/dp at the
means and S the covariance of the posterior (JCGM 100:2008, section 5). That is exact for what is linear in them.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from vehicle_sbi.mismatch.estimation.estimate import Estimate

NORMAL_95 = 1.6448536269514722  # standard deviations from the median of a normal law to its 95 % quantile
STEP = 1e-6  # of a value, or of 1 where that is larger, by which it is moved to get a slope


@dataclass(frozen=True, kw_only=True)
class Inferred:
    """A free parameter, whether it is identified and, if it is not, `why_not`, whether it lies on the edge of its
    prior, and how probable its effect is where that was asked.

    The estimate is of draws that have the effect, or, `averaged`, of all draws, those without it at its null.
    """

    estimate: Estimate
    identified: bool
    why_not: str = "not identified from these recordings"
    on_edge: bool = False
    probability: float | None = None
    averaged: bool = False


@dataclass(frozen=True, kw_only=True)
class Value:
    """A number in `unit` and its slope by each identified parameter; without slopes it is stated, not identified."""

    mean: float
    unit: str
    slopes: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Exported:
    """What a folder knows.

    `inferred`: every free parameter by name; `stated`: the vehicle's constants that were not free [SI]; `correlation`:
    that of the posterior's samples, None where there are none; `doubted`: effects that were looked for and not named,
    with their probabilities; `caveats`: what a user of the numbers must know, in sentences.
    """

    folder: Path
    kind: str  # run or diagnosis
    vehicle: str
    version: str
    inferred: Mapping[str, Inferred]
    stated: Mapping[str, float]
    nominal: Mapping[str, float]
    correlation: pd.DataFrame | None
    doubted: Mapping[str, float]
    caveats: tuple[str, ...]

    @property
    def identified(self) -> Mapping[str, Inferred]:
        """The parameters that the recordings identified."""
        return {name: one for name, one in self.inferred.items() if one.identified}

    @property
    def not_identified(self) -> tuple[str, ...]:
        """Names of the free parameters that they did not."""
        return tuple(name for name, one in self.inferred.items() if not one.identified)

    def parameter(self, name: str) -> Value | None:
        """An identified parameter as a value; None for any other."""
        one = self.identified.get(name)
        return None if one is None else Value(mean=one.estimate.mean, unit=one.estimate.unit, slopes={name: 1.0})

    def estimate(self, value: Value) -> Estimate:
        """A value with its uncertainty; its quantiles are those of a normal law where several parameters make it."""
        moved = np.array([slope * self.inferred[name].estimate.std for name, slope in value.slopes.items()])
        std = math.sqrt(max(float(moved @ self._correlations(tuple(value.slopes)) @ moved), 0.0))
        low, high = value.mean - NORMAL_95 * std, value.mean + NORMAL_95 * std
        if len(value.slopes) == 1:
            ((name, slope),) = value.slopes.items()
            one = self.inferred[name].estimate
            low, high = sorted(value.mean + slope * (q - one.mean) for q in (one.q05, one.q95))
        return Estimate(mean=value.mean, std=std, q05=low, q95=high, unit=value.unit)

    def _correlations(self, names: tuple[str, ...]) -> np.ndarray:
        """Correlations of parameters; those of independent ones where no samples tell."""
        if self.correlation is None:
            return np.eye(len(names))
        return self.correlation.loc[[*names], [*names]].to_numpy()


def made_of(function: Callable[..., float], *values: Value, unit: str) -> Value:
    """The value of a smooth function of values."""
    means = [value.mean for value in values]
    slopes: dict[str, float] = {}
    for i, value in enumerate(values):
        slope = _slope(function, means, i)
        for name, inner in value.slopes.items():
            slopes[name] = slopes.get(name, 0.0) + slope * inner
    return Value(mean=function(*means), unit=unit, slopes=slopes)


def _slope(function: Callable[..., float], at: list[float], i: int) -> float:
    """Central difference by argument i."""
    step = STEP * max(abs(at[i]), 1.0)
    low, high = ([*at[:i], at[i] + move, *at[i + 1 :]] for move in (-step, step))
    return (function(*high) - function(*low)) / (2.0 * step)
