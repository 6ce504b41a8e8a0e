"""What is said of one parameter: its posterior in a few numbers, and in words."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.rounding import mean_and_std


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


def quantity(name: str, e: Estimate) -> str:
    """`body_roll.gradient = 0.0081 ± 0.0004 rad/(m/s^2)`."""
    return f"{name} = {mean_and_std(e.mean, e.std)} {e.unit}".removesuffix(" 1")
