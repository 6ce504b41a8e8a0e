"""run.py as users run it: one line for a wrong value, the same result after any interruption, nothing half-written."""

import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT
from script_runs import ENVIRONMENT, run_script

from vehicle_sbi.report import netcdf

QUICK = ["experiment=smoke", "rounds.simulations=100", "training.max_epochs=3", "samples=200"]


def started(arguments: Sequence[str], script: str = "run", **settings: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, f"scripts/{script}.py", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **{"env": ENVIRONMENT, **settings},
    )


def run(*arguments: str, **settings: Any) -> tuple[int, str, str]:
    """The script; one that has settings of its own is started from nothing."""
    if not settings:
        return run_script("run", *arguments)
    process = started(arguments, **settings)
    out, err = process.communicate(timeout=240)
    return process.returncode, out, err


def killed(folder: Path, at: str, words: Sequence[str] = QUICK, script: str = "run") -> None:
    """Start a script, or the quick study, in `folder` and kill it, without any warning, when `at` appears there."""
    process = started([*words, f"hydra.run.dir={folder}"], script)
    deadline = time.monotonic() + 120
    while not (folder / at).exists():
        assert process.poll() is None, f"ended before {at}: {process.communicate()}"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    status, out, err = run(*QUICK, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert "delta_C_alpha_f" in out
    assert str(folder) in out
    return folder


def test_a_run_leaves_what_it_promises(whole: Path) -> None:
    promised = (
        "manifest.json log.txt table.csv table.md table.tex samples.parquet posterior.nc posterior.pt report.html "
        ".hydra/config.yaml rounds/round_0.pt rounds/round_1.pt"
    )
    for name in promised.split():
        assert (whole / name).stat().st_size > 0, name
    assert list((whole / "figures").glob("*.png"))
    assert not [path for path in whole.rglob(".*.*") if path.is_file() and path.parent.name != ".hydra"]
    table, samples = pd.read_csv(whole / "table.csv"), pd.read_parquet(whole / "samples.parquet")
    assert list(table["parameter"]) == list(samples.columns)
    pd.testing.assert_frame_equal(netcdf.read(whole / "posterior.nc"), samples)
    columns = "parameter unit prior_low prior_high true mean std q05 q50 q95 bound_std contraction identified"
    assert set(columns.split()) <= set(table.columns)
    assert len(samples) == 200
    np.testing.assert_allclose(table["mean"], samples.mean(), rtol=1e-9)
    assert (table["prior_low"].to_numpy() <= samples.min().to_numpy()).all()
    assert (samples.max().to_numpy() <= table["prior_high"].to_numpy()).all()


RESUMED = ["table.csv", "samples.parquet", "rounds/round_0.pt", "rounds/round_1.pt"]


@pytest.mark.slow  # a diagnosis that was killed, and rounds of their own, go on in the tests that are not
@pytest.mark.parametrize(
    "at",
    ["manifest.json", "rounds/round_0.pt", "rounds/round_1.pt", "samples.parquet", "table.csv", "report.html"],
)
def test_a_killed_run_started_again_gives_the_result_of_one_that_was_not(whole: Path, tmp_path: Path, at: str) -> None:
    folder = tmp_path / "run"
    killed(folder, at)
    status, _, err = run(*QUICK, f"hydra.run.dir={folder}")
    assert status == 0, err
    for name in RESUMED:
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.slow
def test_a_finished_run_is_shown_again_and_not_redone(whole: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("round_*.pt")}
    status, out, _ = run(*QUICK, f"hydra.run.dir={whole}")
    assert status == 0
    assert "delta_C_alpha_f" in out
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("round_*.pt")} == before


def vehicle(folder: Path, **changes: object) -> Path:
    content = yaml.safe_load((ROOT / "conf/vehicle/paper.yaml").read_text()) | changes
    (folder / "car.yaml").write_text(yaml.safe_dump(content))
    return folder / "car.yaml"


def recording(folder: Path, text: str) -> Path:
    (folder / "drive.csv").write_text(text)
    return folder / "drive.csv"


ROWS = "\n".join(f"{k / 100},0.01,{10 + k / 1000}" for k in range(1000))
WRONG: Mapping[str, tuple[str | Callable[[Path], str], str]] = {
    "unknown key": ("training.max_epoch=3", "training: unknown key 'max_epoch'; known: max_epochs"),
    "unknown parameter": ("+prior.l_r=[1,2]", "prior: unknown parameter 'l_r'; known: l_f"),
    "prior upside down": ("prior.l_f=[1.5,1.0]", "prior: l_f = [1.5, 1]; low must be below high"),
    "prior past the wheelbase": ("prior.l_f=[1.0,3.0]", "prior: l_f up to 3 m reaches past the wheelbase 2.7 m"),
    "truth outside": (
        "truth={l_f:9,h_cog:0.4,delta_C_kappa_f:0,delta_C_kappa_r:0,delta_C_alpha_f:0,delta_C_alpha_r:0}",
        "truth: l_f = 9 m lies outside its prior [1, 1.5]",
    ),
    "truth incomplete": ("truth={l_f:1.2}", "truth: no value for h_cog"),
    "seed": ("seed=-1", "seed = -1; it must be a whole number that is not negative"),
    "neither effects nor plausible": (
        "effects=plausibel",
        "effects = plausibel; it must be a list, as in effects=[aero_drag,road_grade], or plausible",
    ),
    "rate of an effect": (
        "effect_prior.table.aero_drag.area=[1.4,0.6]",
        "effect_prior.table.aero_drag.area = [1.4, 0.6]; a rate lies between 0 and 1",
    ),
    "drive": ("drive=pedals", "drive: unknown drive mode 'pedals'; known: "),
    "too few": ("rounds.simulations=10", "rounds=truncated: "),
    "negative mass": (lambda folder: f"vehicle={vehicle(folder, m=-1500.0)}", "vehicle 'paper': m = -1500; it must"),
    "l_f past L": (lambda folder: f"vehicle={vehicle(folder, l_f=3.0)}", "vehicle 'paper': l_f = 3 m reaches past"),
    "misspelt constant": (lambda folder: f"vehicle={vehicle(folder, mass=1500.0)}", "unknown constant 'mass'; known"),
    "noise that is no number": ("noise.share.a_x=loud", "noise.share: a_x = 'loud'; it must be a number"),
    "unknown channel": ("manoeuvre.channels=[a_x,a_q]", "manoeuvre 'paper_mild': unknown channel 'a_q'; known: a_"),
    "no period": ("manoeuvre.torque_period=0.0", "manoeuvre 'paper_mild': "),
    "no recording": ("recording=nowhere.csv", "nowhere.csv: no such file"),
    "empty recording": (lambda folder: f"recording={recording(folder, '')}", "drive.csv: is empty"),
    "recording without a channel": (
        lambda folder: f"recording={recording(folder, 'time_s,steering_rad,v_x_mps' + chr(10) + ROWS)}",
        "a_y",
    ),
}


# Each is a process of several seconds; the modules' own tests hold the other lines.
FIRST = {"unknown key", "prior upside down", "negative mass", "recording without a channel"}
CASES = [pytest.param(case, marks=() if case in FIRST else pytest.mark.slow) for case in WRONG]


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_value_gets_one_line_and_leaves_nothing_behind(tmp_path: Path, case: str) -> None:
    given, message = WRONG[case]
    argument = given(tmp_path) if callable(given) else given
    status, out, err = run(argument, f"hydra.run.dir={tmp_path / 'run'}")
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert err.startswith("error: ")
    assert message in err
    assert not (tmp_path / "run").exists()


def test_a_folder_of_another_study_is_left_as_it_is(whole: Path) -> None:
    kept = [path for path in whole.rglob("*") if path.is_file() and path.name not in (".lock", ".holder")]
    before = {path: path.read_bytes() for path in kept}
    status, _, err = run(*QUICK, "seed=1", f"hydra.run.dir={whole}")
    assert (status, err.count("\n")) == (2, 1)
    assert "holds a run of another configuration (differs in seed" in err
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.slow
def test_a_disk_that_fills_up_leaves_whole_files_only_and_the_run_can_go_on(whole: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk: no checkpoint fits, and later all do."""

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))

    folder = tmp_path / "run"
    status, _, err = run(*QUICK, f"hydra.run.dir={folder}", preexec_fn=limited)
    assert status == 2, err
    assert err.splitlines()[-1].startswith("error: cannot write ")
    assert not list((folder / "rounds").glob("*.pt"))
    assert not list((folder / "rounds").glob(".*"))
    status, _, err = run(*QUICK, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert (folder / "table.csv").read_bytes() == (whole / "table.csv").read_bytes()


@pytest.mark.slow
def test_a_run_with_plausible_effects_says_which_were_free_and_what_they_cost(tmp_path: Path) -> None:
    """Stopped after a round and started again it ends with the same numbers."""
    plausible = [*QUICK, "effects=plausible", "noise=constant"]
    folder, again = tmp_path / "run", tmp_path / "again"
    status, out, err = run(*plausible, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert "plausible effects were free" in out
    assert "bound wider by" in out
    table = pd.read_csv(folder / "table.csv")
    assert (table["bound_widened"] >= 1.0).all()
    assert list(table["parameter"]) == list(pd.read_parquet(folder / "samples.parquet").columns)
    (again / "rounds").mkdir(parents=True)
    (again / "rounds" / "round_0.pt").write_bytes((folder / "rounds" / "round_0.pt").read_bytes())
    status, _, err = run(*plausible, f"hydra.run.dir={again}")
    assert status == 0, err
    assert (again / "table.csv").read_bytes() == (folder / "table.csv").read_bytes()
