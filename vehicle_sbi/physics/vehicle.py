"""The constants of a vehicle. Stiffnesses are AXLE values, both tyres together."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import yaml

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.parameters import Parameter

GRAVITY = 9.81
AIR_DENSITY = 1.225


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A vehicle as its YAML file states it; None where a constant is not known and a prior has to stand for it.

    Raises InputError for a value that no vehicle has.
    """

    name: str
    m: float | None = None  # mass [kg]
    L: float | None = None  # wheelbase [m]
    l_f: float | None = None  # front axle to centre of gravity [m]
    h_cog: float | None = None  # height of the centre of gravity [m]
    C_kappa_f: float | None = None  # longitudinal stiffness, front axle [N]
    C_kappa_r: float | None = None  # longitudinal stiffness, rear axle [N]
    C_alpha_f: float | None = None  # cornering stiffness, front axle [N/rad]
    C_alpha_r: float | None = None  # cornering stiffness, rear axle [N/rad]
    mu: float | None = None  # friction coefficient [1]
    R_f: float | None = None  # free tyre radius [m]
    C_vert: float = math.inf  # vertical stiffness of one tyre [N/m]
    I_wf: float | None = None  # front axle: wheels and what turns with them [kg m^2]
    I_wr: float | None = None  # rear axle: wheels and what turns with them [kg m^2]
    K: float = math.inf  # lateral carcass stiffness of an axle [N/m]; infinite: slips without relaxation
    I_z: float | None = None  # yaw inertia [kg m^2]; None: m l_f l_r
    steering_ratio: float | None = None  # steering wheel to road wheel [1]
    drive_front: float = 1.0  # share of the drive torque on the front axle [1]
    brake_front: float = 0.6  # share of the brake torque on the front axle [1]

    def __post_init__(self) -> None:
        where = f"vehicle '{self.name}'"
        for name, value in self.constants().items():
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise InputError(f"{where}: {name} = {value!r} is not a number")
            if math.isinf(value) and name not in ("C_vert", "K"):
                raise InputError(f"{where}: {name} = {value:g}; it must be finite")
            if math.isnan(value) or value < 0 or (value == 0 and name not in ("h_cog", "drive_front", "brake_front")):
                raise InputError(f"{where}: {name} = {value:g}; it must be positive")
        for name in ("drive_front", "brake_front"):
            if getattr(self, name) > 1:
                raise InputError(f"{where}: {name} = {getattr(self, name):g}; a share lies between 0 and 1")
        if self.l_f is not None and self.L is not None and self.l_f >= self.L:
            raise InputError(f"{where}: l_f = {self.l_f:g} m reaches past the wheelbase L = {self.L:g} m")

    def constants(self) -> Mapping[str, float]:
        """The constants that are known, by name."""
        return {name: value for name, value in asdict(self).items() if name != "name" and value is not None}

    @property
    def missing(self) -> tuple[str, ...]:
        """The constants of the equations of motion that the file leaves out."""
        return tuple(name for name in GENERIC_PRIORS if getattr(self, name) is None)


def read(path: str) -> Vehicle:
    """The vehicle of a YAML file: the constants of `Vehicle` by name. Raises InputError for anything else."""
    file = Path(path)
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"vehicle file {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise InputError(f"vehicle file {path}: not YAML; write one constant a line, as in 'm: 1500.0'") from None
    if not isinstance(content, dict):
        raise InputError(f"vehicle file {path}: holds no constants; write one a line, as in 'm: 1500.0'")
    known = [field.name for field in fields(Vehicle)]
    for name in content:
        if name not in (*known, "_target_"):
            raise unknown("constant", str(name), known, f"vehicle file {path}")
    content.pop("_target_", None)
    return Vehicle(**{"name": file.stem, **content})


def _constant(name: str, unit: str, low: float, high: float) -> Parameter:
    return Parameter(name=name, unit=unit, low=low, high=high, fields=(name,))


# Boxes that hold passenger cars from a city car to a loaded van; a study with better knowledge states its own.
GENERIC_PRIORS: Mapping[str, Parameter] = {
    p.name: p
    for p in (
        _constant("m", "kg", 700.0, 3500.0),
        _constant("L", "m", 2.2, 3.5),
        _constant("l_f", "m", 0.9, 1.9),
        _constant("h_cog", "m", 0.3, 0.9),
        _constant("C_kappa_f", "N", 5e4, 4e5),
        _constant("C_kappa_r", "N", 5e4, 4e5),
        _constant("C_alpha_f", "N/rad", 4e4, 3e5),
        _constant("C_alpha_r", "N/rad", 4e4, 4e5),
        _constant("mu", "1", 0.3, 1.2),
        _constant("R_f", "m", 0.25, 0.45),
        _constant("I_wf", "kg m^2", 1.0, 8.0),
        _constant("I_wr", "kg m^2", 1.0, 8.0),
    )
}

CONSTANTS = tuple(field.name for field in fields(Vehicle) if field.name not in ("name", "I_z", "steering_ratio"))
