"""Files as a maker's logger or driver writes them are read by the preset of that name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_drive import DRIVE, assert_is_the_drive
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.constants import g
from test_rosbag import store

from vehicle_sbi import read
from vehicle_sbi.physics.vehicle import GRAVITY

START = 1_700_000_000_000_000_000  # [ns]
SECONDS = 6.0
STEPS = {"/drive": 0.02, "/odom": 0.02, "/imu/data": 0.01}  # [s]


def racing_bag(folder: Path, topics: tuple[str, ...]) -> Path:
    """A RoboRacer bag: the command to the servo, odometry of the VESC, and an IMU if that topic is asked for."""
    types = store(ros2=True)
    kinds = types.types
    vector = kinds["geometry_msgs/msg/Vector3"]

    def header(now: int):
        stamp = kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
        return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")

    def turned():
        return kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)

    def message(topic: str, now: int, x: dict[str, float]):
        if topic == "/drive":
            command = kinds["ackermann_msgs/msg/AckermannDrive"](
                steering_angle=x["steering"], steering_angle_velocity=0.0, speed=x["v_x"], acceleration=0.0, jerk=0.0
            )
            return kinds["ackermann_msgs/msg/AckermannDriveStamped"](header=header(now), drive=command)
        if topic == "/odom":
            pose = kinds["geometry_msgs/msg/Pose"](
                position=kinds["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=0.0), orientation=turned()
            )
            twist = kinds["geometry_msgs/msg/Twist"](
                linear=vector(x=x["v_x"], y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=x["yaw_rate"])
            )
            return kinds["nav_msgs/msg/Odometry"](
                header=header(now), child_frame_id="base_link",
                pose=kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
                twist=kinds["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
            )  # fmt: skip
        return kinds["sensor_msgs/msg/Imu"](
            header=header(now), orientation=turned(), orientation_covariance=np.zeros(9),
            angular_velocity=vector(x=0.0, y=0.0, z=x["yaw_rate"]), angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=x["a_x"], y=x["a_y"], z=GRAVITY), linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip

    path = folder / "race"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in topics:
            connection = None
            for t in np.arange(0.0, SECONDS, STEPS[topic]):
                now = START + round(t * 1e9)
                one = message(topic, now, {name: float(value(np.asarray(t))) for name, value in DRIVE.items()})
                connection = connection or writer.add_connection(topic, one.__msgtype__, typestore=types)
                writer.write(connection, now, types.serialize_cdr(one, one.__msgtype__))
    return path


def test_a_racing_cars_bag_has_its_servo_odometry_and_imu(tmp_path):
    found = read(racing_bag(tmp_path, ("/drive", "/odom", "/imu/data")), mapping="f1tenth")
    steps = {"steering": 0.02, "v_x": 0.02, "yaw_rate": 0.01, "a_x": 0.01, "a_y": 0.01}
    assert_is_the_drive(found, steps, rounding=2e-9)  # of the command, a float32
    assert any(note.startswith("steering: it is the command; the servo follows late") for note in found.notes)


def test_a_racing_cars_bag_without_an_imu_says_that_its_yaw_rate_holds_nothing(tmp_path):
    found = read(racing_bag(tmp_path, ("/drive", "/odom")), mapping="f1tenth")
    assert_is_the_drive(found, {"steering": 0.02, "v_x": 0.02, "yaw_rate": 0.02}, rounding=2e-9)
    assert any(note.startswith("yaw_rate: the bag has no IMU; VESC odometry") for note in found.notes)


@pytest.mark.parametrize("imu", [True, False], ids=["with its IMU", "GPS alone"])
def test_a_racelogic_box_has_its_own_units_and_turns_to_the_right(tmp_path, imu):
    t = np.arange(0.0, SECONDS, 0.01)
    x = {name: value(t) for name, value in DRIVE.items()}
    columns = {"time": [f"1200{s:06.3f}" for s in t], "velocity": 3.6 * x["v_x"]}
    long_names, swa = ["time", "velocity kmh"], {"SWA": np.degrees(15.0 * x["steering"])}
    if imu:  # columns of the box's own come first, those of modules and CAN last, their units in a list
        columns |= swa | {"X_Accel": x["a_x"] / g, "Y_Accel": x["a_y"] / g}
        columns |= {"YawRate": -np.degrees(x["yaw_rate"])}
        long_names, units = [*long_names, "SWA", "X_Accel", "Y_Accel", "YawRate"], ["\xb0", "g", "g", "\xb0/s"]
    else:
        columns |= {"Longacc": x["a_x"] / g, "Latacc": x["a_y"] / g} | swa
        long_names, units = [*long_names, "Long accel g", "Lat accel g", "SWA"], ["deg"]
    rows = [
        " ".join(c if isinstance(c, str) else f"{c:.9f}" for c in row) for row in zip(*columns.values(), strict=True)
    ]
    head = ["File created on 01/01/2020 @ 12:00", "", "[header]", *long_names, "", "[channel units]", *units, ""]
    head += ["[column names]", " ".join(columns), "", "[data]"]
    path = tmp_path / "drive.vbo"
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="latin-1")
    found = read(path, mapping="racelogic")
    wheel = found.channels["steering_wheel"]
    np.testing.assert_allclose(wheel, 15.0 * DRIVE["steering"](found.t), atol=1e-4)
    others = replace(found, channels={name: one for name, one in found.channels.items() if name != "steering_wheel"})
    steps: dict[str, float] = dict.fromkeys(["v_x", "a_x", "a_y", *(["yaw_rate"] if imu else [])], 0.01)
    assert_is_the_drive(others, steps, rounding=2e-8)
    assert any("derived from GPS" in note for note in found.notes) is not imu
