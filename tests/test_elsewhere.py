"""Recordings that do not ship: the list knows every configured one, and says what is in a folder."""

import hashlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from vehicle_sbi.data.elsewhere import Elsewhere, knows, listed
from vehicle_sbi.data.formats.registry import format_of
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
FOLDER = "${oc.env:VEHICLE_SBI_RECORDINGS,../shared/recordings}/"


def test_every_configured_file_that_does_not_ship_is_listed_with_the_name_that_uses_it() -> None:
    configured = {
        (path.stem, name.strip())
        for path in (ROOT / "conf" / "recording").glob("*.yaml")
        for name in re.findall(re.escape(FOLDER) + "(.*)", path.read_text())
    }
    known = {(user, name) for one in listed() for user in one.used_by for name in one.files}
    assert configured <= known
    assert {user for user, _ in known} == {user for user, _ in configured}


def test_a_file_is_told_from_another_of_its_name(tmp_path: Path) -> None:
    digest = hashlib.sha256(b"drive").hexdigest()
    one = Elsewhere(used_by=["a_drive"], licence="MIT", source="a lab", files={"a.csv": digest})
    said = []
    for content in (None, b"drive", b"another"):
        if content is not None:
            (tmp_path / "a.csv").write_bytes(content)
        said.append(one.lines(tmp_path)[3].splitlines()[0].strip())
    assert said == ["not here: a.csv", "here: a.csv", "here, but another file: a.csv"]


def test_a_configured_recording_that_is_not_here_says_how_to_get_it(tmp_path: Path) -> None:
    name = next(iter(listed()[0].files))
    assert knows(tmp_path / name)
    with pytest.raises(InputError, match="no such file; vehicle-sbi recordings says where"):
        format_of(tmp_path / name)
    with pytest.raises(InputError, match=r"no such file$"):
        format_of(tmp_path / "drive.csv")


def test_the_script_lists_what_is_in_a_folder(tmp_path: Path) -> None:
    command = [sys.executable, "scripts/recordings.py", f"folder={tmp_path}"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.count("not here: ") == sum(len(one.files) for one in listed())
    ran = subprocess.run([*command[:2], "folder=README.md"], cwd=ROOT, capture_output=True, text=True)
    assert (ran.returncode, ran.stderr.count("\n")) == (2, 1)
