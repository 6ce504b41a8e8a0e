"""The posterior of a model's effects where a normal about its fit is none: when something began, where a force attacks.

Points in the effects' parameters come from all of their prior, and are carried to the posterior by raising the power of
the likelihood in steps that leave half of the points to count (sequential Monte Carlo, Del Moral, Doucet and Jasra
2006): weighted, drawn again by their weights, moved by differences of pairs of others (ter Braak 2006). So they find
what is far from the fit as well, such as a force of the other sign with another lever arm. All other parameters are
integrated out, normal given the effects'; with A their information and r what a point leaves over,

    log p(r | effects) = power (- 1/2 |r|^2) + 1/2 b' A^-1 b,   A = power J J' + 1,   b = power J r
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import brentq
from scipy.special import softmax

from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.fit import Fit, descend, with_own_noise

MOST = 8  # parameters of effects together: more of them are the values of a profile, which act alike
MOST_SAMPLES = 25_000  # of all channels together; ten thousand simulations of more of them take more than minutes
MOST_INTEGRATED = 5_000  # steps of a simulation, for the same reason; where wheels turn freely there are many a sample
LIKELY = 0.2  # probability of a set, alone or beside something unknown, from which its sizes are worth the time
POINTS = 200
KEPT = 0.5  # of the points count after each step
MOVES = 4  # of each point in each step
MOST_STEPS = 25
LAST_MOVES = 12  # of each point in the end
FAR = 0.1  # share of moves by a whole difference, from one mode to another
LOST = 3.0  # log likelihood by which the best point may fall short of the fit
BETTER = 1.0  # by which another fit has to be likelier


@dataclass(frozen=True)
class Marginal:
    """How likely effects are, under a likelihood to a power; `own` are the places of their parameters."""

    fit: Fit
    own: Bool[np.ndarray, " d"]
    power: float

    @cached_property
    def _others(self) -> Float[np.ndarray, "b samples"]:
        """What other parameters do, per standard deviation of their priors, whitened."""
        return self.fit.metric(self.fit.at.J[~self.own]).reshape(int((~self.own).sum()), -1)

    @cached_property
    def _precision(self) -> Float[np.ndarray, "b b"]:
        return self.power * self._others @ self._others.T + np.eye(len(self._others))

    @property
    def box(self) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
        """Bounds of the effects' parameters."""
        space = self.fit.simulator.space
        return space.low[self.own], space.high[self.own]

    def of(self, phi: Float[np.ndarray, "n q"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n b"]]:
        """Log likelihood of effects' parameters and the other parameters' mean given them; none outside the box."""
        low, high = self.box
        log_likelihood, mean = np.full(len(phi), -np.inf), np.zeros((len(phi), len(self._others)))
        inside = np.flatnonzero(((phi >= low) & (phi <= high)).all(axis=1))
        if len(inside):
            fit = self.fit
            theta = np.repeat(fit.theta[None], len(inside), axis=0)
            theta[:, self.own] = phi[inside]
            off = fit.observation.observed - fit.simulator.noise_free(theta)
            good = np.isfinite(off[:, fit.simulator.windows.valid]).all(axis=1)
            r = fit.metric(np.where(fit.simulator.windows.valid, np.nan_to_num(off), 0.0)).reshape(len(inside), -1)
            b = self.power * r @ self._others.T
            mean[inside] = np.linalg.solve(self._precision, b.T).T
            found = -0.5 * self.power * np.sum(r**2, axis=1) + 0.5 * np.sum(b * mean[inside], axis=1)
            log_likelihood[inside] = np.where(good, found, -np.inf)
        return log_likelihood, mean

    def drawn(
        self, phi: Float[np.ndarray, "n q"], mean: Float[np.ndarray, "n b"], rng: np.random.Generator
    ) -> Float[np.ndarray, "n d"]:
        """All parameters, inside their box."""
        space, fit = self.fit.simulator.space, self.fit
        theta = np.repeat(fit.theta[None], len(phi), axis=0)
        theta[:, self.own] = phi
        spread = np.linalg.cholesky(np.linalg.inv(self._precision))
        about = mean + rng.standard_normal(mean.shape) @ spread.T
        theta[:, ~self.own] += about * space.prior_std[~self.own]
        return np.clip(theta, space.low, space.high)


def sized(found: Explanation, rng: np.random.Generator) -> Explanation:
    """With draws from the posterior of the most probable set, if it is likely at all, has more parameters than effects
    and recordings are not too long for that.

    A likelier fit that is found on the way takes the place of the set's own.
    """
    if not (found.detected and found.models) or found.standing[0] < LIKELY:
        return found
    model, *others = found.models
    if not len(model.effects) < int(model.own.sum()) <= MOST or _takes_minutes(model.fit):
        return found
    draws = sampled(model, found.temper, rng)
    if draws is None:
        return found
    return replace(found, models=[replace(_at_its_best(model, draws), posterior=draws), *others])


def _takes_minutes(fit: Fit) -> bool:
    """Whether ten thousand simulations take more than minutes."""
    simulator = fit.simulator
    return fit.at.y.size > MOST_SAMPLES or simulator.windows.t.size * simulator.substeps > MOST_INTEGRATED


def _at_its_best(model: Model, draws: Float[np.ndarray, "n d"]) -> Model:
    """The model fitted from the middle of its posterior, if that is likelier."""
    spread = draws.std(axis=0) + 1e-12
    middle = draws[np.argmin(np.sum(((draws - np.median(draws, axis=0)) / spread) ** 2, axis=1))]
    found = descend(model.fit.observation, middle)
    if found is None or found.log_likelihood < model.fit.log_likelihood + BETTER:
        return model
    return replace(model, fit=with_own_noise(found))


def sampled(model: Model, power: float, rng: np.random.Generator) -> Float[np.ndarray, "n d"] | None:
    """Draws of all parameters of a model with effects; None where they do not reach the fit."""
    fit, own = model.fit, model.own
    target = Marginal(fit, own, power)
    low, high = target.box
    phi = rng.uniform(low, high, (POINTS, len(low)))
    (likelihood, mean), risen = target.of(phi), 0.0
    for _ in range(MOST_STEPS):
        step = _step(likelihood, 1.0 - risen)
        weight = _log_weight(likelihood, step)
        rows = rng.choice(POINTS, POINTS, p=softmax(weight))
        phi, likelihood, mean, risen = phi[rows], likelihood[rows], mean[rows], risen + step
        for _ in range(MOVES if risen < 1.0 else LAST_MOVES):
            phi, likelihood, mean = _moved(target, phi, likelihood, mean, risen, rng)
        if risen >= 1.0:
            break
    here, _ = target.of(fit.theta[None, own])
    if risen < 1.0 or likelihood.max() < here[0] - LOST:
        return None
    return target.drawn(phi, mean, rng)


def _log_weight(log_likelihood: Float[np.ndarray, " n"], step: float) -> Float[np.ndarray, " n"]:
    """Of points whose likelihood's power is raised by a step, those that cannot be simulated having none."""
    alive = np.isfinite(log_likelihood)
    return np.where(alive, step * np.where(alive, log_likelihood, 0.0), -np.inf)


def _step(log_likelihood: Float[np.ndarray, " n"], most: float) -> float:
    """The power to add, so that so many points count as are to be kept; none if fewer can be simulated."""

    def beyond(step: float) -> float:
        share = softmax(_log_weight(log_likelihood, step))
        return float(1.0 / np.sum(share**2)) - KEPT * len(share)

    if beyond(0.0) <= 0.0:
        return 0.0
    return most if beyond(most) > 0.0 else float(np.asarray(brentq(beyond, 0.0, most)))


def _moved(
    target: Marginal,
    phi: Float[np.ndarray, "n q"],
    likelihood: Float[np.ndarray, " n"],
    mean: Float[np.ndarray, "n b"],
    risen: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "n q"], Float[np.ndarray, " n"], Float[np.ndarray, "n b"]]:
    """Every point, a difference of two others further, where that is as likely."""
    n, q = phi.shape
    first, second = (rng.permutation(n) for _ in range(2))
    far = np.where(rng.uniform(size=(n, 1)) < FAR, 1.0, 2.38 / np.sqrt(2.0 * q) * rng.uniform(0.2, 1.0, (n, 1)))
    to = phi + far * (phi[first] - phi[second]) * rng.normal(1.0, 0.1, (n, q))
    found, given = target.of(to)
    taken = np.log(rng.uniform(size=n)) < risen * (found - likelihood)
    return np.where(taken[:, None], to, phi), np.where(taken, found, likelihood), np.where(taken[:, None], given, mean)
