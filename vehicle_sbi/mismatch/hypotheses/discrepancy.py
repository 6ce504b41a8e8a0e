"""Discrepancy: loads and errors that no effect of the catalogue stands for, as columns of a linear model.

Each target (a force along x or y, a moment about z, the road wheels' angle, each channel's sensor) may be off along
the drive's signals, or on a smooth course of its own (after Kennedy and O'Hagan 2001). A group's columns are the
singular directions of what that does to the series, so that one amplitude, in physical units, says how large it is.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import STEADY, Law, Target, law_slopes, signals, targets
from vehicle_sbi.mismatch.locate import bump, clock

ALONG_SIGNALS = 10  # columns at most of a target that is off along the drive's signals
STRETCH_S = 0.75  # [s] between the middles of neighbouring stretches of a course of its own
STRETCHES = (12, 40)  # at least and at most
LEAST = 1e-2  # singular value over the largest one, below which a direction is left out


@dataclass(frozen=True)
class Discrepancy:
    """One target's columns: `series` (q, channels, time) in the channels' units and `whitened` (q, samples), both per
    the largest size that the target may have."""

    target: Target
    kind: str
    series: Float[np.ndarray, "q channels time"]
    whitened: Float[np.ndarray, "q samples"]


def discrepancies(fit: Fit) -> list[Discrepancy]:
    """Every target, along the drive's signals and on a course of its own, about a fit."""
    acting = targets(fit.simulator, fit.at.y)
    courses = signals(fit.simulator, fit.theta, {})
    along = {name: course for name, course in courses.items() if np.std(course) > STEADY}
    return [
        *_groups(fit, acting, "along the drive's signals", along, columns=ALONG_SIGNALS, scale=len(along) ** -0.5),
        *_groups(fit, acting, "on a course of its own", _stretches(fit), columns=STRETCHES[1], scale=1.0),
    ]


def _stretches(fit: Fit) -> dict[str, Float[np.ndarray, "windows time"]]:
    """Bumps that overlap by half, over all of the recordings' time."""
    t = clock(fit.simulator)
    seconds = float(np.ptp(t))
    number = int(np.clip(seconds / (2.0 * STRETCH_S), *STRETCHES))
    length = 2.0 * seconds / (number + 1)
    starts = t.min() + 0.5 * length * np.arange(number)
    shape = fit.simulator.windows.t.shape
    return {f"stretch {k}": bump(t, start, start + length).reshape(shape) for k, start in enumerate(starts)}


def _groups(
    fit: Fit,
    acting: list[Target],
    kind: str,
    courses: dict[str, Float[np.ndarray, "windows time"]],
    *,
    columns: int,
    scale: float,
) -> list[Discrepancy]:
    """A group for each target: at most so many singular directions of what all courses do."""
    given = [Law(target, name, course) for target in acting for name, course in courses.items()]
    slopes = law_slopes(fit.simulator, fit.theta, fit.at.y, given)
    by_target = slopes.reshape(len(acting), len(courses), *fit.at.y.shape)
    return [
        _group(fit, target, kind, scale * target.size.high * rows, columns)
        for target, rows in zip(acting, by_target, strict=True)
    ]


def _group(
    fit: Fit, target: Target, kind: str, rows: Float[np.ndarray, "k channels time"], columns: int
) -> Discrepancy:
    white = fit.metric(rows).reshape(len(rows), -1)
    left, size, right = np.linalg.svd(white, full_matrices=False)
    kept = max(min(columns, int((size > LEAST * size[0]).sum())), 1)
    series = np.tensordot(left[:, :kept].T, np.nan_to_num(rows), axes=1)
    return Discrepancy(target, kind, series, size[:kept, None] * right[:kept])
