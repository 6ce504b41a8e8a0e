"""Linearly implicit steps of the integrator, for wheels that are too fast for explicit ones.

    k_i = f(x + h sum_j a_ij k_j) + h A sum_j g_ij k_j,   a_ij, g_ij those of ROS34PW2, g_ii = GAMMA
    x' = x + h sum_i b_i k_i                              (Rang and Angermann 2005, sec. 4)

A wheel that slips turns at a rate of R^2 C_kappa / (I_w v), 2000/s and more, which no sensor sees. Explicit steps have
to be shorter than that nevertheless; this method is L-stable for what A tells of the equations df/dx. It keeps its
third order whatever A is, so A has the columns of the wheels' speeds and slips alone, from differences.

f is asked for in turns, of which one loop makes all: for the first stage, the columns of A, the other stages.
"""

from typing import NamedTuple

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.window import FINISHED, blend, outcome_at, perturb

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
WEIGHTS = (0.24212380706095346, -1.2232505839045147, 1.545260255335102, 0.435866521508459)  # b_i
WHEN = (0.0, 0.871733043016918, 0.7315799577888523, 1.0)  # sum_j a_ij
DIFFERENCE = 1e-4  # of a slip, for the columns of A
SHORTER = 0.6  # of an explicit step: 1.6 bounds what is left explicit, and 2.6 the classical method
IMPLICIT_STEP = 5e-3  # [s] at most, in which a tyre swings against its wheel by 1.2 rad (250 rad/s on 0.3 m)
LEAST = 3.0  # speed [m/s, rad/s], of which that is a share at least


class Turn(NamedTuple):
    """What f is asked for: stage `stage` of a step, or column `column` of A, else -1."""

    stage: int
    column: int


class Work(NamedTuple):
    """What a step needs, changed in place: k_i (4, n), f of the last stage (n,), columns of A (c, n) of the states
    `stiff` (c,), among these I - h GAMMA A as its factors (c, c) and a solution (c,)."""

    k: np.ndarray
    f: np.ndarray
    A: np.ndarray
    stiff: np.ndarray
    factors: np.ndarray
    x: np.ndarray


@compiled_apart
def workspace(states: int, stiff) -> Work:
    """Of a model of so many states, the columns of A being those of the states `stiff`."""
    c = len(stiff)
    return Work(
        np.zeros((STAGES, states)), np.zeros(states), np.zeros((c, states)), stiff, np.zeros((c, c)), np.zeros(c)
    )


@compiled
def turn_of(evaluation: int, columns: int) -> Turn:
    """What evaluation number so-and-so of a step is for."""
    if 0 < evaluation <= columns:
        return Turn(0, evaluation - 1)
    return Turn(evaluation - columns if evaluation > columns else 0, -1)


@compiled
def difference(state, i: int, slips: int) -> float:
    """By how much state i is moved: speeds by a share of themselves, the states from `slips` on by as much."""
    return DIFFERENCE * max(abs(state[i]), LEAST) if i < slips else DIFFERENCE


@compiled_apart
def approach(work: Work, turn: Turn, state, slips: int, h: float, trial) -> None:
    """Fill `trial` with where f is asked for: x + h sum_j a_ij k_j, or the state with one of its stiff ones moved."""
    for i in range(len(state)):
        trial[i] = state[i]
        for j in range(turn.stage):
            trial[i] += h * BEFORE[turn.stage][j] * work.k[j, i]
    if turn.column >= 0:
        i = work.stiff[turn.column]
        trial[i] += difference(state, i, slips)


@compiled_apart
def take(work: Work, turn: Turn, rate, slips: int, h: float, state) -> None:
    """Take f into the step as it is found, `rate`: as the first stage's, which is solved for once all columns of A are
    known, as a column, or as a further stage's. The state moves on with the last one."""
    if turn.column >= 0:
        by = difference(state, work.stiff[turn.column], slips)
        for i in range(len(rate)):
            work.A[turn.column, i] = (rate[i] - work.f[i]) / by
        if turn.column == len(work.stiff) - 1:
            factorise(work, h)
            solve(work, h, work.f, work.k[0])
        return
    for i in range(len(rate)):
        work.f[i] = rate[i]
    if turn.stage == 0:
        return
    couple(work, turn.stage, h)
    solve(work, h, work.f, work.k[turn.stage])
    if turn.stage == STAGES - 1:
        for i in range(len(state)):
            for j in range(STAGES):
                state[i] += h * WEIGHTS[j] * work.k[j, i]


@compiled
def couple(work: Work, stage: int, h: float) -> None:
    """Add h A sum_j g_ij k_j, over the stages before, to f."""
    for c in range(len(work.stiff)):
        along = 0.0
        for j in range(stage):
            along += COUPLED[stage][j] * work.k[j, work.stiff[c]]
        for i in range(len(work.f)):
            work.f[i] += h * along * work.A[c, i]


@compiled
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


@compiled
def solve(work: Work, h: float, right, out) -> None:
    """Fill out (n,) with x where (I - h GAMMA A) x = right."""
    A, stiff, factors, x = work.A, work.stiff, work.factors, work.x
    n = len(stiff)
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


@compiled_apart
def stiff_states(model, p):
    """The states by which wheels slip, those that lag included if any do."""
    lagged = p.sigma_f > 0.0 or p.sigma_r > 0.0
    return np.array(model.STIFF + model.LAGGED)[: len(model.STIFF) + (len(model.LAGGED) if lagged else 0)]


@compiled_apart
def drive_through(model, p, drive: int, u, stiffness_noise, dt: float, substeps: int, initial, motion) -> int:
    """What `runge_kutta.drive_through` does, in steps that are implicit in how wheels slip."""
    C = (p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r)
    state, trial, rate = np.zeros(model.STATES), np.zeros(model.STATES), np.zeros(model.STATES)
    now, h, outcome = np.zeros(u.shape[1]), dt / substeps, FINISHED
    work = workspace(model.STATES, stiff_states(model, p))
    turns = len(work.stiff) + STAGES
    p.step = h / SHORTER  # slips that lag are left explicit but for what they do to wheels
    p.split_f = p.split_r = p.slope_f = p.slope_r = 0.0
    for evaluation in range(turns * substeps * (u.shape[0] - 1) + 1):
        step, turn = evaluation // turns, turn_of(evaluation % turns, len(work.stiff))
        k, sampled = step // substeps, evaluation % (turns * substeps) == 0
        blend(u, k, (step % substeps + WHEN[turn.stage]) / substeps, now)
        if sampled and k < len(stiffness_noise):
            perturb(p, C, stiffness_noise, k)
        if evaluation == 0:
            model.start(p, drive, now, initial, state)
        approach(work, turn, state, model.SLIPS, h, trial)
        model.impose(p, drive, now, trial)
        model.derivatives(p, drive, now, trial, rate)
        if sampled:
            model.record(p, drive, now, trial, rate, motion, k)
            outcome = outcome_at(motion, k)
            if outcome != FINISHED:
                break
        take(work, turn, rate, model.SLIPS, h, state)
    p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r = C
    return outcome
