"""Every effect, with every vehicle file, drive mode and channel: it shows, is too weak to be seen, or cannot act."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cars import PAPER

from vehicle_sbi.data.channels import CHANNELS, NEEDED
from vehicle_sbi.data.noise import ConstantNoise, ProcessNoise
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.prior import parameter_space, unused
from vehicle_sbi.inference.setup import Setup
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.design.cannot_act import MEASURED_INSTEAD
from vehicle_sbi.mismatch.design.identifiability import Card, card
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.sensors import BODY_MEASUREMENTS, MEASUREMENTS
from vehicle_sbi.physics.simulation import MODELS
from vehicle_sbi.physics.single_track import DRIVES, INPUTS
from vehicle_sbi.physics.vehicle import GRAVITY, Vehicle, read

FILES = sorted(path for path in (Path(__file__).parents[1] / "conf" / "vehicle").glob("*.yaml") if path.stem != "file")
RATE, SECONDS = 50.0, 10.0
ORDINARY_L = 2.7  # wheelbase [m] of a car that drives at 15 m/s here; others at the same Froude number
STD = {"wheel_speed_front": 0.1, "wheel_speed_rear": 0.1, "v_x": 0.05, "v_y": 0.05} | {
    name: 0.1 if name.startswith("a_") else 0.005 for name in MEASUREMENTS if name.startswith("a_") or "rate" in name
}
QUIET = ProcessNoise(stiffness=0.0, inputs=0.0)
RATIO = {"steering_ratio": {"gain": [0.8, 1.2]}}

every_drive = pytest.mark.parametrize("drive", DRIVES)


def driven(car: Vehicle, drive: str, channels: tuple[str, ...], model: str = "single_track") -> Simulator:
    """A slalom at two thirds of the grip while the car speeds up and brakes, behind the steering's gain."""
    assert car.L is not None
    mass, size = car.m or 1500.0, car.L / ORDINARY_L
    v_0, second = 15.0 * np.sqrt(size), np.sqrt(size)  # a car of this size is so much quicker
    radius = car.R_f or 0.33 * size
    t = np.arange(round(SECONDS * RATE)) / RATE
    acceleration = 1.5 * np.sin(2 * np.pi * t / (4.0 * second))
    v_x = v_0 + np.concatenate([[0.0], np.cumsum(acceleration)[:-1]]) / RATE
    lateral = 0.65 * (car.mu or 0.8) * GRAVITY * np.sin(2 * np.pi * t / (2.2 * second))
    torque = mass * acceleration * radius
    front = torque * np.where(acceleration > 0, car.drive_front, car.brake_front)
    u = np.zeros((1, len(t), len(INPUTS)))
    u[0, :, INPUTS.index("steering")] = car.L * lateral / v_x**2
    u[0, :, INPUTS.index("torque_front")] = front
    u[0, :, INPUTS.index("torque_rear")] = torque - front
    u[0, :, INPUTS.index("v_x")], u[0, :, INPUTS.index("v_x_dot")] = v_x, acceleration
    u[0, :, INPUTS.index("wheel_speed_front")] = u[0, :, INPUTS.index("wheel_speed_rear")] = v_x / radius
    u[0, :, INPUTS.index("time")] = t
    y = np.zeros((len(channels), len(t)))
    windows = Windows(
        rate=RATE, u=u, before=u[:, :0, :3], y=y, valid=y == 0.0, x0=np.array([[v_0, 0.0, 0.0]]),
        x0_std=np.zeros(3), channels=channels,
        groups=tuple(CHANNELS[name].group for name in channels), t=t[None],
    )  # fmt: skip
    setup = Setup(
        vehicle=car, model=model, drive=drive, prior=RATIO, effects=[], window_s=10.0, warmup_s=0.5,
        noise=ConstantNoise(std={name: STD[name] for name in channels}, process=QUIET), seed=0,
    )  # fmt: skip
    return setup.simulator(setup.space(windows), windows, uniform_start=False, stiffest=2.0)


RIGID = tuple(name for name in MEASUREMENTS if name not in BODY_MEASUREMENTS)
PREDICTED = {"speed": {"speed_scale"}}  # the gain of a speed that is compared, and this one drives
FAINT = {"aero_drag", "downforce", "rolling_resistance", "combined_slip"}  # which take little of the grip here
GRIP_LEFT = {"dart": {"friction_level", "friction_step", "lateral_load_transfer"}}
"""What takes little of the grip of a file's tyres: these are so soft that they slip far before."""


def compared(channels: tuple[str, ...], drive: str) -> tuple[str, ...]:
    """Without those that drive the model."""
    return tuple(name for name in channels if name not in NEEDED[drive])


def seen(simulator: Simulator) -> Card:
    space = simulator.space
    return card(simulator, (space.low + space.high) / 2)


def _cars() -> Iterator[Any]:
    """Every file with both models; the full vehicle, which takes longest, is slow but for the smallest car."""
    for path, model in product(FILES, MODELS):
        slow = model == "full_vehicle" and path.stem != "dart"
        yield pytest.param(path, model, id=f"{path.stem}-{model}", marks=[pytest.mark.slow] if slow else [])


@every_drive
@pytest.mark.parametrize(("path", "model"), [*_cars()])
def test_every_effect_shows_with_every_vehicle_file_or_it_is_said_why_it_cannot(
    path: Path, model: str, drive: str
) -> None:
    channels = RIGID if model == "single_track" else MEASUREMENTS
    found = seen(driven(read(str(path)), drive, compared(channels, drive), model))
    shown, weak, cannot = set(found.could_show()), set(found.invisible()), found.cannot_act
    assert shown | weak | set(cannot) | {"steering_ratio"} == set(CATALOGUE)
    assert len(shown) + len(weak) + len(cannot) + 1 == len(CATALOGUE)
    idle = set(MEASURED_INSTEAD[drive]) | PREDICTED.get(drive, set())
    assert weak | set(cannot) - idle <= FAINT | GRIP_LEFT.get(path.stem, set())
    assert set(MEASURED_INSTEAD[drive]) <= set(cannot)


@pytest.mark.parametrize(("channel", "drive"), [(one, drive) for drive in DRIVES for one in compared(RIGID, drive)])
def test_what_a_single_channel_cannot_show_is_said_to_need_others(channel: str, drive: str) -> None:
    found = seen(driven(PAPER, drive, (channel,)))
    acting = {c.effect for c in found.candidates}
    assert acting | set(found.cannot_act) | {"steering_ratio"} == set(CATALOGUE)
    for effect, reason in found.cannot_act.items():
        assert effect not in acting
        others = [name for name in MEASUREMENTS if name in reason.replace("measured speed", "")]
        assert others or reason.startswith(("drive mode", "none of the sensors"))
        assert channel not in others


@every_drive
@pytest.mark.parametrize("model", MODELS)
def test_constants_that_no_channel_depends_on_are_not_freed_and_change_nothing(model: str, drive: str) -> None:
    channels = ("a_x", "a_y", "yaw_rate")
    bare = replace(PAPER, **dict.fromkeys(("C_kappa_f", "C_kappa_r", "R_f", "I_wf", "I_wr")))
    free = driven(bare, drive, channels, model)
    idle = set(unused(drive, model, free.windows.sensed(drive)))
    assert idle.isdisjoint(free.space.names)
    assert {*free.space.names, *idle} >= {"C_kappa_f", "C_kappa_r", "R_f", "I_wf", "I_wr"}
    theta = (free.space.low + free.space.high)[None] / 2
    quiet = free.noise_free(theta)
    for name in idle:
        nominal = free.nominal.copy()
        nominal[name] *= 1.3
        assert np.array_equal(replace(free, nominal=nominal).noise_free(theta), quiet)
    for name in set(free.space.names) - {"steering_ratio.gain"}:  # and what is freed changes something
        moved = theta.copy()
        moved[0, free.space.column(name)] *= 1.1
        assert not np.array_equal(free.noise_free(moved), quiet)


def test_what_belongs_to_sensors_that_are_not_recorded_is_not_freed() -> None:
    windows = driven(PAPER, "speed", ("a_y", "yaw_rate")).windows
    space = parameter_space(
        {"l_f": [1.0, 1.5]}, vehicle=PAPER, model="single_track", effects=["sensor_delay", "gyro_bias"], drive="speed",
        sensed=windows.sensed("speed"),
    )  # fmt: skip
    assert set(space.names) == {"l_f", "gyro_bias.z", "sensor_delay.imu", "sensor_delay.can"}
