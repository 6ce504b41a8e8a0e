"""The fit of many series at once: Gauss-Newton steps whose derivatives are emulated where parameters are proposed.

Along the directions z of parameters and nuisances that the data see, polynomials stand for the derivatives J(z) of the
noise-free model y(z), by least squares through finite differences. A series y is fitted by steps

    z <- z + (J(z)' W J(z) + P)^-1 (J(z)' W (y - y(z)) - P (z - z_0)),     W = sigma(y(z))^-2

under the noise that the fit itself implies, P being the prior's precision and z_0 the point about which features are
taken, from the second round on the last posterior's mean (Bjorck, Numerical Methods for Least Squares Problems, sec.
9.2). J has to follow z: noise that is a share of the signal is smallest where the
signal crosses zero, and those moments, which decide the fit, move with z. They also make it rough, so that steps lead
there only from nearby: they start from a regression of z on a linear fit of simulated series, and the first of them
take the noise's floor for higher than it is. Since y(z) is the simulator's, an error of J costs precision but no bias.
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from jaxtyping import Float, Int

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.rng import Stream, generator

POINTS = 400  # where the model's derivatives are taken
STEP = 0.02  # of the spread of the points, for central differences
SLOPES_DEGREE = 2
REGRESSED = 3000  # noisy series that z is regressed on
REGRESSION_DEGREE = 3
POINTS_A_TERM = 3  # of a polynomial, at least
FLOORS = (4.0, 1.4)  # of the noise in each step, in units of its own
BOUNDED = 4.0  # standard deviations to which residuals are drawn back: where signals cross zero they reach hundreds
AT_ONCE = 2**22  # numbers in memory while series are fitted


def exponents(k: int, degree: int) -> Int[np.ndarray, "terms k"]:
    """Of all monomials of k variables up to a degree."""
    factors = (c for total in range(degree + 1) for c in combinations_with_replacement(range(k), total))
    return np.array([np.bincount(np.array(c, dtype=int), minlength=k) for c in factors])


def monomials(z: Float[np.ndarray, "n k"], powers: Int[np.ndarray, "terms k"]) -> Float[np.ndarray, "n terms"]:
    found = np.ones((len(z), len(powers)), np.float32)
    for i in range(z.shape[1]):
        found *= z[:, [i]].astype(np.float32) ** powers[:, i]
    return found


@dataclass(frozen=True)
class Polynomial:
    """A function of z (n, k) with values of any shape, in single precision."""

    powers: Int[np.ndarray, "terms k"]
    coefficients: Float[np.ndarray, "terms ..."]

    @classmethod
    def through(cls, z: Float[np.ndarray, "n k"], y: Float[np.ndarray, "n ..."], degree: int) -> "Polynomial":
        """The least-squares polynomial of this degree, or of the highest below it that so many points bear."""
        k = z.shape[1]
        while degree > 0 and comb(k + degree, degree) * POINTS_A_TERM > len(z):
            degree -= 1
        powers = exponents(k, degree)
        solution = np.linalg.pinv(monomials(z, powers).astype(float)).astype(np.float32) @ y.reshape(len(y), -1)
        return cls(powers, solution.reshape(-1, *y.shape[1:]))

    def at(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n ..."]:
        flat = monomials(z, self.powers) @ self.coefficients.reshape(len(self.powers), -1)
        return flat.reshape(len(z), *self.coefficients.shape[1:])


@dataclass(frozen=True)
class Regression:
    """z from a series (n, samples): a polynomial of its linear fit about z = 0 under noise of average size."""

    origin: Float[np.ndarray, " samples"]
    projection: Float[np.ndarray, "samples k"]
    polynomial: Polynomial

    @classmethod
    def on(cls, y: np.ndarray, z: np.ndarray, origin: np.ndarray, projection: np.ndarray) -> "Regression":
        """The least-squares polynomial through series that z made."""
        linear = (y - origin) @ projection
        scaled = projection / np.float32(linear.std(axis=0))
        return cls(origin, scaled, Polynomial.through((y - origin) @ scaled, z, REGRESSION_DEGREE))

    def at(self, y: Float[np.ndarray, "n samples"]) -> Float[np.ndarray, "n k"]:
        return self.polynomial.at((y - self.origin) @ self.projection).astype(float)


@dataclass(frozen=True)
class Frame:
    """Coordinates z along orthonormal `directions` (p, k) of parameters and nuisances in units of their spread.

    A point there is middle + directions (centre + scale z), with |z| about 1 where parameters are proposed.
    """

    simulator: Simulator
    middle: Float[np.ndarray, " p"]
    directions: Float[np.ndarray, "p k"]
    centre: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]

    def point(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n p"]:
        return self.middle + (self.centre + self.scale * z) @ self.directions.T

    def coordinates(self, point: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n k"]:
        return ((point - self.middle) @ self.directions - self.centre) / self.scale

    def simulated(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n samples"]:
        return simulated(self.simulator, self.point(z))

    def slopes(self, z: Float[np.ndarray, "n k"]) -> Polynomial:
        """Derivatives (k, samples) of the model, through those at z; none where a simulation fails."""
        each = []
        for step in STEP * np.eye(z.shape[1]):  # one at a time: they are large
            rise = np.nan_to_num(self.simulated(z + step) - self.simulated(z - step))
            each.append(Polynomial.through(z, rise / np.float32(2 * STEP), SLOPES_DEGREE))
        return Polynomial(each[0].powers, np.stack([slope.coefficients for slope in each], axis=1))


@dataclass(frozen=True)
class Emulator:
    """Fits of series in a frame: where they start, and the derivatives by which they go on, up to |z| = `most`."""

    frame: Frame
    most: Float[np.ndarray, " k"]
    slopes: Polynomial
    start: Regression

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        middle: Float[np.ndarray, " p"],
        directions: Float[np.ndarray, "p k"],
        theta: Float[np.ndarray, "n d"],
        std: Float[np.ndarray, " samples"],
    ) -> "Emulator":
        """About a middle, where theta are proposed and nuisances drawn normally; `std` is the noise on average."""
        rng = generator(seed=simulator.seed, stream=Stream.STUDY, index=2)
        theta = np.resize(theta, (REGRESSED, theta.shape[1]))
        eta = rng.standard_normal((REGRESSED, len(simulator.nuisances)))
        point = np.concatenate([theta / simulator.space.prior_std, eta], axis=1)
        y = simulated(simulator, point)
        good = np.isfinite(y).all(axis=1)
        if good.sum() < REGRESSED // 2:
            raise InputError("features=score: most simulations fail; narrow the prior")
        point, y = point[good], y[good]
        raw = (point - middle) @ directions
        frame = Frame(simulator, middle, directions, raw.mean(axis=0), raw.std(axis=0))
        z, none = frame.coordinates(point), np.zeros((1, directions.shape[1]))
        slopes = frame.slopes(z[:POINTS])
        white = slopes.at(none)[0] / std
        projection = (np.linalg.solve(white @ white.T + np.diag(frame.scale**2), white) / std).T
        y += noise_std(simulator, y) * rng.standard_normal(y.shape, dtype=np.float32)
        start = Regression.on(y, z, frame.simulated(none)[0], projection.astype(np.float32))
        return cls(frame, np.abs(z).max(axis=0), slopes, start)

    def fitted(self, y: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, "n p"]:
        """Parameters and nuisances, in units of their spread, that explain each series; NaN where it is not finite."""
        flat = y.reshape(len(y), -1).astype(np.float32)
        z = np.full((len(y), len(self.most)), np.nan)
        finite = np.flatnonzero(np.isfinite(flat).all(axis=1))
        for rows in np.array_split(finite, max(1, len(finite) * self.slopes.coefficients[0].size // AT_ONCE)):
            z[rows] = self._fit(flat[rows])
        return self.frame.point(z)

    def _fit(self, y: Float[np.ndarray, "n samples"]) -> Float[np.ndarray, "n k"]:
        z = np.clip(self.start.at(y), -self.most, self.most)
        for floor in FLOORS:
            J = self.slopes.at(z)
            at = self._simulated(z, J)
            std = noise_std(self.frame.simulator, at, floor)
            z = self._step(z, _drawn_back((y - at) / std), J / std[:, None])
        return z

    def _step(
        self, z: Float[np.ndarray, "n k"], white: Float[np.ndarray, "n samples"], J: Float[np.ndarray, "n k samples"]
    ) -> Float[np.ndarray, "n k"]:
        """One Gauss-Newton step, residuals and derivatives in units of the noise; none where a simulation failed."""
        frame = self.frame
        precision = frame.scale**2
        score = (J @ white[..., None])[..., 0] - precision * (z + frame.centre / frame.scale)
        step = np.linalg.solve(J @ J.transpose(0, 2, 1) + np.diag(precision), score[..., None])[..., 0]
        return np.clip(z + np.where(np.isfinite(step), step, 0.0), -self.most, self.most)

    def _simulated(
        self, z: Float[np.ndarray, "n k"], J: Float[np.ndarray, "n k samples"]
    ) -> Float[np.ndarray, "n samples"]:
        """The model itself, carried on along J where z lies outside the prior's box."""
        frame, space = self.frame, self.frame.simulator.space
        inside, d = frame.point(z), len(space)
        inside[:, :d] = np.clip(inside[:, :d], space.low / space.prior_std, space.high / space.prior_std)
        beyond = (z - frame.coordinates(inside)).astype(np.float32)
        return simulated(frame.simulator, inside) + (beyond[:, None] @ J)[:, 0]


def simulated(simulator: Simulator, point: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n samples"]:
    """The model without noise at points in units of their spread, NaN where it fails, zero where masked."""
    d = len(simulator.space)
    y, _ = simulator.run(point[:, :d] * simulator.space.prior_std, simulator.nuisance_draws(point[:, d:]), np.float32)
    return np.where(simulator.windows.valid, y, np.float32(0.0)).reshape(len(point), -1)


def noise_std(
    simulator: Simulator, y: Float[np.ndarray, "n samples"], floor: float = 1.0
) -> Float[np.ndarray, "n samples"]:
    """Standard deviation of each sample, in single precision, where the noise's floor is so many times its own."""
    noise = replace(simulator.noise, floor=floor * simulator.noise.floor)
    return noise.std(y.reshape(len(y), *simulator.shape)).reshape(y.shape).astype(np.float32)


def _drawn_back(residual: np.ndarray) -> np.ndarray:
    """Residuals in standard deviations, drawn back smoothly to `BOUNDED`."""
    return np.float32(BOUNDED) * np.tanh(residual / np.float32(BOUNDED))
