"""A car, its drives and its sensors, drawn without a look at what they would show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from concealed import drives, outside
from concealed.multibody_car import OFFERED, SETS, MultiBody, vehicle_of
from concealed.strength import Given, Noise
from concealed.twin import Twin
from concealed.worlds import OwnModel, Series, World
from vehicle_sbi.data.channels import NEEDED
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.vehicle import Vehicle

MULTIBODY = 0.2  # share of attempts at level L1 with the multi-body car, where it has the effects
ONCE = ("start", "duration", "angle_0")  # an effect with one of these parameters happens in one recording only


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A car that drives, and what the tool is told of it."""

    world: World
    given: Given
    theta: np.ndarray  # true base parameters
    train: tuple[drives.Plan, ...]
    heldout: tuple[drives.Plan, ...]
    noise: Noise
    regime: str
    truth: Vehicle
    world_name: str

    def scaled(self, factor: float) -> "Setup":
        return replace(self, train=tuple(p.scaled(factor) for p in self.train))


def recording(name: str, plan: drives.Plan, series: Series, given: Given, added: Mapping[str, np.ndarray]) -> Recording:
    """A recording in memory: commands, what drives the model, what is measured, with noise `added`."""
    names = dict.fromkeys(("steering", *NEEDED[given.drive], "v_x", *given.channels))
    if given.drive == "torque":
        names["torque_rear"] = None
    channels = {n: series[n] + added.get(n, 0.0) for n in names}
    return Recording(
        name=name,
        rate=plan.rate,
        t=plan.t,
        channels=channels,
        valid={n: np.ones(len(plan.t), dtype=bool) for n in channels},
        groups={},
        source=name,
    )


def _given(
    rng: np.random.Generator, truth: Vehicle, model: str, effects: Sequence[str], vague: bool
) -> tuple[Given, np.ndarray]:
    """What the tool is told of a car, and the truth of what it fits; fitted constants are off by up to their prior.

    `vague`: of a car whose own constants mean something slightly else; boxes are wide and the steering is fitted.
    """
    drive = str(rng.choice(["speed", "wheel_speed", "torque"], p=[0.4, 0.2, 0.4]))
    channels = ["a_y", "yaw_rate"]
    if drive != "speed" or rng.uniform() < 0.4:
        channels = ["a_x", *channels]
    if drive == "torque":
        channels += ["wheel_speed_front", "wheel_speed_rear"] + ["v_x"] * (rng.uniform() < 0.5)
    if model == "full_vehicle" and rng.uniform() < 0.6:
        channels += ["roll_rate"]
    fitted = ["C_alpha_f", "C_alpha_r", "l_f"] + (["C_kappa_f", "C_kappa_r"] if drive != "speed" else [])
    stated, prior, true = {}, {}, {}
    for name in fitted:
        true[name] = getattr(truth, name)
        if name == "l_f":
            stated[name] = true[name] + rng.uniform(-0.12, 0.12)
            reach = 0.4 if vague else 0.2
            prior[name] = stated[name] - reach, stated[name] + reach
        else:
            stated[name] = true[name] * rng.uniform(0.75, 1.3)
            prior[name] = (0.4 if vague else 0.6) * stated[name], (2.5 if vague else 1.6) * stated[name]
    if "steering_ratio" not in effects and (vague or rng.uniform() < 0.6):
        true["steering_ratio.gain"] = rng.uniform(0.93, 1.07)
        prior["steering_ratio.gain"] = 0.85, 1.18
    prior = {name: (float(f"{low:.5g}"), float(f"{high:.5g}")) for name, (low, high) in prior.items()}
    vehicle = replace(truth, name="car", **{name: float(f"{value:.5g}") for name, value in stated.items()})
    given = Given(
        vehicle=vehicle,
        model=model,
        drive=drive,
        channels=tuple(channels),
        prior=prior,
        effect_prior="one_thing",
    )
    return given, np.array([true[name] for name in prior])


def _noise(rng: np.random.Generator, given: Given) -> Noise:
    """White, autocorrelated or heavy-tailed; what drives the model is measured well, and its noise is white."""
    std = {
        "a_x": rng.uniform(0.05, 0.15), "a_y": rng.uniform(0.05, 0.15), "yaw_rate": rng.uniform(0.002, 0.006),
        "roll_rate": rng.uniform(0.003, 0.008), "v_x": rng.uniform(0.02, 0.05),
        "wheel_speed_front": rng.uniform(0.03, 0.1), "wheel_speed_rear": rng.uniform(0.03, 0.1),
    }  # fmt: skip
    std |= dict.fromkeys(NEEDED[given.drive], 0.003 if given.drive == "speed" else 0.005)
    kind = str(rng.choice(["white", "ar1", "student"]))
    rho = {n: float(rng.uniform(0.5, 0.95)) if kind == "ar1" and n in given.channels else 0.0 for n in std}
    return Noise(std={n: float(s) for n, s in std.items()}, rho=rho, tail="student" if kind == "student" else "normal")


def attempt(rng: np.random.Generator, level: str, effects: Sequence[str]) -> Setup:
    """A car with its drives and sensors, drawn without a look at what they would show."""
    model = "full_vehicle" if level == "L0" and rng.uniform() < 0.25 else "single_track"
    offered = all(
        name in OFFERED or (name in outside.OUTSIDE and outside.OUTSIDE[name].kind != "twin") for name in effects
    )
    number = int(rng.choice(list(SETS))) if level == "L1" and offered and rng.uniform() < MULTIBODY else None
    relaxed = "relaxation" in effects or rng.uniform() < 0.5
    car = drives.car(rng, relaxed=relaxed, body=model == "full_vehicle") if number is None else vehicle_of(number)
    given, theta = _given(rng, car, model, effects, number is not None)
    gain = float(dict(zip(given.prior, theta, strict=True)).get("steering_ratio.gain", 1.0))
    gentle = level == "L1" and (number is not None or rng.uniform() < 0.7)
    regime = "gentle" if gentle else str(rng.choice(["gentle", "normal", "limit"][: 2 if level == "L1" else 3]))
    rate, once = float(rng.choice([50.0, 100.0])), any(happens_once(name) for name in effects)
    n = 1 if once or number is not None else int(rng.choice([1, 2, 5], p=[0.5, 0.33, 0.17]))
    settings: dict[str, Any] = {
        "rate": rate, "smooth": 0.4 if given.drive == "speed" else 0.15, "asks": 0.5 if given.drive == "speed" else 0.9
    }  # fmt: skip
    longest = 26 if n < 5 and number is None else 16
    plans = [
        drives.plan(car, drives.REGIMES[regime], rng, seconds=float(rng.integers(12, longest)), **settings)
        for _ in range(n + int(rng.integers(1, 3)))
    ]
    world: World = OwnModel(car=car, model=model, drive_mode=given.drive, gain=gain)
    if number is not None:
        world = MultiBody(number=number, gain=gain)
        plans = [world.slower(plan) for plan in plans]
    elif level == "L1":
        C = float(rng.uniform(1.2, 1.5))
        world = Twin(car=car, gain=gain, C=C, E=-(1.0 + C**2 / 2) * rng.uniform(0.7, 1.0))
    own = f"the project's {model}" if level == "L0" else "twin"
    noise = _noise(rng, given)
    return Setup(
        world=world,
        given=given,
        theta=theta,
        train=tuple(plans[:n]),
        heldout=tuple(plans[n:]),
        noise=noise if number is None else noise.louder(2.0),
        regime=regime,
        truth=car,
        world_name=own if number is None else f"multi-body car, set {number}",
    )


def happens_once(name: str) -> bool:
    parameters = [p.name.split(".")[1] for p in CATALOGUE[name].parameters] if name in CATALOGUE else ()
    return any(p in ONCE for p in parameters)
