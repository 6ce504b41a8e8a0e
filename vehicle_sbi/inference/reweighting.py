"""Draws of a neural posterior, re-weighted by the simulator's own likelihood.

Where noise is independent from sample to sample the likelihood of (theta, eta) is known, eta being what else is drawn
in a simulation (process noise, initial state). Then the network need only propose: theta_i ~ q(theta | x_o),
eta_i ~ r(eta | theta_i), and

    w_i = p(x_o | theta_i, eta_i) p(eta_i) p(theta_i) / (q(theta_i) r(eta_i | theta_i))

weights the draws to the exact posterior (Robert and Casella, Monte Carlo Statistical Methods, ch. 3; for neural
posteriors Dax et al., Phys. Rev. Lett. 130, 171403, 2023). r is what Laplace's approximation has of eta given theta,
with eta's own prior (`nuisances`). How many draws the weights leave, and the shape k of their tail, say whether the
result is to be relied on (Vehtari et al., Pareto smoothed importance sampling, 2024).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from scipy.special import gammaln, logsumexp

from vehicle_sbi.inference.importance import TRUSTED, pareto_k, systematic, truncated
from vehicle_sbi.inference.information import Laplace
from vehicle_sbi.inference.nuisances import Nuisances, log_prior
from vehicle_sbi.inference.proposal import draw, log_density
from vehicle_sbi.inference.rounds import Problem, at_once
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.rng import Stream, generator

PROPOSED = 4  # draws proposed for each that is asked for
FREEDOM = 5.0  # degrees of freedom of t distributions that propose
LEAST = 200  # effective draws that quantiles need
LEAST_TO_LEARN_FROM = 20  # effective draws whose covariance proposes again
MOST_PROPOSALS = 3


@dataclass(frozen=True)
class Reweighted:
    """Draws of the exact posterior, how many of those proposed they are worth, and the shape of the weights' tail."""

    theta: Float[np.ndarray, "n d"]
    proposed: int
    effective: float
    k: float

    @property
    def trusted(self) -> bool:
        return self.k <= TRUSTED and self.effective >= LEAST

    def sentence(self) -> str:
        """What was done with the draws, for the notes of a run."""
        worth = f"{self.proposed} draws are worth {self.effective:.0f} of it, Pareto k = {self.k:.2f}"
        if self.trusted:
            return f"Draws are re-weighted to the simulator's own likelihood: {worth}."
        return f"Draws are the network's: weights by the simulator's own likelihood cannot be relied on ({worth})."


def posterior_draws(
    problem: Problem, posterior: NeuralPosterior, n: int
) -> tuple[Float[np.ndarray, "n d"], str | None]:
    """n draws, re-weighted where that applies and can be relied on, and a sentence on it.

    Features that lose information have a posterior of their own, which is left as it is. Needs torch's generator
    seeded, as all draws of a network.
    """
    simulator, about = problem.simulator, _fit(problem)
    if about is None:
        return draw(posterior, simulator.space, n), None
    theta = draw(posterior, simulator.space, PROPOSED * n)
    rng = generator(seed=simulator.seed, stream=Stream.POSTERIOR)
    found = reweighted(simulator, problem.observed, (theta, log_density(posterior, theta)), about, n, rng)
    return found.theta if found.trusted else theta[:n], found.sentence()


def draws_about_the_fit(problem: Problem, n: int) -> Reweighted | None:
    """n draws that need no network: a t distribution about the fit proposes them.

    None where the likelihood is not known, or the model does not explain what was observed.
    """
    simulator, about = problem.simulator, _fit(problem)
    if about is None:
        return None
    rng = generator(seed=simulator.seed, stream=Stream.POSTERIOR, index=1)
    proposed = proposed_about(*about.marginal, simulator.space, PROPOSED * n, rng)
    return reweighted(simulator, problem.observed, proposed, about, n, rng)


def _fit(problem: Problem) -> Laplace | None:
    """What draws are proposed about; None where there is no fit, or none of whose draws the likelihood can weight."""
    return problem.laplace if problem.features.efficient and applies(problem.simulator) else None


def applies(simulator: Simulator) -> bool:
    """Whether the likelihood is known: independent noise, drawn once a simulation, no plausible effects."""
    per_sample = simulator.process.per_sample and (simulator.process.stiffness.std or simulator.process.inputs.std)
    return not simulator.noise.rho.any() and not per_sample and not len(simulator.plausible)


def reweighted(
    simulator: Simulator,
    observed: Float[np.ndarray, "channels time"],
    proposed: tuple[Float[np.ndarray, "m d"], Float[np.ndarray, " m"]],
    about: Laplace,
    n: int,
    rng: np.random.Generator,
) -> Reweighted:
    """n draws of the exact posterior, from proposed ones that are given with the logarithm of their density.

    Where those are worth fewer than n, or their weights cannot be relied on, a t distribution proposes as many more:
    with their weighted mean and covariance (Cappe et al., Population Monte Carlo, 2004), or with those of the fit where
    they are worth too few for that. `about` is that fit; it also says where the nuisances are likely.
    """
    target = _Target(simulator, observed, Nuisances.of(simulator, about))
    found = target.weighted(*proposed, rng)
    for _ in range(1, MOST_PROPOSALS):
        if found.effective >= n and found.reliable:
            break
        mean, covariance = found.moments if found.effective > LEAST_TO_LEARN_FROM else about.marginal
        theta, log_q = proposed_about(mean, covariance, simulator.space, len(proposed[0]), rng)
        found = found.joined(target.weighted(theta, log_q, rng)) if len(theta) else found
    return found.resampled(n, rng)


def proposed_about(
    mean: Float[np.ndarray, " d"],
    covariance: Float[np.ndarray, "d d"],
    space: ParameterSpace,
    m: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "k d"], Float[np.ndarray, " k"]]:
    """Of m draws of a t distribution those inside the prior, and the logarithm of their density."""
    off, log_q = t_draws(m, np.linalg.cholesky(np.atleast_2d(covariance)), rng)
    theta = mean + off
    inside = np.all((theta >= space.low) & (theta <= space.high), axis=1)
    return theta[inside], log_q[inside]


def t_draws(
    n: int, factor: Float[np.ndarray, "e e"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n e"], Float[np.ndarray, " n"]]:
    """n draws of a t distribution about zero with scale factor factor', and the logarithm of their density."""
    e = len(factor)
    unit = rng.standard_normal((n, e)) / np.sqrt(rng.chisquare(FREEDOM, (n, 1)) / FREEDOM)
    constant = gammaln((FREEDOM + e) / 2) - gammaln(FREEDOM / 2) - e / 2 * np.log(FREEDOM * np.pi)
    constant -= np.log(np.diag(factor)).sum()
    return unit @ factor.T, constant - (FREEDOM + e) / 2 * np.log1p((unit**2).sum(axis=1) / FREEDOM)


@dataclass(frozen=True)
class _Weighted:
    """Draws with the logarithm of their weights, up to a constant."""

    theta: Float[np.ndarray, "m d"]
    log_weight: Float[np.ndarray, " m"]

    @cached_property
    def weight(self) -> Float[np.ndarray, " m"]:
        """Normalised; zero where all of them are."""
        return truncated(self.log_weight) if np.isfinite(self.log_weight).any() else np.zeros(len(self.theta))

    @cached_property
    def k(self) -> float:
        """Shape of the weights' tail; infinite where all of them are zero."""
        return pareto_k(self.log_weight) if self.weight.any() else np.inf

    @property
    def reliable(self) -> bool:
        return self.k <= TRUSTED

    @property
    def effective(self) -> float:
        """Independent draws that they are worth."""
        return 1.0 / float(self.weight @ self.weight) if self.weight.any() else 0.0

    def joined(self, other: "_Weighted") -> "_Weighted":
        """Both, each for as much as it is worth; the better one where the weights of one cannot be relied on."""
        if not (self.reliable and other.reliable):
            return max(self, other, key=lambda one: (one.reliable, one.effective))
        parts = [one.log_weight - logsumexp(one.log_weight) + np.log(one.effective) for one in (self, other)]
        return _Weighted(np.concatenate([self.theta, other.theta]), np.concatenate(parts))

    @property
    def moments(self) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]]:
        """Weighted mean and covariance."""
        return self.weight @ self.theta, np.cov(self.theta.T, aweights=self.weight)

    def resampled(self, n: int, rng: np.random.Generator) -> Reweighted:
        """n of the draws, in proportion to their weights."""
        if not self.weight.any():
            return Reweighted(self.theta[:n], len(self.theta), 0.0, np.inf)
        chosen = rng.permutation(systematic(self.weight, n, rng))
        return Reweighted(self.theta[chosen], len(self.theta), self.effective, self.k)


@dataclass(frozen=True)
class _Target:
    """The exact posterior of theta, its nuisances drawn with each."""

    simulator: Simulator
    observed: Float[np.ndarray, "channels time"]
    nuisances: Nuisances

    def weighted(
        self, theta: Float[np.ndarray, "m d"], log_q: Float[np.ndarray, " m"], rng: np.random.Generator
    ) -> _Weighted:
        """Draws of any density inside the prior, weighted to this posterior."""
        eta, log_r = self.nuisances.sample(theta, rng)
        likelihood = log_likelihood(self.simulator, self.observed, theta, eta)
        return _Weighted(theta, likelihood + log_prior(self.simulator, eta) - log_q - log_r)


def log_likelihood(
    simulator: Simulator,
    observed: Float[np.ndarray, "channels time"],
    theta: Float[np.ndarray, "n d"],
    eta: Float[np.ndarray, "n e"],
) -> Float[np.ndarray, " n"]:
    """log p(x_o | theta, eta) under independent noise; minus infinity where the simulation fails."""
    valid, parts = simulator.windows.valid, []
    for rows in np.array_split(np.arange(len(theta)), -(-len(theta) // at_once(simulator))):
        y = simulator.noise_free(theta[rows], eta[rows])
        std = simulator.noise.std(y)[:, valid]
        parts.append(-(0.5 * ((observed[valid] - y[:, valid]) / std) ** 2 + np.log(std)).sum(axis=1))
    total = np.concatenate(parts)
    return np.where(np.isfinite(total), total, -np.inf)
