"""What a recording can tell: Fisher information, Cramer-Rao bound, and the fit that both are taken at.

The noise-free model y(theta, eta) has Gaussian measurement noise and nuisances eta of known spread (process noise,
initial state). With J the whitened sensitivities of y,

    F = J'J + 2 sum (d log sigma)(d log sigma)'     joint information of (theta, eta)
    F_theta = F_tt - F_te (F_ee + I)^-1 F_et         eta marginalised, in units of its standard deviation
    bound = sqrt(diag(F_theta^-1))

(Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, sec. 3.9 for the Gaussian case with a
covariance that depends on theta, sec. 10.8 for the random nuisances).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.stats import norm
from tqdm import tqdm

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.simulator import Simulator

LEVEL, POWER = 0.05, 0.8  # of the two-sided test by which a size is said to be seen
SEEN = float(norm.isf(LEVEL / 2) + norm.ppf(POWER))  # standard deviations that this takes, 2.80
TOLD = 4.0  # signal-to-noise ratio from which what is missing can be told from nothing
PLAIN = 8.0  # signal-to-noise ratio of an effect that is plain to see
STEP = 1e-3  # of the prior's width or of a nuisance's standard deviation, for central differences
MOST_STEPS = 30  # of a fit
FAILED = 1e3  # standard deviations that a failed simulation counts as being off
REWEIGHTED = 4  # fits, each by the noise that the last one implies
EXPLAINED = 1.5  # mean square of what a fit leaves over, in units of the noise, up to which it explains a recording
NO_INFORMATION = 1e-6  # information per prior variance below which a direction counts as not seen at all


CONFUSABLE = 0.95  # correlation from which two parameters count as hardly told apart


@dataclass(frozen=True)
class Sensitivity:
    """The noise-free model about one point: y (channels, time) and its derivatives (theta then eta, channels, time)."""

    theta: Float[np.ndarray, " d"]
    y: Float[np.ndarray, "channels time"]
    jacobian: Float[np.ndarray, "p channels time"]


def sensitivity(
    simulator: Simulator, theta: Float[np.ndarray, " d"], eta: Float[np.ndarray, " e"] | None = None
) -> Sensitivity:
    """Central differences by theta and by the nuisances (at their means unless `eta` is given), in one batch.

    By parameters of plausible effects they reach as far as a part of their size, so that a delay outlasts a sample, and
    no further than their box, from a null at its edge to one side. Where that makes the simulation fail they are zero.
    """
    d, e, slabs = len(theta), len(simulator.nuisances), simulator.plausible
    eta, box = np.zeros(e) if eta is None else eta, simulator.nuisance_box
    width = np.concatenate([simulator.space.high - simulator.space.low, np.ones(e - len(slabs))])
    steps, moves = np.concatenate([STEP * width, slabs.steps]), _moves(simulator, d + e)
    points = np.concatenate([np.zeros((1, d + e)), steps * moves, -steps * moves])
    moved = np.clip(eta + points[:, d:], *box)
    y = simulator.noise_free(theta + points[:, :d], moved)
    up, down = np.split(moved[1:], 2)
    between = np.concatenate([2 * steps[:d], np.sum((up - down) * moves[:, d:], axis=0)])
    jacobian = _jacobian(simulator, moves, between, *np.split(y[1:], 2))
    first = d + e - len(slabs)
    jacobian[first:] = np.nan_to_num(jacobian[first:])
    return Sensitivity(theta, y[0], jacobian)


def _initial(simulator: Simulator, p: int) -> tuple[slice, int]:
    """Where initial states are among p parameters and nuisances, window after window, and how many a window has."""
    each, last = len(simulator.uncertain_states), p - len(simulator.plausible)
    return slice(last - each * len(simulator.windows.x0), last), each


def _moves(simulator: Simulator, p: int) -> Bool[np.ndarray, "moves p"]:
    """What is moved together: a parameter or a nuisance alone, an initial state in all windows, which do not see each
    other's. So their number does not grow with the recording."""
    where, each = _initial(simulator, p)
    kind = np.arange(p)
    kind[where] = where.start + np.arange(where.stop - where.start) % max(each, 1)
    return kind == np.unique(kind)[:, None]


def _jacobian(
    simulator: Simulator,
    moves: Bool[np.ndarray, "moves p"],
    between: Float[np.ndarray, " p"],
    up: Float[np.ndarray, "moves channels time"],
    down: Float[np.ndarray, "moves channels time"],
) -> Float[np.ndarray, "p channels time"]:
    """Differences as derivatives, those by initial states in their own windows alone."""
    (where, each), length = _initial(simulator, len(between)), simulator.windows.t.shape[1]
    found = np.zeros((len(between), *up.shape[1:]))
    for k, row in enumerate(moves.argmax(axis=0)):
        window = (k - where.start) // each if where.start <= k < where.stop else None
        seen = slice(None) if window is None else slice(window * length, (window + 1) * length)
        found[k, :, seen] = (up[row, :, seen] - down[row, :, seen]) / between[k]
    return found


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


def correlation(F: Float[np.ndarray, "d d"], prior_std: Float[np.ndarray, " d"]) -> Float[np.ndarray, "d d"]:
    """Correlations of the parameters given the recording and a Gaussian as wide as the prior."""
    covariance = np.linalg.inv(F * np.outer(prior_std, prior_std) + np.eye(len(F)))
    std = np.sqrt(np.diag(covariance))
    return covariance / np.outer(std, std)


def confusable(F: Float[np.ndarray, "d d"], prior_std: Float[np.ndarray, " d"]) -> list[tuple[int, int, float]]:
    """Pairs of parameters that this recording hardly tells apart, (i, j, correlation), the closest first."""
    if not np.isfinite(F).all():
        return []
    r = correlation(F, prior_std)
    pairs = [(int(i), int(j), float(r[i, j])) for i, j in zip(*np.triu_indices(len(r), 1), strict=True)]
    return sorted((pair for pair in pairs if abs(pair[2]) > CONFUSABLE), key=lambda pair: -abs(pair[2]))


def best_fit(
    simulator: Simulator, observed: Float[np.ndarray, "channels time"], starts: Float[np.ndarray, "n d"]
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "channels time"]]:
    """Weighted least squares inside the prior's box: (theta, residual) of the best start.

    Weights take noise as independent, for the reason that the score's do. Nuisances are fitted too, held by their
    spread; theta is scaled to the box. Raises InputError if no start simulates.
    """
    none = np.zeros(len(simulator.nuisances))
    std = _observed_std(simulator, observed)
    theta, eta = _least_squares(simulator, observed, std, [(start, none) for start in starts])
    return theta, observed - simulator.noise_free(theta[None], eta[None])[0]


def _observed_std(
    simulator: Simulator, observed: Float[np.ndarray, "channels time"]
) -> Float[np.ndarray, "channels time"]:
    return simulator.noise.std(np.where(simulator.windows.valid, observed, 0.0))


def _least_squares(
    simulator: Simulator,
    observed: Float[np.ndarray, "channels time"],
    std: Float[np.ndarray, "channels time"],
    starts: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " e"]]:
    """(theta, nuisances) of the best fit from any start under noise of `std`."""
    space, valid, d = simulator.space, simulator.windows.valid, len(simulator.space)
    width, e = space.high - space.low, len(simulator.nuisances)

    def residual(z: np.ndarray) -> np.ndarray:
        y = simulator.noise_free((space.low + z[:d] * width)[None], z[None, d:])[0]
        off = np.where(np.isfinite(y), (observed - y) / std, FAILED)
        return np.concatenate([off[valid], z[d:]])

    def jacobian(z: np.ndarray) -> np.ndarray:
        J = sensitivity(simulator, space.low + z[:d] * width, z[d:]).jacobian
        scaled = (np.nan_to_num(J) / std)[:, valid]
        scaled[:d] *= width[:, None]
        return np.concatenate([-scaled.T, np.eye(d + e)[d:]])

    low, high = simulator.nuisance_box
    bounds = np.concatenate([np.zeros(d), low]), np.concatenate([np.ones(d), high])
    begin = [np.concatenate([np.clip((s - space.low) / width, 1e-3, 1 - 1e-3), eta]) for s, eta in starts]
    fits = [
        least_squares(residual, z, jac=jacobian, bounds=bounds, max_nfev=MOST_STEPS, ftol=1e-5)  # pyright: ignore[reportArgumentType]
        for z in tqdm(begin, desc="fits", disable=None if len(begin) > 1 else True, leave=False)
    ]
    best = min(fits, key=lambda fit: fit.cost).x
    theta, eta = space.low + best[:d] * width, best[d:]
    if not np.isfinite(simulator.noise_free(theta[None], eta[None])).all():
        raise InputError("the simulation fails wherever a fit was tried; narrow the prior")
    return theta, eta


@dataclass(frozen=True)
class Laplace:
    """Laplace's approximation to the posterior of (theta, eta), the box taken for a Gaussian: fit and covariance."""

    theta: Float[np.ndarray, " d"]
    eta: Float[np.ndarray, " e"]
    covariance: Float[np.ndarray, "p p"]

    @property
    def marginal(self) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]]:
        """Mean and covariance of theta."""
        d = len(self.theta)
        return self.theta, self.covariance[:d, :d]


def laplace(
    simulator: Simulator, observed: Float[np.ndarray, "channels time"], starts: Float[np.ndarray, "n d"]
) -> Laplace | None:
    """Laplace's approximation about the best fit from any start.

    None where the model does not explain what was observed, so that its fit says little, and where the simulation fails
    beside the fit. Where noise depends on the signal, each fit is weighted by the noise that the one before implies;
    weights by what was observed would favour low values. They take noise as independent, so where it is not the
    posterior is that given the fit, wider than that given the series. (MacKay, Information Theory, Inference, and
    Learning Algorithms, ch. 27.)
    """
    noise, valid = simulator.noise, simulator.windows.valid
    none = np.zeros(len(simulator.nuisances))
    fit = _least_squares(simulator, observed, _observed_std(simulator, observed), [(start, none) for start in starts])
    for _ in range(REWEIGHTED if noise.share.any() else 0):
        theta, eta = fit
        fit = _least_squares(simulator, observed, noise.std(simulator.noise_free(theta[None], eta[None])[0]), [fit])
    theta, eta = fit
    at = sensitivity(simulator, theta, eta)
    unexplained = np.mean(((observed - at.y) / noise.std(at.y))[valid] ** 2) > EXPLAINED
    if unexplained or not np.isfinite(at.jacobian[:, valid]).all():
        return None
    prior = np.diag(np.concatenate([simulator.space.prior_std**-2.0, np.ones(len(eta))]))
    F = _fit_information(simulator, at) if noise.rho.any() else joint_fisher(simulator, at)
    return Laplace(theta, eta, np.linalg.inv(F + prior))


def _fit_information(simulator: Simulator, at: Sensitivity) -> Float[np.ndarray, "p p"]:
    """Information about (theta, eta) in a fit whose weights take correlated noise for independent: M B^-1 M.

    M = J'J is what the fit takes its information for, B = J'RJ the variance of its score (White, Econometrica, 1982).
    """
    noise = simulator.noise
    J = np.where(simulator.windows.valid, at.jacobian / noise.std(at.y), 0.0)
    M, B = np.tensordot(J, J, ((1, 2), (1, 2))), np.tensordot(J, noise.correlated(J), ((1, 2), (1, 2)))
    return M @ np.linalg.pinv(B, rcond=1e-12, hermitian=True) @ M
