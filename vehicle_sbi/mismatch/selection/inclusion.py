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
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.compiled import compiled_apart, compiled_beside
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief
from vehicle_sbi.mismatch.selection.inverse import LEAST, factorised, rounded, set_precision
from vehicle_sbi.mismatch.selection.likeness import likeness
from vehicle_sbi.threads import each

REFRESHED = 20  # sweeps after which S is factorised anew, against rounding
TAIL = 4.0 / math.sqrt(2.0 * math.pi)  # twice the mean square's factor in the tail
SWAPS = 6  # of two groups' states, tried in a sweep


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
    """States and coefficients that were kept: `level` of each group, `coefficient` of each column, and its `mean` over
    all draws with these levels, where no bound is in its way."""

    level: Int[np.ndarray, "n k"]
    coefficient: Float[np.ndarray, "n columns"]
    mean: Float[np.ndarray, "n columns"]

    @property
    def included(self) -> Bool[np.ndarray, "n k"]:
        """Whether each group is away from its first level."""
        return self.level > 0


class _Believed(NamedTuple):
    """What is believed of groups, for compiled functions; group g has columns from first[g] to stop[g]."""

    first: np.ndarray
    stop: np.ndarray
    amplitude: np.ndarray
    share: np.ndarray
    named: np.ndarray
    sign: np.ndarray
    low: np.ndarray
    high: np.ndarray
    outside: float

    @classmethod
    def of(cls, groups: Groups) -> "_Believed":
        first = np.concatenate([[groups.start], groups.stop[:-1]])
        return cls(
            first, groups.stop, groups.amplitude, groups.share, groups.named, groups.sign, groups.low, groups.high,
            groups.outside,
        )  # fmt: skip


class _State(NamedTuple):
    """Where a chain is, all of which changes in place: the level of each group, each column's precision, S and m, and
    the standard deviations of coefficients in slabs, else 0."""

    level: np.ndarray
    precision: np.ndarray
    S: np.ndarray
    m: np.ndarray
    slab: np.ndarray


def sample(
    H: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, " n"],
    groups: Groups,
    shared: Shared,
    chain: Chain,
    rng: np.random.Generator,
) -> Sampled:
    """Draws from the posterior over states and coefficients; chains start with all groups in and with none, in turn,
    and run beside each other on as many threads as simulations do."""
    believed = _Believed.of(groups)
    alike, odds = likeness(H, groups.start, groups.stop), groups.rate / (1.0 - groups.rate)
    factors = np.array(shared.missing), np.array(shared.discrepant)
    counts = chain.sweeps, chain.forgotten, chain.every

    def run(begun: tuple[np.ndarray, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return run_chain(H, b, believed, alike, odds, factors, begun[0], counts, begun[1])

    begins = [np.full(len(groups.stop), k % 2, dtype=np.int64) for k in range(chain.chains)]
    found = each(run, [(begin, int(rng.integers(2**31))) for begin in begins])
    return Sampled(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


@compiled_apart
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


@compiled_apart
def _log_box(mean: float, variance: float, low: float, high: float, outside: float) -> float:
    """Log probability of a coefficient, under its normal, to be within its box, which is wrong with a probability."""
    std = math.sqrt(2.0 * variance)
    within = 0.5 * (math.erfc((low - mean) / std) - math.erfc((high - mean) / std))
    return math.log((1.0 - outside) * within + outside)


@compiled_apart
def _chosen(log_weight: np.ndarray) -> int:
    """One of several, with probability in proportion to its weight."""
    weight = np.exp(log_weight - log_weight.max())
    left = np.random.random() * weight.sum()
    for k in range(len(weight)):
        left -= weight[k]
        if left <= 0.0:
            return k
    return len(weight) - 1


@compiled_apart
def _log_prior(level, believed, odds):
    """Log prior of all groups' levels."""
    total = 0.0
    for g in range(len(level)):
        total -= math.log1p(odds[g])
        if level[g] > 0:
            total += math.log(odds[g]) + math.log(believed.share[g, level[g]])
    return total


@compiled_apart
def _level_evidence(g, believed, state):
    """Of each level of a group the change of log evidence, mass of coefficients with bounds included."""
    first, last, S, m = believed.first[g], believed.stop[g], state.S, state.m
    amplitude, low, high = believed.amplitude, believed.low, believed.high
    q, n = last - first, len(m)
    e, V = np.linalg.eigh(np.ascontiguousarray(S[first:last, first:last]))
    u = V.T @ m[first:last]
    W = np.ascontiguousarray(S[:, first:last]) @ V
    found = np.full(amplitude.shape[1], -np.inf)
    for k in range(amplitude.shape[1]):
        sd = amplitude[g, k]
        if sd <= 0.0:
            continue
        to = 1.0 / sd**2
        d = to - state.precision[first]
        found[k] = 0.5 * q * math.log(to / state.precision[first])
        c = np.empty(q)
        for i in range(q):
            grown = max(1.0 + d * max(e[i], 0.0), LEAST)
            c[i] = d / grown
            found[k] += -0.5 * math.log(grown) - 0.5 * c[i] * u[i] ** 2
        for j in range(n):
            inside = first <= j < last
            width = _width(g, k, believed) if inside else state.slab[j]
            boxed = j < len(low)
            if width <= 0.0 and not boxed:
                continue
            mean, variance = m[j], S[j, j]
            for i in range(q):
                mean -= c[i] * W[j, i] * u[i]
                variance -= c[i] * W[j, i] ** 2
            variance = max(variance, 1e-300)
            if boxed:
                found[k] += _log_box(mean, variance, low[j], high[j], believed.outside)
            else:
                found[k] += _log_slab(mean, variance, width, believed.sign[j])
    return found


@compiled_apart
def _width(g, level, believed):
    """Standard deviation of a named coefficient in a slab; 0 in its spike, and of groups of several columns."""
    alone = believed.stop[g] - believed.first[g] == 1
    return believed.amplitude[g, level] if level > 0 and believed.named[g] and alone else 0.0


@compiled_apart
def _drawn(H, precision, m, sign, slab):
    """Coefficients from their normal, those on the wrong side of zero drawn again one after another, as Gibbs does."""
    n = len(m)
    L = np.linalg.cholesky(H + np.diag(precision))
    x = m + _solved_upwards(L, np.random.standard_normal(n))
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


@compiled_apart
def _solved_upwards(L, z):
    """x of L' x = z, L lower triangular; z is used up."""
    for i in range(len(z) - 1, -1, -1):
        z[i] /= L[i, i]
        for j in range(i):
            z[j] -= L[i, j] * z[i]
    return z


@compiled_apart
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


@compiled_apart
def _started(H, b, believed, begin):
    """A state with these levels."""
    precision, slab = np.ones(len(b)), np.zeros(len(b))
    for g in range(len(begin)):
        own = slice(believed.first[g], believed.stop[g])
        precision[own] = believed.amplitude[g, begin[g]] ** -2
        slab[own] = _width(g, begin[g], believed)
    S, m = factorised(H, b, precision)
    return _State(begin.copy(), precision, S, m, slab)


@compiled_beside
def run_chain(H, b, believed, alike, rate_odds, factors, begin, counts, seed):
    """One chain; levels, coefficients and their means of every so many sweeps."""
    np.random.seed(seed)
    (missings, discrepants), (sweeps, forgotten, every) = factors, counts
    state, k = _started(H, b, believed, begin), len(begin)
    missing, discrepant = missings[-1], discrepants[-1]
    kept = (sweeps - forgotten) // every
    levels, values, means = np.zeros((kept, k), np.int64), np.zeros((kept, len(b))), np.zeros((kept, len(b)))
    row = 0
    for sweep in range(sweeps):
        odds = _odds(rate_odds, believed, missing, discrepant)
        for _ in range(k):
            g = np.random.randint(k)
            weight = _log_weights(g, believed, state)
            weight[1:] += math.log(odds[g])
            _put(g, _chosen(weight), H, b, believed, state)
        for _ in range(SWAPS):
            _swap(alike, odds, H, b, believed, state)
        if sweep % REFRESHED == 0:
            state.S[:], state.m[:] = factorised(H, b, state.precision)
        tried = [_log_prior(state.level, believed, _odds(rate_odds, believed, one, discrepant)) for one in missings]
        missing = missings[_chosen(np.array(tried))]
        tried = [_log_prior(state.level, believed, _odds(rate_odds, believed, missing, one)) for one in discrepants]
        discrepant = discrepants[_chosen(np.array(tried))]
        if sweep >= forgotten and (sweep - forgotten) % every == 0 and row < kept:
            levels[row] = state.level
            values[row] = _drawn(H, state.precision, state.m, believed.sign, state.slab)
            means[row] = state.m
            row += 1
    return levels, values, means


@compiled_apart
def _odds(rate_odds, believed, missing, discrepant):
    """Odds of all groups, with the factors that effects and discrepancies share."""
    return rate_odds * np.where(believed.named, missing, discrepant)


@compiled_apart
def _log_weights(g, believed, state):
    """Of each level of a group the log of share and evidence, over those of the first."""
    weight, share = _level_evidence(g, believed, state), believed.share[g]
    weight -= weight[0]
    for one in range(1, len(weight)):
        weight[one] += math.log(share[one]) if share[one] > 0.0 else -np.inf
    return weight


@compiled_apart
def _put(g, to, H, b, believed, state):
    """Give a group another level.

    Where groups that are like each other come and go, rounding grows by up to their ratio of precisions each time.
    """
    if to == state.level[g]:
        return
    first, stop = believed.first[g], believed.stop[g]
    set_precision(first, stop, believed.amplitude[g, to] ** -2, state.precision, state.S, state.m)
    state.level[g] = to
    state.slab[first:stop] = _width(g, to, believed)
    if rounded(first, H, state.precision, state.S):
        state.S[:], state.m[:] = factorised(H, b, state.precision)


@compiled_apart
def _swap(alike, odds, H, b, believed, state):
    """Exchange one group that is in for another that is out and is like it, if Metropolis and Hastings accept it.

    Groups are tried in proportion to `alike` (k, k); with all levels of both, so that one replaces the other at once,
    whatever their sizes are.
    """
    there, absent = np.flatnonzero(state.level > 0), np.flatnonzero(state.level == 0)
    if len(there) == 0 or len(absent) == 0:
        return
    g = there[np.random.randint(len(there))]
    h = absent[_chosen(np.log(alike[g][absent]))]
    ways, ways_back = alike[g][absent].sum(), alike[h][absent].sum() - alike[h, h] + alike[h, g]
    before = state.level[g]
    _put(g, 0, H, b, believed, state)
    of_g, of_h = _log_weights(g, believed, state)[1:], _log_weights(h, believed, state)[1:]
    ratio = _log_sum(of_h) + math.log(odds[h] * ways) - _log_sum(of_g) - math.log(odds[g] * ways_back)
    if math.log(np.random.random()) < ratio:
        _put(h, 1 + _chosen(of_h), H, b, believed, state)
    else:
        _put(g, before, H, b, believed, state)


@compiled_apart
def _log_sum(log_weight):
    """Log of a sum of weights."""
    most = log_weight.max()
    return most + math.log(np.exp(log_weight - most).sum())
