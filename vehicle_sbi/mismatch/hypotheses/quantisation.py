"""Does a channel read in steps: an error that rounds what the model says was there to the steps of the sensor.

    error = s round(y / s) - y

for steps s from most of the noise on to a sixth of the channel's range, so closely spaced that one of them stays in
phase with the true one as far as the channel goes. Noise as large as a step hides it from the eye, but not from a
thousand samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import LEAST_VARIANCE, Linearised

FINEST = 0.7  # standard deviations of the noise, below which a step cannot be seen
COARSEST = 1 / 6  # of the channel's range; what is coarser is slow enough for other laws
PHASE = 0.05  # of a step by which the nearest one is off where the channel is farthest from zero
MOST = 4e6  # steps times samples, for time and memory's sake; of more, the coarser steps
CHUNK = 200  # of steps at once


@dataclass(frozen=True)
class Staircase:
    """Steps that one channel may read in, and what the fitted model says it read."""

    about: Linearised
    channel: int
    said: Float[np.ndarray, " time"]
    steps: Float[np.ndarray, " n"]

    @classmethod
    def of_each(cls, about: Linearised) -> "list[Staircase]":
        """Of every channel whose range is wide enough, in units of its noise."""
        fit = about.fit
        said, valid = predicted(fit), fit.simulator.windows.valid
        found = []
        for c in np.flatnonzero(valid.any(axis=1)):
            steps = _steps(said[c, valid[c]], float(fit.metric.std[c].mean()))
            if len(steps):
                found.append(cls(about, int(c), said[c], steps))
        return found

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """Log likelihood that the best step gains in each series."""
        series = self._innovations(e[:, self.channel])
        std = np.sqrt(np.maximum(np.mean(series**2, axis=1), LEAST_VARIANCE))
        best = (series.astype(np.float32) @ self._errors.T).max(axis=1).astype(float)
        return 0.5 * np.maximum(best / std, 0.0) ** 2

    @cached_property
    def _errors(self) -> Float[np.ndarray, "n neighbours"]:
        """Of each step its error as innovations of length 1, in single precision."""
        errors = []
        for steps in np.array_split(self.steps, -(-len(self.steps) // CHUNK)):
            error = self._innovations(rounding(self.said, steps[:, None]))
            norm = np.sqrt(np.maximum(np.sum(error**2, axis=1), LEAST_VARIANCE))
            errors.append((error / norm[:, None]).astype(np.float32))
        return np.concatenate(errors)

    def _innovations(self, series: Float[np.ndarray, "n time"]) -> Float[np.ndarray, "n neighbours"]:
        rho = self.about.fit.simulator.noise.rho[self.channel]
        runs = [(run, slice(run.start - 1, run.stop - 1)) for run in self.about.runs[self.channel]]
        return np.concatenate([series[:, now] - rho * series[:, before] for now, before in runs], axis=1)


@dataclass(frozen=True)
class Staircases:
    """All channels that may read in steps, to test them together."""

    each: Sequence[Staircase]

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """Log likelihood that the best step of any channel gains in each series."""
        return np.max([np.zeros(len(e)), *(one.gains(e) for one in self.each)], axis=0)


def together(about: Linearised) -> list[Staircases]:
    """Whether any channel reads in steps."""
    return [Staircases(Staircase.of_each(about))]


def rounding(said: Float[np.ndarray, "*#n time"], step: float | Float[np.ndarray, "*#n 1"]) -> np.ndarray:
    """The error of a sensor that rounds to steps."""
    return step * np.round(said / step) - said


def predicted(fit: Fit) -> Float[np.ndarray, "channels time"]:
    """What was there, as far as the model can tell: its series with the likeliest initial states."""
    return fit.at.y + fit.metric.states(fit.residual, fit.at)


def _steps(said: Float[np.ndarray, " time"], std: float) -> Float[np.ndarray, " n"]:
    """Steps in inverse proportion, the coarsest first; none where the range is too small."""
    coarsest, finest = COARSEST * float(np.ptp(said)), FINEST * std
    if not finest < coarsest:
        return np.zeros(0)
    spacing = 2.0 * PHASE / float(np.abs(said).max())
    number = min((1.0 / finest - 1.0 / coarsest) / spacing, MOST / len(said))
    return 1.0 / (1.0 / coarsest + spacing * np.arange(max(int(number), 1)))
