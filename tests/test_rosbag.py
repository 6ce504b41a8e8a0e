"""ROS bags of either generation and storage come back as the drive that was written, on every topic's own clock."""

import re
import shutil
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_drive import DRIVE, PNG, assert_is_the_drive, cut_at, damaged, refused
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.formats.ros_definitions import DEFINITIONS
from vehicle_sbi.data.formats.ros_messages import numbers
from vehicle_sbi.data.inspection.inspection import inspect
from vehicle_sbi.data.inspection.spoken import spoken
from vehicle_sbi.data.mapping import mapping_file
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).parent.parent
START = 1_700_000_000_000_000_000  # [ns]
STEERING, VELOCITY, IMU = "/vehicle/status/steering_status", "/vehicle/status/velocity_status", "/sensing/imu/imu_data"
STEPS = {STEERING: 0.02, VELOCITY: 0.03, IMU: 0.01}  # [s]
LATE = 4_000_000  # [ns] from stamp to reception
SECONDS = 6.0


def store(ros2: bool):
    found = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    for name, text in DEFINITIONS.items():
        found.register(get_types_from_msg(text, name))
    return found


def messages(types, ros2: bool, imu: bool, frame: str = "imu_link"):
    """(topic, type, stamp [ns], message) of the drive, topic by topic."""
    kinds = types.types
    stamp = kinds["builtin_interfaces/msg/Time"]
    vector = kinds["geometry_msgs/msg/Vector3"]

    def header(now: int, k: int):
        extra = {} if ros2 else {"seq": k}
        return kinds["std_msgs/msg/Header"](
            stamp=stamp(sec=now // 10**9, nanosec=now % 10**9), frame_id=frame[: 3 + k % 3], **extra
        )

    for topic, step in STEPS.items():
        if topic == IMU and not imu:
            continue
        for k, t in enumerate(np.arange(0.0, SECONDS, step) + (0.31 if topic == IMU else 0.0)):
            now = START + round(t * 1e9)
            x = {name: float(value(np.asarray((now - START) / 1e9))) for name, value in DRIVE.items()}
            if topic == STEERING:
                name = "autoware_vehicle_msgs/msg/SteeringReport"
                one = kinds[name](stamp=stamp(sec=now // 10**9, nanosec=now % 10**9), steering_tire_angle=x["steering"])
            elif topic == VELOCITY:
                name = "autoware_vehicle_msgs/msg/VelocityReport"
                one = kinds[name](
                    header=header(now, k),
                    longitudinal_velocity=x["v_x"],
                    lateral_velocity=0.0,
                    heading_rate=x["yaw_rate"],
                )
            else:
                name = "sensor_msgs/msg/Imu"
                one = kinds[name](
                    header=header(now, k),
                    orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                    orientation_covariance=np.zeros(9),
                    angular_velocity=vector(x=0.0, y=0.0, z=x["yaw_rate"]),
                    angular_velocity_covariance=np.zeros(9),
                    linear_acceleration=vector(x=x["a_x"], y=x["a_y"], z=9.81),
                    linear_acceleration_covariance=np.zeros(9),
                )
            yield topic, name, now, one


def written(folder: Path, kind: str, *, imu: bool = True, definitions: bool = True) -> Path:
    ros2 = not kind.startswith("ros1")
    types = store(ros2)
    path = folder / ("drive.bag" if not ros2 else "drive")
    if ros2:
        plugin = StoragePlugin.MCAP if "mcap" in kind else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if kind.endswith("file"):
            writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
        if kind.endswith("chunk"):
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        if kind.endswith("message"):
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    else:
        writer = Writer1(path)
        if kind != "ros1":
            writer.set_compression(Writer1.CompressionFormat[kind.removeprefix("ros1 ").upper()])
    with writer:
        connections = {}
        for topic, name, now, one in messages(types, ros2, imu):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=types)
            data = types.serialize_cdr(one, name) if ros2 else types.serialize_ros1(one, name)
            writer.write(connections[topic], now + LATE, data)
    if not definitions:
        with sqlite3.connect(next(path.glob("*.db3"))) as base:
            base.execute("DELETE FROM message_definitions")
    return path


AUTOWARE = ROOT / "conf/mapping/autoware.yaml"
USED = {"steering": 0.02, "v_x": 0.03, "yaw_rate": 0.01, "a_y": 0.01, "a_x": 0.01}
REST = ("a_z", "roll_rate", "pitch_rate")


@pytest.mark.parametrize(
    "kind",
    [
        "sqlite3",
        "mcap",
        "ros1",
        "ros1 bz2",
        "ros1 lz4",
        "sqlite3 file",
        "sqlite3 message",
        "mcap chunk",
        "mcap message",
    ],
)
def test_a_bag_comes_back_as_the_drive(tmp_path, kind):
    mapping = {name: one for name, one in mapping_file(AUTOWARE).items() if name not in REST}
    rec = RecordingFile(path=written(tmp_path, kind), mapping=mapping).load()
    assert rec.rate == pytest.approx(100.0)
    # the recording's time begins at the first reception, LATE after the drive's; float32 rounds v_x by 2e-6
    moved = replace(rec, t=rec.t + LATE / 1e9)
    assert_is_the_drive(moved, USED, rounding=2e-6)
    said = "\n".join(rec.notes)
    assert "clock of /sensing/imu/imu_data begins 0.310 s after that of /vehicle/status/steering_status" in said
    assert "its time is header.stamp; the bag received it 0.004 s later" in said


def test_a_single_storage_file_is_a_bag_too(tmp_path):
    folder = written(tmp_path, "mcap")
    tables = read_tables(next(folder.glob("*.mcap")))
    assert {table.clock for table in tables} == set(STEPS)
    assert {table.unit(f"{VELOCITY}.longitudinal_velocity") for table in tables if table.clock == VELOCITY} == {"m/s"}


def test_old_bags_without_definitions_are_read_with_ours(tmp_path):
    folder = written(tmp_path, "sqlite3", definitions=False)
    assert {table.clock for table in read_tables(folder)} == set(STEPS)


def test_autoware_without_an_imu_takes_the_heading_rate_and_says_so(tmp_path):
    rec = RecordingFile(path=written(tmp_path, "mcap", imu=False), mapping=AUTOWARE).load()
    assert set(rec.channels) == {"steering", "v_x", "yaw_rate"}
    assert any(note.startswith("yaw_rate: the bag has no IMU; it is the heading rate") for note in rec.notes)


def test_a_hand_written_message_decodes_with_its_alignment():
    """uint8, then float64 at 8, a text of 3 bytes and its NUL, float32 at 24, an array, all from the CDR's byte 4."""
    types = get_types_from_msg("uint8 a\nfloat64 b\nstring s\nfloat32 c\nint16[2] d\nfloat64[] e\n", "p/msg/M")
    body = (
        bytes([7]) + bytes(7) + np.float64(1.5).tobytes() + np.uint32(4).tobytes() + b"abc\0"
        + np.float32(2.5).tobytes() + np.array([-3, 4], "<i2").tobytes() + np.uint32(1).tobytes() + bytes(4)
        + np.float64(9.0).tobytes()
    )  # fmt: skip
    found = numbers([bytes([0, 1, 0, 0]) + body] * 2, "p/msg/M", types, cdr=True)
    assert {name: values.tolist() for name, values in found.items()} == {
        "a": [7, 7], "b": [1.5] * 2, "c": [2.5] * 2, "d.0": [-3] * 2, "d.1": [4] * 2, "e.0": [9.0] * 2,
    }  # fmt: skip


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["sqlite3", "mcap", "ros1"])
def test_cut_bags_are_refused(tmp_path, kind):
    path = written(tmp_path, kind)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".db3", ".mcap"))
    for copy in cut_at(file, (0.0, 0.01, 0.3, 0.7, 0.95)):
        refused(copy, mapping=AUTOWARE)


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag"])
@pytest.mark.parametrize("content", [b"", PNG, b"time_s,v_x_mps\n0,1\n", b"\x89MCAP0\r\n", b"SQLite format 3\0"])
def test_foreign_files_are_refused(tmp_path, suffix, content):
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(content)
    refused(path, mapping=AUTOWARE)


@pytest.mark.parametrize(
    "metadata",
    [
        "",
        "rosbag2_bagfile_information: [1, 2]",
        "rosbag2_bagfile_information: {version: 5}",
        "!!python/object/apply:os.system ['touch executed']",
        "a: &a [*a]",
    ],
)
def test_hostile_metadata_is_refused_and_not_executed(tmp_path, metadata, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive/metadata.yaml").write_text(metadata)
    refused(tmp_path / "drive", mapping=AUTOWARE)
    assert not (tmp_path / "executed").exists()


def test_a_bag_reads_and_writes_only_in_its_own_folder(tmp_path):
    """Paths of storage files that lead elsewhere count by their last name."""
    folder = written(tmp_path, "sqlite3")
    shutil.copy(next(folder.glob("*.db3")), tmp_path / "elsewhere.db3")
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = ["../elsewhere.db3"]
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    before = sorted(tmp_path.rglob("*"))
    refused(folder, "missing", mapping=AUTOWARE)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_database_with_a_view_is_refused(tmp_path):
    """`messages` as a view could count without end."""
    path = tmp_path / "drive.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id+1 FROM n) "
            "SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n"
        )
    refused(path, "its database holds table, view", mapping=AUTOWARE)


def test_definitions_of_a_bag_are_never_executed(tmp_path):
    """A definition that would be code if it were compiled: reading leaves no module of its kind, and runs nothing."""
    folder = written(tmp_path, "mcap")
    sys.modules.pop("rosbags.usertypes", None)
    read_tables(folder)
    assert "rosbags.usertypes" not in sys.modules


def test_a_missing_library_is_named_with_its_command(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "drive.mcap").write_bytes(b"x")
    with pytest.raises(InputError, match=r"a ROS bag needs rosbags, .*: pip install 'vehicle_sbi\[ros\]'"):
        read_tables(tmp_path / "drive.mcap")


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", ["sqlite3", "mcap", "ros1"])
def test_damaged_bytes_never_get_more_than_a_line(tmp_path, kind):
    path = written(tmp_path, kind)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".db3", ".mcap"))
    damaged(file, mapping=AUTOWARE)


TWIST = "geometry_msgs/msg/TwistStamped"


def twist(types, place: int, stamp: int | None = None):
    """A message with speed `place` [m/s], stamped `place` times 10 ms after START unless said otherwise [ns]."""
    kinds = types.types
    now = START + 10_000_000 * place if stamp is None else stamp
    header = kinds["std_msgs/msg/Header"](
        stamp=kinds["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9), frame_id="car"
    )
    speed, zero = (kinds["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0) for x in (float(place), 0.0))
    return kinds[TWIST](header=header, twist=kinds["geometry_msgs/msg/Twist"](linear=speed, angular=zero))


def test_a_topic_that_is_sent_once_is_listed_beside_the_others(tmp_path):
    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds = types.types
    still = kinds["tf2_msgs/msg/TFMessage"](transforms=[])
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        once = writer.add_connection("/a_once", TWIST, typestore=types)
        static = writer.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=types)
        often = writer.add_connection("/v", TWIST, typestore=types)
        writer.write(once, START, types.serialize_cdr(twist(types, 0), TWIST))
        writer.write(static, START, types.serialize_cdr(still, "tf2_msgs/msg/TFMessage"))
        for k in range(100):
            writer.write(often, START + 10_000_000 * k, types.serialize_cdr(twist(types, k), TWIST))
    found = inspect(RecordingFile(path=tmp_path / "bag"))
    assert found.tables[0].clock.name == "/v"
    assert "  /a_once: 1 row, too few for a signal" in spoken(found)
    assert found.guesses[0].columns == ("/v.twist.linear.x",)


def test_topics_that_cannot_be_read_are_named_beside_those_that_are_used(tmp_path):
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        odd = writer.add_connection("/odd", TWIST, typestore=types)
        often = writer.add_connection("/v", TWIST, typestore=types)
        writer.write(odd, START, bytes(types.serialize_cdr(twist(types, 0), TWIST))[:20])
        for k in range(100):
            writer.write(often, START + 10_000_000 * k, types.serialize_cdr(twist(types, k), TWIST))
    found = inspect(RecordingFile(path=tmp_path / "bag"))
    said = [note for note in found.notes if note.startswith("topics that cannot be read: /odd (")]
    assert len(said) == 1
    assert said[0] in spoken(found)


def test_a_folder_with_a_storage_file_and_no_metadata_names_the_file(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "drive_0.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=r"it holds drive_0\.mcap: name that file"):
        RecordingFile(path=tmp_path / "bag").load()


def test_messages_are_sorted_and_those_with_equal_times_counted_as_rows_of_any_file_are(tmp_path):
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/v", "geometry_msgs/msg/TwistStamped", typestore=types)
        for k, place in enumerate([*range(50), 49, *range(50, 80), 81, 80, *range(82, 100)]):
            writer.write(connection, START + 10_000_000 * k, types.serialize_cdr(twist(types, place), TWIST))
    rec = RecordingFile(path=tmp_path / "bag", mapping={"v_x": {"column": "/v.twist.linear.x"}}).load()
    assert "/v: messages put in the order of their time" in rec.notes
    assert "/v: 1 of 101 rows repeat the time of the row above: of equal times the first is kept" in rec.notes
    np.testing.assert_allclose(rec.channels["v_x"], np.arange(100.0))


@pytest.mark.parametrize(("unset", "kept"), [(1, 99), (40, 60), (60, 100)])
def test_most_stamps_decide_and_messages_of_the_others_are_left_out(tmp_path, unset, kept):
    """A stamp that is not set is 0; where most are, reception counts for all messages of the topic."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/v", TWIST, typestore=types)
        for k in range(100):
            message = twist(types, k, stamp=0 if k < unset else None)
            writer.write(connection, START + 10_000_000 * k + LATE, types.serialize_cdr(message, TWIST))
    (table,) = read_tables(tmp_path / "bag")
    assert len(table.numbers("t")) == kept
    np.testing.assert_allclose(np.diff(table.numbers("t")), 0.01, atol=1e-9)
    said = "\n".join(table.notes)
    if kept == 100:
        assert "its time is the bag's reception, as header.stamp lies 1.7e+09 s from it in the median" in said
    else:
        assert "its time is header.stamp; the bag received it 0.004 s later (0.004 to 0.004 s)" in said
        assert f"/v: {unset} of 100 messages left out: their header.stamp lies more than 10 s from" in said


@pytest.mark.parametrize("jump", [86_400, 1_700_000_000])
def test_a_clock_that_jumps_is_refused_and_can_be_cut(tmp_path, jump):
    """The bag's clock is set, from an epoch near zero, in the middle of the drive; messages have no stamps."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/v", "std_msgs/msg/Float64", typestore=types)
        for k in range(1000):
            message = types.types["std_msgs/msg/Float64"](data=10.0 + np.sin(k / 50.0))
            now = 10_000_000 * k + 10**9 * (0 if k < 600 else jump)
            writer.write(connection, now, types.serialize_cdr(message, "std_msgs/msg/Float64"))
    mapping = {"v_x": {"column": "/v.data"}}
    said = re.escape(f"time jumps by {jump + 0.01:.6g} s at row 601, and 1000 samples would become")
    refused(tmp_path / "bag", said, mapping=mapping)
    before = RecordingFile(path=tmp_path / "bag", mapping=mapping, stop_s=5.99).load()
    assert len(before.t) == 600
