"""The catalogue of optional physics: what a simple model leaves out, one small function per effect.

Every effect is always compiled in. Each of its parameters has a null value at which the effect vanishes exactly, so a
model is nothing but the choice of which parameters are free, and models are nested. To add an effect: write its
function, call it from the stage it enters at (`road_wheel_angle`, `body_force`, `sensors.measure`, ...), and enter it
in `CATALOGUE`; every law that the tests state for effects then holds for it too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.vehicle import AIR_DENSITY, CONSTANTS, GRAVITY, Vehicle


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An optional effect: where it enters, what it means, where its equation comes from, its parameters."""

    name: str
    enters_at: str
    meaning: str
    source: str
    parameters: tuple[Parameter, ...]


def _effect(
    name: str, enters_at: str, meaning: str, source: str, **parameters: tuple[str, float, float, float]
) -> Effect:
    """An effect with `parameters` as name=(unit, low, high, null); the record's fields are effect_parameter."""
    return Effect(
        name=name,
        enters_at=enters_at,
        meaning=meaning,
        source=source,
        parameters=tuple(
            Parameter(name=f"{name}.{key}", unit=unit, low=low, high=high, null=null, fields=(f"{name}_{key}",))
            for key, (unit, low, high, null) in parameters.items()
        ),
    )


CATALOGUE: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        _effect("steering_delay", "steering", "the wheels follow the command later", "pure dead time",
                time=("s", 0.0, 0.3, 0.0)),
        _effect("steering_offset", "steering", "the wheels are not straight at command zero", "alignment",
                angle=("rad", -0.03, 0.03, 0.0)),
        _effect("steering_ratio", "steering", "road-wheel angle per stated road-wheel angle", "steering geometry",
                gain=("1", 0.7, 1.4, 1.0)),
        _effect("aero_drag", "force", "aerodynamic drag", "Rajamani, Vehicle Dynamics and Control, sec. 4.2",
                area=("m^2", 0.0, 1.5, 0.0)),
        _effect("rolling_resistance", "force", "rolling resistance of the tyres",
                "Rajamani, Vehicle Dynamics and Control, sec. 4.2", coefficient=("1", 0.0, 0.05, 0.0)),
        _effect("road_grade", "force", "the road climbs (positive uphill)",
                "Rajamani, Vehicle Dynamics and Control, sec. 4.2", angle=("rad", -0.15, 0.15, 0.0)),
        _effect("road_bank", "force", "the road's left side is higher (positive)",
                "Rajamani, Vehicle Dynamics and Control, sec. 2.8", angle=("rad", -0.1, 0.1, 0.0)),
        _effect("yaw_inertia", "force", "yaw inertia over m l_f l_r", "the paper, sec. II-A",
                factor=("1", 0.7, 1.5, 1.0)),
        _effect("friction_level", "tyre", "friction coefficient over the vehicle's", "Dugoff's mu",
                factor=("1", 0.3, 1.3, 1.0)),
        _effect("accelerometer_bias", "sensor", "constant offset of the accelerometer", "sensor model",
                x=("m/s^2", -0.6, 0.6, 0.0), y=("m/s^2", -0.6, 0.6, 0.0)),
        _effect("gyro_bias", "sensor", "constant offset of the yaw-rate sensor", "sensor model",
                z=("rad/s", -0.03, 0.03, 0.0)),
        _effect("body_roll", "sensor", "the body leans outwards and gravity leaks into a_y",
                "Rajamani, Vehicle Dynamics and Control, sec. 15.2",
                gradient=("rad/(m/s^2)", 0.0, 0.02, 0.0), lag=("s", 0.0, 0.3, 0.0)),
        _effect("imu_lever_arm", "sensor", "the IMU sits away from the centre of gravity",
                "rigid-body kinematics: a + dw/dt x p + w x (w x p)",
                x=("m", -1.5, 1.5, 0.0), y=("m", -0.8, 0.8, 0.0)),
        _effect("sensor_delay", "sensor", "a group of sensors reports later", "pure dead time",
                imu=("s", 0.0, 0.2, 0.0), can=("s", 0.0, 0.2, 0.0), wheel_speed=("s", 0.0, 0.2, 0.0)),
    )
}  # fmt: skip

EFFECT_PARAMETERS: Mapping[str, Parameter] = {p.name: p for effect in CATALOGUE.values() for p in effect.parameters}
_EFFECT_FIELDS = tuple(name for p in EFFECT_PARAMETERS.values() for name in p.fields)

# What follows from the others and stays constant over a simulation; `derive` fills it.
_DERIVED = (
    "l_r", "I_z", "grip", "F_zf_static", "F_zr_static", "load_transfer", "sigma_f", "sigma_r",
    "grade_force", "bank_force", "grade_gravity", "bank_gravity",
)  # fmt: skip

RECORD = np.dtype([(name, np.float64) for name in (*CONSTANTS, "I_z_stated", *_EFFECT_FIELDS, *_DERIVED)])


def nominal_record(vehicle: Vehicle) -> np.void:
    """The physical record of a vehicle with every effect at its null; NaN where a constant is not known."""
    record = np.full(1, np.nan, dtype=RECORD)
    for name in CONSTANTS:
        value = getattr(vehicle, name)
        record[name] = np.nan if value is None else value
    record["I_z_stated"] = vehicle.I_z or 0.0
    for parameter in EFFECT_PARAMETERS.values():
        for name in parameter.fields:
            record[name] = parameter.null
    return record[0]


@njit(cache=True)
def derive(p) -> None:
    """Fill the derived fields of the record.

    I_z = factor m l_f l_r unless the vehicle file states it; static loads m g l_r/L and m g l_f/L across a graded or
    banked road, on which gravity along x shifts load as an acceleration does (Rajamani, sec. 4.2); load transfer m h/L
    [N per m/s^2]; relaxation length sigma = C_alpha / K [m] (the paper's sec. II and equation 11).
    """
    p.l_r = p.L - p.l_f
    p.I_z = yaw_inertia(p, p.I_z_stated if p.I_z_stated > 0.0 else p.m * p.l_f * p.l_r)
    p.grip = friction_level(p, p.mu)
    weight = p.m * GRAVITY * math.cos(p.road_grade_angle) * math.cos(p.road_bank_angle)
    p.sigma_f = p.C_alpha_f / p.K
    p.sigma_r = p.C_alpha_r / p.K
    p.grade_gravity = GRAVITY * math.sin(p.road_grade_angle)
    p.bank_gravity = GRAVITY * math.sin(p.road_bank_angle)
    p.load_transfer = p.m * p.h_cog / p.L
    p.F_zf_static = weight * p.l_r / p.L - p.load_transfer * p.grade_gravity
    p.F_zr_static = weight * p.l_f / p.L + p.load_transfer * p.grade_gravity
    p.grade_force = road_grade(p)
    p.bank_force = road_bank(p)


@njit(cache=True)
def interpolate(signal, position: float) -> float:
    """The signal at a fractional sample `position`, linear between samples, held beyond its ends."""
    last = len(signal) - 1
    if position <= 0.0:
        return signal[0]
    if position >= last:
        return signal[last]
    k = int(position)
    share = position - k
    return signal[k] + share * (signal[k + 1] - signal[k]) if share > 0.0 else signal[k]


@njit(cache=True)
def steering_delay(p, command, k: int, rate: float) -> float:
    """The command [rad] that the wheels follow at sample k, `time` seconds old."""
    return interpolate(command, k - p.steering_delay_time * rate)


@njit(cache=True)
def steering_ratio(p, delta: float) -> float:
    """Road-wheel angle [rad] where the stated ratio is off by a gain."""
    return p.steering_ratio_gain * delta


@njit(cache=True)
def steering_offset(p, delta: float) -> float:
    """Road-wheel angle [rad] with the zero of the steering sensor misplaced."""
    return delta + p.steering_offset_angle


@njit(cache=True)
def road_wheel_angle(p, command, k: int, rate: float) -> float:
    """What the front wheels do [rad] with the steering command at sample k: the steering effects in their order."""
    return steering_offset(p, steering_ratio(p, steering_delay(p, command, k, rate)))


@njit(cache=True)
def aero_drag(p, v_x: float) -> float:
    """Drag force [N] along x, -1/2 rho C_d A v|v| (Rajamani, sec. 4.2); vanishes at area 0."""
    return -0.5 * AIR_DENSITY * p.aero_drag_area * v_x * abs(v_x)


@njit(cache=True)
def rolling_resistance(p, v_x: float) -> float:
    """Rolling resistance [N] along x, -c_rr F_z (Rajamani, sec. 4.2), fading linearly below 1 m/s to zero at rest."""
    return -p.rolling_resistance_coefficient * (p.F_zf_static + p.F_zr_static) * min(1.0, max(-1.0, v_x))


@njit(cache=True)
def road_grade(p) -> float:
    """Gravity along x [N], -m g sin(grade); vanishes at angle 0."""
    return -p.m * GRAVITY * math.sin(p.road_grade_angle)


@njit(cache=True)
def road_bank(p) -> float:
    """Gravity along y [N], -m g sin(bank): the raised left side pulls to the right."""
    return -p.m * GRAVITY * math.sin(p.road_bank_angle)


@njit(cache=True)
def body_force(p, v_x: float) -> tuple[float, float]:
    """Sum of the optional forces (x, y) [N] on the body."""
    return aero_drag(p, v_x) + rolling_resistance(p, v_x) + p.grade_force, p.bank_force


@njit(cache=True)
def yaw_inertia(p, I_z: float) -> float:
    """Yaw inertia [kg m^2] where m l_f l_r is off by a factor."""
    return p.yaw_inertia_factor * I_z


@njit(cache=True)
def friction_level(p, mu: float) -> float:
    """Friction coefficient where the road's differs from the vehicle file's by a factor."""
    return p.friction_level_factor * mu
