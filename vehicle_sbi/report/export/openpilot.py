"""openpilot: `CarSpecs` of opendbc, whose two tyre stiffnesses are a Civic's, scaled by load and by one common factor.

opendbc/car/__init__.py, scale_tire_stiffness: C = C_Civic factor (load of the axle) / (that of the Civic), axle values.
opendbc/car/interfaces.py adds STD_CARGO to the stated mass.
"""

import math

from vehicle_sbi.report.export.car import Car, Entry
from vehicle_sbi.report.export.exported import Exported
from vehicle_sbi.report.export.writing import has_identified, head, left_over, lines_of

STD_CARGO = 136.0  # [kg]
CIVIC_MASS = 1326.0 + STD_CARGO  # [kg]
CIVIC_FRONT = 0.4  # of its wheelbase, from the front axle to the centre of gravity
CIVIC_STIFFNESS_FRONT, CIVIC_STIFFNESS_REAR = 192150.0, 202500.0  # axle values [N/rad]

ONE_FACTOR = (
    "WARNING: openpilot has ONE stiffness factor for both axles; their ratio is that of a Civic under this car's axle "
    "loads. tireStiffnessFactor is the geometric mean of the two axles' own factors."
)
REQUIRED = "mass, wheelbase and steerRatio have no defaults in CarSpecs: fill in those that are left out."
CARGO = f"the drive's mass without the {STD_CARGO:g} kg of cargo that openpilot adds"


def openpilot(known: Exported) -> dict[str, str]:
    """One Python file that builds CarSpecs."""
    entries = _entries(Car(known))
    if not has_identified(entries):
        return {}
    title = "openpilot, opendbc: CarSpecs of a platform in values.py"
    opening = [*head(title, known, (ONE_FACTOR, REQUIRED)), *left_over(known, entries)]
    body = lines_of(known, entries, "    ", between="=", end=",")
    code = ["", "from opendbc.car import CarSpecs", "", "SPECS = CarSpecs(", *body, ")"]
    return {"car_specs.py": "\n".join([*opening, *code]) + "\n"}


def _entries(car: Car) -> list[Entry]:
    factor = car.entry(
        "tireStiffnessFactor", "1", _factor, "C_alpha_f", "C_alpha_r", "m", "L", "l_f", note=_by_axle(car)
    )
    return [
        _mass(car),
        car.same("wheelbase", "L"),
        car.same("steerRatio", "steering_ratio"),
        car.entry("centerToFrontRatio", "1", lambda l_f, L: l_f / L, "l_f", "L"),
        factor,
    ]


def _mass(car: Car) -> Entry:
    """The mass [kg] without what openpilot adds; a model car is one of its `notCar`, to which it adds nothing."""
    mass = car.quantity("m")
    if mass is not None and mass.mean <= STD_CARGO:
        return car.same("mass", "m", "as of a notCar, to whose mass openpilot adds nothing")
    return car.entry("mass", "kg", lambda m: m - STD_CARGO, "m", note=CARGO)


def _factor_front(C_alpha_f: float, m: float, L: float, l_f: float) -> float:
    load = m * (L - l_f) / L
    return C_alpha_f / (CIVIC_STIFFNESS_FRONT * load / (CIVIC_MASS * (1.0 - CIVIC_FRONT)))


def _factor_rear(C_alpha_r: float, m: float, L: float, l_f: float) -> float:
    load = m * l_f / L
    return C_alpha_r / (CIVIC_STIFFNESS_REAR * load / (CIVIC_MASS * CIVIC_FRONT))


def _factor(C_alpha_f: float, C_alpha_r: float, m: float, L: float, l_f: float) -> float:
    return math.sqrt(_factor_front(C_alpha_f, m, L, l_f) * _factor_rear(C_alpha_r, m, L, l_f))


def _by_axle(car: Car) -> str:
    """Each axle's own factor, in words."""
    own = {
        "front": car.entry("front", "1", _factor_front, "C_alpha_f", "m", "L", "l_f").value,
        "rear": car.entry("rear", "1", _factor_rear, "C_alpha_r", "m", "L", "l_f").value,
    }
    return ", ".join(f"{axle} axle alone {value.mean:.3g}" for axle, value in own.items() if value is not None)
