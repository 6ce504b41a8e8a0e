"""What every integrator does in a window: inputs between samples, noise in stiffnesses, whether the car drives on."""

import math

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.effects import derive
from vehicle_sbi.physics.single_track import regular

FINISHED, SPUN_OUT, NOT_FINITE = 0, 1, 2
V_X, V_Y = 0, 1  # the first of MOTION, and the first states of every model


@compiled
def blend(u, k: int, share: float, out) -> None:
    """The inputs at `share` of the way from sample k to the next, linear between samples; u (time, 9)."""
    following = min(k + 1, u.shape[0] - 1)
    for i in range(u.shape[1]):
        out[i] = u[k, i] + share * (u[following, i] - u[k, i])


@compiled_apart
def perturb(p, C, stiffness_noise, k: int) -> None:
    """Stiffnesses of sample k: C (C_kappa_f, C_kappa_r, C_alpha_f, C_alpha_r) [N, N/rad] and a draw (draws, 4) each."""
    p.C_kappa_f = C[0] + stiffness_noise[k, 0]
    p.C_kappa_r = C[1] + stiffness_noise[k, 1]
    p.C_alpha_f = C[2] + stiffness_noise[k, 2]
    p.C_alpha_r = C[3] + stiffness_noise[k, 3]
    derive(p)


@compiled
def outcome_at(motion, k: int) -> int:
    """FINISHED while MOTION at sample k is all numbers and the car goes forwards rather than sideways."""
    total = 0.0
    for i in range(motion.shape[1]):
        total += motion[k, i]
    if not math.isfinite(total):
        return NOT_FINITE
    return SPUN_OUT if abs(motion[k, V_Y]) > regular(motion[k, V_X]) else FINISHED
