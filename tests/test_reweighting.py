"""Draws re-weighted by the likelihood follow the exact posterior, whoever proposed them, or it is said why not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from studies import PRIOR, constant_noise, paper_process, simulator

from vehicle_sbi.inference.information import Laplace, laplace
from vehicle_sbi.inference.reweighting import Reweighted, applies, reweighted
from vehicle_sbi.inference.simulator import Simulator
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


def test_the_answer_does_not_depend_on_who_proposed(
    sim: Simulator, observed: np.ndarray, about: Laplace, right: Reweighted
) -> None:
    wrong = by(sim, observed, about, 0.7, 1.6)
    std = right.theta.std(axis=0)
    few = min(right.effective, wrong.effective)
    assert right.trusted
    assert wrong.trusted
    np.testing.assert_allclose((wrong.theta.mean(axis=0) - right.theta.mean(axis=0)) / std, 0.0, atol=5 / np.sqrt(few))
    np.testing.assert_allclose(np.log(wrong.theta.std(axis=0) / std), 0.0, atol=5 / np.sqrt(few))


def test_proposals_that_are_worth_little_say_where_to_propose_again(
    sim: Simulator, observed: np.ndarray, about: Laplace, right: Reweighted
) -> None:
    poor = by(sim, observed, about, 1.5, 2.0)
    assert poor.trusted
    assert poor.effective > DRAWN / 2
    std, few = right.theta.std(axis=0), min(right.effective, poor.effective)
    np.testing.assert_allclose((poor.theta.mean(axis=0) - right.theta.mean(axis=0)) / std, 0.0, atol=5 / np.sqrt(few))


def test_proposals_where_the_likelihood_has_no_mass_are_not_relied_on(
    sim: Simulator, observed: np.ndarray, about: Laplace
) -> None:
    found = by(sim, observed, about, 6.0, 0.3)
    assert not found.trusted
    assert "cannot be relied on" in found.sentence()


def test_it_applies_where_the_likelihood_is_known() -> None:
    sim = simulator(PRIOR, process=paper_process())
    assert applies(sim)
    assert not applies(sim.with_noise(constant_noise(sim.windows, rho=0.5)))
    assert not applies(replace(sim, process=paper_process(per_sample=True)))
