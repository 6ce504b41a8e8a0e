"""diagnose.py as users run it: an answer with its files, resumed where it was, one line for a wrong value."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from conftest import ROOT
from test_case import written
from test_run_script import ENVIRONMENT

CHANNELS = "recording.channels=[a_x,a_y,yaw_rate]"
BASE = ["vehicle=paper", "recording.drive=speed", CHANNELS, "++prior.steering_ratio.gain=null"]


def diagnose(*arguments: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "scripts/diagnose.py", *arguments], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True
    )
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives with roll that the model does not have, one of them to be held out."""
    folder = tmp_path_factory.mktemp("files")
    written(folder / "a.csv", 0, body_roll__gradient=0.012)
    written(folder / "b.csv", 1, body_roll__gradient=0.012)
    return folder


@pytest.fixture(scope="module")
def run(files: Path) -> Path:
    folder = files / "run"
    status, out, err = diagnose(
        f"recordings=[{files}/a.csv]", f"heldout=[{files}/b.csv]", *BASE, f"hydra.run.dir={folder}"
    )
    assert status == 0, err
    assert "body_roll" in out
    assert str(folder / "verdict.json") in out
    return folder


def test_the_verdict_is_what_the_format_promises(run: Path) -> None:
    verdict = json.loads((run / "verdict.json").read_text())
    assert verdict["detected"] is True
    total = verdict["p_none"] + verdict["p_unknown"] + sum(one["probability"] for one in verdict["explanations"])
    assert total == pytest.approx(1.0)
    best = verdict["explanations"][0]
    held = {effect for group in [best["effects"], *verdict["indistinguishable"]] for effect in
            (group if isinstance(group, list) else [group])}  # fmt: skip
    assert "body_roll" in held
    assert best["foretold"] > 0.0  # the other drive has the same roll
    assert set(verdict["fit"]) == {"heldout", "base", "extended", "gain_log_score"}
    assert set(verdict["base_parameters"]["l_f"]) == {"before", "after", "unit"}
    for parameter in best["parameters"].values():
        assert parameter["q05"] < parameter["mean"] < parameter["q95"]


def test_the_extended_model_is_a_configuration_of_run(run: Path) -> None:
    extended = yaml.safe_load((run / "extended.yaml").read_text())
    verdict = json.loads((run / "verdict.json").read_text())
    assert extended["effects"] == verdict["explanations"][0]["effects"]
    assert {"l_f", *extended["effects"]} <= set(extended["prior"])


@pytest.mark.slow
def test_the_extended_model_is_inferred_where_that_is_asked_for(run: Path, files: Path) -> None:
    folder = files / "inferred"
    status, _, err = diagnose(
        f"recordings=[{files}/a.csv]", f"heldout=[{files}/b.csv]", *BASE, f"hydra.run.dir={folder}",
        "figures=false", "infer=npe_c", "infer.rounds.rounds=2", "infer.rounds.simulations=2000",
    )  # fmt: skip
    assert status == 0, err
    fitted, inferred = (json.loads((one / "verdict.json").read_text())["explanations"][0] for one in (run, folder))
    assert inferred["effects"] == fitted["effects"]
    for name, before in fitted["parameters"].items():
        after = inferred["parameters"][name]
        assert after != before
        assert after["mean"] == pytest.approx(before["mean"], abs=before["std"])


def test_a_diagnosis_that_was_interrupted_goes_on(run: Path, tmp_path: Path) -> None:
    # As after a kill in the last stage: everything before stands, and the answer is the same.
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    answer = (folder / "verdict.json").read_text()
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"status": "running"}))
    (folder / "verdict.json").unlink()
    overrides = yaml.safe_load((run / ".hydra" / "overrides.yaml").read_text())
    status, _, err = diagnose(*overrides, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert (folder / "verdict.json").read_text() == answer


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["recordings=[nowhere]"], "unknown option 'nowhere'"),
        (["recordings=[{files}/none.csv]"], "none.csv"),
        (["recordings=[{files}/a.csv]", "heldout=[{files}/a.csv]"], "is also fitted"),
        (
            ["recordings=[{files}/a.csv]", "++prior.steering_ratio.gain=[1.1,1.3]"],
            "excludes 1, where the effect vanishes",
        ),
        (["recordings=[{files}/a.csv]", "heldout=[dart_sine_steering]"], "is of vehicle dart"),
        (["recordings=[{files}/a.csv]", "window_s=0.4"], "window_s = 0.4; it must be longer than warmup_s = 0.5"),
    ],
)
def test_a_wrong_value_gets_one_line(files: Path, tmp_path: Path, arguments: list[str], line: str) -> None:
    folder = tmp_path / "run"
    given = [argument.format(files=files) for argument in arguments]
    status, _, err = diagnose(*BASE, *given, f"hydra.run.dir={folder}")
    assert status == 2
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert line in err
    assert not folder.exists()
