"""Where the next round's parameters come from: a posterior, or the prior cut down to where posteriors have mass."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import emcee
import numpy as np
import torch
from jaxtyping import Float
from sbi.inference import EnsemblePosterior
from sbi.inference.posteriors import DirectPosterior
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from sbi.utils import BoxUniform
from torch import Tensor

from vehicle_sbi.errors import InputError
from vehicle_sbi.parameters import ParameterSpace

SUPPORT_SAMPLES = 10_000  # draws that estimate where a posterior has mass
EXCLUDED_MASS = 1e-3  # share of a posterior's mass that truncation cuts off
WIDENED = 1.4  # times as wide as that is what truncation keeps
RADIUS = 8.0  # standard deviations about a fit beyond which no posterior is expected
WALKERS, WARM_UP, THINNING = 1000, 60, 20  # of the ensemble, whose autocorrelation time is about 25 steps
LEAST_SHARED = 100  # draws in the supports of all rounds, from which walkers can start
MOST_REJECTIONS = 50  # batches of draws before resampling takes over
RESAMPLED_FROM = 200_000  # uniform draws of the prior


def box(space: ParameterSpace) -> BoxUniform:
    """The uniform prior over the space's box, as sbi wants it."""
    return BoxUniform(torch.as_tensor(space.low, dtype=torch.float32), torch.as_tensor(space.high, dtype=torch.float32))


def _members(posterior: NeuralPosterior) -> Sequence[DirectPosterior]:
    return posterior.posteriors if isinstance(posterior, EnsemblePosterior) else [cast(DirectPosterior, posterior)]


def _raw(posterior: NeuralPosterior, n: int) -> Float[np.ndarray, "n d"]:
    """n draws of the density itself, inside the prior or not, members of an ensemble mixed."""
    members = _members(posterior)
    counts = np.bincount(torch.randint(len(members), (n,)).numpy(), minlength=len(members))
    with torch.no_grad():
        drawn = [
            m.posterior_estimator.sample(torch.Size([int(c)]), cast(Tensor, m.default_x))[:, 0]
            for m, c in zip(members, counts, strict=True)
            if c
        ]
    theta = torch.cat(drawn)
    return theta[torch.randperm(n)].double().numpy()


def _within(space: ParameterSpace, theta: Float[np.ndarray, "n d"]) -> np.ndarray:
    return np.all((theta >= space.low) & (theta <= space.high), axis=1)


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
    """Where a posterior has mass, and a margin: its density exceeds `threshold`.

    All but EXCLUDED_MASS of the draws lie in a region that is then widened, as a Gaussian's would be whose log density
    falls with the square of the distance. Without a margin nearly all of a support in several dimensions is its rim,
    where the posterior is cut off; a network that learns from the rim comes out a tenth too narrow at the centre.
    """

    posterior: NeuralPosterior
    threshold: float

    @classmethod
    def of(cls, posterior: NeuralPosterior, space: ParameterSpace) -> "Support":
        density = log_density(posterior, draw(posterior, space, SUPPORT_SAMPLES))
        peak = density.max()
        return cls(posterior, float(peak - WIDENED**2 * (peak - np.quantile(density, EXCLUDED_MASS))))

    def contains(self, theta: Float[np.ndarray, "n d"]) -> np.ndarray:
        return log_density(self.posterior, theta) > self.threshold

    def draws(self, space: ParameterSpace, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Points inside the prior and their log density."""
        theta = draw(self.posterior, space, SUPPORT_SAMPLES)
        return theta, log_density(self.posterior, theta)


@dataclass(frozen=True)
class Neighbourhood:
    """Where a Gaussian approximation of the posterior has mass, and a wide margin: within RADIUS of its spread.

    A Gaussian in six dimensions has all but EXCLUDED_MASS within 4.7.
    """

    mean: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]

    def distance(self, theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """From the mean, in standard deviations (Mahalanobis)."""
        return np.linalg.norm(np.linalg.solve(np.linalg.cholesky(self.covariance), (theta - self.mean).T), axis=0)

    def contains(self, theta: Float[np.ndarray, "n d"]) -> np.ndarray:
        return self.distance(theta) < RADIUS

    def draws(self, space: ParameterSpace, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Points inside the prior and their log density: a Gaussian as wide as the neighbourhood."""
        widened = RADIUS / np.sqrt(len(space))
        factor, found = widened * np.linalg.cholesky(self.covariance), np.empty((0, len(space)))
        for _ in range(MOST_REJECTIONS):
            theta = self.mean + rng.standard_normal((SUPPORT_SAMPLES, len(space))) @ factor.T
            found = np.concatenate([found, theta[_within(space, theta)]])[:SUPPORT_SAMPLES]
            if len(found) == SUPPORT_SAMPLES:
                break
        return found, -0.5 * (self.distance(found) / widened) ** 2


Region = Support | Neighbourhood


def inside(supports: Sequence[Region], theta: Float[np.ndarray, "n d"]) -> np.ndarray:
    """Which rows lie in every support."""
    kept = np.ones(len(theta), dtype=bool)
    for support in supports[::-1]:
        rows = np.flatnonzero(kept)
        kept[rows] = support.contains(theta[rows]) if len(rows) else False
    return kept


def truncated_prior(
    space: ParameterSpace, supports: Sequence[Region], n: int, rng: np.random.Generator
) -> Float[np.ndarray, "n d"]:
    """n draws, uniform over the part of the prior that lies in every support.

    Rejection from the prior, or from a box around the support, takes millions of draws once a posterior is narrow or
    has tails. An ensemble of walkers (emcee; Goodman & Weare 2010) moves through the support instead: it starts from
    draws of the last posterior, resampled to be nearly uniform, and needs no scale of its own.
    """
    if not supports:
        return rng.uniform(space.low, space.high, (n, len(space)))
    width = space.high - space.low

    def log_uniform(z: np.ndarray) -> np.ndarray:
        theta = space.low + z * width
        allowed = _within(space, theta)
        allowed[allowed] = inside(supports, theta[allowed])
        return np.where(allowed, 0.0, -np.inf)

    sampler = emcee.EnsembleSampler(
        WALKERS,
        len(space),
        log_uniform,
        vectorize=True,
        moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)],
    )
    start = emcee.State((_spread(space, supports, rng) - space.low) / width)
    start.random_state = np.random.RandomState(rng.integers(2**31)).get_state()
    thinned = -(-n // WALKERS)
    sampler.run_mcmc(start, WARM_UP + THINNING * thinned, skip_initial_state_check=True)
    return (space.low + sampler.get_chain(discard=WARM_UP, thin=THINNING, flat=True) * width)[:n]


def _spread(space: ParameterSpace, supports: Sequence[Region], rng: np.random.Generator) -> np.ndarray:
    """Walkers at draws of the last posterior that lie in every support, weighted against its density."""
    draws, density = supports[-1].draws(space, rng)
    kept = inside(supports, draws)
    draws, density = draws[kept], density[kept]
    if len(draws) < LEAST_SHARED:
        raise InputError(
            f"rounds contradict each other: only {len(draws)} of {SUPPORT_SAMPLES} draws of the last one lie where the "
            "fit and the rounds before leave the parameters. The recording is unlike the simulations, or too few "
            "taught the network: use more rounds.simulations, check stated constants, and where no effects are free, "
            "name what `diagnose` finds in effects=[…]"
        )
    weight = np.exp(density.min() - density)
    return draws[rng.choice(len(draws), WALKERS, replace=len(draws) < WALKERS, p=weight / weight.sum())]


def acceptance(posterior: NeuralPosterior, space: ParameterSpace) -> float:
    """Share of the density's own draws that lie inside the prior; what is missing from 1 is leakage."""
    return float(_within(space, _raw(posterior, SUPPORT_SAMPLES)).mean())
