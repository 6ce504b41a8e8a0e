"""Does the steering stick: wheels that stay where they are until the command is a threshold off, and then jump to it.

    error = held - command,   held_k = command_k if |command_k - held_(k-1)| > threshold, else held_(k-1)

for thresholds so closely spaced that one of them jumps when the wheels do. Play leaves the same lag at every turn; what
sticks leaves a sawtooth, which hides in the noise but for the hundreds of teeth that fall into place.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import Law, Target, law_slopes
from vehicle_sbi.mismatch.linear import Linearised, profile
from vehicle_sbi.physics.single_track import INPUTS

COARSEST = 0.3  # of the steering's range
SPACING = 1.015  # from one threshold to the next
MOST = 4e6  # thresholds times samples, for time and memory's sake; of more, the coarser ones
CHUNK = 2e6  # of samples of all channels at once
LARGEST = 2.0  # times the whole error that a fit may take


@dataclass(frozen=True)
class Stiction:
    """The threshold by which the steering is likeliest to stick: its error's size (1 of wheels that stay) and score,
    and of how many thresholds it is one."""

    threshold: float
    size: float
    score: float
    choice: int


def stuck(command: Float[np.ndarray, " time"], thresholds: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n time"]:
    """Where wheels stand that stick by each threshold."""
    held, now = np.empty((len(thresholds), len(command))), np.full(len(thresholds), command[0])
    for k, wanted in enumerate(command):
        now = np.where(np.abs(wanted - now) > thresholds, wanted, now)
        held[:, k] = now
    return held


def errors(simulator: Simulator, thresholds: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n windows time"]:
    """What the steering is off by where it sticks [rad]."""
    command = simulator.windows.u[..., INPUTS.index("steering")]
    off = stuck(command.reshape(-1), thresholds) - command.reshape(-1)
    return off.reshape(-1, *command.shape)


def thresholds(simulator: Simulator) -> Float[np.ndarray, " n"]:
    """Of steering that moves, from the coarsest to what it moves by from one sample to the next."""
    command = simulator.windows.u[..., INPUTS.index("steering")]
    coarsest, finest = COARSEST * float(np.ptp(command)), float(np.median(np.abs(np.diff(command, axis=1))))
    if not 0.0 < finest < coarsest:
        return np.zeros(0)
    number = min(int(np.log(coarsest / finest) / np.log(SPACING)), int(MOST / command.size))
    return coarsest * SPACING ** -np.arange(number, dtype=float)


def likeliest(about: Linearised, target: Target) -> Stiction | None:
    """By which the steering, the target, sticks, if it moves enough to tell."""
    fit, tried = about.fit, thresholds(about.fit.simulator)
    if not len(tried):
        return None
    found = []
    for some in np.array_split(tried, -(-tried.size * fit.at.y.size // int(CHUNK))):
        changes = effect(fit, target, errors(fit.simulator, some))[:, None]
        low, high = np.zeros((len(some), 1)), np.full((len(some), 1), LARGEST)
        best = profile(about, changes, low, high)
        found += zip(some, best.size[:, 0], best.log_likelihood - about.alone, strict=True)
    threshold, size, gain = max(found, key=lambda one: one[2])
    return Stiction(float(threshold), float(size), float(np.sqrt(2.0 * max(gain, 0.0))), len(tried))


def effect(fit: Fit, target: Target, off: Float[np.ndarray, "n windows time"]) -> Float[np.ndarray, "n channels time"]:
    """What errors of the steering do to the series."""
    laws = [Law(target, str(k), course) for k, course in enumerate(off)]
    return law_slopes(fit.simulator, fit.theta, fit.at.y, laws)
