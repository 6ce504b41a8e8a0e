"""The four-wheel model with roll and pitch: its equations of motion.

Each wheel has its own tyre and load, half an axle's stiffness and inertia. The sprung mass m_s leans by the roll angle
phi (to the right) and the pitch angle theta (nose down) about axes at the heights h_roll and h_pitch, a distance
h_s and h_p below its centre of gravity, on springs K and dampers D:

    m a_x = sum F_x - m_s h_p d2theta/dt2             (I_y + m_s h_p^2) d2theta/dt2 = -m_s h_p (a_x + g_x) + M_theta
    m a_y = sum F_y + m_s h_s d2phi/dt2               (I_x + m_s h_s^2) d2phi/dt2   =  m_s h_s (a_y + g_y) + M_phi
    M_theta = -(K_pitch - m_s g h_p) theta - D_pitch dtheta/dt
    M_phi   = -(K_roll - m_s g h_s) phi - D_roll dphi/dt
    I_z dr/dt = sum (x_i F_y,i - y_i F_x,i)

(small angles; Rajamani, Vehicle Dynamics and Control, ch. 15; Jazar, Vehicle Dynamics, ch. 11). Springs and dampers
carry their part of the load transfer, roll and pitch centres carry the rest at once: the forces of the sprung mass that
act there and what acts on wheels and axles. A wheel that lifts leaves all of its axle's load to the other. With no
sprung mass and no track the equations are those of the single-track model.
"""

import math

from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import (
    body_load,
    downforce,
    friction_step,
    road_bank,
    road_grade,
    roll_steer,
    steering_compliance,
    tyre_force,
)
from vehicle_sbi.physics.single_track import (
    DELTA,
    LOAD_ITERATIONS,
    LOAD_TOLERANCE,
    SECANTS,
    SPEED,
    T_F,
    T_R,
    TIME,
    TORQUE,
    TWIST_TOLERANCE,
    U_OMEGA_F,
    U_OMEGA_R,
    U_V_X,
    U_V_X_DOT,
    WHEEL_SPEED,
    extrapolated,
    regular,
    rolling_radii,
    slip,
    tangent,
    wheel_torque,
)
from vehicle_sbi.physics.tyre import effective_radius
from vehicle_sbi.physics.vehicle import GRAVITY

WHEELS = 4  # front left, front right, rear left, rear right
STATES = 7 + 3 * WHEELS
V_X, V_Y, R, ROLL, ROLL_RATE, PITCH, PITCH_RATE = range(7)
OMEGA, KAPPA, ALPHA = 7, 7 + WHEELS, 7 + 2 * WHEELS  # the first of four each


@compiled
def wheel_speed(v_axle: float, r: float, y: float, R_e: float) -> float:
    """Speed [rad/s] of a wheel at y [m] left of the middle of an axle whose mean wheel speed is `v_axle` [rad/s]."""
    return v_axle - r * y / R_e


@compiled
def place(p, i: int) -> tuple[float, float]:
    """Where wheel i stands, (x, y) [m] from the centre of gravity."""
    side = 0.5 if i % 2 == 0 else -0.5
    return (p.l_front, side * p.track_f) if i < 2 else (-p.l_rear, side * p.track_r)


@compiled
def impose(p, drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording."""
    if drive == WHEEL_SPEED:
        R_f, R_r = rolling_radii(p)
        for i in range(WHEELS):
            axle, R_e = (u[U_OMEGA_F], R_f) if i < 2 else (u[U_OMEGA_R], R_r)
            state[OMEGA + i] = wheel_speed(axle, state[R], place(p, i)[1], R_e)
    elif drive == SPEED:
        state[V_X] = u[U_V_X]


@compiled
def load(p, i: int, pitching: float, springs: float, centres: float, press_f: float, press_r: float):
    """Vertical load [N] of wheel i, and its ratio to the static one.

    pitching [N m] moves load to the rear axle; springs and centres [N m] are what the springs and dampers and what the
    roll centres carry of the moment that moves load to the right wheels.
    """
    shift = pitching / p.L
    if i < 2:
        static, axle, track = p.F_zf_static, p.F_zf_static - shift + press_f, p.track_f
        moment = p.roll_front * springs + centres * p.l_rear / p.L
    else:
        static, axle, track = p.F_zr_static, p.F_zr_static + shift + press_r, p.track_r
        moment = (1.0 - p.roll_front) * springs + centres * p.l_front / p.L
    all_of_it = max(0.5 * axle, 0.0)
    across = min(max(moment / track, -all_of_it), all_of_it) if track > 0.0 else 0.0
    F_z = 0.5 * axle + (across if i % 2 == 1 else -across)
    return F_z, 2.0 * F_z / static


@compiled
def restoring(p, state) -> tuple[float, float]:
    """Moments (roll, pitch) [N m] with which springs, dampers and gravity act on a leaning body."""
    roll = -(p.K_roll - GRAVITY * p.roll_lever) * state[ROLL] - p.D_roll * state[ROLL_RATE]
    pitch = -(p.K_pitch - GRAVITY * p.pitch_lever) * state[PITCH] - p.D_pitch * state[PITCH_RATE]
    return roll, pitch


@compiled
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (19,) with d(state)/dt; rate[V_X] and rate[V_Y] on entry are where the load-transfer loop starts.

    Loads depend on the accelerations and these on the tyres: the loop of the single-track model in both directions.
    """
    v_x, v_y, r, t = state[V_X], state[V_Y], state[R], u[TIME]
    relaxed = p.sigma_f > 0.0
    mu = friction_step(p, p.grip, t)
    push_x, push_y, moment_z = body_load(p, v_x, t)
    press_f, press_r = downforce(p, v_x)
    g_x, g_y = road_grade(p, t), road_bank(p)
    steady = v_x * r
    straight = u[DELTA] + roll_steer(p, steady)
    slope = 1.0 + (0.0 if relaxed else steering_compliance(p, p.C_alpha_f))
    roll_moment, pitch_moment = restoring(p, state)
    held_roll = p.K_roll * state[ROLL] + p.D_roll * state[ROLL_RATE]
    held_pitch = -(p.K_pitch * state[PITCH] + p.D_pitch * state[PITCH_RATE])
    m_x, m_y = p.mass - p.pitch_lever**2 / p.pitch_J, p.mass - p.roll_lever**2 / p.roll_J
    pull_x = -p.pitch_lever / p.pitch_J * (pitch_moment - p.pitch_lever * g_x)
    pull_y = p.roll_lever / p.roll_J * (roll_moment + p.roll_lever * g_y)
    rigid_x, rigid_y = p.mass * p.h_cog - p.pitch_lever, p.mass * p.h_cog - p.roll_lever

    a_x = u[U_V_X_DOT] - v_y * r if drive == SPEED else rate[V_X] - v_y * r
    a_y, twist, converged = rate[V_Y] + v_x * r, 0.0, False
    F_x = F_y = M_z = roll_rate_dot = pitch_rate_dot = left_x = left_y = left_M = 0.0
    before_x = before_y = before_turn = led_x = led_y = led_twist = 0.0
    for iteration in range(LOAD_ITERATIONS):
        delta = straight - twist
        sine, cosine = math.sin(delta), math.cos(delta)
        F_x, F_y, M_z, F_yf = push_x, push_y, moment_z, 0.0
        roll_rate_dot = (p.roll_lever * (a_y + g_y) + roll_moment) / p.roll_J
        pitch_rate_dot = (pitch_moment - p.pitch_lever * (a_x + g_x)) / p.pitch_J
        pitching = rigid_x * (a_x + g_x) + held_pitch + p.h_pitch * p.pitch_lever * pitch_rate_dot
        centres = rigid_y * (a_y + g_y) - p.h_roll * p.roll_lever * roll_rate_dot
        for i in range(WHEELS):
            x, y = place(p, i)
            F_z, share = load(p, i, pitching, held_roll, centres, press_f, press_r)
            v_along, v_across = v_x - r * y, v_y + r * x
            speed = regular(v_along)
            front = i < 2
            alpha = (delta if front else 0.0) - math.atan(v_across / speed)
            v_wheel = v_along * cosine + v_across * sine if front else v_along
            R_e = effective_radius(p.R_front if front else p.R_rear, p.C_vert, 2.0 * F_z)
            kappa = 0.0 if drive == SPEED else slip(R_e * state[OMEGA + i], v_wheel)
            f_x, f_y = tyre_force(
                p,
                0.5 * (p.C_kappa_f if front else p.C_kappa_r),
                0.5 * (p.C_alpha_f if front else p.C_alpha_r),
                mu,
                F_z,
                share,
                state[KAPPA + i] if relaxed else kappa,
                tangent(state[ALPHA + i] if relaxed else alpha),
                steady,
            )
            fade = speed / (p.sigma_f if front else p.sigma_r) if relaxed else 0.0
            rate[KAPPA + i] = fade * (kappa - state[KAPPA + i])
            rate[ALPHA + i] = fade * (alpha - state[ALPHA + i])
            rate[OMEGA + i] = 0.0
            if drive == TORQUE:
                torque = wheel_torque(0.5 * (u[T_F] if front else u[T_R]), state[OMEGA + i])
                rate[OMEGA + i] = (torque - f_x * R_e) / (0.5 * (p.I_wf if front else p.I_wr))
            if front:
                F_yf += f_y
                f_x, f_y = f_x * cosine - f_y * sine, f_x * sine + f_y * cosine
            f_M = x * f_y - y * f_x
            if i % 2 == 0:
                left_x, left_y, left_M = f_x, f_y, f_M
            else:  # axle by axle, so that a mirrored drive has the same rounding
                F_x, F_y, M_z = F_x + (left_x + f_x), F_y + (left_y + f_y), M_z + (left_M + f_M)
        solved_x = a_x if drive == SPEED else (F_x + pull_x) / m_x
        solved_y = (F_y + pull_y) / m_y
        missing = steering_compliance(p, F_yf) - twist
        off_x, off_y, turn = solved_x - a_x, solved_y - a_y, missing / slope
        converged = max(abs(off_x), abs(off_y)) < LOAD_TOLERANCE and abs(missing) < TWIST_TOLERANCE
        if converged:
            break
        back = extrapolated(iteration, off_x, off_y, turn, before_x, before_y, before_turn)
        part = 1.0 if iteration < SECANTS else 0.5
        before_x, before_y, before_turn = off_x, off_y, turn
        a_x, led_x = a_x + part * off_x - back * (a_x + off_x - led_x), a_x + off_x
        a_y, led_y = a_y + part * off_y - back * (a_y + off_y - led_y), a_y + off_y
        twist, led_twist = twist + part * turn - back * (twist + turn - led_twist), twist + turn

    rate[V_X] = a_x + v_y * r if converged else math.nan
    rate[V_Y] = a_y - v_x * r
    rate[R] = M_z / p.I_z
    rate[ROLL], rate[PITCH] = state[ROLL_RATE], state[PITCH_RATE]
    rate[ROLL_RATE], rate[PITCH_RATE] = roll_rate_dot, pitch_rate_dot


@compiled
def start(p, drive: int, u, initial, state) -> None:
    """Fill the state at the first sample from (v_x, v_y, r): wheels rolling freely, or as recorded, slips and body
    settled in a steady turn on an even road."""
    state[V_X], state[V_Y], state[R] = initial[0], initial[1], initial[2]
    if drive == SPEED:
        state[V_X] = u[U_V_X]
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    state[ROLL] = p.roll_lever * v_x * r / (p.K_roll - GRAVITY * p.roll_lever)
    R_f, R_r = rolling_radii(p)
    for i in range(WHEELS):
        x, y = place(p, i)
        delta, R_e = (u[DELTA], R_f) if i < 2 else (0.0, R_r)
        v_along, v_across = v_x - r * y, v_y + r * x
        v_wheel = v_along * math.cos(delta) + v_across * math.sin(delta)
        state[OMEGA + i] = v_wheel / R_e
        state[ALPHA + i] = delta - math.atan(v_across / regular(v_along))
    impose(p, drive, u, state)
    if drive == WHEEL_SPEED:
        for i in range(WHEELS):
            x, y = place(p, i)
            delta, R_e = (u[DELTA], R_f) if i < 2 else (0.0, R_r)
            v_wheel = (v_x - r * y) * math.cos(delta) + (v_y + r * x) * math.sin(delta)
            state[KAPPA + i] = slip(R_e * state[OMEGA + i], v_wheel)


@compiled
def record(p, drive: int, u, state, rate, motion, k: int) -> None:
    """Fill motion (14,) with MOTION at one sample: the body at the centre of gravity and the axles' mean wheels."""
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    motion[k, 0], motion[k, 1], motion[k, 2] = v_x, v_y, r
    motion[k, 3] = rate[V_X] - v_y * r + (p.h_cog - p.h_pitch) * rate[PITCH_RATE]
    motion[k, 4] = rate[V_Y] + v_x * r - (p.h_cog - p.h_roll) * rate[ROLL_RATE]
    motion[k, 5] = rate[R]
    if drive == SPEED:
        R_f, R_r = rolling_radii(p)
        forward = v_x * math.cos(u[DELTA]) + (v_y + p.l_front * r) * math.sin(u[DELTA])
        motion[k, 6], motion[k, 7] = forward / R_f, v_x / R_r
    else:
        motion[k, 6] = 0.5 * (state[OMEGA] + state[OMEGA + 1])
        motion[k, 7] = 0.5 * (state[OMEGA + 2] + state[OMEGA + 3])
    motion[k, 8], motion[k, 9] = state[ROLL], state[PITCH]
    motion[k, 10], motion[k, 11] = state[ROLL_RATE], state[PITCH_RATE]
    motion[k, 12], motion[k, 13] = rate[ROLL_RATE], rate[PITCH_RATE]
