"""A fleet as users run it: a folder of vehicles, one table, the same numbers wherever jobs ran and whatever died."""

import json
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import psutil
import pytest
from conftest import ROOT
from script_runs import ENVIRONMENT, run_script
from test_case import NATIVE, written
from test_run_script import started
from test_run_script import vehicle as car_file

from vehicle_sbi.errors import InputError
from vehicle_sbi.fleet.attended import attended
from vehicle_sbi.fleet.diagnoses import Job, Outcome, diagnosed
from vehicle_sbi.fleet.engine import Engine, Function, each
from vehicle_sbi.fleet.vehicles import members
from vehicle_sbi.report import manifest

OPTIONS = 'options=["recording.drive=speed","recording.channels=[a_x,a_y,yaw_rate]","++prior.steering_ratio.gain=null"]'


WORDS = ("figures=false", OPTIONS)


def fleet(*arguments: str) -> tuple[int, str, str]:
    return run_script("fleet", *WORDS, *arguments)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cars of one vehicle file: one with roll and a recording held out, one a single file with a mapping."""
    folder = tmp_path_factory.mktemp("fleet") / "recordings"
    (folder / "rolls" / "heldout").mkdir(parents=True)
    written(folder / "rolls" / "a.csv", 0, body_roll__gradient=0.012)
    written(folder / "rolls" / "heldout" / "b.csv", 1, body_roll__gradient=0.012)
    written(folder / "stiff.csv", 2)
    (folder / "stiff.mapping.yaml").write_text(NATIVE)
    car_file(folder).rename(folder / "vehicle.yaml")
    return folder


@pytest.fixture(scope="module")
def alone(recordings: Path) -> Path:
    """The fleet on this machine."""
    out = recordings.parent / "alone"
    status, said, err = fleet(f"folder={recordings}", f"hydra.run.dir={out}")
    assert status == 0, err
    assert "| rolls | 1 | answered |" in said
    assert said.rstrip().endswith(str(out / "index.html"))
    return out


def verdicts(out: Path) -> dict[str, bytes]:
    return {name: (out / name / "verdict.json").read_bytes() for name in ("rolls", "stiff")}


# --- what a folder holds --------------------------------------------------------------------------------------------


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_a_subfolder_is_a_vehicle_and_so_is_a_file(tmp_path: Path) -> None:
    touched(
        tmp_path, "vehicle.yaml", "a/1.csv", "a/2.mcap", "a/heldout/3.csv", "a/vehicle.yaml", "b.csv",
        "b.mapping.yaml", "notes.md", "c/readme.txt.bak", "d/bag/metadata.yaml", ".hidden.csv",
    )  # fmt: skip
    a, b, d = members(tmp_path)
    assert (a.name, b.name, d.name) == ("a", "b", "d")
    assert [path.name for path in a.recordings] == ["1.csv", "2.mcap"]
    assert [path.name for path in a.heldout] == ["3.csv"]
    assert (a.vehicle, b.vehicle) == (tmp_path / "a" / "vehicle.yaml", tmp_path / "vehicle.yaml")
    assert b.mapping == tmp_path / "b.mapping.yaml"
    assert [path.name for path in d.recordings] == ["bag"]


def test_what_describes_a_folder_is_no_recording(tmp_path: Path) -> None:
    touched(tmp_path, "README.txt", "LICENSE.csv", "a/1.csv", "a/ReadMe.csv", "a/README_first.txt", "b/README.csv")
    for name in ("notes.txt", "a/notes.txt", "c/notes.txt"):
        (touched(tmp_path, name) / name).write_text("Recorded in May, at 30 degrees.\nTyres: 2.2 bar, new\n")
    rows = "".join(f"{k / 100};0,1;12,5\n" for k in range(3))
    (tmp_path / "a" / "2.txt").write_text(f"Logger 3, of 12\n{'about, this' * 50}\nZeit;Lenkung;v\n{rows}")
    (tmp_path / "a" / "3.txt").symlink_to(tmp_path / "none.txt")
    (a,) = members(tmp_path)
    assert [path.name for path in a.recordings] == ["1.csv", "2.txt", "3.txt"]  # of the last its reader says why


def test_a_folder_that_is_read_as_one_is_a_recording(tmp_path: Path) -> None:
    touched(tmp_path, "a/bag/metadata.yaml", "a/segment/CAN/speed/t", "a/other/b", "c/IMU/accelerometer/t")
    a, c = members(tmp_path)
    assert [path.name for path in a.recordings] == ["bag", "segment"]
    assert c.recordings == (tmp_path / "c",)


def test_a_vehicle_may_have_options_of_its_own(tmp_path: Path) -> None:
    touched(tmp_path, "a/1.csv", "b.csv")
    (tmp_path / "a" / "options.yaml").write_text("- window_s=5\n- recording.drive=torque\n")
    a, b = members(tmp_path)
    assert a.words == [f"recordings=['{tmp_path}/a/1.csv']", "window_s=5", "recording.drive=torque"]
    assert b.words == [f"recordings=['{tmp_path}/b.csv']"]
    (tmp_path / "options.yaml").write_text("window_s: 5\n")
    with pytest.raises(InputError, match=r"options.yaml: it must be a list of options, `- window_s=5` a line"):
        members(tmp_path)


@pytest.mark.parametrize(
    ("files", "said"),
    [((), "no recordings here or in subfolders"), (("a.csv", "a.mcap"), "two vehicles are called a; rename one")],
)
def test_a_folder_without_vehicles_is_refused(tmp_path: Path, files: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        members(touched(tmp_path, *files))
    with pytest.raises(InputError, match="no such folder"):
        members(tmp_path / "none")


# --- one table ------------------------------------------------------------------------------------------------------


def test_the_table_has_a_row_for_each_vehicle_with_what_its_verdict_says(alone: Path) -> None:
    table = pd.read_csv(alone / "fleet.csv").set_index("vehicle")
    assert [*table.index] == ["rolls", "stiff"]
    for name, row in table.iterrows():
        verdict = json.loads((alone / str(name) / "verdict.json").read_text())
        said = verdict["base_parameters"]["l_f"]["after"]
        assert row["l_f"] == pytest.approx(said["mean"], rel=1e-5)
        assert row["l_f_q05"] == pytest.approx(said["q05"], rel=1e-5)
        assert row["headline"] == verdict["headline"]
    assert "body_roll" in str(table.loc["rolls", "missing"])
    page = (alone / "index.html").read_text()
    assert all(name in page for name in table.index)


@pytest.mark.slow
def test_what_stands_is_not_done_again_and_what_is_damaged_is(recordings: Path, alone: Path) -> None:
    before = verdicts(alone)
    (alone / "stiff" / "verdict.json").write_text("{}")
    times = {name: (alone / name / "manifest.json").stat().st_mtime_ns for name in before}
    status, _, err = fleet(f"folder={recordings}", f"hydra.run.dir={alone}")
    assert status == 0, err
    assert verdicts(alone) == before
    assert (alone / "rolls" / "manifest.json").stat().st_mtime_ns == times["rolls"]
    assert (alone / "stiff" / "manifest.json").stat().st_mtime_ns != times["stiff"]


@pytest.mark.parametrize(("code", "said"), [(manifest.code(), ""), ("another", "by another version; remove its")])
def test_what_another_version_has_answered_is_said(tmp_path: Path, code: str, said: str) -> None:
    (member,) = members(touched(tmp_path, "a.csv"))
    job = Job(member=member, folder=tmp_path / "out" / "a", script=Path("none.py"))
    made = manifest.described(config={}, overrides=[], inputs={}, choices={}) | {"status": "complete", "code": code}
    job.folder.mkdir(parents=True)
    (job.folder / "manifest.json").write_text(json.dumps({**made, "seal": manifest.digest(made)}))
    job.account.write_text(json.dumps({"words": job.words, "seconds": 1.0}))
    found = diagnosed(job)
    assert found.answered
    assert found.reason.startswith(said)
    assert bool(found.reason) == bool(said)


def test_what_stands_with_a_vehicle_file_and_a_mapping_is_found_so(recordings: Path, alone: Path) -> None:
    for member in members(recordings):
        account = json.loads((alone / f"{member.name}.json").read_text())
        options = tuple(account["words"][len(member.words) : -1])
        inputs = manifest.read(alone / member.name)["inputs"]
        assert {str(file) for file in (member.vehicle, member.mapping) if file is not None} < inputs.keys()
        job = Job(member=member, folder=alone / member.name, script=Path("none.py"), options=options)
        assert diagnosed(job) == Outcome(True, "", account["seconds"])


FAKE = """
import sys
from pathlib import Path

from vehicle_sbi.files import sha256
from vehicle_sbi.quoting import unquoted
from vehicle_sbi.report.run_folder import RunFolder

words = dict(word.split("=", 1) for word in sys.argv[1:])
files = [words["vehicle"], words["mapping"]]
folder = Path(unquoted(words["hydra.run.dir"]))
with RunFolder.open(folder, config={}, overrides=[], inputs={one: sha256(Path(one)) for one in files}) as run:
    (folder / "verdict.json").write_text(" ".join(Path(one).read_text() for one in files))
    run.complete()
"""


@pytest.mark.parametrize("name", ["vehicle", "mapping"])
@pytest.mark.parametrize("was_killed", [False, True])
def test_a_vehicle_is_done_anew_when_one_of_its_files_is_edited(tmp_path: Path, name: str, was_killed: bool) -> None:
    """By a script that keeps a run folder as a diagnosis does, and answers with the text of its files."""
    script, folder = tmp_path / "fake.py", tmp_path / "out" / "a"
    script.write_text(FAKE)
    for file in ("vehicle", "mapping"):
        touched(tmp_path, "fleet/a.csv", f"fleet/a.{file}.yaml")
        (tmp_path / "fleet" / f"a.{file}.yaml").write_text(file)
    (member,) = members(tmp_path / "fleet")
    job = Job(member=member, folder=folder, script=script)
    folder.parent.mkdir()
    assert diagnosed(job).answered
    if was_killed:
        job.account.unlink()
    (folder / "old").touch()
    (tmp_path / "fleet" / f"a.{name}.yaml").write_text("edited")
    assert diagnosed(job).reason == ""
    assert (folder / "verdict.json").read_text() == "vehicle mapping".replace(name, "edited")
    assert not (folder / "old").exists()


def test_a_file_that_is_gone_for_now_removes_no_result(tmp_path: Path) -> None:
    (member,) = members(touched(tmp_path, "a.csv"))
    job = Job(member=member, folder=tmp_path / "out" / "a", script=tmp_path / "none.py")
    made = manifest.described(config={}, overrides=[], inputs={str(tmp_path / "gone.dbc"): ""}, choices={})
    touched(tmp_path, "out/a/verdict.json")
    manifest.write(job.folder, made | {"status": "complete"})
    assert not diagnosed(job).answered
    assert (job.folder / "verdict.json").exists()


def test_a_vehicle_that_fails_costs_its_own_row_alone(recordings: Path, tmp_path: Path, alone: Path) -> None:
    out, bad = tmp_path / "out", recordings / "bad.csv"
    shutil.copytree(alone, out)
    bad.write_text("time,steering\n1,2\n")
    try:
        status, said, err = fleet(f"folder={recordings}", f"hydra.run.dir={out}")
    finally:
        bad.unlink()
    assert status == 2
    assert "| stiff | 1 | answered |" in said
    assert err.count("error: ") == 1
    assert err.splitlines()[-1].startswith(f"error: bad: {bad}: ")


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("workers=0", "workers = 0; it must be a whole number above 0"),
        ("scheduler=tcp://127.0.0.1:1", "scheduler = tcp://127.0.0.1:1: only engine=dask has one"),
    ],
)
def test_a_wrong_value_gets_one_line(recordings: Path, tmp_path: Path, argument: str, said: str) -> None:
    status, out, err = fleet(f"folder={recordings}", f"hydra.run.dir={tmp_path / 'out'}", argument)
    assert (status, out, err) == (2, "", f"error: {said}\n")
    assert not (tmp_path / "out").exists()


# --- processes and machines that die --------------------------------------------------------------------------------


def until(happened: Callable[[], object], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_script_ends_with_the_process_that_attends_it(tmp_path: Path) -> None:
    sleeping, pid = tmp_path / "sleeping.py", tmp_path / "pid"
    sleeping.write_text(
        f"import os, pathlib, time\npathlib.Path({str(pid)!r}).write_text(str(os.getpid()))\ntime.sleep(99)"
    )
    words = f"attended(Path({str(sleeping)!r}), [], Path({str(tmp_path / 'log')!r}), 99.0)"
    code = f"from pathlib import Path; from vehicle_sbi.fleet.attended import attended; {words}"
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    until(lambda: pid.exists() and pid.read_text())
    parent.kill()
    parent.wait()
    until(lambda: not psutil.pid_exists(int(pid.read_text())), 10.0)
    assert attended(sleeping, [], tmp_path / "log", 1.0) is None
    assert "stopped after 1 s" in (tmp_path / "log").read_text()


def test_a_script_runs_where_its_files_are_named_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "script.py").write_text("import pathlib, sys; print(pathlib.Path(sys.argv[1]).read_text())")
    (tmp_path / "car.yaml").write_text("m: 1500")
    monkeypatch.chdir(tmp_path)
    assert attended(tmp_path / "script.py", ["car.yaml"], tmp_path / "log", 60.0) == 0
    assert (tmp_path / "log").read_text() == "m: 1500\n"


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The address of a Dask scheduler, and its process and those of its workers, as if on machines of their own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"

    def started(module: str, *words: str) -> subprocess.Popen[bytes]:
        asked = [sys.executable, "-m", f"distributed.cli.{module}", *words, "--no-dashboard"]
        environment = ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
        return subprocess.Popen(asked, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    scheduler = started("dask_scheduler", "--host", address)
    own = [started("dask_worker", address, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
    try:
        yield address, [scheduler, *own]
    finally:
        for process in (*own, scheduler):
            process.kill()
            process.wait()


def asked_of(address: str, recordings: Path, out: Path) -> subprocess.Popen[str]:
    """The fleet on a cluster, once its diagnoses have begun."""
    words = (*WORDS, f"folder={recordings}", f"hydra.run.dir={out}", "engine=dask", f"scheduler={address}")
    running = started(words, "fleet")
    until(lambda: running.poll() is not None or all((out / name / "stages").exists() for name in ("rolls", "stiff")))
    return running


def test_the_jobs_of_a_worker_that_is_killed_are_done_by_another() -> None:
    with cluster(workers=2) as (address, (_, worker, _)):
        work = Function(str(ROOT / "tests"), "slow_work", "slowly_squared")
        done = each(Engine(name="dask", scheduler=address), work, range(12))
        found = [next(done)]
        worker.kill()
        assert dict([*found, *done]) == {x: x * x for x in range(12)}


def test_a_scheduler_that_is_lost_is_one_line() -> None:
    with cluster(workers=1) as (address, (scheduler, _)):
        work = Function(str(ROOT / "tests"), "slow_work", "slowly_squared")
        done = each(Engine(name="dask", scheduler=address), work, range(12))
        next(done)
        scheduler.kill()
        with pytest.raises(InputError, match=f"^the scheduler {address} is lost; the same command goes on with what"):
            list(done)


@pytest.mark.slow
def test_a_worker_that_is_killed_changes_no_number(recordings: Path, alone: Path, tmp_path: Path) -> None:
    with cluster(workers=2) as (address, (_, worker, _)):
        running = asked_of(address, recordings, tmp_path / "out")
        worker.kill()
        _, err = running.communicate()
    assert running.returncode == 0, err
    assert verdicts(tmp_path / "out") == verdicts(alone)


@pytest.mark.slow
def test_a_scheduler_that_is_lost_ends_in_one_line_and_the_same_command_goes_on(
    recordings: Path, alone: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with cluster(workers=2) as (address, (scheduler, *_)):
        running = asked_of(address, recordings, out)
        scheduler.kill()
        said, err = running.communicate()
    assert (running.returncode, said) == (2, "")
    assert err == f"error: the scheduler {address} is lost; the same command goes on with what is left\n"
    status, _, err = fleet(f"folder={recordings}", f"hydra.run.dir={out}")
    assert status == 0, err
    assert verdicts(out) == verdicts(alone)


@pytest.mark.slow
def test_a_cluster_of_this_machine_s_own_finds_the_same(recordings: Path, alone: Path, tmp_path: Path) -> None:
    status, _, err = fleet(f"folder={recordings}", f"hydra.run.dir={tmp_path / 'out'}", "engine=dask")
    assert status == 0, err
    assert verdicts(tmp_path / "out") == verdicts(alone)


def test_a_scheduler_that_does_not_answer_gets_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vehicle_sbi.fleet.engine.CONNECTED_S", 1.0)
    address = "tcp://127.0.0.1:9"
    with pytest.raises(InputError, match=f"scheduler = {address}: nothing answers there"):
        list(each(Engine(name="dask", scheduler=address), str, [1]))


def test_the_error_of_a_job_is_not_taken_for_one_of_the_engine() -> None:
    with pytest.raises(ZeroDivisionError):
        list(each(Engine(), lambda job: 1 // job, [0]))
