"""The magic formulas that a tyre's curve blends into (Pacejka, Tire and Vehicle Dynamics, sec. 4.3).

    M(z) = sin(C atan(w - E (w - atan w))),   w = z/C,   z = demand over grip

in units of the grip, of slope 1 at no demand. PEAKED and FULL have C = 3/2 and fall beyond their peaks. PEAKED has
E = 0; FULL has the E at which it bends by no third power, any less of which would make it stiffen first. Between them
and Dugoff's curve lie, within 0.0013 of the grip up to z = 1.2, those of C from 1.2 to 1.5 and E from 0.7 to 1 times
that one. With C = 1 and E = 0 the formula bends early and never falls: z / sqrt(1 + z^2). Blends with that one too are
within 0.0025 of the grip, up to 0.9 of it, of tyres of C from 1.35 to 1.65 and E from -0.5 to 0.5.

PEAKED and FULL are fixed, and a simulation asks for them a million times a second: up to z = REACH they are cubics
between knots that have the formula's values and slopes, which differ from it by less than 1e-11.
"""

import math

import numpy as np

from vehicle_sbi.compiled import compiled

PEAKED = (1.5, 0.0)  # C, E
FULL = (1.5, -(1.0 + 0.5 * 1.5**2))
REACH, INTERVALS = 4.0, 1024


@compiled
def magic_formula(z: float, C: float, E: float) -> float:
    """Force over grip at demand over grip z."""
    w = z / C
    return math.sin(C * math.atan(w - E * (w - math.atan(w))))


def _slope(z: float, C: float, E: float) -> float:
    """d(magic_formula)/dz."""
    w = z / C
    bent = w - E * (w - math.atan(w))
    return math.cos(C * math.atan(bent)) / (1.0 + bent * bent) * (1.0 - E * (1.0 - 1.0 / (1.0 + w * w)))


def _cubics() -> np.ndarray:
    """(INTERVALS + 1, 4): PEAKED's value and FULL's, then their slopes times the interval, at each knot."""
    knots, step = np.linspace(0.0, REACH, INTERVALS + 1), REACH / INTERVALS
    values = [[magic_formula(z, *shape) for shape in (PEAKED, FULL)] for z in knots]
    slopes = [[step * _slope(z, *shape) for shape in (PEAKED, FULL)] for z in knots]
    return np.hstack([values, slopes])


CUBICS = _cubics()


@compiled
def peaked_and_full(z: float) -> tuple[float, float]:
    """PEAKED and FULL at demand over grip z, not negative."""
    if not z < REACH:
        return magic_formula(z, PEAKED[0], PEAKED[1]), magic_formula(z, FULL[0], FULL[1])
    share = z * (INTERVALS / REACH)
    i = int(share)
    share -= i
    left = 1.0 - share
    before, after = left * left * (1.0 + 2.0 * share), share * share * (1.0 + 2.0 * left)
    leaving, arriving = left * left * share, -share * share * left
    peaked = before * CUBICS[i, 0] + after * CUBICS[i + 1, 0] + leaving * CUBICS[i, 2] + arriving * CUBICS[i + 1, 2]
    full = before * CUBICS[i, 1] + after * CUBICS[i + 1, 1] + leaving * CUBICS[i, 3] + arriving * CUBICS[i + 1, 3]
    return peaked, full


@compiled
def bent_early(z: float) -> float:
    """Magic formula of C = 1 and E = 0 at demand over grip z."""
    return z / math.hypot(1.0, z)
