"""The console command: its verbs are the scripts, and take the scripts' words."""

import os
import subprocess
import sys

import pytest

from vehicle_sbi.command import VERBS, completion, example


def command(*words: str) -> subprocess.CompletedProcess:
    code = "import sys; from vehicle_sbi.command import main; sys.argv[0] = 'vehicle-sbi'; main()"
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)


def test_every_verb_is_listed_with_a_sentence_and_an_example() -> None:
    shown = command().stdout
    for name, verb in VERBS.items():
        assert verb.path.is_file()
        assert verb.sentence in shown
        assert example(name) in shown
        assert example(name).startswith(f"vehicle-sbi {name}")


@pytest.mark.parametrize("name", ["diagnose", "export"])
def test_help_shows_the_command_as_it_is_typed(name: str) -> None:
    ran = command(name, "--help")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert f"vehicle-sbi {name}" in ran.stdout
    assert "python scripts" not in ran.stdout


def test_an_unknown_verb_gets_one_line_and_status_2() -> None:
    ran = command("diagnoze")
    assert (ran.returncode, ran.stdout, ran.stderr.count("\n")) == (2, "", 1)
    assert "diagnose" in ran.stderr


def test_a_wrong_value_is_reported_as_by_the_script() -> None:
    ran = command("diagnose", "no_such_drive.csv")
    assert (ran.returncode, ran.stderr.count("\n")) == (2, 1), ran.stderr
    assert "no_such_drive.csv: no such file" in ran.stderr


def test_a_file_alone_is_the_recording() -> None:
    assert VERBS["diagnose"].arguments(["drive.csv", "seed=1", "-m"]) == ["recording=drive.csv", "seed=1", "-m"]


def test_the_value_of_a_flag_is_no_recording() -> None:
    for flag in ("--cfg", "--config-dir"):
        assert VERBS["run"].arguments([flag, "job", "drive.csv"]) == [flag, "job", "recording=drive.csv"]


def test_completion_is_a_script_that_bash_reads() -> None:
    checked = subprocess.run(["bash", "-n"], input=completion(), text=True, capture_output=True)
    assert checked.returncode == 0, checked.stderr


def test_a_reader_that_stops_reading_gets_no_traceback() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    code = "import sys; from vehicle_sbi.command import main; sys.argv = ['vehicle-sbi', '--help']; main()"
    done = subprocess.run([sys.executable, "-c", code], stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (128 + 13, b"")
