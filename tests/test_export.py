"""Exported files, read back, hold what was identified and nothing else, with its uncertainty and every caveat."""

import ast
import json
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from cars import PAPER
from hypothesis import given
from hypothesis import strategies as st
from script_runs import run_script
from vehiclemodels.vehicle_parameters import VehicleParameters, setup_vehicle_parameters

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import sha256
from vehicle_sbi.inference.prior import KNOWN
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.record import derive, nominal_record
from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report.export.export import FORMATS, export
from vehicle_sbi.report.export.writing import number, one_line
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.posterior import COLUMNS
from vehicle_sbi.rounding import rounded

VEHICLE: dict[str, Any] = {
    "_target_": "vehicle_sbi.physics.vehicle.Vehicle",
    "name": "paper",
    "m": 1500.0,
    "L": 2.7,
    "l_f": 1.3,
    "h_cog": 0.5,
    "C_alpha_f": 6.0e4,
    "C_alpha_r": 6.0e4,
    "mu": 0.9,
    "R_f": 0.31,
    "steering_ratio": 16.0,
}
# Mean, standard deviation and unit of each parameter; those of UNKNOWN are not identified.
MEANS: dict[str, tuple[float, float, str]] = {
    "l_f": (1.25, 0.02, "m"),
    "h_cog": (0.41, 0.1, "m"),
    "delta_C_alpha_f": (0.1, 0.03, "1e5 N/rad"),
    "delta_C_alpha_r": (0.2, 0.05, "1e5 N/rad"),
    "steering_ratio.gain": (1.05, 0.01, "1"),
    "steering_offset.angle": (0.004, 0.001, "rad"),
    "steering_dead_band.width": (0.01, 0.002, "rad"),
    "steering_delay.time": (0.08, 0.01, "s"),
    "imu_lever_arm.x": (-0.3, 0.05, "m"),
    "imu_misalignment.yaw": (0.02, 0.004, "rad"),
}
UNKNOWN = ("h_cog",)
WARNING = "The last round leaks: only 40% of its density lies inside the prior."
HOSTILE = "car\ncf: 1\r\n\x00\x1b[2J\u2028vehicle: {cf: 2}\n)\nimport os #"


def samples_of(means: Mapping[str, tuple[float, float, str]]) -> pd.DataFrame:
    """Draws whose first two parameters but h_cog hang together."""
    g = np.random.default_rng(0)
    common = g.normal(size=500)
    columns = {name: mean + std * (0.6 * common + 0.8 * g.normal(size=500)) for name, (mean, std, _) in means.items()}
    return pd.DataFrame(columns)


def run_of(
    folder: Path,
    means: Mapping[str, tuple[float, float, str]] = MEANS,
    *,
    unknown: tuple[str, ...] = UNKNOWN,
    complete: bool = True,
    effects: object = None,
    inputs: Mapping[str, str] | None = None,
    lowest: Mapping[str, float] | None = None,
    **vehicle: Any,
) -> pd.DataFrame:
    """A run as its own writer leaves it; returns its table, by parameter."""
    samples = samples_of(means)
    rows = [
        {
            "parameter": name, "unit": unit, "prior_low": (lowest or {}).get(name, -9.0), "prior_high": 9.0,
            "true": np.nan, "mean": samples[name].mean(), "std": samples[name].std(),
            "q05": samples[name].quantile(0.05), "q50": samples[name].median(), "q95": samples[name].quantile(0.95),
            "bound_std": np.inf if name in unknown else 0.1, "contraction": 0.9, "identified": name not in unknown,
        }
        for name, (_, _, unit) in means.items()
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    config = {"vehicle": VEHICLE | vehicle, "effects": effects}
    with RunFolder.open(folder, config=config, overrides=[], inputs=inputs or {}) as run:
        table.to_csv(folder / "table.csv", index=False)
        samples.to_parquet(folder / "samples.parquet")
        run.record(warnings=[WARNING])
        if complete:
            run.complete()
    return table.set_index("parameter")


def numbers(mean: float, std: float, unit: str) -> dict[str, Any]:
    return {"mean": mean, "std": std, "q05": mean - 1.6 * std, "q95": mean + 1.7 * std, "unit": unit}


def diagnosis_of(folder: Path, **changes: Any) -> dict[str, Any]:
    """A diagnosis that names a roll and a delay, and doubts a lag; its C_alpha_r is as wide as its prior."""
    base = {"l_f": (1.33, 0.05, "m"), "C_alpha_f": (1.25e5, 6e3, "N/rad"), "C_alpha_r": (1.2e5, 8e4, "N/rad")}
    sizes = {
        "body_roll.gradient": numbers(0.006, 0.001, "rad/(m/s^2)"),
        "steering_delay.time": numbers(0.05, 0.01, "s"),
    }
    doubted = {"steering_lag.time": numbers(0.02, 0.02, "s")}
    effects = ["body_roll", "steering_delay"]
    verdict: dict[str, Any] = {
        "headline": "Missing: body roll (0.95), steering delay (0.97).",
        "explanations": [
            {"effects": effects, "probability": 0.7, "parameters": sizes},
            {"effects": [*effects, "steering_lag"], "probability": 0.1, "parameters": sizes | doubted},
        ],
        "effects": {"body_roll": 0.95, "steering_delay": 0.97, "steering_lag": 0.1},
        "p_unknown": 0.62,
        "unknown": None,
        "indistinguishable": [["steering_delay", "sensor_delay"]],
        "fit": {"accepted": False, "accepted_because": "it gains nothing there"},
        "base_parameters": {
            name: {"before": {}, "after": numbers(*of), "unit": of[2]} for name, of in base.items()
        },
        "warnings": ["l_f: the base model fits best at 1 m, a bound of its prior: a mismatch may hide there."],
    } | changes  # fmt: skip
    assert set(verdict) <= {field.name for field in fields(Verdict)}
    prior = {"l_f": [1.0, 1.6], "C_alpha_f": [5e4, 3e5], "C_alpha_r": [5e4, 3e5]}
    with RunFolder.open(folder, config={"vehicle": VEHICLE, "prior": prior}, overrides=[], inputs={}) as run:
        (folder / "verdict.json").write_text(json.dumps(verdict))
        (folder / "extended.yaml").write_text(yaml.safe_dump({"prior": prior | {"steering_delay": {"time": [0, 0.5]}}}))
        run.complete()
    return verdict


def texts(folder: Path, format: str) -> dict[str, str]:
    return {path.name: path.read_text() for path in export(folder, format).files}


def parameters(text: str) -> dict[str, Any]:
    return yaml.safe_load(text)["/**"]["ros__parameters"]


def specs(text: str) -> dict[str, float]:
    """The keywords of the one call in a file that builds CarSpecs."""
    (call,) = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    return {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords}


def comments(text: str) -> str:
    """What is said in a file, on one line."""
    return " ".join(" ".join(line.partition("#")[2].strip(" -") for line in text.splitlines()).split())


def line_of(text: str, key: str) -> str:
    (found,) = [line for line in text.splitlines() if line.strip().startswith(key)]
    return found


def shown(value: float, std: float) -> Any:
    """A value as files have it: to the third digit of its standard deviation."""
    return pytest.approx(value, abs=0.0051 * std)


def test_autoware_gets_axle_stiffnesses_and_wheel_loads(tmp_path: Path) -> None:
    """mass_fl = m l_r / (2 L) gives Autoware's l_f = L (mass_rl + mass_rr) / m back."""
    table = run_of(tmp_path)
    text = texts(tmp_path, "autoware")["mpc.param.yaml"]
    vehicle = parameters(text)["vehicle"]
    mean, std = table["mean"], table["std"]
    for key, name in (("cf", "delta_C_alpha_f"), ("cr", "delta_C_alpha_r")):
        assert vehicle[key] == shown(6e4 + 1e5 * mean[name], 1e5 * std[name])
    loads = [vehicle[f"mass_{wheel}"] for wheel in ("fl", "fr", "rl", "rr")]
    assert sum(loads) == shown(1500.0, 4 * 0.5 * 1500.0 / 2.7 * std["l_f"])
    assert 2.7 * (loads[2] + loads[3]) / 1500.0 == shown(mean["l_f"], std["l_f"])
    assert parameters(text)["input_delay"] == shown(mean["steering_delay.time"], std["steering_delay.time"])
    std = 1e5 * std["delta_C_alpha_f"]
    assert f"N/rad; std {rounded(std, std)};" in line_of(text, "cf:")
    assert "AXLE value" in line_of(text, "cf:")
    assert "WARNING: cf and cr are AXLE values" in comments(text)
    assert "with m, L STATED" in line_of(text, "mass_fl:")


def test_autowares_simulator_has_the_signs_of_its_own_code(tmp_path: Path) -> None:
    """It reports its angle plus steer_bias, ours adds the offset to the reported one; its dead band has one side."""
    table = run_of(tmp_path)
    mean, std = table["mean"], table["std"]
    found = parameters(texts(tmp_path, "autoware")["simulator_model.param.yaml"])
    assert found["steer_bias"] == shown(-mean["steering_offset.angle"], std["steering_offset.angle"])
    assert found["steer_dead_band"] == shown(
        0.5 * mean["steering_dead_band.width"], 0.5 * std["steering_dead_band.width"]
    )
    assert found["steer_time_delay"] == shown(mean["steering_delay.time"], std["steering_delay.time"])
    assert found["debug_steer_scaling_factor"] == shown(mean["steering_ratio.gain"], std["steering_ratio.gain"])
    assert set(found) == {"steer_bias", "steer_dead_band", "steer_time_delay", "debug_steer_scaling_factor"}


def test_the_imus_place_is_in_base_link_with_the_samples_own_uncertainty(tmp_path: Path) -> None:
    """x = L - l_f + arm is linear, so its standard deviation is that of the samples to rounding."""
    table, samples = run_of(tmp_path), samples_of(MEANS)
    text = texts(tmp_path, "autoware")["sensors_calibration.yaml"]
    pose = yaml.safe_load(text)["base_link"]["tamagawa/imu_link"]
    std = (samples["imu_lever_arm.x"] - samples["l_f"]).std()
    assert pose["x"] == shown(2.7 - table["mean"]["l_f"] + table["mean"]["imu_lever_arm.x"], std)
    assert pose["yaw"] == shown(table["mean"]["imu_misalignment.yaw"], table["std"]["imu_misalignment.yaw"])
    assert set(pose) == {"x", "yaw"}
    assert f"std {rounded(std, std)};" in line_of(text, "x:")


def test_a_stated_place_of_the_imu_moves_with_its_lever_arm(tmp_path: Path) -> None:
    table = run_of(tmp_path, imu_x=1.2)
    text = texts(tmp_path, "autoware")["sensors_calibration.yaml"]
    pose = yaml.safe_load(text)["base_link"]["tamagawa/imu_link"]
    assert pose["x"] == shown(1.2 + table["mean"]["imu_lever_arm.x"], table["std"]["imu_lever_arm.x"])


@pytest.mark.parametrize("format", ["autoware", "commonroad", "openpilot"])
def test_what_was_not_identified_is_a_comment(tmp_path: Path, format: str) -> None:
    run_of(tmp_path)
    for name, text in texts(tmp_path, format).items():
        assert "h_cog: not identified from these recordings" in comments(text), name
        assert "h_cg:" not in text, name


def test_what_the_run_has_not_learned_is_said_so(tmp_path: Path) -> None:
    run_of(tmp_path)
    table = pd.read_csv(tmp_path / "table.csv")
    table.loc[table["parameter"] == "steering_delay.time", "identified"] = False  # its bound is far below its prior
    table.to_csv(tmp_path / "table.csv", index=False)
    manifests.write(tmp_path, manifests.read(tmp_path) | {"files": {}})
    text = comments(texts(tmp_path, "autoware")["mpc.param.yaml"])
    assert "steering_delay.time: not learned by this run" in text
    assert "steering_delay.time: not identified" not in text


def test_a_file_of_stated_values_alone_is_not_written_but_named(tmp_path: Path) -> None:
    run_of(tmp_path)
    found = export(tmp_path, "autoware")
    assert found.left_out == ("vehicle_info.param.yaml",)  # the vehicle's file states wheelbase and radius
    assert set(found.left_out).isdisjoint(path.name for path in found.files)
    assert not (tmp_path / "export" / "autoware" / "vehicle_info.param.yaml").exists()
    assert export(tmp_path, "json").left_out == ()


def test_without_one_axle_there_is_no_value_that_needs_both(tmp_path: Path) -> None:
    run_of(tmp_path, unknown=("h_cog", "delta_C_alpha_r"))
    assert "cr" not in parameters(texts(tmp_path, "autoware")["mpc.param.yaml"])["vehicle"]
    assert "tireStiffnessFactor" not in specs(texts(tmp_path, "openpilot")["car_specs.py"])
    assert yaml.safe_load(texts(tmp_path, "commonroad")["parameters_tire.yaml"])["tire"] == {"p_dy1": 0.9}


def test_openpilot_gets_one_factor_that_keeps_the_product_of_the_stiffnesses(tmp_path: Path) -> None:
    """opendbc's scale_tire_stiffness, run on what was exported, with the cargo that its interface adds."""
    table = run_of(tmp_path)
    mean, std = table["mean"], table["std"]
    text = texts(tmp_path, "openpilot")["car_specs.py"]
    found = specs(text)
    assert found["mass"] + 136.0 == pytest.approx(1500.0)
    assert found["wheelbase"] == 2.7
    gain = mean["steering_ratio.gain"]
    assert found["steerRatio"] == shown(16.0 / gain, 16.0 / gain**2 * std["steering_ratio.gain"])
    assert found["centerToFrontRatio"] == shown(mean["l_f"] / 2.7, std["l_f"] / 2.7)
    share, mass, factor = found["centerToFrontRatio"], found["mass"] + 136.0, found["tireStiffnessFactor"]
    front = 192150 * factor * mass / 1462 * (1 - share) / 0.6
    rear = 202500 * factor * mass / 1462 * share / 0.4
    stiffnesses = [6e4 + 1e5 * mean[f"delta_C_alpha_{axle}"] for axle in "fr"]
    assert front * rear == pytest.approx(np.prod(stiffnesses), rel=0.0051 * 0.1)  # uncertain by a tenth
    assert "ONE stiffness factor for both axles" in comments(text)


def test_commonroad_reads_its_folder_and_keeps_the_sum_of_the_stiffnesses(tmp_path: Path) -> None:
    """vehicle_dynamics_st: an axle has the stiffness mu C_S F_z with C_S = -p_ky1 / p_dy1 and mu = p_dy1."""
    table = run_of(tmp_path)
    mean, std = table["mean"], table["std"]
    files = export(tmp_path, "commonroad").files
    read = setup_vehicle_parameters(vehicle_id=5, dir_params=files[0].parent)  # pyright: ignore[reportArgumentType]
    assert isinstance(read, VehicleParameters)
    assert (read.m, read.h_cg) == (1500.0, None)
    assert read.a == shown(mean["l_f"], std["l_f"])
    assert read.b == shown(2.7 - mean["l_f"], std["l_f"])
    p_ky1, p_dy1 = read.tire.p_ky1, read.tire.p_dy1
    assert p_ky1 is not None
    assert p_dy1 is not None
    total = p_dy1 * (-p_ky1 / p_dy1) * 1500.0 * GRAVITY
    together = 1e5 * (std["delta_C_alpha_f"] + std["delta_C_alpha_r"])  # at most
    assert total == shown(1.2e5 + 1e5 * (mean["delta_C_alpha_f"] + mean["delta_C_alpha_r"]), together)
    assert "ONE stiffness coefficient for both axles" in comments(files[1].read_text())
    assert "STATED, not identified" in line_of(files[0].read_text(), "m:")


def test_json_has_all_that_was_identified(tmp_path: Path) -> None:
    table = run_of(tmp_path)
    found = json.loads(texts(tmp_path, "json")["parameters.json"])
    assert set(found["parameters"]) == set(MEANS) - set(UNKNOWN)
    for name, one in found["parameters"].items():
        assert one == {key: table[key][name] for key in ("mean", "std", "q05", "q95", "unit")}
    assert found["not_identified"] == ["h_cog"]
    assert "h_cog" not in {**found["stated"], **found["constants"]}
    assert found["constants"]["C_alpha_f"]["unit"] == "N/rad"
    assert found["constants"]["C_alpha_f"]["std"] == pytest.approx(1e5 * table["std"]["delta_C_alpha_f"])


@pytest.mark.parametrize("format", FORMATS)
def test_every_file_repeats_the_caveats(tmp_path: Path, format: str) -> None:
    run_of(tmp_path / "run")
    diagnosis_of(tmp_path / "diagnosis")
    said = {
        "run": [WARNING, "This run did not look for physics that its model lacks."],
        "diagnosis": [
            "Missing: body roll (0.95), steering delay (0.97).",
            "NOT accepted: it gains nothing there",
            "hardly tell apart steering_delay and sensor_delay",
            "l_f: the base model fits best at 1 m, a bound of its prior",
        ],
    }
    for kind, lines in said.items():
        for text in texts(tmp_path / kind, format).values():
            whole = text if format == "json" else comments(text)
            assert [line for line in lines if line not in whole] == []


def test_a_diagnosis_gives_its_averaged_parameters_and_the_effects_it_names(tmp_path: Path) -> None:
    diagnosis_of(tmp_path)
    mpc = texts(tmp_path, "autoware")["mpc.param.yaml"]
    found = parameters(mpc)
    assert found["vehicle"]["cf"] == 1.25e5
    assert found["input_delay"] == 0.05
    assert "cr" not in found["vehicle"]
    assert "vehicle_model_steer_tau" not in found
    assert "steering_lag.time: not found to be missing (probability 0.10)" in comments(mpc)
    assert "C_alpha_r: not identified from these recordings" in comments(mpc)
    assert "body_roll.gradient = 0.0060 ± 0.0010 rad/(m/s^2): identified, no key here takes it" in comments(mpc)
    everything = json.loads(texts(tmp_path, "json")["parameters.json"])["parameters"]
    assert set(everything) == {"l_f", "C_alpha_f", "body_roll.gradient", "steering_delay.time"}
    assert everything["body_roll.gradient"] == numbers(0.006, 0.001, "rad/(m/s^2)") | {"probability": 0.95}


@pytest.mark.parametrize(("part", "known"), [(0.80, False), (0.72, False), (0.70, True), (0.3, True)])
def test_a_base_parameter_whose_posterior_is_its_prior_is_not_exported(
    tmp_path: Path, part: float, known: bool
) -> None:
    """Within its box a normal prior of the box's spread, which is what a diagnosis has, is 0.81 times as wide as it."""
    base = {"l_f": numbers(1.3, part * 0.6 / 12.0**0.5, "m"), "C_alpha_f": numbers(1.25e5, 6e3, "N/rad")}
    diagnosis_of(tmp_path, base_parameters={name: {"after": e, "unit": e["unit"]} for name, e in base.items()})
    found = json.loads(texts(tmp_path, "json")["parameters.json"])
    assert ("l_f" in found["parameters"], "l_f" in found["not_identified"]) == (known, not known)


def test_a_named_stiffness_level_scales_the_axles(tmp_path: Path) -> None:
    table = run_of(tmp_path, MEANS | {"stiffness_level.factor": (0.8, 0.05, "1")})
    whole = json.loads(texts(tmp_path, "json")["parameters.json"])
    found = {name: one["mean"] for name, one in whole["parameters"].items()}
    cf = parameters(texts(tmp_path, "autoware")["mpc.param.yaml"])["vehicle"]["cf"]
    stiffness, level = 6e4 + 1e5 * found["delta_C_alpha_f"], found["stiffness_level.factor"]
    std = np.hypot(1e5 * table["std"]["delta_C_alpha_f"] * level, stiffness * table["std"]["stiffness_level.factor"])
    assert cf == shown(stiffness * level, std)
    assert whole["constants"]["C_alpha_f"]["from"] == ["delta_C_alpha_f", "stiffness_level.factor"]


LOAD: dict[str, tuple[float, float, str]] = {"payload.mass": (300.0, 15.0, "kg"), "payload.x": (-1.2, 0.1, "m")}


def loaded(theta: pd.DataFrame, I_z: float | None) -> tuple[np.ndarray, ...]:
    """m [kg], l_f [m] and I_z [kg m^2] of the model's own record, for draws of l_f and of a payload."""
    space = ParameterSpace(tuple(KNOWN[str(name)] for name in theta))
    records = space.records(theta.to_numpy(), nominal_record(replace(PAPER, I_z=I_z)))
    for record in records:
        derive(record)
    return records["mass"], records["l_front"], records["I_z"]


@pytest.mark.parametrize("I_z", [None, 2000.0])
def test_a_payload_is_in_the_car_of_every_format_as_the_model_has_it(tmp_path: Path, I_z: float | None) -> None:
    """Means are those of the model's own record, and deviations those of the samples to first order."""
    run_of(tmp_path, MEANS | LOAD, I_z=I_z, m_s=1350.0)
    names = ("l_f", *LOAD)
    samples = samples_of(MEANS | LOAD)[[*names]]
    (m,), (l_f,), (own,) = loaded(samples.mean().to_frame().T, I_z)
    deviations = [np.std(draws) for draws in loaded(samples, I_z)]
    found = json.loads(texts(tmp_path, "json")["parameters.json"])
    for name, mean, std in zip(("m", "l_f", "I_z"), (m, l_f, own), deviations, strict=True):
        constant = found["constants"][name]
        assert constant["mean"] == pytest.approx(mean)
        assert constant["std"] == pytest.approx(std, rel=0.05)
        assert constant["note"] == "the payload of the drive is in it"
    assert "note" not in found["constants"]["C_alpha_f"]
    mpc = texts(tmp_path, "autoware")["mpc.param.yaml"]
    loads = parameters(mpc)["vehicle"]
    assert 2.0 * loads["mass_fl"] == pytest.approx(m * (2.7 - l_f) / 2.7, rel=1e-3)
    assert 2.0 * loads["mass_rl"] == pytest.approx(m * l_f / 2.7, rel=1e-3)
    code = texts(tmp_path, "openpilot")["car_specs.py"]
    assert specs(code)["mass"] + 136.0 == pytest.approx(m, rel=1e-3)
    assert specs(code)["centerToFrontRatio"] == pytest.approx(l_f / 2.7, rel=1e-3)
    body = texts(tmp_path, "commonroad")["parameters_vehicle5.yaml"]
    read = yaml.safe_load(body)
    assert (read["m"], read["a"], read["I_z"]) == pytest.approx((m, l_f, own), rel=1e-3)
    assert read["m"] - read["m_s"] == pytest.approx(150.0, rel=1e-3)  # all of the payload is sprung
    lines = [line_of(mpc, "mass_fl:"), line_of(code, "mass="), *(line_of(body, f"{key}:") for key in ("m", "a", "I_z"))]
    assert [line for line in lines if "the payload of the drive is in it" not in line] == []


def test_a_payload_whose_place_is_not_identified_leaves_out_what_needs_it(tmp_path: Path) -> None:
    run_of(tmp_path, MEANS | LOAD, unknown=("h_cog", "payload.x"))
    body = texts(tmp_path, "commonroad")["parameters_vehicle5.yaml"]
    assert {"m", "a", "I_z"} & set(yaml.safe_load(body)) == {"m"}
    assert "a left out: payload.x: not identified" in comments(body)


def test_the_payload_of_a_diagnosis_holds_if_it_is_there(tmp_path: Path) -> None:
    sizes = {name: numbers(*of) for name, of in LOAD.items()}
    explanation = {"effects": ["payload"], "probability": 0.7, "parameters": sizes}
    diagnosis_of(tmp_path, explanations=[explanation], effects={"payload": 0.97})
    line = line_of(texts(tmp_path, "commonroad")["parameters_vehicle5.yaml"], "m:")
    assert yaml.safe_load(line) == {"m": 1800.0}
    assert "if payload is missing (0.97)" in line


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


@pytest.mark.parametrize(
    ("std", "probability", "there"),
    [(0.001, 0.97, True), (0.001, 0.94, False), (0.03, 0.97, False), (0.03, 0.56, False)],
)
def test_a_delay_that_may_be_none_is_a_comment_and_no_value(
    tmp_path: Path, std: float, probability: float, there: bool
) -> None:
    sizes = {"steering_delay.time": numbers(0.02, std, "s")}
    explanation = {"effects": ["steering_delay"], "probability": 0.7, "parameters": sizes}
    diagnosis_of(tmp_path, explanations=[explanation], effects={"steering_delay": probability})
    mpc = texts(tmp_path, "autoware")["mpc.param.yaml"]
    everything = json.loads(texts(tmp_path, "json")["parameters.json"])
    assert ("input_delay" in parameters(mpc)) == ("steering_delay.time" in everything["parameters"]) == there
    assert "EDGE" not in mpc.partition("/**")[2]
    reason = f"compatible with no effect; it would be 0.02.* s if steering_delay is missing ({probability:.2f})"
    said = [comments(mpc), everything["why_not_identified"].get("steering_delay.time", "")]
    pattern = reason.replace("(", r"\(").replace(")", r"\)")
    assert [bool(re.search(pattern, text)) for text in said] == [not there] * 2


def test_a_delay_of_a_run_that_may_be_none_is_no_value(tmp_path: Path) -> None:
    run_of(tmp_path, MEANS | {"steering_delay.time": (0.02, 0.03, "s")}, lowest={"steering_delay.time": 0.0})
    mpc = texts(tmp_path, "autoware")["mpc.param.yaml"]
    assert "input_delay" not in parameters(mpc)
    assert "steering_delay.time: compatible with no effect; it would be 0.0" in comments(mpc)


def test_a_size_that_is_there_only_if_its_effect_is_missing_says_how_probable_that_is(tmp_path: Path) -> None:
    diagnosis_of(tmp_path, effects={"body_roll": 1.0, "steering_delay": 0.97, "steering_lag": 0.1})
    text = texts(tmp_path, "autoware")["mpc.param.yaml"]
    assert "if steering_delay is missing (0.97)" in line_of(text, "input_delay:")
    assert "if body_roll is missing" not in text  # it is certain
    assert "if" not in line_of(text, "cf:").split()


def test_parameters_that_a_run_hardly_tells_apart_are_a_caveat(tmp_path: Path) -> None:
    run_of(tmp_path)
    samples, pair = samples_of(MEANS), ("steering_delay.time", "imu_lever_arm.x")
    samples["imu_lever_arm.x"] = -samples["l_f"]
    samples.to_parquet(tmp_path / "samples.parquet")
    manifest = manifests.read(tmp_path)
    told = {"confusable": [["l_f", "h_cog", 0.99], [*pair, -0.97]]}  # h_cog is not identified
    manifests.write(tmp_path, manifest | {"files": {}, "facts": manifest["facts"] | told})
    (said,) = [line for line in export(tmp_path, "json").caveats if line.startswith("Hardly told apart")]
    assert "l_f and imu_lever_arm.x (-1.00), steering_delay.time and imu_lever_arm.x (-0.97)" in said
    assert "h_cog" not in said


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ([], "This run did not look for physics that its model lacks."),
        (["body_roll", "relaxation"], "This run took body_roll and relaxation for all that is missing."),
        ("plausible", "This run drew whatever physics may be missing from the effect prior"),
    ],
)
def test_a_run_says_what_it_took_to_be_missing(tmp_path: Path, effects: object, said: str) -> None:
    run_of(tmp_path, effects=effects)
    assert said in comments(texts(tmp_path, "autoware")["mpc.param.yaml"])


def test_what_no_effect_stands_for_is_told_as_a_size(tmp_path: Path) -> None:
    law = {"target": "force along y", "size": numbers(210.0, 20.0, "N")}
    diagnosis_of(tmp_path / "diagnosis", unknown={"laws": [law], "beyond_prior": []})
    text = texts(tmp_path / "diagnosis", "autoware")["mpc.param.yaml"]
    assert "No known effect explains: force along y of 2.1e+02 N (root mean square)." in comments(text)
