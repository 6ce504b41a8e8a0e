"""The fit of a model to what was recorded, under noise that is estimated together with it.

The series y(theta) + J_x x + noise has parameters theta in a box, initial states x of each window with a known spread,
and autocorrelated noise. `Metric` takes changes of the series to units in which noise and initial states together are
independent standard normal,

    A = (I + J_x' J_x)^(-1/2) W        W whitens the noise, J_x is whitened and in units of the initial states' spread

so that everything else is least squares: Gauss-Newton steps in A's units inside the box, noise estimated from what the
fit leaves over, both in turn until neither moves.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from vehicle_sbi.data.noise import MeasurementNoise, from_residual, sensor_noise
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.problem.observation import Observation, Series

STEP = 3e-5  # of the prior's width or of an initial state's standard deviation, for differences: so long that loops,
# which end at 1e-9, are no part of them, and so short that derivatives by stiffnesses are off by half a percent at most
DAMPING = 1e-3  # information in units of the prior that keeps directions which nothing sees from running away
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)  # of a Gauss-Newton step that are tried
DAMPINGS = (1e-4, 1e-3, 0.01, 0.1, 1.0)  # of steps that are damped, as shares of the curvature
PROMISED = 0.6  # of the gain that a step promises, below which others are tried too
MOST_STEPS = 15
CONVERGED = 0.01  # decrease of half the sum of squares, which is log likelihood, at which a fit ends
NOISE_ROUNDS = 4  # of fit and noise at most
MEMORY_S = 0.5  # [s], the correlation time of noise at most: what is slower is physics, or a sensor that drifts
STATES = ("v_x", "v_y", "r")


@dataclass(frozen=True)
class Linear:
    """The model about theta: y, its derivatives J (d, channels, time) by theta in units of the prior's standard
    deviations, and J_x (k, channels, time) by each kind of initial state, of all windows at once, in theirs."""

    y: Series
    J: Float[np.ndarray, "d channels time"]
    J_x: Float[np.ndarray, "k channels time"]


def linearise(
    simulator: Simulator, theta: Float[np.ndarray, " d"], J_x: Float[np.ndarray, "k channels time"] | None = None
) -> Linear:
    """Differences towards the middle of the box, in one batch; J_x is taken as it is where it is given.

    Windows do not see each other's initial states, so one difference moves those of all windows.
    """
    d, names, space = len(theta), simulator.nuisances, simulator.space
    kinds = [kind for kind in STATES if J_x is None and any(name.startswith(f"{kind}_") for name in names)]
    steps = np.where(theta < 0.5 * (space.low + space.high), STEP, -STEP) * (space.high - space.low)
    theta_rows = theta + np.concatenate([np.zeros((1, d)), np.diag(steps), np.zeros((len(kinds), d))])
    eta_rows = np.zeros((len(theta_rows), len(names)))
    for row, kind in enumerate(kinds, start=1 + d):
        eta_rows[row] = [STEP * name.startswith(f"{kind}_") for name in names]
    y = simulator.noise_free(theta_rows, eta_rows)
    change = y[1:] - y[0]
    J = change[:d] / (steps / space.prior_std)[:, None, None]
    return Linear(y[0], J, change[d:] / STEP if J_x is None else J_x)


@dataclass(frozen=True)
class Metric:
    """Units in which noise and initial states together are independent and standard normal.

    `basis` (windows, k, channels * samples) spans what initial states do in each window, orthonormal; `gain` their
    standard deviations along it, in units of the noise.
    """

    noise: MeasurementNoise
    std: Series
    valid: Bool[np.ndarray, "channels time"]
    basis: Float[np.ndarray, "windows k samples"]
    gain: Float[np.ndarray, "windows k"]

    @classmethod
    def of(cls, simulator: Simulator, at: Linear) -> "Metric":
        noise, valid = simulator.noise, simulator.windows.valid
        std = noise.std(at.y)
        white = noise.whiten(np.nan_to_num(at.J_x), std, valid)
        _, gain, basis = np.linalg.svd(_by_window(white, noise.window), full_matrices=False)
        return cls(noise, std, valid, basis, gain)

    def __call__(self, changes: Float[np.ndarray, "*k channels time"]) -> Float[np.ndarray, "*k channels time"]:
        """Changes of the series in these units; zero where nothing was measured."""
        white = self.noise.whiten(np.nan_to_num(changes), self.std, self.valid)
        windows = _by_window(white.reshape(-1, *white.shape[-2:]), self.noise.window)
        along = windows @ self.basis.transpose(0, 2, 1)
        shrunk = along * (1.0 - 1.0 / np.sqrt(1.0 + self.gain**2))[:, None]
        return _by_channel(windows - shrunk @ self.basis, len(self.std)).reshape(white.shape)

    def states(self, residual: Series, at: Linear) -> Series:
        """The part of a residual that the likeliest initial states explain."""
        white = _by_window(self.noise.whiten(np.nan_to_num(residual), self.std, self.valid)[None], self.noise.window)
        J = _by_window(self.noise.whiten(np.nan_to_num(at.J_x), self.std, self.valid), self.noise.window)
        information = J @ J.transpose(0, 2, 1) + np.eye(J.shape[1])
        x = np.linalg.solve(information, J @ white.transpose(0, 2, 1))
        raw = _by_window(np.nan_to_num(at.J_x), self.noise.window)
        return _by_channel(x.transpose(0, 2, 1) @ raw, len(self.std))[0]

    def log_likelihood(self, residual: Series) -> float:
        """Log density of a residual: noise and initial states, without the constant of the standard normal."""
        return float(-0.5 * np.sum(self(residual) ** 2) - self.log_scale.sum())

    @property
    def log_scale(self) -> Series:
        """Log of the volume that a unit of each sample stands for: its noise given the sample before, and an equal part
        of what initial states add to the samples of its window; zero where nothing was measured."""
        scale, window = np.where(self.valid, np.log(self.std), 0.0), self.noise.window
        for channel, rho in enumerate(self.noise.rho):
            kept = np.flatnonzero(self.valid[channel])
            same = kept[:-1] // window == kept[1:] // window
            scale[channel, kept[1:][same]] += 0.5 * np.log1p(-(rho ** (2.0 * np.diff(kept)[same]))) if rho > 0 else 0.0
        states, of = 0.5 * np.log1p(self.gain**2).sum(axis=1), np.arange(self.valid.shape[1]) // window
        samples = np.maximum(self.valid.sum(axis=0) @ (of[:, None] == np.arange(len(states))), 1)
        return scale + np.where(self.valid, (states / samples)[of], 0.0)


def _by_window(series: Float[np.ndarray, "k channels time"], window: int) -> Float[np.ndarray, "windows k samples"]:
    k, channels, time = series.shape
    count = time // window
    return series.reshape(k, channels, count, window).transpose(2, 0, 1, 3).reshape(count, k, channels * window)


def _by_channel(windows: Float[np.ndarray, "windows k samples"], channels: int) -> Float[np.ndarray, "k channels time"]:
    count, k, samples = windows.shape
    split = windows.reshape(count, k, channels, samples // channels)
    return split.transpose(1, 2, 0, 3).reshape(k, channels, count * (samples // channels))


@dataclass(frozen=True)
class Shrinkage:
    """What pulls parameters towards a centre, with a precision each in units of the prior's standard deviations."""

    centre: Float[np.ndarray, " d"]
    precision: Float[np.ndarray, " d"]

    def cost(self, theta: Float[np.ndarray, "n d"], spread: Float[np.ndarray, " d"]) -> Float[np.ndarray, " n"]:
        """Half the sum of squares that being off the centre adds."""
        return 0.5 * ((theta - self.centre) / spread) ** 2 @ self.precision


@dataclass(frozen=True)
class Fit:
    """A model at its best: the observation under the noise that belongs to it, theta, and the model about it.

    `shrinkage` is what pulls its parameters, if anything does.
    """

    observation: Observation
    theta: Float[np.ndarray, " d"]
    at: Linear
    shrinkage: Shrinkage | None = None

    @property
    def simulator(self) -> Simulator:
        return self.observation.simulator

    @cached_property
    def metric(self) -> Metric:
        return Metric.of(self.simulator, self.at)

    @cached_property
    def residual(self) -> Series:
        """Recorded less simulated, zero where nothing was measured."""
        return np.where(self.simulator.windows.valid, self.observation.observed - self.at.y, 0.0)

    @property
    def unexplained(self) -> Series:
        """The residual without what the likeliest initial states explain."""
        rest = self.residual - self.metric.states(self.residual, self.at)
        return np.where(self.simulator.windows.valid, rest, 0.0)

    @cached_property
    def log_likelihood(self) -> float:
        return self.metric.log_likelihood(self.residual)

    def pulled(self, theta: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """What shrinkage costs at each theta."""
        return (
            np.zeros(len(theta))
            if self.shrinkage is None
            else self.shrinkage.cost(theta, self.simulator.space.prior_std)
        )

    def costs(
        self, theta: Float[np.ndarray, "n d"], y: Float[np.ndarray, "n channels time"]
    ) -> Float[np.ndarray, " n"]:
        """Half the sum of squares that each theta and the series there leave, with what shrinkage costs; infinite where
        the simulation failed."""
        residual = np.where(self.simulator.windows.valid, self.observation.observed - y, 0.0)
        return cost(self.metric, residual) + self.pulled(theta)

    @property
    def inside(self) -> Bool[np.ndarray, " d"]:
        """Which parameters lie inside their box rather than on its rim, so that they could still move either way."""
        space = self.simulator.space
        margin = 1e-3 * (space.high - space.low)
        return (self.theta > space.low + margin) & (self.theta < space.high - margin)

    @cached_property
    def white(self) -> Float[np.ndarray, "d samples"]:
        """Derivatives in the metric's units."""
        return self.metric(self.at.J).reshape(len(self.theta), -1)

    @cached_property
    def information(self) -> Float[np.ndarray, "d d"]:
        """Fisher information in units of the prior's standard deviations."""
        return self.white @ self.white.T

    def at_point(
        self, theta: Float[np.ndarray, " d"], at: Linear, white: Float[np.ndarray, "d samples"] | None = None
    ) -> "Fit":
        """The fit at another point, with the derivatives there, in the metric's units too if they are known.

        Where noise is no share of the signal, and initial states do what they did, units are the same there.
        """
        there = replace(self, theta=theta, at=at)
        if at.J_x is self.at.J_x and not self.simulator.noise.share.any():
            vars(there).update({"metric": self.metric} | ({} if white is None else {"white": white}))
        return there

    @property
    def precision(self) -> Float[np.ndarray, "d d"]:
        """Of the parameters in standard deviations of their boxes, under a normal prior as wide as these, or as narrow
        as shrinkage."""
        pull = np.ones(len(self.theta)) if self.shrinkage is None else np.maximum(self.shrinkage.precision, 1.0)
        return self.information + np.diag(pull)

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """The inverse, in the parameters' own units."""
        spread = self.simulator.space.prior_std
        return np.linalg.inv(self.precision) * np.outer(spread, spread)


@dataclass(frozen=True)
class _Quadratic:
    """Half the sum of squares that the linearised model leaves about a fit, in units of the boxes' standard deviations:
    less by `slope` (d,) times a step, more by half its square in `curvature` (d, d); steps lie within `bounds`."""

    slope: Float[np.ndarray, " d"]
    curvature: Float[np.ndarray, "d d"]
    bounds: tuple[Float[np.ndarray, " d"], Float[np.ndarray, " d"]]

    @classmethod
    def about(cls, fit: Fit) -> "_Quadratic":
        space, spread = fit.simulator.space, fit.simulator.space.prior_std
        pull = fit.shrinkage or Shrinkage(fit.theta, np.full(len(spread), DAMPING))
        slope = fit.white @ fit.metric(fit.residual).reshape(-1) + pull.precision * (pull.centre - fit.theta) / spread
        room = 1e-9 * (space.high - space.low)
        bounds = (space.low - room - fit.theta) / spread, (space.high + room - fit.theta) / spread
        return cls(slope, fit.information + np.diag(pull.precision), bounds)

    def step(self, damping: float = 0.0) -> Float[np.ndarray, " d"]:
        """To the least of it, with such a share of the curvature along each parameter added (Marquardt 1963)."""
        root = np.linalg.cholesky(self.curvature + damping * np.diag(np.diag(self.curvature)))
        target = solve_triangular(root, self.slope, lower=True)
        return np.asarray(lsq_linear(root.T, target, bounds=self.bounds, method="bvls").x)

    def gain(self, step: Float[np.ndarray, " d"]) -> float:
        """By how much it falls."""
        return float(self.slope @ step - 0.5 * step @ self.curvature @ step)


def cost(metric: Metric, residual: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
    """Half the sum of squares of each residual, infinite where a simulation failed."""
    good = np.isfinite(residual).all(axis=(1, 2))
    cost = np.full(len(residual), np.inf)
    cost[good] = 0.5 * np.sum(metric(residual[good]) ** 2, axis=(1, 2))
    return cost


def descend(
    observation: Observation,
    start: Float[np.ndarray, " d"],
    steps: int = MOST_STEPS,
    shrinkage: Shrinkage | None = None,
    *,
    secant: bool = False,
    renewed: bool = True,
) -> Fit | None:
    """The optimum that Gauss-Newton finds from `start` under the noise as it is; None where the simulation fails."""
    fit = Fit(observation, start, linearise(observation.simulator, start), shrinkage)
    return onwards(fit, steps, secant=secant, renewed=renewed) if np.isfinite(fit.at.y).all() else None


def onwards(fit: Fit, steps: int, *, secant: bool = False, renewed: bool = True) -> Fit:
    """From a fit to the optimum, as far as so many steps go.

    What initial states do is taken from the start, which hardly depends on theta. With `secant` derivatives are updated
    by what each step has changed (Broyden 1965), and differences are `renewed`, if they are, only once no step helps.
    """
    fresh = True
    for _ in range(steps):
        moved = _stepped(fit)
        if moved is None and (fresh or not renewed):
            break
        theta, y = (fit.theta, fit.at.y) if moved is None else moved
        fit = _updated(fit, theta, y) if secant and moved is not None else relinearised(fit, theta)
        fresh = not secant or moved is None
    return fit


def relinearised(fit: Fit, theta: Float[np.ndarray, " d"]) -> Fit:
    """With differences about theta."""
    return fit.at_point(theta, linearise(fit.simulator, theta, fit.at.J_x))


def _stepped(fit: Fit) -> tuple[Float[np.ndarray, " d"], Series] | None:
    """The whole Gauss-Newton step, or the best of it and of shorter and damped ones where it gains less than it
    promised: theta and the series there; None where none of them gains enough."""
    quadratic, now = _Quadratic.about(fit), fit.costs(fit.theta[None], fit.at.y[None])[0]
    whole = quadratic.step()
    best = _best(fit, whole[None])
    if now - best[0] < max(PROMISED * quadratic.gain(whole), CONVERGED):
        others = [*(share * whole for share in SHARES[1:]), *map(quadratic.step, DAMPINGS)]
        best = min(best, _best(fit, np.array(others)), key=lambda one: one[0])
    return best[1:] if now - best[0] >= CONVERGED else None


def _best(fit: Fit, steps: Float[np.ndarray, "n d"]) -> tuple[float, Float[np.ndarray, " d"], Series]:
    """Of some steps, in units of the boxes' standard deviations, what the best one costs, where it leads, and the
    series there."""
    space = fit.simulator.space
    points = np.clip(fit.theta + steps * space.prior_std, space.low, space.high)
    y = fit.simulator.noise_free(points)
    there = fit.costs(points, y)
    best = int(np.argmin(there))
    return float(there[best]), points[best], y[best]


def _updated(fit: Fit, theta: Float[np.ndarray, " d"], y: Series) -> Fit:
    """With derivatives that also hold for the step that was taken."""
    step = (theta - fit.theta) / fit.simulator.space.prior_std
    along, missed = step / (step @ step), y - fit.at.y - np.tensordot(step, fit.at.J, axes=1)
    at = replace(fit.at, y=y, J=fit.at.J + along[:, None, None] * missed)
    return fit.at_point(theta, at, fit.white + np.outer(along, fit.metric(missed)))


def with_own_noise(fit: Fit, rounds: int = NOISE_ROUNDS, steps: int = MOST_STEPS, *, secant: bool = False) -> Fit:
    """The fit under the noise that it leaves over itself, both in turn until the noise stays; as is if it is known.

    What of it the sensors can have made is told by their fast scatter, whatever the model.
    """
    if not fit.observation.estimated:
        return fit
    sensor = sensor_noise(fit.observation.observed, fit.simulator.windows, MEMORY_S)
    for _ in range(rounds):
        before = fit.simulator.noise
        noise = replace(from_residual(fit.unexplained, fit.simulator.windows, MEMORY_S), sensor=sensor)
        fit = replace(fit, observation=fit.observation.extended(fit.simulator.with_noise(noise)))
        fit = onwards(fit, steps, secant=secant, renewed=False)
        if np.allclose(noise.floor, before.floor, rtol=0.01) and np.allclose(noise.rho, before.rho, atol=0.005):
            break
    return fit
