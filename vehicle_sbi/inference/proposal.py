"""Where the next round's parameters come from: a posterior, or the prior cut down to where posteriors have mass."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from torch import Tensor

from vehicle_sbi.parameters import ParameterSpace

SUPPORT_SAMPLES = 10_000  # draws that estimate where a posterior has mass
EXCLUDED_MASS = 1e-3  # share of a posterior's mass that truncation cuts off
MARGIN = 0.05  # of the sampled range, by which the bounding box is widened
CANDIDATES = 20_000
MOST_CANDIDATES = 50_000_000


def draw(posterior: NeuralPosterior, n: int) -> Float[np.ndarray, "n d"]:
    """Samples of a posterior inside its prior, in random order even where an ensemble returns them by member."""
    samples = posterior.sample((n,), show_progress_bars=False).detach()
    return samples[torch.randperm(len(samples))].double().numpy()


def log_density(posterior: NeuralPosterior, theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """log q(theta | x_o), up to the constant that leakage costs."""
    members: Sequence[NeuralPosterior] = getattr(posterior, "posteriors", [posterior])
    at = torch.as_tensor(theta, dtype=torch.float32)
    with torch.no_grad():
        each = torch.stack([member.log_prob(at, norm_posterior=False) for member in members])
    return (torch.logsumexp(each, dim=0) - np.log(len(members))).double().numpy()


@dataclass(frozen=True)
class Support:
    """The highest-density region that holds all but EXCLUDED_MASS of a posterior, with a rotated box around it.

    The box makes uniform sampling exact and cheap: candidates are uniform in it, and kept where the density is high
    enough. It spans mean + axes' z with z between low and high.
    """

    posterior: NeuralPosterior
    threshold: float
    mean: Float[np.ndarray, " d"]
    axes: Float[np.ndarray, "d d"]
    low: Float[np.ndarray, " d"]
    high: Float[np.ndarray, " d"]

    @classmethod
    def of(cls, posterior: NeuralPosterior) -> "Support":
        samples = draw(posterior, SUPPORT_SAMPLES)
        density = log_density(posterior, samples)
        threshold = float(np.quantile(density, EXCLUDED_MASS))
        kept = samples[density > threshold]
        mean, axes = kept.mean(axis=0), np.linalg.cholesky(np.cov(kept.T).reshape(kept.shape[1], -1)).T
        z = np.linalg.solve(axes.T, (kept - mean).T).T
        margin = MARGIN * (z.max(axis=0) - z.min(axis=0))
        return cls(posterior, threshold, mean, axes, z.min(axis=0) - margin, z.max(axis=0) + margin)

    def contains(self, theta: Float[np.ndarray, "n d"]) -> np.ndarray:
        return log_density(self.posterior, theta) > self.threshold

    def candidates(self, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        return self.mean + rng.uniform(self.low, self.high, (CANDIDATES, len(self.low))) @ self.axes


def inside(supports: Sequence[Support], theta: Float[np.ndarray, "n d"]) -> np.ndarray:
    """Which rows lie in every support."""
    kept = np.ones(len(theta), dtype=bool)
    for support in supports:
        rows = np.flatnonzero(kept)
        kept[rows] = support.contains(theta[rows]) if len(rows) else False
    return kept


def truncated_prior(
    space: ParameterSpace, supports: Sequence[Support], n: int, rng: np.random.Generator
) -> Float[np.ndarray, "n d"]:
    """n draws, uniform over the part of the prior that lies in every support.

    Raises RuntimeError if so little of the last support's box qualifies that sampling would not end.
    """
    if not supports:
        return rng.uniform(space.low, space.high, (n, len(space)))
    found: list[np.ndarray] = []
    tried = 0
    while sum(map(len, found)) < n:
        theta = supports[-1].candidates(rng)
        theta = theta[((theta >= space.low) & (theta <= space.high)).all(axis=1)]
        found.append(theta[inside(supports[::-1], theta)])
        tried += CANDIDATES
        if tried > MOST_CANDIDATES:
            raise RuntimeError(f"only {sum(map(len, found))} of {tried} candidates lie in the truncated prior")
    return np.concatenate(found)[:n]


def acceptance(posterior: NeuralPosterior, space: ParameterSpace, n: int = SUPPORT_SAMPLES) -> float:
    """Share of the raw density's draws that lie inside the prior; what is missing from 1 is leakage."""
    members: Sequence[NeuralPosterior] = getattr(posterior, "posteriors", [posterior])
    draws = [_raw(member, n // len(members)) for member in members]
    theta = torch.cat(draws).double().numpy()
    return float(((theta >= space.low) & (theta <= space.high)).all(axis=1).mean())


def _raw(member: NeuralPosterior, n: int) -> Tensor:
    with torch.no_grad():
        return member.posterior_estimator.sample((n,), member.default_x)[:, 0]  # pyright: ignore[reportAttributeAccessIssue]
