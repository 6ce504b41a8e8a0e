"""A simulation: commands through actuators, equations of motion through an integrator, motion through sensors.

MODELS says which equations of motion are integrated; inputs, effects, sensors and the integrator are the same for all.
"""

import math

import numpy as np
from numba import njit, prange

from vehicle_sbi.physics import full_vehicle, single_track
from vehicle_sbi.physics.effects import derive, steer, torques
from vehicle_sbi.physics.sensors import MEASUREMENTS, MOTION, measure, report
from vehicle_sbi.physics.single_track import DELTA, T_F, T_R, TIME, regular
from vehicle_sbi.physics.vehicle import GRAVITY

SINGLE_TRACK, FULL_VEHICLE = 0, 1
MODELS = {"single_track": SINGLE_TRACK, "full_vehicle": FULL_VEHICLE}
STATES = (single_track.STATES, full_vehicle.STATES)
V_X, V_Y = 0, 1  # the first states of every model

FINISHED, SPUN_OUT, NOT_FINITE = 0, 1, 2


@njit(cache=True)
def impose(p, model: int, drive: int, u, state) -> None:
    """Overwrite the states that the drive mode takes from the recording."""
    if model == FULL_VEHICLE:
        full_vehicle.impose(p, drive, u, state)
    else:
        single_track.impose(drive, u, state)


@njit(cache=True)
def derivatives(p, model: int, drive: int, u, state, rate) -> None:
    """Fill rate (states,) with d(state)/dt; what it holds on entry is the guess of what the loads depend on."""
    if model == FULL_VEHICLE:
        full_vehicle.derivatives(p, drive, u, state, rate)
    else:
        single_track.derivatives(p, drive, u, state, rate)


@njit(cache=True)
def start(p, model: int, drive: int, u, initial, state) -> None:
    """Fill the state (states,) at the first sample from (v_x, v_y, r)."""
    if model == FULL_VEHICLE:
        full_vehicle.start(p, drive, u, initial, state)
    else:
        single_track.start(p, drive, u, initial, state)


@njit(cache=True)
def record(p, model: int, drive: int, u, state, rate, motion) -> None:
    """Fill motion (14,) with MOTION at one sample."""
    if model == FULL_VEHICLE:
        full_vehicle.record(p, drive, u, state, rate, motion)
    else:
        single_track.record(p, drive, u, state, rate, motion)


@njit(cache=True)
def blend(u, k: int, share: float, out) -> None:
    """The inputs at `share` of the way from sample k to the next, linear between samples; u (time, 8)."""
    for i in range(u.shape[1]):
        out[i] = u[k, i] + share * (u[k + 1, i] - u[k, i])


@njit(cache=True)
def advance(state, rate, h: float, out) -> None:
    """out = state + h rate."""
    for i in range(len(state)):
        out[i] = state[i] + h * rate[i]


@njit(cache=True)
def runge_kutta(p, model: int, drive: int, u, k: int, substeps: int, dt: float, state, work) -> None:
    """Take the state from sample k to the next in `substeps` classical fourth-order steps; work (6, states).

    work[0] holds d(state)/dt at sample k on entry.
    """
    k1, k2, k3, k4, trial, now = work[0], work[1], work[2], work[3], work[4], work[5, : u.shape[1]]
    h = dt / substeps
    for step in range(substeps):
        if step > 0:
            blend(u, k, step / substeps, now)
            derivatives(p, model, drive, now, state, k1)
        blend(u, k, (step + 0.5) / substeps, now)
        advance(state, k1, 0.5 * h, trial)
        impose(p, model, drive, now, trial)
        k2[V_X], k2[V_Y] = k1[V_X], k1[V_Y]
        derivatives(p, model, drive, now, trial, k2)
        advance(state, k2, 0.5 * h, trial)
        impose(p, model, drive, now, trial)
        k3[V_X], k3[V_Y] = k2[V_X], k2[V_Y]
        derivatives(p, model, drive, now, trial, k3)
        blend(u, k, (step + 1.0) / substeps, now)
        advance(state, k3, h, trial)
        impose(p, model, drive, now, trial)
        k4[V_X], k4[V_Y] = k3[V_X], k3[V_Y]
        derivatives(p, model, drive, now, trial, k4)
        for i in range(len(state)):
            state[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        impose(p, model, drive, now, state)


@njit(cache=True)
def drive_through(p, model: int, drive: int, u, stiffness_noise, dt: float, substeps: int, initial, motion) -> int:
    """Integrate one window and record MOTION at every sample; returns FINISHED, SPUN_OUT or NOT_FINITE.

    stiffness_noise (draws, 4) is added to (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad]: one draw for the
    whole window, or one per sample.
    """
    C = (p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r)
    state, work = np.zeros(STATES[model]), np.zeros((6, STATES[model]))
    motion[:] = 0.0
    outcome = FINISHED
    for k in range(u.shape[0]):
        if k < len(stiffness_noise):
            p.C_kappa_f = C[0] + stiffness_noise[k, 0]
            p.C_kappa_r = C[1] + stiffness_noise[k, 1]
            p.C_alpha_f = C[2] + stiffness_noise[k, 2]
            p.C_alpha_r = C[3] + stiffness_noise[k, 3]
            derive(p)
        if k == 0:
            start(p, model, drive, u[0], initial, state)
        rate = work[0]
        derivatives(p, model, drive, u[k], state, rate)
        record(p, model, drive, u[k], state, rate, motion[k])
        if not math.isfinite(motion[k].sum()):
            outcome = NOT_FINITE
            break
        if abs(state[V_Y]) > regular(state[V_X]):
            outcome = SPUN_OUT
            break
        if k + 1 < u.shape[0]:
            runge_kutta(p, model, drive, u, k, substeps, dt, state, work)
    p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r = C
    return outcome


@njit(cache=True)
def actuate(p, u, input_noise, rate: float, out) -> None:
    """What reaches the wheels: steering and torques through their effects, both with their relative noise.

    u, out (time, 8); input_noise (draws, 2) for steering and torques, one draw for the window or one per sample.
    """
    out[:] = u
    steer(p, u[:, DELTA], rate, out[:, DELTA])
    for k in range(u.shape[0]):
        i = min(k, len(input_noise) - 1)
        T_f, T_r = torques(p, u[:, T_F], u[:, T_R], k, rate)
        out[k, DELTA] *= 1.0 + input_noise[i, 0]
        out[k, T_F] = (1.0 + input_noise[i, 1]) * T_f
        out[k, T_R] = (1.0 + input_noise[i, 1]) * T_r


@njit(cache=True)
def simulate(
    p, model: int, drive: int, u, stiffness_noise, input_noise, rate: float, substeps: int, initial, channels, groups, y
):
    """One simulation over all windows: fill y (channels, windows * time), NaN if it fails; returns its outcome.

    u (windows, time, 8), initial (windows, 3), channels and groups index MEASUREMENTS and GROUPS.
    """
    windows, time = u.shape[0], u.shape[1]
    motion, reading = np.empty((time, len(MOTION))), np.empty((len(MEASUREMENTS), time))
    acting = np.empty((time, u.shape[2]))
    derive(p)
    for w in range(windows):
        actuate(p, u[w], input_noise, rate, acting)
        outcome = drive_through(p, model, drive, acting, stiffness_noise, 1.0 / rate, substeps, initial[w], motion)
        if outcome != FINISHED:
            y[:] = np.nan
            return outcome
        measure(p, motion, acting[:, TIME], rate, reading)
        for i in range(len(channels)):
            report(p, reading[channels[i]], groups[i], rate, y[i, w * time : (w + 1) * time])
    return FINISHED


@njit(cache=True, parallel=True)
def simulate_batch(
    records, model, drive, u, stiffness_noise, input_noise, rate, substeps, initial, channels, groups, y, outcomes
):
    """Simulations in parallel: records (n,), stiffness_noise (n, draws, 4), input_noise (n, draws, 2),
    initial (n, windows, 3), y (n, channels, windows * time), outcomes (n,)."""
    for i in prange(len(records)):
        outcomes[i] = simulate(
            records[i],
            model,
            drive,
            u,
            stiffness_noise[i],
            input_noise[i],
            rate,
            substeps,
            initial[i],
            channels,
            groups,
            y[i],
        )


def fastest_rate(record: np.void, drive: str, v_min: float, model: str = "single_track") -> float:
    """The fastest eigenvalue [1/s] of the model linearised about straight driving at v_min, tyres vertically rigid.

    An upper bound without relaxation, good to a fifth with it. The wheels' slip modes are no faster than
    R^2 C_kappa / (I_w v) + sum(C_kappa) / (m v), the body between recorded wheels has the last term, and the lateral
    pair has a known trace and determinant (Rajamani, sec. 2.5). Behind a relaxation of rate c = v/sigma a mode of rate
    d becomes s^2 + c s + c d = 0, whose roots are sqrt(c d) where they oscillate and below c where they do not. In the
    full vehicle the tyres move less than all of m, the body swinging on its springs; it does so against the rest.
    """
    records, v = np.array([record]), max(v_min, 1.0)
    derive(records[0])
    p, swinging = records[0], []
    m_x = m_y = p["mass"]
    turning = 0.0  # what wheels at both sides that slip against each other add [1/s]
    if model == "full_vehicle":
        for axis in ("roll", "pitch"):
            lever, J = p[f"{axis}_lever"], p[f"{axis}_J"]
            J -= lever**2 / p["mass"]
            swinging.append(_faster_root(p[f"D_{axis}"] / J, abs(p[f"K_{axis}"] - GRAVITY * lever) / J))
        m_x, m_y = m_x - p["pitch_lever"] ** 2 / p["pitch_J"], m_y - p["roll_lever"] ** 2 / p["roll_J"]
        turning = sum(p[f"C_kappa_{axle}"] * p[f"track_{axle}"] ** 2 for axle in "fr") / (4.0 * p["I_z"] * v)
    l_f, l_r, I_z, C_f, C_r = p["l_front"], p["l_rear"], p["I_z"], p["C_alpha_f"], p["C_alpha_r"]
    trace = (C_f + C_r) / (m_y * v) + (l_f**2 * C_f + l_r**2 * C_r) / (I_z * v)
    determinant = p["L"] ** 2 * C_f * C_r / (m_y * I_z * v**2) + (l_r * C_r - l_f * C_f) / I_z
    rigid = [_faster_root(trace, determinant)]
    if drive != "speed":
        rigid.append((p["C_kappa_f"] + p["C_kappa_r"]) / (m_x * v))
    if drive == "torque":
        along = rigid[1] + turning
        rigid += [along + p[f"R_{a}"] ** 2 * p[f"C_kappa_{a[0]}"] / (p[f"I_w{a[0]}"] * v) for a in ("front", "rear")]
    sigma = min(p["sigma_f"], p["sigma_r"])
    behind = rigid if sigma == 0.0 else [v / sigma, np.sqrt(v / sigma * max(rigid))]
    return max([*swinging, *behind])


def _faster_root(trace: float, determinant: float) -> float:
    """Absolute value of the larger root of s^2 + trace s + determinant = 0, trace not negative."""
    discriminant = (0.5 * trace) ** 2 - determinant
    return 0.5 * trace + np.sqrt(discriminant) if discriminant >= 0.0 else np.sqrt(determinant)


def substeps_for(
    records: np.ndarray, drive: str, v_min: float, rate: float, limit: float = 1.0, model: str = "single_track"
) -> int:
    """Runge-Kutta steps per sample so that step times fastest eigenvalue stays below `limit` for every record.

    At 1 the fourth-order method is far inside its stability bound of 2.78 and its error per step in that mode is
    below 1/5! of the mode's amplitude, in the modes that matter to the sensors orders of magnitude less.
    """
    fastest = max(fastest_rate(record, drive, v_min, model) for record in records)
    return max(1, int(np.ceil(fastest / (rate * limit))))
