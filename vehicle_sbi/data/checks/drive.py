"""A drive as the checks compare it: channels averaged over half a second, beside what the motion makes of them.

On a flat road at small sideslip a_y = v_x r, a_x = dv_x/dt and r = v_x delta / (L + K v_x^2) (Rajamani, Vehicle
Dynamics and Control, sec. 2.5 and 3.3). Gains, offsets, roll and grade bend that by tens of per cent; a wrong sign or
unit by a factor that is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.recording import Recording

SMOOTHED_S = 0.5  # [s] over which signals are averaged before they are compared: noise and vibration are faster
ALIKE, UNLIKE = 0.8, 0.5  # correlations from which two series are one motion, or are not
SAMPLES = 50  # that a comparison needs
MOVING = 2.0  # [m/s], from which slips and turns tell
RADIUS = 0.3  # [m] of a wheel, where the speed is told from wheels: good for signs, not for gains
LEAST = {"a": 0.4, "steering": 0.005}  # spread that tells: [m/s^2], [rad]
STEERINGS = ("steering", "steering_wheel")
WHEELS = tuple(name for name in CHANNELS if name.startswith("wheel_speed"))


@dataclass(frozen=True)
class Finding:
    """What a recording contradicts: the channel that is likely at fault, the kind of fault, and the sentence."""

    channel: str
    fault: str
    sentence: str


@dataclass(frozen=True)
class Relation:
    """How one series follows another: correlation, slope of the regression, and ratio of their spreads."""

    correlation: float
    slope: float
    ratio: float


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Smoothed channels of a recording, NaN where not measured throughout the half second.

    `turning` v_x r and `gaining` dv_x/dt are in m/s^2, `turn` r / v_x in 1/m where the car moves. `scaled`: the speed
    is measured, rather than that of the wheels up to their radius.
    """

    recording: Recording
    rate: float
    series: Mapping[str, Float[np.ndarray, " time"]]
    scaled: bool

    def __getitem__(self, name: str) -> Float[np.ndarray, " time"]:
        return self.series[name]


def drive_of(recording: Recording) -> Drive:
    """The drive of a recording."""
    names = ("v_x", "a_x", "a_y", "a_z", "yaw_rate", "roll_rate", "pitch_rate", *STEERINGS)
    x = {name: _smoothed(recording, name) for name in names}
    scaled = bool(np.isfinite(x["v_x"]).any())
    x["v_x"] = x["v_x"] if scaled else _of_wheels(recording)
    moving = np.abs(x["v_x"]) > MOVING
    x["turning"] = x["v_x"] * x["yaw_rate"]
    x["gaining"] = np.gradient(x["v_x"]) * recording.rate
    x["turn"] = np.where(moving, x["yaw_rate"] / np.where(moving, x["v_x"], 1.0), np.nan)
    return Drive(recording=recording, rate=recording.rate, series=x, scaled=scaled)


def relation(y: np.ndarray, x: np.ndarray, least: float) -> Relation | None:
    """How y follows x; None where either is measured too little, or neither varies by as much as `least`.

    One of them may vary by less: its unit may be wrong.
    """
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < SAMPLES:
        return None
    x, y = x[both], y[both]
    spread_x, spread_y = float(np.std(x)), float(np.std(y))
    if min(spread_x, spread_y) == 0.0 or max(spread_x, spread_y) < least:
        return None
    correlation = float(np.corrcoef(x, y)[0, 1])
    return Relation(correlation, correlation * spread_y / spread_x, spread_y / spread_x)


def runs(which: Bool[np.ndarray, " rows"]) -> Int[np.ndarray, "runs 2"]:
    """First sample of each run and the one after its last."""
    return np.flatnonzero(np.diff(np.concatenate([[0], which.astype(int), [0]]))).reshape(-1, 2)


def _of_wheels(recording: Recording) -> Float[np.ndarray, " time"]:
    """The speed as the wheels have it on the mean, up to their radius; NaN where none was measured."""
    each = np.array([_smoothed(recording, name) for name in WHEELS])
    measured = np.isfinite(each)
    return RADIUS * np.where(
        measured.any(axis=0), np.nansum(each, axis=0) / np.maximum(measured.sum(axis=0), 1), np.nan
    )


def _smoothed(recording: Recording, name: str) -> Float[np.ndarray, " time"]:
    """A channel averaged over SMOOTHED_S, NaN where it was not measured throughout."""
    series = recording.series(name)
    if series is None:
        return np.full(len(recording.t), np.nan)
    values = np.where(series[1], series[0], np.nan)
    length = max(round(SMOOTHED_S * recording.rate), 1)
    return pd.Series(values).rolling(length, center=True, min_periods=length).mean().to_numpy()
