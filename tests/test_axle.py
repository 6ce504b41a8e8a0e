"""An axle whose wheels a turn loads unevenly: two of Dugoff's tyres, in closed form."""

import pytest
from test_single_effects import EPS, derived

from vehicle_sbi.physics.axle import axle_force, axle_side_force


def axle_side(q: float, z: float, a_y: float, **more: float) -> float:
    """Side force [N] of an axle of 6 kN and mu 1 at a demand of z grips, half of whose stiffness is each wheel's."""
    return axle_force(derived(lateral_load_transfer_uneven=q, **more), 1e5, 8e4, 1.0, 6e3, 1.0, 0.0, z * 0.075, a_y)[1]


def test_an_axle_of_uneven_wheels_is_two_of_dugoff_s_tyres() -> None:
    # Shares 1 + s and 1 - s of the load at s = 0.4, a demand of z grips: the inner wheel's knee is at z = 0.3, where
    # 1 - 1/(4 z) of its load begins; the outer one's at 0.7. Before the first the axle is one tyre, beyond both it has
    # lost s^2/(4 z) of the grip, to the rounding of a few products.
    s, a_y = 0.4, 5.0
    q = (s / a_y) ** 2
    for sign in (-1.0, 1.0):
        assert axle_side(q, 0.29, sign * a_y) == pytest.approx(0.29 * 6e3, rel=16 * EPS)
        middle = 0.5 * (0.5 + 0.6 * (1.0 - 0.25 * 0.6 / 0.5))
        assert axle_side(q, 0.5, sign * a_y) == pytest.approx(middle * 6e3, rel=16 * EPS)
        assert axle_side(q, 2.0, sign * a_y) == pytest.approx((1.0 - 0.125 * (1.0 + s * s)) * 6e3, rel=16 * EPS)


def test_a_lifted_wheel_carries_nothing() -> None:
    # sqrt(q) a_y >= 1: the outer wheel alone, of half the stiffness and all of the load.
    assert axle_side(0.01, 4.0, 12.0) == pytest.approx((1.0 - 0.125) * 6e3, rel=16 * EPS)


@pytest.mark.parametrize("F_x", [0.0, 2000.0])
def test_a_given_pull_is_shared_between_both_wheels(F_x: float) -> None:
    # Each wheel has its half, so an axle of even wheels is one of two; uneven ones give no more.
    p, even = derived(lateral_load_transfer_uneven=0.01), derived()
    whole = axle_side_force(even, 8e4, 1.0, 6e3, 1.0, F_x, 0.06, 4.0)
    assert axle_side_force(p, 8e4, 1.0, 6e3, 1.0, F_x, 0.06, 1e-9) == pytest.approx(whole, rel=1e-9)
    along, side = axle_side_force(p, 8e4, 1.0, 6e3, 1.0, F_x, 0.06, 4.0)
    assert along == F_x
    assert side < whole[1]
