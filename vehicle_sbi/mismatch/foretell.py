"""What a fitted model says of recordings that it was not fitted to: names that fit as well may foretell differently.

There the parameters are as uncertain as their fit left them, and what follows no law is as large as it was. With J what
a standard deviation of each of them does,

    log p(r) = log N(r; 0, C + J J'),   T = sum_i q_i^2 / (1 + s_i^2),   J = sum_i s_i u_i v_i' (whitened), q_i = v_i' r

is how likely the recordings are, and T how far the parameters would have to move for them: chi-square if what was
fitted is a property of the car, larger if it stands for something that acts differently there.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vehicle_sbi.inference.directions import null
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.fit import Fit, Observation, linearise
from vehicle_sbi.mismatch.laws import Law, followed, moved
from vehicle_sbi.mismatch.loose import Loose
from vehicle_sbi.physics.effects import CATALOGUE

SEEN = 0.3  # standard deviations of the noise, from which a recording says something of a parameter's direction
LENIENT = 1.5  # variance over that of the fit by which parameters of a model that counts as right move


@dataclass(frozen=True)
class Foretold:
    """How likely recordings are under a model, and how often parameters that stay would seem to move as much.

    `left` is the mean square of what the model leaves over there, in units of the noise, once its parameters have moved
    as far as their fit allows.
    """

    log_likelihood: float
    p_value: float
    left: float


def foretold(model: Model, observation: Observation) -> Foretold | None:
    """Of other recordings than the model was fitted to; None where its simulation fails."""
    there = elsewhere(model, observation, apart=True)
    if not np.isfinite(there.at.y[there.simulator.windows.valid]).all():
        return None
    changes = in_std(model.fit, there.at.J)
    if isinstance(model.outside, Loose):
        changes = np.concatenate([changes, model.outside.rows(there)])
    J = there.metric(changes).reshape(len(changes), -1)
    r = there.metric(there.residual).reshape(-1)
    _, s, v = np.linalg.svd(J, full_matrices=False)
    q = v @ r
    log_likelihood = there.log_likelihood + 0.5 * float(np.sum(q**2 * s**2 / (1.0 + s**2) - np.log1p(s**2)))
    left = float(r @ r - np.sum(q**2 * s**2 / (1.0 + s**2))) / max(int(there.simulator.windows.valid.sum()), 1)
    seen = s > SEEN
    moved_by = float(np.sum((q**2 / (1.0 + s**2))[seen])) / (LENIENT * max(left, 1.0))
    return Foretold(log_likelihood, float(chi2.sf(moved_by, seen.sum())) if seen.any() else 1.0, left)


def elsewhere(model: Model, observation: Observation, *, apart: bool) -> Fit:
    """The model at its own parameters and noise in other recordings.

    What happened at a moment of those that it was fitted to did not happen in others, which are `apart`, rather than
    other times of the same.
    """
    fit, space = model.fit, model.fit.simulator.space
    theta = fit.theta
    if apart:
        theta = np.array([null(p) if _timed(p.name) else x for p, x in zip(space.parameters, theta, strict=True)])
    simulator = replace(observation.simulator, space=space, noise=_for(observation.simulator, fit))
    if isinstance(model.outside, Law):
        simulator = followed(simulator, moved(model.outside, simulator, theta))
    return Fit(observation.extended(simulator), theta, linearise(simulator, theta))


def _timed(name: str) -> bool:
    """Whether a parameter belongs to an effect that is tied to the clock of the recording it was fitted to."""
    effect = CATALOGUE.get(name.split(".")[0])
    return effect is not None and effect.timed


def _for(simulator: Simulator, fit: Fit):
    """The fit's noise for windows of another length."""
    return replace(fit.simulator.noise, window=simulator.windows.t.shape[1])


def in_std(fit: Fit, J: Float[np.ndarray, "d channels time"]) -> Float[np.ndarray, "d channels time"]:
    """Derivatives by parameters in units of the prior's spread, as those by a standard deviation of the posterior."""
    spread = fit.simulator.space.prior_std
    root = np.linalg.cholesky(fit.covariance / np.outer(spread, spread))
    return np.tensordot(root.T, J, axes=1)
