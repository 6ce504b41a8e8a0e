"""What follows no law: its evidence is an integral, it is about none, and what is steady is not among it."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.integrate import quad

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.estimation.linearised import Linearised, gained_at_random, profile
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.hypotheses.block import bump, clock, stretches
from vehicle_sbi.mismatch.hypotheses.regressor import targets
from vehicle_sbi.mismatch.loose import courses, deviations
from vehicle_sbi.mismatch.problem.observation import Observation

YAW = "error of the sensor of yaw_rate"


def wandering(size: float, *, seed: int = 0) -> Observation:
    """A gyro whose zero is another one in each stretch of time, about none."""
    observation = recorded(lateral(seconds=20.0), seed=seed)
    t, spans = clock(observation.simulator), stretches(observation.simulator)
    zero = np.random.default_rng(seed).standard_normal(len(spans))
    course = size * (zero - zero.mean()) @ np.array([bump(t, *span) for span in spans])
    return replace(observation, observed=observation.observed + np.array([0 * t, 0 * t, course]))


def test_the_evidence_is_the_integral_over_a_normal_size() -> None:
    # Laplace's approximation, exact but for the noise being estimated at each size: of a likelihood to the power of
    # N/2, N = 1500 samples, its relative error is of the order of gain^2 / N.
    fit = fitted(recorded(lateral(), gyro_bias__z=0.002))
    about = Linearised.of(fit)
    row = np.zeros((1, *fit.at.y.shape))
    row[0, 2] = 0.003

    def density(a: float) -> float:
        there = profile(about, row[None], np.array([[a]]), np.array([[a]])).log_likelihood[0]
        return float(np.exp(there - about.alone - 0.5 * a**2) / np.sqrt(2.0 * np.pi))

    integral, _ = quad(density, -4.0, 4.0, epsrel=1e-6)
    gain = gained_at_random(about, row)
    assert gain == pytest.approx(np.log(integral), abs=max(gain, 1.0) ** 2 / 1500 + 1e-3)
    assert gained_at_random(about, 0.0 * row) == pytest.approx(0.0, abs=1e-9)


def test_a_steady_error_is_no_course_of_its_own() -> None:
    fit = fitted(recorded(lateral()))
    acting = [target for target in targets(fit.simulator, fit.at.y) if target.name == YAW]
    t = clock(fit.simulator)
    steady = np.sum([bump(t, *span) for span in stretches(fit.simulator)], axis=0)
    rows = deviations(fit, acting)[0, :, 2]
    spans = np.array([bump(t, *span) for span in stretches(fit.simulator)])
    sizes = np.linalg.lstsq(spans.T, rows.T, rcond=None)[0]
    np.testing.assert_allclose(sizes.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(sizes.T @ sizes, np.eye(len(rows)), atol=1e-9)
    assert np.linalg.lstsq(rows.T, steady, rcond=None)[1] > 0.1 * steady @ steady


def test_a_zero_that_wanders_is_told_from_one_that_is_off() -> None:
    # The size is that of twelve draws about their mean: its root mean square to within four of its own deviations.
    found = {one.target.name: one for one in courses(Linearised.of(fitted(wandering(0.02))))}
    best = max(found.values(), key=lambda one: one.gain)
    assert best.target.name == YAW
    assert best.gain > 10.0
    assert best.size == pytest.approx(0.02, abs=4.0 * max(best.std, 0.02 / np.sqrt(2 * 11)))
    off = fitted(recorded(lateral(seconds=20.0), gyro_bias__z=0.02))
    assert next(one for one in courses(Linearised.of(off)) if one.target.name == YAW).gain < 1.0


def test_what_wanders_is_unknown_and_what_is_off_has_a_name() -> None:
    for observation, known in ((wandering(0.02), False), (recorded(lateral(seconds=20.0), gyro_bias__z=0.02), True)):
        base = fitted(observation)
        found = explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))
        assert found.detected
        assert (found.p_unknown < 0.5) == known
