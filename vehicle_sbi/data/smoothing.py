"""A signal as the car made it: without the noise of its sensor, and without the steps of a slow update."""

from typing import cast

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import dct, idct
from scipy.optimize import OptimizeResult, minimize_scalar
from scipy.signal import savgol_filter

from vehicle_sbi.errors import InputError

SMOOTHING_S = 0.25
"""Length [s] of the Savitzky-Golay filter (order 2) behind the initial states."""

SLOPE_S = 0.45
"""Length [s] of the one (order 3) behind v_x_dot."""

LEAST_DENOISED = 50
"""Samples, of fewer of which noise is not told."""

PENALTIES = (-3.0, 9.0)
"""Decades of the penalty on second differences: from none, to what leaves waves of 600 samples."""

MOST_HELD = 20
"""Samples for which a held signal usually stays, at most: one that stays for longer is at rest."""

ONE_STEP = 0.8
"""Share of changes by a single step, from which a signal's levels are a sensor's."""


def smoothed(values: Float[np.ndarray, " time"], rate: float, where: str) -> Float[np.ndarray, " time"]:
    """Savitzky-Golay smoothing (order 2, `SMOOTHING_S` and at least 5 samples) of `values`.

    Absent samples are bridged linearly. Exact for parabolas. Raises InputError for fewer samples than the filter has.
    (Savitzky and Golay, Analytical Chemistry 36, 1964.)
    """
    return _filtered(values, rate, where, SMOOTHING_S, order=2, derivative=0)


def slope(values: Float[np.ndarray, " time"], rate: float, where: str) -> Float[np.ndarray, " time"]:
    """Derivative of `values` by the same filter, as long as `SLOPE_S` and exact for cubics.

    It takes 1 % off what a car does at 1 Hz and 12 % at 2 Hz. Of quick drives whose speed has white noise of 0.01 m/s
    and was `denoised` before, it is off by 0.017 m/s^2.
    """
    return _filtered(values, rate, where, SLOPE_S, order=3, derivative=1)


def _filtered(
    values: Float[np.ndarray, " time"], rate: float, where: str, seconds: float, *, order: int, derivative: int
) -> Float[np.ndarray, " time"]:
    length = max(5, 2 * round(0.5 * seconds * rate) + 1)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) == 0 or len(values) < length:
        raise InputError(f"{where}: {len(known)} samples at {rate:g} Hz are too few; at least {length} are needed")
    bridged = np.interp(np.arange(len(values)), known, values[known])
    found = np.asarray(savgol_filter(bridged, length, order, deriv=derivative, delta=1.0 / rate))
    for piece in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(piece) >= length:  # by itself: what bridges a gap is not what the car did
            found[piece] = savgol_filter(values[piece], length, order, deriv=derivative, delta=1.0 / rate)
    return found


def denoised(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """A signal without white noise: penalised by its second differences as much as generalised cross-validation says.

    Noise of an input bends what is inferred: a model that answers less to quick steering then fits better. A signal
    without noise stays as it is. Absent samples remain absent. (Garcia, Computational Statistics & Data Analysis 54,
    2010: the cosine transform makes the penalty diagonal.)
    """
    known = np.isfinite(values)
    if known.sum() < LEAST_DENOISED:
        return values
    x = np.asarray(dct(np.interp(np.arange(len(values)), np.flatnonzero(known), values[known]), norm="ortho"))
    roughness = (2.0 - 2.0 * np.cos(np.pi * np.arange(len(x)) / len(x))) ** 2

    def cross_validated(log_penalty: float) -> float:
        kept = 1.0 / (1.0 + 10.0**log_penalty * roughness)
        return float(np.mean(((1.0 - kept) * x) ** 2) / max(1.0 - kept.mean(), 1e-12) ** 2)

    best = cast(OptimizeResult, minimize_scalar(cross_validated, bounds=PENALTIES, method="bounded")).x
    smooth = np.asarray(idct(x / (1.0 + 10.0**best * roughness), norm="ortho"))
    return np.where(known, smooth, np.nan)


def unheld(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    """A signal that is updated more slowly than it is sampled, linear between its updates instead of in steps.

    Steps that the car did not make would excite the model. A signal counts as held if it usually stays for two samples
    or more while it moves, and is not `_rounded`; where it rests for longer than that it stays at rest until the last
    usual step. Absent samples remain absent, and any other signal as it is.
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 3:
        return values
    x = values[known]
    updates = np.concatenate([[0], np.flatnonzero(np.diff(x)) + 1])
    if len(updates) < MOST_HELD:
        return values
    usual = int(np.median(np.diff(updates)))
    if not 2 <= usual <= MOST_HELD or _rounded(x, updates):
        return values
    rests = updates[1:][np.diff(updates) > 2 * usual] - usual  # until when a long rest lasts
    knots = np.union1d(np.union1d(updates, rests), [len(x) - 1])
    smooth = values.copy()
    smooth[known] = np.interp(np.arange(len(x)), knots, x[knots])
    return smooth


def _rounded(x: Float[np.ndarray, " known"], updates: Int[np.ndarray, " n"]) -> bool:
    """Whether a signal changes by one step of its sensor at a time, whenever it passes from one level to the next.

    There it is half a step off its level, and not at it, as a signal is that has just been updated. Updates come at
    equal times, but for a sample; the passages of levels do so only where a signal grows at a constant rate.
    """
    changes, lengths = np.abs(np.diff(x[updates])), np.diff(updates[1:])
    single = float(np.mean(changes < 1.5 * np.quantile(changes, 0.05)))
    return single >= ONE_STEP and float(np.ptp(np.quantile(lengths, [0.1, 0.9]))) > 1.0
