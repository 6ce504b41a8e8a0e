"""The paper's single-track model: equations of motion, and their integrator.

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

import numpy as np
from numba import njit, prange

from vehicle_sbi.physics.effects import body_force, derive, road_wheel_angle
from vehicle_sbi.physics.sensors import MEASUREMENTS, MOTION, measure, report
from vehicle_sbi.physics.tyre import dugoff, effective_radius

TORQUE, WHEEL_SPEED, SPEED = 0, 1, 2
DRIVES = {"torque": TORQUE, "wheel_speed": WHEEL_SPEED, "speed": SPEED}

INPUTS = ("steering", "torque_front", "torque_rear", "v_x", "v_x_dot", "wheel_speed_front", "wheel_speed_rear")
DELTA, T_F, T_R, U_V_X, U_V_X_DOT, U_OMEGA_F, U_OMEGA_R = range(len(INPUTS))

STATES = 9
V_X, V_Y, R, OMEGA_F, OMEGA_R, KAPPA_F, KAPPA_R, ALPHA_F, ALPHA_R = range(STATES)

FINISHED, SPUN_OUT, NOT_FINITE = 0, 1, 2
LOAD_TOLERANCE = 1e-9  # [m/s^2], where the loop between load transfer and longitudinal force stops
LOAD_ITERATIONS = 50
STEEPEST = 1.5  # [rad], the largest slip angle whose tangent is taken


@njit(cache=True)
def regular(v: float) -> float:
    """|v| [m/s], kept above 0.5 by a parabola that joins it smoothly at 1 m/s, where the model's range ends."""
    v = abs(v)
    return v if v >= 1.0 else 0.5 * (1.0 + v * v)


@njit(cache=True)
def slip(R_omega: float, v_wheel: float) -> float:
    """Longitudinal slip kappa (the paper's equation 4), a wheel that turns backwards counted as locked."""
    return max((R_omega - v_wheel) / regular(max(R_omega, v_wheel)), -1.0)


@njit(cache=True)
def wheel_torque(torque: float, omega: float) -> float:
    """Net axle torque [N m]; a brake opposes rotation, so its torque fades below 1 rad/s and changes sign with it."""
    if torque >= 0.0 or omega >= 1.0:
        return torque
    if omega <= -1.0:
        return -torque
    return torque * omega * (2.0 - abs(omega))


@njit(cache=True)
def tangent(alpha: float) -> float:
    """tan(alpha), with alpha limited to STEEPEST."""
    return math.tan(min(max(alpha, -STEEPEST), STEEPEST))


@njit(cache=True)
def impose(drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording."""
    if drive == WHEEL_SPEED:
        state[OMEGA_F] = u[U_OMEGA_F]
        state[OMEGA_R] = u[U_OMEGA_R]
    elif drive == SPEED:
        state[V_X] = u[U_V_X]


@njit(cache=True)
def derivatives(p, drive: int, u, state, rate) -> None:
    """Fill rate (9,) with d(state)/dt; rate[V_X] on entry is the guess from which the load-transfer loop starts.

    F_x depends on F_z and F_z on a_x: fixed-point iteration, whose factor is below mu h / L.
    """
    v_x, v_y, r = state[V_X], state[V_Y], state[R]
    sin_delta, cos_delta = math.sin(u[DELTA]), math.cos(u[DELTA])
    v_yf, v_yr = v_y + p.l_f * r, v_y - p.l_r * r
    speed = regular(v_x)
    alpha_f = u[DELTA] - math.atan(v_yf / speed)
    alpha_r = -math.atan(v_yr / speed)
    relaxed = p.sigma_f > 0.0
    tan_f = tangent(state[ALPHA_F] if relaxed else alpha_f)
    tan_r = tangent(state[ALPHA_R] if relaxed else alpha_r)
    v_wheel_f = v_x * cos_delta + v_yf * sin_delta
    extra_x, extra_y = body_force(p, v_x)

    F_xf = F_yf = F_xr = F_yr = kappa_f = kappa_r = 0.0
    R_f = R_r = p.R_f
    a_x = u[U_V_X_DOT] - v_y * r if drive == SPEED else rate[V_X] - v_y * r
    for _ in range(LOAD_ITERATIONS):
        F_zf, F_zr = p.F_zf_static - p.load_transfer * a_x, p.F_zr_static + p.load_transfer * a_x
        if drive != SPEED:
            R_f, R_r = effective_radius(p.R_f, p.C_vert, F_zf), effective_radius(p.R_f, p.C_vert, F_zr)
            kappa_f, kappa_r = slip(R_f * state[OMEGA_F], v_wheel_f), slip(R_r * state[OMEGA_R], v_x)
        F_xf, F_yf = dugoff(p.C_kappa_f, p.C_alpha_f, p.grip, F_zf, state[KAPPA_F] if relaxed else kappa_f, tan_f)
        F_xr, F_yr = dugoff(p.C_kappa_r, p.C_alpha_r, p.grip, F_zr, state[KAPPA_R] if relaxed else kappa_r, tan_r)
        solved = (F_xf * cos_delta - F_yf * sin_delta + F_xr + extra_x) / p.m
        converged = drive == SPEED or abs(solved - a_x) < LOAD_TOLERANCE
        if converged:
            break
        a_x = solved

    F_lateral_f = F_xf * sin_delta + F_yf * cos_delta
    rate[V_X] = a_x + v_y * r
    rate[V_Y] = (F_lateral_f + F_yr + extra_y) / p.m - v_x * r
    rate[R] = (p.l_f * F_lateral_f - p.l_r * F_yr) / p.I_z
    rate[OMEGA_F] = (wheel_torque(u[T_F], state[OMEGA_F]) - F_xf * R_f) / p.I_wf if drive == TORQUE else 0.0
    rate[OMEGA_R] = (wheel_torque(u[T_R], state[OMEGA_R]) - F_xr * R_r) / p.I_wr if drive == TORQUE else 0.0
    fade_f = speed / p.sigma_f if relaxed else 0.0
    fade_r = speed / p.sigma_r if relaxed else 0.0
    rate[KAPPA_F] = fade_f * (kappa_f - state[KAPPA_F])
    rate[KAPPA_R] = fade_r * (kappa_r - state[KAPPA_R])
    rate[ALPHA_F] = fade_f * (alpha_f - state[ALPHA_F])
    rate[ALPHA_R] = fade_r * (alpha_r - state[ALPHA_R])


@njit(cache=True)
def contact_speed(p, delta: float, v_x: float, v_y: float, r: float) -> float:
    """Speed [m/s] of the front contact point in the wheel's own plane."""
    return v_x * math.cos(delta) + (v_y + p.l_f * r) * math.sin(delta)


@njit(cache=True)
def start(p, drive: int, u, initial, state) -> None:
    """Fill the state at the first sample from (v_x, v_y, r): wheels rolling freely, or as recorded, slips settled."""
    state[V_X], state[V_Y], state[R] = initial[0], initial[1], initial[2]
    v_wheel_f = contact_speed(p, u[DELTA], state[V_X], state[V_Y], state[R])
    R_f = effective_radius(p.R_f, p.C_vert, p.F_zf_static)
    R_r = effective_radius(p.R_f, p.C_vert, p.F_zr_static)
    state[OMEGA_F], state[OMEGA_R] = v_wheel_f / R_f, state[V_X] / R_r
    impose(drive, u, state)
    speed = regular(state[V_X])
    state[ALPHA_F] = u[DELTA] - math.atan((state[V_Y] + p.l_f * state[R]) / speed)
    state[ALPHA_R] = -math.atan((state[V_Y] - p.l_r * state[R]) / speed)
    state[KAPPA_F] = slip(R_f * state[OMEGA_F], v_wheel_f) if drive == WHEEL_SPEED else 0.0
    state[KAPPA_R] = slip(R_r * state[OMEGA_R], state[V_X]) if drive == WHEEL_SPEED else 0.0


@njit(cache=True)
def blend(u, k: int, share: float, out) -> None:
    """The inputs at `share` of the way from sample k to the next, linear between samples; u (time, 7)."""
    for i in range(u.shape[1]):
        out[i] = u[k, i] + share * (u[k + 1, i] - u[k, i])


@njit(cache=True)
def advance(state, rate, h: float, out) -> None:
    """out = state + h rate."""
    for i in range(STATES):
        out[i] = state[i] + h * rate[i]


@njit(cache=True)
def runge_kutta(p, drive: int, u, k: int, substeps: int, dt: float, state, work) -> None:
    """Take the state from sample k to the next in `substeps` classical fourth-order steps; work (6, 9).

    work[0] holds d(state)/dt at sample k on entry.
    """
    k1, k2, k3, k4, trial, now = work[0], work[1], work[2], work[3], work[4], work[5, :7]
    h = dt / substeps
    for step in range(substeps):
        if step > 0:
            blend(u, k, step / substeps, now)
            derivatives(p, drive, now, state, k1)
        blend(u, k, (step + 0.5) / substeps, now)
        advance(state, k1, 0.5 * h, trial)
        impose(drive, now, trial)
        k2[V_X] = k1[V_X]
        derivatives(p, drive, now, trial, k2)
        advance(state, k2, 0.5 * h, trial)
        impose(drive, now, trial)
        k3[V_X] = k2[V_X]
        derivatives(p, drive, now, trial, k3)
        blend(u, k, (step + 1.0) / substeps, now)
        advance(state, k3, h, trial)
        impose(drive, now, trial)
        k4[V_X] = k3[V_X]
        derivatives(p, drive, now, trial, k4)
        for i in range(STATES):
            state[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        impose(drive, now, state)


@njit(cache=True)
def drive_through(p, drive: int, u, stiffness_noise, dt: float, substeps: int, initial, motion) -> int:
    """Integrate one window and record MOTION at every sample; returns FINISHED, SPUN_OUT or NOT_FINITE.

    stiffness_noise (draws, 4) is added to (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad]: one draw for the
    whole window, or one per sample.
    """
    C = (p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r)
    state, work = np.zeros(STATES), np.zeros((6, STATES))
    outcome = FINISHED
    for k in range(u.shape[0]):
        if k < len(stiffness_noise):
            p.C_kappa_f = C[0] + stiffness_noise[k, 0]
            p.C_kappa_r = C[1] + stiffness_noise[k, 1]
            p.C_alpha_f = C[2] + stiffness_noise[k, 2]
            p.C_alpha_r = C[3] + stiffness_noise[k, 3]
            derive(p)
        if k == 0:
            start(p, drive, u[0], initial, state)
        rate = work[0]
        derivatives(p, drive, u[k], state, rate)
        v_x, v_y, r = state[V_X], state[V_Y], state[R]
        motion[k, 0], motion[k, 1], motion[k, 2] = v_x, v_y, r
        motion[k, 3], motion[k, 4], motion[k, 5] = rate[V_X] - v_y * r, rate[V_Y] + v_x * r, rate[R]
        motion[k, 6], motion[k, 7] = state[OMEGA_F], state[OMEGA_R]
        if not math.isfinite(v_x + v_y + r + state[OMEGA_F] + state[OMEGA_R]):
            outcome = NOT_FINITE
            break
        if abs(v_y) > regular(v_x):
            outcome = SPUN_OUT
            break
        if k + 1 < u.shape[0]:
            runge_kutta(p, drive, u, k, substeps, dt, state, work)
    p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r = C
    return outcome


@njit(cache=True)
def free_wheels(p, u, motion) -> None:
    """Wheel speeds [rad/s] of freely rolling wheels, for the drive mode that does not solve for them; u (time, 7)."""
    R_f = effective_radius(p.R_f, p.C_vert, p.F_zf_static)
    R_r = effective_radius(p.R_f, p.C_vert, p.F_zr_static)
    for k in range(motion.shape[0]):
        motion[k, 6] = contact_speed(p, u[k, DELTA], motion[k, 0], motion[k, 1], motion[k, 2]) / R_f
        motion[k, 7] = motion[k, 0] / R_r


@njit(cache=True)
def actuate(p, u, input_noise, rate: float, out) -> None:
    """What reaches the wheels: steering through its effects, torques as recorded, both with their relative noise.

    u, out (time, 7); input_noise (draws, 2) for steering and torques, one draw for the window or one per sample.
    """
    for k in range(u.shape[0]):
        i = min(k, len(input_noise) - 1)
        out[k] = u[k]
        out[k, DELTA] = (1.0 + input_noise[i, 0]) * road_wheel_angle(p, u[:, DELTA], k, rate)
        out[k, T_F] = (1.0 + input_noise[i, 1]) * u[k, T_F]
        out[k, T_R] = (1.0 + input_noise[i, 1]) * u[k, T_R]


@njit(cache=True)
def simulate(p, drive: int, u, stiffness_noise, input_noise, rate: float, substeps: int, initial, channels, groups, y):
    """One simulation over all windows: fill y (channels, windows * time), NaN if it fails; returns its outcome.

    u (windows, time, 7), initial (windows, 3), channels and groups index MEASUREMENTS and GROUPS.
    """
    windows, time = u.shape[0], u.shape[1]
    motion, reading = np.empty((time, len(MOTION))), np.empty((len(MEASUREMENTS), time))
    acting = np.empty((time, u.shape[2]))
    derive(p)
    for w in range(windows):
        actuate(p, u[w], input_noise, rate, acting)
        outcome = drive_through(p, drive, acting, stiffness_noise, 1.0 / rate, substeps, initial[w], motion)
        if outcome != FINISHED:
            y[:] = np.nan
            return outcome
        if drive == SPEED:
            free_wheels(p, acting, motion)
        measure(p, motion, rate, reading)
        for i in range(len(channels)):
            report(p, reading[channels[i]], groups[i], rate, y[i, w * time : (w + 1) * time])
    return FINISHED


@njit(cache=True, parallel=True)
def simulate_batch(
    records, drive, u, stiffness_noise, input_noise, rate, substeps, initial, channels, groups, y, outcomes
):
    """Simulations in parallel: records (n,), stiffness_noise (n, draws, 4), input_noise (n, draws, 2),
    initial (n, windows, 3), y (n, channels, windows * time), outcomes (n,)."""
    for i in prange(len(records)):
        outcomes[i] = simulate(
            records[i], drive, u, stiffness_noise[i], input_noise[i], rate, substeps, initial[i], channels, groups, y[i]
        )


def fastest_rate(record: np.void, drive: str, v_min: float) -> float:
    """The fastest eigenvalue [1/s] of the model linearised about straight driving at v_min, tyres vertically rigid.

    An upper bound without relaxation, good to a fifth with it. The wheels' slip modes are no faster than
    R^2 C_kappa / (I_w v) + sum(C_kappa) / (m v), the body between recorded wheels has the last term, and the lateral
    pair has a known trace and determinant (Rajamani, sec. 2.5). Behind a relaxation of rate c = v/sigma a mode of rate
    d becomes s^2 + c s + c d = 0, whose roots are sqrt(c d) where they oscillate and below c where they do not.
    """
    p, v = record, max(v_min, 1.0)
    m, l_f, l_r = p["m"], p["l_f"], p["L"] - p["l_f"]
    I_z = p["yaw_inertia_factor"] * (p["I_z_stated"] or m * l_f * l_r)
    C_f, C_r = p["C_alpha_f"], p["C_alpha_r"]
    half_trace = 0.5 * ((C_f + C_r) / (m * v) + (l_f**2 * C_f + l_r**2 * C_r) / (I_z * v))
    determinant = p["L"] ** 2 * C_f * C_r / (m * I_z * v**2) + (l_r * C_r - l_f * C_f) / I_z
    oscillates = determinant > half_trace**2
    rigid = [np.sqrt(determinant) if oscillates else half_trace + np.sqrt(half_trace**2 - determinant)]
    if drive != "speed":
        rigid.append((p["C_kappa_f"] + p["C_kappa_r"]) / (m * v))
    if drive == "torque":
        rigid += [rigid[1] + p["R_f"] ** 2 * p[f"C_kappa_{axle}"] / (p[f"I_w{axle}"] * v) for axle in "fr"]
    lag = v * p["K"] / min(C_f, C_r)
    return max(rigid) if np.isinf(lag) else max(lag, np.sqrt(lag * max(rigid)))


def substeps_for(records: np.ndarray, drive: str, v_min: float, rate: float, limit: float = 1.0) -> int:
    """Runge-Kutta steps per sample so that step times fastest eigenvalue stays below `limit` for every record.

    At 1 the fourth-order method is far inside its stability bound of 2.78 and its error per step in that mode is
    below 1/5! of the mode's amplitude, in the modes that matter to the sensors orders of magnitude less.
    """
    fastest = max(fastest_rate(record, drive, v_min) for record in records)
    return max(1, int(np.ceil(fastest / (rate * limit))))
