"""Importance weights: what their tail says of them, weights of finite variance, and draws in proportion to them."""

import numpy as np
from jaxtyping import Float
from scipy.stats import genpareto

TRUSTED = 0.7  # Pareto k up to which weighted averages can be relied on (Vehtari et al. 2024, sec. 3)


def pareto_k(log_weight: Float[np.ndarray, " n"]) -> float:
    """Shape of the tail of importance weights, drawn towards 0.5 as ten more weights would."""
    tail = int(min(len(log_weight) / 5, 3.0 * np.sqrt(len(log_weight))))
    ordered = np.exp(np.sort(log_weight - log_weight.max())[-tail - 1 :])
    over = ordered[1:] - ordered[0]
    if over[-1] <= 0.0:
        return -np.inf
    k = float(genpareto.fit(over / over.mean(), floc=0.0)[0])
    return (tail * k + 10 * 0.5) / (tail + 10)


def truncated(log_weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Normalised weights, none above sqrt(n) times the mean, so that their variance is finite (Ionides 2008)."""
    weight = np.exp(log_weight - log_weight.max())
    weight = np.minimum(weight, np.sqrt(len(weight)) * weight.mean())
    return weight / weight.sum()


def systematic(weight: Float[np.ndarray, " n"], n: int, rng: np.random.Generator) -> np.ndarray:
    """n rows drawn in proportion to their weights, each as often as its share of n, rounded up or down."""
    edges = np.cumsum(weight)
    return np.minimum(np.searchsorted(edges, (np.arange(n) + rng.uniform()) / n), len(weight) - 1)
