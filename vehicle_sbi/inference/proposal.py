"""Where the next round's parameters come from: a posterior, or the prior cut down to where posteriors have mass."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from sbi.inference.posteriors.base_posterior import NeuralPosterior

from vehicle_sbi.parameters import ParameterSpace

SUPPORT_SAMPLES = 10_000  # draws that estimate where a posterior has mass
EXCLUDED_MASS = 1e-3  # share of a posterior's mass that truncation cuts off
MARGIN = 0.05  # of the sampled range, by which the bounding box is widened
CANDIDATES = 20_000
MOST_CANDIDATES = 50_000_000
MOST_REJECTIONS = 50  # batches of draws before resampling takes over
RESAMPLED_FROM = 200_000  # uniform draws of the prior


def _members(posterior: NeuralPosterior) -> Sequence[NeuralPosterior]:
    return getattr(posterior, "posteriors", [posterior])


def _raw(posterior: NeuralPosterior, n: int) -> Float[np.ndarray, "n d"]:
    """n draws of the density itself, inside the prior or not, members of an ensemble mixed."""
    members = _members(posterior)
    counts = np.bincount(torch.randint(len(members), (n,)).numpy(), minlength=len(members))
    with torch.no_grad():
        drawn = [m.posterior_estimator.sample((int(c),), m.default_x)[:, 0] for m, c in zip(members, counts, strict=True) if c]  # pyright: ignore
    theta = torch.cat(drawn)
    return theta[torch.randperm(n)].double().numpy()


def _within(space: ParameterSpace, theta: Float[np.ndarray, "n d"]) -> np.ndarray:
    return ((theta >= space.low) & (theta <= space.high)).all(axis=1)


def draw(posterior: NeuralPosterior, space: ParameterSpace, n: int) -> Float[np.ndarray, "n d"]:
    """n draws inside the prior: by rejection where that ends soon, else by importance resampling from the box.

    sbi's own rejection sampling has no bound on its time where nearly all of a density lies outside the prior.
    """
    found: list[np.ndarray] = []
    for _ in range(MOST_REJECTIONS):
        theta = _raw(posterior, n)
        found.append(theta[_within(space, theta)])
        if sum(map(len, found)) >= n:
            return np.concatenate(found)[:n]
    candidates = space.low + torch.rand(RESAMPLED_FROM, len(space)).double().numpy() * (space.high - space.low)
    weight = torch.as_tensor(log_density(posterior, candidates)).softmax(dim=0)
    return candidates[torch.multinomial(weight, n, replacement=True).numpy()]


def log_density(posterior: NeuralPosterior, theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """log q(theta | x_o), up to the constant that leakage costs."""
    members = _members(posterior)
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
    def of(cls, posterior: NeuralPosterior, space: ParameterSpace) -> "Support":
        samples = draw(posterior, space, SUPPORT_SAMPLES)
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
        theta = theta[_within(space, theta)]
        found.append(theta[inside(supports[::-1], theta)])
        tried += CANDIDATES
        if tried > MOST_CANDIDATES:
            raise RuntimeError(f"only {sum(map(len, found))} of {tried} candidates lie in the truncated prior")
    return np.concatenate(found)[:n]


def acceptance(posterior: NeuralPosterior, space: ParameterSpace) -> float:
    """Share of the density's own draws that lie inside the prior; what is missing from 1 is leakage."""
    return float(_within(space, _raw(posterior, SUPPORT_SAMPLES)).mean())
