"""What sets in at a moment and stays: a load or an error of one size from then on, and none before.

    series = model + a (what the target at 1 does from t_0 on),   t_0 at every half tile of the recordings' time

So does a brake that begins to drag, a tyre that loses its pressure, a sensor that is knocked. The evidence is averaged
over moments, more of which are tried about the likeliest, and integrated over the size.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import extent, tile
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.detect import uniform_evidence
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import Law, Target, law_slopes, targets
from vehicle_sbi.mismatch.linear import LEAST_VARIANCE, Linearised, profile
from vehicle_sbi.mismatch.locate import Stretch, clock, own_time

FINER = 10  # moments that the likeliest one of the coarser ones is divided into


@dataclass(frozen=True)
class Onset:
    """A target that is off by a size from a moment on: `start_s` on the clock of the recordings one after another, and
    `within` in their own; `std` are how uncertain the two are.

    `gain` is the log evidence that it gains beside a fit, one of so many `choice` that were weighed.
    """

    target: Target
    start_s: float
    start_std: float
    size: float
    std: float
    gain: float
    choice: int
    within: list[Stretch]
    signal: str = "sets in and stays"

    def rows(self, fit: Fit) -> Float[np.ndarray, "0 channels time"]:
        """Nothing: what set in at a moment of these recordings is not foretold of others."""
        return np.zeros((0, *fit.at.y.shape))


@dataclass(frozen=True)
class Tried:
    """A target at some moments: its likeliest size, the information about it and the log evidence of each."""

    starts: Float[np.ndarray, " n"]
    size: Float[np.ndarray, " n"]
    information: Float[np.ndarray, " n"]
    evidence: Float[np.ndarray, " n"]


def onsets(about: Linearised) -> Iterator[Onset]:
    """Every target at its likeliest moment."""
    fit = about.fit
    acting = targets(fit.simulator, fit.at.y)
    for target in acting:
        tried = refined(about, target, at(about, target, moments(fit.simulator)))
        gain = float(np.logaddexp.reduce(tried.evidence))
        weight, k = np.exp(tried.evidence - gain), int(np.argmax(tried.evidence))
        start, size = float(tried.starts[k]), float(tried.size[k])
        spread = weight @ (tried.starts - weight @ tried.starts) ** 2
        start_std = float(np.sqrt(spread + _spacing(fit.simulator) ** 2 / 12.0))  # it may lie between two of them
        std = float(tried.information[k] ** -0.5)
        within = own_time(fit.simulator, start, np.inf)
        yield Onset(target, start, start_std, size, min(std, target.size.high), gain, len(acting), within)


def at(about: Linearised, target: Target, starts: Float[np.ndarray, " n"]) -> Tried:
    """A target at moments of which each is as likely beforehand; log evidence includes that."""
    low, high = (np.full((len(starts), 1), end) for end in (target.size.low, target.size.high))
    found = profile(about, changes(about.fit, target, starts)[:, None], low, high)
    information = np.maximum(found.information[:, 0, 0], LEAST_VARIANCE)
    gain = np.maximum(found.log_likelihood - about.alone, 0.0)
    evidence = uniform_evidence(gain, found.size[:, 0], information, low[:, 0], high[:, 0])
    return Tried(starts, found.size[:, 0], information, evidence - np.log(len(starts)))


def refined(about: Linearised, target: Target, coarse: Tried) -> Tried:
    """With the likeliest moment replaced by several, which share the time that it stands for."""
    k, spacing = int(np.argmax(coarse.evidence)), _spacing(about.fit.simulator)
    fine = at(about, target, coarse.starts[k] + spacing * (np.arange(FINER) - 0.5 * (FINER - 1)))
    pairs = [
        (coarse.starts, fine.starts),
        (coarse.size, fine.size),
        (coarse.information, fine.information),
        (coarse.evidence, fine.evidence - np.log(len(coarse.starts))),
    ]
    return Tried(*(np.concatenate([np.delete(a, k), b]) for a, b in pairs))


def _spacing(simulator: Simulator) -> float:
    """Of the moments [s] that are tried about the likeliest."""
    return 0.5 * tile(simulator) / FINER


def moments(simulator: Simulator) -> Float[np.ndarray, " n"]:
    """At which something may set in [s]: every half tile, but for the first and the last, where nobody could tell."""
    half = 0.5 * tile(simulator)
    return np.arange(half, extent(simulator) - 0.5 * half, half)


def changes(fit: Fit, target: Target, starts: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n channels time"]:
    """What a target of size 1 does to the series from each moment on."""
    simulator, t = fit.simulator, clock(fit.simulator)
    courses = [(t >= start).astype(float).reshape(simulator.windows.t.shape) for start in starts]
    given = [Law(target, f"from {start} s", course) for start, course in zip(starts, courses, strict=True)]
    return law_slopes(simulator, fit.theta, fit.at.y, given)
