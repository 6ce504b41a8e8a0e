"""Discrepancy: loads and errors that no effect of the catalogue stands for, as columns of a linear model.

Each target (a force along x or y, a moment about z, the road wheels' angle, each channel's sensor) may be off along
the drive's signals, or on a smooth course of its own (after Kennedy and O'Hagan 2001). Courses are about their means:
what does not change is the catalogue's (a bank, a side wind, an offset, a bias). A group's columns are the singular
directions of what that does to the series, so that one amplitude, in physical units, says how large it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.block import bump, clock
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief
from vehicle_sbi.mismatch.hypotheses.regressor import Law, Target, law_slopes, signals, targets

ALONG_SIGNALS = 10  # columns at most of a target that is off along the drive's signals
STRETCH_S = 0.75  # [s] between the middles of neighbouring stretches of a course of its own
STRETCHES = (12, 40)  # at least and at most
LEAST = 1e-2  # singular value over the largest one, below which a direction is left out
NOTHING = 0.03  # of the smallest amplitude, which stands for none; less costs the sampler its digits
AMPLITUDES = np.geomspace(0.03, 3.0, 5)  # in units of the scale that is believed of them


@dataclass(frozen=True)
class Discrepancy:
    """One target's columns: `series` (q, channels, time) in the channels' units, `whitened` (q, samples), and `course`
    (q, time) of the load or error itself in the target's unit, all per unit of a coefficient."""

    target: Target
    kind: str
    series: Float[np.ndarray, "q channels time"]
    whitened: Float[np.ndarray, "q samples"]
    course: Float[np.ndarray, "q time"]

    def believed(self, prior: EffectPrior) -> Belief:
        """Its amplitude on a grid, log-uniform and cut off, of either sign."""
        return believed(len(self.series), prior)


class Source(Protocol):
    """Of a discrepancy: found about one fit, it has columns about any other."""

    def about(self, fit: Fit) -> Discrepancy:
        """As columns of a linear model, under the noise of a fit."""
        ...


@dataclass(frozen=True)
class Response:
    """What one target does to the series that is off along each of some courses: `changes` (k, channels, time) and
    `courses` (k, time), per the largest size that it may have; `columns` at most are to stand for all of them."""

    target: Target
    kind: str
    changes: Float[np.ndarray, "k channels time"]
    courses: Float[np.ndarray, "k time"]
    columns: int

    def about(self, fit: Fit) -> Discrepancy:
        """At most so many singular directions of what the courses do."""
        white = fit.metric(self.changes).reshape(len(self.changes), -1)
        left, size, right = np.linalg.svd(white, full_matrices=False)
        kept = max(min(self.columns, int((size > LEAST * size[0]).sum())), 1)
        along = left[:, :kept].T
        series = np.tensordot(along, self.changes, axes=1)
        return Discrepancy(self.target, self.kind, series, size[:kept, None] * right[:kept], along @ self.courses)


def responses(fit: Fit) -> list[Response]:
    """Of every target, along the drive's signals and on a course of its own, simulated about a fit.

    They hardly depend on where the fit is.
    """
    acting, along = targets(fit.simulator, fit.at.y), signals(fit.simulator, fit.theta)
    return [
        *_responses(fit, acting, "along the drive's signals", along, columns=ALONG_SIGNALS, scale=len(along) ** -0.5),
        *_responses(fit, acting, "on a course of its own", _stretches(fit), columns=STRETCHES[1], scale=1.0),
    ]


def believed(columns: int, prior: EffectPrior) -> Belief:
    """A discrepancy of so many columns: of either sign, its amplitude on a grid that is even in its logarithm, cut off
    as a normal density is."""
    share = np.exp(-0.5 * AMPLITUDES**2)
    return Belief(
        named=False,
        rate=prior.discrepancy,
        nothing=NOTHING * prior.scale * AMPLITUDES[0],
        amplitude=prior.scale * AMPLITUDES,
        share=share / share.sum(),
        low=np.full(columns, -np.inf),
        high=np.full(columns, np.inf),
    )


def parts(coefficient: Float[np.ndarray, "n columns"], here: Sequence[Discrepancy]) -> list[Float[np.ndarray, "n _"]]:
    """Coefficients of each discrepancy, of columns that begin with theirs."""
    ends = np.cumsum([len(one.series) for one in here])
    return np.split(coefficient[:, : ends[-1]], ends[:-1], axis=1)


def _stretches(fit: Fit) -> dict[str, Float[np.ndarray, "windows time"]]:
    """Bumps that overlap by half, over all of the recordings' time."""
    t = clock(fit.simulator)
    seconds = float(np.ptp(t))
    number = int(np.clip(seconds / (2.0 * STRETCH_S), *STRETCHES))
    length = 2.0 * seconds / (number + 1)
    starts = t.min() + 0.5 * length * np.arange(number)
    shape = fit.simulator.windows.t.shape
    return {f"stretch {k}": bump(t, start, start + length).reshape(shape) for k, start in enumerate(starts)}


def _responses(
    fit: Fit,
    acting: list[Target],
    kind: str,
    courses: dict[str, Float[np.ndarray, "windows time"]],
    *,
    columns: int,
    scale: float,
) -> list[Response]:
    """Of each target, `scale` being the share of its largest size in each course."""
    courses = {name: course - course.mean() for name, course in courses.items()}
    given = [Law(target, name, course) for target in acting for name, course in courses.items()]
    slopes = np.nan_to_num(law_slopes(fit.simulator, fit.theta, fit.at.y, given))
    by_target = slopes.reshape(len(acting), len(courses), *fit.at.y.shape)
    course = np.array([*courses.values()]).reshape(len(courses), -1)
    sizes = [scale * target.size.high for target in acting]
    return [
        Response(target, kind, size * rows, size * course, columns)
        for target, size, rows in zip(acting, sizes, by_target, strict=True)
    ]


@dataclass(frozen=True)
class Remainder:
    """What a target is off by beside all effects: the course (time) of the load or error in its unit, on average over
    draws; its root mean square in each draw; how far the recording shows it, in standard deviations of the noise; the
    signal of the drive that the course follows best and the square of their correlation; and how probable any is."""

    target: Target
    course: Float[np.ndarray, " time"]
    rms: Float[np.ndarray, " n"]
    shown: float
    signal: str
    followed: float
    probability: float


def remainders(
    fit: Fit,
    here: Sequence[Discrepancy],
    coefficient: Float[np.ndarray, "n columns"],
    there: Bool[np.ndarray, "n groups"],
) -> list[Remainder]:
    """Of each target, what draws of the discrepancies' coefficients say, the one that shows most first."""
    own = parts(coefficient, here)
    courses = {name: course.reshape(-1) for name, course in signals(fit.simulator, fit.theta).items()}
    of_target: dict[str, list[int]] = {}
    for k, one in enumerate(here):
        of_target.setdefault(one.target.name, []).append(k)
    found = [
        _remainder([here[k] for k in ks], [own[k] for k in ks], there[:, ks], courses) for ks in of_target.values()
    ]
    return sorted(found, key=lambda one: -one.shown)


def _remainder(
    groups: Sequence[Discrepancy],
    own: Sequence[Float[np.ndarray, "n _"]],
    there: Bool[np.ndarray, "n groups"],
    courses: dict[str, Float[np.ndarray, " time"]],
) -> Remainder:
    """Of one target, all of its groups together."""
    columns, c = np.concatenate([one.course for one in groups]), np.concatenate(own, axis=1)
    products = columns @ columns.T / columns.shape[1]
    course = c.mean(axis=0) @ columns
    rms = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", c, products, c, optimize=True), 0.0))
    white = c.mean(axis=0) @ np.concatenate([one.whitened for one in groups])
    names, spread = [*courses], np.std(course)
    alike = [float(np.corrcoef(course, courses[name])[0, 1] ** 2) if spread > 0.0 else 0.0 for name in names]
    best = int(np.argmax(alike))
    shown, probability = float(np.linalg.norm(white)), float(there.any(axis=1).mean())
    return Remainder(groups[0].target, course, rms, shown, names[best], alike[best], probability)
