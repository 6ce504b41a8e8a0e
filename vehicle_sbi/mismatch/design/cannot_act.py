"""Why an effect cannot act on a recording at all, however large it is: what is driven, what is recorded, or the drive.

It is told apart from an effect that acts and is too weak to be seen.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import Direction, directions, slopes, within
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.effects import CATALOGUE, Effect
from vehicle_sbi.physics.sensors import BODY_MEASUREMENTS, MEASUREMENTS
from vehicle_sbi.words import enumerated

TORQUES = ("drive_gain", "brake_gain", "drive_delay")  # effects on torques that are stated
MEASURED_INSTEAD = {"torque": (), "wheel_speed": (*TORQUES, "brake_balance"), "speed": TORQUES}
"""Effects on what a drive mode does not compute, as what it would lead to is measured."""


def cannot_act(simulator: Simulator, theta: Float[np.ndarray, " d"], acting: Collection[str]) -> dict[str, str]:
    """For each effect that is neither acting nor fitted the reason."""
    fitted = {name.split(".")[0] for name in simulator.space.names}
    idle = (effect for name, effect in CATALOGUE.items() if name not in acting and name not in fitted)
    return {effect.name: _reason(simulator, theta, effect) for effect in idle}


def _reason(simulator: Simulator, theta: Float[np.ndarray, " d"], effect: Effect) -> str:
    if effect.name in MEASURED_INSTEAD[simulator.drive]:
        return f"drive mode {simulator.drive} takes a measured speed in place of torques"
    if not within(simulator, effect).parameters:
        return "none of the sensors that it belongs to is recorded"
    wider = _measuring_everything(simulator)
    if found := directions(wider, theta, effect):
        return f"it acts on {enumerated(_moved(wider, theta, found))} alone, not among the channels that are compared"
    return "nothing in how the car is driven brings it out"


def _measuring_everything(simulator: Simulator) -> Simulator:
    """The same drive with every channel recorded that the model predicts."""
    windows = simulator.windows
    full = simulator.model == "full_vehicle"
    more = tuple(
        name for name in MEASUREMENTS if name not in windows.channels and (full or name not in BODY_MEASUREMENTS)
    )
    channels = (*windows.channels, *more)
    ever = np.zeros((len(channels), windows.t.size))
    return replace(
        simulator,
        windows=replace(
            windows, channels=channels, groups=(*windows.groups, *("imu",) * len(more)), y=ever, valid=ever == 0.0
        ),
    )


def _moved(simulator: Simulator, theta: Float[np.ndarray, " d"], found: list[Direction]) -> list[str]:
    """Channels that any of the directions changes."""
    change = np.nanmax(np.abs(slopes(simulator, theta, found)), axis=(0, 2))
    return [name for name, moved in zip(simulator.windows.channels, change, strict=True) if moved > 0.0]
