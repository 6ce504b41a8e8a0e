"""Runs and diagnoses to export, and what is read back from the files; shared by the tests of exports."""

import ast
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.report.export.export import export
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.tables.posterior import COLUMNS

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


LOAD: dict[str, tuple[float, float, str]] = {"payload.mass": (300.0, 15.0, "kg"), "payload.x": (-1.2, 0.1, "m")}
