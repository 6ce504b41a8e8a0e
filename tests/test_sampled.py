"""Draws are those of the normal where the posterior is one, and find what is far from a fit where it is none."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, lateral, recorded

from vehicle_sbi.inference.directions import within
from vehicle_sbi.mismatch.estimation.fit import descend, with_own_noise
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.sampled import _step, sampled
from vehicle_sbi.mismatch.selection.detection import Model
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE

GUST = {"gust.force": -900.0, "gust.arm": 0.5, "gust.start": 2.3, "gust.duration": 3.9}


def model(observation: Observation, effect: str, start: list[float]) -> Model:
    """The model with an effect, fitted from somewhere."""
    sim = observation.simulator
    own = within(sim, CATALOGUE[effect]).parameters
    wider = observation.extended(replace(sim, space=ParameterSpace((*sim.space.parameters, *own))))
    fit = descend(wider, np.array([*TRUTH, *start]))
    assert fit is not None
    return Model((effect,), with_own_noise(fit), 10.0)


@pytest.mark.parametrize("power", [1.0, 0.5])
def test_of_a_linear_effect_draws_are_normal_about_the_fit(power: float) -> None:
    # If a quarter of the 200 draws are independent, means are within four standard errors, 4 / sqrt(50) of a standard
    # deviation, and standard deviations within 4 / sqrt(100) of their own.
    one = model(recorded(lateral(), accelerometer_bias__x=0.1), "accelerometer_bias", [0.1, 0.0])
    draws = sampled(one, power, np.random.default_rng(0))
    assert draws is not None
    std = np.sqrt(np.diag(one.fit.tempered(power)))
    assert np.all(np.abs(draws.mean(axis=0) - one.fit.theta) < 4.0 / np.sqrt(50.0) * std)
    np.testing.assert_allclose(draws.std(axis=0), std, rtol=0.4)


def test_a_force_and_its_place_are_found_from_a_fit_of_the_other_sign() -> None:
    gusty = recorded(lateral(), gust__force=-900.0, gust__arm=0.5, gust__start=2.3, gust__duration=3.9)
    wrong = GUST | {"gust.force": 300.0, "gust.arm": -0.9, "gust.start": 1.5}
    stuck, right = (model(gusty, "gust", [at[p.name] for p in CATALOGUE["gust"].parameters]) for at in (wrong, GUST))
    assert stuck.fit.log_likelihood < right.fit.log_likelihood - 10.0
    draws = sampled(stuck, 1.0, np.random.default_rng(0))
    assert draws is not None
    std = np.sqrt(np.diag(right.fit.covariance))
    for k, name in enumerate(right.fit.simulator.space.names):
        if name in GUST:
            low, high = draws[:, k].min(), draws[:, k].max()
            assert low - std[k] <= GUST[name] <= high + std[k], name


def test_steps_leave_half_of_the_points_and_end_where_they_may() -> None:
    log_likelihood = np.random.default_rng(0).normal(0.0, 50.0, 400)
    step = _step(log_likelihood, 1.0)
    weight = np.exp(step * log_likelihood)
    assert weight.sum() ** 2 / np.sum(weight**2) == pytest.approx(200.0, rel=1e-6)
    assert _step(1e-3 * log_likelihood, 0.7) == 0.7
    assert _step(np.array([-np.inf] * 6 + [0.0] * 4), 1.0) == 0.0
