"""Units: factors between channels that no gain, roll or grade gives, but a unit does.

a_y over v_x r and a_x over dv_x/dt are about 1. The effective wheelbase v_x delta / r = L + K v_x^2 is 2 to 8 m for
road wheels up to 15 m/s, the steering ratio (8 to 22) times that for the steering wheel. v_x over a wheel's speed is
its radius.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vehicle_sbi.data.checks.drive import ALIKE, LEAST, STEERINGS, WHEELS, Drive, Finding, relation
from vehicle_sbi.physics.vehicle import GRAVITY

LIKELY = 0.5, 2.0  # gains that sensors and roads may have
OFF = 0.25  # relative distance from a known factor: nearest neighbours, 1/3.6 and mph's 0.447, lie 1.6 apart
DEGREE, KMH, MPH = np.degrees(1.0), 3.6, 1.0 / 0.44704
SLOW, FAST = 15.0, 30.0  # [m/s]: K v_x^2 is below half L of usual cars at the first, below two L at the second
ROLLING = 5.0  # [m/s], from which a wheel's speed is above its sensor's dead range


@dataclass(frozen=True)
class Conversion:
    """What a channel's numbers are multiplied by if its unit is another, and how that is asked."""

    factor: float
    channel: str
    question: str


def _mistaken(channel: str, factor: float, other: str, unit: str, sign: int = 1) -> list[Conversion]:
    """`other` taken for `unit`, which turns a gain by `factor`, and the reverse; `sign` -1: by its inverse."""
    return [
        Conversion(factor**sign, channel, f"is {channel} in {other} rather than {unit}?"),
        Conversion(factor**-sign, channel, f"is {channel} in {unit}, but read as {other}?"),
    ]


LATERAL = [
    *_mistaken("a_y", 1.0 / GRAVITY, "g", "m/s²"),
    *_mistaken("v_x", KMH, "km/h", "m/s", -1),
    *_mistaken("v_x", MPH, "mph", "m/s", -1),
    *_mistaken("yaw_rate", DEGREE, "deg/s", "rad/s", -1),
]
LONGITUDINAL = [
    *_mistaken("a_x", 1.0 / GRAVITY, "g", "m/s²"),
    *_mistaken("v_x", KMH, "km/h", "m/s", -1),
    *_mistaken("v_x", MPH, "mph", "m/s", -1),
]

# Effective wheelbase [m] from, to, and what it asks. A car's L is 2.2 to 3.5 m and grows by half with understeer up to
# SLOW; times a steering ratio of 8 to 22 that is 18 to 115 m; times 57.3 it is 126 to 300 m, and 1000 m and more for
# a steering wheel's degrees. Model cars (L 0.1 to 0.5 m) and lorries (L up to 7 m) fall into no wrong one.
ROAD_WHEELS = (
    (0.0, 0.1, "is yaw_rate in deg/s, or steering converted twice?"),
    (18.0, 119.0, "is steering the steering wheel's angle?"),
    (119.0, 600.0, "is steering in deg rather than rad?"),
    (600.0, np.inf, "is steering the steering wheel's angle in deg?"),
)
STEERING_WHEEL = (
    (0.0, 2.0, "is yaw_rate in deg/s, or steering_wheel converted twice?"),
    (2.0, 10.0, "is steering_wheel the road wheels' angle?"),
    (600.0, np.inf, "is steering_wheel in deg rather than rad?"),
)

# Radius [m] from, to, and what it asks. Wheels of road vehicles have 0.2 to 0.6 m; 9.55 times less for rpm, 57.3 times
# less for deg/s; 1 to a few per cent of slip for the speed of the rim, and 3.6 times more for km/h.
RADII = (
    (0.0, 0.011, "is {wheel} in deg/s rather than rad/s?"),
    (0.018, 0.065, "is {wheel} in rpm rather than rad/s?"),
    (0.95, 1.05, "is {wheel} the rim's speed in m/s, without wheel_radius?"),
    (0.7, 2.2, "is v_x in km/h rather than m/s?"),
)


def lateral(drive: Drive) -> Iterator[Finding]:
    """a_y against the yaw rate times the speed; the longitudinal axis has a say where the speed is suspected."""
    own, other = _gain(drive, "a_y", "turning"), _gain(drive, "a_x", "gaining")
    yield from _judged("a_y", "v_x times yaw_rate", own, _suspected(LATERAL, other))


def longitudinal(drive: Drive) -> Iterator[Finding]:
    """a_x against what the speed gains."""
    own, other = _gain(drive, "a_x", "gaining"), _gain(drive, "a_y", "turning")
    yield from _judged("a_x", "dv_x/dt", own, _suspected(LONGITUDINAL, other))


def steering(drive: Drive) -> Iterator[Finding]:
    """What wheelbase the steering and the turns would need."""
    for name, classes in zip(STEERINGS, (ROAD_WHEELS, STEERING_WHEEL), strict=True):
        wheelbase = _wheelbase(drive, name)
        question = None if wheelbase is None else _named(wheelbase, classes)
        if question is not None:
            what = f"{name} times v_x over yaw_rate is {wheelbase:.2g} m, where a wheelbase is expected"
            yield Finding(name, "unit", f"{what}: {question}")


def wheels(drive: Drive) -> Iterator[Finding]:
    """What radius the wheels would need; one sentence, since wheels have one unit."""
    for wheel in WHEELS:
        series = drive.recording.series(wheel)
        if series is None or not drive.scaled:
            continue
        rolling = (drive["v_x"] > ROLLING) & series[1] & (series[0] > 0.0)
        radius = float(np.median(drive["v_x"][rolling] / series[0][rolling])) if rolling.sum() > 50 else np.nan
        question = _named(radius, RADII)
        if question is not None:
            channel = "v_x" if question.startswith("is v_x") else wheel
            yield Finding(
                channel,
                "unit",
                f"v_x is {radius:.2g} times {wheel}, where a radius in m is expected: {question.format(wheel=wheel)}",
            )
            return


def _suspected(known: Sequence[Conversion], other: float | None) -> list[Conversion]:
    """The conversions that may be; not those of the speed where the other axis has a likely gain with it."""
    cleared = other is not None and LIKELY[0] < other < LIKELY[1]
    return [one for one in known if not (cleared and one.channel == "v_x")]


def _gain(drive: Drive, name: str, course: str) -> float | None:
    """What the channel is multiplied by against the course of the drive; None where the drive does not tell."""
    one = relation(drive[name], drive[course], LEAST["a"])
    return None if one is None or abs(one.correlation) < ALIKE else abs(one.slope)


def _judged(name: str, of: str, gain: float | None, known: Sequence[Conversion]) -> Iterator[Finding]:
    """The conversion that a gain is nearest to, or that none is near; nothing for a likely gain."""
    if gain is None or LIKELY[0] < gain < LIKELY[1]:
        return
    nearest = min(known, key=lambda one: abs(np.log(gain / one.factor)))
    near = abs(gain / nearest.factor - 1.0) < OFF
    channel, question = (nearest.channel, nearest.question) if near else (name, "is a unit or a calibration wrong?")
    yield Finding(channel, "unit", f"{name} is {gain:.2g} times {of}: {question}")


def _wheelbase(drive: Drive, name: str) -> float | None:
    """v_x delta / r [m] where the car is slow, else up to FAST; None where the drive does not tell."""
    for limit in (SLOW, FAST):
        slow = np.abs(drive["v_x"]) < limit
        one = relation(np.where(slow, drive[name], np.nan), drive["turn"], LEAST["steering"])
        if one is not None and abs(one.correlation) > ALIKE:
            return one.ratio
    return None


def _named(value: float, classes: Sequence[tuple[float, float, str]]) -> str | None:
    """The question of the first class that holds a value."""
    return next((question for low, high, question in classes if low <= value < high), None)
