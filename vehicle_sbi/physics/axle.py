"""Both tyres of an axle that is one wheel to its model: forces of two wheels under loads that a turn makes uneven.

    F = F_tyre(C/2, F_z (1 + s)/2, k (1 - d), alpha_R) + F_tyre(C/2, F_z (1 - s)/2, k (1 + d), alpha_L)
    s = sqrt(uneven) a_y F_z,static / F_z,         M_z = track/2 (F_x,R - F_x,L)
    k = (kappa - (nu + rho) rho) / (1 - (nu + rho) d),   nu = r track / (2 v_x),   rho = s F_z / (6 C_vert R_f)

in a turn to the left, the right wheel being the outer one. What the turn moves follows from the car's lateral
acceleration and height, not from what an axle carries at the time. An open differential, or brakes of one pressure,
give both wheels the same torque, so d is where F_x,R (1 - rho) = F_x,L (1 + rho): the inner wheel slips more (Rajamani,
Vehicle Dynamics and Control, sec. 15.2). Wheels that stand apart move at v_x (1 +- nu), which makes their slip angles
differ, and roll on radii R (1 -+ rho). What an axle has of a wheel speed is the mean of both, so the mean
slip k is the axle's kappa but for products of what differs between them, to second order. Of slips that lag, the mean
of both wheels does.
"""

import math
from typing import NamedTuple

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.balance import HASTY, KEPT
from vehicle_sbi.physics.tyre_effects import side_force, tyre_force, uneven, wheels_differ

NEAR = 1e-4  # difference of both torques over their sum, from which a step of the search may be the last one
EQUAL = 1e-9  # the same, where the search has ended
SPLITS = 40  # steps of it at most
MOST = 0.98  # a wheel keeps a little of the slip


class Tyres(NamedTuple):
    """An axle, or one of its wheels, in a turn."""

    C_kappa: float  # stiffnesses [N, N/rad]
    C_alpha: float
    mu: float
    F_z: float  # load [N], and in units of the static one
    load: float
    moved: float  # lateral acceleration [m/s^2] that what has moved across stands for


class Slips(NamedTuple):
    """How both wheels of an axle slip: along them by their mean speed, the mean slip at which a share of theirs lags,
    tangents of their slip angles, how unequal."""

    kappa: float
    lagged: float
    share: float
    faster: float  # share nu by which the right wheel moves faster, the left one slower
    tan_right: float
    tan_left: float
    split: float
    slope: float  # of what both torques differ by, as a share of their sum, over the split; 0 where it is not known


class AxleForce(NamedTuple):
    """Forces [N] of an axle along and across its wheels, the right wheel's less the left one's, by how much their mean
    slip without lag is beyond kappa, and where to go on with the search for how unequal their slips are; `even` where
    it has ended."""

    F_x: float
    F_y: float
    more_x: float
    more_y: float
    beyond: float
    split: float
    slope: float
    even: bool


@compiled
def mixed(share: float, lagged: float, now: float) -> float:
    """A slip of which a share lags."""
    return share * lagged + (1.0 - share) * now


@compiled
def wheel(axle: Tyres, share: float) -> Tyres:
    """Half of an axle, under so many times half of its load."""
    C_kappa, C_alpha, F_z = 0.5 * axle.C_kappa, 0.5 * axle.C_alpha, 0.5 * axle.F_z
    return Tyres(C_kappa, C_alpha, axle.mu, share * F_z, share * axle.load, axle.moved)


@compiled
def slipping(p, tyres: Tyres, kappa: float, tan_alpha: float) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] at these slips; a wheel that turns backwards counts as locked."""
    C_kappa, C_alpha, mu, F_z, load, moved = tyres
    return tyre_force(p, C_kappa, C_alpha, mu, F_z, load, max(kappa, -1.0), tan_alpha, moved)


@compiled
def pulling(p, tyres: Tyres, F_x: float, tan_alpha: float) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] where the longitudinal one is given, as far as the grip goes."""
    return side_force(p, tyres.C_alpha, tyres.mu, tyres.F_z, tyres.load, F_x, tan_alpha, tyres.moved)


@compiled
def axle_force(p, axle: Tyres, slips: Slips, a_y: float) -> AxleForce:
    """Of an axle at a lateral acceleration a_y [m/s^2].

    The search for the split goes on from that of `slips`, by the secant method between bounds, at first with the slope
    known from before or as if forces were in proportion to slips. It ends at a bound where no slip of the inner wheel
    is enough: there it spins or locks. Close to the end it takes one step, whose forces the next call finds, as long as
    it is HASTY. Tyres that have passed their peaks may share a torque in several ways, between which the loop of loads
    may jump for ever: in the end the split is KEPT as it is.
    """
    if not wheels_differ(p):
        F_x, F_y = slipping(p, axle, mixed(slips.share, slips.lagged, slips.kappa), slips.tan_right)
        return AxleForce(F_x, F_y, 0.0, 0.0, 0.0, 0.0, 0.0, True)
    s = uneven(p, axle.load, a_y)
    right, left = wheel(axle, 1.0 + s), wheel(axle, 1.0 - s)
    rho = s * axle.F_z / (6.0 * p.C_vert * p.R_f)
    differ = slips.faster + rho
    kappa = mixed(slips.share, slips.lagged, slips.kappa - differ * rho)
    at_once, d, slope = (1.0 - slips.share) * differ, slips.split, (slips.slope if p.search == HASTY else 0.0)
    mean = x_r = y_r = x_l = y_l = led = more_led = 0.0
    low, high, even = -MOST, MOST, False
    for step in range(SPLITS + 1):
        mean = kappa / (1.0 - at_once * d)
        x_r, y_r = slipping(p, right, (1.0 - d) * mean, slips.tan_right)
        x_l, y_l = slipping(p, left, (1.0 + d) * mean, slips.tan_left)
        both, more = abs(x_r + x_l), ((1.0 - rho) * x_r - (1.0 + rho) * x_l) * math.copysign(1.0, kappa)
        even = abs(more) <= EQUAL * both or high - low < EQUAL or p.search == KEPT
        if even:
            break
        if more > 0.0:
            low = d
        else:
            high = d
        if step > 0:
            slope = (more - more_led) / ((d - led) * both)
        led, more_led = d, more
        following = d - more / both / (slope if slope != 0.0 else -1.0 / (1.0 - d * d))
        d = following if low < following < high else 0.5 * (low + high)
        if p.search == HASTY and slope != 0.0 and abs(more) <= NEAR * both:
            break
    return AxleForce(x_r + x_l, y_r + y_l, x_r - x_l, y_r - y_l, differ * (d * mean - rho), d, slope, even)


@compiled
def axle_side_force(p, axle: Tyres, F_x: float, slips: Slips, a_y: float) -> AxleForce:
    """Of an axle whose longitudinal force [N] is given and shared equally between its wheels."""
    if not wheels_differ(p):
        F_x, F_y = pulling(p, axle, F_x, slips.tan_right)
        return AxleForce(F_x, F_y, 0.0, 0.0, 0.0, 0.0, 0.0, True)
    s = uneven(p, axle.load, a_y)
    x_r, y_r = pulling(p, wheel(axle, 1.0 + s), 0.5 * F_x, slips.tan_right)
    x_l, y_l = pulling(p, wheel(axle, 1.0 - s), 0.5 * F_x, slips.tan_left)
    return AxleForce(x_r + x_l, y_r + y_l, x_r - x_l, y_r - y_l, 0.0, 0.0, 0.0, True)
