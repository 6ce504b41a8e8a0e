"""A fit is trusted where the posterior about it is what it seems; else it is mended, or said not to be trusted."""

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.inference.importance import TRUSTED, pareto_k
from vehicle_sbi.mismatch.estimation.fit import Fit, linearise
from vehicle_sbi.mismatch.estimation.fit_check import GAP, FitCheck, checked, mended


@pytest.mark.parametrize("k", [0.3, 0.9])
def test_the_tail_of_pareto_weights_has_their_shape(k: float) -> None:
    # w = u^-k for uniform u. The likeliest k of m exceedances is off by (1 + k) / sqrt(m), of 3 sqrt(n) here, and is
    # drawn to 0.5 by 10 / (m + 10).
    n = 20_000
    m = 3.0 * np.sqrt(n)
    found = pareto_k(-k * np.log(np.random.default_rng(0).uniform(size=n)))
    assert found == pytest.approx(k, abs=4 * (1 + k) / np.sqrt(m) + 10 / (m + 10) * abs(k - 0.5))


def test_a_normal_posterior_is_trusted() -> None:
    fit = fitted(recorded(lateral(), seed=1))
    check, _ = checked(fit, np.random.default_rng(0))
    assert check.k < TRUSTED
    assert not check.notes


def test_a_fit_that_is_no_optimum_is_done_again() -> None:
    # Three standard deviations off in a direction cost 4.5 of log likelihood, most of which 200 draws find back.
    optimum = fitted(recorded(lateral(), seed=1))
    values, vectors = np.linalg.eigh(optimum.covariance)
    off = optimum.theta + 3.0 * np.sqrt(values[0]) * vectors[:, 0]
    fit = Fit(optimum.observation, off, linearise(optimum.simulator, off))
    assert checked(fit, np.random.default_rng(0))[0].gap > GAP
    better, check = mended(fit, np.random.default_rng(0))
    assert check.gap <= GAP
    # Both end within 0.01 of log likelihood of the optimum, which is 0.15 standard deviations.
    assert np.abs(better.theta - optimum.theta).max() < 2 * 0.15 * np.sqrt(values.max())


def test_a_fit_in_a_corner_of_the_prior_is_not_trusted() -> None:
    fit = fitted(recorded(lateral(), seed=1))
    corner = fit.simulator.space.high
    cornered = Fit(fit.observation, corner, linearise(fit.simulator, corner))
    check, _ = checked(cornered, np.random.default_rng(0))
    assert check.k > TRUSTED or check.gap > GAP
    assert check.notes


def test_what_is_said_has_its_numbers() -> None:
    assert FitCheck(0.3, 0.1).notes == ()
    assert "0.93" in FitCheck(0.93, 0.0).notes[0]
    assert "7.1" in FitCheck(0.3, 7.1).notes[0]
