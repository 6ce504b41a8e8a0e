"""Limits: what no vehicle's channel goes beyond, and samples that jump out and back."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.checks.drive import Finding, runs
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError

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

BROKEN = 0.1  # share of samples beyond a limit, from which it is the unit rather than the samples that is wrong, and
# nothing can be identified
RUN_S = 1.0  # [s] that a run of absurd samples lasts at most
JUMP, BACK = 10.0, 0.25  # times all but the largest usual changes, and of the jump that is not taken back
MOST_JUMPED = 0.02  # share of samples in such runs, from which it is what the channel does


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
    starts: Int[np.ndarray, " runs"] = runs(which)[:, 0]
    more = f" and {len(starts) - most} more" if len(starts) > most else ""
    return f"{int(which.sum())} samples from {', '.join(f'{t[k]:.2f}' for k in starts[:most])} s{more}"


def beyond_limits(recording: Recording) -> Iterator[Finding]:
    """Channels that lie beyond what they can be too often for single samples to be wrong."""
    for name in recording.channels:
        share = _share_beyond(recording, name)
        if share > BROKEN:
            yield Finding(name, "unit", f"{_beyond(name, share)}: is its unit {CHANNELS[name].unit}?")


def refuse_impossible(recording: Recording, used: Iterable[str]) -> None:
    """InputError for the first of the channels that are used that lies too often beyond what any vehicle can be."""
    for name in used:
        share = _share_beyond(recording, name)
        if share > BROKEN:
            raise InputError(
                f"{recording.source}: {_beyond(name, share)}, which no car reaches: is its unit {CHANNELS[name].unit}? "
                "`inspect` says more"
            )


def _share_beyond(recording: Recording, name: str) -> float:
    """Of a channel's samples, those beyond its limit; 0 where it is not recorded."""
    values = recording.channels.get(name, np.zeros(0))
    finite = values[np.isfinite(values)]
    return float(np.mean(np.abs(finite) > LIMITS.get(name, np.inf))) if len(finite) else 0.0


def _beyond(name: str, share: float) -> str:
    return f"{name} is beyond {LIMITS[name]:g} {CHANNELS[name].unit} in {share:.0%} of the time"
