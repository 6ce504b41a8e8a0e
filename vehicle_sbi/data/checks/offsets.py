"""Offsets: what sensors read while the car stands, and gravity in a channel while it drives."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.checks.drive import SAMPLES, Drive, Finding, runs
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.vehicle import GRAVITY

REST_V, REST_S = 0.3, 1.0  # [m/s], [s]: slower for longer, the car stands
REST_TURN, REST_A = 0.005, 0.3  # [rad/s], of good gyroscopes after warming up; [m/s^2], a slope of 3 per cent
STEEPEST = 2.0  # [m/s^2], gravity on a slope of 20 per cent: no drive's mean grade or bank is steeper
IN_G = 0.1  # [m/s^2] from 1, the mean of a vertical channel in g; offsets of one whose gravity is taken out are less
UPRIGHT = 0.25  # relative distance from gravity, of a sensor tilted by less than 40 degrees


def at_rest(recording: Recording) -> Iterator[Finding]:
    """Offsets at standstill that are larger than good sensors and flat ground have."""
    standing = _standing(recording)
    for name in ("yaw_rate", "roll_rate", "pitch_rate", "a_x", "a_y"):
        series = recording.series(name)
        read = np.zeros(0) if series is None else series[0][standing & series[1]]
        mean = float(np.mean(read)) if len(read) else 0.0
        turns = name.endswith("rate")
        if abs(mean) > (REST_TURN if turns else REST_A):
            cause = "an offset?" if turns else "gravity (a slope, a tilted sensor) or an offset?"
            yield Finding(
                name, "offset", f"{name} reads {mean:.2g} {CHANNELS[name].unit} while the car stands: {cause}"
            )


def gravity(drive: Drive) -> Iterator[Finding]:
    """Horizontal channels that hold gravity on the mean, and a vertical one that holds it wrongly."""
    for name, course, of in (("a_x", "gaining", "dv_x/dt"), ("a_y", "turning", "v_x times yaw_rate")):
        rest = drive[name] - drive[course]
        rest = rest[np.isfinite(rest)]
        mean = float(np.mean(rest)) if len(rest) >= SAMPLES else 0.0
        if abs(mean) > STEEPEST:
            vertical = abs(abs(mean) / GRAVITY - 1.0) < UPRIGHT
            cause = "is it the vertical axis?" if vertical else "gravity of a tilted sensor, or an offset?"
            yield Finding(name, "gravity", f"{name} reads {mean:.2g} m/s² more than {of} on the mean: {cause}")
    yield from _vertical(drive)


def _vertical(drive: Drive) -> Iterator[Finding]:
    """a_z is +9.81 m/s^2 on the mean as specific force, 0 without gravity (ISO 8855: z up)."""
    known = drive["a_z"][np.isfinite(drive["a_z"])]
    if len(known) < SAMPLES:
        return
    mean = float(np.mean(known))
    if abs(mean / GRAVITY + 1.0) < UPRIGHT:
        yield Finding("a_z", "sign", f"a_z reads {mean:.2g} m/s² on the mean, +9.8 with z up: is it flipped?")
    elif abs(abs(mean) - 1.0) < IN_G:
        yield Finding("a_z", "unit", f"a_z reads {mean:.2g} m/s² on the mean: is a_z in g rather than m/s²?")


def _standing(recording: Recording) -> Bool[np.ndarray, " time"]:
    """Where the car stands for long enough."""
    standing, speed = np.zeros(len(recording.t), dtype=bool), recording.series("v_x")
    if speed is not None:
        for start, stop in runs(speed[1] & (np.abs(speed[0]) < REST_V)):
            standing[start:stop] = stop - start >= REST_S * recording.rate
    return standing
