"""MATLAB files and comma2k19 folders come back as the drive; objects in them are not read."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_drive import DRIVE, PNG, assert_is_the_drive, cut_at, damaged, refused
from scipy.io import savemat

from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.mapping import mapping_file
from vehicle_sbi.data.readers import RecordingFile

ROOT = Path(__file__).parent.parent
MAPPING = {
    "steering": {"column": "steer_deg", "unit": "deg", "sign": -1},
    "v_x": {"column": "can.speed", "unit": "km/h"},
    "yaw_rate": {"column": "gyro.wz.0"},
    "a_y": {"column": "can.imu.ay", "unit": "g"},
}
STEPS = {"steering": 0.01, "v_x": 0.02, "yaw_rate": 0.025, "a_y": 0.01}


def written(folder: Path, compressed: bool = True) -> Path:
    fast, slow, third = (np.arange(0.0, 6.0, step) for step in (0.01, 0.02, 0.025))
    simulink = {
        "time": third[:, None],
        "signals": {"values": np.stack([DRIVE["yaw_rate"](third), third], axis=1), "label": "wz", "dimensions": 2.0},
    }
    content = {
        "t": fast, "steer_deg": -np.degrees(DRIVE["steering"](fast)), "note": "a text", "scalar": 3.0,
        "can": {
            "time": slow, "speed": 3.6 * DRIVE["v_x"](slow),
            "imu": {"Time": fast, "ay": DRIVE["a_y"](fast) / 9.80665},
        },
        "gyro": simulink,
    }  # fmt: skip
    savemat(folder / "drive.mat", content, do_compression=compressed)
    return folder / "drive.mat"


@pytest.mark.parametrize("compressed", [True, False])
def test_structs_come_back_as_the_drive_each_on_its_own_time(tmp_path, compressed):
    path = written(tmp_path, compressed)
    assert {table.clock for table in read_tables(path)} == {"", "can", "can.imu", "gyro"}
    assert_is_the_drive(RecordingFile(path=path, mapping=MAPPING).load(), STEPS)


@pytest.mark.parametrize("compressed", [True, False])
def test_cut_files_are_refused(tmp_path, compressed):
    for copy in cut_at(written(tmp_path, compressed), (0.0, 0.001, 0.01, 0.3, 0.7, 0.99)):
        refused(copy, mapping=MAPPING)


@pytest.mark.parametrize("content", [b"", PNG, b"MATLAB 7.3 MAT-file" + bytes(600), b"time_s,v\n0,1\n", b"\0" * 400])
def test_foreign_files_are_refused(tmp_path, content):
    path = tmp_path / "drive.mat"
    path.write_bytes(content)
    refused(path, mapping=MAPPING)


def test_a_file_without_time_is_refused(tmp_path):
    savemat(tmp_path / "drive.mat", {"speed": np.arange(9.0)})
    refused(tmp_path / "drive.mat", "no vectors with a time of their length; .*; the file holds speed", mapping=MAPPING)


def comma2k19(folder: Path) -> Path:
    def log(name: str, step: float, *columns: Any) -> None:
        (folder / name).mkdir(parents=True)
        values = np.stack(columns, axis=1) if len(columns) > 1 else next(iter(columns))
        for file, array in (("t", 1000.0 + np.arange(0.0, 6.0, step)), ("value", values)):
            with (folder / name / file).open("wb") as stream:
                np.save(stream, array)

    fast, slow = np.arange(0.0, 6.0, 0.01), np.arange(0.0, 6.0, 0.02)
    log("CAN/speed", 0.02, DRIVE["v_x"](slow)[:, None])
    log("CAN/steering_angle", 0.01, np.degrees(DRIVE["steering"](fast)))
    log("CAN/raw_can", 0.01, np.zeros(len(fast), dtype="S3"))
    log("IMU/accelerometer", 0.01, DRIVE["a_x"](fast), -DRIVE["a_y"](fast), -9.81 + 0.0 * fast)
    log("IMU/gyro", 0.01, 0.0 * fast, 0.0 * fast, -DRIVE["yaw_rate"](fast))
    return folder


def test_a_segment_of_comma2k19_comes_back_as_the_drive(tmp_path):
    whole = mapping_file(ROOT / "conf/mapping/comma2k19.yaml")
    mapping = {name: one for name, one in whole.items() if name not in ("a_z", "roll_rate", "pitch_rate")}
    rec = RecordingFile(path=comma2k19(tmp_path / "processed_log"), mapping=mapping).load()
    for series in (rec.channels, rec.valid):
        series["steering"] = series.pop("steering_wheel")  # pyright: ignore
    rec.t[:] -= 1000.0
    assert_is_the_drive(rec, {"steering": 0.01, "v_x": 0.02, "a_x": 0.01, "a_y": 0.01, "yaw_rate": 0.01})


class Executed:
    def __reduce__(self):
        return (Path.touch, (Path("executed"),))


def test_pickles_are_not_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = comma2k19(tmp_path / "processed_log")
    with (folder / "CAN/speed/value").open("wb") as stream:
        np.save(stream, np.array([Executed()] * 300, dtype=object), allow_pickle=True)
    refused(folder, "cannot be read as a numpy array", mapping=MAPPING)
    (folder / "CAN/speed/value").write_bytes(pickle.dumps(Executed()))
    refused(folder, "cannot be read as a numpy array", mapping=MAPPING)
    assert not (tmp_path / "executed").exists()


def test_a_segment_that_is_cut_is_refused(tmp_path):
    folder = comma2k19(tmp_path / "processed_log")
    file = folder / "IMU/gyro/value"
    file.write_bytes(file.read_bytes()[:-100])
    refused(folder, "cannot be read as a numpy array", mapping=MAPPING)
    (tmp_path / "empty" / "CAN").mkdir(parents=True)
    refused(tmp_path / "empty", "no log of comma2k19", mapping=MAPPING)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("compressed", [True, False])
def test_damaged_bytes_never_get_more_than_a_line(tmp_path, compressed):
    damaged(written(tmp_path, compressed), mapping=MAPPING)
