"""Polynomials are what they should be, and a fit is what the model says: unbiased, as precise as the bound allows."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest
from studies import paper_process, simulator

from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.emulator import POINTS_A_TERM, Emulator, Frame, Polynomial, exponents, monomials, simulated
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.information import bound_std, fisher
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.rng import Stream

TRUTH = np.array([1.2, 0.1, -0.1])
EPS = float(np.finfo(np.float32).eps)


def proportional(sim: Simulator, share: float = 0.05) -> Simulator:
    """The simulator with noise that is mostly a share of the signal, as in the paper."""
    channels = len(sim.windows.channels)
    floor = 0.2 * share * np.abs(sim.noise_free(TRUTH[None]))[0].mean(axis=1)
    return sim.with_noise(MeasurementNoise(np.full(channels, share), floor, np.zeros(channels), sim.shape[1]))


def about(sim: Simulator, width: float, n: int = 500) -> np.ndarray:
    """Parameters around the truth, spread over a share of the prior's box."""
    off = width * (sim.space.high - sim.space.low)
    return np.random.default_rng(0).uniform(TRUTH - off, TRUTH + off, (n, len(TRUTH)))


def features(sim: Simulator, width: float):
    """The score's features of parameters that are proposed from `about`, in the parameters' units."""
    theta = about(sim, width)
    pilot, _ = sim.simulate(theta[:100], np.arange(100), stream=Stream.SIMULATION)
    summary = Score().fit(sim, TRUTH, theta, pilot)
    return lambda y: summary(y)[:, : len(TRUTH)] * sim.space.prior_std


@pytest.fixture(scope="module")
def fitted():
    """The simulator, and the score's features of what is proposed from a tenth of the box about the truth."""
    sim = proportional(simulator())
    return sim, features(sim, 0.1)


@pytest.mark.parametrize(("k", "degree"), [(1, 3), (4, 2), (7, 3)])
def test_there_are_as_many_monomials_as_there_should_be(k: int, degree: int) -> None:
    powers = exponents(k, degree)
    assert len(powers) == len({tuple(row) for row in powers}) == comb(k + degree, degree)
    z = np.random.default_rng(0).normal(size=(5, k))
    # Products of k (and degree) single-precision factors, each rounded once.
    np.testing.assert_allclose(monomials(z, powers), np.prod(z[:, None] ** powers, axis=-1), rtol=12 * EPS)


@pytest.mark.parametrize(("k", "n"), [(1, 6), (1, 50), (7, 100), (7, 108), (7, 400), (30, 400), (200, 400)])
def test_the_degree_is_the_highest_that_the_points_bear(k: int, n: int) -> None:
    z = np.random.default_rng(0).normal(size=(n, k))
    degree = Polynomial.through(z, z[:, :1], 3).powers.sum(axis=1).max()
    assert degree == 0 or comb(k + degree, degree) * POINTS_A_TERM <= n
    assert degree == 3 or comb(k + degree + 1, degree + 1) * POINTS_A_TERM > n


def test_a_cubic_is_found_again() -> None:
    rng = np.random.default_rng(1)
    powers, z, at = exponents(3, 3), rng.normal(size=(200, 3)), rng.normal(size=(5, 3))
    coefficients = rng.normal(size=(len(powers), 4, 2)).astype(np.float32)
    y = np.tensordot(monomials(z, powers), coefficients, 1)
    # Single precision, in sums of 20 terms and 200 points whose monomials reach 3^3.
    expected = np.tensordot(monomials(at, powers), coefficients, 1)
    np.testing.assert_allclose(Polynomial.through(z, y, 3).at(at), expected, atol=200 * 27 * EPS)


def test_slopes_are_the_model_s_derivatives() -> None:
    """To a hundredth of the largest, where parameters vary so little that parabolas follow their derivatives."""
    sim = proportional(simulator())
    spread = sim.space.prior_std
    frame = Frame(sim, TRUTH / spread, np.eye(3), np.zeros(3), np.full(3, 0.05))
    z = np.random.default_rng(2).uniform(-2.0, 2.0, (100, 3))
    slopes, at, h = frame.slopes(z), z[:5], 1e-2
    for i, step in enumerate(h * np.eye(3)):
        rise = simulated(sim, frame.point(at + step)) - simulated(sim, frame.point(at - step))
        size = np.abs(slopes.at(at)[:, i]).max()
        assert np.abs(slopes.at(at)[:, i] - rise / (2 * h)).max() < 0.01 * size


def test_a_series_without_noise_is_explained_by_what_made_it(fitted) -> None:
    """To a tenth of the bound, wherever parameters are proposed: what the prior pulls and one step leaves over."""
    sim, summary = fitted
    theta = about(sim, 0.1, n=20)
    bound = bound_std(fisher(sim, TRUTH), sim.space.prior_std)
    off = (summary(sim.noise_free(theta)) - theta) / bound
    assert (np.abs(off) < 0.1).all()


def test_the_fit_of_a_noisy_series_is_unbiased_and_reaches_the_bound(fitted) -> None:
    """Over n series: their mean within five standard errors, their spread within five of its own of the bound."""
    (sim, summary), n = fitted, 400
    y, _ = sim.simulate(np.tile(TRUTH, (n, 1)), np.arange(n), stream=Stream.TRUTH)
    off = (summary(y) - TRUTH) / bound_std(fisher(sim, TRUTH), sim.space.prior_std)
    assert (np.abs(off.mean(axis=0)) < 5 / np.sqrt(n)).all()
    # Residuals drawn back to four standard deviations cost 1 %.
    assert (np.abs(off.std(axis=0) - 1) < 0.01 + 5 / np.sqrt(2 * n)).all()


def test_process_noise_does_not_spoil_the_fit_of_what_it_leaves_alone() -> None:
    """l_f is found as precisely whatever was drawn for the stiffnesses, a score at one point three times worse."""
    sim, n = proportional(simulator(process=paper_process()), share=0.02), 300
    y, _ = sim.simulate(np.tile(TRUTH, (n, 1)), np.arange(n), stream=Stream.TRUTH)
    found = features(sim, 0.1)(y)[:, 0]
    bound = bound_std(fisher(sim, TRUTH), sim.space.prior_std)[0]
    assert abs(found.std() / bound - 1) < 0.1 + 5 / np.sqrt(2 * n)  # the bound itself depends on the draws


def test_a_series_that_is_not_finite_has_no_fit_and_spoils_no_other(fitted) -> None:
    sim, summary = fitted
    y = sim.noise_free(np.tile(TRUTH, (2, 1)))
    broken = y.copy()
    broken[1] = np.nan
    np.testing.assert_allclose(summary(broken)[0], summary(y)[0], rtol=1e-5)
    assert np.isnan(summary(broken)[1]).all()


def test_masked_samples_do_not_matter() -> None:
    sim = proportional(simulator())
    valid = np.random.default_rng(7).random(sim.shape) > 0.5
    sim = replace(sim, windows=replace(sim.windows, valid=valid))
    summary, y = features(sim, 0.1), sim.noise_free(TRUTH[None])
    np.testing.assert_array_equal(summary(np.where(valid, y, 0.0)), summary(np.where(valid, y, 1e6)))


def test_a_fit_ends_inside_what_was_simulated_however_far_a_series_is() -> None:
    sim = proportional(simulator())
    theta = about(sim, 0.05)
    found = features(sim, 0.05)(1e3 * sim.noise_free(TRUTH[None]))
    assert np.isfinite(found).all()
    assert (np.abs(found - TRUTH) <= 2 * np.abs(theta - TRUTH).max(axis=0)).all()


def test_where_most_simulations_fail_there_is_no_emulator() -> None:
    sim = proportional(simulator({"l_f": [1.0, 1.5], "C_alpha_f": [9e4, 1e5], "C_alpha_r": [1e4, 1e5]}))
    fails = np.tile([1.5, 1e5, 1e4], (10, 1))
    sim = replace(sim, windows=simulator(steering_amplitude=0.5).windows)
    with pytest.raises(InputError, match="features=score: most simulations fail; narrow the prior"):
        Emulator.of(sim, np.zeros(3), np.eye(3), fails, np.ones(sim.shape).reshape(-1))
