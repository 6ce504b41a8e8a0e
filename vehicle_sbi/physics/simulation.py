"""A simulation: commands through actuators, equations of motion through an integrator, motion through sensors.

MODELS says which equations of motion are integrated; inputs, effects, sensors and the integrator are the same for all.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart, compiled_beside
from vehicle_sbi.physics import full_vehicle, single_track
from vehicle_sbi.physics.balance import forget
from vehicle_sbi.physics.body_forces import latent_sensor, latent_steering
from vehicle_sbi.physics.commands import steer, torques
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.rolling import linearise_wheels, roll_wheels, set_wheels, slipping_wheels
from vehicle_sbi.physics.sensors import (
    MEASUREMENTS,
    MOTION,
    ROW_FRONT,
    ROW_REAR,
    ROW_SPEED,
    measure,
    report,
    unreported,
)
from vehicle_sbi.physics.single_track import (
    COMMANDS,
    DELTA,
    SPEED,
    T_F,
    T_R,
    TIME,
    TORQUE,
    U_LATENT,
    U_OMEGA_F,
    U_OMEGA_R,
    U_V_X,
    U_V_X_DOT,
    WHEEL_SPEED,
    regular,
)
from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.threads import cores, each

MODELS: Mapping[str, ModuleType] = {"single_track": single_track, "full_vehicle": full_vehicle}
V_X, V_Y = 0, 1  # the first states of every model

FINISHED, SPUN_OUT, NOT_FINITE = 0, 1, 2
SENSOR_FIELDS = frozenset(
    name
    for effect in CATALOGUE.values()
    if effect.enters_at == "sensor"
    for p in effect.parameters
    for name in p.fields
) | {"latent_sensor", "latent_row"}  # what sensors make of a motion
REPORTED_FIELDS = frozenset(name for name in SENSOR_FIELDS if name.startswith(("sensor_lag", "sensor_delay")))
ROLLING = 3.0  # parts of how fast wheels settle: a step takes all of it exactly but for the curves of their tyres
RIGID = 4.0  # times the fastest mode without relaxation, from which a lag of that rate hardly changes it


@compiled
def blend(u, k: int, share: float, out) -> None:
    """The inputs at `share` of the way from sample k to the next, linear between samples; u (time, 9)."""
    following = min(k + 1, u.shape[0] - 1)
    for i in range(u.shape[1]):
        out[i] = u[k, i] + share * (u[following, i] - u[k, i])


@compiled
def advance(states: int, state, rate, h: float, out) -> None:
    """out = state + h rate, of so many states."""
    for i in range(states):
        out[i] = state[i] + h * rate[i]


@compiled_apart
def perturb(p, C, stiffness_noise, k: int) -> None:
    """Stiffnesses of sample k: C (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad] and a draw (draws, 4) each."""
    p.C_kappa_f = C[0] + stiffness_noise[k, 0]
    p.C_kappa_r = C[1] + stiffness_noise[k, 1]
    p.C_alpha_f = C[2] + stiffness_noise[k, 2]
    p.C_alpha_r = C[3] + stiffness_noise[k, 3]
    derive(p)


@compiled
def outcome_at(motion, k: int) -> int:
    """FINISHED while MOTION at sample k is all numbers and the car goes forwards rather than sideways."""
    total = 0.0
    for i in range(motion.shape[1]):
        total += motion[k, i]
    if not math.isfinite(total):
        return NOT_FINITE
    return SPUN_OUT if abs(motion[k, V_Y]) > regular(motion[k, V_X]) else FINISHED


@compiled_apart
def drive_through(model, p, drive: int, u, stiffness_noise, dt: float, substeps: int, initial, motion) -> int:
    """Integrate one window and record MOTION at every sample; returns FINISHED, SPUN_OUT or NOT_FINITE.

    Between samples `substeps` Runge-Kutta steps of fourth order, classical but for wheels that turn freely (`rolling`),
    inputs being linear. stiffness_noise (draws, 4) is added to (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad]:
    one draw for the whole window, or one per sample. The rate of one stage is where the next one's loops start. The
    four stages share one call of the equations of motion, which is then compiled in place: a quarter of the code, and
    arrays without reference counts.
    """
    C = (p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r)
    state, trial, rate, total = (
        np.zeros(model.STATES), np.zeros(model.STATES), np.zeros(model.STATES), np.zeros(model.STATES),
    )  # fmt: skip
    now, h, outcome, states = np.zeros(u.shape[1]), dt / substeps, FINISHED, model.states(p)
    p.step = h
    forget(p)
    wheels = slipping_wheels(model.WHEELS)
    for evaluation in range(4 * substeps * (u.shape[0] - 1) + 1):
        step, stage = evaluation // 4, evaluation % 4
        k, share = step // substeps, 0.5 * ((stage + 1) // 2)
        sampled = evaluation % (4 * substeps) == 0
        blend(u, k, (step % substeps + share) / substeps, now)
        if sampled and k < len(stiffness_noise):
            perturb(p, C, stiffness_noise, k)
        if evaluation == 0:
            model.start(p, drive, now, initial, state)
        advance(states, state, rate, share * h, trial)
        if drive == TORQUE:
            if stage > 0:
                set_wheels(model, p, wheels, wheels.moved, state, trial)
            else:
                linearise_wheels(model, p, now, state, h, wheels)
        model.impose(p, drive, now, trial)
        model.derivatives(p, drive, now, trial, rate)
        if sampled:
            model.record(p, drive, now, trial, rate, motion, k)
            outcome = outcome_at(motion, k)
            if outcome != FINISHED:
                break
        weight = h / 6.0 if stage % 3 == 0 else h / 3.0
        for i in range(states):
            total[i] = weight * rate[i] + (trial[i] if stage == 0 else total[i])
        if drive == TORQUE:
            roll_wheels(model, p, wheels, stage, rate)
        if stage == 3:
            if drive == TORQUE:
                set_wheels(model, p, wheels, wheels.arrived, state, total)
            for i in range(states):
                state[i] = total[i]
    p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r = C
    return outcome


@compiled_apart
def actuate(p, before, u, input_noise, rate: float, out) -> None:
    """What reaches the wheels: steering and torques through their effects, both with their relative noise.

    before (earlier, 3) has the COMMANDS of the samples before u, which lags, delays and plays remember; u, out
    (time, 9); input_noise (draws, 2) for steering and torques, one draw for the window or one per sample.
    """
    earlier, commands = len(before), np.empty((len(COMMANDS), len(before) + len(u)))
    for i in range(len(COMMANDS)):
        for k in range(earlier):
            commands[i, k] = before[k, i]
        for k in range(len(u)):
            commands[i, earlier + k] = u[k, i]
    for k in range(u.shape[0]):
        for i in range(u.shape[1]):
            out[k, i] = u[k, i]
    steer(p, commands[DELTA], rate, out[:, DELTA])
    for k in range(u.shape[0]):
        i = min(k, len(input_noise) - 1)
        T_f, T_r = torques(p, commands[T_F], commands[T_R], earlier + k, rate)
        out[k, DELTA] = (1.0 + input_noise[i, 0]) * (out[k, DELTA] + latent_steering(p, u[k, U_LATENT]))
        out[k, T_F] = (1.0 + input_noise[i, 1]) * T_f
        out[k, T_R] = (1.0 + input_noise[i, 1]) * T_r


@compiled
def measured_speeds(p, drive: int, group: int, u, rate: float, out) -> None:
    """The speeds that drive the model before their group of sensors reported them; u, out (time, 9)."""
    if drive == SPEED:
        unreported(p, u[:, U_V_X], group, ROW_SPEED, rate, out[:, U_V_X])
        unreported(p, u[:, U_V_X_DOT], group, ROW_SPEED, rate, out[:, U_V_X_DOT])
    elif drive == WHEEL_SPEED:
        unreported(p, u[:, U_OMEGA_F], group, ROW_FRONT, rate, out[:, U_OMEGA_F])
        unreported(p, u[:, U_OMEGA_R], group, ROW_REAR, rate, out[:, U_OMEGA_R])


@compiled
def fail(y) -> None:
    """Fill y (channels, time) with NaN."""
    for i in range(y.shape[0]):
        for k in range(y.shape[1]):
            y[i, k] = np.nan


@compiled_apart
def simulate(
    model,
    records,
    members,
    drive: int,
    speed_group: int,
    before,
    u,
    stiffness_noise,
    input_noise,
    rate: float,
    substeps,
    initial,
    channels,
    groups,
    y,
):
    """One motion over all windows, as the sensors of each of its `members` read it; returns its outcome.

    `members` index records (n,) and y (n, channels, windows * time), which is NaN where the simulation fails; the first
    of them drives. before (windows, earlier, 3), u (windows, time, 9), substeps (windows,), initial (windows, 3),
    channels and groups index MEASUREMENTS and GROUPS, `speed_group` is the group of the speeds that drive the model.
    """
    windows, time, p = u.shape[0], u.shape[1], records[members[0]]
    motion, reading = np.empty((time, len(MOTION))), np.empty((len(MEASUREMENTS), time))
    acting = np.empty((time, u.shape[2]))
    for member in members:
        derive(records[member])
    for w in range(windows):
        actuate(p, before[w], u[w], input_noise, rate, acting)
        measured_speeds(p, drive, speed_group, u[w], rate, acting)
        outcome = drive_through(model, p, drive, acting, stiffness_noise, 1.0 / rate, substeps[w], initial[w], motion)
        if outcome != FINISHED:
            for member in members:
                fail(y[member])
            return outcome
        for member in members:
            sense(records[member], motion, acting[:, TIME], rate, u[w], channels, groups, reading, y[member], w * time)
    return FINISHED


@compiled_apart
def sense(p, motion, t, rate: float, u, channels, groups, reading, y, first: int) -> None:
    """Fill y (channels, all samples) from sample `first` on with what the sensors read of a motion in a window."""
    time = len(t)
    measure(p, motion, t, rate, reading)
    for i in range(len(channels)):
        reported = y[i, first : first + time]
        report(p, reading[channels[i]], groups[i], channels[i], rate, reported)
        if p.latent_sensor != 0.0:
            for k in range(time):
                reported[k] += latent_sensor(p, channels[i], u[k, U_LATENT])


@cache
def batch_simulator(model: str) -> Callable[..., None]:
    """Simulations of one of MODELS on all cores, compiled when first called: a function of records (n,), the Motions
    that they share, the drive mode, the group of its speeds, the COMMANDS before each window (windows, earlier, 3), u
    (windows, time, 9), stiffness_noise (n, draws, 4),
    input_noise (n, draws, 2), rate [Hz], substeps (windows,), initial (n, windows, 3), channels, groups, that fills
    y (n, channels, windows * time) and outcomes (n,)."""
    equations = MODELS[model]

    @compiled_beside
    def simulate_share(
        records,
        motions,
        share,
        shares,
        drive,
        speed_group,
        before,
        u,
        stiffness_noise,
        input_noise,
        rate,
        substeps,
        initial,
        channels,
        groups,
        y,
        outcomes,
    ):
        for i in range(share, len(motions.starts) - 1, shares):
            members = motions.order[motions.starts[i] : motions.starts[i + 1]]
            first = members[0]
            outcome = simulate(
                equations,
                records,
                members,
                drive,
                speed_group,
                before,
                u,
                stiffness_noise[first],
                input_noise[first],
                rate,
                substeps,
                initial[first],
                channels,
                groups,
                y,
            )
            for member in members:
                outcomes[member] = outcome

    def simulate_batch(records, motions, *driven_and_filled) -> None:
        shares = max(min(cores(), len(motions.starts) - 1), 1)

        def one(share: int) -> None:
            simulate_share(records, motions, share, shares, *driven_and_filled)

        each(one, range(shares))

    return simulate_batch


class Motions(NamedTuple):
    """Which simulations have the same motion: `order` has their rows, those of motion i from starts[i] to
    starts[i + 1]."""

    order: np.ndarray
    starts: np.ndarray

    @classmethod
    def each(cls, n: int) -> "Motions":
        """n simulations, each with one of its own."""
        return cls(np.arange(n), np.arange(n + 1))

    @classmethod
    def shared(cls, records: np.ndarray, drive: int, *drawn: np.ndarray) -> "Motions":
        """Of records (n,) and what is drawn for each (n, ...): they differ in what sensors do of one motion, or move
        differently."""
        reported = REPORTED_FIELDS if drive != TORQUE else ()  # speeds that drive the model were reported by sensors
        moving = [name for name in records.dtype.names or () if name not in SENSOR_FIELDS or name in reported]
        columns = [records[name][:, None] for name in moving] + [one.reshape(len(records), -1) for one in drawn]
        key = np.ascontiguousarray(np.concatenate(columns, axis=1))
        rows = key.view(np.dtype((np.void, key.itemsize * key.shape[1]))).ravel()
        _, motion = np.unique(rows, return_inverse=True)
        order = np.argsort(motion, kind="stable")
        return cls(order, np.searchsorted(motion[order], np.arange(motion.max() + 2)))


def fastest_rate(record: np.void, drive: str, v_min: float, model: str = "single_track") -> float:
    """The fastest rate [1/s] that a step has to follow, about straight driving at v_min, tyres vertically rigid.

    Those of the lateral pair have a known trace and determinant (Rajamani, sec. 2.5), the body on its wheels has
    sum(C_kappa) / (m v), and wheels that turn freely have R^2 C_kappa / (I_w v), of which a step has to follow one part
    in ROLLING. Behind a relaxation of rate c = v/sigma a mode of rate d becomes s^2 + c s + c d = 0, whose roots are
    sqrt(c d) where they oscillate and below c where they do not; from c = 4 d on the slower one is that of the body,
    and the lag itself is no faster than its share allows. In the full vehicle the tyres move less than all of m, the
    body swinging on its springs; it does so against the rest.
    """
    records, v = np.array([record]), max(v_min, 1.0)
    derive(records[0])
    p, swinging = records[0], []
    C_kappa = {axle: p[f"stiff_{axle}"] * p[f"C_kappa_{axle}"] for axle in "fr"}
    m_x = m_y = p["mass"]
    turning = 0.0  # what wheels at both sides that slip against each other add [1/s]
    if model == "full_vehicle":
        for axis in ("roll", "pitch"):
            lever, J = p[f"{axis}_lever"], p[f"{axis}_J"]
            J -= lever**2 / p["mass"]
            swinging.append(_faster_root(p[f"D_{axis}"] / J, abs(p[f"K_{axis}"] - GRAVITY * lever) / J))
        m_x, m_y = m_x - p["pitch_lever"] ** 2 / p["pitch_J"], m_y - p["roll_lever"] ** 2 / p["roll_J"]
        turning = sum(C_kappa[axle] * p[f"track_{axle}"] ** 2 for axle in "fr") / (4.0 * p["I_z"] * v)
    l_f, l_r, I_z = p["l_front"], p["l_rear"], p["I_z"]
    C_f, C_r = p["stiff_f"] * p["C_alpha_f"], p["stiff_r"] * p["C_alpha_r"]
    trace = (C_f + C_r) / (m_y * v) + (l_f**2 * C_f + l_r**2 * C_r) / (I_z * v)
    determinant = p["L"] ** 2 * C_f * C_r / (m_y * I_z * v**2) + (l_r * C_r - l_f * C_f) / I_z
    rigid = [_faster_root(trace, determinant)]
    if drive != "speed":
        rigid.append(sum(C_kappa.values()) / (m_x * v) + (turning if drive == "torque" else 0.0))
    sigma = min(p["sigma_f"], p["sigma_r"])
    lag = 0.0 if sigma == 0.0 else min(v / sigma, RIGID * max(rigid))
    behind = rigid if sigma == 0.0 else [lag, np.sqrt(lag * max(rigid))]
    rolling = [p[f"R_{a}"] ** 2 * C_kappa[a[0]] / (p[f"I_w{a[0]}"] * v) for a in ("front", "rear")]
    wheels = max(rolling) if drive == "torque" else 0.0
    settling = wheels / ROLLING if sigma == 0.0 else min(wheels / ROLLING, np.sqrt(v / sigma * wheels))
    return max([*swinging, *behind, settling])


def _faster_root(trace: float, determinant: float) -> float:
    """Absolute value of the larger root of s^2 + trace s + determinant = 0, trace not negative."""
    discriminant = (0.5 * trace) ** 2 - determinant
    return 0.5 * trace + np.sqrt(discriminant) if discriminant >= 0.0 else np.sqrt(determinant)


def substeps_for(
    records: np.ndarray, drive: str, v_min: float, rate: float, limit: float = 1.0, model: str = "single_track"
) -> int:
    """Runge-Kutta steps per sample so that step times fastest rate stays below `limit` for every record.

    At 1 the fourth-order method is far inside its stability bound of 2.78 and its error per step in that mode is
    below 1/5! of the mode's amplitude, in the modes that matter to the sensors orders of magnitude less.
    """
    fastest = max(fastest_rate(record, drive, v_min, model) for record in records)
    return max(1, int(np.ceil(fastest / (rate * limit))))
