"""What is said of one parameter: its posterior in a few numbers, and in words."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.rounding import mean_and_std

TOLD = 0.5**0.5  # of its prior's standard deviation, below which recordings have told a parameter


@dataclass(frozen=True)
class Estimate:
    """A parameter's posterior: mean, standard deviation, and the ends of its 90 % interval."""

    mean: float
    std: float
    q05: float
    q95: float
    unit: str


def drawn(values: Float[np.ndarray, " n"], unit: str) -> Estimate:
    """A parameter's posterior from draws."""
    low, high = np.quantile(values, [0.05, 0.95])
    return Estimate(float(values.mean()), float(values.std()), float(low), float(high), unit)


def told(std: float, low: float, high: float) -> bool:
    """Whether recordings have told a parameter of a diagnosis, from its posterior's spread and its prior's box.

    Of what is normal 1/std² = 1/prior² + 1/bound². So std is below sqrt(1/2) of the prior's where the bound is below
    the prior's, by which `observability` calls a parameter identified. Untold draws of a diagnosis keep 0.81 or more of
    the box's: their prior is a normal law of its spread, within it.
    """
    return std < TOLD * (high - low) / 12.0**0.5


def quantity(name: str, e: Estimate) -> str:
    """`body_roll.gradient = 0.0081 ± 0.0004 rad/(m/s^2)`."""
    return f"{name} = {mean_and_std(e.mean, e.std)} {e.unit}".removesuffix(" 1")
