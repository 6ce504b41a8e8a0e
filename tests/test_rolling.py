"""Laws of the step that takes wheels exactly."""

import math

import numpy as np
import pytest
from cars import PAPER, coasting, finished, record_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from vehicle_sbi.physics.rolling import BACK, FIRST, HALF, LAST, MIDDLE, fill_weights

ROUNDING = 1e-11  # of weights of size h: the series leaves 1e-12, matrices of size 1e3 as many units in the last place


def weights_of(A: np.ndarray, h: float) -> np.ndarray:
    """Weights (5, 2, 2)."""
    weights = np.full((5, 2, 2), np.nan)
    fill_weights(A, h, weights)
    return weights


def phi(Z: np.ndarray, most: int = 3) -> list[np.ndarray]:
    """phi_0 to phi_most of Z, as blocks of one larger exponential (Saad, SIAM J. Numer. Anal. 29, 1992)."""
    n = len(Z)
    larger = np.zeros((n * (most + 1), n * (most + 1)))
    larger[:n, :n] = Z
    for k in range(most):
        larger[n * k : n * (k + 1), n * (k + 1) : n * (k + 2)] = np.eye(n)
    return np.split(expm(larger)[:n], most + 1, axis=1)


@given(st.floats(0.0, 300.0), st.floats(0.0, 2.0), st.floats(0.0, 1.0))
def test_weights_are_those_of_cox_and_matthews(d: float, c: float, share: float) -> None:
    # In units in which a wheel's radius over its speed is 1, a step of 1 s.
    A = np.array([[-(1.0 - share) * d, -share * d], [c, -c]])
    exp_half, half = phi(0.5 * A)[:2]
    _, one, two, three = phi(A)
    expected = np.empty((5, 2, 2))
    expected[HALF] = 0.5 * half
    expected[BACK] = 0.5 * half @ (exp_half - np.eye(2))
    expected[FIRST] = one - 3.0 * two + 4.0 * three
    expected[MIDDLE] = 2.0 * two - 4.0 * three
    expected[LAST] = 4.0 * three - two
    assert weights_of(A, 1.0) == pytest.approx(expected, abs=ROUNDING)


def test_without_a_linear_part_a_step_is_the_classical_one() -> None:
    h = 0.02
    weights = weights_of(np.zeros((2, 2)), h)
    for which, weight in ((HALF, h / 2), (BACK, 0.0), (FIRST, h / 6), (MIDDLE, h / 3), (LAST, h / 6)):
        assert weights[which] == pytest.approx(weight * np.eye(2), abs=ROUNDING * h)


@pytest.mark.parametrize("size", [math.inf, math.nan, 1e300])
def test_weights_of_what_is_no_car_end(size: float) -> None:
    weights_of(np.array([[-size, 0.0], [0.0, 0.0]]), 0.01)


def test_a_braked_wheel_stands_while_the_car_slides() -> None:
    # A torque that no tyre holds: the wheel stops, and stays within what its brake's fading leaves (omega (2 - omega)
    # of the torque is what the road does), with one step a sample as with many.
    u, records = coasting(15.0, 1.0)[::2], record_of(PAPER, K=math.inf)
    u[:, 1] = -12000.0
    for steps in (1, 16):
        omega = finished(records, "torque", u, (15.0, 0.0, 0.0), rate=100.0, substeps=steps)[3]
        assert np.abs(omega[30:]).max() < 0.5
