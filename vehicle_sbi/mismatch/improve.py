"""Does the extended model predict better what it has not seen: base and extended, scored on held-out recordings.

A model predicts a held-out recording with its parameters as fitted, noise as estimated in the fit and the recording's
own initial states marginalised. The gain is the paired difference of log score per sample, its uncertainty from
blocks of time long enough to be nearly independent.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, t

from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.fit import Observation
from vehicle_sbi.mismatch.foretell import elsewhere

BLOCK_S = 2.0  # [s] of a block of the paired difference
CONFIDENT = 0.9  # of the bounds on the gain


@dataclass(frozen=True)
class Prediction:
    """How a model predicts held-out recordings: error over the signal's spread and coverage of the 90 % band of each
    channel, log score of each sample (zero where nothing was measured), and the series with the band's half width."""

    nrmse: dict[str, float]
    coverage90: float
    log_score: Float[np.ndarray, "channels time"]
    y: Float[np.ndarray, "channels time"]
    half_width: Float[np.ndarray, "channels time"]
    samples: int

    @property
    def mean_log_score(self) -> float:
        return float(self.log_score.sum() / self.samples)


@dataclass(frozen=True)
class Gain:
    """Log score per sample that a model gains over another: mean, standard error, one-sided bounds."""

    mean: float
    std: float
    low: float
    high: float

    @property
    def certain(self) -> bool:
        return self.low > 0.0


def predict(model: Model, held_out: Observation, *, apart: bool) -> Prediction:
    """What the model makes of held-out recordings; `apart` says that they are others than it was fitted to."""
    fit, there = model.fit, elsewhere(model, held_out, apart=apart)
    simulator, metric, valid = there.simulator, there.metric, there.simulator.windows.valid
    rest = there.unexplained
    spread = simulator.space.prior_std
    covariance = fit.covariance / np.outer(spread, spread)
    variance = metric.std**2 + np.einsum(
        "ict,ij,jct->ct", np.nan_to_num(there.at.J), covariance, np.nan_to_num(there.at.J)
    )
    half = norm.ppf(0.95) * np.sqrt(variance)
    per_sample = -0.5 * metric(there.residual) ** 2 - np.log(metric.std) - 0.5 * np.log(2 * np.pi)
    per_sample -= 0.5 * np.log1p(-(simulator.noise.rho[:, None] ** 2))
    nrmse = {
        name: float(np.sqrt(np.mean(rest[i, valid[i]] ** 2)) / max(np.std(held_out.observed[i, valid[i]]), 1e-12))
        for i, name in enumerate(simulator.windows.channels)
        if valid[i].any()
    }
    return Prediction(
        nrmse=nrmse,
        coverage90=float((np.abs(rest) <= half)[valid].mean()),
        log_score=np.where(valid, per_sample, 0.0),
        y=np.where(valid, held_out.observed - rest, there.at.y),
        half_width=half,
        samples=int(valid.sum()),
    )


def gain(base: Prediction, extended: Prediction, rate: float) -> Gain:
    """Paired difference of log scores, over blocks of time."""
    difference = (extended.log_score - base.log_score).sum(axis=0)
    blocks = max(2, int(len(difference) / (BLOCK_S * rate)))
    sums = np.array([part.sum() for part in np.array_split(difference, blocks)])
    scale = len(sums) / base.samples
    mean, std = float(sums.mean() * scale), float(sums.std(ddof=1) / np.sqrt(len(sums)) * scale)
    reach = float(t.ppf(CONFIDENT, len(sums) - 1)) * std
    return Gain(mean, std, mean - reach, mean + reach)
