"""Is it the inference: may what follows stand on the base model's fit?

An unconverged fit looks exactly like missing physics. So points theta_i are drawn from the normal approximation q about
the fit, inside the prior, simulated, and weighted by w_i = p(y | theta_i) / q(theta_i). A point that is much likelier
than the fit says that it is no optimum. The shape k of the generalised Pareto distribution of the largest weights says
whether the posterior is anything like q: up to 0.7 averages under the weights can be relied on (Vehtari et al. 2024,
Pareto smoothed importance sampling, sec. 3).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.importance import TRUSTED, pareto_k
from vehicle_sbi.mismatch.estimation.fit import Fit, cost, descend, with_own_noise

DRAWS = 200
MOST_TRIED = 20  # times DRAWS, to find as many inside the prior
GAP = 2.0  # log likelihood by which a drawn point may beat the fit
REFITS = 2


@dataclass(frozen=True)
class FitCheck:
    """`k` of the weights, and by how much log likelihood the best point drawn beats the fit."""

    k: float
    gap: float

    @property
    def trusted(self) -> bool:
        return not self.notes

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said of a fit that should not be trusted."""
        said = []
        if self.gap > GAP:
            said.append(
                "The base model's fit is no optimum (a point near it is likelier by "
                f"{self.gap:.2g} of log likelihood): what is called missing may be the fit's."
            )
        if self.k > TRUSTED:
            said.append(
                f"The posterior about the base model's fit is far from normal (Pareto k = {self.k:.2g}, trusted up to "
                f"{TRUSTED:g}): sizes and probabilities are rough."
            )
        return tuple(said)


def checked(fit: Fit, rng: np.random.Generator) -> tuple[FitCheck, Float[np.ndarray, " d"]]:
    """How far a fit can be trusted, and the likeliest point that was drawn about it."""
    space, simulator = fit.simulator.space, fit.simulator
    factor = np.linalg.cholesky(fit.covariance)
    unit = rng.standard_normal((MOST_TRIED * DRAWS, len(space)))
    theta = fit.theta + unit @ factor.T
    inside = np.flatnonzero(((theta >= space.low) & (theta <= space.high)).all(axis=1))[:DRAWS]
    theta, unit = theta[inside], unit[inside]
    if len(theta) < DRAWS // 2:
        return FitCheck(np.inf, 0.0), fit.theta
    valid = simulator.windows.valid
    off = np.where(valid, fit.observation.observed - simulator.noise_free(theta), 0.0)
    here, there = cost(fit.metric, fit.residual[None])[0], cost(fit.metric, off)
    log_weight = here - there + 0.5 * np.sum(unit**2, axis=1)
    best = int(np.argmin(there))
    return FitCheck(pareto_k(log_weight), float(max(here - there[best], 0.0))), theta[best]


def mended(fit: Fit, rng: np.random.Generator) -> tuple[Fit, FitCheck]:
    """The fit, done again from any likelier point that is found about it, and how far it can be trusted then."""
    check, point = checked(fit, rng)
    for _ in range(REFITS):
        if check.gap <= GAP:
            break
        found = descend(fit.observation, point)
        if found is None:
            break
        fit = with_own_noise(found)
        check, point = checked(fit, rng)
    return fit, check
