"""What is drawn in a simulation beside theta: its prior, and what the likelihood makes of it once theta is given.

Laplace's approximation takes each nuisance's prior for a standard normal. Given theta and the nuisances before it, one
is then normal with mean m and variance v, so the likelihood alone says exp(h x - P x^2 / 2), with P = 1 / v - 1 and
h = m / v. Its own prior is a mixture of normals N(a, s^2), some of which may be far narrower than the mixture. Times
the likelihood each stays a normal (Bishop, Pattern Recognition and Machine Learning, sec. 2.3.3):

    variance c = s^2 / (1 + P s^2), mean a + c (h - P a),
    weight exp(h a - P a^2 / 2 + c (h - P a)^2 / 2) / sqrt(1 + P s^2).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from vehicle_sbi.inference.information import Laplace
from vehicle_sbi.inference.simulator import STATES, STIFFNESSES, Simulator

WIDENED = ((0.8, 1.0), (0.2, 2.0))  # shares of draws, and times as wide as Laplace has it the likelihood is for these


@dataclass(frozen=True)
class NormalMixture:
    """Normals and the logarithms of their weights: the same k of them in each row, or others."""

    log_weight: Float[np.ndarray, "#n k"]
    mean: Float[np.ndarray, "#n k"]
    variance: Float[np.ndarray, " k"]

    @classmethod
    def standard(cls) -> "NormalMixture":
        return cls(np.zeros((1, 1)), np.zeros((1, 1)), np.ones(1))

    def log_density(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        each = -0.5 * ((x[:, None] - self.mean) ** 2 / self.variance + np.log(2.0 * np.pi * self.variance))
        return np.asarray(logsumexp(self.log_weight + each, axis=1))

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
        """A draw for each row."""
        k = (self.log_weight + rng.gumbel(size=self.log_weight.shape)).argmax(axis=1)  # in proportion to the weights
        return self.mean[np.arange(len(k)), k] + np.sqrt(self.variance[k]) * rng.standard_normal(len(k))

    def updated(self, h: Float[np.ndarray, " n"], P: float) -> "NormalMixture":
        """Times a likelihood exp(h x - P x^2 / 2) of its own in each row, weights summing to one."""
        gain = h[:, None] - P * self.mean
        shrunk = 1.0 + P * self.variance
        variance = self.variance / shrunk
        log_weight = self.log_weight + h[:, None] * self.mean - 0.5 * P * self.mean**2
        log_weight += 0.5 * variance * gain**2 - 0.5 * np.log(shrunk)
        return NormalMixture(
            log_weight - np.asarray(logsumexp(log_weight, axis=1, keepdims=True)), self.mean + variance * gain, variance
        )

    def with_tails(self, mean: Float[np.ndarray, " n"], variance: float) -> "NormalMixture":
        """This prior of a nuisance, given a normal that has a standard normal in its place; tails that are heavier."""
        parts = [
            (np.log(share), self.updated(mean / variance / wider**2, (1.0 / variance - 1.0) / wider**2))
            for share, wider in WIDENED
        ]
        return NormalMixture(
            np.concatenate([log_share + part.log_weight for log_share, part in parts], axis=1),
            np.concatenate([part.mean for _, part in parts], axis=1),
            np.concatenate([part.variance for _, part in parts]),
        )


@dataclass(frozen=True)
class Nuisances:
    """Where those of a simulator are likely once theta is given."""

    about: Laplace
    priors: tuple[NormalMixture, ...]

    @classmethod
    def of(cls, simulator: Simulator, about: Laplace) -> "Nuisances":
        return cls(about, tuple(prior_of(simulator, name) for name in simulator.nuisances))

    def sample(
        self, theta: Float[np.ndarray, "n d"], rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "n e"], Float[np.ndarray, " n"]]:
        """A draw for each theta, one nuisance after the other, and the logarithm of its density."""
        d, L = len(self.about.theta), np.linalg.cholesky(self.about.covariance)
        eta, log_density = np.empty((len(theta), len(self.priors))), np.zeros(len(theta))
        white = np.empty((len(theta), len(L)))  # (theta, eta) about the fit is L white
        white[:, :d] = solve_triangular(L[:d, :d], (theta - self.about.theta).T, lower=True).T
        for i, prior in enumerate(self.priors):
            row, std = L[d + i, : d + i], L[d + i, d + i]
            mean = self.about.eta[i] + white[:, : d + i] @ row
            given = prior.with_tails(mean, std**2)
            eta[:, i] = given.sample(rng)
            log_density += given.log_density(eta[:, i])
            white[:, d + i] = (eta[:, i] - mean) / std
        return eta, log_density


def prior_of(simulator: Simulator, name: str) -> NormalMixture:
    """That of a nuisance in standard deviations about its mean; of an initial state a normal, also where it is
    uniform."""
    if name in STIFFNESSES:
        mixture = simulator.process.stiffness
    elif name in ("steering", "torque"):
        mixture = simulator.process.inputs
    else:
        return NormalMixture.standard()
    log_weight = np.full((1, len(mixture.means)), -np.log(len(mixture.means)))
    return NormalMixture(
        log_weight, (mixture.means[None] - mixture.mean) / mixture.std, (mixture.stds / mixture.std) ** 2
    )


def log_prior(simulator: Simulator, eta: Float[np.ndarray, "n e"]) -> Float[np.ndarray, " n"]:
    """Log density of nuisances, in units of their standard deviations about their means."""
    total = np.zeros(len(eta))
    for name, values in zip(simulator.nuisances, eta.T, strict=True):
        if simulator.uniform_start and name.rpartition("_")[0] in STATES:
            total += np.where(np.abs(values) <= np.sqrt(3.0), -np.log(2.0 * np.sqrt(3.0)), -np.inf)
        else:
            total += prior_of(simulator, name).log_density(values)
    return total
