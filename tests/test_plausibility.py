"""What a recording contradicts is said, and nothing of a plausible one: signs, units, offsets, absurd samples."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.plausibility import LIMITS, absurd, findings
from vehicle_sbi.data.readers import read
from vehicle_sbi.data.recording import Recording

RATE, RATIO = 50.0, 16.0
RECORDINGS = Path(os.environ.get("VEHICLE_SBI_RECORDINGS", ROOT.parent / "shared/recordings"))


def drive(*, lively: float = 1.0, noise: float = 1.0) -> dict[str, np.ndarray]:
    """Forty seconds of a car that rolls without slip, from rest and back, with noise of usual sensors."""
    t, rng = np.arange(2000) / RATE, np.random.default_rng(0)
    v = 15.0 * np.clip(np.minimum(t - 3.0, 37.0 - t) / 8.0, 0.0, 1.0) + lively * np.sin(0.6 * t) * ((t > 12) & (t < 28))
    steering = 0.03 * lively * np.sin(0.8 * t)
    yaw_rate = v * steering / 2.7
    quiet = {"steering": steering, "steering_wheel": RATIO * steering, "v_x": v, "yaw_rate": yaw_rate}
    quiet |= {"a_x": np.gradient(v, t), "a_y": 1.1 * v * yaw_rate}  # a body that leans adds a tenth
    std = {"steering": 1e-4, "steering_wheel": 1e-3, "v_x": 0.03, "yaw_rate": 0.004, "a_x": 0.15, "a_y": 0.15}
    return {name: x + noise * std[name] * rng.normal(size=len(t)) for name, x in quiet.items()}


def recording(channels: Mapping[str, np.ndarray]) -> Recording:
    t = np.arange(len(channels["a_y"])) / RATE
    valid = {name: np.isfinite(x) for name, x in channels.items()}
    return Recording(
        name="a", rate=RATE, t=t, channels=channels, valid=valid, groups={}, source="a.csv", sha256=""
    )  # fmt: skip


@pytest.mark.parametrize("lively", [0.0, 0.02, 0.2, 1.0])
@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_a_plausible_drive_contradicts_nothing(lively: float, noise: float) -> None:
    assert findings(recording(drive(lively=lively, noise=noise))) == ()


@pytest.mark.parametrize(
    ("changed", "factor", "offset", "said"),
    [
        ("a_y", -1.0, 0.0, "a_y has the opposite sign of v_x times yaw rate"),
        ("a_x", -1.0, 0.0, "a_x has the opposite sign of dv_x/dt"),
        ("steering", -1.0, 0.0, "steering has the opposite sign of the yaw rate"),
        ("a_y", 1.0 / 9.81, 0.0, "it seems to be in g, not m/s^2"),
        ("a_x", 1.0 / 9.81, 0.0, "it seems to be in g, not m/s^2"),
        ("yaw_rate", np.degrees(1.0), 0.0, "the yaw rate seems to be in deg/s"),
        ("v_x", 3.6, 0.0, "v_x seems to be in km/h"),
        ("a_y", 6.0, 0.0, "a unit or a calibration is wrong"),
        ("yaw_rate", 1.0, 0.02, "rad/s while the car stands: an offset"),
        ("a_x", 1.0, 0.5, "m/s² while the car stands: gravity (a slope"),
        ("steering_wheel", np.degrees(1.0), 0.0, "steering_wheel is beyond 25 rad"),
    ],
)
def test_each_fault_is_said_in_one_sentence(changed: str, factor: float, offset: float, said: str) -> None:
    healthy = drive()
    faulty = healthy | {changed: factor * healthy[changed] + offset}
    found = findings(recording(faulty))
    assert any(said in line for line in found), found
    assert all(len(line.split()) <= 25 for line in found)


def test_swapped_axes_of_an_accelerometer_are_said() -> None:
    healthy = drive()
    found = findings(recording(healthy | {"a_x": healthy["a_y"], "a_y": healthy["a_x"]}))
    assert any("a_x follows v_x times yaw rate" in line and "axes seem swapped" in line for line in found), found


@pytest.mark.parametrize(("flipped", "lines"), [("a_y", 1), ("a_x", 1), ("yaw_rate", 2), (None, 0)])
def test_wheel_speeds_tell_signs_where_no_speed_is_recorded(flipped: str | None, lines: int) -> None:
    series = drive()
    v_x = series.pop("v_x")
    wheels = {f"wheel_speed_{at}": v_x / 0.31 for at in ("fl", "fr", "rl", "rr")}
    faulty = series | ({flipped: -series[flipped]} if flipped else {}) | wheels
    found = findings(recording(faulty))
    assert sum("the opposite sign" in line for line in found) == lines == len(found), found


def test_a_flipped_yaw_rate_shows_against_both_that_follow_it() -> None:
    healthy = drive()
    found = findings(recording(healthy | {"yaw_rate": -healthy["yaw_rate"]}))
    assert len(found) == 2


@pytest.mark.parametrize("length", [1, 2, 5, 25])
def test_a_run_of_absurd_samples_is_found_and_nothing_else(length: int) -> None:
    clean = drive()["steering_wheel"]
    wrong = np.zeros(len(clean), dtype=bool)
    wrong[600 : 600 + length] = True
    beyond, runs = absurd("steering_wheel", np.where(wrong, np.radians(8116.0), clean), RATE)
    assert np.array_equal(beyond, wrong)
    assert not runs.any()
    beyond, runs = absurd("steering_wheel", np.where(wrong, 12.0, clean), RATE)  # possible, but not so suddenly
    assert not beyond.any()
    assert np.array_equal(runs, wrong)


@pytest.mark.parametrize(("length", "low", "high"), [(35, 40.0, 40.0), (10, -90.0, 90.0)])
def test_absurd_samples_are_one_run_though_they_last_or_jump_about(length: int, low: float, high: float) -> None:
    clean = drive()["a_y"]
    wrong = np.zeros(len(clean), dtype=bool)
    wrong[600 : 600 + length] = True
    jumping = np.where(np.arange(len(clean)) % 2, high, low)
    assert np.array_equal(absurd("a_y", np.where(wrong, jumping, clean), RATE)[1], wrong)


def test_steps_and_slow_pulses_are_no_runs() -> None:
    rng = np.random.default_rng(1)
    noise = 0.01 * rng.normal(size=2000)
    step = np.where(np.arange(2000) > 900, 1.0, 0.0) + noise
    held = np.where((np.arange(2000) > 900) & (np.arange(2000) < 1000), 1.0, 0.0) + noise  # two seconds
    pulses = np.where(np.arange(2000) % 100 < 20, 1.0, 0.0) + noise  # two fifths of a second, every two
    for values in (step, held, pulses, np.sin(np.arange(2000) / 10.0), noise):
        assert not np.any(absurd("a_y", values, RATE))
    assert not np.any(absurd("torque_front", np.where((step > 0.5) & (np.arange(2000) < 905), 800.0, 0.0), RATE))


def test_limits_are_those_of_channels() -> None:
    assert LIMITS.keys() <= CHANNELS.keys()


def test_absurd_runs_are_left_out_and_listed_as_a_file_is_read(tmp_path: Path) -> None:
    series = drive()
    series["steering_wheel"][600:605] = np.radians(8116.0)
    columns = {CHANNELS[name].column: x for name, x in series.items()}
    pd.DataFrame({"time_s": np.arange(2000) / RATE} | columns).to_csv(tmp_path / "a.csv", index=False)
    found = read(tmp_path / "a.csv")
    assert any("steering_wheel: 5 samples from 12.00 s left out: beyond 25 rad" in note for note in found.notes)
    assert not found.valid["steering_wheel"][600:605].any()
    assert found.warnings == ()
    assert findings(replace(found, channels=dict(found.channels) | {"a_y": -found.channels["a_y"]})) != ()
