"""The metric is the exact covariance of noise and initial states; fits end where they must."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_normal

from vehicle_sbi.inference.directions import within
from vehicle_sbi.inference.information import sensitivity
from vehicle_sbi.mismatch.estimation.fit import (
    CONVERGED,
    Fit,
    Metric,
    Shrinkage,
    _Quadratic,
    _updated,
    descend,
    linearise,
    with_own_noise,
)
from vehicle_sbi.mismatch.estimation.multistart import best, likeliest
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.single_track import INPUTS


def short(rho: float):
    sim = lateral(rho=rho, seconds=0.6, known_start=False)
    valid = np.ones((3, 30), dtype=bool)
    valid[1, 7:9] = valid[0, 0] = False
    return replace(sim, windows=replace(sim.windows, valid=valid))


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_the_likelihood_is_that_of_the_dense_covariance(rho: float) -> None:
    # Noise of an AR(1) process on each channel, rank-two initial states on all, two samples in a gap.
    sim = short(rho)
    at = linearise(sim, TRUTH)
    metric = Metric.of(sim, at)
    lag = np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    noise = np.zeros((3, 30, 3, 30))
    for c, floor in enumerate(sim.noise.floor):
        noise[c, :, c] = floor**2 * float(rho) ** lag if rho else floor**2 * np.eye(30)
    J = at.J_x.reshape(len(at.J_x), -1)
    keep = sim.windows.valid.reshape(-1)
    covariance = (noise.reshape(90, 90) + J.T @ J)[np.ix_(keep, keep)]
    residual = np.random.default_rng(1).normal(0.0, 0.1, (3, 30))
    dense = multivariate_normal.logpdf(residual.reshape(-1)[keep], cov=covariance)  # pyright: ignore[reportArgumentType]
    constant = 0.5 * keep.sum() * np.log(2 * np.pi)
    masked = np.where(sim.windows.valid, residual, 0.0)
    assert metric.log_likelihood(masked) == pytest.approx(dense + constant, rel=1e-9)


def test_the_likeliest_initial_states_are_those_of_the_dense_problem() -> None:
    sim = short(0.0)
    at = linearise(sim, TRUTH)
    residual = np.where(sim.windows.valid, np.random.default_rng(2).normal(0.0, 0.1, (3, 30)), 0.0)
    white = np.where(sim.windows.valid, at.J_x / sim.noise.floor[:, None], 0.0).reshape(len(at.J_x), -1)
    target = (residual / sim.noise.floor[:, None]).reshape(-1)
    x = np.linalg.solve(white @ white.T + np.eye(len(white)), white @ target)
    expected = np.einsum("k,kct->ct", x, at.J_x)
    np.testing.assert_allclose(Metric.of(sim, at).states(residual, at), expected, rtol=1e-9, atol=1e-12)


def test_one_difference_moves_the_initial_states_of_all_windows() -> None:
    # Against one central difference a window; one-sided ones are off by half a step's curvature.
    sim = lateral(known_start=False)
    two = {name: np.repeat(getattr(sim.windows, name), 2, axis=0) for name in ("u", "before", "x0", "t")}
    tiled = {name: np.tile(getattr(sim.windows, name), 2) for name in ("y", "valid")}
    sim = replace(sim, windows=replace(sim.windows, **two, **tiled))
    at, whole = linearise(sim, TRUTH), sensitivity(sim, TRUTH)
    each = dict(zip(sim.nuisances, whole.jacobian[len(TRUTH) :], strict=True))
    for k, kind in enumerate(("v_y", "r")):
        together = each[f"{kind}_0"] + each[f"{kind}_1"]
        np.testing.assert_allclose(at.J_x[k], together, atol=2e-3 * np.abs(together).max())


def test_a_fit_to_noise_free_data_ends_at_the_truth() -> None:
    sim = lateral()
    clean = sim.noise_free(TRUTH[None])[0]
    fit = best(Observation(sim, clean, False), (sim.space.low + sim.space.high)[None] / 2)
    # It ends where half the sum of squares falls by less than 0.01, so within 0.15 standard deviations along each
    # direction of information.
    off = (fit.theta - TRUTH) / sim.space.prior_std
    assert off @ fit.information @ off < 2 * 2 * 0.01


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_noise_that_is_estimated_with_the_fit_is_the_noise_that_was_added(rho: float) -> None:
    # 500 samples: the standard deviation of an AR(1) process is known to sqrt((1 + rho^2)/(1 - rho^2) / 2n), its
    # correlation to sqrt((1 - rho^2)/n), and three fitted parameters take 3/n of the variance; four of those each.
    fit = fitted(recorded(lateral(rho=rho)))
    n = 500
    spread = 4 * np.sqrt((1 + rho**2) / (1 - rho**2) / (2 * n)) + 3 / n
    np.testing.assert_allclose(fit.simulator.noise.floor, lateral().noise.floor, rtol=spread)
    np.testing.assert_allclose(fit.simulator.noise.rho, rho, atol=4 * np.sqrt((1 - rho**2) / n) + 3 / n)


def test_what_is_known_of_the_noise_stays() -> None:
    observation = replace(recorded(lateral()), estimated=False)
    fit = Fit(observation, TRUTH, linearise(observation.simulator, TRUTH))
    assert with_own_noise(fit) is fit


def test_a_parameter_on_the_rim_of_its_box_does_not_count_as_inside() -> None:
    sim = lateral()
    far = sim.noise_free(np.array([[1.499, 0.05, -0.05]]))[0]
    narrow = replace(sim.space.parameters[0], high=1.3)
    tight = replace(sim, space=replace(sim.space, parameters=(narrow, *sim.space.parameters[1:])))
    fit = best(Observation(tight, far, False), (tight.space.low + tight.space.high)[None] / 2)
    assert fit.inside.tolist()[0] is False


@pytest.mark.parametrize("delay", [0.012, 0.05, 0.11, 0.145, 0.195, 0.33])
def test_a_dead_time_is_found_from_afar(delay: float) -> None:
    # A jerky drive, whose a_x a shift by two samples makes unlike itself; from the middle of the box, at 0.25 s, steps
    # lead to the nearest sample only. Where it is found, it is to four standard deviations.
    sim = lateral()
    u = sim.windows.u.copy()
    u[..., INPUTS.index("v_x_dot")] = np.random.default_rng(3).normal(0.0, 1.0, u.shape[:2])
    sim = replace(sim, windows=replace(sim.windows, u=u))
    wider = replace(sim, space=ParameterSpace((*sim.space.parameters, EFFECT_PARAMETERS["sensor_delay.imu"])))
    fit = fitted(recorded(sim, sensor_delay__imu=delay).extended(wider))
    assert fit.theta[-1] == pytest.approx(delay, abs=4 * np.sqrt(fit.covariance[-1, -1]))


def test_what_begins_and_ends_is_found_from_a_second_away() -> None:
    # A gust whose edges lie 1.1 s from where the fit starts, between the places that are tried. Within six standard
    # deviations of what the noise leaves open.
    truth = {"force": -900.0, "arm": 0.3, "start": 3.3, "duration": 2.8}
    observation = recorded(
        lateral(), gust__force=truth["force"], gust__arm=truth["arm"], gust__start=truth["start"],
        gust__duration=truth["duration"],
    )  # fmt: skip
    added = within(observation.simulator, CATALOGUE["gust"]).parameters
    space = ParameterSpace((*observation.simulator.space.parameters, *added))
    wider = observation.extended(replace(observation.simulator, space=space))
    key = [p.name.split(".")[-1] for p in added]
    start = truth | {"start": truth["start"] - 1.1, "duration": truth["duration"] + 2.2}
    found = likeliest(wider, [np.concatenate([TRUTH, [start[k] for k in key]])])
    assert found is not None
    std = np.sqrt(np.diag(found.covariance))
    expected = np.concatenate([TRUTH, [truth[k] for k in key]])
    assert np.all(np.abs(found.theta - expected) < 6.0 * std)
    assert std[len(TRUTH) + key.index("start")] < 0.1


def test_updated_derivatives_hold_for_the_step_that_was_taken_and_stay_across_it() -> None:
    # Broyden's update: J step is what the step changed, and J along all that is orthogonal to it is as before.
    sim = lateral()
    fit = Fit(recorded(sim), TRUTH, linearise(sim, TRUTH))
    step = np.array([0.3, -0.2, 0.4])
    theta = TRUTH + step * sim.space.prior_std
    y = sim.noise_free(theta[None])[0]
    updated = _updated(fit, theta, y)
    J = updated.at.J
    np.testing.assert_allclose(np.tensordot(step, J, axes=1), y - fit.at.y, atol=1e-9)
    across = np.array([0.2, 0.3, 0.0])
    np.testing.assert_allclose(np.tensordot(across, J, axes=1), np.tensordot(across, fit.at.J, axes=1), atol=1e-9)
    np.testing.assert_allclose(updated.white, updated.metric(J).reshape(len(TRUTH), -1), atol=1e-8 * np.abs(J).max())


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_units_are_those_of_the_point_even_where_noise_grows_with_the_signal(share: float) -> None:
    sim = lateral(known_start=False)
    sim = sim.with_noise(replace(sim.noise, share=np.full(3, share)))
    fit = Fit(recorded(sim), TRUTH, linearise(sim, TRUTH))
    theta = TRUTH + 0.5 * sim.space.prior_std
    there = _updated(fit, theta, sim.noise_free(theta[None])[0])
    anew = Fit(there.observation, theta, there.at)
    np.testing.assert_allclose(there.white, anew.white, rtol=1e-9, atol=1e-9 * np.abs(anew.white).max())
    assert there.log_likelihood == pytest.approx(anew.log_likelihood, rel=1e-12)


def test_a_step_ends_where_the_linear_model_fits_best_in_the_box() -> None:
    # scipy's bounded least squares on all rows, shrinkage among them, in place of the triangle of normal equations.
    sim = lateral(known_start=False)
    start = TRUTH + 0.4 * sim.space.prior_std
    pull = Shrinkage(TRUTH, np.array([0.5, 2.0, 1.0]))
    fit = Fit(recorded(sim), start, linearise(sim, start), pull)
    spread, root = sim.space.prior_std, np.sqrt(pull.precision)
    rows = np.concatenate([fit.metric(fit.at.J).reshape(3, -1).T, np.diag(root)])
    target = np.concatenate([fit.metric(fit.residual).reshape(-1), root * (pull.centre - start) / spread])
    bounds = ((sim.space.low - start) / spread, (sim.space.high - start) / spread)
    exact = lsq_linear(rows, target, bounds=bounds, tol=1e-14).x
    quadratic = _Quadratic.about(fit)
    np.testing.assert_allclose(quadratic.step(), exact, atol=1e-6)
    gained = 0.5 * (target @ target - np.sum((target - rows @ exact) ** 2))
    assert quadratic.gain(quadratic.step()) == pytest.approx(gained, rel=1e-9)
    sizes = [float(step @ (np.diag(quadratic.curvature) * step)) for step in map(quadratic.step, (0.0, 0.1, 10.0))]
    assert sizes == sorted(sizes, reverse=True)
    assert quadratic.gain(quadratic.step(0.1)) < gained


def test_secants_end_at_the_optimum_that_differences_find() -> None:
    # Both end where no step gains CONVERGED of log likelihood any more: apart by a few of them at most.
    observation = recorded(lateral(), body_roll__gradient=0.012)
    start = TRUTH + 0.5 * observation.simulator.space.prior_std
    by_differences, by_secants = (descend(observation, start, 30, secant=secant) for secant in (False, True))
    assert by_differences is not None
    assert by_secants is not None
    assert by_secants.log_likelihood == pytest.approx(by_differences.log_likelihood, abs=4 * CONVERGED)


def test_a_stiffness_and_a_factor_on_it_have_the_same_derivative() -> None:
    # Of tyres without a carcass only the product (C + 1e5 delta) k acts: per logarithm they change the same.
    sim, level = lateral(), EFFECT_PARAMETERS["stiffness_level.front"]
    stiff = sim.nominal.copy()
    stiff["K"] = np.inf
    sim = replace(sim, nominal=stiff, space=ParameterSpace((*sim.space.parameters, level)))
    names, theta = sim.space.names, np.array([*TRUTH, 0.9])  # one steps down, the other up
    at = linearise(sim, theta)
    own, factor = names.index("delta_C_alpha_f"), names.index(level.name)
    spread = sim.space.prior_std
    stiffness = float(sim.nominal["C_alpha_f"]) / 1e5 + theta[own]
    change = stiffness * at.J[own] / spread[own], theta[factor] * at.J[factor] / spread[factor]
    assert np.linalg.norm(change[0] - change[1]) < 1e-4 * np.linalg.norm(change[0])
