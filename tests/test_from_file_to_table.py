"""From a user's own file to a table of parameters in three commands: inspect, run, export.

A car of known parameters is driven by the simulator, and written as a ROS bag, an MDF4 file and a MoTeC CSV: each in
units, signs and clocks of its own, with noise. The files that `inspect` writes are edited as it says, by nothing else.
`VEHICLE_SBI` names another executable than the one beside this Python, such as that of a wheel's environment.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from asammdf import MDF, Signal
from cars import finished, record_of
from exports import shown
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vehicle_sbi.data.formats.ros_definitions import DEFINITIONS
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.vehicle import GRAVITY, Vehicle

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

COMMAND = os.environ.get("VEHICLE_SBI", str(Path(sys.executable).with_name("vehicle-sbi")))
M, L = 1480.0, 2.72
CAR = Vehicle(
    name="truth", m=M, L=L, l_f=1.28, h_cog=0.55, C_kappa_f=1.4e5, C_kappa_r=1.3e5, C_alpha_f=1.15e5,
    C_alpha_r=1.45e5, mu=0.95, R_f=0.32, I_wf=3.0, I_wr=3.0, steering_ratio=15.5,
)  # fmt: skip
TRUTH = {"l_f": CAR.l_f, "C_alpha_f": CAR.C_alpha_f, "C_alpha_r": CAR.C_alpha_r, "steering_ratio.gain": 1.0}
NOISE = {"steering": 2e-4, "v_x": 0.02, "yaw_rate": 0.003, "a_y": 0.08, "a_x": 0.08}  # [SI]
RATE, SECONDS = 200.0, 24.0
QUICK = ["experiment=smoke", "rounds.simulations=600", "training.max_epochs=60"]
PAPERS = ("m", "L", "steering_ratio", "drive_front")  # what those of a car say
STATED = {name: getattr(CAR, name) for name in PAPERS}
FILES = ["mapping=drive.mapping.yaml", "vehicle=drive.vehicle.yaml"]
INTERVAL = 1.645  # standard deviations from the middle of a normal's 90 % interval to its ends
WIDEST = 3.5  # the same, beyond which one of 12 draws lies in 1 of 180 tests


def drive() -> dict[str, np.ndarray]:
    """SI channels at RATE: a swept steering at 9 to 23 m/s that stays below half of the friction."""
    t = np.arange(round(SECONDS * RATE) + 1) / RATE
    u = np.zeros((len(t), len(INPUTS)))
    v_x = 16.0 - 7.0 * np.cos(2.0 * np.pi * t / SECONDS)
    steering = 3.5 / v_x**2 * (2.72 + 0.004 * v_x**2) * np.sin(2.0 * np.pi * (0.2 * t + 0.008 * t**2))
    for name, values in {"time": t, "steering": steering, "v_x": v_x}.items():
        u[:, INPUTS.index(name)] = values
    u[:, 4] = np.gradient(v_x, t)
    y = finished(record_of(CAR), "speed", u, [v_x[0], 0.0, 0.0])
    return {"t": t, "steering": steering} | {
        name: y[MEASUREMENTS.index(name)] for name in ("v_x", "yaw_rate", "a_y", "a_x")
    }


@dataclass(frozen=True)
class Sensor:
    """A clock with its own rate and start [s], and its noise."""

    step: float
    start: float
    seed: int

    def read(self, *names: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times of the drive [s] and noisy channels in SI."""
        driven, rng = drive(), np.random.default_rng(self.seed)
        t = np.arange(self.start, SECONDS, self.step)
        return t, {
            name: np.interp(t, driven["t"], driven[name]) + NOISE[name] * rng.normal(size=len(t)) for name in names
        }


def mcap(folder: Path) -> Path:
    """Three topics, each with its own rate and start, in an epoch's nanoseconds; received later than stamped."""
    epoch, late = 1_700_000_000_000_000_000, 3_000_000  # [ns]
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    kinds = types.types
    imu_t, imu = Sensor(0.01, 0.31, 1).read("a_x", "a_y", "yaw_rate")
    speed_t, speed = Sensor(0.03, 0.0, 2).read("v_x")
    steer_t, steer = Sensor(0.02, 0.013, 3).read("steering")

    def stamp(now: int):
        return kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)

    def header(now: int):
        return kinds["std_msgs/msg/Header"](stamp=stamp(now), frame_id="base_link")

    def vector(x: float, y: float, z: float):
        return kinds["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)

    def inertial(now: int, k: int):
        return kinds["sensor_msgs/msg/Imu"](
            header=header(now), orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9), angular_velocity=vector(0.0, 0.0, imu["yaw_rate"][k]),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(imu["a_x"][k], imu["a_y"][k], GRAVITY),
            linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip

    def velocity(now: int, k: int):
        return kinds["autoware_vehicle_msgs/msg/VelocityReport"](
            header=header(now), longitudinal_velocity=speed["v_x"][k], lateral_velocity=0.0, heading_rate=0.0
        )

    def steered(now: int, k: int):
        return kinds["autoware_vehicle_msgs/msg/SteeringReport"](
            stamp=stamp(now), steering_tire_angle=steer["steering"][k]
        )

    topics = {
        "/vehicle/status/steering_status": ("autoware_vehicle_msgs/msg/SteeringReport", steer_t, steered),
        "/vehicle/status/velocity_status": ("autoware_vehicle_msgs/msg/VelocityReport", speed_t, velocity),
        "/sensing/imu/imu_data": ("sensor_msgs/msg/Imu", imu_t, inertial),
    }
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (kind, times, message) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=types)
            for k, t in enumerate(times):
                now = epoch + round(t * 1e9)
                writer.write(connection, now + late, types.serialize_cdr(message(now, k), kind))
    return next((folder / "bag").glob("*.mcap")).rename(folder / "drive.mcap")


def mf4(folder: Path) -> Path:
    """Degrees, km/h and degrees a second that the file states, g that it does not, and a yaw rate to the right."""
    motion_t, motion = Sensor(0.01, 0.0, 4).read("yaw_rate", "a_y", "steering")
    speed_t, speed = Sensor(0.02, 0.117, 5).read("v_x")
    file = MDF(version="4.10")
    groups = {
        "IMU": (motion_t, {
            "YawRate": (-np.degrees(motion["yaw_rate"]), "deg/s"), "LatAcc": (motion["a_y"] / GRAVITY, ""),
            "SteeringWheelAngle": (np.degrees(motion["steering"]) * STATED["steering_ratio"], "deg"),
        }),
        "ESP": (speed_t, {"VehicleSpeed": (3.6 * speed["v_x"], "km/h")}),
    }  # fmt: skip
    for name, (t, columns) in groups.items():
        signals = [Signal(values, t, name=column, unit=unit) for column, (values, unit) in columns.items()]
        file.append(signals, acq_name=name, common_timebase=True)
    file.save(folder / "drive.mf4", compression=2)
    file.close()
    return folder / "drive.mf4"


def motec(folder: Path) -> Path:
    """A preamble, all in quotes, a clock that begins with the session's, a steering positive to the right."""
    t, driven = Sensor(0.01, 0.0, 6).read("steering", "v_x", "a_y", "a_x", "yaw_rate")
    columns = {
        "Time": (t + 312.4, "s", 3),
        "Steered Angle": (-np.degrees(driven["steering"]) * STATED["steering_ratio"], "deg", 2),
        "Ground Speed": (3.6 * driven["v_x"], "km/h", 2),
        "G Force Lat": (driven["a_y"] / GRAVITY, "G", 4),
        "G Force Long": (driven["a_x"] / GRAVITY, "G", 4),
        "Gyro Yaw Velocity": (np.degrees(driven["yaw_rate"]), "deg/s", 3),
    }

    def quoted(words: Iterable[str]) -> str:
        return ",".join(f'"{word}"' for word in words)

    preamble = {"Format": "MoTeC CSV File", "Venue": "Airfield", "Vehicle": "truth", "Sample Rate": "100.000"}
    rows = zip(*(values for values, _, _ in columns.values()), strict=True)
    digits = [digits for _, _, digits in columns.values()]
    lines = [
        *(quoted(pair) for pair in preamble.items()), "",
        quoted(columns), quoted(unit for _, unit, _ in columns.values()), "",
        *(quoted(f"{value:.{n}f}" for value, n in zip(row, digits, strict=True)) for row in rows),
    ]  # fmt: skip
    (folder / "drive.csv").write_text("\n".join(lines) + "\n")
    return folder / "drive.csv"


def vehicle_sbi(folder: Path, *words: str) -> str:
    """What a command prints, run in a folder that is no checkout; it must end well and say no traceback."""
    environment = {key: value for key, value in os.environ.items() if key not in ("HYDRA_FULL_ERROR", "PYTHONPATH")}
    done = subprocess.run([COMMAND, *words], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{words}: {done.stderr[-2000:]}"
    return done.stdout


def edited(folder: Path, said: str) -> None:
    """The edits that an inspection calls for: signs, units, and what the vehicle file has no number for."""
    mapping = yaml.safe_load((folder / "drive.mapping.yaml").read_text())
    for channel in re.findall(r"is (\w+)(?:, or [\w ]+)? flipped\?", said):
        mapping[channel]["sign"] = -1
    for channel, unit in re.findall(r"is (\w+) in (\S+) rather than", said):
        mapping[channel]["unit"] = unit
    (folder / "drive.mapping.yaml").write_text(yaml.safe_dump(mapping))
    text = (folder / "drive.vehicle.yaml").read_text()
    for name, value in STATED.items():
        text = re.sub(rf'^{name}: ".*?"', f"{name}: {value}", text, flags=re.MULTILINE)
    (folder / "drive.vehicle.yaml").write_text(text)


def assert_holds_the_truth(table: pd.DataFrame) -> None:
    """Every identified parameter within WIDEST standard deviations of its interval's middle.

    A deviation is that of the interval, or the Cramér-Rao bound where the few simulations have learned less than it.
    """
    rows = {row["parameter"]: row for row in table.to_dict("records")}
    for name, truth in TRUTH.items():
        row = rows[name]
        assert row["identified"], name
        deviation = max((row["q95"] - row["q05"]) / (2.0 * INTERVAL), row["bound_std"])
        assert abs(truth - 0.5 * (row["q05"] + row["q95"])) < WIDEST * deviation, f"{name}: {row}"


def exported(folder: Path, run: Path) -> Mapping[str, float]:
    """What an Autoware node would find of the vehicle in the files that `export` writes of a run."""
    vehicle_sbi(folder, "export", str(run), "format=autoware")
    parsed = [yaml.safe_load(file.read_text()) for file in sorted((run / "export/autoware").glob("*.yaml"))]
    assert len(parsed) == 2
    return next(
        one["/**"]["ros__parameters"]["vehicle"] for one in parsed if "vehicle" in one["/**"]["ros__parameters"]
    )


@dataclass(frozen=True)
class Journey:
    """A file's writer and what an inspection finds wrong in it: (channel, word of the question)."""

    write: Callable[[Path], Path]
    wrong: Mapping[str, str]


JOURNEYS = {
    "mcap": Journey(mcap, {}),
    "mf4": Journey(mf4, {"yaw_rate": "is yaw_rate flipped?", "a_y": "is a_y in g rather than m/s²?"}),
    "motec": Journey(motec, {"steering_wheel": "is steering_wheel, or a_y with yaw_rate flipped?"}),
}


def inspected(folder: Path, journey: Journey) -> Path:
    """The file, inspected and its mapping and vehicle edited as it says; a second look then finds nothing."""
    file = journey.write(folder)
    said = vehicle_sbi(folder, "inspect", file.name)
    found = said.partition("what looks wrong\n")[2].partition("\n\n")[0]
    assert [
        line for line in found.splitlines() if "?" in line and not any(q in line for q in journey.wrong.values())
    ] == []
    assert all(question in found for question in journey.wrong.values())
    assert f"vehicle-sbi run {file.name} {' '.join(FILES)}" in said
    edited(folder, said)
    assert "nothing that this drive tells" in vehicle_sbi(folder, "inspect", file.name, FILES[0])
    return file


@pytest.mark.parametrize("kind", JOURNEYS)
def test_three_commands_lead_from_a_file_to_a_table_that_holds_the_truth(kind: str, tmp_path: Path) -> None:
    file = inspected(tmp_path, JOURNEYS[kind])
    vehicle_sbi(tmp_path, "run", file.name, *FILES, *QUICK)
    (run,) = (tmp_path / "outputs").iterdir()
    table = pd.read_csv(run / "table.csv")
    assert_holds_the_truth(table)
    mean, std = (table.set_index("parameter")[column] for column in ("mean", "std"))
    vehicle = exported(tmp_path, run)
    assert vehicle["cf"] == shown(mean["C_alpha_f"], std["C_alpha_f"])
    assert vehicle["cr"] == shown(mean["C_alpha_r"], std["C_alpha_r"])
    masses = sum(vehicle[f"mass_{wheel}"] for wheel in ("fl", "fr", "rl", "rr"))
    assert masses == shown(M, 4 * 0.5 * M / L * std["l_f"])


def test_the_same_files_are_diagnosed(tmp_path: Path) -> None:
    file = inspected(tmp_path, JOURNEYS["motec"])
    vehicle_sbi(tmp_path, "diagnose", file.name, *FILES, "figures=false")
    (run,) = (tmp_path / "outputs/diagnosis").iterdir()
    effects = json.loads((run / "verdict.json").read_text())["effects"]
    assert effects
    assert all(0.0 <= probability <= 1.0 for probability in effects.values())
    assert exported(tmp_path, run)["cf"] > 0.0
