"""Both tyres of an axle that is one wheel to its model: forces of two wheels under loads that a turn makes uneven.

    F = F_tyre(C/2, F_z (1 + s)/2, kappa (1 - d)) + F_tyre(C/2, F_z (1 - s)/2, kappa (1 + d))
    s = sqrt(uneven) |a_y| F_z,static / F_z

What the turn moves follows from the car's lateral acceleration and height, not from what an axle carries at the time.
An open differential, or brakes of one pressure, give both wheels the same torque, so d is where both have the same
longitudinal force: the inner wheel slips more (Rajamani, Vehicle Dynamics and Control, sec. 15.2). Their mean slip is
the axle's, their slip angle the same. Without transfer the axle is one tyre of twice the size.
"""

import math

from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import side_force, tyre_force, uneven

EQUAL = 1e-9  # difference of both longitudinal forces over their sum, where the search for d ends
SPLITS = 40  # steps of it at most
MOST = 0.98  # a wheel keeps a little of the slip


@compiled
def axle_force(
    p,
    C_kappa: float,
    C_alpha: float,
    mu: float,
    F_z: float,
    load: float,
    kappa: float,
    tan_alpha: float,
    steady: float,
    a_y: float,
    d: float,
) -> tuple[float, float, float]:
    """Forces (F_x, F_y) [N] of an axle under F_z [N], `load` times its static one, at a_y [m/s^2], of a `steady` turn,
    and how unequal its wheels' slips are; `d` is about that.

    It is found by the secant method between bounds, at first as if forces were in proportion to slips. It is at a bound
    where no slip of the inner wheel is enough: there it spins or locks.
    """
    s = uneven(p, load, a_y)
    if s == 0.0:
        F_x, F_y = tyre_force(p, C_kappa, C_alpha, mu, F_z, load, kappa, tan_alpha, steady)
        return F_x, F_y, 0.0
    C_kappa, C_alpha, F_z = 0.5 * C_kappa, 0.5 * C_alpha, 0.5 * F_z
    x_o = y_o = x_i = y_i = led = more_led = 0.0
    low, high = -MOST, MOST
    for step in range(SPLITS + 1):
        slip_o, slip_i = max((1.0 - d) * kappa, -1.0), max((1.0 + d) * kappa, -1.0)
        x_o, y_o = tyre_force(p, C_kappa, C_alpha, mu, (1.0 + s) * F_z, (1.0 + s) * load, slip_o, tan_alpha, steady)
        x_i, y_i = tyre_force(p, C_kappa, C_alpha, mu, (1.0 - s) * F_z, (1.0 - s) * load, slip_i, tan_alpha, steady)
        both, more = abs(x_o + x_i), (x_o - x_i) * math.copysign(1.0, kappa)
        if abs(more) <= EQUAL * both or high - low < EQUAL:
            break
        if more > 0.0:
            low = d
        else:
            high = d
        following = d + (more * (d - led) / (more_led - more) if step > 0 else (1.0 - d * d) * more / both)
        led, more_led = d, more
        d = following if low < following < high else 0.5 * (low + high)
    return x_o + x_i, y_o + y_i, d


@compiled
def axle_side_force(
    p, C_alpha: float, mu: float, F_z: float, load: float, F_x: float, tan_alpha: float, steady: float, a_y: float
) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] of an axle whose longitudinal force is given, as far as the grip of each wheel goes."""
    s = uneven(p, load, a_y)
    if s == 0.0:
        return side_force(p, C_alpha, mu, F_z, load, F_x, tan_alpha, steady)
    C_alpha, F_z, F_x = 0.5 * C_alpha, 0.5 * F_z, 0.5 * F_x
    x_o, y_o = side_force(p, C_alpha, mu, (1.0 + s) * F_z, (1.0 + s) * load, F_x, tan_alpha, steady)
    x_i, y_i = side_force(p, C_alpha, mu, (1.0 - s) * F_z, (1.0 - s) * load, F_x, tan_alpha, steady)
    return x_o + x_i, y_o + y_i
