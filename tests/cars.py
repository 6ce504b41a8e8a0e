"""Cars and drives that the physics tests share, and a simulation of one of them in one call."""

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numba import njit

from vehicle_sbi.physics.record import RECORD, derive, nominal_record
from vehicle_sbi.physics.sensors import GROUPS, MEASUREMENTS, MOTION
from vehicle_sbi.physics.simulation import FINISHED, MODELS, Motions, batch_simulator, drive_through
from vehicle_sbi.physics.single_track import DRIVES, INPUTS, TIME, U_LATENT
from vehicle_sbi.physics.vehicle import Vehicle

# The constants of the design's closed forms; rigid tyres without relaxation.
RIGID = Vehicle(
    name="rigid", m=1093.3, L=2.5789, l_f=1.1562, h_cog=0.57487, C_kappa_f=131963.0, C_kappa_r=107242.0,
    C_alpha_f=100e3, C_alpha_r=120e3, mu=1.0489, R_f=0.344, I_wf=3.4, I_wr=3.4,
)  # fmt: skip

PAPER = Vehicle(
    name="paper", m=1500.0, L=2.7, l_f=1.3, h_cog=0.5, C_kappa_f=1e5, C_kappa_r=1e5, C_alpha_f=6e4, C_alpha_r=6e4,
    mu=0.9, R_f=0.31, C_vert=2e5, I_wf=3.0, I_wr=3.0, K=1.5e5,
    track_f=1.5, track_r=1.5, m_s=1350.0, I_x=500.0, I_y=2000.0, h_roll=0.1, h_pitch=0.15, K_roll=7e4, D_roll=6e3,
    roll_front=0.55, K_pitch=1.1e5, D_pitch=9e3,
)  # fmt: skip

MILD = (0.06, 600.0, -900.0)  # steering [rad], drive and brake torque [N m]
STRONG = (0.085, 900.0, -1800.0)
RATE = 200.0
V = 10.5  # [m/s], where the exciting manoeuvre starts

# Each group of sensors reports something: v_y beside the IMU, yaw rate and speed over CAN, and the wheels.
REPORTED_BY = ("imu", "imu", "can", "wheel_speed", "wheel_speed", "can", "imu", "imu", "imu", "imu")


def record_of(vehicle: Vehicle, **fields: float) -> np.ndarray:
    """The record of a car with every effect at its null but for `fields`, as an array of one."""
    records = np.full(1, nominal_record(vehicle), dtype=RECORD)
    for name, value in fields.items():
        records[name] = value
    return records


def paper_manoeuvre(size: tuple[float, float, float] = MILD, seconds: float = 5.0) -> np.ndarray:
    """The paper's drive, inputs (time, 9): sine steering of 4 s, square-wave torque of 5 s, brakes 60 % front."""
    t = np.arange(round(seconds * RATE)) / RATE
    driving = t % 5.0 < 2.5
    u = np.zeros((len(t), len(INPUTS)))
    u[:, TIME] = t
    u[:, 0] = size[0] * np.sin(2.0 * math.pi * t / 4.0)
    u[:, 1] = np.where(driving, size[1], 0.6 * size[2])
    u[:, 2] = np.where(driving, 0.0, 0.4 * size[2])
    return u


def exciting(seconds: float) -> np.ndarray:
    """The strong manoeuvre with a speed and wheel speeds for the drive modes that ask for them."""
    u = paper_manoeuvre(STRONG, seconds=seconds)
    t = np.arange(len(u)) / RATE
    u[:, 3], u[:, 4] = V + 0.8 * np.sin(1.2 * t), 0.96 * np.cos(1.2 * t)
    u[:, 5], u[:, 6] = u[:, 3] * (1.0 + 0.01 * np.sin(2.0 * t)) / 0.3, u[:, 3] / 0.3
    return u


def coasting(v_x: float, seconds: float, rate: float = RATE) -> np.ndarray:
    """No steering, no torque; the recorded speed, where a drive mode reads it, is constant."""
    u = np.zeros((round(seconds * rate) + 1, len(INPUTS)))
    u[:, 3] = v_x
    u[:, TIME] = np.arange(len(u)) / rate
    return u


def smooth_inputs(seconds: float = 2.0) -> np.ndarray:
    """Everything a drive mode may ask for, smooth; wheel speeds that drive, then brake, near a slowly varying speed."""
    t = np.arange(round(seconds * RATE) + 1) / RATE
    u = np.zeros((len(t), len(INPUTS)))
    u[:, 0] = 0.05 * np.sin(math.pi * t)
    u[:, 1] = 400.0 * np.sin(2.0 * t) ** 2
    u[:, 2] = -300.0 * np.sin(1.5 * t) ** 2
    u[:, 3] = 10.5 + 0.8 * np.sin(1.2 * t)
    u[:, 4] = 0.96 * np.cos(1.2 * t)
    u[:, 5] = (10.5 + 0.5 * np.sin(1.2 * t)) / 0.305
    u[:, 6] = (10.5 + 0.5 * np.sin(1.2 * t)) / 0.3055
    u[:, 7] = t
    return u


def disturb(records: np.ndarray, u: np.ndarray, rng: np.random.Generator) -> None:
    """Let a load that no effect stands for, up to a few kN and kN m, act on the body."""
    for axis in ("x", "y", "z"):
        records[f"latent_{axis}"] = rng.uniform(-2000.0, 2000.0)
    u[U_LATENT] = rng.uniform(-1.0, 1.0)


def rate_of(
    records: np.ndarray, drive: str, state: np.ndarray, u: np.ndarray, *, model: str = "single_track"
) -> np.ndarray:
    """d(state)/dt (states,) of the first record, the load-transfer loop started from no acceleration."""
    assert u.shape == (len(INPUTS),)  # compiled code reads beyond the end of a shorter one
    p, out = records[0], np.zeros(MODELS[model].STATES)
    derive(p)
    MODELS[model].derivatives(p, DRIVES[drive], u, state, out)
    return out


def jacobian_of(
    records: np.ndarray, drive: str, v_x: float, columns: tuple[int, ...], step: float, *, model: str = "single_track"
) -> np.ndarray:
    """d(rate)/d(state) about straight driving at v_x, by central differences."""
    p, state, u = records[0], np.zeros(MODELS[model].STATES), np.zeros(len(INPUTS))
    derive(p)
    u[3] = v_x
    MODELS[model].start(p, DRIVES["torque"], u, np.array([v_x, 0.0, 0.0]), state)
    u[5:7] = (state[3:5] if model == "single_track" else state[[7, 9]]).copy()
    slopes = []
    for column in columns:
        shifted = np.tile(state, (2, 1))
        shifted[0, column] += step
        shifted[1, column] -= step
        for x in shifted:
            MODELS[model].impose(p, DRIVES[drive], u, x)
        forward, backward = (rate_of(records, drive, x, u, model=model) for x in shifted)
        slopes.append((forward - backward)[list(columns)] / (2.0 * step))
    return np.array(slopes).T


@cache
def integrator(model: str) -> Callable[..., int]:
    """`drive_through` of one model, to be called without the rest of a simulation."""
    equations = MODELS[model]

    @njit(cache=True)
    def integrate(p, drive, u, stiffness_noise, dt, substeps, initial, motion):
        return drive_through(equations, p, drive, u, stiffness_noise, dt, substeps, initial, motion)

    return integrate


def integrated(
    records: np.ndarray, drive: str, u: np.ndarray, initial: Sequence[float], *, model: str = "single_track"
) -> np.ndarray:
    """MOTION (time, 14) of the first record straight from the integrator, fed with u (time, 9) itself."""
    p, motion = records[0], np.empty((len(u), len(MOTION)))
    derive(p)
    none = np.zeros((1, 4))
    outcome = integrator(model)(p, DRIVES[drive], u, none, 1.0 / RATE, 4, np.array(initial, dtype=float), motion)
    assert outcome == FINISHED
    return motion


def simulate(
    records: np.ndarray,
    drive: str,
    u: np.ndarray,
    initial: Sequence[float] | np.ndarray,
    *,
    model: str = "single_track",
    rate: float = RATE,
    substeps: int = 4,
    stiffness_noise: np.ndarray | None = None,
    input_noise: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """All MEASUREMENTS of n records over one window, (n, 10, time), and their outcomes (n,); u (time, 9)."""
    speed_group = "wheel_speed" if drive == "wheel_speed" else "can"
    n = len(records)
    start = np.broadcast_to(np.asarray(initial, dtype=float), (n, 1, 3)).copy()
    y, outcomes = np.empty((n, len(MEASUREMENTS), len(u))), np.full(n, -1)
    batch_simulator(model)(
        records.copy(),
        Motions.each(n),
        DRIVES[drive],
        GROUPS.index(speed_group),
        u[np.newaxis, :0, :3],
        u[np.newaxis],
        np.zeros((n, 1, 4)) if stiffness_noise is None else stiffness_noise,
        np.zeros((n, 1, 2)) if input_noise is None else input_noise,
        rate,
        np.array([substeps]),
        start,
        np.arange(len(MEASUREMENTS)),
        np.array([GROUPS.index(group) for group in REPORTED_BY]),
        y,
        outcomes,
    )
    return y, outcomes


def finished(*args: object, **kwargs: object) -> np.ndarray:
    """`simulate` of one record that must end well: its measurements (10, time)."""
    y, outcomes = simulate(*args, **kwargs)  # pyright: ignore[reportArgumentType]
    assert outcomes.tolist() == [FINISHED]
    return y[0]


def derived(**fields: float) -> np.void:
    """The record of the rigid car with effects, what follows from it filled in."""
    p = record_of(RIGID, **fields)[0]
    derive(p)
    return p
