"""Explicit steps of the integrator: the classical Runge-Kutta method of fourth order."""

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.window import FINISHED, blend, outcome_at, perturb

STAGES = 4


@compiled
def advance(state, rate, h: float, out) -> None:
    """out = state + h rate."""
    for i in range(len(state)):
        out[i] = state[i] + h * rate[i]


@compiled_apart
def drive_through(model, p, drive: int, u, stiffness_noise, dt: float, substeps: int, initial, motion) -> int:
    """Integrate one window and record MOTION at every sample; returns FINISHED, SPUN_OUT or NOT_FINITE.

    Between samples `substeps` classical Runge-Kutta steps of fourth order, inputs being linear. stiffness_noise
    (draws, 4) is added to (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad]: one draw for the whole window, or
    one per sample. The rate of one stage is where the next one's loops start. The four stages share one call of the
    equations of motion, which is then compiled in place: a quarter of the code, and arrays without reference counts.
    """
    C = (p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r)
    state, trial, rate, total = (
        np.zeros(model.STATES), np.zeros(model.STATES), np.zeros(model.STATES), np.zeros(model.STATES),
    )  # fmt: skip
    now, h, outcome = np.zeros(u.shape[1]), dt / substeps, FINISHED
    p.step = h
    p.split_f = p.split_r = p.slope_f = p.slope_r = 0.0
    for evaluation in range(4 * substeps * (u.shape[0] - 1) + 1):
        step, stage = evaluation // 4, evaluation % 4
        k, share = step // substeps, 0.5 * ((stage + 1) // 2)
        sampled = evaluation % (4 * substeps) == 0
        blend(u, k, (step % substeps + share) / substeps, now)
        if sampled and k < len(stiffness_noise):
            perturb(p, C, stiffness_noise, k)
        if evaluation == 0:
            model.start(p, drive, now, initial, state)
        advance(state, rate, share * h, trial)
        model.impose(p, drive, now, trial)
        model.derivatives(p, drive, now, trial, rate)
        if sampled:
            model.record(p, drive, now, trial, rate, motion, k)
            outcome = outcome_at(motion, k)
            if outcome != FINISHED:
                break
        weight = h / 6.0 if stage % 3 == 0 else h / 3.0
        for i in range(model.STATES):
            total[i] = weight * rate[i] + (trial[i] if stage == 0 else total[i])
            state[i] = total[i] if stage == 3 else state[i]
    p.C_kappa_f, p.C_kappa_r, p.C_alpha_f, p.C_alpha_r = C
    return outcome
