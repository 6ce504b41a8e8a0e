"""A fit at first order: what its parameters, initial states and further directions do, and how likely that is at best.

With J what parameters and initial states do, g what directions do and r the residual, the noise of each channel an
AR(1) process,

    l(k) = max over beta, a, rho, S of  - 1/2 sum_c N_c log S_c - 1/2 |beta|^2,
           N_c S_c = sum_t (e_t - rho_c e_(t-1))^2,   e = r - J beta - a g_k

is how likely the recording is with a little of direction k (its size a within bounds) under the noise that is then left
over. A parameter on the rim of its box, where what is missing may have pushed it, can come back in beside a direction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.data.noise import largest_rho
from vehicle_sbi.mismatch.estimation.fit import MEMORY_S, Fit

ITERATIONS = 6  # of sizes and noise, in turn
LEAST_VARIANCE = 1e-18
STEADYING = 1e-9  # of the diagonal, for directions that are one and the same
WIDTH = 12.0**0.5  # of a uniform prior, in its standard deviations
MODELS = 100  # at once, for memory's sake

Products = Float[np.ndarray, "3 channels i j"]


@dataclass(frozen=True)
class Linearised:
    """A fit at first order: residual, what parameters and then initial states do (m, channels, time), how many of the
    latter there are, and the runs of neighbouring valid samples of each channel, as what follows each of their first.

    `back` is what parameters do that lie on the rim, per standard deviation of the prior into the box.
    """

    fit: Fit
    J: Float[np.ndarray, "m channels time"]
    back: Float[np.ndarray, "p channels time"]
    states: int
    residual: Float[np.ndarray, "1 channels time"]
    runs: Sequence[Sequence[slice]]

    @classmethod
    def of(cls, fit: Fit) -> "Linearised":
        windows, length = fit.simulator.windows, fit.simulator.noise.window
        states = np.zeros((len(windows.x0), *fit.at.J_x.shape))
        for w in range(len(windows.x0)):
            span = slice(w * length, (w + 1) * length)
            states[w, ..., span] = fit.at.J_x[..., span]
        states = states.reshape(-1, *fit.at.y.shape)
        same = np.arange(1, windows.valid.shape[1]) % length > 0
        runs = [_runs(valid[1:] & valid[:-1] & same) for valid in windows.valid]
        J = np.concatenate([fit.at.J[fit.inside], states])
        space = fit.simulator.space
        inwards = np.where(fit.theta < 0.5 * (space.low + space.high), 1.0, -1.0)
        back = (inwards[:, None, None] * fit.at.J)[~fit.inside]
        return cls(fit, np.nan_to_num(J), np.nan_to_num(back), len(states), fit.residual[None], runs)

    @property
    def count(self) -> Float[np.ndarray, " channels"]:
        """Neighbouring valid samples of each channel."""
        return np.array([float(max(sum(run.stop - run.start for run in runs), 1)) for runs in self.runs])

    @property
    def largest_rho(self) -> float:
        """Correlation of the slowest noise."""
        return largest_rho(self.fit.simulator.windows.rate, MEMORY_S)

    def products(self, x: Float[np.ndarray, "i channels time"], y: Float[np.ndarray, "j channels time"]) -> Products:
        """Sums over neighbouring samples of x y now, x y a sample earlier, and across (symmetric).

        The second differs from the first by its ends alone, and the third is half of both less half of the product of
        differences: two matrix products instead of four.
        """
        out = np.zeros((3, x.shape[1], len(x), len(y)), np.result_type(x, y))
        for c, now, before in self._neighbours():
            a, b = x[:, c, now], y[:, c, now]
            same, changed = a @ b.T, (a - x[:, c, before]) @ (b - y[:, c, before]).T
            first, last = (np.outer(x[:, c, t], y[:, c, t]) for t in (before.start, now.stop - 1))
            out[0, c] += same
            out[1, c] += same + first - last
            out[2, c] += same + 0.5 * (first - last - changed)
        return out

    @cached_property
    def moving(self) -> Float[np.ndarray, "n channels time"]:
        """Everything that the fit can move, what can come back from the rim last."""
        return np.concatenate([self.J, self.back])

    @cached_property
    def own_products(self) -> Products:
        """Of that with itself."""
        return self.products(self.moving, self.moving)

    @cached_property
    def products_left(self) -> Products:
        """Of that with the residual."""
        return self.products(self.moving, self.residual)

    @cached_property
    def alone(self) -> float:
        """Log likelihood without any direction, under the noise that is then left over, as `profile` has it."""
        nothing = np.zeros((1, 0))
        return float(profile(self, np.zeros((1, 0, *self.fit.at.y.shape)), nothing, nothing).log_likelihood[0])

    def _neighbours(self) -> Iterator[tuple[int, slice, slice]]:
        """Channels, samples and those before them, run by run."""
        for c, runs in enumerate(self.runs):
            for run in runs:
                yield c, run, slice(run.start - 1, run.stop - 1)

    @cached_property
    def _weight(self) -> Float[np.ndarray, "3 channels"]:
        """Of the three kinds of products in the information, under the fit's noise."""
        noise = self.fit.simulator.noise
        innovation = self.fit.metric.std.mean(axis=1) ** 2 * (1.0 - noise.rho**2)
        return kinds(noise.rho) / innovation

    def absorbed(self, series: Float[np.ndarray, "k channels time"]) -> Float[np.ndarray, "k channels time"]:
        """What the fit leaves of some series once parameters and initial states have taken what they can."""
        m = len(self.J)
        H = np.einsum("tc,tcij->ij", self._weight, self.own_products[..., :m, :m]) + np.eye(m)
        taken = np.linalg.solve(H, np.einsum("tc,tcij->ij", self._weight, self.products(self.J, series)))
        return series - np.tensordot(taken.T, self.J, axes=1)

    def coherence(
        self, a: Float[np.ndarray, "i channels time"], b: Float[np.ndarray, "j channels time"]
    ) -> Float[np.ndarray, "i j"]:
        """Cosines of the angles between what the fit leaves of series a and b."""
        a, b = self.absorbed(np.nan_to_num(a)), self.absorbed(np.nan_to_num(b))
        size = [
            np.sqrt(np.maximum(np.einsum("tc,tck->k", self._weight, self.squares(series)), LEAST_VARIANCE))
            for series in (a, b)
        ]
        return np.abs(np.einsum("tc,tcij->ij", self._weight, self.products(a, b))) / np.outer(*size)

    def squares(self, series: Float[np.ndarray, "k channels time"]) -> Float[np.ndarray, "3 channels k"]:
        """Products of each series with itself."""
        out = np.zeros((3, series.shape[1], len(series)), series.dtype)
        for c, now, before in self._neighbours():
            a, b = series[:, c, now], series[:, c, before]
            out[:, c] += [np.einsum("kt,kt->k", x, y) for x, y in ((a, a), (b, b), (a, b))]
        return out

    def drawn(self, n: int, rng: np.random.Generator) -> Float[np.ndarray, "n channels time"]:
        """Noise and initial states under the fit, zero where nothing was measured."""
        noise, shape = self.fit.simulator.noise, self.fit.at.y.shape
        e = np.stack([noise.sample(shape, rng) for _ in range(n)]) * self.fit.metric.std
        e += np.tensordot(rng.standard_normal((n, self.states)), self.J[len(self.J) - self.states :], axes=1)
        return np.where(self.fit.simulator.windows.valid, e, 0.0)


def _runs(paired: Bool[np.ndarray, " time"]) -> list[slice]:
    """Where neighbours follow each other without a gap, `paired` saying of each sample whether it and the next are."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], paired.astype(int), [0]])))
    return [slice(1 + start, 1 + stop) for start, stop in edges.reshape(-1, 2).tolist()]


@dataclass(frozen=True)
class Profiled:
    """Sizes of directions at their likeliest, and the log likelihood there."""

    size: Float[np.ndarray, "k q"]
    log_likelihood: Float[np.ndarray, " k"]


@dataclass(frozen=True)
class Quadratic:
    """Products of what k models leave over at sizes x, rr - 2 b x + x H x, of the three kinds in each channel.

    `rr` has one column if all of them explain the same series.
    """

    H: Float[np.ndarray, "3 channels k n n"]
    b: Float[np.ndarray, "3 channels k n"]
    rr: Float[np.ndarray, "3 channels #k"]
    count: Float[np.ndarray, " channels"]
    largest_rho: float

    @classmethod
    def of(cls, about: Linearised, changes: Float[np.ndarray, "k q channels time"]) -> "Quadratic":
        """For everything that the fit can move, m in number, what can come back from the rim included, and one
        direction (q = 1) or none in each of k models."""
        k, q, channels, time = changes.shape
        J, changes = about.moving, np.nan_to_num(changes)
        m, flat = len(J), changes.reshape(k * q, channels, time)
        H, b = np.empty((3, channels, k, m + q, m + q)), np.empty((3, channels, k, m + q))
        H[..., :m, :m] = about.own_products[:, :, None]
        H[..., :m, m:] = about.products(J, flat).reshape(3, channels, m, k, q).transpose(0, 1, 3, 2, 4)
        H[..., m:, :m] = np.swapaxes(H[..., :m, m:], -1, -2)
        H[..., m:, m:] = about.squares(flat).reshape(3, channels, k, q, q)
        b[..., :m] = about.products_left[:, :, None, :, 0]
        b[..., m:] = about.products(flat, about.residual).reshape(3, channels, k, q)
        return cls(H, b, about.squares(about.residual), about.count, about.largest_rho)

    def noise(
        self, x: Float[np.ndarray, "k n"]
    ) -> tuple[Float[np.ndarray, "channels k"], Float[np.ndarray, "channels k"]]:
        """Correlation and innovation variance of what is left over at x."""
        left = self.rr - 2.0 * np.einsum("tcki,ki->tck", self.b, x)
        left = left + np.einsum("tckij,ki,kj->tck", self.H, x, x, optimize=True)
        return ar1(left, self.count[:, None], self.largest_rho)

    def log_likelihood(self, x: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
        """Of what is left over at x under its own noise, up to a constant."""
        return -0.5 * (self.count @ np.log(self.noise(x)[1]))

    def solved(
        self, prior: Float[np.ndarray, "n n"], low: Float[np.ndarray, "#k q"], high: Float[np.ndarray, "#k q"]
    ) -> Float[np.ndarray, "k n"]:
        """The likeliest x under noise of its own, both in turn; the last q sizes lie within low and high."""
        k, n = self.b.shape[2:]
        x = np.zeros((k, n))
        for _ in range(ITERATIONS):
            x = _bounded(*self.weighted(x, prior), low, high, n - low.shape[1])
        return x

    def weighted(
        self, x: Float[np.ndarray, "k n"], prior: Float[np.ndarray, "n n"]
    ) -> tuple[Float[np.ndarray, "k n n"], Float[np.ndarray, "k n"]]:
        """Normal equations A, g under the noise that is left over at x."""
        rho, S = self.noise(x)
        weight = kinds(rho) / S
        return np.einsum("tck,tckij->kij", weight, self.H) + prior, np.einsum("tck,tcki->ki", weight, self.b)


def profile(
    about: Linearised,
    changes: Float[np.ndarray, "k q channels time"],
    low: np.ndarray,
    high: np.ndarray,
) -> Profiled:
    """k models with a direction (q = 1) or none each, its size within low and high (k, q), all else and the noise at
    their best."""
    k, q, m, p = *changes.shape[:2], len(about.J), len(about.back)
    if k > MODELS:
        low, high = (np.broadcast_to(end, (k, q)) for end in (low, high))
        parts = [slice(first, first + MODELS) for first in range(0, k, MODELS)]
        found = [profile(about, changes[part], low[part], high[part]) for part in parts]
        each = [(one.size, one.log_likelihood) for one in found]
        return Profiled(*(np.concatenate(values) for values in zip(*each, strict=True)))
    quadratic = Quadratic.of(about, changes)
    prior = np.diag(np.repeat([1.0, 0.0], [m, p + q]))
    low, high = (
        np.concatenate([np.full((k, p), rim), np.broadcast_to(end, (k, q))], axis=1)
        for rim, end in ((0.0, low), (WIDTH, high))
    )
    x = quadratic.solved(prior, low, high)
    log_likelihood = quadratic.log_likelihood(x) - 0.5 * x**2 @ np.diag(prior)
    return Profiled(x[:, m + p :], log_likelihood)


def kinds(rho: np.ndarray) -> np.ndarray:
    """Weights of the three kinds of products in those of innovations, (3, …) for rho (…)."""
    return np.stack([np.ones_like(rho), rho**2, -2.0 * rho])


def ar1(
    left: Float[np.ndarray, "3 channels ..."], count: Float[np.ndarray, "channels ..."], largest: float
) -> tuple[Float[np.ndarray, "channels ..."], Float[np.ndarray, "channels ..."]]:
    """Correlation and innovation variance from the three kinds of products of a residual."""
    rho = np.clip(left[2] / np.maximum(left[1], LEAST_VARIANCE), 0.0, largest)
    return rho, np.maximum(np.sum(kinds(rho) * left, axis=0) / count, LEAST_VARIANCE)


def _bounded(A: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray, m: int) -> np.ndarray:
    """Solutions of A x = g whose last entries lie within their bounds, the others at their best given those.

    Solved in units in which A has a diagonal of ones: sizes may be of any order, and what steadies one must not hold
    another. The entry that goes farthest beyond a bound is held there and the rest solved again, until none does; then
    one that is held and pushes inwards is let go again, as long as that gains anything.
    """
    k, n = g.shape
    unit = np.maximum(np.diagonal(A, axis1=1, axis2=2), LEAST_VARIANCE) ** -0.5
    A, g = A * unit[:, :, None] * unit[:, None, :] + STEADYING * np.eye(n), g * unit
    bounds = np.full((2, k, n), [[[-np.inf]], [[np.inf]]])
    bounds[..., m:] = np.broadcast_to(low, (k, n - m)), np.broadcast_to(high, (k, n - m))
    low, high = bounds / unit
    x, held = _holding(A, g, low, high, np.zeros((k, n), dtype=bool), np.zeros((k, n)))
    rows = np.flatnonzero(held.any(axis=1))
    for _ in range(n - m):
        inwards = _inwards(A[rows], g[rows], low[rows], high[rows], x[rows], held[rows])
        pushed = inwards.max(axis=1, initial=0.0) > 0.0
        rows, freed = rows[pushed], held[rows[pushed]]
        if not len(rows):
            break
        freed[np.arange(len(rows)), inwards[pushed].argmax(axis=1)] = False
        tried, kept = _holding(A[rows], g[rows], low[rows], high[rows], freed, x[rows])
        better = _misfit(A[rows], g[rows], tried) < _misfit(A[rows], g[rows], x[rows])
        rows = rows[better]
        x[rows], held[rows] = tried[better], kept[better]
    return x * unit


def _holding(
    A: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray, held: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Solutions with what is held where it is `at`, and whatever goes beyond a bound held there too; and what is."""
    n, held, at, x, rows = g.shape[1], held.copy(), at.copy(), np.zeros_like(g), np.arange(len(g))
    while len(rows):
        fixed = held[rows]
        right = np.where(fixed, at[rows], g[rows])
        x[rows] = np.linalg.solve(np.where(fixed[:, :, None], np.eye(n), A[rows]), right[..., None])[..., 0]
        beyond = np.where(fixed, 0.0, np.maximum(low[rows] - x[rows], x[rows] - high[rows]))
        out = beyond.max(axis=1) > 0.0
        rows, worst = rows[out], beyond[out].argmax(axis=1)
        held[rows, worst] = True
        at[rows, worst] = np.clip(x[rows, worst], low[rows, worst], high[rows, worst])
    return np.clip(x, low, high), held


def _inwards(
    A: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray, x: np.ndarray, held: np.ndarray
) -> np.ndarray:
    """How strongly the misfit pushes what is held away from its bound, into the box."""
    push = g - (A @ x[..., None])[..., 0]
    return np.where(held & (low < high), np.where(x <= low, push, -push), 0.0)


def _misfit(A: np.ndarray, g: np.ndarray, x: np.ndarray) -> np.ndarray:
    return 0.5 * np.einsum("ki,kij,kj->k", x, A, x) - np.einsum("ki,ki->k", g, x)
