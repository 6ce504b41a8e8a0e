"""MDF4 comes back as the drive, a clock a group, and nothing of a file is executed."""

import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from asammdf import MDF, Signal
from foreign_drive import DRIVE, PNG, assert_is_the_drive, cut_at, damaged, refused

from vehicle_sbi.data.formats.mdf import _formulas
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError

MAPPING = {
    "steering": {"column": "Steer", "sign": -1},
    "v_x": {"column": "Chassis/Speed"},
    "yaw_rate": {"column": "Yaw"},
    "a_y": {"column": "LatAcc"},
}
STEPS = {"steering": 0.01, "v_x": 0.025, "yaw_rate": 0.01, "a_y": 0.01}


def written(folder: Path, compression: Any = 0, conversion: Any = None) -> Path:
    def group(name: str, start: float, step: float, columns: dict[str, tuple[str, float, str]]) -> None:
        t = np.arange(start, 6.0, step)
        signals = [
            Signal(
                DRIVE[channel](t) * scale, t, name=column, unit=unit, conversion=conversion if scale == 0.5 else None
            )
            for column, (channel, scale, unit) in columns.items()
        ]
        file.append(signals, acq_name=name, common_timebase=True)

    file = MDF(version="4.10")
    group("Motion", 0.0, 0.01, {
        "Steer": ("steering", -180.0 / np.pi, "°"), "Yaw": ("yaw_rate", 180.0 / np.pi, "°/s"),
        "LatAcc": ("a_y", 1.0 / 9.80665, "G"), "Speed": ("v_x", 0.5, "furlong"),
    })  # fmt: skip
    group("Chassis", 0.1, 0.025, {"Speed": ("v_x", 3.6, "kph")})
    path = folder / "drive.mf4"
    file.save(path, overwrite=True, compression=compression)
    file.close()
    return path


@pytest.mark.parametrize("compression", [0, 2])
def test_a_file_comes_back_as_the_drive_with_its_own_units(tmp_path, compression):
    rec = RecordingFile(path=written(tmp_path, compression), mapping=MAPPING).load()
    assert rec.rate == pytest.approx(100.0)
    assert_is_the_drive(rec, STEPS)
    assert "units as drive.mf4 states them: steering °, v_x kph, yaw_rate °/s, a_y G" in rec.notes
    assert "clock of Chassis begins 0.100 s after that of Motion, in steps of 25 ms against 10 ms" in rec.notes


def test_a_group_is_a_clock_and_names_are_qualified_where_they_come_twice(tmp_path):
    motion, chassis = read_tables(written(tmp_path))
    assert (motion.clock, chassis.clock) == ("Motion", "Chassis")
    assert set(motion.columns) == {"t", "Steer", "Yaw", "LatAcc", "Motion/Speed"}
    assert motion.has("Motion/Steer")
    assert chassis.unit("Chassis/Speed") == "kph"


def test_measured_channels_need_no_library_of_can(tmp_path):
    """The extra `mdf` alone reads a file that holds no raw frames."""
    code = (
        "import sys; sys.modules.update(can=None, cantools=None)\n"
        "from vehicle_sbi.data.formats.registry import read_tables\n"
        f"print([one.clock for one in read_tables({str(written(tmp_path))!r})])"
    )
    said = subprocess.check_output([sys.executable, "-c", code], cwd=Path(__file__).parent.parent, text=True)
    assert said == "['Motion', 'Chassis']\n"


def test_a_unit_that_is_none_of_the_channel_is_refused_unless_the_mapping_says_another(tmp_path):
    path = written(tmp_path)
    bad: dict[str, Any] = {"v_x": {"column": "Motion/Speed"}}
    refused(path, "channel v_x: column 'Motion/Speed': unit 'furlong' is not understood; a unit in", mapping=bad)
    bad["v_x"] |= {"unit": "m/s", "scale": 2.0}
    assert_is_the_drive(RecordingFile(path=path, mapping=bad).load(), {"v_x": 0.01})


def test_a_unit_may_stand_in_the_conversion_of_a_channel(tmp_path):
    """Some writers say what a scaled value is in there alone; the channel's own unit counts where both have one."""
    t = np.arange(0.0, 6.0, 0.01)
    file = MDF(version="4.10")
    scale: Any = {"a": 0.01, "b": 0.0}
    for name in ("Inner", "Both"):
        raw = np.round(DRIVE["v_x"](t) * 360.0).astype(np.uint16)
        file.append([Signal(raw, t, name=name, unit="km/h", conversion=scale)], acq_name=name, common_timebase=True)
    for group, own in zip(file.groups, ("", "mph"), strict=True):
        channel: Any = next(one for one in group.channels if one.conversion is not None)
        channel.conversion.unit, channel.unit = "km/h", own
    file.save(tmp_path / "drive.mf4", overwrite=True)
    file.close()
    inner, both = read_tables(tmp_path / "drive.mf4")
    assert (inner.unit("Inner"), both.unit("Both")) == ("km/h", "mph")
    rec = RecordingFile(path=tmp_path / "drive.mf4", mapping={"v_x": {"column": "Inner"}}).load()
    assert_is_the_drive(rec, {"v_x": 0.01}, rounding=0.005 / 3.6)


def test_columns_of_several_clocks_are_not_summed(tmp_path):
    mapping = {"v_x": {"column": ["Motion/Speed", "Chassis/Speed"]}}
    refused(written(tmp_path), "are on several clocks and cannot be summed", mapping=mapping)


@pytest.mark.parametrize(
    "formula", ["__import__('os').system('touch executed')", "X.__class__", "9**9**9**9", "X*" * 9 + "(X"]
)
def test_formulas_are_not_executed(tmp_path, formula, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, conversion={"formula": formula})
    refused(path, mapping={"v_x": {"column": "Motion/Speed", "unit": "m/s"}})
    assert not (tmp_path / "executed").exists()


def test_a_formula_is_found_however_deep_it_lies():
    def nested(depth: int) -> SimpleNamespace:
        inner = nested(depth - 1) if depth else None
        return SimpleNamespace(formula="" if depth else "hostile", referenced_blocks={"default_addr": inner})

    assert list(_formulas(Path("drive.mf4"), nested(8), 0)) == ["hostile"]
    with pytest.raises(InputError, match="more than 8 times: they are not evaluated"):
        list(_formulas(Path("drive.mf4"), nested(9), 0))


def test_formulas_of_arithmetic_count(tmp_path):
    path = written(tmp_path, conversion={"formula": "2 * X1 + 0.0*sin(X1)"})
    rec = RecordingFile(path=path, mapping={"v_x": {"column": "Motion/Speed", "unit": "m/s"}}).load()
    assert_is_the_drive(rec, {"v_x": 0.01})


@pytest.mark.parametrize("compression", [0, 2])
def test_cut_files_are_refused(tmp_path, compression):
    for copy in cut_at(written(tmp_path, compression), (0.0, 0.001, 0.01, 0.2, 0.5, 0.9, 0.99)):
        refused(copy, mapping=MAPPING)


@pytest.mark.parametrize("content", [b"", PNG, b"MDF     4.10    ", b"PK\3\4" + bytes(400), b"time_s,v\n0,1\n"])
def test_foreign_files_are_refused(tmp_path, content):
    path = tmp_path / "drive.mf4"
    path.write_bytes(content)
    refused(path, mapping=MAPPING)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", [b"##DG", b"##CG", b"##CN", b"##CC"])
def test_links_in_a_circle_are_refused(tmp_path, kind):
    """The first link of a block, which is to the next of its list, leads back to the block."""
    path = written(tmp_path, conversion={"a": 2.0, "b": 0.0})
    data = bytearray(path.read_bytes())
    address = data.find(kind)
    assert address > 0
    struct.pack_into("<Q", data, address + 24, address)
    path.write_bytes(data)
    if kind == b"##CC":  # its first link is a text, which is not a list
        return
    refused(path, "lead in a circle", mapping=MAPPING)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("compression", [0, 2])
def test_damaged_bytes_never_get_more_than_a_line(tmp_path, compression):
    damaged(written(tmp_path, compression), mapping=MAPPING)
