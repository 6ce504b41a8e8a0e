"""A polynomial that stands for the noise-free model where parameters are proposed, and the fit of many series by it.

Along the directions z of parameters and nuisances that the data see, y(z) is a polynomial, by least squares through
simulations without noise. With its derivatives J(z) a series y is fitted by Gauss-Newton steps

    z <- z + (J(z)' W J(z) + P)^-1 (J(z)' W (y - y(z)) - P (z - z_0)),     W = sigma(y(z))^-2

under the noise that the fit itself implies, P being the prior's precision and z_0 its mean (Bjorck, Numerical Methods
for Least Squares Problems, sec. 9.2). J has to follow z: noise that is a share of the signal is smallest where the
signal crosses zero, and those moments, which decide the fit, move with z. The last steps take y(z) from the simulator,
so that an error of the polynomial costs some precision but makes no bias.
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from jaxtyping import Float, Int

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.rng import Stream, generator

POINTS = 2000  # simulations that the polynomial is fitted to
LARGEST_DEGREE = 3
POINTS_A_TERM = 4  # at least
AVERAGE_STEPS = 3  # by the noise averaged over simulations, which no crossing of zero dominates
OWN_STEPS = 6  # by the fit's own noise; these and the first use every THINNED-th sample
SIMULATED_STEPS = 1  # by all samples and the simulator itself
THINNED = 5
BOUNDED = 4.0  # standard deviations to which residuals are drawn back: where signals cross zero they reach hundreds
AT_ONCE = 2**20  # numbers in memory while series are fitted


def exponents(k: int, degree: int) -> Int[np.ndarray, "terms k"]:
    """Of all monomials of k variables up to a degree."""
    factors = (c for total in range(degree + 1) for c in combinations_with_replacement(range(k), total))
    return np.array([np.bincount(np.array(c, dtype=int), minlength=k) for c in factors])


def monomials(z: Float[np.ndarray, "n k"], powers: Int[np.ndarray, "terms k"]) -> Float[np.ndarray, "n terms"]:
    found = np.ones((len(z), len(powers)), z.dtype)
    for i in range(z.shape[1]):
        found *= z[:, [i]] ** powers[:, i]
    return found


def degree_for(k: int) -> int:
    """The highest that `POINTS` simulations of k variables bear."""
    borne = [degree for degree in range(2, LARGEST_DEGREE + 1) if comb(k + degree, degree) * POINTS_A_TERM <= POINTS]
    return max(borne, default=1)


@dataclass(frozen=True)
class Polynomial:
    """Values (samples,) and derivatives (k, samples) at standardised z, in single precision."""

    powers: Int[np.ndarray, "terms k"]
    coefficients: Float[np.ndarray, "terms samples"]
    slope_powers: Int[np.ndarray, "lower k"]
    slopes: Float[np.ndarray, "lower k samples"]

    @classmethod
    def through(cls, z: Float[np.ndarray, "n k"], y: Float[np.ndarray, "n samples"]) -> "Polynomial":
        """The least-squares polynomial of the highest degree that these points bear."""
        k = z.shape[1]
        powers, lower = exponents(k, degree_for(k)), exponents(k, degree_for(k) - 1)
        coefficients = np.linalg.lstsq(monomials(z, powers), y, rcond=None)[0]
        place = {tuple(row): i for i, row in enumerate(lower)}
        slopes = np.zeros((len(lower), k, y.shape[1]))
        for power, coefficient in zip(powers, coefficients, strict=True):
            for i in np.flatnonzero(power):
                slopes[place[tuple(power - np.eye(k, dtype=int)[i])], i] += power[i] * coefficient
        return cls(powers, coefficients.astype(np.float32), lower, slopes.astype(np.float32))

    def at(self, kept: Int[np.ndarray, " some"]) -> "Polynomial":
        """That of some of the samples."""
        return replace(self, coefficients=self.coefficients[:, kept], slopes=self.slopes[..., kept])

    def values(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n samples"]:
        return monomials(z.astype(np.float32), self.powers) @ self.coefficients

    def derivatives(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k samples"]:
        flat = monomials(z.astype(np.float32), self.slope_powers) @ self.slopes.reshape(len(self.slopes), -1)
        return flat.reshape(len(z), *self.slopes.shape[1:])


@dataclass(frozen=True)
class Emulator:
    """The model along orthonormal `directions` (p, k) of parameters and nuisances in units of their spread.

    A point there is middle + directions (centre + scale z), with |z| about 1 where the model was simulated and limits
    low and high to z beyond which the polynomial stands for nothing. `std` is the noise averaged over simulations.
    """

    simulator: Simulator
    middle: Float[np.ndarray, " p"]
    directions: Float[np.ndarray, "p k"]
    centre: Float[np.ndarray, " k"]
    scale: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    std: Float[np.ndarray, " samples"]
    polynomial: Polynomial

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        middle: Float[np.ndarray, " p"],
        directions: Float[np.ndarray, "p k"],
        theta: Float[np.ndarray, "n d"],
        std: Float[np.ndarray, " samples"],
    ) -> "Emulator":
        """The model where theta are proposed, nuisances drawn from a normal distribution."""
        rng = generator(seed=simulator.seed, stream=Stream.STUDY, index=2)
        theta = np.resize(theta, (POINTS, theta.shape[1]))
        eta = rng.standard_normal((POINTS, len(simulator.nuisances)))
        y = np.where(simulator.windows.valid, simulator.noise_free(theta, eta), 0.0).reshape(POINTS, -1)
        good = np.isfinite(y).all(axis=1)
        if good.sum() < POINTS // 2:
            raise InputError("features=score: most simulations fail; narrow the prior")
        raw = (np.concatenate([theta / simulator.space.prior_std, eta], axis=1)[good] - middle) @ directions
        centre, scale = raw.mean(axis=0), raw.std(axis=0)
        z = (raw - centre) / scale
        polynomial = Polynomial.through(z, y[good])
        return cls(simulator, middle, directions, centre, scale, z.min(axis=0), z.max(axis=0), std, polynomial)

    def point(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n p"]:
        """Parameters and nuisances at z, in units of their spread."""
        return self.middle + (self.centre + self.scale * z) @ self.directions.T

    def coordinates(self, point: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n k"]:
        """z of parameters and nuisances in units of their spread."""
        return ((point - self.middle) @ self.directions - self.centre) / self.scale

    def fitted(self, y: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, "n p"]:
        """Parameters and nuisances, in units of their spread, that explain each series; NaN where it is not finite."""
        flat = y.reshape(len(y), -1).astype(np.float32)
        z = np.full((len(y), len(self.scale)), np.nan)
        finite = np.flatnonzero(np.isfinite(flat).all(axis=1))
        thinned = np.arange(self.std.size).reshape(self.simulator.shape)[:, ::THINNED].reshape(-1)
        coarse = self.polynomial.at(thinned)
        for rows in np.array_split(finite, max(1, len(finite) * self.polynomial.slopes[0].size // AT_ONCE)):
            z[rows] = self._fit(flat[rows], coarse, thinned)
        return self.point(z)

    def _fit(
        self, y: Float[np.ndarray, "n samples"], coarse: Polynomial, thinned: Int[np.ndarray, " some"]
    ) -> Float[np.ndarray, "n k"]:
        few, average = y[:, thinned], self.std[thinned].astype(np.float32)
        z = np.zeros((len(y), len(self.scale)))
        for _ in range(AVERAGE_STEPS):
            z = self._step(z, (few - coarse.values(z)) / average, coarse.derivatives(z) / average)
        for _ in range(OWN_STEPS):
            at = coarse.values(z)
            std = self._noise(at)
            z = self._step(z, _drawn_back((few - at) / std), coarse.derivatives(z) / std[:, None])
        for _ in range(SIMULATED_STEPS):
            at = self._simulated(z)
            std = self._noise(at)
            z = self._step(z, _drawn_back((y - at) / std), self.polynomial.derivatives(z) / std[:, None])
        return z

    def _step(
        self, z: Float[np.ndarray, "n k"], white: Float[np.ndarray, "n samples"], J: Float[np.ndarray, "n k samples"]
    ) -> Float[np.ndarray, "n k"]:
        """One Gauss-Newton step, residuals and derivatives in units of the noise; none where a simulation failed."""
        precision = self.scale**2
        score = (J @ white[..., None])[..., 0] - precision * (z + self.centre / self.scale)
        step = np.linalg.solve(J @ J.transpose(0, 2, 1) + np.diag(precision), score[..., None])[..., 0]
        return np.clip(z + np.where(np.isfinite(step), step, 0.0), self.low, self.high)

    def _simulated(self, z: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n samples"]:
        """The model itself, carried on by the polynomial where z lies outside the prior's box."""
        simulator, spread, d = self.simulator, self.simulator.space.prior_std, len(self.simulator.space)
        at = self.point(z)
        theta = np.clip(at[:, :d] * spread, simulator.space.low, simulator.space.high)
        y, _ = simulator.run(theta, simulator.nuisance_draws(at[:, d:]), np.float32)
        inside = np.concatenate([theta / spread, at[:, d:]], axis=1)
        beyond = self.polynomial.values(z) - self.polynomial.values(self.coordinates(inside))
        return np.where(simulator.windows.valid, y, np.float32(0.0)).reshape(beyond.shape) + beyond

    def _noise(self, y: Float[np.ndarray, "n samples"]) -> Float[np.ndarray, "n samples"]:
        """Standard deviation of each sample, in single precision."""
        noise = self.simulator.noise
        return noise.std(y.reshape(len(y), len(noise.share), -1)).reshape(y.shape).astype(np.float32)


def _drawn_back(residual: np.ndarray) -> np.ndarray:
    """Residuals in standard deviations, drawn back smoothly to `BOUNDED`."""
    return np.float32(BOUNDED) * np.tanh(residual / np.float32(BOUNDED))
