"""What a real car has that a simple model leaves out: how often, and how large.

Rates and sizes are stated here, once, from what is known of passenger cars, not from what any tool finds.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from concealed.multibody_car import OFFERED
from concealed.outside import OUTSIDE

from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

FEWEST, MOST = 4, 9
RELAXED = 0.95  # share of cars without a stated carcass stiffness whose tyres relax noticeably
OUTSIDE_SHARE = 1.0 / 3.0
OUTSIDE_STRENGTH = (0.1, 0.4)  # of the largest that an effect outside the catalogue can have


@dataclass(frozen=True)
class Missing:
    """An effect's weight in the draw and its parameters' distances from null, (least, most), either way or upwards."""

    weight: float
    sizes: Mapping[str, tuple[float, float]]
    either: bool = True
    drives: tuple[str, ...] = ("speed", "wheel_speed", "torque")

    def drawn(self, name: str, rng: np.random.Generator) -> dict[str, float]:
        found = {}
        for key, bounds in self.sizes.items():
            sign = rng.choice([-1.0, 1.0]) if self.either else 1.0
            found[key] = float((EFFECT_PARAMETERS[f"{name}.{key}"].null or 0.0) + sign * rng.uniform(*bounds))
        return found


BY_TORQUE = ("torque",)
BY_WHEELS = ("wheel_speed", "torque")
REAL: Mapping[str, Missing] = {
    "relaxation": Missing(0.0, {"front": (0.2, 0.6), "rear": (0.2, 0.6)}, either=False),  # RELAXED of cars
    "body_roll": Missing(1.0, {"gradient": (0.004, 0.010), "lag": (0.02, 0.12)}, either=False),
    "body_pitch": Missing(0.4, {"gradient": (0.002, 0.006), "lag": (0.02, 0.12)}, either=False),
    "steering_delay": Missing(0.6, {"time": (0.01, 0.08)}, either=False),
    "steering_lag": Missing(0.3, {"time": (0.02, 0.08)}, either=False),
    "steering_ratio": Missing(0.7, {"gain": (0.02, 0.10)}),
    "steering_offset": Missing(0.6, {"angle": (0.001, 0.010)}),
    "steering_dead_band": Missing(0.2, {"width": (0.002, 0.008)}, either=False),
    "steering_compliance": Missing(0.4, {"coefficient": (0.5e-6, 2.5e-6)}, either=False),
    "roll_steer": Missing(0.2, {"coefficient": (0.0003, 0.0015)}),
    "load_sensitivity": Missing(0.4, {"coefficient": (0.2, 0.6)}, either=False),
    "lateral_load_transfer": Missing(0.4, {"coefficient": (0.001, 0.004)}, either=False),
    "friction_level": Missing(0.3, {"factor": (0.05, 0.15)}),
    "yaw_inertia": Missing(0.5, {"factor": (0.04, 0.15)}),
    "aero_drag": Missing(0.5, {"area": (0.4, 0.9)}, either=False),
    "rolling_resistance": Missing(0.5, {"coefficient": (0.008, 0.020)}, either=False),
    "road_grade": Missing(0.3, {"angle": (0.005, 0.03)}),
    "road_bank": Missing(0.3, {"angle": (0.005, 0.03)}),
    "crosswind": Missing(0.1, {"force": (100.0, 500.0), "arm": (0.1, 0.8)}),
    "drive_gain": Missing(0.3, {"gain": (0.03, 0.12)}, drives=BY_TORQUE),
    "brake_gain": Missing(0.3, {"gain": (0.03, 0.12)}, drives=BY_TORQUE),
    "drive_delay": Missing(0.3, {"time": (0.02, 0.08)}, either=False, drives=BY_TORQUE),
    "wheel_radius": Missing(0.3, {"front": (0.005, 0.03), "rear": (0.005, 0.03)}, drives=BY_WHEELS),
    "imu_lever_arm": Missing(0.6, {"x": (0.1, 1.0), "y": (0.1, 0.4)}),
    "imu_misalignment": Missing(0.2, {"yaw": (0.005, 0.03), "pitch": (0.005, 0.03), "roll": (0.005, 0.03)}),
    "accelerometer_scale": Missing(0.4, {"y": (0.02, 0.10)}),
    "accelerometer_bias": Missing(0.6, {"y": (0.05, 0.25)}),
    "gyro_scale": Missing(0.3, {"z": (0.01, 0.04)}),
    "gyro_bias": Missing(0.5, {"z": (0.002, 0.012)}),
    "sensor_delay": Missing(0.6, {"imu": (0.01, 0.08)}, either=False),
    "sensor_lag": Missing(0.3, {"imu": (0.02, 0.08)}, either=False),
}


def drawn(
    rng: np.random.Generator, *, drive: str, fitted: frozenset[str], stated_carcass: bool, multibody: bool
) -> dict[str, dict[str, float]]:
    """Four to nine effects with their sizes; not what the base model fits anyway, nor what the world does not offer."""
    number = int(rng.integers(FEWEST, MOST + 1))
    offered = {
        name: one
        for name, one in REAL.items()
        if one.weight and drive in one.drives and name not in fitted and (not multibody or name in OFFERED)
        and not (multibody and name in ("body_roll", "body_pitch"))  # its body does that itself
    }  # fmt: skip
    weights = np.array([one.weight for one in offered.values()])
    names = list(rng.choice(list(offered), size=number, replace=False, p=weights / weights.sum()))
    if not multibody and not stated_carcass and rng.uniform() < RELAXED:
        names = ["relaxation", *names[: number - 1]]
    return {str(name): REAL[name].drawn(name, rng) for name in names}


def drawn_outside(rng: np.random.Generator, seconds: float, *, multibody: bool) -> dict[str, dict[str, float]]:
    """In a third of all cars one thing that no catalogue has."""
    if rng.uniform() >= OUTSIDE_SHARE:
        return {}
    name = str(rng.choice([k for k, one in OUTSIDE.items() if not multibody or one.kind != "twin"]))
    one = OUTSIDE[name]
    sign = rng.choice([-1.0, 1.0]) if one.signed else 1.0
    values = {one.strength: float(sign * rng.uniform(*OUTSIDE_STRENGTH) * one.largest)}
    values |= {key: float(rng.uniform(*bounds)) for key, bounds in one.shape.items()}
    return {name: values | ({"start": float(rng.uniform(0.2, 0.6) * seconds)} if one.starts else {})}
