"""Does the extended model predict better what it has not seen: base and extended, scored on held-out recordings.

A model predicts a held-out recording with noise as estimated in the fit, its parameters as uncertain as the fit left
them and the recording's own initial states marginalised. Blocks of time are predicted one after another, each with what
those before it say of the parameters, so that log scores add up to that of the whole: with r and J whitened,

    log p(r) = log N(r; 0, I + J J') = log N(r; 0, I) + 1/2 b' A^-1 b - 1/2 log det A,   A = I + J' J,   b = J' r

over all blocks up to one, less the same up to the one before. The gain is the paired difference of log score per
sample, its uncertainty from that of blocks long enough to be nearly independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, t

from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.fit import Observation
from vehicle_sbi.mismatch.foretell import elsewhere, in_std

BLOCK_S = 2.0  # [s] of a block of the paired difference
CONFIDENT = 0.9  # of the bounds on the gain


@dataclass(frozen=True)
class Prediction:
    """How a model predicts held-out recordings: error over the signal's spread and coverage of the 90 % band of each
    channel, log score of each block of time, and the series with the band's half width."""

    nrmse: dict[str, float]
    coverage90: float
    log_score: Float[np.ndarray, " blocks"]
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
    r, J = metric(there.residual), metric(in_std(fit, there.at.J))
    per_sample = -0.5 * r**2 - np.log(metric.std) - 0.5 * np.log(2 * np.pi)
    per_sample -= 0.5 * np.log1p(-(simulator.noise.rho[:, None] ** 2))
    count = max(2, int(r.shape[1] / (BLOCK_S * simulator.windows.rate)))
    blocks = np.array_split(np.arange(r.shape[1]), count)
    plain = np.array([per_sample[:, block][valid[:, block]].sum() for block in blocks])
    nrmse = {
        name: float(np.sqrt(np.mean(rest[i, valid[i]] ** 2)) / max(np.std(held_out.observed[i, valid[i]]), 1e-12))
        for i, name in enumerate(simulator.windows.channels)
        if valid[i].any()
    }
    return Prediction(
        nrmse=nrmse,
        coverage90=float((np.abs(rest) <= half)[valid].mean()),
        log_score=plain + _learnt(r, J, blocks),
        y=np.where(valid, held_out.observed - rest, there.at.y),
        half_width=half,
        samples=int(valid.sum()),
    )


def _learnt(
    r: Float[np.ndarray, "channels time"], J: Float[np.ndarray, "d channels time"], blocks: Sequence[np.ndarray]
) -> Float[np.ndarray, " blocks"]:
    """What parameters that are uncertain and learn from each block add to its log score."""
    A, b, reached = np.eye(len(J)), np.zeros(len(J)), [0.0]
    for block in blocks:
        rows = J[..., block].reshape(len(J), -1)
        A, b = A + rows @ rows.T, b + rows @ r[:, block].ravel()
        reached.append(0.5 * float(b @ np.linalg.solve(A, b)) - 0.5 * float(np.linalg.slogdet(A)[1]))
    return np.diff(reached)


def gain(base: Prediction, extended: Prediction) -> Gain:
    """Paired difference of log scores, over blocks of time."""
    sums = extended.log_score - base.log_score
    scale = len(sums) / base.samples
    mean, std = float(sums.mean() * scale), float(sums.std(ddof=1) / np.sqrt(len(sums)) * scale)
    reach = float(t.ppf(CONFIDENT, len(sums) - 1)) * std
    return Gain(mean, std, mean - reach, mean + reach)
