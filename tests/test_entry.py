"""The door of the scripts: one line and status 2 for a wrong value, and a folder that the same command finds again."""

from _entry import LONGEST_NAME, study_name

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent

SITE = """
import _entry.configuration
from pathlib import Path

_entry.configuration.CONF = Path(__file__).parent / "conf"  # in the processes of a sweep too
"""
SCRIPT = """
import _entry
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate


@_entry.launch("config")
def main(cfg):
    rounds = instantiate(cfg.rounds)
    match cfg.does:
        case "bug":
            raise ZeroDivisionError
        case "interrupted":
            raise KeyboardInterrupt
        case "full disk":
            with open("/dev/full", "w") as file:
                file.write("a")
        case "prints":
            print("a" * cfg.letters)
        case "protected":
            raise PermissionError(13, "Permission denied", "/protected/table.csv")
        case "needs":
            cfg.needed
        case "extra":
            instantiate(cfg.rounds, extra=1)
    Path(HydraConfig.get().runtime.output_dir, "done").write_text(str(rounds))


if __name__ == "__main__":
    main()
"""

TARGETS = """
from dataclasses import dataclass

from vehicle_sbi.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Rounds:
    count: int
    share: float = 0.1
    cap: float | None = None

    def __post_init__(self):
        if self.count < 1:
            raise InputError(f"rounds.count = {self.count}: must be at least 1")
"""


FOREIGN = "_target_: pathlib.Path.touch, _args_: [sprung]"
HOSTILE = {
    "hostile": f"deeper: {{in: [{{{FOREIGN}}}]}}",
    "callback": f"hydra: {{callbacks: {{mine: {{{FOREIGN}}}}}}}",
    "logging": "hydra: {job_logging: {version: 1, root: {handlers: [x]}, handlers: {x: {(): pathlib.Path.touch}}}}",
    "environment": "hydra: {job: {env_set: {GIT_CONFIG_COUNT: '1'}}}",
    "shell": 'hydra: {launcher: {comment: "one\\ntouch two"}}',
}
ALIASES = ["a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]"] + [
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project of one script, with the project's own settings of Hydra."""
    ours = yaml.safe_load((ROOT / "conf" / "config.yaml").read_text())
    settings = [entry for entry in ours["defaults"] if "override hydra/" in str(entry)]
    files = {
        "sitecustomize.py": SITE,
        "script.py": SCRIPT,
        "targets.py": TARGETS,
        "conf/rounds/several.yaml": "_target_: targets.Rounds\ncount: 5\n",
        "conf/rounds/single.yaml": "_target_: targets.Rounds\ncount: 1\n",
        "conf/experiment/misspelt.yaml": "# @package _global_\nrounds: {cuont: 3}\n",
        "conf/experiment/not_yaml.yaml": "rounds: [1\n",
        "deep/experiment/one.yaml": "[" * 60 + "]" * 60,
        "aliases/experiment/one.yaml": "\n".join(ALIASES),
        "conf/config.yaml": yaml.safe_dump(
            {
                "defaults": ["_self_", {"rounds": "several"}, {"experiment": None}, *settings],
                "seed": 0,
                "does": "nothing",
                "needed": "???",
                "hydra": ours["hydra"],
            }
        ),
    }
    hostile = {f"hostile/experiment/{name}.yaml": f"# @package _global_\n{text}\n" for name, text in HOSTILE.items()}
    for name, text in {**files, **hostile}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def run(
    folder: Path, *arguments: str, stdout: IO[str] | int = subprocess.PIPE, **environment: str
) -> subprocess.CompletedProcess[str]:
    search = os.pathsep.join([str(folder), str(ROOT / "scripts"), str(ROOT)])
    inherited = {key: value for key, value in os.environ.items() if key != "HYDRA_FULL_ERROR"}
    return subprocess.run(
        [sys.executable, "script.py", *arguments],
        cwd=folder,
        env=inherited | {"PYTHONPATH": search} | environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )


WRONG: Mapping[str, tuple[str, str]] = {
    "unknown key": ("rounds.cuont=1", "rounds: unknown key 'cuont'; known: count, cap, share"),
    "unknown key at the top": (
        "sed=1",
        "configuration: unknown key 'sed'; known: seed, needed, does, experiment, rounds",
    ),
    "unknown group": ("experment=x", "configuration: unknown key 'experment'; known: experiment, "),
    "unknown option": ("rounds=sevral", "rounds: unknown option 'sevral'; known: several, single"),
    "unknown key in a file": (
        "experiment=misspelt",
        "rounds (targets.Rounds): unknown key 'cuont'; known: count, cap, share",
    ),
    "unknown added key": ("+rounds.foo=1", "rounds (targets.Rounds): unknown key 'foo'; known: "),
    "key left at its default": ("rounds.share=1", "rounds.share is not in the configuration, which leaves it at its "),
    "not a number": ("+rounds.share=much", "rounds.share = much: must be a number"),
    "not whole": ("rounds.count=2.5", "rounds.count = 2.5: must be a whole number"),
    "null": ("rounds.count=null", "rounds.count = null: must be a whole number"),
    "list for a scalar": ("rounds.count=[1]", "rounds.count = [1]: must be a whole number"),
    "what the class refuses": ("rounds.count=0", "rounds.count = 0: must be at least 1"),
    "what the call lacks": (
        "~rounds.count",
        "rounds: Rounds.__init__() missing 1 required keyword-only argument: 'count'",
    ),
    "no key=value": ("seed", "cannot read 'seed' as key=value: missing EQUAL"),
    "a letter outside quotes": (
        "rounds=se&veral",
        "cannot read 'rounds=se&veral' as key=value: '&' stands outside quotes; write \"key='value'\"",
    ),
    "a line's end": ("seed=1\n", r"cannot read 'seed=1\n' as key=value: '\n' stands outside quotes"),
    "unclosed": ("rounds=[a", "cannot read 'rounds=[a' as key=value: "),
    "sweep without -m": ("seed=1,2", "Ambiguous value for argument 'seed=1,2' "),
    "unknown target": (
        "rounds._target_=targets.Nothing",
        "rounds: unknown _target_ 'targets.Nothing'; known: targets.Rounds",
    ),
    "foreign code": ("rounds={_target_:os.system}", "rounds: unknown _target_ 'os.system'"),
    "foreign code in an experiment": (
        "--config-dir=hostile experiment=hostile",
        "deeper.in[0]: unknown _target_ 'pathlib.Path.touch'",
    ),
    "foreign code by Hydra": (
        "--config-dir=hostile experiment=callback",
        "hydra.callbacks.mine._target_ = pathlib.Path.touch: only Hydra",
    ),
    "foreign code by logging": (
        "--config-dir=hostile experiment=logging",
        "hydra.job_logging.handlers.x.() = pathlib.Path.touch: only",
    ),
    "the environment of a job": (
        "--config-dir=hostile experiment=environment",
        "hydra.job.env_set: what a shell gets is taken from the command line alone",
    ),
    "the shell of a job": (
        "--config-dir=hostile hydra/launcher=submitit_slurm experiment=shell",
        "hydra.launcher.comment: what a shell gets is taken from the command line alone",
    ),
    "unknown reference": ("seed=${nothing}", "seed: Interpolation key 'nothing' not found"),
    "missing value": ("does=needs", "needed: Missing mandatory value: needed"),
    "extra argument": ("does=extra", "rounds: Rounds.__init__() got an unexpected keyword argument 'extra'"),
    "file that is not YAML": (
        "experiment=not_yaml",
        "{folder}/conf/experiment/not_yaml.yaml, line 2: not valid YAML: ",
    ),
    "a key with dashes": ("--seed 1", "unknown option --seed: keys are written without dashes, seed=1"),
    "a key and value with dashes": ("--seed=1 -m", "unknown option --seed: keys are written without dashes, seed=1"),
    "dashes before another key": (
        "--seed rounds.count=1",
        "unknown option --seed: keys are written without dashes, seed=…",
    ),
    "a key with one dash": (
        "-rounds 1",
        "argument --run/-r: ignored explicit argument 'ounds'; keys are written without",
    ),
    "a flag between keys": ("-m seed=1 -r does=x", "does=x stands apart from other keys: write flags, as -m, before"),
    "blanks around =": ("-m rounds = single", "leave no blanks around '=': write rounds=single"),
    "a blank before =": ("-m rounds =single", "leave no blanks around '=': write rounds=single"),
    "a blank behind =": ("-m rounds= single", "leave no blanks around '=': write rounds=single"),
    "protected file": ("does=protected", "cannot write /protected/table.csv: permission denied"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_value_gets_one_line_and_leaves_no_folder(folder: Path, case: str) -> None:
    given, line = WRONG[case]
    done = run(folder, *given.split(" ") if given.startswith("-") else [given])
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (2, 1, "")
    assert done.stderr.startswith(f"error: {line.replace('{folder}', str(folder))}")
    assert not list(folder.glob("outputs/*"))
    assert not (folder / "sprung").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_gets_one_line(folder: Path) -> None:
    done = run(folder, "does=full disk")
    name = study_name(["does=full disk"])
    assert (done.returncode, done.stderr) == (
        2,
        f"error: cannot write {folder}/outputs/{name}: no space left on device\n",
    )


LONG = 100_000  # letters, more than any buffer holds


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("letters", [1, LONG])
def test_standard_output_that_takes_no_more_is_named(folder: Path, letters: int) -> None:
    with open("/dev/full", "w") as full:
        done = run(folder, "does=prints", f"+letters={letters}", stdout=full)
    assert (done.returncode, done.stderr) == (2, "error: cannot write standard output: no space left on device\n")


@pytest.mark.parametrize("letters", [1, LONG])
def test_a_reader_that_reads_no_further_ends_a_script_quietly(folder: Path, letters: int) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as unread:
        done = run(folder, "does=prints", f"+letters={letters}", stdout=unread)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_bug_keeps_its_traceback(folder: Path) -> None:
    done = run(folder, "does=bug")
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


def test_the_traceback_of_a_wrong_value_is_to_be_had(folder: Path) -> None:
    done = run(folder, "rounds.count=0", HYDRA_FULL_ERROR="1")
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert "InputError" in done.stderr


def test_an_interruption_says_how_to_go_on(folder: Path) -> None:
    done = run(folder, "does=interrupted")
    assert (done.returncode, done.stderr.count("\n")) == (130, 1)
    assert "the same command continues" in done.stderr


@pytest.mark.parametrize("launcher", ["basic", "joblib", "submitit_local"])
def test_a_sweep_names_the_job_that_fails_and_runs_the_others(folder: Path, launcher: str) -> None:
    done = run(folder, "-m", "rounds.count=1,0,2", f"hydra/launcher={launcher}")
    assert done.returncode == 2
    assert done.stderr == "error: job rounds.count=0: rounds.count = 0: must be at least 1\n"
    assert {path.name for path in folder.glob("outputs/sweep/[!.]*/")} == {"rounds.count-1", "rounds.count-2"}


def test_a_sweep_for_slurm_gets_one_line_where_there_is_none(folder: Path) -> None:
    done = run(folder, "-m", "rounds.count=1,2", "hydra/launcher=submitit_slurm", PATH="")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: hydra/launcher=submitit_slurm needs a SLURM cluster: there is no srun here\n"


def test_a_script_without_arguments_runs_with_its_defaults(folder: Path) -> None:
    done = run(folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert (folder / "outputs" / "default" / "done").exists()


def test_a_run_writes_only_what_the_script_writes(folder: Path) -> None:
    done = run(folder, "seed=1", "rounds=single", "hydra.job.name=x")
    assert (done.returncode, done.stderr) == (0, "")
    written = [path for path in (folder / "outputs").rglob("*") if path.is_file()]
    assert written == [folder / "outputs" / "rounds-single+seed-1" / "done"]


def test_threads_are_set_before_numpy_is_imported_whatever_the_environment_says(folder: Path) -> None:
    code = "import os, sys, _entry; print(os.environ['OMP_NUM_THREADS'], {'numpy', 'torch'} & sys.modules.keys())"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "scripts"), str(ROOT)])}
    call = [sys.executable, "-c", code]
    for threads in ("1", "3"):
        assert subprocess.check_output(call, env=environment | {"OMP_NUM_THREADS": threads}, text=True) == "1 set()\n"


def test_the_environment_of_a_job_may_be_typed(folder: Path) -> None:
    done = run(folder, "+hydra.job.env_set.SAID=1")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("name", "said"), [("deep", "nested deeper than 50 levels"), ("aliases", "more than 100,000")])
def test_a_file_that_stands_for_more_than_a_configuration_gets_one_line(folder: Path, name: str, said: str) -> None:
    done = run(folder, f"--config-dir={name}", "experiment=one")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


WAITS = "open('waits', 'w').close(); import time; time.sleep(60)"
LOST = """
class Lost:
    def __del__(self):
        WAITS

Lost()
"""
MOMENTS = {
    "import": {"script.py": f"import _entry\n{WAITS}"},
    "import of a target": {"targets.py": f"{WAITS}\n{TARGETS}"},
    "import of a library that makes it its own error": {
        "targets.py": f"try:\n    {WAITS}\nexcept BaseException as error:\n    raise OSError from error\n"
    },
    "import of a library that loses it": {"targets.py": LOST.replace("WAITS", WAITS) + "time.sleep(60)"},
    "import of a library that ignores it": {
        "targets.py": f"try:\n    {WAITS}\nexcept BaseException:\n    pass\nimport wave, colorsys\ntime.sleep(60)"
    },
    "work": {"script.py": SCRIPT.replace("raise KeyboardInterrupt", WAITS)},
}


def interrupted(folder: Path, asked: signal.Signals) -> tuple[int, str]:
    """Exit status of a script that is interrupted as soon as there is a file `waits`, and what it prints."""
    search = os.pathsep.join([str(folder), str(ROOT / "scripts"), str(ROOT)])
    with subprocess.Popen(
        [sys.executable, "script.py", "does=interrupted"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": search, "NUMBA_NUM_THREADS": "2"},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # ignored in a background job
    ) as process:
        while not (folder / "waits").exists() and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(asked)
        try:
            _, said = process.communicate(timeout=20)
        finally:
            process.kill()
    return process.returncode, said


@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interruption_at_any_moment_gets_one_line(folder: Path, asked: signal.Signals, moment: str) -> None:
    for name, text in MOMENTS[moment].items():
        (folder / name).write_text(text)
    status, said = interrupted(folder, asked)
    assert said.count("\n") == 1, said
    assert "the same command continues" in said
    assert status == 128 + asked


BUSY = """
import atexit, subprocess, sys, threading, time
from multiprocessing import get_context
from pathlib import Path
from vehicle_sbi.threads import each

children = [subprocess.Popen([sys.executable, "-IS", "-c", "import time; time.sleep(60)"])]
atexit.register(children[0].terminate)
children.append(get_context("fork").Process(target=time.sleep, args=[60]))
children[1].start()
threading.Thread(target=time.sleep, args=[60]).start()

def work(seconds):
    Path("children").write_text(" ".join(str(child.pid) for child in children))
    Path("waits").touch()
    time.sleep(seconds)

try:
    each(work, [60, 60])
finally:
    Path("closed").touch()
"""


def test_an_interruption_waits_for_no_thread_and_leaves_no_process(folder: Path) -> None:
    (folder / "busy.py").write_text(BUSY)
    (folder / "script.py").write_text(SCRIPT.replace("raise KeyboardInterrupt", "import busy"))
    status, said = interrupted(folder, signal.SIGTERM)
    assert (status, said.count("\n")) == (143, 1), said
    assert (folder / "closed").exists()
    time.sleep(0.2)
    for child in (folder / "children").read_text().split():
        assert not is_running(int(child))


def is_running(pid: int) -> bool:
    """Whether there is such a process, other than one that has ended and is not waited for."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout
    return bool(state) and not state.startswith("Z")


def test_the_name_of_a_study_does_not_depend_on_the_order_of_its_keys() -> None:
    assert study_name([]) == "default"
    assert study_name(["seed=3", "estimator=maf"]) == study_name(["estimator=maf", "seed=3"]) == "estimator-maf+seed-3"


def test_names_of_different_studies_differ_and_are_safe_as_folders() -> None:
    long = [f"prior.parameter_{i}=[0,{i}]" for i in range(30)]
    studies = [["recording=a/b.csv"], ["recording=a_b.csv"], ["recording=../b.csv"], ["~x"], ["x="], long, long[:-1]]
    names = [study_name(study) for study in studies]
    assert len(set(names)) == len(names)
    for name in names:
        assert len(name) <= LONGEST_NAME + 9
        assert not set(name) & set("/=,[]~ ")
        assert not name.startswith(".")
