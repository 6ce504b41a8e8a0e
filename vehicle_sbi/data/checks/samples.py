"""Samples: channels that are clipped at a level, frozen while the car moves, or quantised coarsely.

What a driver holds (steering, torque, brake) stays at one value by nature, so clipping is not looked for there.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.data.channels import AXLE_MEANS, CHANNELS
from vehicle_sbi.data.checks.drive import MOVING, STEERINGS, Drive, Finding, runs
from vehicle_sbi.data.smoothing import ONE_STEP

MOTION = ("a_x", "a_y", "a_z", "yaw_rate", "roll_rate", "pitch_rate", "v_y")
WHEELS = tuple(wheel for pair in AXLE_MEANS.values() for wheel in pair)
PARTNERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "a_y": ("turning",), "yaw_rate": ("a_y", *STEERINGS), "a_x": ("gaining",), "steering": ("turn",),
        "steering_wheel": ("turn",), "v_x": WHEELS, **dict.fromkeys(WHEELS, ("v_x",)),
    }
)  # fmt: skip
"""Channel -> what moves when it does."""

ENOUGH = 200  # samples that a judgement of them needs
CLIPPED = 0.005  # share of samples at the extreme: 1 s in 200 s
TIMES = 4.0  # as many at the extreme as near it; the rounded top of a signal in steps of any size has 1 (see `_at`)
NEAR = 0.02, 3.0  # what is near: share of the range, and steps of the channel
VISITS = 2  # of the extreme: one could be a manoeuvre that holds
FROZEN_S = 2.0  # [s]: slower than any bus repeats its message
HELD = 20.0  # times as long as the channel usually holds a value
MOVES = 0.15  # part of its own spread that half of a partner's samples cover meanwhile: a step of a coarse channel
STEPS = 10  # of the channel that its spread holds, below which its steps show as noise of a tenth of the spread
AGAIN = 5  # changes for each level: a manoeuvre goes through its few levels once or twice


def clipped(drive: Drive) -> Iterator[Finding]:
    """Channels of the motion that stay at their largest or smallest value again and again."""
    for name in MOTION:
        values = _known(drive, name)
        if len(values) < ENOUGH or np.ptp(values) == 0.0:
            continue
        for what, signed in (("largest", values), ("smallest", -values)):
            share, visits = _at(signed)
            if share > CLIPPED and visits >= VISITS:
                level = f"{signed.max() if what == 'largest' else -signed.max():.3g} {CHANNELS[name].unit}"
                yield Finding(
                    name, "clipped", f"{name} is at its {what}, {level}, in {share:.1%} of the time: is it clipped?"
                )
                break


def frozen(drive: Drive) -> Iterator[Finding]:
    """Channels that keep one value for long while what goes with them moves."""
    for name, partners in PARTNERS.items():
        series = drive.recording.series(name)
        if series is None:
            continue
        values = np.where(series[1], series[0], np.nan)
        same = np.concatenate([[False], np.abs(np.diff(values)) <= 1e-9 * (np.nanmax(np.abs(values), initial=0.0))])
        if name != "v_x":
            same &= _driving(drive)  # a car that stands is no contradiction
        held = runs(same)
        lengths = held[:, 1] - held[:, 0] + 1
        usual = float(np.median(lengths)) if len(lengths) > 4 else 1.0
        least = max(FROZEN_S * drive.rate, HELD * usual) if len(lengths) > 4 else FROZEN_S * drive.rate
        for (start, stop), length in zip(held, lengths, strict=True):
            moved = next((one for one in partners if length >= least and _moves(drive, one, start, stop)), None)
            if moved is not None:
                spoken = _spoken(moved)
                seconds, at = length / drive.rate, drive.recording.t[start - 1]
                what = f"{values[start]:.3g} {CHANNELS[name].unit} for {seconds:.3g} s from {at:.2f} s"
                yield Finding(name, "frozen", f"{name} stays at {what}, while {spoken} moves: is it frozen?")
                break


def coarse(drive: Drive) -> Iterator[Finding]:
    """Measured channels whose spread holds only a few of their steps."""
    for name in ("steering", "steering_wheel", "v_x", *MOTION, *WHEELS):
        values = _known(drive, name)
        if len(values) < ENOUGH:
            continue
        levels = _levels(values)
        low, high = np.quantile(values, [0.05, 0.95])
        inside = levels[(levels >= low - 1e-12) & (levels <= high + 1e-12)]
        if not 3 <= len(inside) <= STEPS:
            continue
        step = float(np.median(np.diff(inside)))
        changes = np.abs(np.diff(values))
        changes = changes[changes > 0.5 * step]
        if len(changes) < AGAIN * len(inside) or (name in STEERINGS and np.mean(changes < 1.5 * step) < ONE_STEP):
            continue
        unit = CHANNELS[name].unit
        yield Finding(
            name,
            "quantised",
            f"{name} moves in steps of {step:.2g} {unit} and 90% of it spans {len(inside) - 1} of them: is it rounded?",
        )


def _known(drive: Drive, name: str) -> Float[np.ndarray, " known"]:
    """The measured samples of a channel, those while the car moves where that is known."""
    series = drive.recording.series(name)
    if series is None:
        return np.zeros(0)
    speed = drive["v_x"]
    moving = np.abs(speed) > MOVING
    return series[0][series[1] & (moving if moving.any() else True)]


def _levels(values: Float[np.ndarray, " known"]) -> Float[np.ndarray, " levels"]:
    """The distinct values, those within 1e-6 of the range as one."""
    distinct = np.unique(values)
    apart = np.concatenate([[True], np.diff(distinct) > 1e-6 * max(float(np.ptp(values)), 1e-300)])
    return distinct[apart]


def _at(values: Float[np.ndarray, " known"]) -> tuple[float, int]:
    """Share of samples at the maximum and number of visits there; 0 where as many lie near it.

    The top of a signal of curvature k in steps of q lasts 2 sqrt(2 q/k), and its next three levels together as long.
    """
    levels = _levels(values)
    step = float(np.median(np.diff(levels))) if len(levels) > 1 else 0.0
    top, width = float(values.max()), max(NEAR[0] * float(np.ptp(values)), NEAR[1] * step)
    at = values >= top - 1e-6 * float(np.ptp(values))
    near = (values >= top - width) & ~at
    if at.sum() <= TIMES * near.sum():
        return 0.0, 0
    return float(at.mean()), len(runs(at))


def _driving(drive: Drive) -> Bool[np.ndarray, " time"]:
    """Where the car drives: not where it stands, and nowhere if its speed is not known at all."""
    speed = drive["v_x"]
    return (np.abs(speed) > MOVING) | (np.isnan(speed) & np.isfinite(speed).any())


def _moves(drive: Drive, name: str, start: int, stop: int) -> bool:
    """Whether a series covers a part of its usual spread between two samples, for more than a moment.

    Turns must go to both sides: with the steering held, they change with the speed and run out.
    """
    series = drive[name] if name in drive.series else _raw(drive, name)
    inside = series[start:stop][np.isfinite(series[start:stop])]
    if len(inside) < 5:
        return False
    spread = float(np.subtract(*np.nanquantile(series, [0.95, 0.05])))
    low, high = np.quantile(inside, [0.1, 0.9])
    if name == "turn" and not low < 0.0 < high:
        return False
    low, high = np.quantile(inside, [0.25, 0.75])
    return bool(high - low > MOVES * spread > 0.0)


def _raw(drive: Drive, name: str) -> Float[np.ndarray, " time"]:
    series = drive.recording.series(name)
    return np.full(len(drive.recording.t), np.nan) if series is None else np.where(series[1], series[0], np.nan)


def _spoken(name: str) -> str:
    return {"turning": "v_x times yaw_rate", "gaining": "dv_x/dt", "turn": "yaw_rate"}.get(name, name)
