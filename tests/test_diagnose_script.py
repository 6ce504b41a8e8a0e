"""diagnose.py as users run it: an answer with its files, resumed where it was, one line for a wrong value."""

import json
import pickle
import re
import shlex
import shutil
from dataclasses import replace
from html import escape
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
import yaml
from cars import PAPER
from conftest import ROOT
from script_runs import run_script
from test_case import NATIVE, written
from test_run_script import killed, vehicle
from test_run_script import run as infer
from test_stage_file import Trap, write

from vehicle_sbi.files import sha256
from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.mismatch.design.identifiability import Card
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck
from vehicle_sbi.mismatch.pipeline import AtOnce, Begun
from vehicle_sbi.mismatch.selection.detection import Examined
from vehicle_sbi.mismatch.selection.extended import Extended
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report import netcdf
from vehicle_sbi.report.extended import command, extended
from vehicle_sbi.report.stage_file import read

CHANNELS = "recording.channels=[a_x,a_y,yaw_rate]"
BASE = ["vehicle=paper", "recording.drive=speed", CHANNELS, "++prior.steering_ratio.gain=null"]


def diagnose(*arguments: str) -> tuple[int, str, str]:
    return run_script("diagnose", *arguments)


def goes_on(folder: Path, *sealed: str) -> tuple[int, str, str]:
    """The command of a run folder again, as after a kill in its last stage, with some files as they are now."""
    manifest = manifests.read(folder)
    manifest["files"] |= {name: sha256(folder / name) for name in sealed}
    manifests.write(folder, manifest | {"status": "running"})
    overrides = yaml.safe_load((folder / ".hydra" / "overrides.yaml").read_text())
    return diagnose(*overrides, f"hydra.run.dir={folder}")


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
    assert "body roll" in out.splitlines()[0]
    assert str(folder / "verdict.json") in out
    assert base_parameters_of(out) == json.loads((folder / "verdict.json").read_text())["base_parameters"].keys()
    return folder


def base_parameters_of(out: str) -> set[str]:
    """Names in the table that stands between what is said and the paths of what was written."""
    table = out.split("\n\n")[1]
    return {line.split()[0] for line in table.splitlines()[1:]}


def test_the_verdict_is_what_the_format_promises(run: Path) -> None:
    verdict = json.loads((run / "verdict.json").read_text())
    assert verdict["detected"] is True
    alone = sum(one["probability"] for one in verdict["explanations"])
    assert verdict["p_none"] + verdict["p_unknown"] + alone <= 1.0 + 1e-9  # not all sets are listed
    assert len(verdict["headline"].split()) <= 25
    assert 1 <= len(verdict["lines"]) <= 5
    assert verdict["sentence"] == " ".join([verdict["headline"], *verdict["lines"]])
    best = verdict["explanations"][0]
    held = {effect for group in [best["effects"], *verdict["indistinguishable"]] for effect in
            (group if isinstance(group, list) else [group])}  # fmt: skip
    assert "body_roll" in held
    assert set(verdict["fit"]) == {"heldout", "base", "extended", "gain_log_score", "accepted", "accepted_because"}
    assert set(verdict["base_parameters"]["l_f"]) == {"before", "after", "unit", "identified"}
    for parameter in best["parameters"].values():
        assert parameter["q05"] < parameter["mean"] < parameter["q95"]


def test_the_draws_are_those_that_the_verdict_speaks_of(run: Path) -> None:
    verdict, draws = json.loads((run / "verdict.json").read_text()), netcdf.read(run / "posterior.nc")
    for name, one in verdict["base_parameters"].items():
        assert draws[name].mean() == pytest.approx(one["after"]["mean"], rel=1e-9)
        assert draws[name].std(ddof=0) == pytest.approx(one["after"]["std"], rel=1e-9)
    away = draws.notna().T.groupby(lambda name: name.split(".")[0]).any().T.mean()
    with xr.open_datatree(run / "posterior.nc", engine="h5netcdf") as tree:
        stated = [(str(name).split(".")[0], one.attrs) for name, one in tree["posterior"].data_vars.items()]
    said = {effect: attrs["effect_probability"] for effect, attrs in stated if "effect_probability" in attrs}
    assert {name: said[name] for name in verdict["effects"]} == pytest.approx(verdict["effects"])
    for name, probability in verdict["effects"].items():
        assert probability <= away[name] + 1e-12  # by sizes that show; others may be away too


@pytest.mark.slow
def test_the_extended_model_is_a_configuration_of_run(run: Path, tmp_path: Path) -> None:
    # By the command that is printed; free is what is so in the base model and the effect, not in run.py.
    written_down = yaml.safe_load((run / "extended.yaml").read_text())
    best = json.loads((run / "verdict.json").read_text())["explanations"][0]
    assert written_down["effects"] == best["effects"]
    program, verb, *words = shlex.split(command(run))
    assert (program, verb, words[-1]) == ("vehicle-sbi", "run", f"hydra.run.dir={run}-extended")
    folder = tmp_path / "inferred"
    status, _, err = infer(
        *words[:-1], "rounds.rounds=1", "rounds.simulations=100", "training.max_epochs=2", "samples=200",
        f"hydra.run.dir={folder}",
    )  # fmt: skip
    assert status == 0, err
    inferred = pd.read_csv(folder / "table.csv").set_index("parameter")
    assert set(inferred.index) == {"l_f", "C_alpha_f", "C_alpha_r", *best["parameters"]}
    assert PAPER.L is not None
    assert tuple(inferred[["prior_low", "prior_high"]].loc["l_f"]) == pytest.approx((0.35 * PAPER.L, 0.65 * PAPER.L))
    manifest = json.loads((folder / "manifest.json").read_text())
    assert [Path(source).name for source in manifest["inputs"]] == ["a.csv"]
    config, asked = (yaml.safe_load((one / ".hydra" / "config.yaml").read_text()) for one in (folder, run))
    for key in ("vehicle", "model", "drive", "noise", "window_s", "warmup_s"):
        assert config[key] == asked[key]
    assert config["recording"]["channels"] == asked["recording"]["channels"]


def test_a_part_of_an_effect_is_inferred_alone(run: Path) -> None:
    # The same diagnosis, had it found the gradient without the lag, one of two recordings named in its own words.
    config = yaml.safe_load((run / ".hydra" / "config.yaml").read_text())
    model = read(run / "stages" / "extended.npz", Extended).model
    simulator = model.fit.simulator
    roll = EFFECT_PARAMETERS["body_roll.gradient"]
    part = (*(p for p in simulator.space.parameters if p.name in model.base), roll)
    fit = replace(model.fit, observation=model.fit.observation.extended(replace(simulator, space=ParameterSpace(part))))
    usual = config["recording"]
    named = usual | {"path": "other.csv", "v_min": 3.0}
    text = extended(
        replace(model, effects=("body_roll",), fit=fit), config | {"recordings": [named, "a.csv"], "effects": []}
    )
    written_down = yaml.safe_load(text)
    assert written_down["prior"]["body_roll"] == {"gradient": [0.0, 0.02], "lag": None, "period": None}
    assert (written_down["recording"]["path"], written_down["recording"]["v_min"]) == (
        str(Path("other.csv").absolute()),
        3.0,
    )
    both = [(one["path"], one["v_min"]) for one in written_down["recordings"]]
    assert both == [(str(Path("other.csv").absolute()), 3.0), (str(Path("a.csv").absolute()), usual["v_min"])]
    space = parameter_space(written_down["prior"], vehicle=PAPER, model="single_track", effects=written_down["effects"])
    assert space == ParameterSpace(part)


def test_no_path_of_the_extended_model_depends_on_the_folder_that_it_is_read_in(run: Path) -> None:
    config = yaml.safe_load((run / ".hydra" / "config.yaml").read_text())
    model = read(run / "stages" / "extended.npz", Extended).model
    files = {"path": "a.blf", "mapping": "a.mapping.yaml", "dbc": "a.dbc"}
    one = config["recording"] | files
    recording = yaml.safe_load(extended(model, config | {"recordings": [one]}))["recording"]
    assert {key: recording[key] for key in files} == {key: str(Path(file).absolute()) for key, file in files.items()}
    spelled_out = {"a_y": {"column": "a"}}
    recording = yaml.safe_load(extended(model, config | {"recordings": [one | {"mapping": spelled_out}]}))["recording"]
    assert recording["mapping"] == spelled_out


def test_what_the_recordings_could_have_shown_is_in_the_verdict_and_on_the_page(run: Path) -> None:
    verdict, page = json.loads((run / "verdict.json").read_text()), (run / "report.html").read_text()
    shown, hidden, idle = verdict["could_show"], verdict["invisible"], verdict["cannot_act"]
    beside = verdict["effects"].keys() - shown.keys()  # those that show where other effects are there too
    assert sorted([*shown, *hidden, *idle, *beside]) == sorted(CATALOGUE)
    for effect, least in shown.items():
        assert set(least) == {"parameter", "size", "unit"}
        assert least["parameter"].startswith(f"{effect}.")
        assert least["parameter"] in page
    reason = "drive mode speed takes a measured speed in place of torques"
    assert idle["drive_gain"] == reason
    assert f"Cannot act here: drive_gain, brake_gain, drive_delay ({reason})." in page
    assert "absorbed by" in page
    assert "Not told apart: " in page


def test_the_page_answers_as_the_screen_does(run: Path) -> None:
    verdict, page = json.loads((run / "verdict.json").read_text()), (run / "report.html").read_text()
    assert f"<strong>{escape(verdict['headline'])}</strong>" in page
    for said in verdict["lines"]:
        assert f"<p>{escape(said)}</p>" in page


def test_why_the_fit_may_not_be_relied_on_is_printed(run: Path, tmp_path: Path) -> None:
    # The same diagnosis, had its check found weights with a heavy tail, as it would have gone on from there.
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    begun = read(folder / "stages" / "fit.npz", Begun)
    write(folder / "stages" / "fit.npz", replace(begun, fit_check=FitCheck(0.93, 0.0)), Begun)
    status, out, err = goes_on(folder, "stages/fit.npz")
    assert status == 0, err
    warning = next(line for line in out.splitlines() if "Pareto k = 0.93" in line)
    assert out.startswith("The base fit is doubtful. Missing: ")
    verdict = json.loads((folder / "verdict.json").read_text())
    assert verdict["warnings"] == [warning, *json.loads((run / "verdict.json").read_text())["warnings"]]
    assert warning in verdict["notes"]
    assert '<section class="warnings" role="alert">' in (folder / "report.html").read_text()


def test_an_estimator_is_chosen_as_the_documentation_says() -> None:
    (override,) = set(re.findall(r"`(\w+(?:/\w+)*@infer\.estimator=\w+)`", (ROOT / "docs/diagnosis.md").read_text()))
    status, out, err = diagnose("--cfg", "job", "infer=npe_c", override)
    assert status == 0, err
    assert "MaskedAutoregressiveFlow" in yaml.safe_load(out)["infer"]["estimator"]["_target_"]


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
    (folder / "verdict.json").unlink()
    status, _, err = goes_on(folder)
    assert status == 0, err
    assert (folder / "verdict.json").read_text() == answer


def test_the_same_command_after_an_edit_of_vehicle_or_mapping_gets_one_line(files: Path, tmp_path: Path) -> None:
    folder, car, mapping = tmp_path / "run", vehicle(tmp_path), tmp_path / "a.mapping.yaml"
    mapping.write_text(NATIVE)
    words = [f"recordings=[{files}/a.csv]", f"mapping={mapping}", f"vehicle={car}", *BASE[1:]]
    killed(folder, "manifest.json", words, "diagnose")
    assert {str(car), str(mapping)} < manifests.read(folder)["inputs"].keys()
    for file in (car, mapping):
        before = file.read_text()
        file.write_text(f"{before}# edited\n")
        status, out, err = diagnose(*words, f"hydra.run.dir={folder}")
        file.write_text(before)
        since = "other input files, or of files that have changed since"
        assert (status, out) == (2, "")
        assert err == f"error: {folder} holds a run of {since} (differs in {file}); choose another hydra.run.dir\n"


def test_every_stage_that_was_kept_is_written_again_as_it_was_read(run: Path, tmp_path: Path) -> None:
    # Of what is searched for the first time as of what was read, each object is once in the file.
    kinds = {
        "fit": Begun,
        "directions": list[Direction],
        "separability": Card,
        "examined": Examined,
        "pruned": AtOnce,
        "extended": Extended,
    }
    assert {path.name for path in (run / "stages").iterdir()} == {f"{name}.npz" for name in kinds}
    for name, kind in kinds.items():
        path, again = run / "stages" / f"{name}.npz", tmp_path / f"{name}.npz"
        write(again, read(path, kind), kind)
        assert again.read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_what_is_no_stage_is_not_run_and_its_stage_is_done_anew(run: Path, tmp_path: Path) -> None:
    # One stage is a pickle that would write a file, of another a byte is wrong: it says so, and the answer is the same.
    folder, sprung = tmp_path / "run", tmp_path / "sprung"
    shutil.copytree(run, folder)
    answer = (folder / "verdict.json").read_text()
    (folder / "stages" / "examined.npz").write_bytes(pickle.dumps(Trap(sprung)))
    damaged = bytearray((folder / "stages" / "pruned.npz").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (folder / "stages" / "pruned.npz").write_bytes(damaged)
    overrides = yaml.safe_load((folder / ".hydra" / "overrides.yaml").read_text())
    status, _, err = diagnose(*overrides, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert "examined.npz is damaged or missing; what rests on it is made anew" in err
    assert not sprung.exists()
    assert (folder / "verdict.json").read_text() == answer
    for name in ("directions", "examined", "pruned"):
        assert (folder / "stages" / f"{name}.npz").read_bytes() == (run / "stages" / f"{name}.npz").read_bytes()


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
        (["recordings=[{files}/a.csv]", "engine=dask"], "engine = dask: one study runs on this machine; fleet and"),
        (["recordings=[{files}/a.csv]", "infer=npe_c", "device=tpu"], "unknown device 'tpu'; known: cpu, cuda"),
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


def test_a_recording_of_a_private_config_directory_is_named_like_one_of_the_project(tmp_path: Path) -> None:
    (tmp_path / "recording").mkdir()
    content = (ROOT / "conf" / "recording" / "ferrari_250lm.yaml").read_text()
    path = re.sub(r"path: .*", f"path: {tmp_path}/mine.csv", content)
    (tmp_path / "recording" / "mine.yaml").write_text(path)
    status, out, err = diagnose("--config-dir", str(tmp_path), "recordings=[mine]", f"hydra.run.dir={tmp_path}/run")
    assert (status, out) == (2, "")
    assert "mine.csv" in err  # which its configuration names, and which is not there
    assert err.count("\n") == 1
    status, _, err = diagnose("--config-dir", str(tmp_path), "recordings=[mime]", f"hydra.run.dir={tmp_path}/run")
    assert status == 2
    assert err.startswith("error: recording: unknown option 'mime'; known: mine, ")
