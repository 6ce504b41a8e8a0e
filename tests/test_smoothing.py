"""Laws of smoothing, and of signals that are held between their updates."""

import numpy as np
import pytest
from made_up import RATE

from vehicle_sbi.data.smoothing import smoothed, unheld


def test_derivative_of_a_parabola_is_exact():
    t = np.arange(500) / RATE
    v_x = 10.0 + 0.3 * t - 0.7 * t**2 + 5.0
    np.testing.assert_allclose(smoothed(v_x, RATE, ""), v_x, atol=1e-10)
    np.testing.assert_allclose(smoothed(v_x, RATE, "", derivative=1), 0.3 - 1.4 * t, atol=1e-8)


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


def test_a_signal_that_is_not_held_stays_as_it_is() -> None:
    wave = np.sin(np.arange(200) / 7.0)
    np.testing.assert_array_equal(unheld(wave), wave)
