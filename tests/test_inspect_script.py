"""inspect_recording.py as users run it: a foreign CSV, files to edit that reading takes, one line for a wrong value."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from conftest import ROOT
from test_inspection import foreign
from test_run_script import ENVIRONMENT

from vehicle_sbi.data.readers import RecordingFile


def inspect(*arguments: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "scripts/inspect_recording.py", *arguments],
        cwd=ROOT,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout, done.stderr


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
    last = out.splitlines()[-1]
    assert last.startswith(
        f"  python scripts/diagnose.py recording={folder}/drive.csv mapping={folder}/drive.mapping.yaml"
    )
    assert f"vehicle={folder}/drive.vehicle.yaml" in last


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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "recording.path"),
        (["recording=nothing.csv"], "nothing.csv: no such file"),
        (["recording=README.md"], "README.md"),
        (["recording=synthetic"], "recording"),
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
