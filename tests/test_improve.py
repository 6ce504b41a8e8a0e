"""Held-out predictions: calibrated where the model is right, better where the missing effect is modelled."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.mismatch.candidates import left_out
from vehicle_sbi.mismatch.examine import Model, examine, versions
from vehicle_sbi.mismatch.explain import extended
from vehicle_sbi.mismatch.improve import Gain, Prediction, gain, predict
from vehicle_sbi.mismatch.repertoire import Repertoire


@pytest.fixture(scope="module")
def models() -> dict[str, Model]:
    """Fits to a drive whose roll is left out, and the same with roll and with a gain of the accelerometer."""
    base = Model((), fitted(recorded(lateral(), body_roll__gradient=0.012)), 0.0)
    tried = ("body_roll", "accelerometer_scale", "gust")
    known = [d for d in left_out(base.fit.simulator, base.fit.theta) if d.effect in tried]
    found = versions(examine(base, Repertoire.around(base.fit, known), np.random.default_rng(0)))
    grown = {version.effect: extended(base, version) for version in found}
    return {"base": base} | {name: model for name, model in grown.items() if model is not None}


def test_the_band_covers_what_it_says_where_the_model_is_right(models: dict[str, Model]) -> None:
    # 1500 samples of independent noise: 90 % within four binomial standard deviations.
    held = recorded(lateral(), seed=9, body_roll__gradient=0.012)
    found = predict(models["body_roll"], held, apart=True)
    assert found.coverage90 == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / found.samples))


def test_modelling_what_is_missing_gains_on_another_drive(models: dict[str, Model]) -> None:
    held = recorded(lateral(), seed=9, body_roll__gradient=0.012)
    base, better = (predict(models[name], held, apart=True) for name in ("base", "body_roll"))
    assert gain(base, better).certain
    assert better.nrmse["a_y"] < base.nrmse["a_y"]


def test_log_scores_of_blocks_are_those_of_a_normal_with_noise_and_parameters_in_its_covariance() -> None:
    # White noise; blocks of two seconds, each given the ones before it, so the sums are those of all up to one.
    fit, held = fitted(replace(recorded(lateral()), estimated=False)), recorded(lateral(), seed=9)
    found = predict(Model((), fit, 0.0), held, apart=True)
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
    blown, calm = (predict(gust, held, apart=apart).y for apart in (False, True))
    simulated = gust.fit.simulator.noise_free(gust.fit.theta[None])[0]
    np.testing.assert_allclose(blown, simulated)
    assert np.abs(blown - calm).max() > 0


def test_a_gain_is_the_mean_difference_and_its_error_that_of_blocks() -> None:
    series, score = np.zeros((1, 400)), np.zeros(4)
    one = Prediction({}, 0.9, score, series, series, 400)
    other = Prediction({}, 0.9, score + 100.0 * np.array([1.0, 3.0, 1.0, 3.0]), series, series, 400)
    found = gain(one, other)
    assert found.mean == pytest.approx(2.0)
    assert found.std == pytest.approx(np.std([1, 3, 1, 3], ddof=1) / 2)
    assert found.low < found.mean
    assert not Gain(1.0, 1.0, -0.5, 2.5).certain
