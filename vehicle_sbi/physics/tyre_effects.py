"""Tyres and their loads, with the effects that enter there."""

import math

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.effects import SPRINGS_BEAR
from vehicle_sbi.physics.magic_formula import bent_early, peaked_and_full
from vehicle_sbi.physics.signals import SHORTEST, pulse
from vehicle_sbi.physics.tyre import dugoff, dugoff_share, dugoff_side

LEAST_LOAD = 1e-3  # of the static one, that loads are divided by
LEAST_STIFFNESS = 0.05  # share of a stiffness that no load and no acceleration takes away
LEAST_LAG = 0.5  # of the way that a wheel rolls in a step of the integrator, the least length that lags as it is
MOST_GRIP = 0.99  # share of the grip that a given longitudinal force takes, at most
LEAST_SWING = 4.0  # steps of the integrator, the least natural period that swings as it is


@compiled
def friction_level(p, mu: float) -> float:
    """Friction coefficient where the road's differs from the vehicle file's by a factor."""
    return p.friction_level_factor * mu


@compiled
def friction_step(p, mu: float, t: float) -> float:
    """Friction coefficient at time t [s], off by a factor from `start` on for `duration`."""
    return mu * (1.0 + (p.friction_step_factor - 1.0) * pulse(t, p.friction_step_start, p.friction_step_duration))


@compiled
def load_sensitivity(p, load: float) -> float:
    """Factor on the stiffnesses at a vertical load in units of the static one."""
    if p.load_sensitivity_coefficient == 0.0:
        return 1.0
    return max(1.0 + p.load_sensitivity_coefficient * (load - 1.0), LEAST_STIFFNESS)


@compiled
def lateral_load_transfer(p, a_y: float) -> float:
    """Factor on the cornering stiffness of an axle whose load has moved across as an acceleration [m/s^2] asks."""
    return max(1.0 - p.lateral_load_transfer_coefficient * a_y * a_y, LEAST_STIFFNESS)


@compiled
def lean_period(p) -> float:
    """Natural period [s] over 2 pi of the lean that moves load across, LEAST_SWING steps of the integrator at least."""
    return max(p.lateral_load_transfer_period, LEAST_SWING * p.step) / (2.0 * math.pi)


@compiled
def lean_damping(p) -> float:
    """Acceleration [m/s^2] that dampers stand for, per unit of the lean's rate [s]."""
    return 2.0 * p.lateral_load_transfer_damping * lean_period(p)


@compiled
def pitch_period(p) -> float:
    """The same of the pitch that moves load between the axles."""
    return max(p.load_sensitivity_period, LEAST_SWING * p.step) / (2.0 * math.pi)


@compiled
def pitch_damping(p) -> float:
    """The same as of the lean, of the pitch."""
    return 2.0 * p.load_sensitivity_damping * pitch_period(p)


@compiled
def pitches(p) -> bool:
    """Whether load moves between the axles as the body pitches."""
    return p.load_sensitivity_sprung != 0.0


@compiled
def lean_share(p) -> float:
    """Share of what a turn moves across that comes as the body leans, the rest coming at once.

    A shorter period than LEAST_SWING steps is that long, by the share that has the same second-order response,
    1 - (s T)^2.
    """
    if not leans(p):
        return 0.0
    shorter = min(p.lateral_load_transfer_period / (LEAST_SWING * p.step), 1.0)
    return SPRINGS_BEAR * shorter * shorter


@compiled
def uneven(p, load: float, a_y: float) -> float:
    """By which share the load of an axle's right wheel is above, and that of its left one below, the mean of both,
    which is `load` times the static one."""
    return min(max(math.sqrt(p.lateral_load_transfer_uneven) * a_y / max(load, LEAST_LOAD), -1.0), 1.0)


@compiled
def tyre_curve(p, z: float, share: float) -> tuple[float, float]:
    """Forces (x, y) over demands at demand over grip z, where Dugoff's are `share` of them: blends towards magic
    formulas, one of which peaks, one bends late and one early (Pacejka, sec. 4.3)."""
    if z == 0.0:
        return share, share
    peaked, full = peaked_and_full(z)
    peaked, full, early = peaked / z - share, full / z - share, bent_early(z) / z - share
    both = share + p.tyre_curve_fullness * full + p.tyre_curve_early * early
    return both + p.tyre_curve_longitudinal * peaked, both + p.tyre_curve_peak * peaked


@compiled
def curved(p) -> bool:
    """Whether the tyre curve is another one than Dugoff's."""
    peaked = p.tyre_curve_peak != 0.0 or p.tyre_curve_longitudinal != 0.0
    return peaked or p.tyre_curve_fullness != 0.0 or p.tyre_curve_early != 0.0


@compiled
def relaxation(p, sigma_f: float, sigma_r: float) -> tuple[float, float]:
    """Relaxation lengths [m] of the front and rear tyres, longer than C_alpha / K of each by a length."""
    return sigma_f + p.relaxation_front, sigma_r + p.relaxation_rear


@compiled
def lag_share(p, sigma: float, speed: float) -> float:
    """Share of the slip behind a force that lags by the relaxation length, the rest following at once.

    The integrator of step h is stable for a lag of rate v/sigma up to 2.78/h. A shorter one than LEAST_LAG v h lags as
    that does, by the share that has the same first-order response: 1 - s sigma/v.
    """
    return min(sigma / (LEAST_LAG * speed * p.step), 1.0) if sigma > 0.0 else 0.0


@compiled
def lag_rate(p, sigma: float, speed: float) -> float:
    """Rate [1/s] at which a lagged slip follows; none without relaxation."""
    return speed / max(sigma, LEAST_LAG * speed * p.step) if sigma > 0.0 else 0.0


@compiled
def stiffness_level(p) -> tuple[float, float]:
    """Factors on the cornering and longitudinal stiffness of the front and rear tyres."""
    both = p.stiffness_level_factor
    return both * p.stiffness_level_front, both * p.stiffness_level_rear


@compiled
def wheel_radius(p) -> tuple[float, float]:
    """Free radii [m] of the front and rear tyres, off by a factor each."""
    return p.wheel_radius_front * p.R_f, p.wheel_radius_rear * p.R_f


@compiled
def ignores_load(p) -> bool:
    """Whether the force that `axle_force` gives below the knee is the same under any load."""
    stiff = p.load_sensitivity_coefficient == 0.0 and p.lateral_load_transfer_coefficient == 0.0
    return stiff and not wheels_differ(p) and not curved(p)


@compiled
def moves_load_across(p) -> bool:
    """Whether a turn moves load from an axle's inner wheel to its outer one, and the model counts with it."""
    return p.lateral_load_transfer_uneven != 0.0 or p.lateral_load_transfer_coefficient != 0.0


@compiled
def leans(p) -> bool:
    """Whether load moves across as the body leans."""
    return p.lateral_load_transfer_period > SHORTEST and moves_load_across(p)


@compiled
def wheels_differ(p) -> bool:
    """Whether the wheels of an axle are two to the model, in their loads or in where they stand."""
    return p.lateral_load_transfer_uneven != 0.0 or p.lateral_load_transfer_track != 0.0


@compiled
def tyre_force(
    p, C_kappa: float, C_alpha: float, mu: float, F_z: float, load: float, kappa: float, tan_alpha: float, a_y: float
) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] of a tyre or an axle under F_z [N], `load` times its static one, with the tyre effects."""
    stiffness = load_sensitivity(p, load)
    C_kappa, C_alpha = stiffness * C_kappa, stiffness * lateral_load_transfer(p, a_y) * C_alpha
    if not curved(p) and not weighed(p):
        return dugoff(C_kappa, C_alpha, mu, F_z, kappa, tan_alpha)
    demand_x, demand_y, grip = C_kappa * kappa, C_alpha * tan_alpha, mu * max(F_z, 0.0)
    along, across = shares(p, math.hypot(demand_x, demand_y), grip, kappa)
    if weighed(p):
        _, across = shares(p, combined_slip(p, demand_x, demand_y), grip, kappa)
    return along * demand_x, across * demand_y


@compiled
def shares(p, demand: float, grip: float, kappa: float) -> tuple[float, float]:
    """Forces (x, y) over their demands [N], of size `demand`."""
    if demand == 0.0:
        return 0.0, 0.0
    share = dugoff_share(demand, grip, kappa)
    return tyre_curve(p, demand / max(grip, 1e-9), share) if curved(p) else (share, share)


@compiled
def weighed(p) -> bool:
    """Whether the longitudinal demand counts less in the side force than in the friction circle."""
    return p.combined_slip_weight != 1.0


@compiled
def combined_slip(p, demand_x: float, demand_y: float) -> float:
    """Combined demand S_y [N] that the side force follows from."""
    return math.hypot(p.combined_slip_weight * demand_x, demand_y)


@compiled
def side_force(p, C_alpha: float, mu: float, F_z: float, load: float, F_x: float, tan_alpha: float, a_y: float):
    """Forces (F_x, F_y) [N] of a tyre or an axle whose longitudinal force is given, as far as its grip goes."""
    demand_y = load_sensitivity(p, load) * lateral_load_transfer(p, a_y) * C_alpha * tan_alpha
    grip = mu * max(F_z, 0.0)
    F_x = min(max(F_x, -MOST_GRIP * grip), MOST_GRIP * grip)
    F_y, demand = dugoff_side(F_x, demand_y, grip)
    if demand_y == 0.0 or (not curved(p) and not weighed(p)):
        return F_x, F_y
    if weighed(p):
        demand = combined_slip(p, math.sqrt(max(demand * demand - demand_y * demand_y, 0.0)), demand_y)
    _, across = shares(p, demand, grip, 0.0)
    return F_x, across * demand_y
