"""What the tool's model leaves of a whole car's world, without noise: with no effect, and with the case's own.

    .venv/bin/python benchmarks/model_gap.py 203 3 23 47          (a seed and numbers of cases; a minute each)
    .venv/bin/python benchmarks/model_gap.py each 205 75 114      (with none and each of their effects alone, and all)
    .venv/bin/python benchmarks/model_gap.py high 203 3 23 47     (their IMU on the body, at the height of the centre
                                                                  of gravity and above it)
    .venv/bin/python benchmarks/model_gap.py tyres 208 5 20 32    (without and with parts of the tyres' law; multi-body
                                                                  cars too)

The twin has other tyres than the tool's model, and wheels whose loads are uneven in a turn. Base parameters and those
of `tyre_curve`, `combined_slip` and `lateral_load_transfer` are fitted to what its sensors would read, then the
friction beside them. What is left is a signal-to-noise ratio, in standard deviations of the case's noise: what no
parameter can take over, and what is then taken by friction, which is not off. Then the car has its effects of the
catalogue, and their parameters are fitted too: a world that does an effect otherwise than the catalogue says leaves
more.
"""

import os
import sys
from collections.abc import Sequence
from dataclasses import replace

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

import numpy as np
import pandas as pd
from concealed.actuators_and_sensors import Effects
from concealed.twin import TRACK, Twin
from whole_car.cars import INHERENT, WholeCar
from whole_car.cases import base_model, driven, ideal_series

from vehicle_sbi.mismatch.estimation.fit import descend
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.vehicle import GRAVITY

EARLY, COMBINED, SPRUNG = "tyre_curve.early", "combined_slip.weight", "load_sensitivity.sprung"
FRICTION = "friction_level.factor"
STARTS = {
    "twin": {
        "tyre_curve.fullness": 0.9, "lateral_load_transfer.uneven": 0.004, "lateral_load_transfer.track": 1.5,
        "lateral_load_transfer.period": 0.6, "body_roll.gradient": 0.006, "body_roll.period": 0.6,
    },
    "multi-body car": {
        "tyre_curve.peak": 0.8, "tyre_curve.longitudinal": 0.8, EARLY: 0.2, COMBINED: 0.5,
        "load_sensitivity.coefficient": 1.0, SPRUNG: 0.9, "relaxation.front": 0.2, "relaxation.rear": 0.2,
        "body_roll.gradient": 0.012, "body_roll.period": 0.7, "body_pitch.gradient": 0.005, "body_pitch.period": 0.66,
        "lateral_load_transfer.uneven": 0.006, "lateral_load_transfer.period": 0.6,
    },
}  # fmt: skip
STEPS = 30  # of Gauss-Newton
HEIGHTS = (0.0, 0.5)  # [m] of an IMU above the centre of gravity
NONE: Effects = {}


def bare(seed: int, index: int, *, on_body: bool = False) -> WholeCar:
    """The twin of a case, its IMU on a level platform or on the body, and nothing missing."""
    car, _ = driven(seed, index)
    if not isinstance(car.world, Twin):
        raise SystemExit(f"error: case {index} is a multi-body car")
    return replace(car, world=replace(car.world, on_body=on_body), world_name="twin")


def inherent(car: WholeCar) -> list[str]:
    """Parameters of the effects that its world has by itself."""
    return [p.name for name in INHERENT[car.world_name] for p in CATALOGUE[name].parameters]


def left(car: WholeCar, names: Sequence[str], effects: Effects = NONE) -> tuple[float, dict[str, float]]:
    """The signal-to-noise ratio of what a fit leaves of the car with these effects, and the fitted values of these
    parameters."""
    series = ideal_series(car, car.train, effects)
    if series is None:
        raise SystemExit("error: with these effects alone this car cannot be driven so")
    simulator, added = base_model(car, series), [EFFECT_PARAMETERS[name] for name in names]
    space = ParameterSpace((*simulator.space.parameters, *added))
    values = STARTS.get(car.world_name, STARTS["twin"]) | {
        f"{effect}.{key}": value for effect, held in effects.items() for key, value in held.items()
    }
    start = [car.base[name] for name in simulator.space.names] + [values.get(p.name, p.null) for p in added]
    freed = replace(simulator, space=space)
    observed = np.where(freed.windows.valid, freed.windows.y, 0.0)
    fit = descend(Observation(freed, observed, True), np.clip(np.array(start, float), space.low, space.high), STEPS)
    if fit is None:
        raise SystemExit("error: the model cannot be simulated there")
    ratio = float(np.linalg.norm(fit.unexplained / freed.noise.floor[:, None]))
    return ratio, dict(zip(space.names, map(float, fit.theta), strict=True))


def row(seed: int, index: int) -> dict[str, object]:
    car = bare(seed, index)
    own, found = left(car, inherent(car))
    freer, with_friction = left(car, (*inherent(car), FRICTION))
    return {
        "case": index, "drive": car.given.drive, "peak a_y": round(car.peak, 1), "left": own, "with friction": freer,
        "friction": with_friction[FRICTION], "uneven": found["lateral_load_transfer.uneven"],
        "by height and track": (2.0 * (car.truth.h_cog or 0.0) / (GRAVITY * TRACK)) ** 2,
        "damping": found["lateral_load_transfer.damping"], "true damping": getattr(car.world, "roll_damping", np.nan),
        "left with its effects": told(car, acting(car)),
    }  # fmt: skip


def acting(car: WholeCar) -> Effects:
    """The case's effects of the catalogue."""
    return {name: values for name, values in car.effects.items() if name in CATALOGUE}


def told(car: WholeCar, effects: Effects) -> float:
    """What a fit leaves that has the parameters of these effects."""
    theirs = [p.name for name in effects for p in CATALOGUE[name].parameters if p.name not in inherent(car)]
    return left(car, (*inherent(car), *theirs), effects)[0]


def each(seed: int, index: int) -> dict[str, float]:
    """What a fit leaves without effects, with each of the case's alone, and with all of them."""
    car = bare(seed, index)
    alone = {name: told(car, {name: values}) for name, values in acting(car).items()}
    return {"case": index, "none": told(car, {})} | alone | {"all": told(car, acting(car))}


def high(seed: int, index: int) -> dict[str, float]:
    """What a fit leaves where the IMU leans with the body, and how high above the centre of gravity the fit has it."""
    car, found = bare(seed, index, on_body=True), {"case": index}
    theirs = [p.name for name in ("body_roll", "imu_lever_arm") for p in CATALOGUE[name].parameters]
    for z in HEIGHTS:
        ratio, fitted = left(car, (*inherent(car), *theirs), {"imu_lever_arm": {"x": 0.3, "y": 0.1, "z": z}})
        told = {"left": ratio, "l_f": fitted.get("l_f", np.nan), "found": fitted["imu_lever_arm.z"]}
        found |= {f"{name}, {z} m high": value for name, value in told.items()}
    return found | {"true l_f": car.base.get("l_f", np.nan)}


def tyres(seed: int, index: int) -> dict[str, object]:
    """What a fit leaves without and with a tyre that bends early, side forces that feel less of driving and load that
    moves as the body pitches, and by which share l_f is off then."""
    car, _ = driven(seed, index)
    names, found = inherent(car), {"case": index, "world": car.world_name, "drive": car.given.drive}
    for label, without in (
        ("none", (EARLY, COMBINED, SPRUNG)),
        ("combined", (EARLY, SPRUNG)),
        ("and early", (SPRUNG,)),
        ("all", ()),
    ):
        ratio, fitted = left(car, [name for name in names if name not in without])
        found |= {label: ratio, f"l_f, {label}": fitted["l_f"] / car.base["l_f"] - 1.0}
    return found


OTHERS = {"each": each, "high": high, "tyres": tyres}


def main(*words: str) -> None:
    of, words = (OTHERS[words[0]], words[1:]) if words[0] in OTHERS else (row, words)
    rows = [of(int(words[0]), int(index)) for index in words[1:]]
    print(pd.DataFrame(rows).to_markdown(index=False, floatfmt=".3g"))


if __name__ == "__main__":
    main(*sys.argv[1:])
