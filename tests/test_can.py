"""Raw CAN in BLF, ASC and MDF4: frames decode as `cantools` decodes them, and come back as the drive."""

import struct
import zlib
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from foreign_drive import DRIVE, PNG, assert_is_the_drive, cut_at, damaged, read_or_refused, refused

from vehicle_sbi.data.formats.can_frames import Frames, decoded
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.readers import RecordingFile

DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 Steering: 4 ECU
 SG_ Angle : 7|16@0- (0.001,0) [-32|32] "deg" ECU
 SG_ Counter : 16|8@1+ (1,0) [0|255] "" ECU
BO_ 512 Motion: 8 ECU
 SG_ Speed : 0|16@1+ (0.005,0) [0|300] "km/h" ECU
 SG_ YawRate : 16|16@1- (0.01,0) [-300|300] "deg/s" ECU
 SG_ LatAcc : 39|16@0- (0.0005,0) [-16|16] "g" ECU
 SG_ Odd : 48|13@1- (0.5,-3) [-100|100] "" ECU
BO_ 768 Muxed: 8 ECU
 SG_ Which M : 0|8@1+ (1,0) [0|3] "" ECU
 SG_ First m0 : 8|16@1- (0.01,0) [-300|300] "m/s" ECU
 SG_ Second m1 : 8|16@1- (0.01,0) [-300|300] "m/s^2" ECU
BO_ 1024 Floats: 8 ECU
 SG_ Real : 0|32@1- (1,0) [0|0] "m/s" ECU
SIG_VALTYPE_ 1024 Real : 1;
"""

MAPPING = {
    "steering": {"column": "Steering.Angle", "sign": -1},
    "v_x": {"column": "Motion.Speed"},
    "yaw_rate": {"column": "Motion.YawRate"},
    "a_y": {"column": "Motion.LatAcc", "sign": -1},
}
STEPS = {"steering": 0.02, "v_x": 0.01, "yaw_rate": 0.01, "a_y": 0.01}
ROUNDING = 0.0005 * 9.80665  # half a step of the coarsest signal, with some of its scale to spare


def database(folder: Path) -> Path:
    path = folder / "car.dbc"
    path.write_text(DBC)
    return path


def frames(dbc: Path, seconds: float = 6.0) -> list[can.Message]:
    base: Any = cantools.database.load_file(dbc)
    found = []
    for k, t in enumerate(np.arange(0.0, seconds, 0.01)):
        x = {name: float(value(np.asarray(t))) for name, value in DRIVE.items()}
        motion = {
            "Speed": x["v_x"] * 3.6, "YawRate": np.degrees(x["yaw_rate"]), "LatAcc": -x["a_y"] / 9.80665, "Odd": -7.5,
        }  # fmt: skip
        found.append((t, 512, base.encode_message(512, motion, strict=False)))
        if k % 2 == 0:
            angle = {"Angle": -np.degrees(x["steering"]), "Counter": k % 256}
            found.append((t, 256, base.encode_message(256, angle)))
        muxed = {"Which": 0, "First": t} if k % 3 else {"Which": 1, "Second": -t}
        found.append((t, 768, base.encode_message(768, muxed)))
    return [
        can.Message(timestamp=1.7e9 + t, arbitration_id=i, data=data, is_extended_id=False, channel=0)
        for t, i, data in found
    ]


def log(folder: Path, suffix: str) -> Path:
    path = folder / f"drive{suffix}"
    with can.Logger(path) as writer:
        for message in frames(database(folder)):
            writer(message)
    return path


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".mf4"])
def test_a_log_comes_back_as_the_drive(tmp_path, suffix):
    path = log(tmp_path, suffix)
    rec = RecordingFile(path=path, mapping=MAPPING, dbc=str(tmp_path / "car.dbc")).load()
    assert rec.rate == pytest.approx(100.0, rel=1e-3)
    assert_is_the_drive(rec, STEPS, rounding=ROUNDING + 6.0 * 1.5 * 1e-5)  # a BLF counts time in 10 us
    assert any("units as drive" in note and "v_x km/h, yaw_rate deg/s, a_y g" in note for note in rec.notes)
    assert "car.dbc" in rec.source


def test_signals_decode_as_cantools_decodes_them(tmp_path):
    """Both byte orders, signs, odd lengths, scales, multiplexers and floats, over random bytes."""
    dbc = database(tmp_path)
    base: Any = cantools.database.load_file(dbc)
    rng = np.random.default_rng(0)
    data = rng.integers(0, 256, (200, 8), dtype=np.uint8)
    for message in base.messages:
        rows = data.copy()
        if message.name == "Muxed":
            rows[:, 0] = np.arange(200) % 2
        if message.name == "Floats":
            rows[:, :4] = rng.normal(size=200).astype("<f4").view(np.uint8).reshape(200, 4)
        given = Frames(
            t=np.arange(200.0), identifiers=np.full(200, message.frame_id), data=rows,
            lengths=np.full(200, 8), bus=np.zeros(200, dtype=np.int64),
        )  # fmt: skip
        for table in decoded(dbc, given, dbc):
            which = table.columns["t"].astype(int)
            expected: list[Any] = [
                message.decode(rows[k, : message.length].tobytes(), decode_choices=False) for k in which
            ]
            for name in table.columns.keys() - {"t"}:
                signal = name.partition(".")[2]
                np.testing.assert_allclose(table.columns[name], [one[signal] for one in expected], rtol=1e-12)


def test_a_multiplexed_signal_has_the_clock_of_its_own_frames(tmp_path):
    tables = {table.clock: table for table in read_tables(log(tmp_path, ".blf"), tmp_path / "car.dbc")}
    second = tables["Muxed[Which=1]"]
    np.testing.assert_allclose(second.numbers("Muxed.Second"), -second.numbers("t"), atol=0.006)
    assert "Muxed.Second" not in tables["Muxed[Which=0]"].columns


def test_a_bus_with_a_copy_of_the_messages_is_left_out(tmp_path):
    one = Frames(
        t=np.arange(6.0), identifiers=np.full(6, 1024), data=np.zeros((6, 8), dtype=np.uint8),
        lengths=np.full(6, 8), bus=np.array([0, 1, 0, 1, 0, 0]),
    )  # fmt: skip
    (table,) = decoded(tmp_path, one, database(tmp_path))
    assert table.numbers("t").tolist() == [0.0, 2.0, 4.0, 5.0]
    assert table.notes


def test_frames_with_equal_times_are_counted_as_rows_of_any_file_are(tmp_path):
    """The first of them is kept, so the drive comes back although the others say something else."""
    path = tmp_path / "drive.blf"
    with can.BLFWriter(path) as writer:
        for k, message in enumerate(frames(database(tmp_path))):
            writer(message)
            if k % 100 == 0:
                zeros = bytes(len(message.data))
                writer(can.Message(timestamp=message.timestamp, arbitration_id=512, data=zeros, is_extended_id=False))
    rec = RecordingFile(path=path, mapping=MAPPING, dbc=str(tmp_path / "car.dbc")).load()
    assert_is_the_drive(rec, STEPS, rounding=ROUNDING + 6.0 * 1.5 * 1e-5)
    assert [note for note in rec.notes if note.startswith("Motion: ") and "repeat the time of the row above" in note]


def test_what_is_missing_is_said(tmp_path):
    path, dbc = log(tmp_path, ".blf"), str(tmp_path / "car.dbc")
    refused(path, "holds raw CAN frames: recording.dbc=FILE.dbc", mapping=MAPPING)
    refused(path, "nowhere.dbc: no such file", mapping=MAPPING, dbc=str(tmp_path / "nowhere.dbc"))
    (tmp_path / "png.dbc").write_bytes(PNG)
    refused(path, "png.dbc: cannot be read as a CAN database", mapping=MAPPING, dbc=str(tmp_path / "png.dbc"))
    (tmp_path / "other.dbc").write_text(DBC.replace("BO_ 256", "BO_ 257").split("BO_ 512")[0])
    refused(path, "holds none of the 1 messages of .*other.dbc; it holds 0x100, 0x200", dbc=str(tmp_path / "other.dbc"))
    (tmp_path / "drive.csv").write_text("time_s,v_x_mps\n0,1\n1,1\n2,1\n")
    refused(tmp_path / "drive.csv", "a dbc is for raw CAN frames", dbc=dbc)
    refused(path, r"unknown column 'Motion.Sped'", mapping={"v_x": {"column": "Motion.Sped"}}, dbc=dbc)


@pytest.mark.parametrize("suffix", [".blf", ".mf4"])
def test_cut_logs_are_refused(tmp_path, suffix):
    for copy in cut_at(log(tmp_path, suffix), (0.0, 0.01, 0.3, 0.7, 0.95)):
        refused(copy, mapping=MAPPING, dbc=str(tmp_path / "car.dbc"))


def test_a_cut_text_log_is_read_to_its_last_whole_line_or_refused(tmp_path):
    for copy in cut_at(log(tmp_path, ".asc"), (0.0, 0.001, 0.3, 0.71, 0.951)):
        rec = read_or_refused(copy, mapping=MAPPING, dbc=str(tmp_path / "car.dbc"))
        if rec is not None:
            assert_is_the_drive(rec, STEPS, rounding=ROUNDING + 1e-4)
            assert any("no end mark" in note for note in rec.notes)


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
@pytest.mark.parametrize("content", [PNG, b"LOGG" + bytes(20), b"LOGG" + b"\xff" * 400, b"time_s,v\n0,1\n"])
def test_foreign_files_are_refused(tmp_path, suffix, content):
    path = tmp_path / f"drive{suffix}"
    path.write_bytes(content)
    refused(path, mapping=MAPPING, dbc=str(database(tmp_path)))


@pytest.mark.timeout(120)
@pytest.mark.parametrize("suffix", [".blf", ".asc", ".mf4"])
def test_damaged_bytes_never_get_more_than_a_line(tmp_path, suffix):
    damaged(log(tmp_path, suffix), mapping=MAPPING, dbc=str(tmp_path / "car.dbc"))


@pytest.mark.timeout(20)
@pytest.mark.parametrize("level", [0, 9])
def test_an_object_without_length_is_refused_rather_than_read_for_ever(tmp_path, level):
    path = tmp_path / "drive.blf"
    with can.BLFWriter(path, compression_level=level) as writer:
        for message in frames(database(tmp_path)):
            writer(message)
    content = bytearray(path.read_bytes())
    if level:  # one packed container with a single object of another kind
        content = content[:144]
        inner = struct.pack("<4sHHII", b"LOBJ", 16, 1, 0, 99) + bytes(64)
        packed = zlib.compress(inner)
        content += struct.pack("<4sHHII", b"LOBJ", 16, 1, 32 + len(packed), 10) + struct.pack("<H6xI4x", 2, len(inner))
        content += packed + bytes(8)
    else:
        second = content.index(b"LOBJ", content.index(b"LOBJ") + 4)
        content[second + 8 : second + 16] = struct.pack("<II", 0, 99)
    content[16:24] = bytes(8)  # how long the file is
    path.write_bytes(content)
    refused(path, "an object of the log states a length of 0 bytes", mapping=MAPPING, dbc=str(tmp_path / "car.dbc"))
