"""Draws re-weighted by the likelihood follow the exact posterior, whoever proposed them, or it is said why not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from studies import PRIOR, constant_noise, paper_process, simulator

from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Handcrafted, Score
from vehicle_sbi.inference.information import Laplace, laplace
from vehicle_sbi.inference.reweighting import Reweighted, applies, draws_about_the_fit, reweighted
from vehicle_sbi.inference.rounds import Problem
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.inference.training import Training
from vehicle_sbi.rng import Stream

PROPOSED, DRAWN = 2000, 500


@pytest.fixture(scope="module")
def sim() -> Simulator:
    """Process noise of the paper's law and an uncertain initial speed."""
    return simulator(process=paper_process(), known_start=False)


@pytest.fixture(scope="module")
def observed(sim: Simulator) -> np.ndarray:
    return sim.simulate(np.array([[1.22, 0.05, -0.05]]), np.array([0]), stream=Stream.TRUTH)[0][0].astype(float)


@pytest.fixture(scope="module")
def about(sim: Simulator, observed: np.ndarray) -> Laplace:
    found = laplace(sim, observed, (sim.space.low + sim.space.high)[None] / 2)
    assert found is not None
    return found


def by(sim: Simulator, observed: np.ndarray, about: Laplace, off: float, wide: float) -> Reweighted:
    """Draws proposed by a normal that is so many standard deviations off and so many times as wide as Laplace's."""
    rng, space = np.random.default_rng(1), sim.space
    mean, covariance = about.marginal
    normal = multivariate_normal(mean=mean + off * np.sqrt(np.diag(covariance)), cov=wide**2 * covariance)  # pyright: ignore[reportArgumentType]
    theta = normal.rvs(4 * PROPOSED, random_state=rng)
    theta = theta[np.all((theta >= space.low) & (theta <= space.high), axis=1)][:PROPOSED]
    return reweighted(sim, observed, (theta, normal.logpdf(theta)), about, DRAWN, rng)


@pytest.fixture(scope="module")
def right(sim: Simulator, observed: np.ndarray, about: Laplace) -> Reweighted:
    return by(sim, observed, about, 0.0, 1.3)


def agree(some: Reweighted, others: Reweighted) -> None:
    """Means and widths within five standard errors."""
    std, error = others.theta.std(axis=0), 5 / np.sqrt(min(some.effective, others.effective, DRAWN))
    np.testing.assert_allclose((some.theta.mean(axis=0) - others.theta.mean(axis=0)) / std, 0.0, atol=error)
    np.testing.assert_allclose(np.log(some.theta.std(axis=0) / std), 0.0, atol=error)


@pytest.mark.parametrize(
    ("off", "wide"),
    [(0.7, 1.6), (1.5, 2.0), (6.0, 0.3)],
    ids=["worth much", "worth little, but where to propose again", "worth nothing, so the fit proposes"],
)
def test_the_answer_does_not_depend_on_who_proposed(
    off: float, wide: float, sim: Simulator, observed: np.ndarray, about: Laplace, right: Reweighted
) -> None:
    found = by(sim, observed, about, off, wide)
    assert right.trusted
    assert found.trusted
    assert found.effective > DRAWN / 2
    agree(found, right)


def test_draws_about_the_fit_need_no_network(sim: Simulator, observed: np.ndarray, right: Reweighted) -> None:
    problem = Problem(sim, observed, Score(), NeuralSplineFlow(), Training())
    found = draws_about_the_fit(problem, DRAWN)
    assert found is not None
    assert found.trusted
    agree(found, right)
    assert draws_about_the_fit(replace(problem, features=Handcrafted()), DRAWN) is None


def test_where_all_that_is_proposed_misses_the_likelihood_it_is_not_relied_on(
    sim: Simulator, observed: np.ndarray, about: Laplace
) -> None:
    std = np.sqrt(np.diag(about.marginal[1]))
    found = by(sim, observed, replace(about, theta=about.theta - 6.0 * std, covariance=0.09 * about.covariance), 0, 1)
    assert not found.trusted
    assert "cannot be relied on" in found.sentence()


def test_it_applies_where_the_likelihood_is_known() -> None:
    sim = simulator(PRIOR, process=paper_process())
    assert applies(sim)
    assert not applies(sim.with_noise(constant_noise(sim.windows, rho=0.5)))
    assert not applies(replace(sim, process=paper_process(per_sample=True)))
