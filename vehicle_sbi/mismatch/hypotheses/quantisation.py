"""Does a channel read in steps: an error that rounds what the model says was there to the steps of the sensor.

    error = s round(y / s) - y

for steps s from most of the noise on to a sixth of the channel's range, so closely spaced that one of them stays in
phase with the true one as far as the channel goes. Noise as large as a step hides it from the eye, but not from a
thousand samples.

Beside effects, the likeliest step of each channel is sampled, by a column that is the error itself. What is believed of
all steps together is so much less for that one as the others are less likely than it on average.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import LEAST_VARIANCE, Linearised
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief
from vehicle_sbi.mismatch.hypotheses.regressor import Target, size_of_latent
from vehicle_sbi.physics.sensors import MEASUREMENTS

FINEST = 0.7  # standard deviations of the noise, below which a step cannot be seen
COARSEST = 1 / 6  # of the channel's range; what is coarser is slow enough for other laws
PHASE = 0.05  # of a step by which the nearest one is off where the channel is farthest from zero
MOST = 4e6  # steps times samples, for time and memory's sake; of more, the coarser steps
CHUNK = 200  # of steps at once
NOTHING = 1e-2  # coefficient that stands for no steps; less costs the sampler its digits


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

    @property
    def likeliest(self) -> tuple[float, float]:
        """The step that explains most of the residual, and the mean likelihood of all steps in units of its own."""
        series = self._innovations(self.about.residual[:, self.channel])
        std = np.sqrt(np.maximum(np.mean(series**2), LEAST_VARIANCE))
        along = (series.astype(np.float32) @ self._errors.T)[0].astype(float) / std
        size = self._sizes / std
        gained = (along - 0.5 * size) * size
        return float(self.steps[np.argmax(gained)]), float(np.exp(gained - gained.max()).mean())

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """Log likelihood that the best step gains in each series."""
        series = self._innovations(e[:, self.channel])
        std = np.sqrt(np.maximum(np.mean(series**2, axis=1), LEAST_VARIANCE))
        best = (series.astype(np.float32) @ self._errors.T).max(axis=1).astype(float)
        return 0.5 * np.maximum(best / std, 0.0) ** 2

    @property
    def _errors(self) -> Float[np.ndarray, "steps neighbours"]:
        """Of each step its error as innovations of length 1, in single precision."""
        return self._measured[0]

    @property
    def _sizes(self) -> Float[np.ndarray, " steps"]:
        """Of each step the length of its error as innovations."""
        return self._measured[1]

    @cached_property
    def _measured(self) -> tuple[Float[np.ndarray, "steps neighbours"], Float[np.ndarray, " steps"]]:
        """Directions and lengths of all steps' errors, some steps after others for memory's sake."""
        directions, sizes = [], []
        for steps in np.array_split(self.steps, -(-len(self.steps) // CHUNK)):
            errors = self._innovations(rounding(self.said, steps[:, None]))
            sizes.append(np.sqrt(np.maximum(np.sum(errors**2, axis=1), LEAST_VARIANCE)))
            directions.append((errors / sizes[-1][:, None]).astype(np.float32))
        return np.concatenate(directions), np.concatenate(sizes)

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


@dataclass(frozen=True)
class InSteps(Discrepancy):
    """A channel that reads in steps, by its error itself, so that a coefficient of 1 says that it does; `share` of what
    is believed of all steps together is about this one."""

    share: float

    def believed(self, prior: EffectPrior) -> Belief:
        """That the channel reads in these steps."""
        return believed(self.share, prior)


@dataclass(frozen=True)
class Reading:
    """The step in which a channel reads if it reads in any, and its `share` of what is believed of all steps."""

    channel: int
    step: float
    share: float

    def about(self, fit: Fit) -> InSteps:
        """The error of a sensor that rounds to these steps what the fit says was there."""
        name = fit.simulator.windows.channels[self.channel]
        unit, row = CHANNELS[name].unit, MEASUREMENTS.index(name)
        target = Target(
            f"rounding of {name} to steps of {self.step:.2g} {unit}", size_of_latent("steps", unit, self.step), row
        )
        series = np.zeros((1, *fit.at.y.shape))
        series[0, self.channel] = error = rounding(predicted(fit)[self.channel], self.step)
        return InSteps(target, "in steps", series, fit.metric(series).reshape(1, -1), error[None], self.share)


def believed(share: float, prior: EffectPrior) -> Belief:
    """Of a share of all steps that a sensor may read in, as often as it is off in any other way."""
    one, endless = np.ones(1), np.full(1, np.inf)
    return Belief(
        named=False,
        rate=prior.discrepancy * share,
        nothing=NOTHING,
        amplitude=one,
        share=one,
        low=-endless,
        high=endless,
    )


def readings(fit: Fit) -> list[Reading]:
    """Of every channel whose range is wide enough, its likeliest step."""
    return [Reading(one.channel, *one.likeliest) for one in Staircase.of_each(Linearised.of(fit))]


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
