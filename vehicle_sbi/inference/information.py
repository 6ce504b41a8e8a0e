"""What a recording can tell: Fisher information, Cramer-Rao bound, and the fit that both are taken at.

The noise-free model y(theta, eta) has Gaussian measurement noise and nuisances eta of known spread (process noise,
initial state). With J the whitened sensitivities of y,

    F = J'J + 2 sum (d log sigma)(d log sigma)'     joint information of (theta, eta)
    F_theta = F_tt - F_te (F_ee + I)^-1 F_et         eta marginalised, in units of its standard deviation
    bound = sqrt(diag(F_theta^-1))

(Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, sec. 3.9 for the Gaussian case with a
covariance that depends on theta, sec. 10.8 for the random nuisances).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.simulator import Simulator

STEP = 1e-3  # of the prior's width or of a nuisance's standard deviation, for central differences
NO_INFORMATION = 1e-6  # information per prior variance below which a direction counts as not seen at all


@dataclass(frozen=True)
class Sensitivity:
    """The noise-free model about one point: y (channels, time) and its derivatives (theta then eta, channels, time)."""

    theta: Float[np.ndarray, " d"]
    y: Float[np.ndarray, "channels time"]
    jacobian: Float[np.ndarray, "p channels time"]


def sensitivity(simulator: Simulator, theta: Float[np.ndarray, " d"]) -> Sensitivity:
    """Central differences by theta and by the nuisances, in one batch of simulations."""
    d, e = len(theta), len(simulator.nuisances)
    width = np.concatenate([simulator.space.high - simulator.space.low, np.ones(e)])
    steps = STEP * np.diag(width)
    points = np.concatenate([np.zeros((1, d + e)), steps, -steps])
    y = simulator.noise_free(theta + points[:, :d], points[:, d:])
    up, down = y[1 : 1 + d + e], y[1 + d + e :]
    return Sensitivity(theta, y[0], (up - down) / (2 * STEP * width)[:, None, None])


def joint_fisher(simulator: Simulator, at: Sensitivity) -> Float[np.ndarray, "p p"]:
    """Information of the measurements about (theta, eta), without any prior."""
    noise, valid = simulator.noise, simulator.windows.valid
    std = noise.std(at.y)
    white = noise.whiten(at.jacobian, std, valid).reshape(len(at.jacobian), -1)
    d_log_std = np.where(valid, noise.share[:, None] ** 2 * at.y / std**2 * at.jacobian, 0.0)
    d_log_std = d_log_std.reshape(len(at.jacobian), -1)
    return white @ white.T + 2.0 * d_log_std @ d_log_std.T


def fisher(simulator: Simulator, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, "d d"]:
    """Information about theta with the nuisances marginalised; NaN if the simulation at theta fails."""
    d = len(theta)
    F = joint_fisher(simulator, sensitivity(simulator, theta))
    nuisance = F[d:, d:] + np.eye(len(F) - d)
    return F[:d, :d] - F[:d, d:] @ np.linalg.solve(nuisance, F[d:, :d])


def bound_std(F: Float[np.ndarray, "d d"], prior_std: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Cramer-Rao bound on the standard deviation of each parameter; infinite where the recording does not see it.

    Directions with next to no information (in units of the prior) are left out of the inverse, and every parameter
    that takes part in one of them is unbounded.
    """
    scaled = F * np.outer(prior_std, prior_std)
    if not np.isfinite(scaled).all():
        return np.full(len(F), np.inf)
    values, vectors = np.linalg.eigh(scaled)
    unseen = values < NO_INFORMATION
    variance = (vectors[:, ~unseen] ** 2 / values[~unseen]).sum(axis=1)
    variance[(vectors[:, unseen] ** 2).sum(axis=1) > 1e-6] = np.inf
    return np.sqrt(variance) * prior_std
