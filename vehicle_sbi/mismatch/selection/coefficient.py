"""One coefficient under its prior: the weight of its normal with that prior, and draws from both together.

In a slab it counts by its square, on its side of zero; in a box by its mass there.
"""

import math

import numpy as np

from vehicle_sbi.compiled import compiled_apart

TAIL = 4.0 / math.sqrt(2.0 * math.pi)  # twice the mean square's factor in the tail
CLEAR = 3.0  # standard deviations off zero, from which a normal hardly knows the other side of it


@compiled_apart
def log_slab(mean: float, variance: float, sd: float, sign: int) -> float:
    """Log of the expected weight x^2 / sd^2 of a coefficient x under its normal, none on the wrong side of zero.

    With it, the normal of a slab is a moment prior (Johnson and Rossell 2010), which has no mass at zero.
    """
    square = (mean * mean + variance) / (sd * sd)
    if sign == 0:
        return math.log(square)
    std = math.sqrt(variance)
    z = sign * mean / std
    if z < -20.0:  # the tail's expansion: the mean square is 2 phi(z) / |z|^3 (1 - 6 / z^2) variances
        return -0.5 * z * z + math.log(TAIL * variance / (sd * sd)) - 3.0 * math.log(-z) + math.log1p(-6.0 / (z * z))
    density = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    part = square * 0.5 * math.erfc(-z / math.sqrt(2.0)) + z * variance / (sd * sd) * density
    return math.log(max(2.0 * part, 1e-300))


@compiled_apart
def log_box(mean: float, variance: float, low: float, high: float, outside: float) -> float:
    """Log probability of a coefficient, under its normal, to be within its box, which is wrong with a probability."""
    return math.log((1.0 - outside) * _within(mean, math.sqrt(variance), low, high) + outside)


@compiled_apart
def _within(mean: float, std: float, low: float, high: float) -> float:
    """Probability of a normal to be between two limits."""
    wide = math.sqrt(2.0) * std
    return 0.5 * (math.erfc((low - mean) / wide) - math.erfc((high - mean) / wide))


@compiled_apart
def off_zero(mean, std, sign):
    """A draw x in proportion to x^2 times a normal density, on its side of zero if it has one, by rejection.

    Away from zero, of the normal and of z^2 times it (Maxwell's law) in proportion to their parts; near it or beyond,
    of the gamma law t^2 exp(-rate t) that touches the density where it is largest over it.
    """
    if sign != 0 and sign * mean < CLEAR * std:
        low = -sign * mean / std
        rate = 0.5 * (low + math.sqrt(low * low + 12.0))
        while True:
            t = np.random.gamma(3.0, 1.0 / rate)
            if np.random.random() < math.exp(-0.5 * (t - rate + low) ** 2):
                return sign * std * t
    share = mean * mean / (mean * mean + std * std)
    while True:
        z = np.random.standard_normal()
        if np.random.random() > share:
            z = math.copysign(math.sqrt(z * z + 2.0 * np.random.exponential()), z)
        x = mean + std * z
        if np.random.random() * 2.0 * (mean * mean + std * std * z * z) < x * x and sign * x >= 0.0:
            return x


@compiled_apart
def mostly_within(mean, std, low, high, outside):
    """A normal draw within its box, or anywhere with the probability that the box is wrong."""
    within = (1.0 - outside) * _within(mean, std, low, high)
    if np.random.random() * (within + outside) >= within:
        return mean + std * np.random.standard_normal()
    a, b = (low - mean) / std, (high - mean) / std
    return mean + std * (_between(a, b) if b > 0.0 else -_between(-b, -a))


@compiled_apart
def _between(a, b):
    """A standard normal draw between a and b, b being positive (Robert 1995)."""
    if a < 0.0 and b - a > 1.0:
        while True:
            z = np.random.standard_normal()
            if a < z < b:
                return z
    nearest, rate = max(a, 0.0), 0.5 * (a + math.sqrt(a * a + 4.0))
    if (b - a) * rate < 1.0:
        while True:
            z = a + (b - a) * np.random.random()
            if np.random.random() < math.exp(0.5 * (nearest * nearest - z * z)):
                return z
    while True:
        z = a + np.random.exponential(1.0 / rate)
        if z < b and np.random.random() < math.exp(-0.5 * (z - rate) ** 2):
            return z
