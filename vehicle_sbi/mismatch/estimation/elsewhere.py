"""A fitted model in recordings that it was not fitted to."""

from dataclasses import replace

import numpy as np

from vehicle_sbi.data.noise import FEWEST, from_residual
from vehicle_sbi.inference.directions import null
from vehicle_sbi.mismatch.estimation.fit import MEMORY_S, Fit, linearise
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE


def elsewhere(fit: Fit, observation: Observation, *, apart: bool) -> Fit:
    """A fit at its own parameters and noise there.

    What happened at a moment of the recordings that it was fitted to did not happen in others, which are `apart`,
    rather than other times of the same.
    """
    space, simulator = fit.simulator.space, observation.simulator
    absent = np.array([apart and _timed(p) for p in space.parameters])
    theta = np.array([null(p) if gone else x for p, x, gone in zip(space.parameters, fit.theta, absent, strict=True)])
    noise = replace(fit.simulator.noise, window=simulator.windows.t.shape[1])
    simulator = replace(simulator, space=space, noise=noise)
    at = linearise(simulator, theta)
    return Fit(observation.extended(simulator), theta, replace(at, J=np.where(absent[:, None, None], 0.0, at.J)))


def under_own_noise(fit: Fit) -> Fit:
    """The fit with the noise that it leaves over there, where that is more than it does where it was fitted.

    A linear model would make parameters answer for what is wrong with the fit in recordings that it has never seen.
    A channel that is too rarely measured there to tell keeps its noise.
    """
    noise, windows = fit.simulator.noise, fit.simulator.windows
    enough = windows.valid.sum(axis=1) >= FEWEST
    known = replace(windows, valid=np.where(enough[:, None], windows.valid, True))
    left = from_residual(np.where(enough[:, None], fit.unexplained, 0.0), known, MEMORY_S)
    more = enough & (left.floor > noise.floor)
    noise = replace(noise, floor=np.maximum(left.floor, noise.floor), rho=np.where(more, left.rho, noise.rho))
    return replace(fit, observation=fit.observation.extended(fit.simulator.with_noise(noise)))


def _timed(p: Parameter) -> bool:
    """Whether a parameter belongs to an effect that is tied to the clock of the recording it was fitted to."""
    effect = CATALOGUE.get(p.name.split(".")[0])
    return effect is not None and effect.timed
