"""What a diagnosis or a run with effects exports: averaged parameters, the effects it names, a payload in the car."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from cars import PAPER
from exports import (
    LOAD,
    MEANS,
    comments,
    diagnosis_of,
    line_of,
    numbers,
    parameters,
    run_of,
    samples_of,
    shown,
    specs,
    texts,
)

from vehicle_sbi.inference.prior import KNOWN
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.record import derive, nominal_record
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report.export.export import export


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
