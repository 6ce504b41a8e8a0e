"""What the network sees: statistics that are what they say, and a score that loses no information."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from studies import PRIOR, constant_noise, paper_process, repeated, simulator

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.features import (
    Embedding,
    Features,
    Handcrafted,
    Score,
    correlations,
    hardened_score,
    independent_rows,
    slow,
)
from vehicle_sbi.inference.information import fisher, joint_fisher, sensitivity
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.rng import Stream

MIDDLE = np.array([1.25, 0.05, -0.1])
KINDS: dict[str, Features] = {"handcrafted": Handcrafted(), "score": Score(), "embedding": Embedding(decimate=2)}


def pilot(sim: Simulator, n: int = 100) -> np.ndarray:
    theta = np.random.default_rng(0).uniform(sim.space.low, sim.space.high, (n, len(sim.space)))
    return sim.simulate(theta, np.arange(n), stream=Stream.SIMULATION)[0]


@pytest.mark.parametrize("lag", [0, 1, 7])
def test_correlations_are_those_of_numpy(lag: int) -> None:
    """Of standardised stretches: for a series that is standardised as a whole the lagged ones nearly are."""
    rng, n, time = np.random.default_rng(1), 3, 40
    z = rng.standard_normal((n, 2, time))
    early, late = z[..., : time - lag], z[..., lag:]
    expected = np.einsum("nit,njt->nij", early, late) / (time - lag)
    found = correlations(z, (lag,))
    pairs = expected[:, [0], [1]] if lag == 0 else expected.reshape(n, 4)
    np.testing.assert_allclose(found, pairs)
    if lag == 0:
        z = (z - z.mean(axis=-1, keepdims=True)) / z.std(axis=-1, keepdims=True)
        np.testing.assert_allclose(correlations(z, (0,))[:, 0], [np.corrcoef(row)[0, 1] for row in z])


def test_correlations_at_lags_are_numpys_up_to_the_ends() -> None:
    """Leaving out `lag` of n samples changes means and variances by O(lag / n), times at most the largest |z|^2."""
    rng, time, lag = np.random.default_rng(2), 20_000, 5
    z = np.cumsum(rng.standard_normal((1, 2, time)), axis=-1)
    z = (z - z.mean(axis=-1, keepdims=True)) / z.std(axis=-1, keepdims=True)
    expected = [np.corrcoef(z[0, i, :-lag], z[0, j, lag:])[0, 1] for i in range(2) for j in range(2)]
    np.testing.assert_allclose(correlations(z, (lag,))[0], expected, atol=3 * lag / time * np.abs(z).max() ** 2)


def test_statistics_are_means_log_variances_and_correlations() -> None:
    y = np.random.default_rng(3).normal([[[3.0], [-1.0]]], [[[2.0], [0.5]]], (4, 2, 100))
    found = Handcrafted(lags_s=(0.0,)).statistics(y, rate=100.0)
    correlation = [[np.corrcoef(row)[0, 1]] for row in y]
    np.testing.assert_allclose(found, np.hstack([y.mean(axis=-1), np.log(y.var(axis=-1)), correlation]), rtol=1e-9)


def test_statistics_know_time_and_units_only_as_they_should() -> None:
    """Twice the rate with lags of half the time is the same; a unit moves only mean and log variance."""
    y = np.random.default_rng(4).normal(size=(4, 2, 100))
    slow = Handcrafted(lags_s=(0.0, 0.2)).statistics(y, rate=50.0)
    np.testing.assert_array_equal(slow, Handcrafted(lags_s=(0.0, 0.1)).statistics(y, rate=100.0))
    scaled = Handcrafted(lags_s=(0.0, 0.2)).statistics(1000.0 * y, rate=50.0)
    np.testing.assert_allclose(scaled[:, :2], 1000.0 * slow[:, :2])
    np.testing.assert_allclose(scaled[:, 2:4], slow[:, 2:4] + 2 * np.log(1000.0))
    np.testing.assert_allclose(scaled[:, 4:], slow[:, 4:], atol=1e-9)


def test_a_lag_longer_than_the_recording_is_shortened_and_a_constant_channel_is_finite() -> None:
    y = np.random.default_rng(5).normal(size=(4, 2, 100))
    y[:, 1] = 3.0
    assert np.isfinite(Handcrafted(lags_s=(0.0, 100.0)).statistics(y, rate=50.0)).all()


@pytest.mark.parametrize("lags", [(), (-0.1,), (0.0, float("nan"))])
def test_bad_lags_are_refused(lags: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"features\.lags_s = .*state at least one lag, none negative"):
        Handcrafted(lags_s=lags)


def test_handcrafted_features_are_normalised_by_their_pilot() -> None:
    sim = simulator(known_start=False)
    y = pilot(sim)
    x = Handcrafted().fit(sim, MIDDLE, MIDDLE[None], y)(y)
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=1e-3)  # float32 series
    np.testing.assert_allclose(x.std(axis=0), 1.0, rtol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_row_of_features_depends_on_its_own_series_alone(kind: str) -> None:
    sim = simulator(known_start=False)
    y = pilot(sim)
    summary = KINDS[kind].fit(sim, MIDDLE, MIDDLE[None], y)
    x = summary(y)
    np.testing.assert_allclose(np.concatenate([summary(y[:30]), summary(y[30:])]), x, rtol=1e-4, atol=1e-4)
    assert summary(y[:0]).shape == (0, *x.shape[1:])


def test_independent_rows_span_what_all_rows_span() -> None:
    rng = np.random.default_rng(6)
    two = rng.standard_normal((2, 5))
    matrix = np.vstack([two[0], 3 * two[0], np.zeros(5), two[1], two.sum(axis=0)])
    assert independent_rows(matrix).tolist() == [0, 3]
    assert independent_rows(np.eye(4)).tolist() == [0, 1, 2, 3]
    assert independent_rows(np.zeros((3, 3))).tolist() == []


def scored(sim: Simulator, fiducial: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The score's features are affine in the series: its value without noise, and its matrix in whitened noise.

    Also the features' derivatives by theta and nuisances at the fiducial.
    """
    summary = Score().fit(sim, fiducial, fiducial[None], sim.noise_free(fiducial[None]))
    at = sensitivity(sim, fiducial)
    zero = summary(at.y[None])[0]
    unit = np.eye(at.y.size).reshape(-1, *at.y.shape) * sim.noise.floor[:, None]
    return zero, summary(at.y + unit) - zero, summary(at.y + at.jacobian) - zero


@pytest.mark.parametrize("factor", [1.0, 1e-3])
@pytest.mark.parametrize("nuisances", [False, True])
def test_the_score_holds_the_fisher_information(factor: float, nuisances: bool) -> None:
    """Of t ~ N(D theta, P P'): D'(P P')^-1 D is that of the series, to 1 %, however precise the sensors are."""
    process: dict[str, Any] = {"process": paper_process()} if nuisances else {}
    sim = simulator(known_start=not nuisances, **process)
    sim = sim.with_noise(constant_noise(sim.windows, factor=factor))
    _, P, D = scored(sim, MIDDLE)
    covariance = P.T @ P  # float32 features: scaled before the inverse
    scale = np.sqrt(np.diag(covariance))
    held = (D / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), (D / scale).T)
    e = len(sim.nuisances)
    F = held[:3, :3] - held[:3, 3:] @ np.linalg.solve(held[3:, 3:] + np.eye(e), held[3:, :3])
    expected = fisher(sim, MIDDLE)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(F / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.01)


def test_the_score_is_the_posterior_mean_of_the_linear_model() -> None:
    """Without noise and near the fiducial: theta itself, in prior standard deviations, but for the prior's pull."""
    sim = simulator()
    sim = sim.with_noise(constant_noise(sim.windows, factor=0.1))
    summary = Score().fit(sim, MIDDLE, MIDDLE[None], sim.noise_free(MIDDLE[None]))
    std, F = sim.space.prior_std, joint_fisher(sim, sensitivity(sim, MIDDLE))
    off = 0.02 * std * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 1, -1]])
    x = summary(sim.noise_free(MIDDLE + off))
    information = F * np.outer(std, std)
    pulled = (off / std) @ (np.linalg.solve(information + np.eye(3), information)).T
    # The model's curvature over a fiftieth of the prior's spread is about a fiftieth of the shift itself.
    np.testing.assert_allclose(x, MIDDLE / std + pulled, atol=0.02 * 0.05)


def test_what_a_recording_does_not_see_is_no_feature() -> None:
    seen = simulator(drive_torque=0.0, brake_torque=0.0, steering_amplitude=0.02)
    unseen = simulator(PRIOR | {"h_cog": [0.2, 0.6]}, drive_torque=0.0, brake_torque=0.0, steering_amplitude=0.02)
    sizes = []
    for sim, fiducial in ((seen, MIDDLE), (unseen, np.append(MIDDLE, 0.4))):
        rigid = sim.nominal.copy()
        rigid["C_vert"] = np.inf
        sim = replace(sim, nominal=rigid)
        y = sim.noise_free(fiducial[None])
        sizes.append(Score().fit(sim, fiducial, fiducial[None], y)(y).shape[1])
    assert sizes == [3, 3]


def test_the_score_of_masked_samples_does_not_depend_on_them() -> None:
    sim = simulator()
    valid = np.random.default_rng(7).random(sim.shape) > 0.5
    sim = replace(sim, windows=replace(sim.windows, valid=valid))
    y = sim.noise_free(MIDDLE[None])
    summary = Score().fit(sim, MIDDLE, MIDDLE[None], y)
    np.testing.assert_array_equal(summary(np.where(valid, y, 0.0)), summary(np.where(valid, y, 1e6)))


def test_a_recording_that_tells_nothing_is_refused() -> None:
    sim = simulator()
    nothing = replace(sim, windows=replace(sim.windows, valid=np.zeros(sim.shape, dtype=bool)))
    with pytest.raises(InputError, match="features=score: this recording tells nothing about any free parameter"):
        Score().fit(nothing, MIDDLE, MIDDLE[None], sim.noise_free(MIDDLE[None]))


def test_a_fiducial_that_spins_out_is_refused() -> None:
    sim = simulator({"l_f": [1.4, 1.5], "C_alpha_r": [1e4, 1.1e4]}, steering_amplitude=0.3)
    with pytest.raises(InputError, match="features=score: the simulation at the fiducial point fails"):
        Score().fit(sim, np.array([1.45, 1.05e4]), np.array([1.45, 1.05e4])[None], np.zeros((1, *sim.shape)))


def test_an_embedding_sees_averages_of_standardised_series() -> None:
    sim = simulator(known_start=False)
    y = pilot(sim)
    x = Embedding(decimate=3).fit(sim, MIDDLE, MIDDLE[None], y)(y)
    assert x.shape == (100, 5, 83)
    z = (y - y.mean(axis=(0, 2), keepdims=True)) / y.std(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(x[:, :, 5], z[:, :, 15:18].mean(axis=-1), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("decimate", [0, 4, 1000])
def test_an_embedding_needs_samples_to_see(decimate: int) -> None:
    sim = simulator()
    with pytest.raises(InputError, match=f"features.decimate = {decimate}; it must leave at least 64 of 250 samples"):
        Embedding(decimate=decimate).fit(sim, MIDDLE, MIDDLE[None], pilot(sim, 2))


def test_only_the_embedding_learns() -> None:
    assert Handcrafted().network(5, 250) is None
    assert Score().network(5, 250) is None
    network = Embedding(outputs=7).network(5, 250)
    assert network is not None
    assert network(torch.zeros(3, 5, 250)).shape == (3, 7)


@pytest.mark.parametrize("time", [64, 250, 30_000])
def test_the_embedding_network_takes_series_of_any_length_and_its_rows_are_its_own(time: int) -> None:
    network = Embedding().network(2, time)
    assert network is not None
    y = torch.randn(4, 2, time, generator=torch.Generator().manual_seed(0))
    whole = network(y)
    assert whole.shape == (4, 20)
    torch.testing.assert_close(network(y[2:3]), whole[2:3], rtol=1e-4, atol=1e-5)
    assert (whole == 0).sum() == 0  # no output is stuck


def test_the_score_of_several_windows_is_one_number_per_parameter() -> None:
    sim = simulator()
    long = replace(sim, windows=repeated(sim.windows, 3))
    y = long.noise_free(MIDDLE[None])
    assert Score().fit(long, MIDDLE, MIDDLE[None], y)(y).shape == (1, 3)


def test_a_hardened_score_is_the_ordinary_one_where_nuisances_are_independent_of_the_parameters() -> None:
    J, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((200, 7)))
    white = 30.0 * J.T
    np.testing.assert_allclose(hardened_score(white, 3), white[:3], atol=30.0 * 200 * np.finfo(float).eps)


@pytest.mark.parametrize("precision", [1.0, 1e-2, 1e-4])
def test_a_hardened_score_does_not_move_with_nuisances_of_a_wide_prior(precision: float) -> None:
    """Its derivative by them is S (F_nn + P)^-1 P with S = F_bn: at most |F_bn| P / lambda_min(F_nn), 0 as P is."""
    white = np.random.default_rng(9).standard_normal((9, 100))
    white[3:] /= np.sqrt(precision)  # in units of a spread of precision^-1/2
    moved = hardened_score(white, 3) @ white[3:].T * np.sqrt(precision)
    F = white[:3] @ white[3:].T * np.sqrt(precision)
    least = np.linalg.eigvalsh(white[3:] @ white[3:].T)[0] * precision
    assert np.linalg.norm(moved, 2) <= np.linalg.norm(F, 2) * precision / least * (1 + 1e-9)


def test_a_hardened_score_keeps_the_information_of_the_schur_complement() -> None:
    """Linear and Gaussian: D' C^-1 D of t = H y equals (F_bb - F_bn (F_nn + I)^-1 F_nb), which is that of y, itself
    J_b' (I + J_n' J_n)^-1 J_b, where C = H (I + J_n' J_n) H' is what noise and nuisances make of t."""
    white, d = np.random.default_rng(10).standard_normal((9, 60)), 3
    H = hardened_score(white, d)
    covariance = np.eye(60) + white[d:].T @ white[d:]
    D = H @ white[:d].T
    held = D.T @ np.linalg.solve(H @ covariance @ H.T, D)
    F = white @ white.T
    schur = F[:d, :d] - F[:d, d:] @ np.linalg.solve(F[d:, d:] + np.eye(6), F[d:, :d])
    np.testing.assert_allclose(held, schur, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(schur, white[:d] @ np.linalg.solve(covariance, white[:d].T), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_slow_noise_counts_by_the_variance_of_its_mean(rho: float) -> None:
    """n var(mean) / sigma^2 of AR(1) noise: (1 + rho) / (1 - rho) less 2 rho / n (1 - rho)^2, under a hundredth."""
    sim = simulator()
    sim = sim.with_noise(constant_noise(sim.windows, rho=rho))
    n = 4000
    lag = np.arange(1, n)
    expected = 1 + 2 * np.sum((1 - lag / n) * rho**lag)
    np.testing.assert_allclose(slow(sim) ** 2, expected, rtol=0.01)
