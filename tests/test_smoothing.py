"""Laws of smoothing, and of signals that are held between their updates."""

import numpy as np
import pytest
from made_up import RATE

from vehicle_sbi.data.smoothing import LEAST_DENOISED, SLOPE_S, denoised, slope, smoothed, unheld


def test_derivative_of_a_parabola_is_exact():
    t = np.arange(500) / RATE
    v_x = 10.0 + 0.3 * t - 0.7 * t**2 + 5.0
    np.testing.assert_allclose(smoothed(v_x, RATE, ""), v_x, atol=1e-10)
    np.testing.assert_allclose(slope(v_x, RATE, ""), 0.3 - 1.4 * t, atol=1e-8)


def test_the_slope_of_a_fourth_power_is_exact_where_the_filter_reaches_to_both_sides() -> None:
    # Of even order about the middle, a fourth power adds nothing to an odd derivative.
    t = np.arange(500) / RATE - 1.0
    inner = slice(round(SLOPE_S * RATE), -round(SLOPE_S * RATE))
    np.testing.assert_allclose(slope(t**4, RATE, "")[inner], (4.0 * t**3)[inner], atol=1e-8)


@pytest.mark.parametrize("hold", [2, 5])
def test_a_held_line_becomes_a_line_again(hold: int) -> None:
    line = np.arange(200.0)
    held = line[np.arange(200) // hold * hold]
    last = 199 // hold * hold
    np.testing.assert_allclose(unheld(held)[: last + 1], line[: last + 1])


def test_a_rest_between_moves_stays_a_rest() -> None:
    values = np.concatenate([np.repeat(np.arange(20.0), 3), np.full(30, 19.0), np.repeat(np.arange(20.0, 40.0), 3)])
    smooth = unheld(values)
    np.testing.assert_allclose(smooth[60:86], 19.0)


@pytest.mark.parametrize("step", [0.25, 0.5, 1.0, 2.0])
def test_a_rounded_signal_comes_neither_early_nor_late(step: float) -> None:
    # Taken for a held one, it would come half of the time early that it takes to pass a level, here 4 ms to 35 ms.
    rate, t = 100.0, np.arange(6000) / 100.0
    true = 15.0 * np.sin(2.0 * np.pi * 0.3 * t)
    clean, speed = denoised(unheld(step * np.round(true / step))), np.gradient(true) * rate
    inside = slice(200, -200)
    early = np.dot((clean - true)[inside], speed[inside]) / np.dot(speed[inside], speed[inside])
    assert abs(early) < 1e-3


def test_each_side_of_a_gap_is_differentiated_by_itself() -> None:
    t = np.arange(1000) / 100.0
    values = np.where(t < 5.0, t**2, 40.0 - t**2)
    values[480:520] = np.nan
    found, true = slope(values, 100.0, "x"), np.where(t < 5.0, 2.0 * t, -2.0 * t)
    known = np.isfinite(values)
    np.testing.assert_allclose(found[known], true[known], atol=1e-9)


def test_a_signal_that_is_not_held_stays_as_it_is() -> None:
    wave = np.sin(np.arange(200) / 7.0)
    np.testing.assert_array_equal(unheld(wave), wave)


def slalom(n: int = 3000) -> np.ndarray:
    """Steering [rad] of a slalom that becomes quicker, from 0.2 to 1 Hz."""
    t = np.arange(n) / RATE
    return 0.03 * np.sin(2.0 * np.pi * (0.2 + 0.4 * t / t[-1]) * t)


def test_steering_without_noise_stays_as_it_is() -> None:
    # The least penalty, 1e-3, takes 1e-3 (2 pi f / rate)^4 = 2e-8 of a wave of 1 Hz. Ends are mirrored, which is a kink
    # of the slope there: it takes 1e-3 of a slope of 2 pi f / rate = 0.06 a sample, 6e-5.
    np.testing.assert_allclose(denoised(slalom()), slalom(), atol=1e-4 * 0.03)
    np.testing.assert_allclose(denoised(slalom())[50:-50], slalom()[50:-50], atol=1e-6 * 0.03)


def test_of_white_noise_little_is_left_where_the_signal_is_slow() -> None:
    rng = np.random.default_rng(0)
    noise = 2e-4 * rng.standard_normal(3000)
    left = denoised(slalom() + noise) - slalom()
    # A penalty of second order at 1 Hz keeps waves up to some 5 Hz: a tenth of the noise's variance at 100 Hz.
    assert np.std(left) < np.sqrt(0.1) * np.std(noise) * 1.5
    assert abs(np.corrcoef(left, np.gradient(slalom()))[0, 1]) < 0.1  # and it does not come late


def test_denoising_is_affine_and_blind_to_the_direction_of_time() -> None:
    noisy = slalom() + 2e-4 * np.random.default_rng(1).standard_normal(3000)
    smooth = denoised(noisy)
    np.testing.assert_allclose(denoised(0.1 - 3.0 * noisy), 0.1 - 3.0 * smooth, atol=1e-6)
    np.testing.assert_allclose(denoised(noisy[::-1])[::-1], smooth, atol=1e-6)


def test_absent_samples_remain_absent_and_a_few_tell_no_noise() -> None:
    noisy = slalom() + 2e-4 * np.random.default_rng(2).standard_normal(3000)
    noisy[100:140] = np.nan
    np.testing.assert_array_equal(np.isnan(denoised(noisy)), np.isnan(noisy))
    few = noisy[: LEAST_DENOISED - 1]
    np.testing.assert_array_equal(denoised(few), few)
