"""Does the extended model predict better what it has not seen: base and extended, scored on held-out recordings.

A model predicts a held-out recording with noise as estimated in the fit, its parameters as uncertain as the fit left
them and the recording's own initial states marginalised. Blocks of time are predicted one after another, each with what
those before it say of the parameters, so that log scores add up to that of the whole: with r and J whitened,

    log p(r) = log N(r; 0, I + J J') = log N(r; 0, I) + 1/2 b' A^-1 b - 1/2 log det A,   A = I + J' J,   b = J' r

over all blocks up to one, less the same up to the one before. The gain is the paired difference of log score per
sample, its uncertainty from that of blocks long enough to be nearly independent. So is that of each channel's
continuous ranked probability score, which for a normal prediction is (Gneiting and Raftery 2007, sec. 4.2)

    CRPS = std (z (2 Phi(z) - 1) + 2 phi(z) - pi^(-1/2)),   z the error over its std

What it takes to accept the extended model stands in `acceptance`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import norm, t

from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.observation import Observation

BLOCK_S = 2.0  # [s] of a block of the paired difference
CONFIDENT = 0.9  # of the bounds on the gain


@dataclass(frozen=True)
class Prediction:
    """How a model predicts held-out recordings: error over the signal's spread of each channel, coverage of the 90 %
    band, log score of each block of time, the sum of each channel's CRPS [channel's unit] in each, and the series with
    the band's half width, and over how many `seconds` anything was measured."""

    nrmse: dict[str, float]
    coverage90: float
    log_score: Float[np.ndarray, " blocks"]
    crps: dict[str, Float[np.ndarray, " blocks"]]
    y: Float[np.ndarray, "channels time"]
    half_width: Float[np.ndarray, "channels time"]
    samples: dict[str, int]
    seconds: float

    @property
    def mean_log_score(self) -> float:
        return float(self.log_score.sum() / sum(self.samples.values()))

    @property
    def mean_crps(self) -> dict[str, float]:
        return {name: float(sums.sum() / self.samples[name]) for name, sums in self.crps.items()}


@dataclass(frozen=True)
class Gain:
    """Log score per sample that a model gains over another: mean, standard error, one-sided bounds; and the channels
    that it predicts worse for certain."""

    mean: float
    std: float
    low: float
    high: float
    worse: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        return self.low > 0.0


def predict(model: Model, held_out: Observation, *, apart: bool) -> Prediction | None:
    """What the model makes of held-out recordings; `apart` says that they are others than it was fitted to. None where
    its simulation fails there."""
    fit, there = model.fit, elsewhere(model.fit, held_out, apart=apart)
    simulator, valid = there.simulator, there.simulator.windows.valid
    if not np.isfinite(there.at.y[valid]).all():
        return None
    metric, rest, channels = there.metric, there.unexplained, simulator.windows.channels
    spread = simulator.space.prior_std
    covariance = fit.covariance / np.outer(spread, spread)
    variance = metric.std**2 + np.einsum(
        "ict,ij,jct->ct", np.nan_to_num(there.at.J), covariance, np.nan_to_num(there.at.J)
    )
    std = np.sqrt(variance)
    half = norm.ppf(0.95) * std
    r, J = metric(there.residual), metric(in_std(fit, there.at.J))
    per_sample = np.where(valid, -0.5 * r**2 - 0.5 * np.log(2 * np.pi), 0.0) - metric.log_scale
    ranked = np.where(valid, crps(rest, std), 0.0)
    blocks = _blocks(valid, BLOCK_S * simulator.windows.rate)
    seen = [(i, name) for i, name in enumerate(channels) if valid[i].any()]
    return Prediction(
        nrmse={name: _error(rest[i, valid[i]], held_out.observed[i, valid[i]]) for i, name in seen},
        coverage90=float((np.abs(rest) <= half)[valid].mean()),
        log_score=np.array([per_sample[:, block].sum() for block in blocks]) + _learnt(r, J, blocks),
        crps={name: np.array([ranked[i, block].sum() for block in blocks]) for i, name in seen},
        y=np.where(valid, held_out.observed - rest, there.at.y),
        half_width=half,
        samples={name: int(valid[i].sum()) for i, name in seen},
        seconds=float(valid.any(axis=0).sum() / simulator.windows.rate),
    )


def in_std(fit: Fit, J: Float[np.ndarray, "d channels time"]) -> Float[np.ndarray, "d channels time"]:
    """Derivatives by parameters in units of the prior's spread, as those by a standard deviation of the posterior."""
    spread = fit.simulator.space.prior_std
    root = np.linalg.cholesky(fit.covariance / np.outer(spread, spread))
    return np.tensordot(root.T, J, axes=1)


def crps(error: Float[np.ndarray, "*n"], std: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Of normal predictions that are off by an error."""
    z = error / std
    return std * (z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - np.pi**-0.5)


def _blocks(valid: Bool[np.ndarray, "channels time"], length: float) -> list[np.ndarray]:
    """What was measured, cut into at least two blocks of about so many samples of time."""
    measured = np.flatnonzero(valid.any(axis=0))
    return np.array_split(measured, max(2, int(len(measured) / length)))


def _error(rest: Float[np.ndarray, " n"], observed: Float[np.ndarray, " n"]) -> float:
    """Root mean square over the signal's spread."""
    return float(np.sqrt(np.mean(rest**2)) / max(np.std(observed), 1e-12))


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
    """Paired differences of log scores and of each channel's CRPS, over blocks of time."""
    mean, std, reach = _paired(extended.log_score - base.log_score, sum(base.samples.values()))
    worse = []
    for name, sums in base.crps.items():
        more, _, bound = _paired(extended.crps[name] - sums, base.samples[name])
        worse += [name] if more > bound else []
    return Gain(mean, std, mean - reach, mean + reach, tuple(worse))


def _paired(sums: Float[np.ndarray, " blocks"], samples: int) -> tuple[float, float, float]:
    """Mean per sample of what blocks add up to, its standard error, and how far its one-sided bounds are away."""
    scale = len(sums) / samples
    std = float(sums.std(ddof=1) / np.sqrt(len(sums)) * scale)
    return float(sums.mean() * scale), std, float(t.ppf(CONFIDENT, len(sums) - 1)) * std
