"""Dugoff's tyre: one shape for both directions, capped by the friction circle.

    F_x = C_kappa kappa / (1 + kappa) f(lambda),   F_y = C_alpha tan(alpha) / (1 + kappa) f(lambda)
    lambda = mu F_z (1 + kappa) / (2 S),           S = sqrt((C_kappa kappa)^2 + (C_alpha tan alpha)^2)
    f(lambda) = lambda (2 - lambda) below 1, else 1

(the paper's equations 8 to 10; Rajamani, Vehicle Dynamics and Control, sec. 13.10). Forces and stiffnesses are those
of an axle, both tyres together.
"""

import math

from vehicle_sbi.compiled import compiled

NEWTON_STEPS, NEWTON_TOLERANCE = 30, 1e-13  # of the share of grip over demand


@compiled
def dugoff(
    C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, tan_alpha: float
) -> tuple[float, float]:
    """Axle forces (F_x, F_y) [N] at longitudinal slip `kappa` in [-1, 1) and tangent of the slip angle.

    No slip or no stiffness is no force.
    """
    demand_x, demand_y = C_kappa * kappa, C_alpha * tan_alpha
    demand = math.sqrt(demand_x * demand_x + demand_y * demand_y)
    if demand == 0.0:
        return 0.0, 0.0
    share = dugoff_share(demand, mu * max(F_z, 0.0), kappa)
    return share * demand_x, share * demand_y


@compiled
def dugoff_share(demand: float, grip: float, kappa: float) -> float:
    """Forces over their demands C_kappa kappa and C_alpha tan(alpha) [N], of size `demand`, at slip `kappa`, -1 to 1.

    Below the knee the common factor f/(1 + kappa) is 1/(1 + kappa); beyond it the (1 + kappa) cancels, which gives a
    locked wheel (kappa = -1) its finite limit, the friction circle.
    """
    if grip * (1.0 + kappa) >= 2.0 * demand:
        return 1.0 / (1.0 + kappa)
    return 0.5 * grip / demand * (2.0 - 0.5 * grip * (1.0 + kappa) / demand)


@compiled
def dugoff_side(F_x: float, demand_y: float, grip: float) -> tuple[float, float]:
    """Side force F_y [N] beside a given longitudinal one, and the combined demand S [N], of the same law.

    With (1 + kappa) taken as 1 the force lies along the demand (X, D), of size S below S = G/2 and G - G^2/(4 S) beyond
    it. So F_y = D where F_x^2 + D^2 <= (G/2)^2, else q = G/(2 S) solves (1 - q/2)^2 (1 - d^2 q^2) = (F_x/G)^2 with
    d = 2 D/G, by Newton's method between bounds; |F_x| has to be less than the grip G.
    """
    demand = math.sqrt(F_x * F_x + demand_y * demand_y)
    if demand_y == 0.0 or 2.0 * demand <= grip:
        return demand_y, demand
    if grip <= 0.0:
        return 0.0, demand
    d, share = 2.0 * abs(demand_y) / grip, (F_x / grip) ** 2
    low, high = 0.0, min(1.0, 1.0 / d)
    q = high
    for _ in range(NEWTON_STEPS):
        rest, left = 1.0 - 0.5 * q, 1.0 - d * d * q * q
        off = rest * rest * left - share
        if off > 0.0:
            low = q
        else:
            high = q
        slope = -rest * left - 2.0 * rest * rest * d * d * q
        step = q - off / slope
        if abs(step - q) <= NEWTON_TOLERANCE * q:
            break
        q = step if low < step < high else 0.5 * (low + high)
    return math.copysign((1.0 - 0.5 * q) * d * q * grip, demand_y), 0.5 * grip / q


@compiled
def grips(mu: float, F_z: float, F_x: float, F_y: float) -> bool:
    """Whether Dugoff's forces [N] are short of the knee (lambda = 1) under a load F_z [N], so that no larger load would
    change them.

    There the force is S / (1 + kappa), and lambda > 1 says that it is below mu F_z / 2.
    """
    half = 0.5 * mu * max(F_z, 0.0)
    return F_x * F_x + F_y * F_y < half * half


@compiled
def effective_radius(R_f: float, C_vert: float, F_z: float) -> float:
    """Effective rolling radius [m] of an axle's tyres, 2/3 R_f + 1/3 R_l with R_l = R_f - F_z,tyre / C_vert.

    F_z is the axle's load, half of it on each tyre (the paper's equation 6, with the deflection it prints as a radius
    subtracted from R_f; Jazar, Vehicle Dynamics, sec. 3.1).
    """
    return R_f - 0.5 * F_z / (3.0 * C_vert)
