"""Which groups of columns a linear model needs: the posterior over their amplitudes by Gibbs sampling.

With H = X X' and b = X r of whitened columns X and residual r, coefficients normal about zero with precision L(s),

    log p(r | s) = 1/2 b' A^-1 b - 1/2 log det A + 1/2 log det L + const,   A = H + L(s),

where the state s gives each group of columns one of a few amplitudes. A named effect has a *spike*, a size so small
that it is negligible, and *slabs*, sizes that it has where it is missing (George and McCulloch 1993, stochastic search
variable selection). How much is missing at all is learned, as a factor on the odds of all rates. A coefficient that
may not be negative counts in a slab by its normal's mass on the right side of zero, one that is always there by its
mass within its box. Coefficients are integrated out; those of the states that are kept are drawn afterwards.

One group's amplitude is drawn given all others; with S = A^-1, m = S b and the eigenvalues e and vectors V of the
group's block of S, a change d of its precision changes the log evidence by
sum_i [ - 1/2 log(1 + d e_i) - 1/2 d u_i^2 / (1 + d e_i) ] + q/2 log(ratio of precisions),   u = V' m of the group.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief

REFRESHED = 20  # sweeps after which S is factorised anew, against rounding
LEAST = 1e-9  # part of its precision that a direction keeps, against rounding
TAIL = 4.0 / math.sqrt(2.0 * math.pi)  # twice the mean square's factor in the tail
SWAPS = 6  # of two groups' states, tried in a sweep
UNLIKE = 0.01  # least squared cosine by which two groups are tried to be swapped
ROUNDED = 1e-8  # part of a product's terms, by which it is off where rounding has grown
HARDLY = 1e-9  # part of the largest eigenvalue, below which a direction is rounding


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Sweeps of each of several chains that start apart, how many are forgotten, and every how many one is kept."""

    chains: int = 4
    sweeps: int = 600
    forgotten: int = 150
    every: int = 3


@dataclass(frozen=True, kw_only=True)
class Groups:
    """What is believed of groups of neighbouring columns, as arrays.

    `stop` is where each group's columns end; those before `start` are always there, with a precision of 1. The first of
    these lie within `low` and `high`, but with probability `outside`. Levels begin with nothing, the spike of a named
    group, and end with zeros where a group has fewer.
    """

    low: Float[np.ndarray, " boxes"]
    high: Float[np.ndarray, " boxes"]
    outside: float
    start: int
    stop: Int[np.ndarray, " k"]
    amplitude: Float[np.ndarray, "k levels"]
    share: Float[np.ndarray, "k levels"]
    rate: Float[np.ndarray, " k"]
    named: Bool[np.ndarray, " k"]
    sign: Int[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        believed: Sequence[Belief],
        start: int,
        *,
        low: Float[np.ndarray, " boxes"],
        high: Float[np.ndarray, " boxes"],
        outside: float,
    ) -> "Groups":
        """Hypotheses one after another, behind so many columns that are always there, the first of them in boxes."""
        levels = max((len(one.amplitude) for one in believed), default=0)
        return cls(
            low=low,
            high=high,
            outside=outside,
            start=start,
            stop=start + np.cumsum([len(one.sign) for one in believed], dtype=np.int64),
            amplitude=np.array([_levels(one.nothing, one.amplitude, levels) for one in believed]),
            share=np.array([_levels(1.0, one.share, levels) for one in believed]),
            rate=np.array([one.rate for one in believed]),
            named=np.array([one.named for one in believed]),
            sign=np.concatenate([np.zeros(start, dtype=np.int64), *(one.sign for one in believed)]),
        )


def _levels(first: float, others: Float[np.ndarray, " given"], most: int) -> Float[np.ndarray, " levels"]:
    """Values of the first level, of the others that there are, and 0 for the rest."""
    return np.concatenate([[first], others, np.zeros(most - len(others))])


@dataclass(frozen=True, kw_only=True)
class Shared:
    """What all groups share and is learned: factors on the odds of effects and of discrepancies, each as likely as the
    others of its list before."""

    missing: Sequence[float] = (0.03, 0.1, 0.3, 1.0)
    discrepant: Sequence[float] = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Sampled:
    """States and coefficients that were kept: `level` of each group, `coefficient` of each column."""

    level: Int[np.ndarray, "n k"]
    coefficient: Float[np.ndarray, "n columns"]

    @property
    def included(self) -> Bool[np.ndarray, "n k"]:
        """Whether each group is away from its first level."""
        return self.level > 0


def sample(
    H: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, " n"],
    groups: Groups,
    shared: Shared,
    chain: Chain,
    rng: np.random.Generator,
) -> Sampled:
    """Draws from the posterior over states and coefficients; chains start with all groups in and with none, in turn."""
    found, alike = [], _alike(H, groups)
    for k in range(chain.chains):
        begin = np.full(len(groups.stop), k % 2, dtype=np.int64)
        found.append(
            _run(
                H, b, (groups.low, groups.high, groups.outside), alike, groups.start, groups.stop, groups.amplitude,
                groups.share, groups.rate, groups.named, groups.sign, np.array(shared.missing),
                np.array(shared.discrepant), begin, chain.sweeps, chain.forgotten, chain.every,
                int(rng.integers(2**31)),
            )
        )  # fmt: skip
    level, coefficient = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Sampled(level, coefficient)


@njit(cache=True)
def _log_slab(mean: float, variance: float, sd: float, sign: int) -> float:
    """Log of the expected weight x^2 / sd^2 of a coefficient x under its normal, none on the wrong side of zero.

    With it, the normal of a slab is a moment prior (Johnson and Rossell 2010), which has no mass at zero.
    """
    square = (mean * mean + variance) / (sd * sd)
    if sign == 0:
        return math.log(square)
    std = math.sqrt(variance)
    z = sign * mean / std
    if z < -20.0:  # the tail's expansion: the mean square is 2 phi(z) / |z|^3 (1 - 6 / z^2) variances
        return -0.5 * z * z + math.log(TAIL * variance / (sd * sd)) - 3.0 * math.log(-z) + math.log1p(-6.0 / (z * z))
    density = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    part = square * 0.5 * math.erfc(-z / math.sqrt(2.0)) + z * variance / (sd * sd) * density
    return math.log(max(2.0 * part, 1e-300))


@njit(cache=True)
def _log_box(mean: float, variance: float, low: float, high: float, outside: float) -> float:
    """Log probability of a coefficient, under its normal, to be within its box, which is wrong with a probability."""
    std = math.sqrt(2.0 * variance)
    within = 0.5 * (math.erfc((low - mean) / std) - math.erfc((high - mean) / std))
    return math.log((1.0 - outside) * within + outside)


@njit(cache=True)
def _chosen(log_weight: np.ndarray) -> int:
    """One of several, with probability in proportion to its weight."""
    weight = np.exp(log_weight - log_weight.max())
    left = np.random.random() * weight.sum()
    for k in range(len(weight)):
        left -= weight[k]
        if left <= 0.0:
            return k
    return len(weight) - 1


@njit(cache=True)
def _factorised(H, b, precision):
    """S = (H + L)^-1 and m = S b."""
    S = np.linalg.inv(H + np.diag(precision))
    S = 0.5 * (S + S.T)
    return S, S @ b


@njit(cache=True)
def _log_prior(level, share, rate, named, missing, discrepant):
    """Log prior of all groups' levels, given the factors on the odds."""
    total = 0.0
    for g in range(len(level)):
        odds = rate[g] / (1.0 - rate[g]) * (missing if named[g] else discrepant)
        total -= math.log1p(odds)
        if level[g] > 0:
            total += math.log(odds) + math.log(share[g, level[g]])
    return total


@njit(cache=True)
def _level_evidence(g, first, last, level, precision, S, m, amplitude, named, sign, slab, box):
    """Of each level of a group the change of log evidence, mass of coefficients with bounds included."""
    q, n = last - first, len(m)
    low, high, outside = box
    weighted = named[g] and q == 1
    e, V = np.linalg.eigh(np.ascontiguousarray(S[first:last, first:last]))
    u = V.T @ m[first:last]
    W = np.ascontiguousarray(S[:, first:last]) @ V
    found = np.full(amplitude.shape[1], -np.inf)
    for k in range(amplitude.shape[1]):
        sd = amplitude[g, k]
        if sd <= 0.0:
            continue
        to = 1.0 / sd**2
        d = to - precision[first]
        found[k] = 0.5 * q * math.log(to / precision[first])
        c = np.empty(q)
        for i in range(q):
            grown = max(1.0 + d * max(e[i], 0.0), LEAST)
            c[i] = d / grown
            found[k] += -0.5 * math.log(grown) - 0.5 * c[i] * u[i] ** 2
        for j in range(n):
            inside = first <= j < last
            width = (sd if k > 0 and weighted else 0.0) if inside else slab[j]
            boxed = j < len(low)
            if width <= 0.0 and not boxed:
                continue
            mean, variance = m[j], S[j, j]
            for i in range(q):
                mean -= c[i] * W[j, i] * u[i]
                variance -= c[i] * W[j, i] ** 2
            variance = max(variance, 1e-300)
            if boxed:
                found[k] += _log_box(mean, variance, low[j], high[j], outside)
            else:
                found[k] += _log_slab(mean, variance, width, sign[j])
    return found


@njit(cache=True)
def _width(g, level, first, last, amplitude, named):
    """Standard deviation of a named coefficient in a slab; 0 in its spike, and of groups of several columns."""
    return amplitude[g, level] if level > 0 and named[g] and last - first == 1 else 0.0


@njit(cache=True)
def _set_level(first, last, to, precision, S, m):
    """Give a group another precision; S, m and `precision` change in place.

    Its own rows are scaled rather than subtracted from: where a precision grows by 1e7, seven digits would be lost.
    """
    d = to - precision[first]
    if d == 0.0:
        return
    if last - first == 1:
        _set_alone(first, d, S, m)
    else:
        e, V = np.linalg.eigh(np.ascontiguousarray(S[first:last, first:last]))
        W, u = np.ascontiguousarray(S[:, first:last]) @ V, V.T @ m[first:last].copy()
        grown = np.maximum(1.0 + d * np.maximum(e, 0.0), LEAST)
        m -= W @ (d / grown * u)
        S -= (W * (d / grown)) @ W.T
        m[first:last] = V @ (u / grown)
        S[:, first:last] = (W / grown) @ V.T
        S[first:last] = S[:, first:last].T
    precision[first:last] = to


@njit(cache=True)
def _set_alone(j, d, S, m):
    """What `_set_level` does to a group of one column j, whose precision changes by d, without matrices beside S."""
    w = S[j].copy()
    grown, mean = max(1.0 + d * max(w[j], 0.0), LEAST), m[j]
    for i in range(len(m)):
        share = d / grown * w[i]
        m[i] -= share * mean
        for k in range(len(m)):
            S[i, k] -= share * w[k]
    m[j] = mean / grown
    for i in range(len(m)):
        S[i, j] = S[j, i] = w[i] / grown


@njit(cache=True)
def _drawn(H, precision, m, sign, slab):
    """Coefficients from their normal, those on the wrong side of zero drawn again one after another, as Gibbs does."""
    n = len(m)
    L = np.linalg.cholesky(H + np.diag(precision))
    x = m + np.linalg.solve(L.T, np.random.standard_normal(n))
    held = [j for j in range(n) if sign[j] != 0 and slab[j] > 0.0]
    for j in held:
        if sign[j] * x[j] < 0.0:
            x[j] = 0.0
    for _ in range(4 if len(held) else 0):
        off = H @ (x - m) + precision * (x - m)
        for j in held:
            a = H[j, j] + precision[j]
            mean = x[j] - off[j] / a
            to = sign[j] * _above_zero(sign[j] * mean, 1.0 / math.sqrt(a))
            off += (to - x[j]) * H[:, j]
            off[j] += (to - x[j]) * precision[j]
            x[j] = to
    return x


@njit(cache=True)
def _above_zero(mean, std):
    """A normal draw given that it is positive (Robert 1995)."""
    low = -mean / std
    if low < 1.0:
        while True:
            z = np.random.standard_normal()
            if z > low:
                return mean + std * z
    rate = 0.5 * (low + math.sqrt(low * low + 4.0))
    while True:
        z = low + np.random.exponential(1.0 / rate)
        if np.random.random() < math.exp(-0.5 * (z - rate) ** 2):
            return mean + std * z


@njit(cache=True)
def _run(
    H, b, box, alike, start, stop, amplitude, share, rate, named, sign, missings, discrepants, begin, sweeps,
    forgotten, every, seed,
):  # fmt: skip
    """One chain; levels and coefficients of every so many sweeps."""
    np.random.seed(seed)
    n, k = len(b), len(stop)
    level, slab = begin.copy(), np.zeros(n)
    missing, discrepant = missings[-1], discrepants[-1]
    first = np.empty(k, np.int64)
    precision = np.ones(n)
    for g in range(k):
        first[g] = start if g == 0 else stop[g - 1]
        precision[first[g] : stop[g]] = amplitude[g, level[g]] ** -2
        slab[first[g] : stop[g]] = _width(g, level[g], first[g], stop[g], amplitude, named)
    S, m = _factorised(H, b, precision)
    kept = (sweeps - forgotten) // every
    levels, values = np.zeros((kept, k), np.int64), np.zeros((kept, n))
    row = 0
    for sweep in range(sweeps):
        odds = rate / (1.0 - rate) * np.where(named, missing, discrepant)
        for _ in range(k):
            g = np.random.randint(k)
            weight = _log_weights(g, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box)
            weight[1:] += math.log(odds[g])
            _put(g, _chosen(weight), H, b, first, stop, level, precision, S, m, amplitude, named, slab)
        for _ in range(SWAPS):
            _swap(alike, odds, H, b, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box)
        if sweep % REFRESHED == 0:
            S, m = _factorised(H, b, precision)
        tried = np.array([_log_prior(level, share, rate, named, one, discrepant) for one in missings])
        missing = missings[_chosen(tried)]
        tried = np.array([_log_prior(level, share, rate, named, missing, one) for one in discrepants])
        discrepant = discrepants[_chosen(tried)]
        if sweep >= forgotten and (sweep - forgotten) % every == 0 and row < kept:
            levels[row], values[row] = level, _drawn(H, precision, m, sign, slab)
            row += 1
    return levels, values


@njit(cache=True)
def _log_weights(g, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box):
    """Of each level of a group the log of share and evidence, over those of the first."""
    weight = _level_evidence(g, first[g], stop[g], level[g], precision, S, m, amplitude, named, sign, slab, box)
    weight -= weight[0]
    for one in range(1, len(weight)):
        weight[one] += math.log(share[g, one]) if share[g, one] > 0.0 else -np.inf
    return weight


@njit(cache=True)
def _put(g, to, H, b, first, stop, level, precision, S, m, amplitude, named, slab):
    """Give a group another level; the arrays of all of them change in place.

    Where groups that are like each other come and go, rounding grows by up to their ratio of precisions each time.
    """
    if to == level[g]:
        return
    _set_level(first[g], stop[g], amplitude[g, to] ** -2, precision, S, m)
    level[g] = to
    slab[first[g] : stop[g]] = _width(g, to, first[g], stop[g], amplitude, named)
    if _rounded(first[g], H, precision, S):
        S[:], m[:] = _factorised(H, b, precision)


@njit(cache=True)
def _rounded(j, H, precision, S):
    """Whether S is no longer the inverse of H + L, by the product of a row of the one and a column of the other."""
    product = H[j] * S[j]
    product[j] += precision[j] * S[j, j]
    return not abs(product.sum() - 1.0) <= ROUNDED * np.abs(product).sum()


@njit(cache=True)
def _swap(alike, odds, H, b, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box):
    """Exchange one group that is in for another that is out and is like it, if Metropolis and Hastings accept it.

    Groups are tried in proportion to `alike` (k, k); with all levels of both, so that one replaces the other at once,
    whatever their sizes are.
    """
    there, absent = np.flatnonzero(level > 0), np.flatnonzero(level == 0)
    if len(there) == 0 or len(absent) == 0:
        return
    g = there[np.random.randint(len(there))]
    h = absent[_chosen(np.log(alike[g][absent]))]
    ways, ways_back = alike[g][absent].sum(), alike[h][absent].sum() - alike[h, h] + alike[h, g]
    before = level[g]
    _put(g, 0, H, b, first, stop, level, precision, S, m, amplitude, named, slab)
    of_g = _log_weights(g, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box)[1:]
    of_h = _log_weights(h, first, stop, level, precision, S, m, amplitude, share, named, sign, slab, box)[1:]
    ratio = _log_sum(of_h) + math.log(odds[h] * ways) - _log_sum(of_g) - math.log(odds[g] * ways_back)
    if math.log(np.random.random()) < ratio:
        _put(h, 1 + _chosen(of_h), H, b, first, stop, level, precision, S, m, amplitude, named, slab)
    else:
        _put(g, before, H, b, first, stop, level, precision, S, m, amplitude, named, slab)


@njit(cache=True)
def _log_sum(log_weight):
    """Log of a sum of weights."""
    most = log_weight.max()
    return most + math.log(np.exp(log_weight - most).sum())


def _alike(H: Float[np.ndarray, "n n"], groups: Groups) -> Float[np.ndarray, "k k"]:
    """How well groups of columns can stand for each other beside those that are always there, from `UNLIKE` to 1: the
    mean squared cosine between the directions of the smaller and those of the larger."""
    always, first = groups.start, [groups.start, *groups.stop[:-1].tolist()]
    taken = np.linalg.solve(H[:always, :always] + np.eye(always), H[:always, always:])
    left = H[always:, always:] - H[always:, :always] @ taken
    scale = np.sqrt(np.maximum(np.diag(left), np.finfo(float).tiny))
    left /= np.outer(scale, scale)
    k = len(groups.stop)
    across = np.zeros_like(left)  # rows of each group made orthonormal
    spans = [slice(a - always, b - always) for a, b in zip(first, groups.stop.tolist(), strict=True)]
    roots = [_inverse_root(left[span, span]) for span in spans]
    for span, root in zip(spans, roots, strict=True):
        across[span] = root @ left[span]
    for span, root in zip(spans, roots, strict=True):
        across[:, span] = across[:, span] @ root
    starts = np.array([span.start for span in spans], dtype=np.int64)
    width = groups.stop - always - starts
    squares = np.add.reduceat(np.add.reduceat(across**2, starts, axis=0), starts, axis=1)
    shared = squares / np.minimum.outer(width, width)
    return np.clip(shared.reshape(k, k), UNLIKE, 1.0)


def _inverse_root(A: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """A^-1/2 of a symmetric matrix, without the directions that it hardly has."""
    size, direction = np.linalg.eigh(A)
    kept = size > HARDLY * size[-1]
    return (direction[:, kept] / np.sqrt(size[kept])) @ direction[:, kept].T
