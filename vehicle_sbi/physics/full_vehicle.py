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

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.balance import SPEED, TORQUE, WHEEL_SPEED, Front, Outside, outside, pointing, pulls, settled
from vehicle_sbi.physics.body_forces import lateral_cog, road_bank
from vehicle_sbi.physics.single_track import (
    DELTA,
    T_F,
    T_R,
    TIME,
    U_LATENT,
    U_OMEGA_F,
    U_OMEGA_R,
    U_V_X,
    U_V_X_DOT,
    mixed,
    regular,
    rolling_radii,
    slip,
    tangent,
    wheel_torque,
)
from vehicle_sbi.physics.tyre import effective_radius
from vehicle_sbi.physics.tyre_effects import lag_rate, lag_share, side_force, tyre_force
from vehicle_sbi.physics.vehicle import GRAVITY

WHEELS = 4  # front left, front right, rear left, rear right
STATES = 7 + 3 * WHEELS
V_X, V_Y, R, ROLL, ROLL_RATE, PITCH, PITCH_RATE = range(7)
OMEGA, KAPPA, ALPHA = 7, 7 + WHEELS, 7 + 2 * WHEELS  # the first of four each


@compiled
def ground(p, state, wheel: int) -> float:
    """Speed [m/s] of the car above a wheel."""
    return state[V_X] - state[R] * place(p, wheel)[1]


@compiled
def states(_) -> int:
    """How many of the states change anything."""
    return STATES


@compiled
def place(p, i: int) -> tuple[float, float]:
    """Where wheel i stands, (x, y) [m] from the centre of gravity."""
    side = 0.5 if i % 2 == 0 else -0.5
    return (p.l_front, side * p.track_f) if i < 2 else (-p.l_rear, side * p.track_r)


@compiled
def impose(p, drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording: each wheel has its axle's mean speed."""
    if drive == WHEEL_SPEED:
        for i in range(WHEELS):
            state[OMEGA + i] = u[U_OMEGA_F] if i < 2 else u[U_OMEGA_R]
    elif drive == SPEED:
        state[V_X] = u[U_V_X]


@compiled
def shared(axle: float, moment: float, track: float) -> tuple[float, float]:
    """Loads [N] of an axle's left and right wheel, of the axle's load [N] and a moment [N m] to the right."""
    all_of_it = max(0.5 * axle, 0.0)
    across = min(max(moment / track, -all_of_it), all_of_it) if track > 0.0 else 0.0
    return 0.5 * axle - across, 0.5 * axle + across


@compiled
def loads(p, pitching: float, springs: float, centres: float, press_f: float, press_r: float):
    """Vertical loads [N] of the wheels: front left, front right, rear left, rear right.

    pitching [N m] moves load to the rear axle; springs and centres [N m] are what the springs and dampers and what the
    roll centres carry of the moment that moves load to the right wheels.
    """
    shift = pitching / p.L
    moment_f = p.roll_front * springs + centres * p.l_rear / p.L
    moment_r = (1.0 - p.roll_front) * springs + centres * p.l_front / p.L
    front_left, front_right = shared(p.F_zf_static - shift + press_f, moment_f, p.track_f)
    rear_left, rear_right = shared(p.F_zr_static + shift + press_r, moment_r, p.track_r)
    return front_left, front_right, rear_left, rear_right


@compiled
def restoring(p, state) -> tuple[float, float]:
    """Moments (roll, pitch) [N m] with which springs, dampers and gravity act on a leaning body."""
    roll = -(p.K_roll - GRAVITY * p.roll_lever) * state[ROLL] - p.D_roll * state[ROLL_RATE]
    pitch = -(p.K_pitch - GRAVITY * p.pitch_lever) * state[PITCH] - p.D_pitch * state[PITCH_RATE]
    return roll, pitch


class Axle(NamedTuple):
    """Constants of a wheel of an axle, half of the axle's where they are the axle's."""

    x: float  # from the centre of gravity [m]
    half_track: float  # [m]
    R: float  # free radius [m]
    C_kappa: float  # [N]
    C_alpha: float  # [N/rad]
    sigma: float  # [m]
    slide: float  # factor on the friction coefficient
    inertia: float  # [kg m^2]
    F_z_static: float  # [N]


class Wheel(NamedTuple):
    """What of a wheel stays as it is at one moment while loads and forces settle."""

    x: float  # where it stands from the centre of gravity [m]
    y: float
    v_along: float  # how it moves along and across the car [m/s]
    v_across: float
    speed: float  # |v_along|, kept above 0.5 [m/s]
    beta: float  # angle of its motion [rad]
    omega: float  # [rad/s]
    share: float  # of its slips that lag
    kappa: float  # lagged slip, slip angle [rad] and its tangent
    alpha: float
    tan_alpha: float


class Car(NamedTuple):
    """What of the car does."""

    drive: int
    share_f: float  # of the front axle's slips that lag
    outside: Outside
    g_y: float  # gravity across the car [m/s^2]
    roll: float  # moments that turn the body [N m]
    pitch: float
    held_roll: float  # and what of them springs and dampers carry to the wheels [N m]
    held_pitch: float
    front: Axle
    rear: Axle
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
    final: bool  # never: body and lateral acceleration move load as long as they change
    even: bool  # always: each wheel has a speed of its own
    F_yf: float  # side force of the front axle [N]
    M_z: float  # [N m]
    roll_rate_dot: float  # [rad/s^2]
    pitch_rate_dot: float
    front_left: Contact
    front_right: Contact
    rear_left: Contact
    rear_right: Contact


@compiled
def axles(p) -> tuple[Axle, Axle]:
    """Front and rear."""
    half_f, half_r = 0.5 * p.stiff_f, 0.5 * p.stiff_r
    front = Axle(
        p.l_front, 0.5 * p.track_f, p.R_front,
        half_f * p.C_kappa_f, half_f * p.C_alpha_f, p.sigma_f, p.slide_f, 0.5 * p.I_wf, 0.5 * p.F_zf_static,
    )  # fmt: skip
    rear = Axle(
        -p.l_rear, 0.5 * p.track_r, p.R_rear,
        half_r * p.C_kappa_r, half_r * p.C_alpha_r, p.sigma_r, p.slide_r, 0.5 * p.I_wr, 0.5 * p.F_zr_static,
    )  # fmt: skip
    return front, rear


@compiled
def wheel(p, axle: Axle, y: float, v_x: float, v_y: float, r: float, omega: float, kappa: float, alpha: float) -> Wheel:
    """The wheel at y [m] of an axle of a car that moves with v_x, v_y [m/s] and r [rad/s], from its own states."""
    v_along, v_across = v_x - r * y, v_y + r * axle.x
    speed = regular(v_along)
    share, beta = lag_share(p, axle.sigma, speed), math.atan(v_across / speed)
    return Wheel(axle.x, y, v_along, v_across, speed, beta, omega, share, kappa, alpha, tangent(alpha))


@compiled
def in_plane(front: Front, w: Wheel) -> float:
    """Speed [m/s] of a wheel in its own plane."""
    return w.v_along * front.cosine + w.v_across * front.sine


@compiled
def rolling_freely(p, axle: Axle, front: Front, left: Wheel, right: Wheel, F_l: float, F_r: float) -> float:
    """Mean speed [rad/s] at which an axle's wheels would turn without slip, under their loads [N]."""
    R_l, R_r = effective_radius(axle.R, p.C_vert, 2.0 * F_l), effective_radius(axle.R, p.C_vert, 2.0 * F_r)
    return 0.5 * (regular(in_plane(front, left)) / R_l + regular(in_plane(front, right)) / R_r)


@compiled
def contact(
    p, car: Car, axle: Axle, front: Front, w: Wheel, F_z: float, moved: float, freely: float, pull: float
) -> Contact:
    """What the tyre of a wheel that points to the `front` does under the load F_z [N], which an acceleration `moved`
    [m/s^2] has moved across.

    `pull` is its axle's longitudinal force [N] where the speed is given. Where wheel speeds are, only their mean is
    known: an open differential drives both wheels alike, so both have the slip of the mean over `freely` [rad/s].
    """
    R_e, alpha, v_wheel = effective_radius(axle.R, p.C_vert, 2.0 * F_z), front.delta - w.beta, in_plane(front, w)
    rolled = v_wheel * w.omega / freely if car.drive == WHEEL_SPEED else R_e * w.omega
    kappa = 0.0 if car.drive == SPEED else slip(rolled, v_wheel)
    tan_alpha = w.tan_alpha if w.share == 1.0 else tangent(mixed(w.share, w.alpha, alpha))
    mu, load = axle.slide * car.outside.mu, F_z / axle.F_z_static
    if car.drive == SPEED:
        F_along, F_side = side_force(p, axle.C_alpha, mu, F_z, load, 0.5 * pull, tan_alpha, moved)
    else:
        used = mixed(w.share, w.kappa, kappa)
        F_along, F_side = tyre_force(p, axle.C_kappa, axle.C_alpha, mu, F_z, load, used, tan_alpha, moved)
    F_x = F_along * front.cosine - F_side * front.sine
    F_y = F_along * front.sine + F_side * front.cosine
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
    F_z = loads(p, pitching, car.held_roll, centres, out.press_f, out.press_r)
    straight, pull_f, pull_r, free_f, free_r = pointing(0.0, 0.0), 0.0, 0.0, 0.0, 0.0
    felt = a_y + car.g_y
    if car.drive == SPEED:
        pull_f, pull_r = pulls(p, out, front, a_x)
    elif car.drive == WHEEL_SPEED:
        free_f = rolling_freely(p, car.front, front, car.front_left, car.front_right, F_z[0], F_z[1])
        free_r = rolling_freely(p, car.rear, straight, car.rear_left, car.rear_right, F_z[2], F_z[3])
    fl = contact(p, car, car.front, front, car.front_left, F_z[0], felt, free_f, pull_f)
    fr = contact(p, car, car.front, front, car.front_right, F_z[1], felt, free_f, pull_f)
    rl = contact(p, car, car.rear, straight, car.rear_left, F_z[2], felt, free_r, pull_r)
    rr = contact(p, car, car.rear, straight, car.rear_right, F_z[3], felt, free_r, pull_r)
    F_along = (fl.F_x + fr.F_x) + (rl.F_x + rr.F_x)
    F_x = out.push_x + F_along
    F_y = out.push_y + (fl.F_y + fr.F_y) + (rl.F_y + rr.F_y)
    M_z = out.moment_z + lateral_cog(p, F_along) + (fl.M_z + fr.M_z) + (rl.M_z + rr.M_z)
    solved_x, solved_y = accelerated(p, car, F_x, F_y)
    solved_x = a_x if car.drive == SPEED else solved_x
    return Forces(
        solved_x, solved_y, False, True, fl.F_side + fr.F_side, M_z, roll_rate_dot, pitch_rate_dot, fl, fr, rl, rr
    )


@compiled
def accelerated(p, car: Car, F_x: float, F_y: float) -> tuple[float, float]:
    """Accelerations [m/s^2] under the forces [N] of the tyres and from outside, the body swinging on its springs."""
    m_x, m_y = p.mass - p.pitch_lever**2 / p.pitch_J, p.mass - p.roll_lever**2 / p.roll_J
    pull_x = -p.pitch_lever / p.pitch_J * (car.pitch - p.pitch_lever * car.outside.g_x)
    pull_y = p.roll_lever / p.roll_J * (car.roll + p.roll_lever * car.g_y)
    return (F_x + pull_x) / m_x, (F_y + pull_y) / m_y


@compiled
def turning(p, car: Car, axle: Axle, torque: float, w: Wheel, c: Contact) -> tuple[float, float, float]:
    """d/dt of a wheel's speed [rad/s^2] under its axle's torque [N m], and of its lagged slips [1/s, rad/s]."""
    net = wheel_torque(0.5 * torque, w.omega) - c.F_along * c.R_e
    fade = lag_rate(p, axle.sigma, w.speed)
    return net / axle.inertia if car.drive == TORQUE else 0.0, fade * (c.kappa - w.kappa), fade * (c.alpha - w.alpha)


@compiled
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (19,) with d(state)/dt; on entry rate[V_X], rate[V_Y] are where the loop of loads starts."""
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    roll, pitch = restoring(p, state)
    front, rear = axles(p)
    y_f, y_r = front.half_track, rear.half_track
    given = u[U_V_X_DOT] if drive == SPEED else rate[V_X]
    out = outside(p, u[DELTA], v_x, r, u[TIME], u[U_LATENT])
    car = Car(
        drive=drive,
        share_f=lag_share(p, p.sigma_f, regular(v_x)),
        outside=out,
        g_y=road_bank(p),
        roll=roll,
        pitch=pitch,
        held_roll=p.K_roll * state[ROLL] + p.D_roll * state[ROLL_RATE],
        held_pitch=-(p.K_pitch * state[PITCH] + p.D_pitch * state[PITCH_RATE]),
        front=front,
        rear=rear,
        front_left=wheel(p, front, y_f, v_x, v_y, r, state[7], state[11], state[15]),
        front_right=wheel(p, front, -y_f, v_x, v_y, r, state[8], state[12], state[16]),
        rear_left=wheel(p, rear, y_r, v_x, v_y, r, state[9], state[13], state[17]),
        rear_right=wheel(p, rear, -y_r, v_x, v_y, r, state[10], state[14], state[18]),
    )
    found, _, a_x, a_y = settled(forces, p, car, given - v_y * r, rate[V_Y] + v_x * r)

    rate[V_X], rate[V_Y], rate[R] = a_x + v_y * r, a_y - v_x * r, found.M_z / p.I_z
    rate[ROLL], rate[PITCH] = state[ROLL_RATE], state[PITCH_RATE]
    rate[ROLL_RATE], rate[PITCH_RATE] = found.roll_rate_dot, found.pitch_rate_dot
    rate[7], rate[11], rate[15] = turning(p, car, front, u[T_F], car.front_left, found.front_left)
    rate[8], rate[12], rate[16] = turning(p, car, front, u[T_F], car.front_right, found.front_right)
    rate[9], rate[13], rate[17] = turning(p, car, rear, u[T_R], car.rear_left, found.rear_left)
    rate[10], rate[14], rate[18] = turning(p, car, rear, u[T_R], car.rear_right, found.rear_right)


@compiled_apart
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
            middle = regular(v_x * math.cos(delta) + (v_y + r * x) * math.sin(delta))
            v_wheel = middle - r * y * math.cos(delta)
            state[KAPPA + i] = slip(v_wheel * state[OMEGA + i] * R_e / middle, v_wheel)


@compiled_apart
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
