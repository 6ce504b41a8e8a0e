"""An axle whose wheels a turn loads unevenly: two of Dugoff's tyres, in closed form, with the same torque at both."""

import numpy as np
import pytest
from reference_single_track import mean_slip, root
from test_single_effects import EPS, derived

from vehicle_sbi.physics.axle import EQUAL, MOST, Slips, Tyres, axle_force, axle_side_force
from vehicle_sbi.physics.balance import WHOLE
from vehicle_sbi.physics.tyre_effects import tyre_force

F_Z, C = 6e3, 8e4  # load [N] and stiffness [N, N/rad] of the axle, at a friction coefficient of 1


def axle(q: float, kappa: float, tan_alpha: float, a_y: float, *, load: float = 1.0, **more: float):
    """Forces (F_x, F_y) [N] of the axle under `load` times its static one."""
    p = derived(lateral_load_transfer_uneven=q, search=WHOLE, **more)
    slips = Slips(kappa, 0.0, 0.0, 0.0, tan_alpha, tan_alpha, 0.0, 0.0)
    found = axle_force(p, Tyres(C, C, 1.0, load * F_Z, load, a_y), slips, a_y)
    assert found.even
    return found.F_x, found.F_y


def wheels(s: float, kappa: float, tan_alpha: float, d: float, **more: float) -> np.ndarray:
    """Forces of the outer and the inner wheel, of slips kappa (1 - d) and kappa (1 + d)."""
    p, half = derived(**more), 0.5 * C
    shares = ((1.0 + s, 1.0 - d), (1.0 - s, 1.0 + d))  # of the load and of the slip
    return np.array(
        [tyre_force(p, half, half, 1.0, 0.5 * of * F_Z, of, part * kappa, tan_alpha, 0.0) for of, part in shares]
    )


def test_an_axle_of_uneven_wheels_is_two_of_dugoff_s_tyres() -> None:
    # Shares 1 + s and 1 - s of the load at s = 0.4, a demand of z grips: the inner wheel's knee is at z = 0.3, where
    # 1 - 1/(4 z) of its load begins; the outer one's at 0.7. Before the first the axle is one tyre, beyond both it has
    # lost s^2/(4 z) of the grip, to the rounding of a few products.
    s, a_y = 0.4, 5.0
    q, middle = (s / a_y) ** 2, 0.5 * (0.5 + 0.6 * (1.0 - 0.25 * 0.6 / 0.5))
    for sign in (-1.0, 1.0):
        for z, grips in ((0.29, 0.29), (0.5, middle), (2.0, 1.0 - 0.125 * (1.0 + s * s))):
            assert axle(q, 0.0, z * F_Z / C, sign * a_y)[1] == pytest.approx(grips * F_Z, rel=16 * EPS)


def test_a_lifted_wheel_carries_nothing() -> None:
    # sqrt(q) a_y >= 1: the outer wheel alone, of half the stiffness and all of the load.
    assert axle(0.01, 0.0, 4.0 * F_Z / C, 12.0)[1] == pytest.approx((1.0 - 0.125) * F_Z, rel=16 * EPS)


def test_a_turn_moves_a_share_of_the_static_load() -> None:
    # Half as much on the axle, as under braking or on a crest: twice the share. Both far beyond the knee.
    s, load, z = 0.2, 0.5, 4.0
    expected = load * F_Z * (1.0 - 0.25 * load / z * (1.0 + (s / load) ** 2))
    assert axle((s / 5.0) ** 2, 0.0, z * F_Z / C, 5.0, load=load)[1] == pytest.approx(expected, rel=16 * EPS)


@pytest.mark.parametrize("curve", [{}, {"tyre_curve_peak": 0.3, "tyre_curve_fullness": 0.7, "tyre_curve_early": 0.4}])
@pytest.mark.parametrize("kappa", [-0.05, -0.005, 0.01, 0.04])
@pytest.mark.parametrize("tan_alpha", [0.02, -0.06, 0.1])
def test_both_wheels_have_the_same_force_along_them(curve: dict[str, float], kappa: float, tan_alpha: float) -> None:
    # Their forces differ by EQUAL of the sum at most; across the wheels a slip changes about as much as along them.
    s, a_y = 0.5, 5.0
    found = axle((s / a_y) ** 2, kappa, tan_alpha, a_y, **curve)

    def apart(d: float) -> float:
        outer, inner = wheels(s, kappa, tan_alpha, d, **curve)
        return outer[0] - inner[0]

    expected = wheels(s, kappa, tan_alpha, root(apart, -MOST, MOST), **curve).sum(axis=0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=10.0 * EQUAL * F_Z)


@pytest.mark.parametrize("shrink", [1.0, 0.1])
def test_the_mean_of_both_wheel_speeds_is_the_axle_s(shrink: float) -> None:
    # omega_i = (1 + kappa_i) V_i / R_i of wheels that slip by k (1 -+ d), V (1 +- nu), R (1 -+ rho). The formula leaves
    # out products of three of nu, rho and k, each 0.03 at most: there are fewer than 10 of them.
    k, d, nu, rho = 0.03 * shrink, 0.6, 0.03 * shrink, -0.01 * shrink
    speeds = ((1.0 + k * (1.0 - d)) * (1.0 + nu) / (1.0 - rho), (1.0 + k * (1.0 + d)) * (1.0 - nu) / (1.0 + rho))
    assert mean_slip(sum(speeds) / 2.0 - 1.0, nu, rho, d) == pytest.approx(k, abs=10.0 * (0.03 * shrink) ** 3)
    assert abs(sum(speeds) / 2.0 - 1.0 - k) > (0.01 * shrink) ** 2


def test_even_wheels_slip_alike() -> None:
    # A difference of loads that vanishes leaves one tyre of twice the size.
    np.testing.assert_allclose(axle(1e-20, 0.03, 0.05, 5.0), axle(0.0, 0.03, 0.05, 5.0), rtol=1e-8)


@pytest.mark.parametrize("kappa", [-1.0, -0.7, 0.5, 0.95])
def test_wheels_that_lock_or_spin_have_no_more_than_the_grip(kappa: float) -> None:
    F_x, F_y = axle(0.01, kappa, 0.1, 6.0)
    assert np.sign(F_x) == np.sign(kappa)
    assert np.hypot(F_x, F_y) <= F_Z * (1.0 + 4 * EPS)


@pytest.mark.parametrize("F_x", [0.0, 2000.0])
def test_a_given_pull_is_shared_between_both_wheels(F_x: float) -> None:
    # Each wheel has its half, so an axle of even wheels is one of two; uneven ones give no more.
    p, even = derived(lateral_load_transfer_uneven=0.01), derived()
    slips = Slips(0.0, 0.0, 0.0, 0.0, 0.06, 0.06, 0.0, 0.0)
    tyres = Tyres(C, C, 1.0, F_Z, 1.0, 4.0)
    whole = axle_side_force(even, tyres, F_x, slips, 4.0)
    level = axle_side_force(p, tyres, F_x, slips, 1e-9)
    assert level[:2] == pytest.approx(whole[:2], rel=1e-9)
    along, side, *_ = axle_side_force(p, tyres, F_x, slips, 4.0)
    assert along == F_x
    assert side < whole[1]
