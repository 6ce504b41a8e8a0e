"""The constants of a vehicle. Stiffnesses are AXLE values, both tyres together."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from vehicle_sbi import plain_yaml
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.plain_yaml import UnreadableYaml

GRAVITY = 9.81
AIR_DENSITY = 1.225


MAY_BE_ZERO = (
    "h_cog", "drive_front", "brake_front", "track_f", "track_r", "m_s", "h_roll", "h_pitch", "D_roll", "D_pitch",
    "roll_front",
)  # fmt: skip


MEANINGS: Mapping[str, str] = {
    "m": "mass as driven",
    "L": "wheelbase",
    "steering_ratio": "steering wheel angle to road wheel angle",
    "l_f": "front axle to centre of gravity",
    "h_cog": "height of the centre of gravity",
    "I_z": "yaw inertia",
    "C_alpha_f": "cornering stiffness, front axle",
    "C_alpha_r": "cornering stiffness, rear axle",
    "C_kappa_f": "longitudinal stiffness, front axle",
    "C_kappa_r": "longitudinal stiffness, rear axle",
    "mu": "friction coefficient",
    "R_f": "free tyre radius; with C_vert .inf the rolling radius",
    "I_wf": "inertia of the front wheels and what turns with them",
    "I_wr": "inertia of the rear wheels and what turns with them",
    "drive_front": "share of the drive torque on the front axle: 1 front, 0 rear",
    "brake_front": "share of the brake torque on the front axle",
    "imu_x": "IMU ahead of the rear axle; null: at the centre of gravity; effects=[imu_lever_arm] frees it",
    "imu_y": "IMU left of the middle",
    "imu_z": "IMU above the ground",
    "track_f": "front track",
    "track_r": "rear track",
    "m_s": "sprung mass",
    "I_x": "roll inertia of the sprung mass",
    "I_y": "pitch inertia of the sprung mass",
    "h_roll": "height of the roll axis above the ground, at the centre of gravity",
    "h_pitch": "height of the pitch axis above the ground",
    "K_roll": "roll stiffness, both axles",
    "D_roll": "roll damping, both axles",
    "roll_front": "front axle's share of the roll stiffness",
    "K_pitch": "pitch stiffness",
    "D_pitch": "pitch damping",
    "C_vert": "vertical stiffness of one tyre; .inf: rigid",
    "K": "lateral carcass stiffness of an axle; .inf: slips without relaxation",
}
"""What each constant of a vehicle is, in the order of a file; from track_f on, what only the full vehicle has."""

IMU_PLACE = ("imu_x", "imu_y", "imu_z")
STATED = ("C_vert", "K", "drive_front", "brake_front")  # with what stands for them where a file does not say
LENGTHS = ("L", "l_f", "h_cog", "R_f", "track_f", "track_r", "h_roll", "h_pitch")
LONGEST = 30.0  # [m], which none of them reaches


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
    track_f: float | None = None  # front track [m]; from here on, what only the full vehicle has
    track_r: float | None = None  # rear track [m]
    m_s: float | None = None  # sprung mass [kg]
    I_x: float | None = None  # roll inertia of the sprung mass about its centre of gravity [kg m^2]
    I_y: float | None = None  # pitch inertia of the sprung mass about its centre of gravity [kg m^2]
    h_roll: float | None = None  # height of the roll axis above the ground, at the centre of gravity [m]
    h_pitch: float | None = None  # height of the pitch axis [m]
    K_roll: float | None = None  # roll stiffness, both axles together [N m/rad]
    D_roll: float | None = None  # roll damping, both axles together [N m s/rad]
    roll_front: float | None = None  # front axle's share of the roll stiffness and damping [1]
    K_pitch: float | None = None  # pitch stiffness [N m/rad]
    D_pitch: float | None = None  # pitch damping [N m s/rad]
    imu_x: float | None = None  # IMU ahead of the rear axle [m]; None: at the centre of gravity
    imu_y: float | None = None  # IMU left of the middle [m]
    imu_z: float | None = None  # IMU above the ground [m]
    steering_ratio: float | None = None  # steering wheel to road wheel [1]
    drive_front: float = 1.0  # share of the drive torque on the front axle [1]
    brake_front: float = 0.6  # share of the brake torque on the front axle [1]

    def __post_init__(self) -> None:
        where = f"vehicle '{self.name}'"
        for name in STATED:
            if getattr(self, name) is None:
                usual = getattr(Vehicle, name)
                raise InputError(f"{where}: {name} = null; state a number, or leave the line out for {usual:g}")
        for name, value in self.constants().items():
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise InputError(f"{where}: {name} = {value!r}; a number has to stand there")
            if math.isinf(value) and name not in ("C_vert", "K"):
                raise InputError(f"{where}: {name} = {value:g}; it must be finite")
            if name in IMU_PLACE and math.isfinite(value):
                continue
            if math.isnan(value) or value < 0 or (value == 0 and name not in MAY_BE_ZERO):
                raise InputError(f"{where}: {name} = {value:g}; it must be positive")
        for name in LENGTHS:
            if (getattr(self, name) or 0.0) > LONGEST:
                raise InputError(f"{where}: {name} = {getattr(self, name):g} m; is it stated in millimetres?")
        for name in ("drive_front", "brake_front", "roll_front"):
            if (getattr(self, name) or 0.0) > 1:
                raise InputError(f"{where}: {name} = {getattr(self, name):g}; a share lies between 0 and 1")
        if self.m_s is not None and self.m is not None and self.m_s > self.m:
            raise InputError(f"{where}: m_s = {self.m_s:g} kg; the sprung mass is a part of m = {self.m:g} kg")
        if self.l_f is not None and self.L is not None and self.l_f >= self.L:
            raise InputError(f"{where}: l_f = {self.l_f:g} m reaches past the wheelbase L = {self.L:g} m")

    def constants(self) -> Mapping[str, float]:
        """The constants that are known, by name."""
        return {name: value for name, value in asdict(self).items() if name != "name" and value is not None}

    def missing(self, model: str) -> tuple[str, ...]:
        """The constants of a model's equations of motion that the file leaves out."""
        needed = {**GENERIC_PRIORS, **(BODY_PRIORS if model == "full_vehicle" else {})}
        return tuple(name for name in needed if getattr(self, name) is None)


def read(path: str) -> Vehicle:
    """The vehicle of a YAML file: the constants of `Vehicle` by name. Raises InputError for anything else."""
    file = Path(path)
    try:
        content = plain_yaml.load(file)
    except OSError as error:
        raise InputError(f"vehicle file {path}: {error.strerror}") from None
    except UnreadableYaml as error:
        raise InputError(f"vehicle file {path}: {error}; write one constant a line, as in 'm: 1500.0'") from None
    if not isinstance(content, dict):
        raise InputError(f"vehicle file {path}: holds no constants; write one a line, as in 'm: 1500.0'")
    known = [field.name for field in fields(Vehicle)]
    if "/**" in content:
        raise InputError(
            f"vehicle file {path}: is a parameter file of ROS; `inspect` writes a vehicle file. Of Autoware's "
            "vehicle_info, wheel_base is L there, wheel_radius R_f, and wheel_tread track_f and track_r"
        )
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

# The same for what only the full vehicle has.
BODY_PRIORS: Mapping[str, Parameter] = {
    p.name: p
    for p in (
        _constant("track_f", "m", 1.3, 1.8),
        _constant("track_r", "m", 1.3, 1.8),
        _constant("m_s", "kg", 600.0, 3000.0),
        _constant("I_x", "kg m^2", 200.0, 1500.0),
        _constant("I_y", "kg m^2", 800.0, 6000.0),
        _constant("h_roll", "m", 0.01, 0.2),
        _constant("h_pitch", "m", 0.01, 0.3),
        _constant("K_roll", "N m/rad", 3e4, 2e5),
        _constant("D_roll", "N m s/rad", 1e3, 1.5e4),
        _constant("roll_front", "1", 0.4, 0.75),
        _constant("K_pitch", "N m/rad", 5e4, 3e5),
        _constant("D_pitch", "N m s/rad", 2e3, 3e4),
    )
}

# Where an IMU may be that the vehicle file does not place; free only where a study's prior says so.
IMU_PRIORS: Mapping[str, Parameter] = {
    p.name: p
    for p in (
        _constant("imu_x", "m", -1.0, 4.0),
        _constant("imu_y", "m", -0.8, 0.8),
        _constant("imu_z", "m", 0.0, 2.0),
    )
}

CONSTANTS = tuple(field.name for field in fields(Vehicle) if field.name not in ("name", "I_z", "steering_ratio"))
