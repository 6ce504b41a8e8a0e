"""From series to what the network sees, in three kinds: hand-crafted statistics, the score, or the series itself.

A kind of features is fitted once a round, on pilot simulations and about a fiducial theta, and is from then on a plain
function from series (n, channels, time) to x.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float
from torch import nn

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.embedding import StridedCNN
from vehicle_sbi.inference.information import Sensitivity, sensitivity
from vehicle_sbi.inference.simulator import Simulator

Series = Float[np.ndarray, "n channels time"]
Summary = Callable[[Series], np.ndarray]
TINY = 1e-12
BOUNDED = 4.0  # standard deviations to which a sharply weighted residual is drawn back
INFORMATIVE = 1e-4  # information, in units of the prior's, below which a direction of the score is left out


class Features(Protocol):
    """What is configured as `features=...`."""

    @property
    def recentred(self) -> bool:
        """Whether the features move with the fiducial, so that stored simulations need theirs anew each round."""
        ...

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], pilot: Series) -> Summary:
        """The function from series to x."""
        ...

    def network(self, channels: int, time: int) -> nn.Module | None:
        """The embedding network learned with the flow, if any."""
        ...


def correlations(z: Series, lags: tuple[int, ...]) -> Float[np.ndarray, "n k"]:
    """Correlations of standardised series, within and between them: the mean of z_i(t) z_j(t + lag) at each lag."""
    columns = []
    for lag in lags:
        early, late = (z, z) if lag == 0 else (z[..., :-lag], z[..., lag:])
        product = np.einsum("nit,njt->nij", early, late) / early.shape[-1]
        i, j = np.triu_indices(z.shape[1], 1) if lag == 0 else np.indices(product.shape[1:]).reshape(2, -1)
        columns.append(product[:, i, j])
    return np.concatenate(columns, axis=1)


@dataclass(frozen=True, kw_only=True)
class Handcrafted:
    """The paper's statistics: log variance of each series, auto- and cross-correlations at several lags.

    The means of the series are kept as well: they place the vehicle's speed. Normalised by the mean and standard
    deviation of pilot simulations, as the paper does with 1000 of them (its section IV).
    """

    lags_s: tuple[float, ...] = (0.0, 0.1, 0.3, 1.0)
    recentred: bool = False

    def __post_init__(self) -> None:
        if not self.lags_s or not all(0 <= lag < np.inf for lag in self.lags_s):
            raise InputError(f"features.lags_s = {list(self.lags_s)}; state at least one lag, none negative [s]")

    def statistics(self, y: Series, rate: float) -> Float[np.ndarray, "n k"]:
        mean, std = y.mean(axis=-1), y.std(axis=-1)
        z = (y - mean[..., None]) / (std[..., None] + TINY)
        lags = tuple(min(round(lag * rate), y.shape[-1] - 2) for lag in self.lags_s)
        return np.concatenate([mean, 2.0 * np.log(std + TINY), correlations(z, lags)], axis=1)

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], pilot: Series) -> Summary:
        rate = simulator.windows.rate
        statistics = self.statistics(pilot, rate)
        mean, std = statistics.mean(axis=0), statistics.std(axis=0) + TINY
        return lambda y: (self.statistics(y, rate) - mean) / std

    def network(self, channels: int, time: int) -> nn.Module | None:
        return None


def independent_rows(matrix: Float[np.ndarray, "p k"], tolerance: float = 1e-6) -> np.ndarray:
    """Indices of rows, first come first kept, that are no linear combination of the rows kept before them."""
    kept: list[int] = []
    basis = np.zeros((0, matrix.shape[1]))
    for i, row in enumerate(matrix):
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > tolerance:
            kept.append(i)
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
    return np.array(kept, dtype=int)


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compression by the score of the likelihood at a fiducial point, to two numbers per parameter that the data see.

    With J the sensitivities by parameters and nuisances a (in units of their spread and of the noise), r the residual
    against the noise-free simulation at the fiducial, and J'J = U diag(l) U', the features are the posterior mean of
    a linear model about the fiducial, a* + U (l + 1)^-1 U' J'r: the score J'r in the parameters' own coordinates
    (Alsing & Wandelt 2018, Generalized massive optimal data compression).

    Noise that is a share of the signal is smallest where the signal crosses zero, so much of the information lies
    there, at a moment that moves with theta. Hence two weightings: by the variance of the noise averaged over pilot
    simulations, which no crossing dominates, and by its precision averaged over them, which is sharp at crossings and
    whose residuals are bounded (`BOUNDED`), because a simulation that crosses elsewhere is off by hundreds there. Where
    noise does not depend on the signal the two are one. Both take noise as independent: whitening a slow residual
    would hand the decision to its fastest part, which a model explains worst. What autocorrelation costs in certainty
    is in the simulations, so the network learns it.
    """

    recentred: bool = True

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], pilot: Series) -> Summary:
        at = sensitivity(simulator, fiducial)
        if not np.isfinite(at.jacobian).all():
            raise InputError("features=score: the simulation at the fiducial point fails; narrow the prior")
        std = simulator.noise.std(pilot)
        robust = np.sqrt(np.mean(np.square(std, dtype=float), axis=0))
        scores = [_linear_estimate(simulator, at, robust, bound=np.inf)]
        if simulator.noise.share.any():
            sharp = 1.0 / np.sqrt(np.mean(1.0 / np.square(std, dtype=float), axis=0))
            scores.append(_linear_estimate(simulator, at, sharp, bound=BOUNDED))
        return lambda y: np.concatenate([score(y) for score in scores], axis=1)

    def network(self, channels: int, time: int) -> nn.Module | None:
        return None


def _linear_estimate(
    simulator: Simulator, at: Sensitivity, std: Float[np.ndarray, "channels time"], *, bound: float
) -> Summary:
    """Parameters and nuisances, in units of their spread, that explain series about `at` under noise of `std`.

    Residuals beyond `bound` standard deviations are drawn back to it smoothly.
    """
    valid, d = simulator.windows.valid, len(at.theta)
    spread = np.concatenate([simulator.space.prior_std, np.ones(len(at.jacobian) - d)])
    scaled = np.where(valid, at.jacobian * spread[:, None, None] / std, 0.0).reshape(len(spread), -1)
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    seen = values > INFORMATIVE
    if not seen.any():
        raise InputError("features=score: this recording tells nothing about any free parameter")
    mean = vectors[:, seen] / (values[seen] + 1.0) @ vectors[:, seen].T
    rows = independent_rows(vectors[:, seen])  # as those of `mean`, which shrink as the data grow precise
    projection = (mean[rows] @ scaled).astype(np.float32)
    centre = (np.concatenate([at.theta, np.zeros(len(spread) - d)]) / spread)[rows]

    def estimate(y: Series) -> Float[np.ndarray, "n k"]:
        residual = np.where(valid, (y - at.y) / std, 0.0).astype(np.float32)
        if np.isfinite(bound):
            residual = bound * np.tanh(residual / bound)
        return centre + residual.reshape(len(y), projection.shape[1]) @ projection.T

    return estimate


@dataclass(frozen=True, kw_only=True)
class Embedding:
    """The series themselves, for a network that learns its own statistics together with the flow.

    Each channel is standardised by pilot simulations; `decimate` averages that many neighbouring samples, which
    loses nothing below the resulting rate and makes training that much faster.
    """

    decimate: int = 4
    outputs: int = 20
    recentred: bool = False

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], pilot: Series) -> Summary:
        if not 1 <= self.decimate <= pilot.shape[-1] // 64:
            raise InputError(
                f"features.decimate = {self.decimate}; it must leave at least 64 of {pilot.shape[-1]} samples"
            )
        mean = pilot.mean(axis=(0, 2), keepdims=True)[0]
        std = pilot.std(axis=(0, 2), keepdims=True)[0] + TINY

        def standardise(y: Series) -> Float[np.ndarray, "n channels kept"]:
            kept = y.shape[-1] // self.decimate * self.decimate
            z = (y[..., :kept] - mean) / std
            return z.reshape(*z.shape[:-1], kept // self.decimate, self.decimate).mean(axis=-1)

        return standardise

    def network(self, channels: int, time: int) -> nn.Module | None:
        return StridedCNN(channels=channels, outputs=self.outputs)
