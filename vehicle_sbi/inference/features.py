"""From series to what the network sees, in three kinds: hand-crafted statistics, the score, or the series itself.

A kind of features is fitted once a round, on pilot simulations and about a fiducial theta, and is from then on a plain
function from series (n, channels, time) to x.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Float
from torch import nn

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.embedding import StridedCNN
from vehicle_sbi.inference.emulator import Emulator
from vehicle_sbi.inference.information import sensitivity
from vehicle_sbi.inference.simulator import Simulator

Series = Float[np.ndarray, "n channels time"]
Theta = Float[np.ndarray, "pilots d"]
Summary = Callable[[Series], np.ndarray]
TINY = 1e-12
AT_ONCE = 2**23  # numbers of pilot simulations that are looked at together
INFORMATIVE = 1e-4  # information, in units of the prior's, below which a direction of the score is left out


class Features(Protocol):
    """What is configured as `features=...`."""

    efficient: ClassVar[bool]
    """Whether they keep what a fit of the model uses, so that a fit may bound the proposals."""

    @property
    def recentred(self) -> bool:
        """Whether the features move with the fiducial, so that stored simulations need theirs anew each round."""
        ...

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], theta: Theta, pilot: Series) -> Summary:
        """The function from series to x, from parameters that are proposed and pilot simulations of them."""
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
    efficient: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not self.lags_s or not all(0 <= lag < np.inf for lag in self.lags_s):
            raise InputError(f"features.lags_s = {list(self.lags_s)}; state at least one lag, none negative [s]")

    def statistics(self, y: Series, rate: float) -> Float[np.ndarray, "n k"]:
        mean, std = y.mean(axis=-1), y.std(axis=-1)
        z = (y - mean[..., None]) / (std[..., None] + TINY)
        lags = tuple(min(round(lag * rate), y.shape[-1] - 2) for lag in self.lags_s)
        return np.concatenate([mean, 2.0 * np.log(std + TINY), correlations(z, lags)], axis=1)

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], theta: Theta, pilot: Series) -> Summary:
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


@dataclass(frozen=True)
class Linearised:
    """The noise-free model about a point: y + J a, with a (p,) parameters and nuisances in units of their spread.

    y (samples,) and J (p, samples) run over all channels; J is zero where a sample is not to be fitted. `origin` is
    the point itself in the same units.
    """

    y: Float[np.ndarray, " samples"]
    J: Float[np.ndarray, "p samples"]
    origin: Float[np.ndarray, " p"]

    @classmethod
    def about(cls, simulator: Simulator, theta: Float[np.ndarray, " d"]) -> "Linearised":
        at, d = sensitivity(simulator, theta), len(theta)
        if not np.isfinite(at.jacobian).all():
            raise InputError("features=score: the simulation at the fiducial point fails; narrow the prior")
        spread = np.concatenate([simulator.space.prior_std, np.ones(len(at.jacobian) - d)])
        J = np.where(simulator.windows.valid, at.jacobian * spread[:, None, None], 0.0)
        origin = np.concatenate([theta, np.zeros(len(spread) - d)]) / spread
        return cls(at.y.reshape(-1), J.reshape(len(spread), -1), origin)

    def residual(self, y: Series) -> Float[np.ndarray, "n samples"]:
        return (y.reshape(len(y), self.y.size) - self.y).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class Score:
    """Compression by the score of the likelihood, to a few numbers per parameter that the data see.

    With J the sensitivities by parameters and nuisances a (in units of their spread and of the noise), r the residual
    against the noise-free simulation at the fiducial, and J'J = U diag(l) U', the features are the posterior mean of
    a linear model about the fiducial, a* + U (l + 1)^-1 U' J'r: the score J'r in the parameters' own coordinates
    (Alsing & Wandelt 2018, Generalized massive optimal data compression).

    Noise that is a share of the signal is smallest where the signal crosses zero, so much of the information lies
    there, at moments that move with a. A score at one point is then far from sufficient anywhere else, and process
    noise alone takes simulations there. So each series is fitted under the noise of its own fit (`Emulator`), which is
    where its score vanishes: as efficient as the Cramer-Rao bound allows wherever the parameters are proposed.

    Both take noise as independent: whitening a slow residual would hand the decision to its fastest part, which a
    model explains worst. What autocorrelation costs in certainty is in the simulations, so the network learns it.

    With plausible effects free, tens of nuisances, the score is hardened against them (`hardened_score`) in one matrix
    product: a series is not fitted on its own, which with so many nuisances takes minutes and tells no more, even under
    noise that is a share of the signal. A linear estimate hardens by an effect's mean square over all cars, whether the
    series shows the effect or excludes it. So with `nuisances` the estimates of what is drawn stand beside those of the
    parameters, some 30 to 60 features from which the network tells one from the other; without, there are as many
    features as parameters, quicker to learn and 0.2 to 0.9 nats worse after 12000 simulations.
    """

    nuisances: bool = True
    recentred: bool = True
    efficient: ClassVar[bool] = True

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], theta: Theta, pilot: Series) -> Summary:
        model = Linearised.about(simulator, fiducial)
        std = usual_noise(simulator, pilot)
        if len(simulator.plausible):
            return _explained(model, std * slow(simulator), len(model.J) if self.nuisances else len(fiducial))
        if not simulator.noise.share.any():
            return _explained(model, std, len(model.J))
        white = model.J / std
        directions = _seen(white @ white.T)[1]
        rows = independent_rows(directions)
        emulator = Emulator.of(simulator, model.origin, directions, theta, std)
        return lambda y: emulator.fitted(y)[:, rows]

    def network(self, channels: int, time: int) -> nn.Module | None:
        return None


def usual_noise(simulator: Simulator, pilot: Series) -> Float[np.ndarray, " samples"]:
    """Root mean square over the pilots of the noise's standard deviation at each sample, a stretch of time at once."""
    parts = np.array_split(pilot, -(-pilot.size // AT_ONCE), axis=-1)
    mean = [(simulator.noise.std(part).astype(float) ** 2).mean(axis=0) for part in parts]
    return np.sqrt(np.concatenate(mean, axis=-1)).reshape(-1)


def _seen(information: Float[np.ndarray, "p p"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "p k"]]:
    """Orthonormal directions that the data see, and the information about each."""
    values, vectors = np.linalg.eigh(information)
    informative = values > INFORMATIVE
    if not informative.any():
        raise InputError("features=score: this recording tells nothing about any free parameter")
    return values[informative], vectors[:, informative]


def slow(simulator: Simulator) -> Float[np.ndarray, " samples"]:
    """How many times its own standard deviation noise counts for in what is slow: the root of sum rho^|lag| over all
    lags, (1 + rho) / (1 - rho), by which the variance of a long mean exceeds that of independent noise."""
    rho = simulator.noise.rho
    return np.repeat(np.sqrt((1.0 + rho) / (1.0 - rho)), simulator.windows.t.size)


def hardened_score(white: Float[np.ndarray, "p samples"], d: int) -> Float[np.ndarray, "d samples"]:
    """Sensitivities by d parameters less what nuisances of unit spread explain: J_b - F_bn (F_nn + I)^-1 J_n.

    `white` has the sensitivities by parameters, then nuisances, in units of their spread and of the noise, F = J J'.
    Times a residual it is the score of the parameters with the nuisances marginalised, and its derivative by the
    parameters their information, F_bb - F_bn (F_nn + I)^-1 F_nb (Alsing & Wandelt 2019, Nuisance hardened data
    compression for fast likelihood-free inference).
    """
    base, nuisance = white[:d], white[d:]
    return base - base @ nuisance.T @ np.linalg.solve(nuisance @ nuisance.T + np.eye(len(nuisance)), nuisance)


def _explained(model: Linearised, std: Float[np.ndarray, " samples"], d: int) -> Summary:
    """What explains series about the model's point under noise of `std`: the posterior mean of the first d parameters
    in a linear model, those after them marginalised; (n, as many of the d as the data tell apart)."""
    white = model.J / std
    score = hardened_score(white, d)
    values, vectors = _seen(score @ white[:d].T)
    rows = independent_rows(vectors)
    mean = (vectors / (values + 1.0) @ vectors.T)[rows]
    projection, scale = (mean @ score).astype(np.float32), std.astype(np.float32)
    return lambda y: model.origin[rows] + model.residual(y) / scale @ projection.T


@dataclass(frozen=True, kw_only=True)
class Embedding:
    """The series themselves, for a network that learns its own statistics together with the flow.

    Each channel is standardised by pilot simulations; `decimate` averages that many neighbouring samples, which
    loses nothing below the resulting rate and makes training that much faster.
    """

    decimate: int = 4
    outputs: int = 20
    recentred: bool = False
    efficient: ClassVar[bool] = False

    def fit(self, simulator: Simulator, fiducial: Float[np.ndarray, " d"], theta: Theta, pilot: Series) -> Summary:
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
