"""What cannot be exported, or has changed, is one line and no file; nothing breaks out of a comment."""

import ast
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from exports import HOSTILE, MEANS, WARNING, comments, line_of, parameters, run_of, specs, texts
from hypothesis import given
from hypothesis import strategies as st
from script_runs import run_script

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import sha256
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report.export.export import FORMATS, export
from vehicle_sbi.report.export.writing import number, one_line


@pytest.mark.parametrize("format", FORMATS)
def test_a_name_cannot_break_out_of_its_comment(tmp_path: Path, format: str) -> None:
    run_of(tmp_path / "plain")
    run_of(tmp_path / "hostile", name=HOSTILE)
    read = {"openpilot": specs, "json": lambda text: json.loads(text)["parameters"]}.get(format, yaml.safe_load)
    plain, hostile = texts(tmp_path / "plain", format), texts(tmp_path / "hostile", format)
    assert {name: read(text) for name, text in plain.items()} == {name: read(text) for name, text in hostile.items()}


@given(st.text())
def test_a_comment_is_one_line_that_yaml_reads_as_nothing(text: str) -> None:
    said = f"# {one_line(text)}"
    assert len(said.splitlines()) == 1
    assert yaml.safe_load(said) is None


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_keeps_every_digit_in_yaml_json_and_python(value: float) -> None:
    text = number(value)
    assert yaml.safe_load(text) == json.loads(text) == ast.literal_eval(text) == value
    assert isinstance(yaml.safe_load(text), float)


def test_a_car_whose_file_has_gone_is_exported_without_its_constants(tmp_path: Path) -> None:
    gone: dict[str, Any] = {"_target_": "vehicle_sbi.physics.vehicle.read", "path": str(tmp_path / "gone.yaml")}
    run_of(tmp_path, **gone)
    text = texts(tmp_path, "autoware")["mpc.param.yaml"]
    assert set(parameters(text)) == {"input_delay"}
    assert "Constants of the vehicle are not known" in comments(text)
    assert "delta_C_alpha_f: an offset from a nominal C_alpha_f that is not known" in comments(text)


@pytest.mark.parametrize("format", FORMATS)
def test_constants_of_a_vehicle_file_that_has_changed_are_not_those_of_the_run(tmp_path: Path, format: str) -> None:
    file = tmp_path / "car.yaml"
    file.write_text("m: 1500\nL: 2.7\nC_alpha_f: 60000\nC_alpha_r: 60000\n")
    target: dict[str, Any] = {"_target_": "vehicle_sbi.physics.vehicle.read", "path": str(file)}
    run_of(tmp_path / "run", inputs={str(file): sha256(file)}, **target)
    assert texts(tmp_path / "run", format)
    file.write_text(file.read_text().replace("1500", "1700"))
    with pytest.raises(InputError, match=rf"^{file} has changed since this run, .* repeat the run$"):
        export(tmp_path / "run", format)


@pytest.mark.parametrize(
    ("means", "settings", "format", "message"),
    [
        (MEANS, {}, "autoware2", "unknown format 'autoware2'; known: autoware, commonroad, json, openpilot"),
        (MEANS, {"complete": False}, "autoware", "has not finished"),
        (MEANS, {"unknown": tuple(MEANS)}, "json", "none of its parameters was identified"),
        ({"h_cog": MEANS["h_cog"]}, {"unknown": ()}, "autoware", "autoware has no key for what was identified"),
    ],
)
def test_what_cannot_be_exported_says_why_and_writes_nothing(
    tmp_path: Path, means: dict, settings: dict, format: str, message: str
) -> None:
    run_of(tmp_path, means, **settings)
    with pytest.raises(InputError, match=message):
        export(tmp_path, format)
    assert not (tmp_path / "export").exists()


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("table.csv", None, "neither a run"),
        ("table.csv", "a,b\n1,2\n", "column parameter, unit"),
        ("table.csv", "", "not a table"),
        ("samples.parquet", "nonsense", "not a Parquet file"),
        ("verdict.json", "nonsense", "not the verdict of a diagnosis"),
        ("verdict.json", "{}", "not the verdict of a diagnosis"),
        ("manifest.json", None, "is not a run folder"),
    ],
)
def test_a_damaged_folder_is_one_line(tmp_path: Path, file: str, content: str | None, message: str) -> None:
    run_of(tmp_path)
    manifests.write(tmp_path, manifests.read(tmp_path) | {"files": {}})  # as if it had been left like that
    if content is None:
        (tmp_path / file).unlink()
    else:
        (tmp_path / file).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        export(tmp_path, "autoware")
    assert "\n" not in str(caught.value)


def test_a_file_that_changed_after_the_run_is_not_exported(tmp_path: Path) -> None:
    run_of(tmp_path)
    (tmp_path / "samples.parquet").write_bytes((tmp_path / "samples.parquet").read_bytes() + b"x")
    with pytest.raises(InputError, match=r"samples.parquet is damaged or missing"):
        export(tmp_path, "autoware")


def script(*arguments: str) -> tuple[int, str, str]:
    return run_script("export", *arguments)


@pytest.mark.slow
def test_the_script_prints_paths_and_caveats(tmp_path: Path) -> None:
    run_of(tmp_path / "run")
    status, out, err = script(f"run={tmp_path}/run", "format=commonroad", f"to={tmp_path}/there")
    assert status == 0, err
    assert f"{tmp_path}/there/parameters_tire.yaml" in out
    assert WARNING in out
    assert sorted(path.name for path in (tmp_path / "there").iterdir()) == [
        "parameters_tire.yaml", "parameters_vehicle5.yaml",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "run"),
        (("run=nowhere",), "nowhere is not a run folder"),
        (("run=nowhere", "format=urdf"), "unknown format 'urdf'; known: "),
    ],
)
def test_the_script_refuses_in_one_line(arguments: tuple[str, ...], said: str) -> None:
    status, out, err = script(*arguments)
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1
    assert said in err


def test_a_value_on_the_edge_of_its_prior_is_said_to_be_a_limit(tmp_path: Path) -> None:
    run_of(tmp_path / "run", MEANS | {"steering_delay.time": (8.5, 0.01, "s")})  # priors end at 9
    text = texts(tmp_path / "run", "autoware")["mpc.param.yaml"]
    assert "ON THE EDGE OF ITS PRIOR: steering_delay.time" in line_of(text, "input_delay:")
    assert "EDGE" not in line_of(text, "cf:")
