"""A chain of Gibbs sampling over the levels of groups, compiled: what `inclusion` runs.

One group's amplitude is drawn given all others; with S = A^-1, m = S b and the eigenvalues e and vectors V of the
group's block of S, a change d of its precision changes the log evidence by
sum_i [ - 1/2 log(1 + d e_i) - 1/2 d u_i^2 / (1 + d e_i) ] + q/2 log(ratio of precisions),   u = V' m of the group.
Sums are loops here for the sake of compilation (see `inverse`).
"""

import math
from typing import NamedTuple

import numpy as np

from vehicle_sbi.compiled import compiled_apart, compiled_beside
from vehicle_sbi.mismatch.selection.coefficient import log_box, log_square, mostly_within, off_zero
from vehicle_sbi.mismatch.selection.inverse import LEAST, along, factorise, rounded, set_precision, with_precision

REFRESHED = 20  # sweeps after which S is factorised anew, against rounding
REDRAWN = 10  # times that each coefficient of a draw is drawn given all others
SWAPS = 6  # of two groups' states, tried in a sweep
HELD = 1e-3  # standard deviation of the shape of what is not there


class Believed(NamedTuple):
    """What is believed of groups, for compiled functions; group g has columns from first[g] to stop[g]. Column
    boxes + i is a shape of the groups g for which shaped[i, g], if there are any, and held where none of them is."""

    first: np.ndarray
    stop: np.ndarray
    amplitude: np.ndarray
    share: np.ndarray
    named: np.ndarray
    low: np.ndarray
    high: np.ndarray
    boxes: int
    outside: float
    shaped: np.ndarray


class State(NamedTuple):
    """Where a chain is, all of which changes in place: the level of each group, each column's precision, S and m, and
    the standard deviations of coefficients in slabs, else 0."""

    level: np.ndarray
    precision: np.ndarray
    S: np.ndarray
    m: np.ndarray
    slab: np.ndarray


@compiled_apart
def _chosen(log_weight: np.ndarray) -> int:
    """One of several, with probability in proportion to its weight; none of no weight."""
    most, total, last = _largest(log_weight), 0.0, 0
    for k in range(len(log_weight)):
        total += math.exp(log_weight[k] - most)
    left = np.random.random() * total
    for k in range(len(log_weight)):
        weight = math.exp(log_weight[k] - most)
        left -= weight
        if left < 0.0:
            return k
        if weight > 0.0:
            last = k
    return last


@compiled_apart
def _largest(values: np.ndarray) -> float:
    most = -np.inf
    for value in values:
        most = max(most, value)
    return most


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
def _odds(rate_odds, believed, missing, discrepant):
    """Odds of all groups, with the factors that effects and discrepancies share."""
    odds = np.empty(len(rate_odds))
    for g in range(len(odds)):
        odds[g] = rate_odds[g] * (missing if believed.named[g] else discrepant)
    return odds


@compiled_apart
def _level_evidence(g, believed, state):
    """Of each level of a group the change of log evidence, mass of coefficients with bounds included."""
    first, last, S, m = believed.first[g], believed.stop[g], state.S, state.m
    amplitude, low, high = believed.amplitude, believed.low, believed.high
    q, n = last - first, len(m)
    e, _, W, u = along(first, last, S, m)
    found, c = np.empty(amplitude.shape[1]), np.empty(q)
    for k in range(amplitude.shape[1]):
        sd = amplitude[g, k]
        if sd <= 0.0:
            found[k] = -np.inf
            continue
        to = 1.0 / sd**2
        d = to - state.precision[first]
        found[k] = 0.5 * q * math.log(to / state.precision[first])
        for i in range(q):
            grown = max(1.0 + d * max(e[i], 0.0), LEAST)
            c[i] = d / grown
            found[k] += -0.5 * math.log(grown) - 0.5 * c[i] * u[i] ** 2
        own = _width(g, k, believed)
        if own > 0.0:
            found[k] -= log_square(0.0, own * own, low[first], high[first]) - 2.0 * math.log(own)
        for j in range(n):
            width = own if first <= j < last else state.slab[j]
            boxed = j < believed.boxes
            if width <= 0.0 and not boxed:
                continue
            mean, variance = m[j], S[j, j]
            for i in range(q):
                mean -= c[i] * W[i, j] * u[i]
                variance -= c[i] * W[i, j] ** 2
            variance = max(variance, 1e-300)
            if boxed:
                found[k] += log_box(mean, variance, low[j], high[j], believed.outside)
            else:
                found[k] += log_square(mean, variance, low[j], high[j]) - 2.0 * math.log(width)
    return found


@compiled_apart
def _own_shapes(g, believed, level):
    """Columns of shapes that are free if a group is there and held if it is not, whichever it is now."""
    own = np.empty(len(believed.shaped), np.int64)
    count = 0
    for i in range(len(believed.shaped)):
        alone = believed.shaped[i, g]
        for h in range(len(level)):
            if h != g and level[h] > 0 and believed.shaped[i, h]:
                alone = False
        if alone:
            own[count] = believed.boxes + i
            count += 1
    return own[:count]


@compiled_apart
def _shape(columns, free, state):
    """Free shapes, or hold them; the change of log evidence without that of masses within bounds."""
    gained, to = 0.0, 1.0 if free else HELD**-2
    for j in columns:
        d = to - state.precision[j]
        if d != 0.0:
            grown = max(1.0 + d * max(state.S[j, j], 0.0), LEAST)
            gained += 0.5 * (math.log(to / state.precision[j]) - math.log(grown) - d * state.m[j] ** 2 / grown)
            set_precision(j, j + 1, to, state.precision, state.S, state.m)
    return gained


@compiled_apart
def _width(g, level, believed):
    """Standard deviation of a named coefficient in a slab; 0 in its spike, and of groups of several columns."""
    alone = believed.stop[g] - believed.first[g] == 1
    return believed.amplitude[g, level] if level > 0 and believed.named[g] and alone else 0.0


@compiled_apart
def _drawn(H, believed, state):
    """Coefficients given the levels: from their normal, then those with a box or in a slab one after another given all
    others (Gibbs), under their priors' whole densities."""
    m, S, low, high = state.m, state.S, believed.low, believed.high
    n, boxed = len(m), believed.boxes
    A = with_precision(H, state.precision)
    x = _with_precision_of(A)
    for j in range(n):
        x[j] += m[j]
    for j in range(n):  # moved within its bounds, the others with it: what hardly can be told apart follows
        if (j < boxed or state.slab[j] > 0.0) and not low[j] <= x[j] <= high[j]:
            to = _drawn_alone(j, m[j], math.sqrt(S[j, j]), believed)
            step = (to - x[j]) / S[j, j]
            for i in range(n):
                x[i] += step * S[i, j]
    off = np.empty(n)
    for _ in range(REDRAWN):
        for i in range(n):
            off[i] = 0.0
            for j in range(n):
                off[i] += A[i, j] * (x[j] - m[j])
        for j in range(n):
            if j >= boxed and state.slab[j] <= 0.0:
                continue
            std = 1.0 / math.sqrt(A[j, j])
            mean = x[j] - off[j] * std * std
            to = _drawn_alone(j, mean, std, believed)
            for i in range(n):
                off[i] += (to - x[j]) * A[j, i]
            x[j] = to
    return x


@compiled_apart
def _drawn_alone(j, mean, std, believed):
    """A coefficient with a box or in a slab, from its normal under its prior's whole density."""
    if j < believed.boxes:
        return mostly_within(mean, std, believed.low[j], believed.high[j], believed.outside)
    return off_zero(mean, std, believed.low[j], believed.high[j])


@compiled_apart
def _with_precision_of(A):
    """A draw x from the normal about 0 with precision A: of L' x = z, where A = L L' and z is white."""
    L = np.linalg.cholesky(A)
    x = np.empty(len(A))
    for i in range(len(x)):
        x[i] = np.random.standard_normal()
    for i in range(len(x) - 1, -1, -1):
        x[i] /= L[i, i]
        for j in range(i):
            x[j] -= L[i, j] * x[i]
    return x


@compiled_apart
def started(H, b, believed, begin):
    """A state with these levels."""
    n = len(b)
    precision, slab = np.ones(n), np.zeros(n)
    for g in range(len(begin)):
        if begin[g] == 0:
            for j in _own_shapes(g, believed, begin):
                precision[j] = HELD**-2
        for j in range(believed.first[g], believed.stop[g]):
            precision[j] = believed.amplitude[g, begin[g]] ** -2
            slab[j] = _width(g, begin[g], believed)
    S, m = np.empty((n, n)), np.empty(n)
    factorise(H, b, precision, S, m)
    return State(begin.copy(), precision, S, m, slab)


@compiled_beside
def run_chain(H, b, believed, alike, rate_odds, factors, begin, counts, seed):
    """One chain; levels, coefficients and their means of every so many sweeps."""
    np.random.seed(seed)
    (missings, discrepants), (sweeps, forgotten, every) = factors, counts
    state, k, n = started(H, b, believed, begin), len(begin), len(b)
    missing, discrepant = missings[-1], discrepants[-1]
    kept = (sweeps - forgotten) // every
    levels, values, means = np.zeros((kept, k), np.int64), np.zeros((kept, n)), np.zeros((kept, n))
    row = 0
    for sweep in range(sweeps):
        odds = _odds(rate_odds, believed, missing, discrepant)
        for _ in range(k):
            g = np.random.randint(k)
            _put(g, _chosen(_log_weights(g, odds, believed, state)), H, b, believed, state)
        for _ in range(SWAPS):
            _swap(alike, odds, H, b, believed, state)
        if sweep % REFRESHED == 0:
            factorise(H, b, state.precision, state.S, state.m)
        missing, discrepant = _factors(missings, discrepants, discrepant, rate_odds, believed, state.level)
        if sweep >= forgotten and (sweep - forgotten) % every == 0 and row < kept:
            drawn = _drawn(H, believed, state)
            for j in range(n):
                values[row, j], means[row, j] = drawn[j], state.m[j]
            for g in range(k):
                levels[row, g] = state.level[g]
            row += 1
    return levels, values, means


@compiled_apart
def _factors(missings, discrepants, discrepant, rate_odds, believed, level):
    """Draws of both shared factors, one after the other, given the levels."""
    weight = np.empty(len(missings))
    for i in range(len(missings)):
        weight[i] = _log_prior(level, believed, _odds(rate_odds, believed, missings[i], discrepant))
    missing = missings[_chosen(weight)]
    weight = np.empty(len(discrepants))
    for i in range(len(discrepants)):
        weight[i] = _log_prior(level, believed, _odds(rate_odds, believed, missing, discrepants[i]))
    return missing, discrepants[_chosen(weight)]


@compiled_apart
def _log_weights(g, odds, believed, state):
    """Of each level of a group the log of prior and evidence, over those of the first."""
    weight, share = _shaped_evidence(g, believed, state), believed.share
    nothing = weight[0]
    weight[0] = 0.0
    for k in range(1, len(weight)):
        weight[k] += math.log(odds[g] * share[g, k]) - nothing if share[g, k] > 0.0 else -np.inf
    return weight


@compiled_apart
def _shaped_evidence(g, believed, state):
    """Of each level of a group the change of log evidence, with its shapes free in all but the first."""
    found, own = _level_evidence(g, believed, state), _own_shapes(g, believed, state.level)
    if len(own) == 0:
        return found
    there, precision, S, m = state.level[g] > 0, state.precision.copy(), state.S.copy(), state.m.copy()
    gained = _shape(own, not there, state)
    other = _level_evidence(g, believed, state)
    for k in range(len(found)):
        if (k > 0) != there:
            found[k] = other[k] + gained
    state.precision[:], state.S[:], state.m[:] = precision, S, m
    return found


@compiled_apart
def _put(g, to, H, b, believed, state):
    """Give a group another level, and free or hold its shapes.

    Where groups that are like each other come and go, rounding grows by up to their ratio of precisions each time.
    """
    if to == state.level[g]:
        return
    first, stop = believed.first[g], believed.stop[g]
    set_precision(first, stop, believed.amplitude[g, to] ** -2, state.precision, state.S, state.m)
    state.level[g] = to
    for j in range(first, stop):
        state.slab[j] = _width(g, to, believed)
    own = _own_shapes(g, believed, state.level)
    _shape(own, to > 0, state)
    off = rounded(first, H, state.precision, state.S)
    for j in own:
        off = off or rounded(j, H, state.precision, state.S)
    if off:
        factorise(H, b, state.precision, state.S, state.m)


@compiled_apart
def _swap(alike, odds, H, b, believed, state):
    """Exchange one group that is in for another that is out and is like it, if Metropolis and Hastings accept it.

    Groups are tried in proportion to `alike` (k, k); with all levels of both, so that one replaces the other at once,
    whatever their sizes are.
    """
    k, there = len(state.level), 0
    for level in state.level:
        there += 1 if level > 0 else 0
    if there == 0 or there == k:
        return
    g = _there(np.random.randint(there), state.level)
    way = np.full(k, -np.inf)
    for other in range(k):
        if state.level[other] == 0:
            way[other] = math.log(alike[g, other])
    h, ways, ways_back = _chosen(way), 0.0, 0.0
    for other in range(k):
        if state.level[other] == 0:
            ways += alike[g, other]
            ways_back += alike[h, other]
    ways_back += alike[h, g] - alike[h, h]
    before = state.level[g]
    _put(g, 0, H, b, believed, state)
    of_g, of_h = _log_weights(g, odds, believed, state), _log_weights(h, odds, believed, state)
    of_g[0] = of_h[0] = -np.inf
    if math.log(np.random.random()) < _log_sum(of_h) + math.log(ways) - _log_sum(of_g) - math.log(ways_back):
        _put(h, _chosen(of_h), H, b, believed, state)
    else:
        _put(g, before, H, b, believed, state)


@compiled_apart
def _there(before, level):
    """The group that is in and has so many before it that are."""
    for g in range(len(level)):
        if level[g] > 0:
            if before == 0:
                return g
            before -= 1
    return len(level) - 1


@compiled_apart
def _log_sum(log_weight):
    """Log of a sum of weights."""
    most, total = _largest(log_weight), 0.0
    for one in log_weight:
        total += math.exp(one - most)
    return most + math.log(total)
