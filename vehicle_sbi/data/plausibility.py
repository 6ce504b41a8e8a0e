"""What a recording contradicts: signs, units and axes that the drive itself tells, offsets at rest, absurd samples.

On a flat road at small sideslip a_y = v_x r, a_x = dv_x/dt and r = v_x delta / (L + K v_x^2) (Rajamani, Vehicle
Dynamics and Control, sec. 2.5 and 3.3). Gains, offsets, roll and grade bend that by tens of per cent; a wrong sign or
unit by a factor that is known. Nothing is said where the drive is too gentle to tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.vehicle import GRAVITY

LIMITS: Mapping[str, float] = {
    "steering": 1.4,  # [rad], 80 degrees: no road wheel turns further
    "steering_wheel": 25.0,  # [rad], four turns to either side
    "v_x": 130.0,  # [m/s]
    "v_y": 60.0,
    **dict.fromkeys(("a_x", "a_y", "a_z"), 100.0),  # [m/s^2], ten times gravity: a crash
    **dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate"), 20.0),  # [rad/s], three turns a second
    **dict.fromkeys(
        (name for name in CHANNELS if name.startswith("wheel_speed")), 2000.0
    ),  # [rad/s], of toy wheels too
}
"""What no vehicle's channel goes beyond, in its own unit."""

BROKEN = 0.1  # share of samples beyond a limit, from which it is the unit rather than the samples that is wrong
RUN_S = 1.0  # [s] that a run of absurd samples lasts at most
JUMP, BACK = 10.0, 0.25  # times all but the largest usual changes, and of the jump that is not taken back
MOST_JUMPED = 0.02  # share of samples in such runs, from which it is what the channel does
SMOOTHED_S = 0.5  # [s] over which signals are averaged before they are compared
ALIKE, UNLIKE, OFF = 0.8, 0.5, 0.25  # correlations that tell, and relative distance from a known factor
LEAST = {"a": 0.4, "turn": 0.02, "steering": 0.005}  # spread that tells: [m/s^2], of yaw rate over speed [1/m], [rad]
LIKELY = 0.5, 2.0  # gains that sensors and roads may have
REST_V, REST_S, REST_TURN, REST_A = 0.3, 1.0, 0.005, 0.3  # [m/s], [s], [rad/s], [m/s^2]
MOVING = 2.0  # [m/s], from which slips and turns tell
SPEED_UNIT, DEGREE = 3.6, np.degrees(1.0)
SIGN = "the opposite sign"
COURSES = {"turning": "v_x times yaw rate", "gaining": "dv_x/dt"}
WHEELS = tuple(name for name in CHANNELS if name.startswith("wheel_speed"))
RADIUS = 0.3  # [m] of a wheel, where the speed is told from wheels: good for signs, not for gains


@dataclass(frozen=True)
class Relation:
    """How one series follows another: correlation, and slope through the origin."""

    correlation: float
    slope: float

    def by(self, factor: float) -> bool:
        """Whether the slope is about a factor."""
        return self.correlation > ALIKE and abs(self.slope / factor - 1.0) < OFF


def absurd(
    name: str, values: Float[np.ndarray, " rows"], rate: float
) -> tuple[Bool[np.ndarray, " rows"], Bool[np.ndarray, " rows"]]:
    """Samples beyond what the channel can be, and those of short runs that jump out and back."""
    beyond = np.abs(values) > LIMITS.get(name, np.inf)
    if beyond.mean() > BROKEN:
        beyond = np.zeros(len(values), dtype=bool)
    if name == "brake" or name.startswith("torque"):
        return beyond, np.zeros(len(values), dtype=bool)  # which people switch on and off
    return beyond, _out_and_back(np.where(beyond, np.nan, values), round(RUN_S * rate))


def _out_and_back(values: Float[np.ndarray, " rows"], most: int) -> Bool[np.ndarray, " rows"]:
    """Runs of at most so many samples between two jumps that undo each other, each far beyond all usual changes; there
    may be others between them."""
    found, known = np.zeros(len(values), dtype=bool), np.flatnonzero(np.isfinite(values))
    x = values[known]
    changes = np.diff(x)
    if len(x) < 5 or not changes.any():
        return found
    usual = max(float(np.quantile(np.abs(changes), 0.99)), float(np.median(np.abs(changes[changes != 0.0]))))
    jumps = np.flatnonzero(np.abs(changes) > JUMP * usual)
    done = -1
    for out in jumps:
        later = jumps[(jumps > out) & (jumps <= out + most)]
        undone = later[np.abs(x[later + 1] - x[out]) < BACK * abs(changes[out])]
        if out > done and len(undone):
            done = undone[0]
            found[known[out + 1] : known[done] + 1] = True
    return found if found.mean() < MOST_JUMPED else np.zeros(len(values), dtype=bool)


def spoken_runs(which: Bool[np.ndarray, " rows"], t: Float[np.ndarray, " rows"], most: int = 3) -> str:
    """Runs of samples and when they begin [s], at most so many of them."""
    starts = _runs(which)[:, 0]
    more = f" and {len(starts) - most} more" if len(starts) > most else ""
    return f"{int(which.sum())} samples from {', '.join(f'{t[k]:.2f}' for k in starts[:most])} s{more}"


def _runs(which: Bool[np.ndarray, " rows"]) -> Int[np.ndarray, "runs 2"]:
    """First sample of each run and the one after its last."""
    return np.flatnonzero(np.diff(np.concatenate([[0], which.astype(int), [0]]))).reshape(-1, 2)


def findings(recording: Recording) -> tuple[str, ...]:
    """What the drive contradicts, a sentence each; empty for a plausible recording or one too gentle to tell."""
    x = {name: _smoothed(recording, name) for name in ("v_x", "a_x", "a_y", "yaw_rate", "steering", "steering_wheel")}
    scaled = bool(np.isfinite(x["v_x"]).any())
    x["v_x"] = x["v_x"] if scaled else _of_wheels(recording)
    x["turning"], x["gaining"] = x["v_x"] * x["yaw_rate"], np.gradient(x["v_x"]) * recording.rate
    told = [*_swapped(x), *_lateral(x), *_longitudinal(x), *_steering(x)]
    return (*_limits(recording), *(line for line in told if scaled or SIGN in line), *_at_rest(recording))


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


def _relation(y: np.ndarray, x: np.ndarray, least: float) -> Relation | None:
    """How y follows x; None where either is measured too little or varies too little to tell."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < 50:
        return None
    x, y = x[both], y[both]
    if min(np.std(x), np.std(y)) == 0.0 or np.std(x) < least:
        return None
    return Relation(float(np.corrcoef(x, y)[0, 1]), float(np.cov(x, y)[0, 1] / np.var(x)))


def _limits(recording: Recording) -> list[str]:
    """Channels that lie beyond what they can be too often for single samples to be wrong."""
    said = []
    for name, values in recording.channels.items():
        share = float(np.mean(np.abs(values[np.isfinite(values)]) > LIMITS.get(name, np.inf))) if len(values) else 0.0
        if share > BROKEN:
            unit = CHANNELS[name].unit
            said.append(f"{name} is beyond {LIMITS[name]:g} {unit} in {share:.0%} of the time: is its unit {unit}?")
    return said


def _swapped(x: Mapping[str, np.ndarray]) -> list[str]:
    """Whether one axis of the accelerometer reads what the other should."""
    for course, own, other in (("turning", "a_y", "a_x"), ("gaining", "a_x", "a_y")):
        right, wrong = (_relation(x[name], x[course], LEAST["a"]) for name in (own, other))
        if right is None or wrong is None:
            continue
        if abs(wrong.correlation) > ALIKE and abs(right.correlation) < UNLIKE:
            return [
                f"{other} follows {COURSES[course]} (correlation {wrong.correlation:.2f}), and {own} does not: "
                "the axes seem swapped."
            ]
    return []


def _lateral(x: Mapping[str, np.ndarray]) -> list[str]:
    """a_y against the yaw rate times the speed."""
    one = _relation(x["a_y"], x["turning"], LEAST["a"])
    if one is None:
        return []
    if one.correlation < -ALIKE:
        return [f"a_y has {SIGN} of v_x times yaw rate (correlation {one.correlation:.2f}): one is flipped."]
    if one.by(1.0 / GRAVITY):
        return [f"a_y is {one.slope:.2g} times v_x times yaw rate: it seems to be in g, not m/s^2."]
    if one.by(1.0 / SPEED_UNIT):
        return [f"a_y is {one.slope:.2g} times v_x times yaw rate: v_x seems to be in km/h, not m/s."]
    if one.by(1.0 / DEGREE):
        return [f"a_y is {one.slope:.2g} times v_x times yaw rate: the yaw rate seems to be in deg/s, not rad/s."]
    return _gain("a_y", "v_x times yaw rate", one)


def _longitudinal(x: Mapping[str, np.ndarray]) -> list[str]:
    """a_x against what the speed gains."""
    one = _relation(x["a_x"], x["gaining"], LEAST["a"])
    if one is None:
        return []
    if one.correlation < -ALIKE:
        return [f"a_x has {SIGN} of dv_x/dt (correlation {one.correlation:.2f}): one is flipped."]
    if one.by(1.0 / GRAVITY):
        return [f"a_x is {one.slope:.2g} times dv_x/dt: it seems to be in g, not m/s^2."]
    if one.by(1.0 / SPEED_UNIT):
        return [f"a_x is {one.slope:.2g} times dv_x/dt: v_x seems to be in km/h, not m/s."]
    return _gain("a_x", "dv_x/dt", one)


def _gain(name: str, of: str, one: Relation) -> list[str]:
    """A gain that no sensor and no road gives."""
    low, high = LIKELY
    if one.correlation > ALIKE and not low < one.slope < high:
        return [f"{name} is {one.slope:.2g} times {of}: a unit or a calibration is wrong."]
    return []


def _steering(x: Mapping[str, np.ndarray]) -> list[str]:
    """Whether the car turns to the side to which it is steered."""
    moving = np.abs(x["v_x"]) > MOVING
    turn = np.where(moving, x["yaw_rate"] / np.where(moving, x["v_x"], 1.0), np.nan)
    for name in ("steering", "steering_wheel"):
        one = _relation(turn, np.where(moving, x[name], np.nan), LEAST["steering"])
        if one is not None and one.correlation < -ALIKE:
            return [f"{name} has {SIGN} of the yaw rate (correlation {one.correlation:.2f}): one is flipped."]
    return []


def _at_rest(recording: Recording) -> list[str]:
    """What sensors read while the car stands."""
    speed = recording.series("v_x")
    if speed is None:
        return []
    long = np.zeros(len(recording.t), dtype=bool)
    for start, stop in _runs(speed[1] & (np.abs(speed[0]) < REST_V)):
        long[start:stop] = stop - start >= REST_S * recording.rate
    said = []
    for name, least in (("yaw_rate", REST_TURN), ("a_x", REST_A), ("a_y", REST_A)):
        series = recording.series(name)
        read = None if series is None else series[0][long & series[1]]
        if read is not None and len(read) and abs(mean := float(np.mean(read))) > least:
            why = "an offset" if name == "yaw_rate" else "gravity (a slope, a tilted sensor) or an offset"
            said.append(f"{name} reads {mean:.2g} {CHANNELS[name].unit} while the car stands: {why}.")
    return said
