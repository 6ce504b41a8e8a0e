"""Numbers for people: as many digits as their uncertainty supports, which are two of it."""

import numpy as np

NONE = 1e-12  # part of a value, below which its uncertainty is none: it lies on a bound


def rounded(value: float, std: float) -> str:
    """`value` to the decimal place of the second significant digit of `std`; next to no uncertainty: three digits."""
    if np.isnan(value):
        return ""
    if np.isinf(value):
        return "∞" if value > 0 else "-∞"
    if not NONE * abs(value) < std < np.inf:
        return f"{value:.3g}"
    places = 1 - int(f"{std:.1e}".partition("e")[2])
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"


def mean_and_std(mean: float, std: float) -> str:
    """`mean ± std`, both to the second significant digit of std."""
    if np.isnan(mean):
        return ""
    return f"{rounded(mean, std)} ± {rounded(std, std) if std > NONE * abs(mean) else '0'}"
