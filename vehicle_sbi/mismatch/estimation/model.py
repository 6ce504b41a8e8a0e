"""The base model with a set of effects, fitted, and what is said of its parameters."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import truncnorm

from vehicle_sbi.mismatch.estimation.estimate import Estimate, drawn
from vehicle_sbi.mismatch.estimation.fit import Fit


@dataclass(frozen=True)
class Model:
    """`base` are the names of the base model's own parameters, which may be an effect's too; `posterior` draws of all
    parameters where a normal about the fit is not what is said of them."""

    effects: tuple[str, ...]
    fit: Fit
    base: tuple[str, ...]
    posterior: Float[np.ndarray, "n d"] | None = None

    @classmethod
    def without_effects(cls, fit: Fit) -> "Model":
        """The base model itself."""
        return cls((), fit, fit.simulator.space.names)

    @property
    def own(self) -> Bool[np.ndarray, " d"]:
        """Which parameters came with its effects."""
        names = self.fit.simulator.space.names
        return np.array([name.split(".")[0] in self.effects and name not in self.base for name in names])

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Posterior of every free parameter: as it was drawn, else normal about the fit within its box."""
        space = self.fit.simulator.space
        if self.posterior is not None:
            return {p.name: drawn(x, p.unit) for p, x in zip(space.parameters, self.posterior.T, strict=True)}
        std, found = np.sqrt(np.diag(self.fit.covariance)), {}
        for p, mean, s in zip(space.parameters, self.fit.theta, std, strict=True):
            box = truncnorm((p.low - mean) / s, (p.high - mean) / s, loc=mean, scale=s)
            low, high = box.ppf([0.05, 0.95])
            found[p.name] = Estimate(float(box.mean()), float(box.std()), float(low), float(high), p.unit)
        return found
