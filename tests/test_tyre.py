"""Laws of Dugoff's tyre: its slopes, its knee, its circle, and finite answers to every finite question."""

import math
from itertools import product

import numpy as np
import pytest
from cars import RIGID, record_of
from hypothesis import given
from hypothesis import strategies as st
from reference_single_track import dugoff as printed_dugoff

from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.tyre import dugoff, effective_radius, grips

EPS = np.finfo(float).eps
C_KAPPA, C_ALPHA, MU = 131963.0, 100e3, 1.0489  # front axle of the car of the closed forms
G = 9.81
LOAD = 1093.3 * G * 1.4227 / 2.5789

stiffness = st.floats(1e3, 1e6)
friction = st.floats(0.01, 2.0)
load = st.floats(-1e6, 1e6)
slip = st.floats(-1.0, 1.0)
tangent = st.floats(-1e6, 1e6)


def test_slope_at_origin_is_stiffness() -> None:
    # Central difference of C k/(1+k) is C/(1-k^2); of C t it is C. k = 1e-6 leaves k^2 and 4 eps/k of rounding.
    step = 1e-6
    along = [dugoff(C_KAPPA, C_ALPHA, MU, LOAD, k, 0.0)[0] for k in (step, -step)]
    across = [dugoff(C_KAPPA, C_ALPHA, MU, LOAD, 0.0, t)[1] for t in (step, -step)]
    tolerance = step**2 + 4 * EPS / step
    assert (along[0] - along[1]) / (2 * step) == pytest.approx(131963.0, rel=tolerance)
    assert (across[0] - across[1]) / (2 * step) == pytest.approx(100000.0, rel=tolerance)


def test_lateral_knee_is_at_half_the_friction_force() -> None:
    # tan alpha* and F to half a unit of their last printed digit.
    knee = MU * LOAD / (2.0 * C_ALPHA)
    assert knee == pytest.approx(0.031031, abs=5e-7)
    _, F = dugoff(C_KAPPA, C_ALPHA, MU, LOAD, 0.0, knee)
    assert pytest.approx(MU * LOAD / 2.0, rel=8 * EPS) == F
    assert pytest.approx(3103.07, abs=5e-3) == F
    # Linear up to the knee, below the line beyond it, and smooth through it: f(lambda) has slope zero at lambda = 1.
    for share in (0.25, 0.5, 0.999):
        t = share * knee
        assert dugoff(C_KAPPA, C_ALPHA, MU, LOAD, 0.0, t)[1] == pytest.approx(C_ALPHA * t, rel=4 * EPS)
    beyond = 1.001 * knee
    lost = 1.0 - dugoff(C_KAPPA, C_ALPHA, MU, LOAD, 0.0, beyond)[1] / (C_ALPHA * beyond)
    assert 0.0 < lost < 1.1 * (1.0 - 1.0 / 1.001) ** 2  # 1 - f = (1 - lambda)^2


@pytest.mark.parametrize(("times", "share"), [(2, 0.75), (4, 0.875), (10, 0.95)])
def test_beyond_the_knee_the_force_nears_friction(times: float, share: float) -> None:
    # k times the knee's slip: F/(mu F_z) = 1 - 1/(2k), to rounding.
    slip_tangent = times * MU * LOAD / (2.0 * C_ALPHA)
    assert dugoff(C_KAPPA, C_ALPHA, MU, LOAD, 0.0, slip_tangent)[1] / (MU * LOAD) == pytest.approx(share, rel=8 * EPS)


@pytest.mark.parametrize(("kappa", "share"), [(-0.5, 0.988243), (-0.9, 0.998694), (-1.0, 1.0)])
def test_braking_limit(kappa: float, share: float) -> None:
    # 1 - mu F_z (1+kappa)/(4 C |kappa|); the printed value to half its last digit.
    F, _ = dugoff(C_KAPPA, C_ALPHA, MU, LOAD, kappa, 0.0)
    closed = 1.0 - MU * LOAD * (1.0 + kappa) / (4.0 * C_KAPPA * abs(kappa))
    used = -F / (MU * LOAD)
    assert used == pytest.approx(closed, rel=8 * EPS)
    assert used == pytest.approx(share, abs=5e-7)


@given(stiffness, stiffness, friction, load, slip, tangent)
def test_force_stays_inside_the_friction_circle(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, t: float
) -> None:
    # Below the knee S/(1+kappa) <= mu F_z/2; beyond it 1 - lambda/2 < 1. Six roundings on the way.
    F = dugoff(C_kappa, C_alpha, mu, F_z, kappa, t)
    assert math.hypot(*F) <= mu * max(F_z, 0.0) * (1.0 + 8 * EPS)


@given(stiffness, stiffness, friction, st.floats(1.0, 1e6), tangent)
def test_locked_wheel_is_on_the_friction_circle(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, t: float
) -> None:
    # At kappa = -1 lambda = 0: the whole of friction, along the demand (-C_kappa, C_alpha t).
    F_x, F_y = dugoff(C_kappa, C_alpha, mu, F_z, -1.0, t)
    assert math.hypot(F_x, F_y) == pytest.approx(mu * F_z, rel=8 * EPS)
    demand = math.hypot(C_kappa, C_alpha * t)
    assert F_x == pytest.approx(-mu * F_z * C_kappa / demand, rel=8 * EPS)
    assert F_y == pytest.approx(mu * F_z * C_alpha * t / demand, rel=8 * EPS, abs=1e-300)


def test_force_is_continuous_up_to_the_locked_wheel() -> None:
    # |dF/dkappa| <= mu F_z * mu F_z/(4 C) (1/kappa^2 + ...) is below mu F_z here, so a step of 1e-9 moves F by less.
    near = dugoff(C_KAPPA, C_ALPHA, MU, LOAD, -1.0 + 1e-9, 0.1)
    locked = dugoff(C_KAPPA, C_ALPHA, MU, LOAD, -1.0, 0.1)
    assert np.abs(np.subtract(near, locked)).max() < 1e-9 * MU * LOAD


@given(stiffness, stiffness, friction, st.floats(-1e6, 0.0), slip, tangent)
def test_lifted_wheel_has_no_force(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, t: float
) -> None:
    assert dugoff(C_kappa, C_alpha, mu, F_z, kappa, t) == (0.0, 0.0)


# Stiffness and slip whose product squares within the range of a double, which leaves 150 decades either way.
anything = st.floats(-1e70, 1e70)


@given(st.floats(0.0, 1e70), st.floats(0.0, 1e70), st.floats(0.0, 1e70), anything, st.floats(-1.0, 1e70), anything)
def test_finite_question_finite_answer(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, t: float
) -> None:
    assert np.isfinite(dugoff(C_kappa, C_alpha, mu, F_z, kappa, t)).all()


EDGES = tuple(product((0.0, 1e5), (0.0, 6e4), (0.0, 0.9), (-1.0, 0.0, 5e3), (-1.0, 0.0), (0.0, 0.1)))


@pytest.mark.parametrize("question", EDGES)
def test_nothing_divides_by_zero(question: tuple[float, ...]) -> None:
    assert np.isfinite(dugoff(*question)).all()


@given(stiffness, stiffness, friction, st.floats(0.0, 1e5), st.floats(-0.999, 0.999), st.floats(-1.5, 1.5))
def test_rearranged_form_equals_the_printed_one(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, alpha: float
) -> None:
    # Both to rounding; 1 + kappa cancels down to 1e-3, and near the knee the branches differ by (1 - lambda)^2 only.
    ours = dugoff(C_kappa, C_alpha, mu, F_z, kappa, math.tan(alpha))
    printed = printed_dugoff(C_kappa, C_alpha, mu, F_z, kappa, alpha)
    assert ours == pytest.approx(printed, rel=1e3 * EPS, abs=1e3 * EPS)


@given(stiffness, stiffness, friction, load, slip, st.floats(-10.0, 10.0), st.floats(1.0, 10.0))
def test_more_load_changes_no_force_that_grips(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, t: float, more: float
) -> None:
    # Forces grip where lambda > 1, but for the rounding of both sides and loads whose squares vanish; then the numbers
    # are the same to rounding.
    F = dugoff(C_kappa, C_alpha, mu, F_z, kappa, t)
    demand = math.hypot(C_kappa * kappa, C_alpha * t)
    knee = mu * F_z * (1.0 + kappa) / (2.0 * demand) if demand > 0.0 else math.inf
    if F_z >= 1.0 and kappa > -1.0 and abs(knee - 1.0) > 16 * EPS:
        assert grips(mu, F_z, *F) == (knee > 1.0)
    if grips(mu, F_z, *F):
        assert dugoff(C_kappa, C_alpha, mu, more * F_z, kappa, t) == pytest.approx(F, rel=4 * EPS)
    assert not grips(mu, min(F_z, 0.0), 0.0, 0.0)  # a wheel in the air has no force, and would have with a load


@given(stiffness, stiffness, friction, load, slip, tangent)
def test_mirrored_slip_angle_mirrors_the_side_force(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, t: float
) -> None:
    F_x, F_y = dugoff(C_kappa, C_alpha, mu, F_z, kappa, t)
    assert dugoff(C_kappa, C_alpha, mu, F_z, kappa, -t) == (F_x, -F_y)


def test_effective_radius_is_two_thirds_free_and_one_third_loaded() -> None:
    # Equation 6 with half the axle's load on each tyre; a rigid tyre keeps its free radius exactly.
    F_z, R_f, C_vert = 7000.0, 0.31, 2e5
    loaded = R_f - 3500.0 / C_vert
    assert effective_radius(R_f, C_vert, F_z) == pytest.approx(2 / 3 * R_f + 1 / 3 * loaded, rel=4 * EPS)
    assert effective_radius(R_f, math.inf, F_z) == R_f


def test_load_of_the_closed_forms_is_the_car_s() -> None:
    p = record_of(RIGID)[0]
    derive(p)
    assert p["F_zf_static"] == pytest.approx(LOAD, rel=8 * EPS)
    assert p["F_zf_static"] + p["F_zr_static"] == pytest.approx(1093.3 * G, rel=4 * EPS)
