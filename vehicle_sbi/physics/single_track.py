"""The paper's single-track model: its equations of motion.

    m (dv_x/dt - v_y r) = F_xf cos(delta) - F_yf sin(delta) + F_xr + F_x
    m (dv_y/dt + v_x r) = F_xf sin(delta) + F_yf cos(delta) + F_yr + F_y
    I_z dr/dt           = l_f (F_xf sin(delta) + F_yf cos(delta)) - l_r F_yr
    I_w domega/dt       = T - F_x R_eff                                  for each axle
    dkappa^/dt          = |v_x|/sigma (kappa - kappa^), and alpha^ alike  (the paper's equations 1 to 11)

States: v_x, v_y [m/s], r [rad/s], omega_f, omega_r [rad/s], the lagged slips (angles of right and left wheels), and
the lean of the body and its pitch with their rates, in units of the acceleration that they stand for [m/s^2]. A drive
mode says what is given and what is solved for: TORQUE integrates all of it, WHEEL_SPEED takes the measured wheel
speeds, SPEED the measured v_x and leaves only the lateral equations.
"""

import math
from typing import NamedTuple

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.axle import Slips, Tyres, axle_force, axle_side_force, mixed
from vehicle_sbi.physics.balance import SPEED, TORQUE, WHEEL_SPEED, Front, Outside, outside, pulls, settled
from vehicle_sbi.physics.body_forces import lateral_cog, road_bank, road_grade
from vehicle_sbi.physics.tyre import effective_radius, grips
from vehicle_sbi.physics.tyre_effects import (
    ignores_load,
    lag_rate,
    lag_share,
    lean_damping,
    lean_period,
    lean_share,
    leans,
    moves_load_across,
    pitch_damping,
    pitch_period,
    pitches,
    wheels_differ,
)

DRIVES = {"torque": TORQUE, "wheel_speed": WHEEL_SPEED, "speed": SPEED}

INPUTS = (
    "steering", "torque_front", "torque_rear", "v_x", "v_x_dot", "wheel_speed_front", "wheel_speed_rear", "time",
    "latent",
)  # fmt: skip
DELTA, T_F, T_R, U_V_X, U_V_X_DOT, U_OMEGA_F, U_OMEGA_R, TIME, U_LATENT = range(len(INPUTS))
COMMANDS = INPUTS[:3]  # what a driver or an actuator is told

STATES = 15
V_X, V_Y, R, OMEGA_F, OMEGA_R, KAPPA_F, KAPPA_R, ALPHA_FR, ALPHA_RR, ALPHA_FL, ALPHA_RL = range(STATES - 4)
LEAN, LEANING, PITCH, PITCHING = range(STATES - 4, STATES)
WHEELS, OMEGA, KAPPA = 2, OMEGA_F, KAPPA_F  # one an axle, and the first of their states
ALIKE, LEVEL = ALPHA_FL, PITCH  # of these states a car has whose wheels are alike, and one whose body does not pitch

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
def torque_slope(torque: float, omega: float) -> float:
    """By how much a brake's torque [N m] falls per rad/s of a wheel's speed, where it fades."""
    return -2.0 * torque * max(1.0 - abs(omega), 0.0) if torque < 0.0 else 0.0


@compiled
def tangent(alpha: float) -> float:
    """tan(alpha), with alpha limited to STEEPEST."""
    return math.tan(min(max(alpha, -STEEPEST), STEEPEST))


@compiled
def impose(p, drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording."""
    if drive == WHEEL_SPEED:
        state[OMEGA_F] = u[U_OMEGA_F]
        state[OMEGA_R] = u[U_OMEGA_R]
    elif drive == SPEED:
        state[V_X] = u[U_V_X]


class Wheels(NamedTuple):
    """A value of each wheel of an axle."""

    right: float
    left: float


class Car(NamedTuple):
    """What stays as it is at one moment while loads and forces settle."""

    drive: int
    share_f: float  # of the slips that lag
    share_r: float
    outside: Outside
    v_x: float  # along both axles [m/s]
    v_yf: float  # across the front axle [m/s]
    omega_f: float  # [rad/s]
    omega_r: float
    kappa_f: float  # lagged slips, the front ones across too [rad]
    kappa_r: float
    alpha_f: Wheels
    moving_f: Wheels  # where front wheels move [rad]
    tan_f: Wheels  # tangents of slip angles, of the front ones as far as they lag, of the rear ones as they act
    tan_r: Wheels
    at_once: float  # share of what a turn moves across that follows its acceleration at once
    leant: float  # acceleration [m/s^2] that the rest of it has followed
    ahead_at_once: float  # the same of what braking moves between the axles
    pitched: float


class Rolling(NamedTuple):
    """How the wheels roll under their loads."""

    R_f: float  # effective radii [m]
    R_r: float
    kappa_f: float  # slips without lag
    kappa_r: float


class Forces(NamedTuple):
    """What the axles' tyres do to the car."""

    a_x: float  # [m/s^2]
    a_y: float
    final: bool  # whether the loads of these accelerations leave all forces exactly as they are
    even: bool  # whether both wheels of each axle are found to have the same torque
    F_xf: float  # in the wheels' own directions [N]
    F_yf: float
    F_along: float  # of both axles along the car [N]
    F_lateral_f: float  # across the car [N]
    F_xr: float
    F_yr: float
    beyond_f: float  # by how much the mean slip of an axle's wheels is beyond that of their mean speed
    beyond_r: float
    M_z: float  # yaw moment [N m] of what differs between right and left


@compiled
def loads(p, car: Car, a_x: float) -> tuple[float, float]:
    """Loads [N] of the front and rear axle under an acceleration a_x [m/s^2]."""
    shift = p.load_transfer * (car.ahead_at_once * (a_x + car.outside.g_x) + car.pitched)
    return p.F_zf_static - shift + car.outside.press_f, p.F_zr_static + shift + car.outside.press_r


@compiled
def tyres(p, out: Outside, F_zf: float, F_zr: float, moved: float) -> tuple[Tyres, Tyres]:
    """Both axles under their loads [N], which have moved across as an acceleration [m/s^2] asks."""
    C_kf, C_f, mu_f = p.stiff_f * p.C_kappa_f, p.stiff_f * p.C_alpha_f, p.slide_f * out.mu
    C_kr, C_r, mu_r = p.stiff_r * p.C_kappa_r, p.stiff_r * p.C_alpha_r, p.slide_r * out.mu
    return (
        Tyres(C_kf, C_f, mu_f, F_zf, F_zf / p.F_zf_static, moved),
        Tyres(C_kr, C_r, mu_r, F_zr, F_zr / p.F_zr_static, moved),
    )


@compiled
def rolling(p, car: Car, front: Front, F_zf: float, F_zr: float) -> Rolling:
    """Radii and slips of wheels under axle loads [N]; no slip where the drive mode has none."""
    if car.drive == SPEED:
        return Rolling(p.R_front, p.R_rear, 0.0, 0.0)
    v_wheel_f = car.v_x * front.cosine + car.v_yf * front.sine
    R_f, R_r = effective_radius(p.R_front, p.C_vert, F_zf), effective_radius(p.R_rear, p.C_vert, F_zr)
    return Rolling(R_f, R_r, slip(R_f * car.omega_f, v_wheel_f), slip(R_r * car.omega_r, car.v_x))


@compiled
def moving(p, v_across: float, speed: float, r: float) -> Wheels:
    """Directions [rad] in which an axle's wheels move, at v_x +- r track/2."""
    if p.lateral_load_transfer_track == 0.0:
        middle = math.atan(v_across / speed)
        return Wheels(middle, middle)
    more = 0.5 * p.lateral_load_transfer_track * r
    return Wheels(math.atan(v_across / regular(speed + more)), math.atan(v_across / regular(speed - more)))


@compiled
def mixed_angles(share: float, lagged: Wheels, delta: float, moving: Wheels) -> Wheels:
    """Slip angles [rad] of wheels at an angle delta, of which a share lags."""
    return Wheels(mixed(share, lagged.right, delta - moving.right), mixed(share, lagged.left, delta - moving.left))


@compiled
def right_faster(p, v_x: float, steady: float) -> float:
    """Share by which right wheels move faster than the middle of their axle, r track / (2 v_x), in a `steady` turn of
    v_x r [m/s^2]; half of it at most, as where a car spins."""
    share = 0.5 * p.lateral_load_transfer_track * steady / regular(v_x) ** 2
    return min(max(share, -0.5), 0.5)


@compiled
def tangents(alpha: Wheels) -> Wheels:
    """Tangents of both wheels' slip angles [rad]."""
    right = tangent(alpha.right)
    return Wheels(right, right if alpha.left == alpha.right else tangent(alpha.left))


@compiled
def forces(p, car: Car, front: Front, a_x: float, a_y: float) -> Forces:
    """Forces of both axles under the loads of an acceleration a_x [m/s^2], and the acceleration that they cause.

    a_y is passed on where it moves no load. Tyres whose slips lag and that do not saturate, neither under these loads
    nor under those of the acceleration that they cause, have the same forces under both. How unequal the slips of an
    axle's wheels are is kept: the next search begins there.
    """
    out, relaxed = car.outside, car.share_f == 1.0 and car.share_r == 1.0
    F_zf, F_zr = loads(p, car, a_x)
    moved = car.at_once * (a_y + road_bank(p)) + car.leant
    axle_f, axle_r = tyres(p, out, F_zf, F_zr, moved)
    tan_f, kappa_f, kappa_r = car.tan_f, 0.0, 0.0
    if car.share_f < 1.0:
        tan_f = tangents(mixed_angles(car.share_f, car.alpha_f, front.delta, car.moving_f))
    if not relaxed and car.drive != SPEED:
        _, _, kappa_f, kappa_r = rolling(p, car, front, F_zf, F_zr)
    faster = right_faster(p, car.v_x, out.steady)
    slips_f = Slips(kappa_f, car.kappa_f, car.share_f, faster, tan_f.right, tan_f.left, p.split_f, p.slope_f)
    slips_r = Slips(kappa_r, car.kappa_r, car.share_r, faster, car.tan_r.right, car.tan_r.left, p.split_r, p.slope_r)
    if car.drive == SPEED:
        pull_f, pull_r = pulls(p, out, front, a_x)
        f = axle_side_force(p, axle_f, pull_f, slips_f, p.moved_f * moved)
        b = axle_side_force(p, axle_r, pull_r, slips_r, p.moved_r * moved)
    else:
        f, b = axle_force(p, axle_f, slips_f, p.moved_f * moved), axle_force(p, axle_r, slips_r, p.moved_r * moved)
        p.split_f, p.slope_f, p.split_r, p.slope_r = f.split, f.slope, b.split, b.slope
    F_along = f.F_x * front.cosine - f.F_y * front.sine + b.F_x
    F_lateral_f = f.F_x * front.sine + f.F_y * front.cosine
    M_z = 0.5 * p.lateral_load_transfer_track * (f.more_x * front.cosine - f.more_y * front.sine + b.more_x)
    solved = a_x if car.drive == SPEED else (F_along + out.push_x) / p.mass
    shifted = abs(p.load_transfer * (solved - a_x))
    final = relaxed and ignores_load(p)
    final = final and grips(axle_f.mu, F_zf - shifted, f.F_x, f.F_y)
    final = final and grips(axle_r.mu, F_zr - shifted, b.F_x, b.F_y)
    solved_y = (F_lateral_f + b.F_y + out.push_y) / p.mass if moves_load_across(p) else a_y
    return Forces(
        solved, solved_y, final, f.even and b.even, f.F_x, f.F_y, F_along, F_lateral_f, b.F_x, b.F_y, f.beyond,
        b.beyond, M_z,
    )  # fmt: skip


@compiled
def ground(_, state, __: int) -> float:
    """Speed [m/s] of the car above a wheel."""
    return state[V_X]


@compiled
def turns_unevenly(p) -> bool:
    """Whether it changes anything that the wheels of an axle differ, or that the body leans."""
    return wheels_differ(p) or leans(p)


@compiled
def states(p) -> int:
    """How many of the states, the first ones, change anything."""
    if pitches(p):
        return STATES
    return LEVEL if turns_unevenly(p) else ALIKE


@compiled
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (15,) with d(state)/dt of the states that change anything.

    What of v_x and v_y it has on entry is where the loop between loads and forces starts.
    """
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    speed, v_yf = regular(v_x), v_y + p.l_front * r
    share_f, share_r = lag_share(p, p.sigma_f, speed), lag_share(p, p.sigma_r, speed)
    moving_f, moving_r = moving(p, v_yf, speed, r), moving(p, v_y - p.l_rear * r, speed, r)
    alpha_f, alpha_r = Wheels(state[ALPHA_FR], state[ALPHA_FR]), Wheels(state[ALPHA_RR], state[ALPHA_RR])
    changing, leaning, leant, pitching, pitched = states(p), 0.0, 0.0, 0.0, 0.0
    if changing > ALIKE:
        alpha_f, alpha_r = Wheels(alpha_f.right, state[ALPHA_FL]), Wheels(alpha_r.right, state[ALPHA_RL])
        leaning = lean_share(p)
        leant = leaning * (state[LEAN] + lean_damping(p) * state[LEANING])
    if changing > LEVEL:
        pitching = p.load_sensitivity_sprung
        pitched = pitching * (state[PITCH] + pitch_damping(p) * state[PITCHING])
    given = u[U_V_X_DOT] if drive == SPEED else rate[V_X]
    out = outside(p, u[DELTA], v_x, r, u[TIME], u[U_LATENT])
    car = Car(
        drive=drive,
        share_f=share_f,
        share_r=share_r,
        outside=out,
        v_x=v_x,
        v_yf=v_yf,
        omega_f=state[OMEGA_F],
        omega_r=state[OMEGA_R],
        kappa_f=state[KAPPA_F],
        kappa_r=state[KAPPA_R],
        alpha_f=alpha_f,
        moving_f=moving_f,
        tan_f=tangents(alpha_f),
        tan_r=tangents(mixed_angles(share_r, alpha_r, 0.0, moving_r)),
        at_once=1.0 - leaning,
        leant=leant,
        ahead_at_once=1.0 - pitching,
        pitched=pitched,
    )
    found, front, a_x, _ = settled(forces, p, car, given - v_y * r, rate[V_Y] + v_x * r)
    F_zf, F_zr = loads(p, car, a_x)
    rolls = rolling(p, car, front, F_zf, F_zr)

    rate[V_X] = a_x + v_y * r
    rate[V_Y] = (found.F_lateral_f + found.F_yr + out.push_y) / p.mass - v_x * r
    moment = out.moment_z + lateral_cog(p, found.F_along) + found.M_z
    rate[R] = (p.l_front * found.F_lateral_f - p.l_rear * found.F_yr + moment) / (p.I_z + p.I_wheels)
    T_f, T_r = wheel_torque(u[T_F], state[OMEGA_F]), wheel_torque(u[T_R], state[OMEGA_R])
    rate[OMEGA_F] = (T_f - found.F_xf * rolls.R_f) / p.I_wf if drive == TORQUE else 0.0
    rate[OMEGA_R] = (T_r - found.F_xr * rolls.R_r) / p.I_wr if drive == TORQUE else 0.0
    fade_f, fade_r = lag_rate(p, p.sigma_f, speed), lag_rate(p, p.sigma_r, speed)
    rate[KAPPA_F] = fade_f * (rolls.kappa_f + found.beyond_f - state[KAPPA_F])
    rate[KAPPA_R] = fade_r * (rolls.kappa_r + found.beyond_r - state[KAPPA_R])
    rate[ALPHA_FR] = fade_f * (front.delta - moving_f.right - alpha_f.right)
    rate[ALPHA_RR] = fade_r * (-moving_r.right - alpha_r.right)
    if changing > ALIKE:
        rate[ALPHA_FL] = fade_f * (front.delta - moving_f.left - alpha_f.left)
        rate[ALPHA_RL] = fade_r * (-moving_r.left - alpha_r.left)
        rate[LEAN] = rate[LEANING] = 0.0
        if leaning > 0.0:
            swing(LEAN, lean_period(p), lean_damping(p), rate[V_Y] + v_x * r + road_bank(p), state, rate)
    if changing > LEVEL:
        swing(PITCH, pitch_period(p), pitch_damping(p), a_x + out.g_x, state, rate)


@compiled
def swing(angle: int, T: float, damped: float, felt: float, state, rate) -> None:
    """Fill d/dt of the body's lean or pitch and of its rate, of the period 2 pi T [s], under the acceleration [m/s^2]
    that it feels."""
    rate[angle] = state[angle + 1]
    rate[angle + 1] = (felt - state[angle] - damped * state[angle + 1]) / (T * T)


@compiled
def contact_speed(p, delta: float, v_x: float, v_y: float, r: float) -> float:
    """Speed [m/s] of the front contact point in the wheel's own plane."""
    return v_x * math.cos(delta) + (v_y + p.l_front * r) * math.sin(delta)


@compiled
def rolling_radii(p) -> tuple[float, float]:
    """Effective radii [m] of the front and rear tyres under their static loads."""
    return effective_radius(p.R_front, p.C_vert, p.F_zf_static), effective_radius(p.R_rear, p.C_vert, p.F_zr_static)


@compiled_apart
def start(p, drive: int, u, initial, state) -> None:
    """Fill the state at the first sample from (v_x, v_y, r): wheels rolling freely, or as recorded, slips and the body
    settled."""
    state[V_X], state[V_Y], state[R] = initial[0], initial[1], initial[2]
    state[LEAN], state[LEANING] = initial[0] * initial[2] + road_bank(p), 0.0
    pushed = u[U_V_X_DOT] - initial[1] * initial[2] if drive == SPEED else (u[T_F] + u[T_R]) / (p.R_f * p.mass)
    state[PITCH], state[PITCHING] = pushed + road_grade(p, u[TIME]), 0.0
    v_wheel_f = contact_speed(p, u[DELTA], state[V_X], state[V_Y], state[R])
    R_f, R_r = rolling_radii(p)
    state[OMEGA_F], state[OMEGA_R] = v_wheel_f / R_f, state[V_X] / R_r
    impose(p, drive, u, state)
    speed = regular(state[V_X])
    front = moving(p, state[V_Y] + p.l_front * state[R], speed, state[R])
    rear = moving(p, state[V_Y] - p.l_rear * state[R], speed, state[R])
    state[ALPHA_FR], state[ALPHA_FL] = u[DELTA] - front.right, u[DELTA] - front.left
    state[ALPHA_RR], state[ALPHA_RL] = -rear.right, -rear.left
    state[KAPPA_F] = slip(R_f * state[OMEGA_F], v_wheel_f) if drive == WHEEL_SPEED else 0.0
    state[KAPPA_R] = slip(R_r * state[OMEGA_R], state[V_X]) if drive == WHEEL_SPEED else 0.0


@compiled_apart
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
