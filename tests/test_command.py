"""The console command: its verbs are the scripts, and take the scripts' words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vehicle_sbi.command import VERBS, _main, completion, example


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


@pytest.mark.parametrize("name", VERBS)
def test_help_says_what_a_verb_does_as_it_is_typed(name: str) -> None:
    ran = command(name, "--help")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert VERBS[name].sentence in " ".join(ran.stdout.split())
    assert example(name) in ran.stdout
    assert "python scripts" not in ran.stdout


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["--cfg", "job"]])
def test_a_page_of_before_is_not_opened_where_nothing_is_done(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "outputs" / "demo").mkdir(parents=True)
    (tmp_path / "outputs" / "demo" / "report.html").touch()
    opened = list[str]()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("runpy.run_path", lambda *_, **__: None)
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("vehicle_sbi.command._has_screen", lambda: True)
    for name in ("sys.argv", "sys.path"):
        monkeypatch.setattr(name, ["vehicle-sbi"])
    monkeypatch.setenv("VEHICLE_SBI_COMMAND", "")
    _main(["demo", *words])
    assert opened == []
    _main(["demo"])
    assert opened == [(tmp_path / "outputs" / "demo" / "report.html").as_uri()]


def test_a_terminal_without_the_signs_shows_question_marks() -> None:
    code = "from vehicle_sbi.command import print_anywhere; print_anywhere(); print('1.2 \u00b1 0.1 \u2026 \u2500')"
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "1.2 ? 0.1 ? ?\n"), done.stderr


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


def test_of_two_files_none_is_dropped() -> None:
    done = command("diagnose", "a.csv", "b.csv")
    assert (done.returncode, done.stdout) == (2, "")
    said = "'a.csv' and 'b.csv': one is taken, as in recording=FILE; several drives are 'recordings=[a.csv,b.csv]'"
    assert done.stderr == f"error: {said}\n"


def test_the_value_of_a_flag_is_no_recording() -> None:
    for flag in ("--cfg", "--config-dir"):
        assert VERBS["run"].arguments([flag, "job", "drive.csv"]) == [flag, "job", "recording=drive.csv"]


def test_a_slip_keeps_the_words_that_it_consists_of() -> None:
    assert VERBS["diagnose"].arguments(["--vehicle", "car.yaml"]) == ["--vehicle", "car.yaml"]
    assert VERBS["diagnose"].arguments(["a.csv", "mapping=", "b.yaml"]) == ["recording=a.csv", "mapping=", "b.yaml"]
    assert VERBS["diagnose"].arguments(["--multirun", "a.csv"]) == ["--multirun", "recording=a.csv"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--recording x.csv", "unknown option --recording: keys are written without dashes, recording=x.csv"),
        ("x.csv mapping = map.yaml", "leave no blanks around '=': write mapping=map.yaml"),
    ],
)
def test_a_slip_gets_one_line(words: str, line: str) -> None:
    ran = command("diagnose", *words.split())
    assert (ran.returncode, ran.stdout, ran.stderr) == (2, "", f"error: {line}\n")


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
