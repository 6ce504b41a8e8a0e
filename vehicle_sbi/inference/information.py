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

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.simulator import Simulator

STEP = 1e-3  # of the prior's width or of a nuisance's standard deviation, for central differences
NO_INFORMATION = 1e-6  # information per prior variance below which a direction counts as not seen at all


@dataclass(frozen=True)
class Sensitivity:
    """The noise-free model about one point: y (channels, time) and its derivatives (theta then eta, channels, time)."""

    theta: Float[np.ndarray, " d"]
    y: Float[np.ndarray, "channels time"]
    jacobian: Float[np.ndarray, "p channels time"]


def sensitivity(
    simulator: Simulator, theta: Float[np.ndarray, " d"], eta: Float[np.ndarray, " e"] | None = None
) -> Sensitivity:
    """Central differences by theta and by the nuisances (at their means unless `eta` is given), in one batch."""
    d, e = len(theta), len(simulator.nuisances)
    eta = np.zeros(e) if eta is None else eta
    width = np.concatenate([simulator.space.high - simulator.space.low, np.ones(e)])
    steps = STEP * np.diag(width)
    points = np.concatenate([np.zeros((1, d + e)), steps, -steps])
    y = simulator.noise_free(theta + points[:, :d], eta + points[:, d:])
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


DAMPING = (0.0, 1e-3, 1e-1, 10.0)
MOST_STEPS = 30
SETTLED = 1e-3  # of the cost: a smaller gain ends the search


def best_fit(
    simulator: Simulator, observed: Float[np.ndarray, "channels time"], starts: Float[np.ndarray, "n d"]
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "channels time"]]:
    """Damped Gauss-Newton on the whitened residual, nuisances held by their spread: (theta, residual) of the best start.

    Each step tries all of DAMPING in one batch and keeps to the prior's box. Raises InputError if no start simulates.
    """
    fits = [fit for fit in (_descend(simulator, observed, start) for start in starts) if np.isfinite(fit[0])]
    if not fits:
        raise InputError("the simulation fails at every starting point; narrow the prior")
    _, theta, y = min(fits, key=lambda fit: fit[0])
    return theta, observed - y


def _descend(
    simulator: Simulator, observed: np.ndarray, start: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """(cost, theta, y) where the descent from one start settles."""
    space, valid, d = simulator.space, simulator.windows.valid, len(start)
    eta = np.zeros(len(simulator.nuisances))
    std = simulator.noise.std(np.where(valid, observed, 0.0))

    def cost_of(y: np.ndarray, eta: np.ndarray) -> float:
        cost = np.sum(simulator.noise.whiten(observed - y, std, valid) ** 2) + np.sum(eta**2)
        return float(cost) if np.isfinite(cost) else np.inf

    at = sensitivity(simulator, start, eta)
    cost = cost_of(at.y, eta)
    for _ in range(MOST_STEPS):
        if not np.isfinite(at.jacobian).all():
            break
        J = simulator.noise.whiten(at.jacobian, std, valid).reshape(len(at.jacobian), -1)
        r = simulator.noise.whiten(observed - at.y, std, valid).ravel()
        F = J @ J.T + np.diag([0.0] * d + [1.0] * len(eta))
        downhill = J @ r - np.concatenate([np.zeros(d), eta])
        steps = [np.linalg.lstsq(F + c * np.diag(np.diag(F)), downhill, rcond=1e-10)[0] for c in DAMPING]
        thetas = np.clip(at.theta + [step[:d] for step in steps], space.low, space.high)
        etas = eta + np.array([step[d:] for step in steps])
        costs = [cost_of(y, e) for y, e in zip(simulator.noise_free(thetas, etas), etas, strict=True)]
        best = int(np.argmin(costs))
        if not costs[best] < cost:
            break
        gained, cost, eta = cost - costs[best], costs[best], etas[best]
        at = sensitivity(simulator, thetas[best], eta)
        if gained < SETTLED * max(1.0, cost * SETTLED):
            break
    return cost, at.theta, at.y
