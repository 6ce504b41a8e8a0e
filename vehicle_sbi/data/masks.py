"""Which part of a recording is used, and what for: the liveliest stretches, blocks to fit and blocks to hold out.

A part is the recording itself on its own grid, with the samples of all other parts absent.
"""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError

LIVELINESS = (("steering", "steering_wheel"), ("v_x", "wheel_speed_rear", "wheel_speed_front"))
"""Channels whose variance is liveliness, of steering and of speed; of each the first one that is recorded."""


def liveliest(recording: Recording, share: float, *, stretch_s: float = 60.0) -> Recording:
    """The recording with nothing but the stretches in which steering and speed change most, `share` of its time.

    A stretch of about `stretch_s` [s] is as lively as its variances of the two are large, in units of the whole
    recording's. The steering wheel stands for the steering and the wheels' speed for the car's where that is all there
    is. A `share` of 1 or more returns the recording as it is.
    """
    if share >= 1.0:
        return recording
    n = len(recording.t)
    count = max(round(n / recording.rate / stretch_s), math.ceil(1.0 / share))
    stretch = np.arange(n) * count // n
    kept = np.argsort(-_liveliness(recording, stretch, count), kind="stable")[: max(int(share * count), 1)]
    keep = np.isin(stretch, kept)
    return recording.masked(keep, f"{keep.mean():.0%} of the time used: where steering and speed change most")


def _liveliness(recording: Recording, stretch: Int[np.ndarray, " time"], count: int) -> Float[np.ndarray, " count"]:
    """Variance of steering and speed in each stretch, in units of the whole recording's; `stretch` is each sample's."""
    lively = np.zeros(count)
    for names in LIVELINESS:
        recorded = _first(recording, names)
        if recorded is None:
            continue
        values, valid = np.nan_to_num(recorded[0]), recorded[1]
        variance = pd.Series(values[valid]).groupby(stretch[valid]).var(ddof=0).reindex(range(count), fill_value=0.0)
        lively += np.nan_to_num(variance.to_numpy()) / max(float(np.var(values[valid])), 1e-12)
    return lively


def liveliest_of(recordings: Sequence[Recording], most: int) -> list[int]:
    """Which recordings, in their order, have the largest variances of steering and speed, `most` of them at most."""
    if len(recordings) <= most:
        return list(range(len(recordings)))
    variances = np.array([[_variance(one, names) for names in LIVELINESS] for one in recordings])
    lively = (variances / np.maximum(variances.mean(axis=0), 1e-12)).sum(axis=1)
    return sorted(np.argsort(-lively, kind="stable")[:most].tolist())


def _variance(recording: Recording, names: Sequence[str]) -> float:
    """Of the first of these channels that was recorded; 0 without."""
    recorded = _first(recording, names)
    return float(np.var(recorded[0][recorded[1]])) if recorded is not None and recorded[1].any() else 0.0


def _first(
    recording: Recording, names: Sequence[str]
) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]] | None:
    """Values and validity of the first of these channels that was recorded."""
    return next((series for name in names if (series := recording.series(name)) is not None), None)


def holdout(
    recording: Recording, *, share: float = 0.25, block_s: float = 10.0, buffer_s: float = 1.0
) -> tuple[Recording, Recording]:
    """(training, held out): alternating blocks in time, on the same grid, each with the other's samples absent.

    About `share` of the blocks of `block_s` [s] (shorter ones in a short recording) is held out. The training part
    also lacks `buffer_s` [s] on either side of them, so that nothing correlated lies in both. Raises InputError for
    a share outside (0, 1) or a buffer that leaves no training sample.
    """
    if not (0.0 < share < 1.0 and block_s > 0.0 and buffer_s >= 0.0):
        raise InputError(
            f"{recording.source}: holdout needs 0 < share < 1, block_s > 0 and buffer_s >= 0, "
            f"given {share:g}, {block_s:g} and {buffer_s:g}"
        )
    n = len(recording.t)
    blocks = max(round(n / recording.rate / block_s), math.ceil(1.0 / min(share, 1.0 - share)))
    turns = np.diff(np.floor(np.arange(blocks + 1) * share + 0.5)) > 0  # evenly spread over the blocks
    held = turns[np.arange(n) * blocks // n]
    near = _widened(held, round(buffer_s * recording.rate))
    if near.all():
        raise InputError(f"{recording.source}: a buffer of {buffer_s:g} s leaves nothing to train on; make it shorter")
    note = f"{held.mean():.0%} of the time held out in {turns.sum()} of {blocks} blocks, buffer {buffer_s:g} s"
    return recording.masked(~near, f"training part: {note}"), recording.masked(held, f"held-out part: {note}")


def _widened(mask: Bool[np.ndarray, " time"], samples: int) -> Bool[np.ndarray, " time"]:
    """Where `mask` is true at most `samples` away."""
    return np.convolve(mask, np.ones(2 * samples + 1))[samples : samples + len(mask)] > 0.5
