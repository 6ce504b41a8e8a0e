"""A batch of simulations is a pure function of theta and addresses, and its noise has the law that is stated."""

from dataclasses import replace

import numpy as np
import pytest
from cars import MILD, PAPER, finished, paper_manoeuvre, record_of
from scipy.stats import chi2, kstest
from studies import QUIET, constant_noise, manoeuvre, paper_process, repeated, simulator

from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.inference.simulator import STIFFNESSES, Simulator, succeeded
from vehicle_sbi.physics.simulation import SPUN_OUT
from vehicle_sbi.rng import Stream

N = 24


def noisy() -> Simulator:
    """Every kind of randomness at once, correlated measurement noise included."""
    process = paper_process(stiffness=0.05, inputs=0.02)
    noise = constant_noise(manoeuvre().windows(PAPER), rho=0.5)
    return simulator(process=process, noise=noise, known_start=False)


def thetas(sim: Simulator, n: int = N) -> np.ndarray:
    return np.random.default_rng(0).uniform(sim.space.low, sim.space.high, (n, len(sim.space)))


def simulated(sim: Simulator, theta: np.ndarray, index: np.ndarray, **address: int) -> np.ndarray:
    return sim.simulate(theta, index, stream=Stream.SIMULATION, **address)[0]


@pytest.mark.parametrize("per_sample", [False, True])
def test_a_row_depends_on_its_theta_and_its_address_alone(per_sample: bool) -> None:
    sim = noisy()
    sim = replace(sim, process=replace(sim.process, per_sample=per_sample))
    theta, index = thetas(sim), np.arange(N)
    whole = simulated(sim, theta, index)
    order = np.random.default_rng(1).permutation(N)
    np.testing.assert_array_equal(simulated(sim, theta[order], index[order]), whole[order])
    parts = [simulated(sim, theta[part], index[part]) for part in np.array_split(index, 5)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    np.testing.assert_array_equal(simulated(sim, theta[7:8], index[7:8]), whole[7:8])


def test_other_addresses_give_other_noise() -> None:
    sim = noisy()
    theta = np.repeat(thetas(sim, 1), 2, axis=0)
    first = simulated(sim, theta, np.array([0, 1]))
    others = [
        simulated(sim, theta, np.array([0, 1]), round=1),
        simulated(replace(sim, seed=4), theta, np.array([0, 1])),
        sim.simulate(theta, np.array([0, 1]), stream=Stream.TRUTH)[0],
        first[::-1],
    ]
    assert all((other != first).mean() > 0.99 for other in others)


def test_no_simulations_are_no_rows() -> None:
    sim = noisy()
    y, outcomes = sim.simulate(np.zeros((0, 3)), np.arange(0), stream=Stream.SIMULATION)
    assert y.shape == (0, *sim.shape)
    assert outcomes.shape == (0,)


def test_without_noise_it_is_the_model() -> None:
    """The same as the physics called directly, with theta as fields of the record."""
    sim = simulator({"l_f": [1.0, 1.5], "delta_C_alpha_f": [-0.3, 0.3]}, rate=200.0)
    theta = np.array([[1.2, 0.1]])
    car = record_of(PAPER, l_f=1.2, C_alpha_f=7e4)
    expected = finished(car, "torque", paper_manoeuvre(MILD), (10.5, 0, 0), substeps=4)
    # cars.simulate reports the yaw rate over CAN and the simulator from the IMU: neither is delayed here.
    np.testing.assert_allclose(sim.noise_free(theta)[0], expected[:5], rtol=1e-12, atol=1e-12)


def test_nuisances_at_zero_are_at_their_means() -> None:
    sim = noisy()
    assert sim.nuisances == (*STIFFNESSES, "steering", "torque", "v_x_0")
    draws = sim.nuisance_draws(np.zeros((2, 7)))
    nominal = np.array([getattr(PAPER, name) for name in STIFFNESSES])
    np.testing.assert_allclose(draws.stiffness, np.tile(sim.process.stiffness.mean * nominal, (2, 1, 1)))
    np.testing.assert_allclose(draws.inputs, np.full((2, 1, 2), sim.process.inputs.mean))
    np.testing.assert_allclose(draws.initial, np.tile(sim.windows.x0, (2, 1, 1)))


@pytest.mark.parametrize("i", range(7))
def test_a_nuisance_counts_in_standard_deviations_and_moves_nothing_else(i: int) -> None:
    sim = noisy()
    mean, moved = (sim.nuisance_draws(eta) for eta in (np.zeros((1, 7)), np.eye(7)[i : i + 1]))
    nominal = np.array([getattr(PAPER, name) for name in STIFFNESSES])
    expected = np.zeros(9)
    spreads = [*(sim.process.stiffness.std * nominal), *[sim.process.inputs.std] * 2, sim.windows.x0_std[0]]
    expected[i] = spreads[i]
    moves = [(getattr(moved, f) - getattr(mean, f)).ravel() for f in ("stiffness", "inputs", "initial")]
    np.testing.assert_allclose(np.concatenate(moves), expected, atol=1e-9)


def test_drawn_nuisances_have_the_spread_that_the_information_takes_them_to_have() -> None:
    sim, n = noisy(), 4000
    rng = np.random.default_rng(2)
    draws = [sim._random(rng) for _ in range(n)]
    nominal = np.array([getattr(PAPER, name) for name in STIFFNESSES])
    stiffness = np.concatenate([d.stiffness[:, 0] for d in draws]) / nominal
    mixture = sim.process.stiffness
    np.testing.assert_allclose(stiffness.mean(axis=0), mixture.mean, atol=5 * mixture.std / np.sqrt(n))
    # A mixture's kurtosis here is below 6, so its variance estimate's relative spread below sqrt(5 / n).
    np.testing.assert_allclose(stiffness.var(axis=0), mixture.std**2, rtol=5 * np.sqrt(5 / n))
    speed = np.array([d.initial[0, 0, 0] for d in draws])
    assert kstest(speed, "uniform", (10.0, 1.0)).pvalue > 1e-3
    assert not np.any([d.initial[0, 0, 1:] for d in draws])


def test_a_recordings_initial_state_is_gaussian_about_what_was_measured() -> None:
    sim = noisy()
    measured = replace(sim.windows, x0=np.array([[15.0, 0.2, 0.1]]), x0_std=np.array([0.3, 0.05, 0.02]))
    sim = replace(sim, windows=measured, uniform_start=False)
    rng = np.random.default_rng(3)
    states = np.concatenate([sim._random(rng).initial[:, 0] for _ in range(2000)])
    for values, mean, std in zip(states.T, measured.x0[0], measured.x0_std, strict=True):
        assert kstest(values, "norm", (mean, std)).pvalue > 1e-3


def test_measurement_noise_has_the_stated_standard_deviation() -> None:
    n = 200
    windows = manoeuvre().windows(PAPER)
    share = np.array([0.1, 0.1, 0.05, 0.05, 0.05])
    noise = MeasurementNoise(share, 0.1 * constant_noise(windows).floor, np.zeros(5), 250)
    sim = simulator(noise=noise)
    theta = np.repeat(thetas(sim, 1), n, axis=0)
    clean = sim.noise_free(theta[:1])[0]
    z = (simulated(sim, theta, np.arange(n)) - clean) / noise.std(clean)
    for channel in range(5):
        size = z[:, channel].size
        assert chi2.ppf(1e-6, size) < np.sum(z[:, channel].astype(float) ** 2) < chi2.ppf(1 - 1e-6, size)
    assert kstest(z[:, :, ::10].ravel(), "norm").pvalue > 1e-3


def test_masked_samples_are_zero_and_the_others_as_without_a_mask() -> None:
    sim = noisy()
    valid = np.random.default_rng(4).random(sim.windows.valid.shape) > 0.3
    masked = replace(sim, windows=replace(sim.windows, valid=valid))
    theta = thetas(sim, 3)
    whole, holes = simulated(sim, theta, np.arange(3)), simulated(masked, theta, np.arange(3))
    np.testing.assert_array_equal(holes, np.where(valid, whole, 0.0))


def test_a_simulation_that_spins_out_is_a_row_of_nan_and_counted() -> None:
    sim = simulator({"l_f": [1.0, 1.5], "C_alpha_r": [1e4, 1e5]}, steering_amplitude=0.3)
    theta = np.array([[1.5, 1e4], [1.0, 1e5]])
    y, outcomes = sim.simulate(theta, np.arange(2), stream=Stream.SIMULATION)
    assert outcomes[0] == SPUN_OUT
    assert np.isnan(y[0]).all()
    assert succeeded(outcomes).tolist() == [False, True]
    assert np.isfinite(y[1]).all()


def test_windows_that_are_the_same_are_simulated_the_same() -> None:
    sim = simulator()
    twice = replace(sim, windows=repeated(sim.windows, 2))
    theta = thetas(sim, 2)
    once = sim.noise_free(theta)
    np.testing.assert_array_equal(twice.noise_free(theta), np.concatenate([once, once], axis=-1))


def test_no_noise_is_no_nuisance() -> None:
    assert simulator(process=QUIET).nuisances == ()
