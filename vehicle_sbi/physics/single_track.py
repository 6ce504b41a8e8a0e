"""The paper's single-track model: its equations of motion.

    m (dv_x/dt - v_y r) = F_xf cos(delta) - F_yf sin(delta) + F_xr + F_x
    m (dv_y/dt + v_x r) = F_xf sin(delta) + F_yf cos(delta) + F_yr + F_y
    I_z dr/dt           = l_f (F_xf sin(delta) + F_yf cos(delta)) - l_r F_yr
    I_w domega/dt       = T - F_x R_eff                                  for each axle
    dkappa^/dt          = |v_x|/sigma (kappa - kappa^), and alpha^ alike  (the paper's equations 1 to 11)

States: v_x, v_y [m/s], r [rad/s], omega_f, omega_r [rad/s], and the lagged slips. A drive mode says what is given and
what is solved for: TORQUE integrates all of it, WHEEL_SPEED takes the measured wheel speeds, SPEED the measured v_x
and leaves only the lateral equations.
"""

import math

from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import (
    body_load,
    downforce,
    friction_step,
    road_grade,
    roll_steer,
    steering_compliance,
    tyre_force,
)
from vehicle_sbi.physics.tyre import effective_radius

TORQUE, WHEEL_SPEED, SPEED = 0, 1, 2
DRIVES = {"torque": TORQUE, "wheel_speed": WHEEL_SPEED, "speed": SPEED}

INPUTS = (
    "steering", "torque_front", "torque_rear", "v_x", "v_x_dot", "wheel_speed_front", "wheel_speed_rear", "time",
)  # fmt: skip
DELTA, T_F, T_R, U_V_X, U_V_X_DOT, U_OMEGA_F, U_OMEGA_R, TIME = range(len(INPUTS))

STATES = 9
V_X, V_Y, R, OMEGA_F, OMEGA_R, KAPPA_F, KAPPA_R, ALPHA_F, ALPHA_R = range(STATES)

LOAD_TOLERANCE = 1e-9  # [m/s^2], where the loop between load transfer and longitudinal force stops
TWIST_TOLERANCE = 1e-12  # [rad], where that between side force and steering compliance does
TWIST_WEIGHT = 1e3  # [m/s^2 per rad], what makes the two comparable
LOAD_ITERATIONS = 100
SECANTS = 30  # of which the first so many extrapolate, the others go half the way
STEEPEST = 1.5  # [rad], the largest slip angle whose tangent is taken


@compiled
def regular(v: float) -> float:
    """|v| [m/s], kept above 0.5 by a parabola that joins it smoothly at 1 m/s, where the model's range ends."""
    v = abs(v)
    return v if v >= 1.0 else 0.5 * (1.0 + v * v)


@compiled
def slip(R_omega: float, v_wheel: float) -> float:
    """Longitudinal slip kappa (the paper's equation 4), a wheel that turns backwards counted as locked."""
    return max((R_omega - v_wheel) / regular(max(R_omega, v_wheel)), -1.0)


@compiled
def wheel_torque(torque: float, omega: float) -> float:
    """Net axle torque [N m]; a brake opposes rotation, so its torque fades below 1 rad/s and changes sign with it."""
    if torque >= 0.0 or omega >= 1.0:
        return torque
    if omega <= -1.0:
        return -torque
    return torque * omega * (2.0 - abs(omega))


@compiled
def tangent(alpha: float) -> float:
    """tan(alpha), with alpha limited to STEEPEST."""
    return math.tan(min(max(alpha, -STEEPEST), STEEPEST))


@compiled
def extrapolated(iteration: int, off_x: float, off_y: float, turn: float, x: float, y: float, z: float) -> float:
    """Share of the step before in the next one of a fixed-point iteration, whose residuals are (off_x, off_y [m/s^2],
    turn [rad]) now and were (x, y, z) then: Anderson's mixing of depth one, in one unknown the secant method.

    It ends where plain iteration creeps (a tall car on one axle that slips) or runs away (a very compliant steering).
    """
    if iteration == 0 or iteration >= SECANTS:
        return 0.0
    turn, z = TWIST_WEIGHT * turn, TWIST_WEIGHT * z
    size = (off_x - x) ** 2 + (off_y - y) ** 2 + (turn - z) ** 2
    share = ((off_x - x) * off_x + (off_y - y) * off_y + (turn - z) * turn) / size if size > 0.0 else 0.0
    return min(max(share, -9.0), 0.9)


@compiled
def impose(p, drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording."""
    if drive == WHEEL_SPEED:
        state[OMEGA_F] = u[U_OMEGA_F]
        state[OMEGA_R] = u[U_OMEGA_R]
    elif drive == SPEED:
        state[V_X] = u[U_V_X]


@compiled
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (9,) with d(state)/dt; rate[V_X] on entry is the guess from which the load-transfer loop starts.

    F_x depends on F_z and F_z on a_x: fixed-point iteration, whose factor is below mu h / L, `extrapolated`; the angle
    that steering compliance takes off the front wheels depends on their force and it on that angle, solved beside it
    with the tyre's slope at the origin. NaN if the loop does not end.
    """
    v_x, v_y, r, t = state[V_X], state[V_Y], state[R], u[TIME]
    relaxed = p.sigma_f > 0.0
    v_yf, v_yr = v_y + p.l_front * r, v_y - p.l_rear * r
    speed = regular(v_x)
    beta_f, alpha_r = math.atan(v_yf / speed), -math.atan(v_yr / speed)
    tan_r = tangent(state[ALPHA_R] if relaxed else alpha_r)
    a_y = v_x * r
    straight = u[DELTA] + roll_steer(p, a_y)
    mu = friction_step(p, p.grip, t)
    push_x, push_y, moment_z = body_load(p, v_x, t)
    press_f, press_r = downforce(p, v_x)
    g_x = road_grade(p, t)
    slope = 1.0 + (0.0 if relaxed else steering_compliance(p, p.C_alpha_f))

    F_xf = F_yf = F_xr = F_yr = kappa_f = kappa_r = twist = alpha_f = sin_delta = 0.0
    cos_delta, converged = 1.0, False
    R_f, R_r = p.R_front, p.R_rear
    a_x = u[U_V_X_DOT] - v_y * r if drive == SPEED else rate[V_X] - v_y * r
    before_x = before_turn = led_x = led_twist = 0.0
    for iteration in range(LOAD_ITERATIONS):
        if iteration == 0 or p.steering_compliance_coefficient != 0.0:
            delta = straight - twist
            sin_delta, cos_delta = math.sin(delta), math.cos(delta)
            alpha_f = delta - beta_f
        tan_f = tangent(state[ALPHA_F] if relaxed else alpha_f)
        shift = p.load_transfer * (a_x + g_x)
        F_zf, F_zr = p.F_zf_static - shift + press_f, p.F_zr_static + shift + press_r
        if drive != SPEED:
            v_wheel_f = v_x * cos_delta + v_yf * sin_delta
            R_f, R_r = effective_radius(p.R_front, p.C_vert, F_zf), effective_radius(p.R_rear, p.C_vert, F_zr)
            kappa_f, kappa_r = slip(R_f * state[OMEGA_F], v_wheel_f), slip(R_r * state[OMEGA_R], v_x)
        used_f = state[KAPPA_F] if relaxed else kappa_f
        used_r = state[KAPPA_R] if relaxed else kappa_r
        F_xf, F_yf = tyre_force(p, p.C_kappa_f, p.C_alpha_f, mu, F_zf, F_zf / p.F_zf_static, used_f, tan_f, a_y)
        F_xr, F_yr = tyre_force(p, p.C_kappa_r, p.C_alpha_r, mu, F_zr, F_zr / p.F_zr_static, used_r, tan_r, a_y)
        solved = a_x if drive == SPEED else (F_xf * cos_delta - F_yf * sin_delta + F_xr + push_x) / p.mass
        missing = steering_compliance(p, F_yf) - twist
        converged = abs(solved - a_x) < LOAD_TOLERANCE and abs(missing) < TWIST_TOLERANCE
        if converged:
            break
        off, turn = solved - a_x, missing / slope
        back = extrapolated(iteration, off, 0.0, turn, before_x, 0.0, before_turn)
        part = 1.0 if iteration < SECANTS else 0.5
        before_x, before_turn = off, turn
        a_x, led_x = a_x + part * off - back * (a_x + off - led_x), a_x + off
        twist, led_twist = twist + part * turn - back * (twist + turn - led_twist), twist + turn

    F_lateral_f = F_xf * sin_delta + F_yf * cos_delta
    rate[V_X] = a_x + v_y * r if converged else math.nan
    rate[V_Y] = (F_lateral_f + F_yr + push_y) / p.mass - v_x * r
    rate[R] = (p.l_front * F_lateral_f - p.l_rear * F_yr + moment_z) / p.I_z
    rate[OMEGA_F] = (wheel_torque(u[T_F], state[OMEGA_F]) - F_xf * R_f) / p.I_wf if drive == TORQUE else 0.0
    rate[OMEGA_R] = (wheel_torque(u[T_R], state[OMEGA_R]) - F_xr * R_r) / p.I_wr if drive == TORQUE else 0.0
    fade_f = speed / p.sigma_f if relaxed else 0.0
    fade_r = speed / p.sigma_r if relaxed else 0.0
    rate[KAPPA_F] = fade_f * (kappa_f - state[KAPPA_F])
    rate[KAPPA_R] = fade_r * (kappa_r - state[KAPPA_R])
    rate[ALPHA_F] = fade_f * (alpha_f - state[ALPHA_F])
    rate[ALPHA_R] = fade_r * (alpha_r - state[ALPHA_R])


@compiled
def contact_speed(p, delta: float, v_x: float, v_y: float, r: float) -> float:
    """Speed [m/s] of the front contact point in the wheel's own plane."""
    return v_x * math.cos(delta) + (v_y + p.l_front * r) * math.sin(delta)


@compiled
def rolling_radii(p) -> tuple[float, float]:
    """Effective radii [m] of the front and rear tyres under their static loads."""
    return effective_radius(p.R_front, p.C_vert, p.F_zf_static), effective_radius(p.R_rear, p.C_vert, p.F_zr_static)


@compiled
def start(p, drive: int, u, initial, state) -> None:
    """Fill the state at the first sample from (v_x, v_y, r): wheels rolling freely, or as recorded, slips settled."""
    state[V_X], state[V_Y], state[R] = initial[0], initial[1], initial[2]
    v_wheel_f = contact_speed(p, u[DELTA], state[V_X], state[V_Y], state[R])
    R_f, R_r = rolling_radii(p)
    state[OMEGA_F], state[OMEGA_R] = v_wheel_f / R_f, state[V_X] / R_r
    impose(p, drive, u, state)
    speed = regular(state[V_X])
    state[ALPHA_F] = u[DELTA] - math.atan((state[V_Y] + p.l_front * state[R]) / speed)
    state[ALPHA_R] = -math.atan((state[V_Y] - p.l_rear * state[R]) / speed)
    state[KAPPA_F] = slip(R_f * state[OMEGA_F], v_wheel_f) if drive == WHEEL_SPEED else 0.0
    state[KAPPA_R] = slip(R_r * state[OMEGA_R], state[V_X]) if drive == WHEEL_SPEED else 0.0


@compiled
def record(p, drive: int, u, state, rate, motion, k: int) -> None:
    """Fill the planar part of motion (14,), MOTION at one sample; wheels that are not solved for roll freely."""
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    motion[k, 0], motion[k, 1], motion[k, 2] = v_x, v_y, r
    motion[k, 3], motion[k, 4], motion[k, 5] = rate[V_X] - v_y * r, rate[V_Y] + v_x * r, rate[R]
    if drive == SPEED:
        R_f, R_r = rolling_radii(p)
        motion[k, 6], motion[k, 7] = contact_speed(p, u[DELTA], v_x, v_y, r) / R_f, v_x / R_r
    else:
        motion[k, 6], motion[k, 7] = state[OMEGA_F], state[OMEGA_R]
    for i in range(8, 14):
        motion[k, i] = 0.0
