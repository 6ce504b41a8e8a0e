"""The physical record: what one simulation is of, as numbers, and what follows from them."""

import math

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.body_forces import payload, profile_knots, yaw_inertia
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.tyre_effects import friction_level, relaxation, stiffness_level, wheel_radius
from vehicle_sbi.physics.vehicle import CONSTANTS, GRAVITY, Vehicle

_EFFECT_FIELDS = tuple(name for p in EFFECT_PARAMETERS.values() for name in p.fields)

# What follows from the others and stays constant over a simulation; `derive` fills it.
_DERIVED = (
    "mass", "l_front", "l_rear", "I_z", "grip", "F_zf_static", "F_zr_static", "load_transfer",
    "sigma_f", "sigma_r", "stiff_f", "stiff_r", "slide_f", "slide_r", "moved_f", "moved_r", "I_wheels",
    "R_front", "R_rear", "grade_gravity", "bank_gravity", "profiled",
    "roll_lever", "pitch_lever", "roll_J", "pitch_J", "arm_x", "arm_y", "arm_z",
)  # fmt: skip

# What the integrator keeps from one step to the next: its step [s], how the search of each axle for its wheels' slips
# goes on, and where the loop between loads and forces does: the front axle's side force [N], and by how much
# `balance.Inverse` is beyond plain iteration.
OWN = (
    "step", "split_f", "split_r", "slope_f", "slope_r", "search", "side_f",
    *(f"inverse_{row}{column}" for row in "xys" for column in "xys"),
)  # fmt: skip

# What no effect stands for, following the input `latent` over time: a load on the body [N, N, N m], an error of the
# road wheels' angle [rad], and one of a sensor, that of a row of MEASUREMENTS [its unit].
LATENT = ("latent_x", "latent_y", "latent_z", "latent_steering", "latent_sensor", "latent_row")

_FIELDS = (*CONSTANTS, "I_z_stated", "duration", *_EFFECT_FIELDS, *LATENT, *_DERIVED, *OWN)
RECORD = np.dtype([(name, np.float64) for name in _FIELDS])


def nominal_record(vehicle: Vehicle, duration: float = 0.0) -> np.void:
    """The physical record of a vehicle with every effect at its null; NaN where a constant is not known.

    `duration` [s] is the recording's, over which a profile's knots are spread.
    """
    record = np.full(1, np.nan, dtype=RECORD)
    for name in CONSTANTS:
        value = getattr(vehicle, name)
        record[name] = np.nan if value is None else value
    record["I_z_stated"] = vehicle.I_z or 0.0
    record["duration"] = duration
    for name in (*LATENT, *OWN):
        record[name] = 0.0
    for parameter in EFFECT_PARAMETERS.values():
        for name in parameter.fields:
            record[name] = parameter.null
    return record[0]


@compiled_apart
def derive(p) -> None:
    """Fill the derived fields of the record.

    Mass, its place and I_z = factor m l_f l_r (unless the vehicle file states it) with the payload; static loads m g
    l_r/L and m g l_f/L across a graded or banked road, and how much of what a turn moves each axle bears over its share
    of them; what wheels that stand apart add to I_z, the outer ones turning faster; load transfer m h/L [N per m/s^2];
    relaxation lengths sigma = C_alpha / K and what is added to it [m] (the paper's sec. II and equation 11); levers m_s
    h_s [kg m] of the sprung mass, payload included, about the roll and pitch axes, wheels and axles taken to lie at the
    height of the wheels' centres, with its moments of inertia about those axes [kg m^2]; the IMU's place. No more than
    all of m is sprung.
    """
    p.mass, p.l_front, carried = payload(p)
    p.l_rear = p.L - p.l_front
    p.I_z = carried + yaw_inertia(p, p.I_z_stated if p.I_z_stated > 0.0 else p.m * p.l_f * (p.L - p.l_f))
    p.grip = friction_level(p, p.mu)
    weight = p.mass * GRAVITY * math.cos(p.road_grade_angle) * math.cos(p.road_bank_angle)
    p.stiff_f, p.stiff_r = stiffness_level(p)
    p.sigma_f, p.sigma_r = relaxation(p, p.stiff_f * p.C_alpha_f / p.K, p.stiff_r * p.C_alpha_r / p.K)
    p.slide_f, p.slide_r = p.friction_level_front, p.friction_level_rear
    p.R_front, p.R_rear = wheel_radius(p)
    p.moved_f = max(1.0 + p.lateral_load_transfer_front * p.L / p.l_rear, 0.0)
    p.moved_r = max(1.0 - p.lateral_load_transfer_front * p.L / p.l_front, 0.0)
    wheels = (p.I_wf if p.I_wf > 0.0 else 0.0) + (p.I_wr if p.I_wr > 0.0 else 0.0)
    p.I_wheels = wheels * (0.5 * p.lateral_load_transfer_track / p.R_f) ** 2
    p.grade_gravity = GRAVITY * math.sin(p.road_grade_angle)
    p.bank_gravity = GRAVITY * math.sin(p.road_bank_angle)
    p.profiled = 0.0
    for angle in profile_knots(p):
        p.profiled += abs(angle)
    p.load_transfer = p.mass * p.h_cog / p.L
    p.F_zf_static = weight * p.l_rear / p.L
    p.F_zr_static = weight * p.l_front / p.L
    sprung = min(p.m_s, p.m) + p.payload_mass if p.m_s > 0.0 else 0.0
    h_s = (p.mass * p.h_cog - (p.mass - sprung) * p.R_f) / sprung if sprung > 0.0 else p.h_cog
    p.roll_lever, p.pitch_lever = sprung * (h_s - p.h_roll), sprung * (h_s - p.h_pitch)
    p.roll_J = p.I_x + p.roll_lever * (h_s - p.h_roll)
    p.pitch_J = p.I_y + p.pitch_lever * (h_s - p.h_pitch)
    p.arm_x, p.arm_y, p.arm_z = imu_lever_arm(p)


@compiled
def imu_lever_arm(p) -> tuple[float, float, float]:
    """Where the IMU sits from the centre of gravity [m]: where the vehicle file has it, plus the lever arm.

    A vehicle file states the place from the middle of the rear axle on the ground, as Autoware's base_link does.
    """
    x = p.imu_x - p.l_rear if math.isfinite(p.imu_x) else 0.0
    y = p.imu_y if math.isfinite(p.imu_y) else 0.0
    z = p.imu_z - p.h_cog if math.isfinite(p.imu_z) else 0.0
    return x + p.imu_lever_arm_x, y + p.imu_lever_arm_y, z + p.imu_lever_arm_z
