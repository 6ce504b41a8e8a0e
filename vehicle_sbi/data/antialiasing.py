"""What a coarser grid cannot show, taken off a series before it is laid on the grid.

A line above half of the grid's rate would come back as a slow one: 49.3 Hz sampled at 50 Hz are 0.7 Hz. A Butterworth
low-pass of fourth order, run forward and backward (Gustafsson, IEEE Trans. Signal Processing 44, 1996), has no phase.
It leaves 1 / (1 + (f / cutoff)^8) of an amplitude: 99.9 % at 0.4 of the cutoff, half at it, 0.07 % at the grid's rate.
"""

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfiltfilt

CUTOFF = 0.4
"""Frequency at which half of an amplitude is left, in rates of the grid."""

FASTER = 1.05
"""A clock is faster than a grid if its rate is more than this many times the grid's; rates of equal clocks jitter."""

ORDER = 4
SETTLED = 3.0  # periods of the cutoff that the filter takes to settle


def is_faster(step: float, rate: float) -> bool:
    """Whether a clock with this usual step [s] is faster than a grid of this rate [Hz]."""
    return step * rate * FASTER < 1.0


def low_passed(
    t: Float[np.ndarray, " rows"], values: Float[np.ndarray, " rows"], rate: float, longest_gap: float
) -> Float[np.ndarray, " rows"]:
    """Values without what a grid of `rate` [Hz] cannot show, each piece between gaps over `longest_gap` [s] alone."""
    ends = np.flatnonzero(np.diff(t) > longest_gap) + 1
    pieces = zip(np.split(t, ends), np.split(values, ends), strict=True)
    return np.concatenate([_piece(*piece, rate) for piece in pieces])


def _piece(
    t: Float[np.ndarray, " rows"], values: Float[np.ndarray, " rows"], rate: float
) -> Float[np.ndarray, " rows"]:
    """A piece without gaps, low-passed on even steps as its clock may jitter; as it is if too short to tell or slow.

    The line between its ends is left out of the filter, so that straight lines stay exact.
    """
    if len(t) < 2 or not is_faster((t[-1] - t[0]) / (len(t) - 1), rate):
        return values
    even = np.linspace(t[0], t[-1], len(t))
    own_rate = (len(t) - 1) / (t[-1] - t[0])
    cutoff = CUTOFF * rate
    settling = int(np.ceil(SETTLED * own_rate / cutoff))
    if len(t) <= settling:
        return values
    line = np.interp(even, t[[0, -1]], values[[0, -1]])
    sections = butter(ORDER, cutoff, fs=own_rate, output="sos")
    smooth = sosfiltfilt(sections, np.interp(even, t, values) - line, padlen=settling) + line
    return np.interp(t, even, smooth)
