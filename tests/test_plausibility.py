"""What a recording contradicts is said, and nothing of a plausible one: signs, units, offsets, absurd samples."""

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from cars import PAPER, finished, record_of
from conftest import ROOT

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.checks.limits import refuse_impossible
from vehicle_sbi.data.plausibility import LIMITS, absurd, examine
from vehicle_sbi.data.readers import RecordingFile, read
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import INPUTS

RATE, RATIO = 50.0, 16.0
STD = {"steering": 1e-4, "steering_wheel": 1e-3, "v_x": 0.03, "yaw_rate": 0.004, "a_x": 0.15, "a_y": 0.15}
RECORDINGS = Path(os.environ.get("VEHICLE_SBI_RECORDINGS", ROOT.parent / "shared/recordings"))


def drive(*, lively: float = 1.0, noise: float = 1.0) -> dict[str, np.ndarray]:
    """Forty seconds of a car that rolls without slip, from rest and back, with noise of usual sensors."""
    t, rng = np.arange(2000) / RATE, np.random.default_rng(0)
    v = 15.0 * np.clip(np.minimum(t - 3.0, 37.0 - t) / 8.0, 0.0, 1.0) + lively * np.sin(0.6 * t) * ((t > 12) & (t < 28))
    steering = 0.03 * lively * np.sin(0.8 * t)
    yaw_rate = v * steering / 2.7
    quiet = {"steering": steering, "steering_wheel": RATIO * steering, "v_x": v, "yaw_rate": yaw_rate}
    quiet |= {"a_x": np.gradient(v, t), "a_y": 1.1 * v * yaw_rate}  # a body that leans adds a tenth
    return {name: x + noise * STD[name] * rng.normal(size=len(t)) for name, x in quiet.items()}


def recording(channels: Mapping[str, np.ndarray]) -> Recording:
    t = np.arange(len(channels["a_y"])) / RATE
    valid = {name: np.isfinite(x) for name, x in channels.items()}
    return Recording(
        name="a", rate=RATE, t=t, channels=channels, valid=valid, groups={}, source="a.csv"
    )  # fmt: skip


def findings(seen: Recording) -> tuple[str, ...]:
    return tuple(one.sentence for one in examine(seen))


@cache
def simulated(kind: str, *, noisy: bool = True) -> Mapping[str, np.ndarray]:
    """A minute of the paper's car, with body roll, from the simulator at 50 Hz: on bends, in a slalom, in a city."""
    t = np.arange(round(60.0 * RATE)) / RATE
    bends = 0.02 * np.sin(0.5 * t) + 0.012 * np.sin(0.23 * t + 1.0) + 0.008 * np.sin(1.3 * t)
    steering, speed = {
        "bends": (bends, 18.0 + 3.0 * np.sin(0.3 * t) + 2.0 * np.sin(0.11 * t)),
        "slalom": (0.06 * np.sin(2.0 * np.pi * t / 3.0), 9.0 + 1.5 * np.sin(0.4 * t)),
        "city": (0.15 * np.sin(0.4 * t) * np.sin(0.07 * t), 6.0 + 3.5 * np.sin(0.35 * t)),
    }[kind]
    u = np.zeros((len(t), len(INPUTS)))
    gain = np.gradient(speed, t)
    for name, values in {"steering": steering, "v_x": speed, "v_x_dot": gain, "time": t}.items():
        u[:, INPUTS.index(name)] = values
    record = record_of(PAPER, body_roll_gradient=0.008)
    y = finished(record, "speed", u, [speed[0], 0.0, 0.0], model="single_track", rate=RATE, substeps=20)
    rng, x = np.random.default_rng(2), dict(zip(MEASUREMENTS, y, strict=True))
    wheel = speed / 0.31
    quiet = {"steering": steering, "steering_wheel": RATIO * steering, "v_x": speed, "a_x": x["a_x"], "a_y": x["a_y"]}
    quiet |= {"yaw_rate": x["yaw_rate"], "wheel_speed_fl": wheel, "wheel_speed_fr": 1.0 * wheel}
    std = STD | {"wheel_speed_fl": 0.1, "wheel_speed_fr": 0.1}
    return {name: x + noisy * std[name] * rng.normal(size=len(t)) for name, x in quiet.items()}


DRIVES = ["bends", "slalom", "city", "stopping"]


def healthy(kind: str) -> dict[str, np.ndarray]:
    return drive() if kind == "stopping" else dict(simulated(kind))


@pytest.mark.parametrize("lively", [0.0, 0.02, 0.2, 1.0])
@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_a_plausible_drive_contradicts_nothing(lively: float, noise: float) -> None:
    assert findings(recording(drive(lively=lively, noise=noise))) == ()


@pytest.mark.parametrize("kind", DRIVES[:3])
@pytest.mark.parametrize("noisy", [False, True])
def test_a_simulated_drive_contradicts_nothing(kind: str, noisy: bool) -> None:
    assert findings(recording(simulated(kind, noisy=noisy))) == ()


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "conf/recording").glob("*_*.yaml")))
def test_real_recordings_contradict_nothing_but_what_is_known(name: str) -> None:
    text = (ROOT / "conf/recording" / f"{name}.yaml").read_text()
    settings = yaml.safe_load(re.sub(r"\$\{oc.env:[^}]*\}", str(RECORDINGS), text))["recording"]
    settings.pop("_target_")
    if not Path(settings["path"]).exists():
        pytest.skip(f"{settings['path']} is not here")
    known = ["a_x reads", "a_y reads"] if name == "dart_sine_steering" else []  # -0.5 m/s^2 at standstill, it is so
    found = RecordingFile(**settings).load().warnings
    assert len(found) == len(known), found
    assert all(line.startswith(said) for line, said in zip(found, known, strict=True))


DEGREE, G, KMH = np.degrees(1.0), 9.81, 3.6


@pytest.mark.parametrize("kind", DRIVES)
@pytest.mark.parametrize(
    ("changed", "factor", "offset", "said"),
    [
        ("a_y", -1.0, 0.0, "is a_y flipped?"),
        ("a_x", -1.0, 0.0, "is a_x flipped?"),
        ("yaw_rate", -1.0, 0.0, "is yaw_rate flipped?"),
        ("steering", -1.0, 0.0, "is steering"),
        ("steering_wheel", -1.0, 0.0, "is steering_wheel"),
        ("a_y", 1.0 / G, 0.0, "is a_y in g rather than m/s²?"),
        ("a_y", G, 0.0, "is a_y in m/s², but read as g?"),
        ("a_x", 1.0 / G, 0.0, "is a_x in g rather than m/s²?"),
        ("a_x", G, 0.0, "is a_x in m/s², but read as g?"),
        ("yaw_rate", DEGREE, 0.0, "is yaw_rate in deg/s rather than rad/s?"),
        ("yaw_rate", 1.0 / DEGREE, 0.0, "is yaw_rate in rad/s, but read as deg/s?"),
        ("v_x", KMH, 0.0, "is v_x in km/h rather than m/s?"),
        ("v_x", 1.0 / KMH, 0.0, "is v_x in m/s, but read as km/h?"),
        ("v_x", 2.237, 0.0, "is v_x in mph rather than m/s?"),
        ("steering", RATIO, 0.0, "is steering the steering wheel's angle?"),
        ("steering", DEGREE, 0.0, "steering in deg rather than rad?"),
        ("steering", RATIO * DEGREE, 0.0, "is steering the steering wheel's angle in deg?"),
        ("steering_wheel", DEGREE, 0.0, "is steering_wheel in deg rather than rad?"),
        ("steering_wheel", 1.0 / RATIO, 0.0, "is steering_wheel the road wheels' angle?"),
        ("a_y", 6.0, 0.0, "a_y is 6"),
        ("a_x", 1.0, 3.0, "a_x reads 3"),
        ("a_y", 1.0, G, "is it the vertical axis?"),
    ],
)
def test_each_fault_is_named_with_its_channel_and_cause(
    kind: str, changed: str, factor: float, offset: float, said: str
) -> None:
    right = healthy(kind)
    found = findings(recording(right | {changed: factor * right[changed] + offset}))
    assert any(said in line for line in found), found
    assert all(len(line.split()) <= 25 for line in found), found
    assert len(found) <= 2, found


@pytest.mark.parametrize(
    ("changed", "factor", "offset", "said"),
    [
        ("yaw_rate", 1.0, 0.02, "rad/s while the car stands: an offset?"),
        ("a_x", 1.0, 0.5, "m/s² while the car stands: gravity (a slope"),
        ("steering_wheel", DEGREE, 0.0, "is steering_wheel in deg"),
    ],
)
def test_offsets_show_while_the_car_stands(changed: str, factor: float, offset: float, said: str) -> None:
    right = drive()
    found = findings(recording(right | {changed: factor * right[changed] + offset}))
    assert any(said in line for line in found), found


@pytest.mark.parametrize("kind", DRIVES)
def test_swapped_axes_of_an_accelerometer_are_said(kind: str) -> None:
    right = healthy(kind)
    (line,) = findings(recording(right | {"a_x": right["a_y"], "a_y": right["a_x"]}))
    assert "follows" in line
    assert "are the axes swapped?" in line


@pytest.mark.parametrize("kind", ["bends", "city", "stopping"])
@pytest.mark.parametrize("seconds", [-2.0, 0.7, 3.0])
@pytest.mark.parametrize("changed", ["a_y", "a_x", "steering", "yaw_rate"])
def test_seconds_of_shift_are_said(kind: str, changed: str, seconds: float) -> None:
    right = healthy(kind)
    cut, late = round(4.0 * RATE), round(seconds * RATE)
    moved = {name: x[cut:-cut] for name, x in right.items() if name != "steering_wheel"}
    moved[changed] = right[changed][cut - late : len(right[changed]) - cut - late]
    found = findings(recording(moved))
    (line,) = found
    assert line.startswith(f"{changed} comes ")
    assert float(line.split(" comes ")[1].split()[0]) == pytest.approx(abs(seconds), abs=0.25)  # a car's own is 0.2 s
    assert ("after" if seconds > 0.0 else "before") in line


@pytest.mark.parametrize("kind", DRIVES)
@pytest.mark.parametrize("changed", ["a_y", "yaw_rate"])
def test_a_clipped_channel_is_said(kind: str, changed: str) -> None:
    right = healthy(kind)
    limit = 0.6 * float(np.max(right[changed]))
    found = findings(recording(right | {changed: np.clip(right[changed], -limit, limit)}))
    assert any(line.startswith(f"{changed} is at its") and line.endswith("is it clipped?") for line in found), found


@pytest.mark.parametrize("kind", DRIVES)
@pytest.mark.parametrize("changed", ["a_y", "yaw_rate", "a_x", "steering"])
def test_a_frozen_channel_is_said(kind: str, changed: str) -> None:
    assert_frozen_is_said(healthy(kind), changed)


@pytest.mark.parametrize("kind", DRIVES[:3])  # the other one has no wheels
def test_a_frozen_wheel_is_said(kind: str) -> None:
    assert_frozen_is_said(healthy(kind), "wheel_speed_fl")


@pytest.mark.parametrize("kind", DRIVES)
@pytest.mark.parametrize("changed", ["a_y", "yaw_rate", "steering"])
def test_a_channel_that_is_dead_from_the_start_or_to_the_end_is_said(kind: str, changed: str) -> None:
    assert_frozen_is_said(healthy(kind), changed, start=0, stop=None)
    assert_frozen_is_said(healthy(kind), changed, start=900, stop=None)


def assert_frozen_is_said(
    right: Mapping[str, np.ndarray], changed: str, *, start: int = 900, stop: int | None = 1400
) -> None:
    values = right[changed].copy()
    values[start:stop] = values[start]
    found = findings(recording({**right, changed: values}))
    assert any(line.startswith(f"{changed} stays at") and line.endswith("is it frozen?") for line in found), found


@pytest.mark.parametrize("kind", DRIVES[:3])
@pytest.mark.parametrize("changed", ["a_y", "yaw_rate", "v_x", "steering"])
def test_a_coarsely_quantised_channel_is_said_and_a_finely_quantised_one_is_not(kind: str, changed: str) -> None:
    right = healthy(kind)
    spread = float(np.subtract(*np.quantile(right[changed], [0.95, 0.05])))
    for steps, lines in ((6, 1), (40, 0)):
        step = spread / steps
        found = findings(recording(right | {changed: step * np.round(right[changed] / step)}))
        assert sum(line.startswith(f"{changed} moves in steps") for line in found) == lines, found


def test_units_and_signs_of_a_vertical_axis_are_said() -> None:
    right = drive()
    for values, said in ((-9.8, "is it flipped?"), (1.0, "is a_z in g rather than m/s²?"), (9.8, ""), (0.02, "")):
        a_z = values + 0.05 * np.random.default_rng(3).normal(size=2000)
        found = findings(recording(right | {"a_z": a_z}))
        assert [line for line in found if said and said in line] == list(found), found
        assert len(found) == bool(said)


@pytest.mark.parametrize(
    ("factor", "said"),
    [(0.31, "the rim's speed in m/s"), (60.0 / (2 * np.pi), "in rpm rather than rad/s"), (DEGREE, "in deg/s rather")],
)
def test_units_of_wheel_speeds_are_said_once(factor: float, said: str) -> None:
    right = healthy("bends")
    wheels = {name: factor * right[name] for name in ("wheel_speed_fl", "wheel_speed_fr")}
    (line,) = findings(recording(right | wheels))
    assert said in line


@pytest.mark.parametrize(("flipped", "said"), [("a_y", "a_y"), ("a_x", "a_x"), ("yaw_rate", "yaw_rate"), (None, "")])
def test_wheel_speeds_tell_signs_where_no_speed_is_recorded(flipped: str | None, said: str) -> None:
    series = drive()
    v_x = series.pop("v_x")
    wheels = {f"wheel_speed_{at}": v_x / 0.31 for at in ("fl", "fr", "rl", "rr")}
    found = findings(recording(series | ({flipped: -series[flipped]} if flipped else {}) | wheels))
    assert [line for line in found if f"is {said} flipped?" in line] == list(found)
    assert len(found) == bool(flipped)


def test_what_a_flipped_channel_runs_against_names_it_where_enough_is_recorded() -> None:
    right = drive()
    few = {name: right[name] for name in ("v_x", "a_y")} | {"yaw_rate": -right["yaw_rate"]}
    (line,) = findings(recording(few))
    assert "is a_y or yaw_rate flipped?" in line
    backwards = right | {"v_x": -right["v_x"]}
    (line,) = findings(recording(backwards))
    assert "is v_x flipped?" in line


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


@pytest.mark.parametrize(
    ("name", "factor"), [("steering", 1e300), ("v_x", 1000.0), ("a_y", 1e4), ("yaw_rate", 1e4), ("steering_wheel", 1e3)]
)
def test_what_no_car_can_be_is_refused_before_anything_is_inferred(name: str, factor: float) -> None:
    right = healthy("slalom")
    refuse_impossible(recording(right), right)
    with pytest.raises(InputError, match=rf"{name} is beyond .* which no car reaches"):
        refuse_impossible(recording(right | {name: factor * (right[name] + 1e-3)}), right)
    refuse_impossible(recording(right | {name: factor * right[name]}), ())  # what is not used may be anything


@pytest.mark.parametrize(("share", "refused"), [(0.05, False), (0.33, True)])
def test_samples_that_no_car_can_have_are_left_out_or_refuse_the_channel(share: float, refused: bool) -> None:
    right = healthy("slalom")
    wrong = np.random.default_rng(0).random(len(right["steering"])) < share
    one = recording(right | {"steering": np.where(wrong, 1e300, right["steering"])})
    beyond, _ = absurd("steering", one.channels["steering"], RATE)
    assert np.array_equal(beyond, wrong & (not refused))
    if refused:
        with pytest.raises(InputError, match=r"steering is beyond 1\.4 rad in 3[0-9]% of the time"):
            refuse_impossible(one, right)
    else:
        refuse_impossible(one, right)
