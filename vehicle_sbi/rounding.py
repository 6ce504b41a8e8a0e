"""Numbers for people: as many digits as their uncertainty supports, which are two of it."""

import numpy as np


def rounded(value: float, std: float) -> str:
    """`value` to the decimal place of the second significant digit of `std`; no uncertainty: three digits."""
    if np.isnan(value):
        return ""
    if np.isinf(value):
        return "∞" if value > 0 else "-∞"
    if not 0.0 < std < np.inf:
        return f"{value:.3g}"
    places = 1 - int(f"{std:.1e}".partition("e")[2])
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"


def mean_and_std(mean: float, std: float) -> str:
    """`mean ± std`, both to the second significant digit of std."""
    return "" if np.isnan(mean) else f"{rounded(mean, std)} ± {rounded(std, std)}"
