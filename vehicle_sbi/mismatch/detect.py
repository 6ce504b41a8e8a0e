"""Is there a mismatch at all: the residual against every direction that could explain it, with one null for all.

At a fit, with J what the fitted parameters do and g what a direction does, both whitened and with initial states
marginalised (`fit.Metric`), and r the residual,

    M = I - J' (J J' + I)^-1 J,    b = g M r,    i = g M g',    z = b / sqrt(i)

z is the directed score of the direction, b / i its size at first order. Under the fitted model r is standard normal
noise that has been fitted too, so the null of the largest |z| of any set, with all correlations, comes from noise that
is drawn, fitted (by the same M) and scored. A size that lies outside the prior explains nothing and scores zero.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr

from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.mismatch.fit import Fit

DRAWS = 1000  # of noise, behind a p-value
BEYOND = 1.2  # times its prior's reach that a first-order size may have: larger effects are seldom linear


@dataclass(frozen=True)
class Scores:
    """Directions projected off what the fit absorbs: GM (k, samples), b (k,), i (k,), and the sizes allowed.

    `null` (draws, k) are the scores of drawn noise.
    """

    b: Float[np.ndarray, " k"]
    information: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    cross: Float[np.ndarray, "k k"]
    null: Float[np.ndarray, "draws k"]

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        return _scores(self.b, self.information, self.low, self.high)

    @property
    def p_values(self) -> Float[np.ndarray, " k"]:
        """Of each direction, for the largest of all: how often noise alone scores as high anywhere."""
        highest = np.abs(self.null).max(axis=1)
        return (1.0 + (highest[:, None] >= np.abs(self.z)).sum(axis=0)) / (len(highest) + 1.0)

    @property
    def p_value(self) -> float:
        return float(self.p_values.min(initial=1.0))

    @property
    def log_evidence(self) -> Float[np.ndarray, " k"]:
        """Log Bayes factor of each direction at first order against none, its size uniform over the prior."""
        std = 1.0 / np.sqrt(self.information)
        top, bottom = (self.high - self.b / self.information) / std, (self.low - self.b / self.information) / std
        mass = _log_mass(bottom, top)
        return 0.5 * self.b**2 / self.information + mass + np.log(np.sqrt(2 * np.pi) * std / (self.high - self.low))


def _log_mass(low: Float[np.ndarray, " k"], high: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """log of the standard normal's mass between two bounds, from whichever tail is nearer."""
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    return log_ndtr(b) + np.log1p(-np.exp(np.minimum(log_ndtr(a) - log_ndtr(b), -1e-12)))


def _scores(b: np.ndarray, information: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    size = b / information
    allowed = (size >= BEYOND * low) & (size <= BEYOND * high)
    return np.where(allowed, b / np.sqrt(information), 0.0)


def score(
    fit: Fit,
    changes: Float[np.ndarray, "k channels time"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
    *,
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Scores:
    """Scores of `changes` (per unit of a size that the prior bounds between low and high) at a fit."""
    metric, free = fit.metric, fit.inside
    J = metric(fit.at.J)[free].reshape(int(free.sum()), -1)
    G, r = metric(changes).reshape(len(changes), -1), metric(fit.residual).reshape(-1)
    weights = np.linalg.solve(J @ J.T + np.eye(len(J)), J)
    GM = (G - (G @ J.T) @ weights).astype(np.float32)
    information = np.maximum(np.einsum("kt,kt->k", GM, G), 1e-12)
    noise = rng.standard_normal((draws, GM.shape[1]), dtype=np.float32)
    noise *= metric.valid.reshape(-1)
    null = _scores((noise @ GM.T).astype(float), information, low, high)
    return Scores(GM @ r, information, low, high, GM @ G.T, null)


def relative_noise(of: MeasurementNoise, to: MeasurementNoise) -> Float[np.ndarray, " channels"]:
    """Innovation's standard deviation of each channel in one noise over that in another."""
    return of.floor * np.sqrt(1 - of.rho**2) / (to.floor * np.sqrt(1 - to.rho**2))
