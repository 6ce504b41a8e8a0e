"""inspect_recording.py as users run it: a foreign CSV, files to edit that reading takes, one line for a wrong value."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from script_runs import run_script
from test_inspection import column, foreign
from test_rosbag import written

from vehicle_sbi.data.inspection.contents import contents
from vehicle_sbi.data.inspection.guess import guess
from vehicle_sbi.data.readers import RecordingFile


def inspect(*arguments: str) -> tuple[int, str, str]:
    return run_script("inspect_recording", *arguments)


@pytest.fixture(scope="module")
def inspected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A drive of foreign names and units with a flipped a_y, inspected."""
    folder = tmp_path_factory.mktemp("inspected")
    foreign(folder / "drive.csv", flip=True)
    status, out, err = inspect(f"recording={folder}/drive.csv", f"to={folder}")
    assert status == 0, err
    assert err == ""
    return folder, out


def test_contents_mapping_faults_and_the_next_command_are_printed(inspected: tuple[Path, str]) -> None:
    folder, out = inspected
    assert "3000 rows in 59.98 s, usually at 50 Hz, no gaps; time is 'Time [ms]' [ms]" in out
    assert "  yaw_rate         gyro_z_deg_s in deg/s (from the name): sure" in out
    assert "  - a_y has the opposite sign of v_x times yaw_rate" in out
    for script, line in zip(("run", "diagnose"), out.splitlines()[-2:], strict=True):
        assert line.startswith(
            f"  python scripts/{script}.py recording={folder}/drive.csv mapping={folder}/drive.mapping.yaml"
        )
        assert f"vehicle={folder}/drive.vehicle.yaml" in line


def test_the_written_mapping_reads_the_recording(inspected: tuple[Path, str]) -> None:
    folder, _ = inspected
    mapping = yaml.safe_load((folder / "drive.mapping.yaml").read_text())
    mapping["a_y"]["sign"] = -1  # as the finding suggests
    read = RecordingFile(path=folder / "drive.csv", mapping=mapping, time="Time [ms]", time_unit="ms").load()
    assert read.warnings == ()
    assert list(read.channels) == ["steering_wheel", "v_x", "a_y", "yaw_rate"]


def test_files_of_an_earlier_inspection_stay_unless_overwrite(inspected: tuple[Path, str]) -> None:
    folder, _ = inspected
    (folder / "drive.vehicle.yaml").write_text("m: 1500\n")
    status, out, err = inspect(f"recording={folder}/drive.csv", f"to={folder}")
    assert status == 2
    assert "what looks wrong" in out
    assert err.startswith("error: ")
    assert "exists, left as it is; overwrite=true replaces it" in err
    assert len(err.splitlines()) == 1
    assert (folder / "drive.vehicle.yaml").read_text() == "m: 1500\n"


def test_a_preset_is_held_against_the_file_and_only_the_vehicle_is_written(tmp_path: Path) -> None:
    bag = written(tmp_path, "mcap")
    status, out, err = inspect(f"recording={bag}", "mapping=autoware", f"to={tmp_path}")
    assert (status, err) == (0, "")
    assert "mapping as given: steering, v_x, yaw_rate, a_y, a_x, a_z, roll_rate, pitch_rate" in out
    assert out.splitlines()[-1] == (
        f"  python scripts/diagnose.py recording={bag} mapping=autoware vehicle={tmp_path}/drive.vehicle.yaml"
    )
    assert not list(tmp_path.glob("*.mapping.yaml"))
    (tmp_path / "drive.vehicle.yaml").write_text("m: 1500\n")
    status, out, _ = inspect(f"recording={bag}", "mapping=autoware", f"to={tmp_path}")
    assert status == 0
    assert f"there already: {tmp_path}/drive.vehicle.yaml" in out
    assert (tmp_path / "drive.vehicle.yaml").read_text() == "m: 1500\n"


def test_a_preset_whose_columns_the_file_has_is_named(tmp_path: Path, inspected: tuple[Path, str]) -> None:
    status, out, err = inspect(f"recording={written(tmp_path, 'mcap')}", f"to={tmp_path}")
    assert (status, err) == (0, "")
    named = [line.split(",")[0] for line in out.splitlines() if "a preset, has columns of this file" in line]
    assert named == ["mapping=autoware"]
    assert "a preset, has columns of this file" not in inspected[1]


def test_an_edited_mapping_is_held_against_the_file(inspected: tuple[Path, str], tmp_path: Path) -> None:
    folder, _ = inspected
    mapping = yaml.safe_load((folder / "drive.mapping.yaml").read_text())
    mapping["a_y"]["sign"] = -1
    (tmp_path / "edited.yaml").write_text(yaml.safe_dump(mapping))
    times = ['recording.time="Time [ms]"', "recording.time_unit=ms"]
    status, out, err = inspect(
        f"recording={folder}/drive.csv", f"mapping={tmp_path}/edited.yaml", *times, f"to={tmp_path}"
    )
    assert (status, err) == (0, "")
    assert "nothing that this drive tells" in out
    assert f" mapping={tmp_path}/edited.yaml vehicle={tmp_path}/drive.vehicle.yaml" in out.splitlines()[-1]


def test_a_vehicle_file_that_is_given_is_the_one_that_the_next_command_names(
    inspected: tuple[Path, str], tmp_path: Path
) -> None:
    (tmp_path / "car.yaml").write_text("m: 1500\n")
    status, out, err = inspect(f"recording={inspected[0]}/drive.csv", f"vehicle={tmp_path}/car.yaml", f"to={tmp_path}")
    assert (status, err) == (0, "")
    assert f" mapping={tmp_path}/drive.mapping.yaml vehicle={tmp_path}/car.yaml" in out.splitlines()[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["car.yaml", "drive.mapping.yaml"]


def test_a_preset_that_does_not_fit_says_what_it_lacks(inspected: tuple[Path, str], tmp_path: Path) -> None:
    status, out, err = inspect(f"recording={inspected[0]}/drive.csv", "mapping=autoware", f"to={tmp_path}")
    assert status == 2
    assert "  column " in out
    assert len(err.splitlines()) == 1
    assert "unknown column '/vehicle/status/steering_status.steering_tire_angle'" in err
    assert not list(tmp_path.iterdir())


def test_topics_of_autoware_are_recognised_and_commands_are_not(tmp_path: Path) -> None:
    tables = contents(written(tmp_path, "mcap"))
    columns = [column for table in tables for column in table.columns]
    found = {one.channel: one.columns for one in guess(columns)}
    assert found["steering"] == ("/vehicle/status/steering_status.steering_tire_angle",)
    assert found["v_x"] == ("/vehicle/status/velocity_status.longitudinal_velocity",)
    speed = next(one for one in columns if one.field == "longitudinal_velocity")
    late = replace(
        speed, clock="/localization/kinematic_state", name="/localization/kinematic_state.longitudinal_velocity"
    )
    assert guess([late, speed])[0].columns == (speed.name,)
    command = {"clock": "/control/command", "name": "/control/command.lateral.steering_tire_angle"}
    steering = next(one for one in columns if one.field == "steering_tire_angle")
    assert guess([replace(steering, **command)]) == ()


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("G Force Lat", "a_y"), ("G Force Long", "a_x"), ("G Force Vert", "a_z"), ("Ground Speed", "v_x"),
        ("Vehicle Acceleration Lateral", "a_y"), ("Gyro Yaw Velocity", "yaw_rate"), ("Steered Angle", "steering"),
    ],
)  # fmt: skip
def test_channels_of_motec_are_recognised(name: str, channel: str) -> None:
    assert [one.channel for one in guess([column(name)])] == [channel]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no recording is given: recording=drive.csv names one"),
        (["recording=nothing.csv"], "nothing.csv: no such file"),
        (["recording=README.md"], "README.md"),
        (["recording=synthetic"], "recording"),
        (["recording=README.md", "mapping=none_such"], "mapping: unknown option 'none_such'"),
        (["recording=file", "recording.path=README.md"], "files ending in '.md' are not read"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments: list[str], said: str, tmp_path: Path) -> None:
    status, out, err = inspect(*arguments, f"to={tmp_path}")
    assert status == 2
    assert out == ""
    assert len(err.splitlines()) == 1
    assert said in err
    assert not list(tmp_path.iterdir())
