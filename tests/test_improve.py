"""Held-out predictions: calibrated where the model is right, better where the missing effect is modelled."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.integrate import quad
from scipy.stats import norm

from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere, under_own_noise
from vehicle_sbi.mismatch.estimation.fit import descend
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import Gain, Prediction, crps, gain, in_std, predict
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.single_track import INPUTS

STARTS = {
    "body_roll": {"body_roll.gradient": 0.01, "body_roll.lag": 0.01},
    "gust": {"gust.force": 100.0, "gust.arm": 0.1, "gust.start": 1.0, "gust.duration": 1.0},
}


def predicted(model: Model, held: Observation, *, apart: bool = True) -> Prediction:
    found = predict(model, held, apart=apart)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def models() -> dict[str, Model]:
    """Fits to a drive whose roll is left out, and the same with roll and with a gain of the accelerometer."""
    base = fitted(recorded(lateral(), body_roll__gradient=0.012))
    found = {"base": Model((), base, base.simulator.space.names)}
    for effect, starts in STARTS.items():
        added = {EFFECT_PARAMETERS[name]: value for name, value in starts.items()}
        wider = base.observation.freeing([*base.simulator.space.parameters, *added])
        fit = descend(wider, np.array([*base.theta, *added.values()]))
        assert fit is not None
        found[effect] = Model((effect,), fit, base.simulator.space.names)
    return found


def test_the_band_covers_what_it_says_where_the_model_is_right(models: dict[str, Model]) -> None:
    # 1500 samples of independent noise: 90 % within four binomial standard deviations.
    held = recorded(lateral(), seed=9, body_roll__gradient=0.012)
    found = predicted(models["body_roll"], held)
    assert found.coverage90 == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 1500))


def test_modelling_what_is_missing_gains_on_another_drive(models: dict[str, Model]) -> None:
    held = recorded(lateral(), seed=9, body_roll__gradient=0.012)
    base, better = (predicted(models[name], held) for name in ("base", "body_roll"))
    assert gain(base, better).certain
    assert not gain(base, better).worse
    assert better.mean_crps["a_y"] < base.mean_crps["a_y"]
    assert better.nrmse["a_y"] < base.nrmse["a_y"]


def test_log_scores_of_blocks_are_those_of_a_normal_with_noise_and_parameters_in_its_covariance() -> None:
    # White noise; blocks of two seconds, each given the ones before it, so the sums are those of all up to one.
    fit, held = fitted(replace(recorded(lateral()), estimated=False)), recorded(lateral(), seed=9)
    found = predicted(Model((), fit, ()), held)
    std, root = fit.simulator.noise.floor, np.linalg.cholesky(fit.covariance)
    J = np.tensordot(root.T / fit.simulator.space.prior_std, fit.at.J, axes=1)
    for blocks in (1, 3, 5):
        r = (held.observed - fit.at.y)[:, : 100 * blocks].ravel()
        rows = J[..., : 100 * blocks].reshape(len(J), -1)
        covariance = np.diag(np.repeat(std**2, 100 * blocks)) + rows.T @ rows
        _, log_det = np.linalg.slogdet(2.0 * np.pi * covariance)
        expected = -0.5 * r @ np.linalg.solve(covariance, r) - 0.5 * log_det
        assert found.log_score[:blocks].sum() == pytest.approx(expected, rel=1e-9)
    assert found.mean_log_score == pytest.approx(found.log_score.sum() / 1500.0)


def test_what_happened_at_a_moment_of_one_drive_did_not_happen_in_another(models: dict[str, Model]) -> None:
    gust = models["gust"]
    held = recorded(lateral(), seed=9)
    blown, calm = (predicted(gust, held, apart=apart).y for apart in (False, True))
    simulated = gust.fit.simulator.noise_free(gust.fit.theta[None])[0]
    np.testing.assert_allclose(blown, simulated)
    assert np.abs(blown - calm).max() > 0


def test_a_gain_is_the_mean_difference_and_its_error_that_of_blocks() -> None:
    series, score = np.zeros((1, 400)), np.zeros(4)
    one = Prediction(
        {}, 0.9, score, {"a_y": score, "yaw_rate": score}, series, series, {"a_y": 200, "yaw_rate": 200}, 4.0
    )
    more = 100.0 * np.array([1.0, 3.0, 1.0, 3.0])
    found = gain(one, replace(one, log_score=more))
    assert found.mean == pytest.approx(2.0)
    assert found.std == pytest.approx(np.std([1, 3, 1, 3], ddof=1) / 2)
    assert found.low < found.mean
    assert not Gain(1.0, 1.0, -0.5, 2.5).certain
    assert found.certain
    assert not found.worse
    spoilt = gain(one, replace(one, log_score=more, crps={"a_y": -more, "yaw_rate": more}))
    assert spoilt.certain
    assert spoilt.worse == ("yaw_rate",)


def test_the_crps_is_the_integral_of_the_squared_difference_of_distributions() -> None:
    for error, std in ((0.0, 1.0), (0.7, 0.3), (-2.0, 1.5)):
        below, _ = quad(lambda x, e=error, s=std: norm.cdf((x + e) / s) ** 2, -20.0, 0.0)
        above, _ = quad(lambda x, e=error, s=std: norm.sf((x + e) / s) ** 2, 0.0, 20.0)
        assert crps(np.array([error]), np.array([std]))[0] == pytest.approx(below + above, rel=1e-7)


def test_what_is_masked_is_no_block_and_a_score_is_the_density_of_what_is_not(models: dict[str, Model]) -> None:
    # Correlated noise with a gap, in windows that begin anywhere: the log score is that of the likelihood.
    sim = lateral(rho=0.6, known_start=False)
    held = recorded(sim, seed=9)
    fit = fitted(recorded(sim))
    kept = np.arange(held.observed.shape[1]) // 50 % 4 != 1
    there = predicted(Model((), fit, ()), held.masked(kept))
    assert len(there.log_score) == int(kept.sum() / 100.0)
    gone = elsewhere(fit, held.masked(kept), apart=True)
    J = gone.metric(in_std(fit, gone.at.J)).reshape(len(fit.theta), -1)
    A, b = np.eye(len(J)) + J @ J.T, J @ gone.metric(gone.residual).reshape(-1)
    exact = gone.log_likelihood + 0.5 * b @ np.linalg.solve(A, b) - 0.5 * np.linalg.slogdet(A)[1]
    constant = 0.5 * np.log(2.0 * np.pi) * sum(there.samples.values())
    assert there.log_score.sum() == pytest.approx(exact - constant, rel=1e-9)


def test_what_a_fit_leaves_over_where_it_was_not_fitted_is_noise_there() -> None:
    # A second drive with the same car is as noisy as the first; one with another steering ratio leaves much more over,
    # and counts as so much noisier that its residual is of unit variance. Both to four standard deviations of that.
    fit, n = fitted(recorded(lateral())), 500
    bound = 4.0 * np.sqrt(2.0 / n)
    like, unlike = (
        elsewhere(fit, recorded(lateral(), seed=9, **e), apart=True) for e in ({}, {"steering_ratio__gain": 1.2})
    )
    floor = fit.simulator.noise.floor
    same = under_own_noise(like).simulator.noise.floor
    assert np.all((floor <= same) & (same < (1.0 + bound) * floor))
    before, after = (np.mean(one.metric(one.residual) ** 2, axis=1) for one in (unlike, under_own_noise(unlike)))
    assert before.max() > 5.0
    assert np.all(np.abs(after[before > 5.0] - 1.0) < bound)
    np.testing.assert_array_equal(under_own_noise(unlike).theta, fit.theta)


def test_a_channel_that_drops_out_elsewhere_keeps_its_noise() -> None:
    fit = fitted(recorded(lateral()))
    there = elsewhere(fit, recorded(lateral(), seed=2), apart=True)
    windows = there.simulator.windows
    valid = windows.valid.copy()
    valid[0] = False
    simulator = replace(there.simulator, windows=replace(windows, valid=valid))
    silent = replace(there, observation=there.observation.extended(simulator))
    assert under_own_noise(silent).simulator.noise.floor[0] == fit.simulator.noise.floor[0]


def test_what_cannot_be_simulated_is_not_predicted() -> None:
    fit, held = fitted(recorded(lateral())), recorded(lateral())
    u = held.simulator.windows.u.copy()
    u[..., INPUTS.index("v_x")] = np.nan
    stalled = replace(held.simulator, windows=replace(held.simulator.windows, u=u))
    assert predict(Model((), fit, ()), held.extended(stalled), apart=True) is None
