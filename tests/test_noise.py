"""Noise has the law that its configuration states, and estimating it finds that law again."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from cars import PAPER
from scipy.signal import lfilter
from scipy.stats import chi2, kstest
from studies import STD, constant_noise, manoeuvre, paper_process, repeated

from vehicle_sbi.data.noise import (
    ConstantNoise,
    EstimatedNoise,
    MeasurementNoise,
    Mixture,
    ProcessNoise,
    ProportionalNoise,
    from_residual,
    rounding,
    sensor_noise,
)
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError
from vehicle_sbi.rng import Stream, generator

SHARE = {"a_x": 0.1, "a_y": 0.1, "yaw_rate": 0.05, "wheel_speed_front": 0.05, "wheel_speed_rear": 0.05}
FLOOR = {name: 0.2 * std for name, std in STD.items()}
RHO = 0.9


def long_windows(times: int = 100) -> Windows:
    """As many windows of 250 samples: enough samples for tight intervals, and starts in between."""
    return repeated(manoeuvre().windows(PAPER), times)


def chi_square_interval(n: int) -> tuple[float, float]:
    """Where the mean square of n unit Gaussians lies in all but 1e-6 of cases."""
    return float(chi2.ppf(5e-7, n) / n), float(chi2.ppf(1 - 5e-7, n) / n)


def test_a_mixture_has_the_mean_and_the_spread_that_it_says() -> None:
    mixture = Mixture(np.array([-0.05, 0.0, 0.03]), np.array([0.01, 0.05, 0.02]))
    n = 200_000
    draws = mixture.sample((n,), np.random.default_rng(0))
    assert abs(draws.mean() - mixture.mean) < 5 * mixture.std / np.sqrt(n)
    # The variance of a sample variance is (kurtosis - 1) / n; five of its standard deviations.
    kurtosis = np.mean(((draws - mixture.mean) / mixture.std) ** 4)
    assert abs(draws.var() / mixture.std**2 - 1) < 5 * np.sqrt((kurtosis - 1) / n)


def test_an_empty_mixture_is_no_noise() -> None:
    mixture = paper_process(stiffness=0.0).stiffness
    assert (mixture.mean, mixture.std) == (0.0, 0.0)
    assert not mixture.sample((3, 2), np.random.default_rng(0)).any()


def test_process_noise_is_drawn_once_per_study_and_from_its_seed() -> None:
    def drawn(seed: int) -> np.ndarray:
        process = ProcessNoise(inputs=0.02).draw(generator(seed=seed, stream=Stream.STUDY))
        return np.concatenate([[*m.means, *m.stds] for m in (process.stiffness, process.inputs)])

    np.testing.assert_array_equal(drawn(3), drawn(3))
    assert (drawn(3) != drawn(4)).all()


def test_the_mixture_is_that_of_the_paper() -> None:
    """Ten components, means uniform in +-5 % of nominal, standard deviations uniform in 0 to 5 %."""
    processes = [ProcessNoise().draw(generator(seed=seed, stream=Stream.STUDY)).stiffness for seed in range(200)]
    assert all(len(m.means) == len(m.stds) == 10 for m in processes)
    means, stds = (np.concatenate([getattr(m, name) for m in processes]) for name in ("means", "stds"))
    assert kstest(means, "uniform", (-0.05, 0.1)).pvalue > 1e-3
    assert kstest(stds, "uniform", (0.0, 0.05)).pvalue > 1e-3


@pytest.mark.parametrize("settings", [{"stiffness": -0.1}, {"stiffness": 0.3}, {"inputs": 0.5}, {"components": 0}])
def test_process_noise_out_of_range_is_refused(settings: dict) -> None:
    with pytest.raises(InputError, match=r"noise\.process: "):
        ProcessNoise(**settings)


def test_the_standard_deviation_grows_with_the_signal_from_a_floor() -> None:
    windows = manoeuvre().windows(PAPER)
    noise = ProportionalNoise(share=SHARE, floor=FLOOR).measurement(windows)
    still, fast = noise.std(np.zeros((5, 250))), noise.std(np.full((5, 250), -1e6))
    np.testing.assert_allclose(still, np.repeat(np.array(list(FLOOR.values()))[:, None], 250, axis=1))
    np.testing.assert_allclose(fast, np.repeat(1e6 * np.array(list(SHARE.values()))[:, None], 250, axis=1), rtol=1e-9)
    y = np.array([[0.5], [2.0], [0.1], [30.0], [31.0]])
    expected = [np.hypot(SHARE[name] * y[i, 0], FLOOR[name]) for i, name in enumerate(windows.channels)]
    np.testing.assert_allclose(noise.std(y)[:, 0], expected)


def test_channels_are_taken_by_name_whatever_their_order() -> None:
    windows = manoeuvre().windows(PAPER)
    backwards = dict(reversed(STD.items()))
    np.testing.assert_array_equal(ConstantNoise(std=backwards).measurement(windows).floor, list(STD.values()))


def test_white_noise_is_white_and_of_unit_variance() -> None:
    noise = constant_noise(long_windows())
    unit = noise.sample((5, 25_000), np.random.default_rng(0))
    low, high = chi_square_interval(unit.size)
    assert low < np.mean(unit.astype(float) ** 2) < high
    assert abs(np.mean(unit[:, 1:] * unit[:, :-1])) < 5 / np.sqrt(unit.size)


def test_correlated_noise_decays_as_rho_to_the_lag_and_starts_anew_with_each_window() -> None:
    windows, n, time = long_windows(1000), 1000, 250
    unit = constant_noise(windows, rho=RHO).sample((5, n * time), np.random.default_rng(1)).reshape(5, n, time)
    independent = 5 * n * time * (1 - RHO) / (1 + RHO)  # samples that a mean over the series is worth
    assert abs(np.mean(unit**2) - 1) < 5 * np.sqrt(2.0 / independent)
    for lag in (1, 2, 5, 20):
        # A product of two unit Gaussians with correlation c has variance 1 + c^2.
        tolerance = 5 * np.sqrt((1 + RHO ** (2 * lag)) / independent)
        assert abs(np.mean(unit[..., lag:] * unit[..., :-lag]) - RHO**lag) < tolerance
    across = np.mean(unit[:, 1:, 0] * unit[:, :-1, -1])
    assert abs(across) < 5 / np.sqrt(5 * n)
    first = np.mean(unit[..., 0] ** 2)
    assert chi_square_interval(5 * n)[0] < first < chi_square_interval(5 * n)[1]


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.99])
def test_whitening_makes_noise_white_across_windows_and_gaps(rho: float) -> None:
    windows = long_windows()
    rng = np.random.default_rng(2)
    valid = rng.random((5, 25_000)) > 0.2  # gaps of one sample to several
    for begin in range(100, 24_000, 1111):
        valid[:, begin : begin + 300] = False  # and gaps longer than a window
    noise = constant_noise(windows, rho=rho)
    std = noise.std(np.zeros((5, 25_000)))
    residual = np.where(valid, std * noise.sample((5, 25_000), rng), np.nan)
    white = noise.whiten(residual, std, valid)
    assert not white[~valid].any()
    kept = [row[good] for row, good in zip(white, valid, strict=True)]
    n = sum(map(len, kept))
    low, high = chi_square_interval(n)
    assert low < np.sum(np.concatenate(kept) ** 2) / n < high
    for lag in (1, 2, 10):
        products = np.concatenate([row[lag:] * row[:-lag] for row in kept])
        assert abs(products.mean()) < 5 / np.sqrt(len(products))


def test_whitening_is_linear_and_takes_a_stack_of_residuals() -> None:
    windows = manoeuvre().windows(PAPER)
    rng = np.random.default_rng(3)
    valid = rng.random((5, 250)) > 0.3
    noise = constant_noise(windows, rho=RHO)
    std, stack = noise.std(np.zeros((5, 250))), rng.standard_normal((4, 5, 250))
    white = noise.whiten(stack, std, valid)
    for one, whole in zip(stack, white, strict=True):
        np.testing.assert_allclose(noise.whiten(one, std, valid), whole, rtol=1e-12)
    np.testing.assert_allclose(noise.whiten(stack.sum(axis=0), std, valid), white.sum(axis=0), atol=1e-9)


def test_a_residuals_noise_is_found_again() -> None:
    """sigma and rho of each channel, within five standard errors of an AR(1) estimate (Kay, sec. 3.4 and 7.8)."""
    windows = long_windows(200)
    n = 200 * 250
    rhos, sigmas = np.array([0.0, 0.3, 0.6, 0.9, 0.95]), np.array(list(STD.values()))
    truth = MeasurementNoise(np.zeros(5), sigmas, rhos, 250)
    valid = np.random.default_rng(4).random((5, n)) > 0.1
    unit = truth.sample((5, n), np.random.default_rng(5))
    residual = np.where(valid, sigmas[:, None] * unit, np.nan)
    found = from_residual(residual, replace(windows, valid=valid))
    worth = 0.8 * n * (1 - rhos**2) / (1 + rhos**2)
    assert (np.abs(found.floor / sigmas - 1) < 5 * np.sqrt(0.5 / worth)).all()
    # rho is the ratio of two sums over slightly different samples: the tenth that is masked adds 1/5 to its variance.
    assert (np.abs(found.rho - rhos) < 5 * np.sqrt(1.2 / (0.8 * n)) + 5 * np.sqrt(0.2 / worth) * rhos).all()
    assert found.window == 250


def recorded(rho: float = 0.0, gaps: bool = False) -> Windows:
    """A made-up recording: slow signals about large means, with noise of a known law."""
    windows = replace(long_windows(20), rate=200.0)
    n = windows.y.shape[1]
    t = np.arange(n) % 250 / 200.0
    slow = 20.0 + np.sin(2 * np.pi * 0.5 * t)
    noise = constant_noise(windows, rho=rho)
    valid = np.ones((5, n), dtype=bool)
    if gaps:
        for begin in range(60, n, 250):
            valid[:, begin : begin + 30] = False
    y = slow + noise.floor[:, None] * noise.sample((5, n), np.random.default_rng(6))
    return replace(windows, y=np.where(valid, y, np.nan), valid=valid)


@pytest.mark.parametrize("gaps", [False, True])
def test_white_sensor_noise_is_found_in_a_recording(gaps: bool) -> None:
    windows = recorded(gaps=gaps)
    found = EstimatedNoise().measurement(windows)
    n = windows.valid[0].sum()
    # A variance from n residuals of a local cubic has at most twice the spread of one from n independent samples; the
    # smoother's ends, and gaps that are bridged, take or leave a share of the noise: 5 %.
    tolerance = 5 * np.sqrt(0.5 * 2 / n) + 0.05
    np.testing.assert_allclose(found.floor, list(STD.values()), rtol=tolerance)
    assert (found.rho < 5 / np.sqrt(n)).all()


def test_estimated_noise_needs_a_recording() -> None:
    with pytest.raises(InputError, match="noise=estimated: there is no recording to estimate it from"):
        EstimatedNoise().measurement(manoeuvre().windows(PAPER))


def test_estimated_noise_needs_ten_samples_of_each_channel() -> None:
    windows = recorded()
    valid = windows.valid.copy()
    valid[2, 9:] = False
    with pytest.raises(InputError, match="noise=estimated: channel yaw_rate has 9 valid samples; it needs at least 10"):
        EstimatedNoise().measurement(replace(windows, valid=valid))


def test_a_channel_that_is_fitted_perfectly_can_still_be_divided_by_its_noise() -> None:
    windows = recorded()
    noise = from_residual(np.zeros(windows.y.shape), windows)
    assert (noise.floor > 0).all()
    assert not noise.rho.any()
    assert np.isfinite(noise.whiten(np.zeros(windows.y.shape), noise.std(windows.y), windows.valid)).all()


WRONG: Mapping[str, tuple[dict, str]] = {
    "missing": ({"a_x": 0.1}, "noise.std: unknown channel 'a_y'; known: a_x"),
    "negative": (STD | {"a_x": -0.1}, "noise.std: a_x = -0.1; it must be a number that is not negative"),
    "not a number": (STD | {"a_x": float("nan")}, "noise.std: a_x = nan; it must be a number that is not negative"),
    "infinite": (STD | {"a_x": float("inf")}, "noise.std: a_x = inf; it must be a number that is not negative"),
    "text": (STD | {"a_x": "loud"}, "noise.std: a_x = 'loud'; it must be a number that is not negative"),
    "null": (STD | {"a_x": None}, "noise.std: a_x = None; it must be a number that is not negative"),
    "zero": (STD | {"a_x": 0.0}, "noise.std: a standard deviation must be positive"),
}


@pytest.mark.parametrize("case", WRONG)
def test_bad_noise_is_one_clear_line(case: str) -> None:
    given, message = WRONG[case]
    with pytest.raises(InputError, match=message):
        ConstantNoise(std=given).measurement(manoeuvre().windows(PAPER))


def test_proportional_noise_needs_a_floor_since_signals_cross_zero() -> None:
    with pytest.raises(InputError, match=r"noise\.floor: a floor must be positive"):
        ProportionalNoise(share=SHARE, floor=FLOOR | {"a_x": 0.0}).measurement(manoeuvre().windows(PAPER))


def ar1_series(rho: float, n: int, rng: np.random.Generator) -> np.ndarray:
    unit = rng.standard_normal(n) * np.sqrt(1.0 - rho**2)
    unit[0] /= np.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], unit))


def as_windows(y: np.ndarray, rate: float) -> Windows:
    one = manoeuvre().windows(PAPER)
    valid = np.ones_like(y, dtype=bool)
    u, t = np.zeros((1, y.shape[1], one.u.shape[2])), np.arange(y.shape[1])[None] / rate
    return replace(one, rate=rate, u=u, y=y, valid=valid, channels=("a_y",), groups=("imu",), t=t)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_a_sensors_noise_is_told_by_its_fast_scatter_whatever_slow_misfit_there_is(rho: float) -> None:
    # A slow swing ten times as large, w = 2 pi 0.5 Hz: of order 3 over 0.25 s it leaves (0.25 s w)^4 / 4! / 16 of
    # itself, a thousandth, which is a hundredth of the noise. The estimate is good to sqrt(2/n) (1 + rho)/(1 - rho).
    rng = np.random.default_rng(3)
    swing = np.sin(2.0 * np.pi * 0.5 * np.arange(4000) / 100.0)
    y = 0.1 * ar1_series(rho, 4000, rng) + swing
    windows = as_windows(y[None], 100.0)
    found = sensor_noise(windows.y, windows)
    assert found.floor[0] == pytest.approx(0.1, rel=4 * np.sqrt(2 / 4000) * (1 + rho) / (1 - rho))
    noise = replace(from_residual(windows.y, windows, 0.5), sensor=found)
    assert noise.floor[0] > 0.5
    assert noise.of_sensor.floor[0] == found.floor[0]
    assert noise.misfit[0] == pytest.approx(noise.floor[0] / found.floor[0])


def test_noise_that_is_no_larger_than_the_fast_scatter_is_all_the_sensors() -> None:
    windows = as_windows(0.1 * ar1_series(0.6, 4000, np.random.default_rng(4))[None], 100.0)
    estimated = from_residual(0.5 * windows.y, windows)
    noise = replace(estimated, sensor=sensor_noise(windows.y, windows))
    assert noise.misfit[0] == 1.0
    assert noise.of_sensor.floor[0] == estimated.floor[0]
    assert noise.of_sensor.rho[0] == estimated.rho[0]


@pytest.mark.parametrize("step", [0.02, 1.0 / 3.0])
def test_a_quantised_channel_keeps_its_rounding_noise(step: float) -> None:
    # So slow that it stays on a step for longer than the filter: its fast scatter is nothing, its rounding not.
    signal = 10.0 * step * np.sin(2.0 * np.pi * np.arange(4000) / 4000.0)
    windows = as_windows(np.round(signal / step)[None] * step, 100.0)
    assert sensor_noise(windows.y, windows).floor[0] >= step / np.sqrt(12.0) * (1 - 1e-9)
    assert rounding(windows.y[0]) == pytest.approx(step / np.sqrt(12.0))
    assert rounding(np.random.default_rng(0).normal(size=4000)) == 0.0


def test_a_quick_drive_is_not_taken_for_slow_noise() -> None:
    # A swing of 3 Hz leaves something of itself beside the noise, which reads like a correlation of almost 1. With half
    # a second of memory at most its part of the noise at low frequencies, floor^2 (1 + rho) / (1 - rho), is bounded.
    y = np.sin(2.0 * np.pi * 3.0 * np.arange(4000) / 50.0) + 0.03 * ar1_series(0.7, 4000, np.random.default_rng(5))
    windows = as_windows(y[None], 50.0)
    free, bounded = sensor_noise(windows.y, windows), sensor_noise(windows.y, windows, 0.5)
    assert free.rho[0] > bounded.rho[0] == pytest.approx(np.exp(-1.0 / 25.0))
    slow = [one.floor[0] ** 2 * (1.0 + one.rho[0]) / (1.0 - one.rho[0]) for one in (free, bounded)]
    assert slow[1] < 0.5 * slow[0]


def test_innovations_are_what_each_sample_adds() -> None:
    noise = from_residual(
        as_windows(ar1_series(0.8, 4000, np.random.default_rng(6))[None], 50.0).y, as_windows(np.zeros((1, 4000)), 50.0)
    )
    white = noise.innovations
    assert white.rho.tolist() == [0.0]
    assert white.floor[0] == pytest.approx(noise.floor[0] * np.sqrt(1.0 - noise.rho[0] ** 2))
