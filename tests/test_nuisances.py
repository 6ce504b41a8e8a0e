"""What a simulation draws beside theta: densities are those of the draws, and a prior is exchanged exactly."""

from dataclasses import replace

import numpy as np
import pytest
from studies import paper_process, simulator

from vehicle_sbi.data.noise import ProcessNoise
from vehicle_sbi.inference.information import Laplace
from vehicle_sbi.inference.nuisances import WIDENED, NormalMixture, Nuisances, log_prior, prior_of

X = np.linspace(-15.0, 15.0, 60_001)
SPIKED = NormalMixture(np.log([[0.1, 0.3, 0.6]]), np.array([[-0.6, 0.5, 0.1]]), np.array([0.01, 1.2, 0.3]) ** 2)


def test_densities_of_nuisances_integrate_to_one() -> None:
    """Along each axis through zero p(x) / p(0) integrates to 1 / p_i(0); the product of all p_i(0) is p(0)."""
    inputs = ProcessNoise(stiffness=0.05, inputs=0.03).draw(np.random.default_rng(0))
    uniform = simulator(process=inputs, known_start=False)
    for sim in (uniform, replace(uniform, uniform_start=False)):
        axes, zero = np.eye(len(sim.nuisances)), log_prior(sim, np.zeros((1, len(sim.nuisances))))[0]
        integrals = [np.trapezoid(np.exp(log_prior(sim, X[:, None] * axis) - zero), X) for axis in axes]
        assert np.exp(-np.log(integrals).sum()) == pytest.approx(np.exp(zero), rel=1e-3)


@pytest.mark.parametrize("name", ["C_alpha_f", "v_x_0"])
def test_nuisances_are_counted_in_their_standard_deviations(name: str) -> None:
    density = np.exp(prior_of(simulator(process=paper_process(), known_start=False), name).log_density(X))
    mean = np.trapezoid(X * density, X)
    np.testing.assert_allclose([mean, np.trapezoid((X - mean) ** 2 * density, X)], [0.0, 1.0], atol=1e-3)


@pytest.mark.parametrize(("h", "P"), [(0.0, 0.0), (3.0, 2.0), (-40.0, 100.0)])
def test_a_mixture_times_a_normal_likelihood(h: float, P: float) -> None:
    """Bayes' rule, at points that any of its normals reaches."""
    x = np.linspace(-1.5, 1.5, 31)
    updated = SPIKED.updated(np.full(len(x), h), P)
    product = np.array(SPIKED.log_density(x)) + h * x - 0.5 * P * x**2
    np.testing.assert_allclose(np.ptp(updated.log_density(x) - product), 0.0, atol=1e-8)
    at = np.full(len(X), h)
    assert np.trapezoid(np.exp(SPIKED.updated(at, P).log_density(X)), X) == pytest.approx(1.0, abs=1e-6)


def test_draws_of_a_mixture_have_its_density() -> None:
    """Shares below some points are its distribution function there, within binomial error."""
    n = 20_000
    drawn = SPIKED.updated(np.full(n, 1.0), 0.5).sample(np.random.default_rng(0))
    cumulated = np.cumsum(np.exp(SPIKED.updated(np.full(len(X), 1.0), 0.5).log_density(X))) * (X[1] - X[0])
    for point in (-0.6, 0.0, 0.3, 1.0):
        below = np.interp(point, X, cumulated)
        assert np.mean(drawn < point) == pytest.approx(below, abs=4 * np.sqrt(below * (1 - below) / n) + 1e-3)


def linear(theta: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Log likelihood of two numbers that were read as (1, -1), with noise of one."""
    y = theta @ np.array([[1.0, 0.4]]) + eta @ np.array([[0.8, -0.5], [0.6, 1.0]])
    return -0.5 * ((y - [1.0, -1.0]) ** 2).sum(axis=1)


def laplace_of_linear() -> Laplace:
    """Its posterior with standard normal priors, by the normal equations."""
    J = np.array([[1.0, 0.4], [0.8, -0.5], [0.6, 1.0]]).T
    covariance = np.linalg.inv(J.T @ J + np.eye(3))
    fit = covariance @ J.T @ np.array([1.0, -1.0])
    return Laplace(fit[:1], fit[1:], covariance)


def weights(priors: tuple[NormalMixture, ...], n: int = 4000) -> np.ndarray:
    """Logarithms of p(x | theta, eta) p(eta) / r(eta | theta) at one theta."""
    rng, theta = np.random.default_rng(1), np.full((n, 1), 0.7)
    eta, log_r = Nuisances(laplace_of_linear(), priors).sample(theta, rng)
    prior = sum(one.log_density(values) for one, values in zip(priors, eta.T, strict=True))
    return linear(theta, eta) + prior - log_r


def test_what_proposes_holds_the_exact_conditional() -> None:
    """With standard normals for priors, a share of the draws for all nuisances together is exact: weights are bounded
    by its inverse, and their mean is p(x | theta)."""
    standard = NormalMixture.standard()
    weight = np.exp(weights((standard, standard)))
    about, J = laplace_of_linear(), np.array([[0.8, 0.6], [-0.5, 1.0]])
    covariance, off = np.eye(2) + J @ J.T, np.array([1.0, -1.0]) - 0.7 * np.array([1.0, 0.4])
    evidence = np.exp(-0.5 * off @ np.linalg.solve(covariance, off)) / np.sqrt(np.linalg.det(covariance))
    assert weight.mean() == pytest.approx(evidence, abs=4 * weight.std() / np.sqrt(len(weight)))
    assert weight.max() <= evidence / WIDENED[0][0] ** len(about.eta) + 1e-12


def test_a_prior_with_a_spike_is_no_tail_of_the_weights() -> None:
    """The last nuisance has its own prior exchanged exactly; a spike of the prior is then one of the proposals."""
    weight = np.exp(weights((NormalMixture.standard(), SPIKED)))
    assert 1.0 / np.sum((weight / weight.sum()) ** 2) > 0.5 * len(weight)
