"""Steps of the integrator: explicit Runge-Kutta, or linearly implicit where wheels are too fast for that.

    explicit: the classical method of fourth order, four stages
    implicit: k_i = f(x + h sum_j a_ij k_j) + h A sum_j g_ij k_j,  a_ij, g_ij those of ROS34PW2, g_ii = GAMMA
              x' = x + h sum_i b_i k_i                              (Rang and Angermann 2005, sec. 4)

A wheel that slips turns at a rate of R^2 C_kappa / (I_w v), 2000/s and more, which no sensor sees. Explicit steps have
to be shorter than that nevertheless; the implicit method is L-stable for what A tells of the equations df/dx. It keeps
its third order whatever A is, so A has the columns of the wheels' speeds and slips alone, from differences.

Both methods ask for f in turns, of which one loop makes all: the first stage, the columns of A, the other stages.
"""

from typing import NamedTuple

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart

STAGES = 4
GAMMA = 0.435866521508459
BEFORE = (  # a_ij
    (0.0, 0.0, 0.0, 0.0),
    (0.871733043016918, 0.0, 0.0, 0.0),
    (0.8445706001536942, -0.1129906423648418, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
)
COUPLED = (  # g_ij
    (GAMMA, 0.0, 0.0, 0.0),
    (-0.871733043016918, GAMMA, 0.0, 0.0),
    (-0.9033805701304408, 0.054180672388095326, GAMMA, 0.0),
    (0.24212380706095346, -1.2232505839045147, 0.5452602553351021, GAMMA),
)
WEIGHTS = (0.24212380706095346, -1.2232505839045147, 1.545260255335102, 0.435866521508459)
WHEN = (0.0, 0.871733043016918, 0.7315799577888523, 1.0)  # sum_j a_ij
EXPLICIT_WHEN = (0.0, 0.5, 0.5, 1.0)
EXPLICIT_WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
DIFFERENCE = 1e-4  # of a slip, for the columns of A
LEAST = 3.0  # speed [m/s, rad/s], of which that is a share at least


class Turn(NamedTuple):
    """What f is asked for: stage `stage` of a step, or column `column` of A, else -1."""

    stage: int
    column: int


class Work(NamedTuple):
    """What a step needs, changed in place: f of each stage and k_i (4, n), f at the step's start (n,), columns of A
    (c, n) of the states `stiff` (c,), and I - h GAMMA A among these as its factors (c, c)."""

    k: np.ndarray
    f: np.ndarray
    A: np.ndarray
    stiff: np.ndarray
    factors: np.ndarray


@compiled_apart
def workspace(states: int, stiff) -> Work:
    """Of a model of so many states, the columns of A being those of the states `stiff`, none for explicit steps."""
    c = len(stiff)
    return Work(np.zeros((STAGES, states)), np.zeros(states), np.zeros((c, states)), stiff, np.zeros((c, c)))


@compiled
def turn_of(evaluation: int, columns: int) -> Turn:
    """What evaluation number so-and-so of a step is for."""
    if 0 < evaluation <= columns:
        return Turn(0, evaluation - 1)
    return Turn(evaluation - columns if evaluation > columns else 0, -1)


@compiled
def when(turn: Turn, columns: int) -> float:
    """At which share of the step f is asked for."""
    return WHEN[turn.stage] if columns else EXPLICIT_WHEN[turn.stage]


@compiled
def difference(state, i: int, wheels: int) -> float:
    """By how much state i is moved: speeds by a share of themselves, slips by as much."""
    return DIFFERENCE * max(abs(state[i]), LEAST) if i < wheels else DIFFERENCE


@compiled
def approach(work: Work, turn: Turn, state, slips: int, h: float, trial) -> None:
    """Fill `trial` with where f is asked for; states from `slips` on are slips."""
    columns = len(work.stiff)
    for i in range(len(state)):
        moved = 0.0
        for j in range(turn.stage):
            moved += (BEFORE[turn.stage][j] if columns else _explicit(turn.stage, j)) * work.k[j, i]
        trial[i] = state[i] + h * moved
    if turn.column >= 0:
        i = work.stiff[turn.column]
        trial[i] += difference(state, i, slips)


@compiled
def _explicit(stage: int, j: int) -> float:
    """a_ij of the explicit method."""
    return EXPLICIT_WHEN[stage] if j == stage - 1 else 0.0


@compiled
def take(work: Work, turn: Turn, rate, slips: int, h: float, state) -> None:
    """Take f as it is found, `rate`, into the step; the state moves on with its last stage."""
    columns = len(work.stiff)
    if turn.column >= 0:
        by = difference(state, work.stiff[turn.column], slips)
        for i in range(len(rate)):
            work.A[turn.column, i] = (rate[i] - work.f[i]) / by
        if turn.column == columns - 1:
            factorise(work, h)
            solve(work, h, work.f, work.k[0])
        return
    for i in range(len(rate)):
        work.f[i] = rate[i]
        work.k[turn.stage, i] = rate[i]
    if columns and turn.stage > 0:
        couple(work, turn.stage, h)
        solve(work, h, work.f, work.k[turn.stage])
    if turn.stage == STAGES - 1:
        for i in range(len(state)):
            for j in range(STAGES):
                state[i] += h * (WEIGHTS[j] if columns else EXPLICIT_WEIGHTS[j]) * work.k[j, i]


@compiled_apart
def couple(work: Work, stage: int, h: float) -> None:
    """Add h A sum_j g_ij k_j, over the stages before, to f."""
    for c in range(len(work.stiff)):
        along = 0.0
        for j in range(stage):
            along += COUPLED[stage][j] * work.k[j, work.stiff[c]]
        for i in range(len(work.f)):
            work.f[i] += h * along * work.A[c, i]


@compiled_apart
def factorise(work: Work, h: float) -> None:
    """Factors of I - h GAMMA A among the stiff states, by elimination.

    A column with which a state would drive itself away, a tyre's past its peak, is left to the explicit part: implicit
    steps may have no solution there.
    """
    A, stiff, factors = work.A, work.stiff, work.factors
    n = len(stiff)
    for c in range(n):
        if A[c, stiff[c]] > 0.0:
            A[c, :] = 0.0
    for r in range(n):
        for c in range(n):
            factors[r, c] = (1.0 if r == c else 0.0) - h * GAMMA * A[c, stiff[r]]
    for pivot in range(n):
        for r in range(pivot + 1, n):
            factors[r, pivot] /= factors[pivot, pivot]
            for c in range(pivot + 1, n):
                factors[r, c] -= factors[r, pivot] * factors[pivot, c]


@compiled_apart
def solve(work: Work, h: float, right, out) -> None:
    """Fill out (n,) with x where (I - h GAMMA A) x = right."""
    A, stiff, factors = work.A, work.stiff, work.factors
    n = len(stiff)
    x = np.empty(n)
    for r in range(n):
        x[r] = right[stiff[r]]
        for c in range(r):
            x[r] -= factors[r, c] * x[c]
    for r in range(n - 1, -1, -1):
        for c in range(r + 1, n):
            x[r] -= factors[r, c] * x[c]
        x[r] /= factors[r, r]
    for i in range(len(out)):
        out[i] = right[i]
        for c in range(n):
            out[i] += h * GAMMA * A[c, i] * x[c]
