"""A whole car that drives: what it is, what the tool is told of it, and what its sensors add; all of it drawn."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from concealed import drives
from concealed.multibody_car import SETS, MultiBody, vehicle_of
from concealed.strength import Given, Noise
from concealed.twin import TRACK, Twin
from concealed.worlds import OwnModel, World

from vehicle_sbi.data.channels import NEEDED
from vehicle_sbi.physics.vehicle import GRAVITY, Vehicle
from whole_car import missing

WORLDS = {"twin": 0.4, "twin, IMU on the body": 0.4, "multi-body car": 0.2}
OWN = "the tool's own model"
DRIVES = {"speed": 0.5, "wheel_speed": 0.2, "torque": 0.3}
RATE = 50.0  # [Hz]
LATERAL = (2.0, 8.0)  # [m/s^2], peak of a case's drives
MOST_GRIP = 0.9  # of mu g, that a drive asks for at most
GENTLEST = 0.7  # of a case's peak, in the gentlest of its drives
LENGTH_S = (12.0, 20.0)  # of a recording
LENGTH_MULTIBODY_S = (11.0, 13.0)
UNSTATED_CARCASS = 0.8  # share of vehicle files without K
ROLL_DAMPING = (0.2, 0.45)  # as a ratio, stated; the three cars of CommonRoad have 0.37 to 0.45
ROLL_CENTRE_M = (0.04, 0.14)  # above the ground, stated
COMBINED = (0.0, 1.0)  # weight of longitudinal demands in side forces, from none to that of a friction circle; stated
IMU_HEIGHT_M = (-0.3, 0.9)  # above the centre of gravity, of an IMU that is off it: on the floor, on the roof; stated
OFF = 0.3  # by which stated stiffnesses are off at most
OFF_L_F = 0.12  # [m]
INHERENT: Mapping[str, tuple[str, ...]] = {
    "twin": ("tyre_curve", "combined_slip", "lateral_load_transfer"),
    "twin, IMU on the body": ("tyre_curve", "combined_slip", "lateral_load_transfer", "body_roll"),
    "multi-body car": (
        "tyre_curve",
        "combined_slip",
        "load_sensitivity",
        "lateral_load_transfer",
        "relaxation",
        "body_roll",
        "body_pitch",
    ),
    OWN: (),
}
"""Effects that each world has by itself: its tyres are neither Dugoff's nor on a friction circle, its wheels' loads are
uneven in a turn, its body leans, its axles give way sideways (the multi-body car's by 175 kN/m). Naming one is never
wrong."""
LIKE: Mapping[str, tuple[str, ...]] = {"body_roll": ("accelerometer_scale",)}
"""What reads as such an effect does, by its equation: an IMU that leans by k a_y reads a_y larger by k g."""


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Noise of every channel that is recorded, and the step [its unit] to which it is rounded, if it is."""

    noise: Noise
    steps: Mapping[str, float]

    def reported(self, name: str, series: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The series with noise; commands are recorded as they are."""
        if name not in self.noise.std:
            return series
        noisy = series + self.noise.draw(name, len(series), rng)
        step = self.steps.get(name, 0.0)
        return step * np.round(noisy / step) if step else noisy

    @property
    def total(self) -> Noise:
        """With the variance of rounding, for signal-to-noise ratios."""
        std = {
            name: float(np.hypot(s, self.steps.get(name, 0.0) / np.sqrt(12.0))) for name, s in self.noise.std.items()
        }
        return replace(self.noise, std=std)


@dataclass(frozen=True, kw_only=True)
class WholeCar:
    """A car in its world with its drives, what it has that is not modelled, its sensors, and what the tool is told."""

    world: World
    world_name: str
    truth: Vehicle
    given: Given
    base: Mapping[str, float]  # true base parameters
    effects: Mapping[str, Mapping[str, float]]
    train: tuple[drives.Plan, ...]
    heldout: tuple[drives.Plan, ...]
    sensors: Sensors
    peak: float  # [m/s^2]

    def gentler(self, factor: float) -> "WholeCar":
        slower = {kind: tuple(p.scaled(factor) for p in getattr(self, kind)) for kind in ("train", "heldout")}
        return replace(self, peak=factor * self.peak, **slower)


def _chosen(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    return str(rng.choice(list(shares), p=list(shares.values())))


def _given(rng: np.random.Generator, truth: Vehicle, *, carcass: bool) -> tuple[Given, dict[str, float]]:
    """What the tool is told, and the truth of what it fits: stiffnesses off by up to OFF, often the steering's gain."""
    drive = _chosen(rng, DRIVES)
    channels = ["a_y", "yaw_rate"]
    if drive != "speed" or rng.uniform() < 0.6:
        channels = ["a_x", *channels]
    if drive == "torque":
        channels += ["wheel_speed_front", "wheel_speed_rear"] + ["v_x"] * (rng.uniform() < 0.5)
    stiff = ["C_alpha_f", "C_alpha_r"] + (["C_kappa_f", "C_kappa_r"] if drive != "speed" else [])
    stated = {name: getattr(truth, name) * rng.uniform(1.0 - OFF, 1.0 + OFF) for name in stiff}
    prior = {name: (0.4 * value, 2.5 * value) for name, value in stated.items()}
    stated["l_f"] = (truth.l_f or 0.0) + rng.uniform(-OFF_L_F, OFF_L_F)
    prior["l_f"] = stated["l_f"] - 0.4, stated["l_f"] + 0.4
    base = {name: float(getattr(truth, name)) for name in prior}
    if rng.uniform() < 0.5:
        base["steering_ratio.gain"] = float(rng.uniform(0.92, 1.08))
        prior["steering_ratio.gain"] = 0.8, 1.25
    prior = {name: (float(f"{low:.5g}"), float(f"{high:.5g}")) for name, (low, high) in prior.items()}
    told = {name: float(f"{value:.5g}") for name, value in stated.items()}
    vehicle = replace(truth, name="car", **told, **({} if carcass else {"K": np.inf}))
    return Given(vehicle=vehicle, model="single_track", drive=drive, channels=tuple(channels), prior=prior), base


def _sensors(rng: np.random.Generator, given: Given) -> Sensors:
    """White, autocorrelated, heavy-tailed or coarsely rounded; what drives the model is measured well."""
    std = {
        "a_x": rng.uniform(0.03, 0.12), "a_y": rng.uniform(0.03, 0.12), "yaw_rate": rng.uniform(0.001, 0.004),
        "v_x": rng.uniform(0.01, 0.04), "wheel_speed_front": rng.uniform(0.02, 0.08),
        "wheel_speed_rear": rng.uniform(0.02, 0.08),
    }  # fmt: skip
    std |= dict.fromkeys(NEEDED[given.drive], 0.003 if given.drive == "speed" else 0.005)
    kind = str(rng.choice(["white", "ar1", "student", "rounded"]))
    rho = {n: float(rng.uniform(0.3, 0.9)) if kind == "ar1" and n in given.channels else 0.0 for n in std}
    tail = "student" if kind == "student" else "normal"
    noise = Noise(std={n: float(s) for n, s in std.items()}, rho=rho, tail=tail)
    steps = {n: float(rng.uniform(1.0, 4.0) * std[n]) for n in given.channels} if kind == "rounded" else {}
    return Sensors(noise=noise, steps=steps)


def _always(car: Vehicle, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """What the twin has by itself, as effects of the tool's own model."""
    uneven = (2.0 * (car.h_cog or 0.0) / (GRAVITY * TRACK)) ** 2
    wheels = {"uneven": uneven, "track": TRACK, "front": float(rng.uniform(-0.1, 0.1))}
    return {"tyre_curve": {"fullness": float(rng.uniform(0.6, 1.0))}, "lateral_load_transfer": wheels}


def _leaning(twin: Twin, rng: np.random.Generator) -> Twin:
    """With a roll axis and roll damping as passenger cars have them."""
    return replace(twin, roll_centre=float(rng.uniform(*ROLL_CENTRE_M)), roll_damping=float(rng.uniform(*ROLL_DAMPING)))


def _gripping(twin: Twin, rng: np.random.Generator) -> Twin:
    """With tyres that are more or less far from a friction circle."""
    return replace(twin, combined=float(rng.uniform(*COMBINED)))


def whole_car(rng: np.random.Generator, worlds: Mapping[str, float] = WORLDS) -> WholeCar:
    """Everything of a case, drawn without a look at what it would show; of each world as often as its share says."""
    name = _chosen(rng, worlds)
    multibody, carcass = name == "multi-body car", bool(rng.uniform() >= UNSTATED_CARCASS)
    number = int(rng.choice(list(SETS)))
    car = vehicle_of(number) if multibody else drives.car(rng, relaxed=carcass, body=False)
    given, base = _given(rng, car, carcass=carcass and not multibody)
    gain = base.get("steering_ratio.gain", 1.0)
    fitted = frozenset(n.split(".")[0] for n in base)
    shortest, longest = LENGTH_MULTIBODY_S if multibody else LENGTH_S
    peak = float(min(rng.uniform(*LATERAL), MOST_GRIP * (car.mu or 1.0) * GRAVITY))
    share = peak / ((car.mu or 1.0) * GRAVITY)
    smooth, asks = (0.4, 0.6) if given.drive == "speed" else (0.15, 0.9)
    fitted_runs = 1 if multibody else int(rng.choice([1, 2]))
    plans = [
        drives.plan(
            car, (GENTLEST * share, share), rng,
            rate=RATE, seconds=float(rng.uniform(shortest, longest)), smooth=smooth, asks=asks,
        )
        for _ in range(fitted_runs + 1)
    ]  # fmt: skip
    effects = missing.drawn(
        rng, drive=given.drive, fitted=fitted, stated_carcass=carcass and not multibody, multibody=multibody
    )
    effects |= missing.drawn_outside(rng, shortest, multibody=multibody) if name != OWN else {}
    shape = float(rng.uniform(1.2, 1.5))
    curvature = -(1.0 + shape**2 / 2) * float(rng.uniform(0.7, 1.0))
    leaning, height, gripping = rng.spawn(3)
    twin = Twin(car=car, gain=gain, C=shape, E=curvature, on_body=name != "twin")
    world: World = _gripping(_leaning(twin, leaning), gripping)
    if "imu_lever_arm" in effects:
        effects["imu_lever_arm"] |= {"z": float(height.uniform(*IMU_HEIGHT_M))}
    if name == OWN:
        world = OwnModel(car=car, model=given.model, drive_mode=given.drive, gain=gain)
        for effect, values in _always(car, rng).items():
            effects[effect] = values | effects.get(effect, {})
    if multibody:
        world = MultiBody(number=number, gain=gain, on_body=True)
        plans = [world.slower(plan) for plan in plans]
    return WholeCar(
        world=world,
        world_name=name,
        truth=car,
        given=given,
        base=base,
        effects=effects,
        train=tuple(plans[:fitted_runs]),
        heldout=tuple(plans[fitted_runs:]),
        sensors=_sensors(rng, given),
        peak=peak,
    )
