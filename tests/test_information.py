"""The Fisher information is that of the model that simulates, and its bound is what fits to noisy data scatter by."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from studies import PRIOR, constant_noise, paper_process, repeated, simulator

from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.information import (
    CONFUSABLE,
    best_fit,
    bound_std,
    confusable,
    correlation,
    fisher,
    joint_fisher,
    laplace,
    sensitivity,
)
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.rng import Stream

BIASES = {"accelerometer_bias": {"x": [-0.5, 0.5], "y": [-0.5, 0.5]}, "gyro_bias": {"z": [-0.05, 0.05]}}
MIDDLE = np.array([1.25, 0.05, -0.1])


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_it_is_the_closed_form_of_a_linear_model(rho: float) -> None:
    """A constant in white noise: n / sigma^2. In AR(1) noise: (1 + (n - 1)(1 - rho)/(1 + rho)) / sigma^2 (Kay, 3.9)."""
    sim = simulator(BIASES)
    noise = constant_noise(sim.windows, rho=rho)
    n = sim.shape[1]
    worth = 1 + (n - 1) * (1 - rho) / (1 + rho)
    F = fisher(sim.with_noise(noise), np.array([0.1, -0.2, 0.01]))
    np.testing.assert_allclose(F, np.diag(worth / noise.floor[:3] ** 2), rtol=1e-6, atol=1e-6 * F.max())
    np.testing.assert_allclose(bound_std(F, sim.space.prior_std), noise.floor[:3] / np.sqrt(worth), rtol=1e-6)


def test_noise_that_grows_with_the_signal_informs_by_its_size_too() -> None:
    """An offset of a signal y in noise of sigma^2 = (s y)^2 + f^2: the sum of 1/sigma^2 + 2 (s^2 y/sigma^2)^2."""
    sim = simulator(BIASES)
    noise = MeasurementNoise(np.full(5, 0.1), np.full(5, 0.02), np.zeros(5), 250)
    theta = np.array([0.1, -0.2, 0.01])
    y = sim.noise_free(theta[None])[0]
    variance = (0.1 * y[:3]) ** 2 + 0.02**2
    # d y = 1, d log sigma = 0.01 y / sigma^2 at every sample.
    expected = np.sum(1 / variance + 2 * (0.01 * y[:3] / variance) ** 2, axis=1)
    np.testing.assert_allclose(np.diag(fisher(sim.with_noise(noise), theta)), expected, rtol=1e-5)


def test_masked_samples_hold_no_information() -> None:
    sim = simulator(BIASES)
    valid = sim.windows.valid.copy()
    valid[:, 100:] = False
    valid[1] = False
    F = fisher(replace(sim, windows=replace(sim.windows, valid=valid)), np.zeros(3))
    np.testing.assert_allclose(np.diag(F), [100 / 0.15**2, 0, 100 / 0.005**2], rtol=1e-6)


def test_marginalised_nuisances_are_those_of_the_joint_covariance() -> None:
    """F_theta^-1 is the theta block of (joint information + the nuisances' own)^-1."""
    sim = simulator(process=paper_process(), known_start=False)
    joint = joint_fisher(sim, sensitivity(sim, MIDDLE))
    e = len(sim.nuisances)
    assert e == 5
    covariance = np.linalg.inv(joint + np.diag([0.0] * 3 + [1.0] * e))
    np.testing.assert_allclose(np.linalg.inv(fisher(sim, MIDDLE)), covariance[:3, :3], rtol=1e-6)


def test_process_noise_bounds_a_stiffness_from_below_however_long_the_recording() -> None:
    """The stiffness's own draw cannot be told from its offset: std >= 0.6 x the mixture's, in units of 1e5."""
    sim = simulator(process=paper_process())
    precise = sim.with_noise(constant_noise(sim.windows, factor=1e-2))
    bound = bound_std(fisher(precise, MIDDLE), sim.space.prior_std)
    np.testing.assert_allclose(bound[1:], 0.6 * sim.process.stiffness.std, rtol=1e-3)


@pytest.mark.parametrize("times", [2, 5])
def test_the_bound_falls_with_the_root_of_the_number_of_windows(times: int) -> None:
    once = simulator()
    often = replace(once, windows=repeated(once.windows, times))
    ratio = bound_std(fisher(once, MIDDLE), once.space.prior_std) / bound_std(
        fisher(often, MIDDLE), once.space.prior_std
    )
    np.testing.assert_allclose(ratio, np.sqrt(times), rtol=1e-9)


def test_the_bound_is_proportional_to_the_noise() -> None:
    sim = simulator()
    quiet, loud = (sim.with_noise(constant_noise(sim.windows, factor=factor)) for factor in (1.0, 3.0))
    bounds = [bound_std(fisher(each, MIDDLE), sim.space.prior_std) for each in (quiet, loud)]
    np.testing.assert_allclose(bounds[1], 3 * bounds[0], rtol=1e-9)


def test_a_parameter_without_effect_is_unbounded_and_does_not_spoil_the_others() -> None:
    """Below half the friction limit Dugoff's forces do not depend on the load: h_cog has no effect at all."""
    with_h = simulator(PRIOR | {"h_cog": [0.2, 0.6]}, drive_torque=0.0, brake_torque=0.0, steering_amplitude=0.02)
    rigid = with_h.nominal.copy()
    rigid["C_vert"] = np.inf
    without = simulator(drive_torque=0.0, brake_torque=0.0, steering_amplitude=0.02)
    bounds = [
        bound_std(fisher(replace(sim, nominal=rigid), theta), sim.space.prior_std)
        for sim, theta in ((with_h, np.append(MIDDLE, 0.4)), (without, MIDDLE))
    ]
    assert bounds[0][3] == np.inf
    np.testing.assert_allclose(bounds[0][:3], bounds[1], rtol=1e-4)


def test_two_parameters_of_which_only_the_sum_is_seen_are_both_unbounded() -> None:
    F = np.array([[4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 25.0]])
    np.testing.assert_allclose(bound_std(F, np.ones(3)), [np.inf, np.inf, 0.2])


def test_a_failed_simulation_bounds_nothing() -> None:
    assert (bound_std(np.full((2, 2), np.nan), np.ones(2)) == np.inf).all()


def test_sensitivities_are_the_models_own_differences() -> None:
    """Central differences at a step of 1e-3 against ones at a tenth of it, at most second order apart."""
    sim = simulator(process=paper_process(), known_start=False)
    at = sensitivity(sim, MIDDLE)
    step, e = 1e-4 * (sim.space.high - sim.space.low), len(sim.nuisances)
    for i in range(3):
        shift = step * np.eye(3)[i]
        up, down = sim.noise_free(np.stack([MIDDLE + shift, MIDDLE - shift]))
        slope = (up - down) / (2 * step[i])
        assert np.abs(at.jacobian[i] - slope).max() < 1e-3 * np.abs(slope).max()
    shift = 1e-4 * np.eye(e)
    up, down = (sim.noise_free(np.repeat(MIDDLE[None], e, axis=0), sign * shift) for sign in (1, -1))
    np.testing.assert_allclose(at.jacobian[3:], (up - down) / 2e-4, atol=1e-3 * np.abs(at.jacobian[3:]).max())


def scatter(sim: Simulator, theta: np.ndarray, n: int) -> np.ndarray:
    """Best fits (n, d) to n noisy simulations at theta."""
    y, _ = sim.simulate(np.repeat(theta[None], n, axis=0), np.arange(n), stream=Stream.SIMULATION)
    return np.array([best_fit(sim, row.astype(float), theta[None])[0] for row in y])


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_best_fits_scatter_as_weighted_least_squares_does(rho: float) -> None:
    """Weights take noise as independent, so A^-1 B A^-1 with A = J'J, B = J'RJ; that is the bound if it is white.

    (theta^ - theta)' covariance^-1 (theta^ - theta) summed over n fits is chi-square of n d degrees of freedom.
    """
    sim, n = simulator(), 30
    sim = sim.with_noise(constant_noise(sim.windows, rho=rho))
    off = scatter(sim, MIDDLE, n) - MIDDLE
    J = sensitivity(sim, MIDDLE).jacobian / sim.noise.floor[:, None]
    t = np.arange(sim.shape[1])
    R = rho ** np.abs(t[:, None] - t) if rho else np.eye(len(t))
    inverse = np.linalg.inv(np.einsum("ict,jct->ij", J, J))
    covariance = inverse @ np.einsum("ict,ts,jcs->ij", J, R, J) @ inverse
    total = np.einsum("ni,ij,nj->", off, np.linalg.inv(covariance), off)
    assert chi2.ppf(1e-4, 3 * n) < total < chi2.ppf(1 - 1e-4, 3 * n)
    mean = off.mean(axis=0)
    assert n * mean @ np.linalg.solve(covariance, mean) < chi2.ppf(1 - 1e-4, 3)
    bound = bound_std(fisher(sim, MIDDLE), sim.space.prior_std)
    spread = np.sqrt(np.diag(covariance))
    if rho == 0:
        np.testing.assert_allclose(spread, bound, rtol=1e-6)
    else:
        assert (spread > bound).all()


@pytest.mark.slow
def test_best_fits_scatter_by_the_bound_with_nuisances_too() -> None:
    """Drawn process noise and initial speed: the mixture is not quite Gaussian, so 20 % more room in the spread."""
    sim, n = simulator(process=paper_process(), known_start=False), 60
    # The nuisances' mean is not the nominal value; nor are they told apart from the parameters they move.
    off = scatter(sim, MIDDLE, n) - MIDDLE
    F = fisher(sim, MIDDLE)
    total = np.einsum("ni,ij,nj->", off, F, off)
    assert chi2.ppf(1e-4, 3 * n) / 1.2 < total < 1.2 * chi2.ppf(1 - 1e-4, 3 * n)


def test_a_fit_without_noise_finds_the_truth_from_afar() -> None:
    sim = simulator(known_start=False)
    truth = np.array([1.1, 0.2, -0.2])
    starts = np.stack([(sim.space.low + sim.space.high) / 2, sim.space.high])
    theta, residual = best_fit(sim, sim.noise_free(truth[None])[0], starts)
    bound = bound_std(fisher(sim, truth), sim.space.prior_std)
    assert (np.abs(theta - truth) < 0.05 * bound).all()
    assert (np.abs(residual).max(axis=1) < 0.05 * sim.noise.floor).all()


def test_a_fit_stays_inside_the_prior() -> None:
    sim = simulator()
    y = sim.noise_free(np.array([[1.25, 0.4, 0.0]]))[0]  # 0.4 lies beyond the prior's 0.3
    theta, _ = best_fit(sim, y, MIDDLE[None])
    assert (theta >= sim.space.low).all()
    assert (theta <= sim.space.high).all()
    assert theta[1] == pytest.approx(0.3, abs=1e-3)


def test_a_fit_where_nothing_simulates_is_refused() -> None:
    sim = simulator({"l_f": [1.4, 1.5], "C_alpha_r": [1e4, 1.1e4]}, steering_amplitude=0.3)
    with pytest.raises(InputError, match="the simulation fails wherever a fit was tried; narrow the prior"):
        best_fit(sim, np.zeros(sim.shape), (sim.space.low + sim.space.high)[None] / 2)


def test_parameters_that_do_the_same_are_named_as_confusable() -> None:
    """F = s v v' with v = (1, 1, 0) in units of the prior: covariance (I + s v v')^-1, correlation -s/(1 + s)."""
    prior_std, v = np.array([2.0, 0.1, 1.0]), np.array([1.0, 1.0, 0.0])
    for s in (10.0, 100.0):
        F = s * np.outer(v / prior_std, v / prior_std)
        assert correlation(F, prior_std)[0, 1] == pytest.approx(-s / (1 + s))
        expected = [(0, 1, pytest.approx(-s / (1 + s)))] if s / (1 + s) > CONFUSABLE else []
        assert confusable(F, prior_std) == expected
    assert confusable(np.full((2, 2), np.nan), np.ones(2)) == []


def test_laplace_is_the_gaussian_about_the_fit_of_a_series_without_noise() -> None:
    """Noise as a share of the signal; the covariance is the inverse of the information and the prior's."""
    sim = simulator()
    share = np.full(len(sim.windows.channels), 0.05)
    sim = sim.with_noise(replace(sim.noise, share=share, floor=0.1 * sim.noise.floor))
    found = laplace(sim, sim.noise_free(MIDDLE[None])[0], MIDDLE[None] + [[0.1, 0.1, -0.1]])
    assert found is not None
    mean, covariance = found.marginal
    expected = np.linalg.inv(fisher(sim, MIDDLE) + np.diag(sim.space.prior_std**-2.0))
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((mean - MIDDLE) / std, 0.0, atol=0.05)
    np.testing.assert_allclose(covariance / np.outer(std, std), expected / np.outer(std, std), atol=0.02)


def test_a_fit_that_ignores_correlation_says_as_much_as_its_score_varies() -> None:
    """M B^-1 M with B = J'RJ, R dense; less than the series say."""
    sim = simulator()
    sim = sim.with_noise(replace(sim.noise, rho=np.linspace(0.5, 0.9, len(sim.windows.channels))))
    found = laplace(sim, sim.noise_free(MIDDLE[None])[0], MIDDLE[None])
    assert found is not None
    at = sensitivity(sim, found.theta)
    J = at.jacobian / sim.noise.std(at.y)
    lags = np.abs(np.subtract.outer(*[np.arange(sim.shape[1])] * 2))
    B = sum(J[:, c] @ (rho**lags) @ J[:, c].T for c, rho in enumerate(sim.noise.rho))
    M = np.einsum("ict,jct->ij", J, J)
    d, prior = len(MIDDLE), np.ones(len(J))
    prior[:d] = sim.space.prior_std**-2.0
    expected = np.linalg.inv(M @ np.linalg.solve(B, M) + np.diag(prior))[:d, :d]
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.marginal[1] / np.outer(std, std), expected / np.outer(std, std), atol=1e-6)
    everything = np.linalg.inv(joint_fisher(sim, at) + np.diag(prior))[:d, :d]
    assert (np.diag(found.marginal[1]) >= np.diag(everything)).all()


def test_a_fit_that_explains_little_says_nothing_about_the_posterior() -> None:
    sim = simulator()
    y = sim.noise_free(MIDDLE[None])[0]
    assert laplace(sim, y + 2.0 * sim.noise.std(y) * (-1.0) ** np.arange(y.shape[1]), MIDDLE[None]) is None
