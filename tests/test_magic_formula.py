"""The tyre curve's magic formulas, and the cubics that stand for them."""

import itertools

import numpy as np
import pytest
from numpy.polynomial import Chebyshev
from scipy.optimize import lsq_linear

from vehicle_sbi.physics.magic_formula import FULL, INTERVALS, PEAKED, REACH, bent_early, magic_formula, peaked_and_full

PIECES, DEGREE = 8, 20  # of the polynomials that give fourth derivatives


def steepest_bend(shape: tuple[float, float]) -> float:
    """max |M''''| up to REACH."""
    edges, bends = np.linspace(0.0, REACH, PIECES + 1), []
    for low, high in itertools.pairwise(edges):
        piece = Chebyshev.interpolate(np.vectorize(lambda z: magic_formula(z, *shape)), DEGREE, [low, high])
        bends.append(np.abs(piece.deriv(4)(np.linspace(low, high, 200))).max())
    return max(bends)


@pytest.mark.parametrize("shape", [PEAKED, FULL])
def test_cubics_are_as_near_as_fourth_derivatives_allow(shape: tuple[float, float]) -> None:
    # A cubic with the values and slopes at both ends of an interval h is off by at most h^4/384 max |M''''|.
    allowed = (REACH / INTERVALS) ** 4 / 384.0 * steepest_bend(shape)
    z, column = np.linspace(0.0, REACH, 7 * INTERVALS), (PEAKED, FULL).index(shape)
    off = [peaked_and_full(x)[column] - magic_formula(x, *shape) for x in z]
    assert 0.9 * allowed < np.abs(off).max() < 1.01 * allowed < 1e-11


@pytest.mark.parametrize("z", [np.nextafter(REACH, 0.0), REACH, 2.0 * REACH, 1e9, np.inf])
def test_beyond_the_knots_it_is_the_formula(z: float) -> None:
    # Joined within the rounding of a few products; it ends at the formula's limit, sin(C pi/2).
    expected = [magic_formula(z, *shape) for shape in (PEAKED, FULL)]
    np.testing.assert_allclose(peaked_and_full(z), expected, rtol=1e-14)


def test_what_is_not_a_number_stays_that() -> None:
    assert np.isnan(peaked_and_full(np.nan)).all()


def curve(z: np.ndarray, C: float, E: float) -> np.ndarray:
    return np.array([magic_formula(x, C, E) for x in z])


def left_by_blends(z: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """What the nearest blend of the tool's curves leaves of a curve."""
    dugoff = np.where(z < 0.5, z, 1.0 - 0.25 / np.maximum(z, 0.5))
    blends = np.array([(*peaked_and_full(x), bent_early(x)) for x in z]) - dugoff[:, None]
    return lsq_linear(blends, wanted - dugoff, (0.0, 1.0)).fun


@pytest.mark.parametrize("share", [0.7, 0.85, 1.0])
@pytest.mark.parametrize("C", [1.2, 1.3, 1.4, 1.5])
def test_blends_come_near_the_curves_of_real_tyres(C: float, share: float) -> None:
    # C of side forces is about 1.3 (Pacejka, sec. 4.3), E between bending early and bending by no third power.
    z = np.linspace(0.0, 1.2, 100)
    assert np.abs(left_by_blends(z, curve(z, C, -share * (1.0 + 0.5 * C**2)))).max() < 0.0013


@pytest.mark.parametrize("E", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("C", [1.35, 1.5, 1.65])
def test_blends_come_near_tyres_that_bend_early(C: float, E: float) -> None:
    # Up to 0.9 of the grip. The tyre's stiffness is a parameter of its own, so the slope is free by two per cent.
    z = np.linspace(0.0, 8.0, 2001)
    z = np.linspace(0.0, z[np.argmax(curve(z, C, E) > 0.9)], 60)
    left = [left_by_blends(stiffer * z, curve(z, C, E)) for stiffer in np.linspace(0.98, 1.02, 9)]
    assert min(np.abs(residual).max() for residual in left) < 0.0025


def test_the_early_curve_is_the_formula_of_c_one_and_e_zero() -> None:
    z = np.array([1e-9, 0.1, 1.0, 30.0, 1e200])
    np.testing.assert_allclose([bent_early(x) for x in z], curve(z, 1.0, 0.0), rtol=1e-15)
