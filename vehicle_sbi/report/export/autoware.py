"""Autoware: the keys of its MPC, simulator, vehicle and sensor files that a run tells; copy them into your own files.

Frames and signs: steering is positive to the left; base_link is the middle of the rear axle on the ground, x ahead, y
left, z up. Keys and their meaning as in autoware_universe's mpc_lateral_controller and simple_planning_simulator: the
simulator reports its road-wheel angle plus `steer_bias`, and its dead band is one-sided.
"""

from itertools import chain

from vehicle_sbi.report.export.car import Car, Entry
from vehicle_sbi.report.export.exported import Exported
from vehicle_sbi.report.export.writing import has_identified, head, left_over, yaml_file

IMU = "tamagawa/imu_link"
PARAMETERS = ("/**", "ros__parameters")
AXLE_VALUES = (
    "WARNING: cf and cr are AXLE values, both tyres together, as Autoware's state matrices take them. Its feed-forward "
    "divides by 2 cf and 2 cr, as if they were of one tyre, which halves its understeer term."
)
MODEL = (
    'The keys below "vehicle" are read by vehicle_model_type "dynamics" alone, which needs all six and takes '
    "l_f and I_z = m l_f l_r from the masses. This file does not switch to it; do so yourself, in simulation first."
)
CHANNEL = (
    "Steering delay, lag, dead band and gain are those from the recorded steering channel to the wheels. They are the "
    "actuator's only if that channel was the command. steer_bias, in turn, supposes that it was the reported angle."
)
POSE = (
    "The pose of the IMU in base_link, turned by yaw, then pitch, then roll. It is that of the recorded axes, after "
    "whatever the recording's mapping turned or negated. For an IMU on a sensor kit, take the kit's own pose out first."
)


def autoware(known: Exported) -> dict[str, str]:
    """Parameter files by name; one that nothing identified has a key in is empty."""
    car = Car(known)
    entries = {
        "mpc.param.yaml": [*_control(car), *_dynamics(car)],
        "simulator_model.param.yaml": _simulator(car),
        "vehicle_info.param.yaml": _dimensions(car),
        "sensors_calibration.yaml": _pose(car),
    }
    end = left_over(known, [*chain(*entries.values())])
    texts = {
        "mpc.param.yaml": _mpc_file(car, end),
        "simulator_model.param.yaml": _simulator_file(car, end),
        "vehicle_info.param.yaml": _dimensions_file(car, end),
        "sensors_calibration.yaml": _pose_file(car, end),
    }
    return {name: text if has_identified(entries[name]) else "" for name, text in texts.items()}


def _mpc_file(car: Car, end: list[str]) -> str:
    title = "Autoware, mpc_lateral_controller: keys of mpc.param.yaml"
    opening = [*head(title, car.known, (AXLE_VALUES, MODEL, CHANNEL)), *end]
    return yaml_file(car.known, opening, PARAMETERS, _control(car), {"vehicle": _dynamics(car)})


def _simulator_file(car: Car, end: list[str]) -> str:
    title = "Autoware, simple_planning_simulator: keys of simulator_model.param.yaml, model DELAY_STEER_ACC_GEARED"
    return yaml_file(car.known, [*head(title, car.known, (CHANNEL,)), *end], PARAMETERS, _simulator(car))


def _dimensions_file(car: Car, end: list[str]) -> str:
    title = "Autoware, vehicle description: keys of vehicle_info.param.yaml"
    return yaml_file(car.known, [*head(title, car.known), *end], PARAMETERS, _dimensions(car))


def _pose_file(car: Car, end: list[str]) -> str:
    title = "Autoware, individual parameters: the IMU in sensors_calibration.yaml"
    return yaml_file(car.known, [*head(title, car.known, (POSE,)), *end], ("base_link", IMU), _pose(car))


def _control(car: Car) -> list[Entry]:
    """The delays that the controller makes up for."""
    return [car.same("input_delay", "steering_delay.time"), car.same("vehicle_model_steer_tau", "steering_lag.time")]


def _dynamics(car: Car) -> list[Entry]:
    """The load on each wheel [kg], from which Autoware has l_f and I_z = m l_f l_r, and axle stiffnesses [N/rad]."""
    needs = ("m", "L", "l_f")
    front = [car.entry(f"mass_f{side}", "kg", lambda m, L, l_f: 0.5 * m * (L - l_f) / L, *needs) for side in "lr"]
    rear = [car.entry(f"mass_r{side}", "kg", lambda m, L, l_f: 0.5 * m * l_f / L, *needs) for side in "lr"]
    axle = "AXLE value"
    return [*front, *rear, car.same("cf", "C_alpha_f", axle), car.same("cr", "C_alpha_r", axle)]


def _simulator(car: Car) -> list[Entry]:
    """How the simulator's actuators follow their commands."""
    return [
        car.same("steer_time_delay", "steering_delay.time"),
        car.same("steer_time_constant", "steering_lag.time", "the simulator takes at least 0.03 s"),
        car.entry("steer_dead_band", "rad", lambda w: 0.5 * w, "steering_dead_band.width", note="half the play"),
        car.entry(
            "steer_bias", "rad", lambda angle: -angle, "steering_offset.angle",
            note="reported less true angle: the other sign of our offset, which is true less reported",
        ),
        car.same("debug_steer_scaling_factor", "steering_ratio.gain", _of_ratio(car)),
        car.same("acc_time_delay", "drive_delay.time"),
    ]  # fmt: skip


def _of_ratio(car: Car) -> str:
    """What the steering gain means, which depends on whether a steering ratio is stated."""
    ratio = car.quantity("steering_ratio")
    if ratio is None:
        return "true per recorded angle"
    return f"it makes the stated steering ratio {ratio.mean:.4g}: where you can, correct that in place of this"


def _dimensions(car: Car) -> list[Entry]:
    return [
        car.same("wheel_radius", "R_f", "free radius of the front tyres"),
        car.same("wheel_base", "L"),
        car.same("wheel_tread", "track_f", "front"),
    ]


def _pose(car: Car) -> list[Entry]:
    """R_z(yaw) R_y(pitch) R_x(roll) takes the IMU's axes to the car's, as URDF's rpy does."""
    turns = [car.same(name, f"imu_misalignment.{name}") for name in ("roll", "pitch", "yaw")]
    return [*(car.place(axis) for axis in "xyz"), *turns]
