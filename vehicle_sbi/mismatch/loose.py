"""What follows no signal of the drive: a load or an error that takes a course of its own, or sets in at a moment and
stays; a sensor that reads in steps; a steering that sticks.

They stand for something unknown beside the laws. They are not fitted but weighed. What they do to the series has sizes
that are normal about zero, so that their evidence and what they foretell are those of a normal with a wider covariance;
but for what sets in, whose size is as likely anywhere in its box and foretells nothing of other recordings.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.fft import dct

from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import STEERING, Law, Target, law_slopes, targets
from vehicle_sbi.mismatch.linear import Linearised, gained_at_random
from vehicle_sbi.mismatch.locate import bump, clock, stretches
from vehicle_sbi.mismatch.onset import Onset, onsets
from vehicle_sbi.mismatch.staircase import Staircase, predicted, rounding
from vehicle_sbi.mismatch.stiction import effect, errors, likeliest
from vehicle_sbi.physics.sensors import MEASUREMENTS

SIZES = np.geomspace(0.01, 1.0, 7)  # of a course of its own, in units of the largest size of a law


@dataclass(frozen=True)
class Course:
    """A target that is off by another size in each stretch of time, about none.

    `size` is a root mean square and `std` how uncertain it is; `gain` the log evidence that it gains beside a fit, one
    of so many `choice` that were weighed.
    """

    target: Target
    size: float
    std: float
    gain: float
    choice: int
    signal: str = "a course of its own"

    def rows(self, fit: Fit) -> Float[np.ndarray, "q channels time"]:
        """Stretches of the fit's own recordings."""
        return self.size * deviations(fit, [self.target])[0]


@dataclass(frozen=True)
class Steps:
    """A sensor that rounds to steps; as what takes a course of its own."""

    target: Target
    channel: int
    step: float
    std: float
    gain: float
    choice: int

    @property
    def size(self) -> float:
        """Of its error, which is uniform within a step."""
        return self.step / 12.0**0.5

    @property
    def signal(self) -> str:
        return f"its own reading, in steps of {self.step:.2g} {self.target.size.unit}"

    def rows(self, fit: Fit) -> Float[np.ndarray, "1 channels time"]:
        """Its error where the fit says what it read."""
        return in_steps(fit, self.channel, self.step)


@dataclass(frozen=True)
class Jerks:
    """A steering that sticks; as what takes a course of its own."""

    target: Target
    threshold: float
    size: float
    std: float
    gain: float
    choice: int

    @property
    def signal(self) -> str:
        return f"its sticking until it is {self.threshold:.2g} rad off"

    def rows(self, fit: Fit) -> Float[np.ndarray, "1 channels time"]:
        """What the error does that the fit's own steering would have."""
        return effect(fit, self.target, errors(fit.simulator, np.array([self.threshold])))


Loose = Course | Onset | Steps | Jerks


def loose(fit: Fit) -> Iterator[Loose]:
    """Every target on a course of its own and setting in, every channel in steps, and a steering that sticks."""
    about = Linearised.of(fit)
    yield from courses(about)
    yield from onsets(about)
    yield from staircases(about)
    yield from sticking(about)


def courses(about: Linearised) -> Iterator[Course]:
    """Every target, its size averaged over and at the likeliest of those that are tried."""
    fit = about.fit
    acting = targets(fit.simulator, fit.at.y)
    for target, rows in zip(acting, deviations(fit, acting), strict=True):
        size = SIZES * target.size.high
        evidence = np.array([gained_at_random(about, s * rows) for s in size])
        gain = float(np.logaddexp.reduce(evidence) - np.log(len(size)))
        weight = np.exp(evidence - np.logaddexp.reduce(evidence))
        mean = float(weight @ size)
        yield Course(target, mean, float(np.sqrt(weight @ (size - mean) ** 2)), gain, len(acting))


def deviations(fit: Fit, acting: list[Target]) -> Float[np.ndarray, "targets q channels time"]:
    """What targets do to the series that are off in single stretches of time, about their mean."""
    slopes = in_stretches(fit, acting)
    contrasts = dct(np.eye(slopes.shape[1]), norm="ortho", axis=0)[1:]
    return np.moveaxis(np.tensordot(contrasts, slopes, axes=(1, 1)), 0, 1)


def in_stretches(fit: Fit, acting: list[Target]) -> Float[np.ndarray, "targets stretches channels time"]:
    """What a target of size 1 does to the series in each stretch of time."""
    simulator, t = fit.simulator, clock(fit.simulator)
    bumps = [bump(t, *span).reshape(simulator.windows.t.shape) for span in stretches(simulator)]
    given = [Law(target, f"stretch {k}", course) for target in acting for k, course in enumerate(bumps)]
    return law_slopes(simulator, fit.theta, fit.at.y, given).reshape(len(acting), len(bumps), *fit.at.y.shape)


def staircases(about: Linearised) -> Iterator[Steps]:
    """Every channel in its likeliest steps."""
    fit, each = about.fit, Staircase.of_each(about)
    choice = sum(len(one.steps) for one in each)
    sensors = {target.row: target for target in targets(fit.simulator, fit.at.y)}
    for one in each:
        step, size, score = one.likeliest()
        target = sensors[MEASUREMENTS.index(fit.simulator.windows.channels[one.channel])]
        std = step / 12.0**0.5 * size / max(score, 1.0)
        gain = gained_at_random(about, in_steps(fit, one.channel, step))
        yield Steps(target, one.channel, step, std, gain, choice)


def in_steps(fit: Fit, channel: int, step: float) -> Float[np.ndarray, "1 channels time"]:
    """The error of a channel that rounds to steps."""
    error = np.zeros((1, *fit.at.y.shape))
    error[0, channel] = rounding(predicted(fit)[channel], step)
    return error


def sticking(about: Linearised) -> Iterator[Jerks]:
    """The steering with its likeliest threshold, if it moves."""
    fit = about.fit
    for target in targets(fit.simulator, fit.at.y):
        found = likeliest(about, target) if target.name == STEERING else None
        if found is not None:
            off = errors(fit.simulator, np.array([found.threshold]))
            size = found.size * float(np.sqrt(np.mean(off**2)))
            gain = gained_at_random(about, effect(fit, target, off))
            yield Jerks(target, found.threshold, size, size / max(found.score, 1.0), gain, found.choice)
