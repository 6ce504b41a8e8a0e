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
from typing import NamedTuple

from vehicle_sbi.physics.balance import Front, Outside, outside, settled
from vehicle_sbi.physics.compiled import compiled
from vehicle_sbi.physics.effects import road_bank, tyre_force
from vehicle_sbi.physics.single_track import (
    DELTA,
    SPEED,
    T_F,
    T_R,
    TIME,
    TORQUE,
    U_OMEGA_F,
    U_OMEGA_R,
    U_V_X,
    U_V_X_DOT,
    WHEEL_SPEED,
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


class Wheel(NamedTuple):
    """What of a wheel stays as it is at one moment while loads and forces settle."""

    x: float  # where it stands from the centre of gravity [m]
    y: float
    v_along: float  # how it moves along and across the car [m/s]
    v_across: float
    speed: float  # |v_along|, kept above 0.5 [m/s]
    beta: float  # angle of its motion [rad]
    omega: float  # [rad/s]
    kappa: float  # lagged slip, slip angle [rad] and its tangent
    alpha: float
    tan_alpha: float


class Car(NamedTuple):
    """What of the car does."""

    drive: int
    relaxed: bool
    outside: Outside
    g_y: float  # gravity across the car [m/s^2]
    roll: float  # moments that turn the body [N m]
    pitch: float
    held_roll: float  # and what of them springs and dampers carry to the wheels [N m]
    held_pitch: float
    front_left: Wheel
    front_right: Wheel
    rear_left: Wheel
    rear_right: Wheel


class Contact(NamedTuple):
    """What a tyre does to the car, and what it is under."""

    F_x: float  # along and across the car [N]
    F_y: float
    M_z: float  # about the centre of gravity [N m]
    F_along: float  # in the wheel's own directions [N]
    F_side: float
    R_e: float  # effective radius [m]
    kappa: float  # slip and slip angle without lag
    alpha: float  # [rad]


class Forces(NamedTuple):
    """What all of it amounts to."""

    a_x: float  # [m/s^2]
    a_y: float
    F_yf: float  # side force of the front axle [N]
    M_z: float  # [N m]
    roll_rate_dot: float  # [rad/s^2]
    pitch_rate_dot: float
    front_left: Contact
    front_right: Contact
    rear_left: Contact
    rear_right: Contact


@compiled
def wheel(p, i: int, state) -> Wheel:
    """Wheel i in a state (19,)."""
    x, y = place(p, i)
    v_along, v_across = state[V_X] - state[R] * y, state[V_Y] + state[R] * x
    speed = regular(v_along)
    beta, alpha = math.atan(v_across / speed), state[ALPHA + i]
    return Wheel(x, y, v_along, v_across, speed, beta, state[OMEGA + i], state[KAPPA + i], alpha, tangent(alpha))


@compiled
def contact(p, car: Car, front: Front, i: int, w: Wheel, F_z: float, share: float) -> Contact:
    """What the tyre of wheel i does under the load F_z [N], `share` times its static one."""
    R_free, C_kappa, C_alpha = (p.R_front, p.C_kappa_f, p.C_alpha_f) if i < 2 else (p.R_rear, p.C_kappa_r, p.C_alpha_r)
    delta, sine, cosine = (front.delta, front.sine, front.cosine) if i < 2 else (0.0, 0.0, 1.0)
    R_e, alpha = effective_radius(R_free, p.C_vert, 2.0 * F_z), delta - w.beta
    kappa = 0.0 if car.drive == SPEED else slip(R_e * w.omega, w.v_along * cosine + w.v_across * sine)
    used, tan_alpha = (w.kappa, w.tan_alpha) if car.relaxed else (kappa, tangent(alpha))
    mu, steady = car.outside.mu, car.outside.steady
    F_along, F_side = tyre_force(p, 0.5 * C_kappa, 0.5 * C_alpha, mu, F_z, share, used, tan_alpha, steady)
    F_x, F_y = F_along * cosine - F_side * sine, F_along * sine + F_side * cosine
    return Contact(F_x, F_y, w.x * F_y - w.y * F_x, F_along, F_side, R_e, kappa, alpha)


@compiled
def forces(p, car: Car, front: Front, a_x: float, a_y: float) -> Forces:
    """Forces of all wheels under the loads of accelerations (a_x, a_y) [m/s^2], and what they cause.

    Sums run axle by axle, so that a mirrored drive has the same rounding.
    """
    out = car.outside
    roll_rate_dot = (p.roll_lever * (a_y + car.g_y) + car.roll) / p.roll_J
    pitch_rate_dot = (car.pitch - p.pitch_lever * (a_x + out.g_x)) / p.pitch_J
    rigid_x, rigid_y = p.mass * p.h_cog - p.pitch_lever, p.mass * p.h_cog - p.roll_lever
    pitching = rigid_x * (a_x + out.g_x) + car.held_pitch + p.h_pitch * p.pitch_lever * pitch_rate_dot
    centres = rigid_y * (a_y + car.g_y) - p.h_roll * p.roll_lever * roll_rate_dot
    F_z_fl, share_fl = load(p, 0, pitching, car.held_roll, centres, out.press_f, out.press_r)
    F_z_fr, share_fr = load(p, 1, pitching, car.held_roll, centres, out.press_f, out.press_r)
    F_z_rl, share_rl = load(p, 2, pitching, car.held_roll, centres, out.press_f, out.press_r)
    F_z_rr, share_rr = load(p, 3, pitching, car.held_roll, centres, out.press_f, out.press_r)
    fl = contact(p, car, front, 0, car.front_left, F_z_fl, share_fl)
    fr = contact(p, car, front, 1, car.front_right, F_z_fr, share_fr)
    rl = contact(p, car, front, 2, car.rear_left, F_z_rl, share_rl)
    rr = contact(p, car, front, 3, car.rear_right, F_z_rr, share_rr)
    F_x = out.push_x + (fl.F_x + fr.F_x) + (rl.F_x + rr.F_x)
    F_y = out.push_y + (fl.F_y + fr.F_y) + (rl.F_y + rr.F_y)
    M_z = out.moment_z + (fl.M_z + fr.M_z) + (rl.M_z + rr.M_z)
    solved_x, solved_y = accelerated(p, car, F_x, F_y)
    solved_x = a_x if car.drive == SPEED else solved_x
    return Forces(solved_x, solved_y, fl.F_side + fr.F_side, M_z, roll_rate_dot, pitch_rate_dot, fl, fr, rl, rr)


@compiled
def accelerated(p, car: Car, F_x: float, F_y: float) -> tuple[float, float]:
    """Accelerations [m/s^2] under the forces [N] of the tyres and from outside, the body swinging on its springs."""
    m_x, m_y = p.mass - p.pitch_lever**2 / p.pitch_J, p.mass - p.roll_lever**2 / p.roll_J
    pull_x = -p.pitch_lever / p.pitch_J * (car.pitch - p.pitch_lever * car.outside.g_x)
    pull_y = p.roll_lever / p.roll_J * (car.roll + p.roll_lever * car.g_y)
    return (F_x + pull_x) / m_x, (F_y + pull_y) / m_y


@compiled
def turn_wheel(p, drive: int, i: int, torque: float, w: Wheel, c: Contact, rate) -> None:
    """Fill what rate (19,) has of wheel i: its rotation under its axle's torque [N m], and its lagged slips."""
    inertia, sigma = (p.I_wf, p.sigma_f) if i < 2 else (p.I_wr, p.sigma_r)
    net = wheel_torque(0.5 * torque, w.omega) - c.F_along * c.R_e
    rate[OMEGA + i] = net / (0.5 * inertia) if drive == TORQUE else 0.0
    rate[KAPPA + i] = w.speed / sigma * (c.kappa - w.kappa) if p.sigma_f > 0.0 else 0.0
    rate[ALPHA + i] = w.speed / sigma * (c.alpha - w.alpha) if p.sigma_f > 0.0 else 0.0


@compiled
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (19,) with d(state)/dt; rate[V_X] and rate[V_Y] on entry are where the load-transfer loop starts."""
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    roll, pitch = restoring(p, state)
    car = Car(
        drive=drive,
        relaxed=p.sigma_f > 0.0,
        outside=outside(p, u[DELTA], v_x, r, u[TIME]),
        g_y=road_bank(p),
        roll=roll,
        pitch=pitch,
        held_roll=p.K_roll * state[ROLL] + p.D_roll * state[ROLL_RATE],
        held_pitch=-(p.K_pitch * state[PITCH] + p.D_pitch * state[PITCH_RATE]),
        front_left=wheel(p, 0, state),
        front_right=wheel(p, 1, state),
        rear_left=wheel(p, 2, state),
        rear_right=wheel(p, 3, state),
    )
    given = u[U_V_X_DOT] if drive == SPEED else rate[V_X]
    found, a_x, a_y = settled(forces, p, car, given - v_y * r, rate[V_Y] + v_x * r)

    rate[V_X], rate[V_Y], rate[R] = a_x + v_y * r, a_y - v_x * r, found.M_z / p.I_z
    rate[ROLL], rate[PITCH] = state[ROLL_RATE], state[PITCH_RATE]
    rate[ROLL_RATE], rate[PITCH_RATE] = found.roll_rate_dot, found.pitch_rate_dot
    turn_wheel(p, drive, 0, u[T_F], car.front_left, found.front_left, rate)
    turn_wheel(p, drive, 1, u[T_F], car.front_right, found.front_right, rate)
    turn_wheel(p, drive, 2, u[T_R], car.rear_left, found.rear_left, rate)
    turn_wheel(p, drive, 3, u[T_R], car.rear_right, found.rear_right, rate)


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
