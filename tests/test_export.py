"""Exported files, read back, hold what was identified and nothing else, with its uncertainty and every caveat."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from exports import (
    MEANS,
    UNKNOWN,
    WARNING,
    comments,
    diagnosis_of,
    line_of,
    parameters,
    run_of,
    samples_of,
    shown,
    specs,
    texts,
)
from vehiclemodels.vehicle_parameters import VehicleParameters, setup_vehicle_parameters

from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report.export.export import FORMATS, export
from vehicle_sbi.rounding import rounded


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
