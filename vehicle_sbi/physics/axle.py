"""Both tyres of an axle that is one wheel to its model: forces of two wheels under loads that a turn makes uneven.

    F = F_tyre(C/2, F_z (1 + s)/2) + F_tyre(C/2, F_z (1 - s)/2),   s = sqrt(uneven) |a_y|

Both have the same slips. Of a longitudinal force that is given each wheel has a half, as behind an open differential
(Rajamani, Vehicle Dynamics and Control, sec. 15.2). Without transfer the axle is one tyre of twice the size.
"""

from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import side_force, tyre_force, uneven


@compiled
def axle_force(
    p, C_kappa: float, C_alpha: float, mu: float, F_z: float, load: float, kappa: float, tan_alpha: float, a_y: float
) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] of an axle under F_z [N], `load` times its static one, at a steady a_y [m/s^2]."""
    s = uneven(p, a_y)
    if s == 0.0:
        return tyre_force(p, C_kappa, C_alpha, mu, F_z, load, kappa, tan_alpha, a_y)
    C_kappa, C_alpha, F_z = 0.5 * C_kappa, 0.5 * C_alpha, 0.5 * F_z
    x_o, y_o = tyre_force(p, C_kappa, C_alpha, mu, (1.0 + s) * F_z, (1.0 + s) * load, kappa, tan_alpha, a_y)
    x_i, y_i = tyre_force(p, C_kappa, C_alpha, mu, (1.0 - s) * F_z, (1.0 - s) * load, kappa, tan_alpha, a_y)
    return x_o + x_i, y_o + y_i


@compiled
def axle_side_force(
    p, C_alpha: float, mu: float, F_z: float, load: float, F_x: float, tan_alpha: float, a_y: float
) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] of an axle whose longitudinal force is given, as far as the grip of each wheel goes."""
    s = uneven(p, a_y)
    if s == 0.0:
        return side_force(p, C_alpha, mu, F_z, load, F_x, tan_alpha, a_y)
    C_alpha, F_z, F_x = 0.5 * C_alpha, 0.5 * F_z, 0.5 * F_x
    x_o, y_o = side_force(p, C_alpha, mu, (1.0 + s) * F_z, (1.0 + s) * load, F_x, tan_alpha, a_y)
    x_i, y_i = side_force(p, C_alpha, mu, (1.0 - s) * F_z, (1.0 - s) * load, F_x, tan_alpha, a_y)
    return x_o + x_i, y_o + y_i
