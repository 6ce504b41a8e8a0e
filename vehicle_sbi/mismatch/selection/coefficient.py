"""One coefficient under its prior: the weight of its normal with that prior, and draws from both together.

In a slab it counts by its square within its bounds; in a box by its mass there.
"""

import math

import numpy as np

from vehicle_sbi.compiled import compiled_apart

TAIL = 2.0 / math.sqrt(2.0 * math.pi)  # the mean square's factor in the tail
FAR = 8.0  # standard deviations, beyond which a normal has nothing
CLEAR = 3.0  # standard deviations off zero, from which a normal hardly knows the other side of it


@compiled_apart
def log_square(mean: float, variance: float, low: float, high: float) -> float:
    """Log of the mean of x^2 between two bounds, which enclose zero or begin or end there, of a normal x.

    Over that of a slab's normal it is what a coefficient in the slab counts by: under a moment prior (Johnson and
    Rossell 2010), which has no mass at zero, cut off at the bounds.
    """
    if low < 0.0 and high <= 0.0:
        return log_square(-mean, variance, -high, -low)
    std = math.sqrt(variance)
    a, b, square = (low - mean) / std, (high - mean) / std, mean * mean + variance
    if a < -FAR and b > FAR:
        return math.log(square)
    if low == 0.0 and a > 20.0:  # the tail's expansion: the mean square is 2 phi(a) / a^3 (1 - 6 / a^2) variances
        return -0.5 * a * a + math.log(TAIL * variance) - 3.0 * math.log(a) + math.log1p(-6.0 / (a * a))
    part = square * _mass(a, b)
    if a > -FAR:
        part += std * (mean + low) * math.exp(-0.5 * a * a) / math.sqrt(2.0 * math.pi)
    if b < FAR:
        part -= std * (mean + high) * math.exp(-0.5 * b * b) / math.sqrt(2.0 * math.pi)
    return math.log(max(part, 1e-300))


@compiled_apart
def log_box(mean: float, variance: float, low: float, high: float, outside: float) -> float:
    """Log probability of a coefficient, under its normal, to be within its box, which is wrong with a probability."""
    return math.log((1.0 - outside) * _within(mean, math.sqrt(variance), low, high) + outside)


@compiled_apart
def _within(mean: float, std: float, low: float, high: float) -> float:
    """Probability of a normal to be between two limits."""
    return _mass((low - mean) / std, (high - mean) / std)


@compiled_apart
def _mass(a: float, b: float) -> float:
    """Probability of a standard normal to be between two numbers, also where that is in a tail."""
    if a + b < 0.0:
        return _mass(-b, -a)
    return 0.5 * (math.erfc(a / math.sqrt(2.0)) - math.erfc(b / math.sqrt(2.0)))


@compiled_apart
def off_zero(mean, std, low, high):
    """A draw x in proportion to x^2 times a normal density, between finite bounds as those of `log_square`."""
    if low < 0.0 and high <= 0.0:
        return -off_zero(-mean, std, -high, -low)
    if mean > high or mean < low < 0.0 or high - low < std:  # rather a normal draw between them, by rejection
        most = max(low * low, high * high)
        while True:
            x = between(mean, std, low, high)
            if np.random.random() * most < x * x:
                return x
    while True:
        x = _off_zero(mean, std, low == 0.0)
        if low <= x <= high:
            return x


@compiled_apart
def _off_zero(mean, std, positive):
    """The same without bounds, or above zero, by rejection.

    Away from zero, of the normal and of z^2 times it (Maxwell's law) in proportion to their parts; near it or beyond,
    of the gamma law t^2 exp(-rate t) that touches the density where it is largest over it.
    """
    if positive and mean < CLEAR * std:
        low = -mean / std
        rate = 0.5 * (low + math.sqrt(low * low + 12.0))
        while True:
            t = np.random.gamma(3.0, 1.0 / rate)
            if np.random.random() < math.exp(-0.5 * (t - rate + low) ** 2):
                return std * t
    share = mean * mean / (mean * mean + std * std)
    while True:
        z = np.random.standard_normal()
        if np.random.random() > share:
            z = math.copysign(math.sqrt(z * z + 2.0 * np.random.exponential()), z)
        x = mean + std * z
        if np.random.random() * 2.0 * (mean * mean + std * std * z * z) < x * x and (x >= 0.0 or not positive):
            return x


@compiled_apart
def mostly_within(mean, std, low, high, outside):
    """A normal draw within its box, or anywhere with the probability that the box is wrong."""
    within = (1.0 - outside) * _within(mean, std, low, high)
    if np.random.random() * (within + outside) >= within:
        return mean + std * np.random.standard_normal()
    return between(mean, std, low, high)


@compiled_apart
def between(mean, std, low, high):
    """A normal draw between two bounds."""
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
