"""A run folder is continued by the run that began it, by no other, and never holds half a file."""

import errno
import json
import logging
import multiprocessing
import os
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
import yaml

from vehicle_sbi.errors import InputError
from vehicle_sbi.report.run_folder import RunFolder, is_finished, read

CONFIG = {"seed": 3, "prior": {"l_f": [1.0, 1.5]}, "estimator": {"_target_": "vehicle_sbi.inference.estimator.Spline"}}
INPUTS = {"drive.csv": "a" * 64}


def opened(path: Path, **changes: Any) -> RunFolder:
    given: dict[str, Any] = {"config": CONFIG, "overrides": ["seed=3"], "inputs": INPUTS, **changes}
    return RunFolder.open(path, **given)


def manifest(path: Path) -> dict:
    return json.loads((path / "manifest.json").read_text())


def test_a_new_folder_says_what_runs_and_on_what(tmp_path: Path) -> None:
    with opened(tmp_path / "run", choices={"prior": "default"}):
        pass
    written = manifest(tmp_path / "run")
    assert (written["schema"], written["status"], written["seed"]) == (2, "running", 3)
    assert written["inputs"] == INPUTS
    assert written["packages"]["numpy"]
    assert written["peak_memory_mb"] > 0
    assert yaml.safe_load((tmp_path / "run/.hydra/config.yaml").read_text()) == CONFIG
    assert yaml.safe_load((tmp_path / "run/.hydra/overrides.yaml").read_text()) == ["seed=3"]


def test_seconds_facts_and_log_of_a_resumed_run_add_up(tmp_path: Path) -> None:
    for start in (1, 2):
        with opened(tmp_path) as run:
            run.manifest["seconds"].setdefault("simulate", 10.0)
            run.record(**{f"round_{start}": 0.9})
            with run.stage("simulate"):
                logging.getLogger("vehicle_sbi.inference").info("line %d", start)
                time.sleep(0.01)
    with opened(tmp_path) as run:
        run.complete()
    written = manifest(tmp_path)
    assert written["starts"] == 3
    assert 10.02 <= written["seconds"]["simulate"] < 12.0
    assert written["facts"] == {"round_1": 0.9, "round_2": 0.9}
    log = (tmp_path / "log.txt").read_text()
    assert log.count("line 1") == log.count("line 2") == 1


def test_a_stage_that_fails_is_timed_and_leaves_the_run_unfinished(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), opened(tmp_path) as run, run.stage("train"):
        raise ZeroDivisionError
    assert "train" in manifest(tmp_path)["seconds"]
    assert not is_finished(tmp_path)
    opened(tmp_path).close()  # and the lock is free


def test_nothing_is_logged_after_closing(tmp_path: Path) -> None:
    before = logging.getLogger().handlers[:]
    opened(tmp_path).close()
    assert logging.getLogger().handlers == before


def kept(run: RunFolder, name: str, content: bytes) -> None:
    run.checkpoints.write(name, lambda file: file.write(content))


def finished(path: Path) -> None:
    with opened(path) as run:
        kept(run, "stages/fit.npz", b"fit")
        kept(run, "stages/extended.npz", b"extended")
        (path / "table.csv").write_text("a table")
        run.complete()


def test_a_checkpoint_counts_only_as_the_run_left_it(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        kept(run, "stages/fit.npz", b"fit")
        (tmp_path / "stages/foreign.npz").write_bytes(b"of another run")
    with opened(tmp_path) as run:
        assert run.checkpoints.kept("stages/fit.npz") == tmp_path / "stages/fit.npz"
        assert run.checkpoints.kept("stages/foreign.npz") is None
    (tmp_path / "stages/fit.npz").write_bytes(b"fix")
    with opened(tmp_path) as run:
        assert run.checkpoints.kept("stages/fit.npz") is None


def test_what_was_made_after_a_checkpoint_falls_with_it(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        for name in "abc":
            kept(run, name, name.encode())
        kept(run, "b", b"anew")
    with opened(tmp_path) as run:
        assert [run.checkpoints.kept(name) is not None for name in "abc"] == [True, True, False]


@pytest.mark.parametrize("name", ["table.csv", "stages/fit.npz"])
@pytest.mark.parametrize("harm", ["gone", "cut", "changed"])
def test_a_finished_run_with_a_damaged_file_goes_on_from_what_is_whole(tmp_path: Path, name: str, harm: str) -> None:
    finished(tmp_path)
    content = (tmp_path / name).read_bytes()
    if harm == "gone":
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(content[:-1] + b"?" * (harm == "changed"))
    with pytest.raises(InputError, match="damaged or missing"):
        read(tmp_path).file(name)
    with opened(tmp_path) as run:
        assert not run.finished
        assert f"{name} is damaged or missing" in run.notices[0]
        assert run.checkpoints.kept("stages/extended.npz")


def test_checkpoints_without_a_manifest_are_of_nobody(tmp_path: Path) -> None:
    (tmp_path / "rounds").mkdir()
    with pytest.raises(InputError, match=r"holds rounds/ but no manifest\.json"):
        opened(tmp_path)


def test_an_unfinished_run_of_other_code_is_done_anew_and_a_finished_one_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path / "finished")
    with opened(tmp_path / "begun") as run:
        kept(run, "stages/fit.npz", b"fit")
    monkeypatch.setattr("vehicle_sbi.report.manifest.code", lambda: "of tomorrow")
    for _ in range(2):  # to be opened does not make it this version's
        with opened(tmp_path / "finished") as run:
            assert run.finished
            assert "made by another version (code)" in run.notices[0]
    with opened(tmp_path / "begun") as run:
        assert "done anew" in run.notices[0]
        assert run.checkpoints.kept("stages/fit.npz") is None


def test_every_byte_of_a_manifest_counts(tmp_path: Path) -> None:
    finished(tmp_path)
    whole = (tmp_path / "manifest.json").read_bytes()
    for at in range(0, len(whole), max(1, len(whole) // 100)):
        (tmp_path / "manifest.json").write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        try:
            same = json.loads((tmp_path / "manifest.json").read_bytes()) == json.loads(whole)  # a blank is no content
        except ValueError:
            same = False
        with nullcontext() if same else pytest.raises(InputError, match=r"manifest"):
            read(tmp_path)


def test_what_a_killed_write_left_is_removed(tmp_path: Path) -> None:
    left = tmp_path / "rounds" / ".round_0.pt.abc123.part"
    opened(tmp_path).close()
    left.parent.mkdir()
    left.write_bytes(b"half")
    opened(tmp_path).close()
    assert not left.exists()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"config": {**CONFIG, "seed": 4}}, r"configuration \(differs in seed\)"),
        ({"config": {**CONFIG, "prior": {}, "noise": "paper"}}, r"configuration \(differs in noise, prior\)"),
        ({"inputs": {"drive.csv": "b" * 64}}, r"files that have changed since \(differs in drive.csv\)"),
    ],
)
def test_another_run_is_refused_and_changes_nothing(tmp_path: Path, changes: dict, named: str) -> None:
    opened(tmp_path).close()
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match=named + ".*choose another hydra.run.dir"):
        opened(tmp_path, **changes)
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before


def test_the_order_of_keys_does_not_make_another_configuration(tmp_path: Path) -> None:
    opened(tmp_path).close()
    opened(tmp_path, config=dict(reversed(CONFIG.items()))).close()


def test_a_folder_in_use_names_the_process(tmp_path: Path) -> None:
    with opened(tmp_path), pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
        opened(tmp_path)
    opened(tmp_path).close()


def _open_and_die(path: Path) -> None:
    opened(path)
    os.kill(os.getpid(), 9)


def test_a_killed_process_leaves_no_lock(tmp_path: Path) -> None:
    process = multiprocessing.get_context("fork").Process(target=_open_and_die, args=(tmp_path,))
    process.start()
    process.join()
    assert process.exitcode == -9
    with opened(tmp_path) as run:
        assert run.manifest["starts"] == 2


@pytest.mark.parametrize("call", ["complete", "record"])
def test_a_full_disk_is_an_os_error_and_leaves_the_manifest_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    with opened(tmp_path) as run:
        before = manifest(tmp_path)

        def full(descriptor: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            getattr(run, call)()
        assert manifest(tmp_path) == before
        expected = [".holder", ".hydra", ".lock", "log.txt", "manifest.json"]
        assert sorted(file.name for file in tmp_path.iterdir()) == expected


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is missing")
def test_a_log_on_a_full_disk_stops_the_run(tmp_path: Path) -> None:
    (tmp_path / "log.txt").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        opened(tmp_path)
    (tmp_path / "log.txt").unlink()
    opened(tmp_path).close()


def test_reading_gives_back_what_ran(tmp_path: Path) -> None:
    with opened(tmp_path, choices={"prior": "default"}) as run:
        run.complete()
    found = read(tmp_path)
    assert found.config == CONFIG
    assert (found.seed, found.overrides) == (3, ("seed=3",))
    assert (found.choice("prior"), found.choice("estimator"), found.choice("rounds")) == ("default", "Spline", "")


def test_a_finished_run_stays_finished_when_it_is_opened_again(tmp_path: Path) -> None:
    with opened(tmp_path) as run:
        run.complete()
    with opened(tmp_path) as run:
        assert run.finished


@pytest.mark.parametrize(
    ("content", "named"),
    [(None, "no manifest.json"), ("{", "not JSON"), ("[]", "schema None"), ('{"schema": 9}', "schema 9")],
)
def test_what_is_no_run_folder_is_named(tmp_path: Path, content: str | None, named: str) -> None:
    if content is not None:
        (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(InputError, match=named):
        read(tmp_path)


def test_an_unfinished_run_is_not_read(tmp_path: Path) -> None:
    opened(tmp_path).close()
    with pytest.raises(InputError, match="has not finished"):
        read(tmp_path)


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("")
    for path in (tmp_path / "run", tmp_path / "run" / "below"):
        with pytest.raises(InputError, match="is a file"):
            opened(path)
