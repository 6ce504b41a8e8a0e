"""Both tyres of an axle that is one wheel to its model: forces of two wheels under loads that a turn makes uneven.

    F = F_tyre(C/2, F_z (1 + s)/2, k (1 - d), alpha_R) + F_tyre(C/2, F_z (1 - s)/2, k (1 + d), alpha_L)
    s = sqrt(uneven) a_y F_z,static / F_z,         M_z = track/2 (F_x,R - F_x,L)
    k = (kappa - (nu + rho) rho) / (1 - (nu + rho) d),   nu = r track / (2 v_x),   rho = s F_z / (6 C_vert R_f)

in a turn to the left, the right wheel being the outer one. What the turn moves follows from the car's lateral
acceleration and height, not from what an axle carries at the time. An open differential, or brakes of one pressure,
give both wheels the same torque, so d is where F_x,R (1 - rho) = F_x,L (1 + rho): the inner wheel slips more (Rajamani,
Vehicle Dynamics and Control, sec. 15.2). Wheels that stand apart move at v_x (1 +- nu), which makes their slip angles
differ, and roll on radii R (1 -+ rho). What an axle has of a wheel speed is the mean of both, so the mean
slip k is the axle's but for products of what differs between them, to second order.
"""

import math
from typing import NamedTuple

from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import side_force, tyre_force, uneven, wheels_differ

NEAR = 1e-4  # difference of both torques over their sum, from which a step of the search is the last one
EQUAL = 1e-9  # the same, where the search has ended
SPLITS = 40  # steps of it at most
MOST = 0.98  # a wheel keeps a little of the slip


class Slips(NamedTuple):
    """How both wheels of an axle slip: along them by their mean speed, tangents of their slip angles, how unequal."""

    kappa: float
    faster: float  # share nu by which the right wheel moves faster, the left one slower
    tan_right: float
    tan_left: float
    split: float
    slope: float  # of what both torques differ by, as a share of their sum, over the split; 0 where it is not known


class AxleForce(NamedTuple):
    """Forces [N] of an axle along and across its wheels, the right wheel's less the left one's, and where to go on with
    the search for how unequal their slips are; `even` where it has ended."""

    F_x: float
    F_y: float
    more_x: float
    more_y: float
    split: float
    slope: float
    even: bool


@compiled
def axle_force(
    p, C_kappa: float, C_alpha: float, mu: float, F_z: float, load: float, slips: Slips, steady: float, a_y: float
) -> AxleForce:
    """Of an axle under F_z [N], `load` times its static one, at a_y [m/s^2], of a `steady` turn.

    The search for the split goes on from that of `slips`, by the secant method between bounds, at first with the slope
    known from before or as if forces were in proportion to slips. It ends at a bound where no slip of the inner wheel
    is enough: there it spins or locks. Close to the end one more step is left to the next call.
    """
    kappa, d, slope = slips.kappa, slips.split, slips.slope
    if not wheels_differ(p):
        F_x, F_y = tyre_force(p, C_kappa, C_alpha, mu, F_z, load, kappa, slips.tan_right, steady)
        return AxleForce(F_x, F_y, 0.0, 0.0, 0.0, 0.0, True)
    s = uneven(p, load, a_y)
    rho = s * F_z / (6.0 * p.C_vert * p.R_f)
    differ = slips.faster + rho
    kappa -= differ * rho
    C_kappa, C_alpha, F_z = 0.5 * C_kappa, 0.5 * C_alpha, 0.5 * F_z
    F_zr, F_zl, load_r, load_l = (1.0 + s) * F_z, (1.0 - s) * F_z, (1.0 + s) * load, (1.0 - s) * load
    x_r = y_r = x_l = y_l = led = more_led = 0.0
    low, high, even = -MOST, MOST, False
    for step in range(SPLITS + 1):
        mean = kappa / (1.0 - differ * d)
        kappa_r, kappa_l = max((1.0 - d) * mean, -1.0), max((1.0 + d) * mean, -1.0)
        x_r, y_r = tyre_force(p, C_kappa, C_alpha, mu, F_zr, load_r, kappa_r, slips.tan_right, steady)
        x_l, y_l = tyre_force(p, C_kappa, C_alpha, mu, F_zl, load_l, kappa_l, slips.tan_left, steady)
        both, more = abs(x_r + x_l), ((1.0 - rho) * x_r - (1.0 + rho) * x_l) * math.copysign(1.0, kappa)
        even = abs(more) <= EQUAL * both or high - low < EQUAL
        if even:
            break
        if more > 0.0:
            low = d
        else:
            high = d
        if step > 0:
            slope = (more - more_led) / ((d - led) * both)
        led, more_led = d, more
        following = d - more / both / (slope if slope < 0.0 else -1.0 / (1.0 - d * d))
        d = following if low < following < high else 0.5 * (low + high)
        if slope < 0.0 and abs(more) <= NEAR * both:
            break
    return AxleForce(x_r + x_l, y_r + y_l, x_r - x_l, y_r - y_l, d, slope, even)


@compiled
def axle_side_force(
    p, C_alpha: float, mu: float, F_z: float, load: float, F_x: float, slips: Slips, steady: float, a_y: float
) -> AxleForce:
    """Of an axle whose longitudinal force [N] is given, as far as the grip of each wheel goes."""
    if not wheels_differ(p):
        F_x, F_y = side_force(p, C_alpha, mu, F_z, load, F_x, slips.tan_right, steady)
        return AxleForce(F_x, F_y, 0.0, 0.0, 0.0, 0.0, True)
    s = uneven(p, load, a_y)
    C_alpha, F_z, F_x = 0.5 * C_alpha, 0.5 * F_z, 0.5 * F_x
    x_r, y_r = side_force(p, C_alpha, mu, (1.0 + s) * F_z, (1.0 + s) * load, F_x, slips.tan_right, steady)
    x_l, y_l = side_force(p, C_alpha, mu, (1.0 - s) * F_z, (1.0 - s) * load, F_x, slips.tan_left, steady)
    return AxleForce(x_r + x_l, y_r + y_l, x_r - x_l, y_r - y_l, 0.0, 0.0, True)
