"""Is an effect as large in each recording: a size that changes from one to the next is no property of the car.

Beside the size that all recordings share, each but the last gets one of its own, at first order; twice the log
likelihood that this gains is chi-square if there is but one.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.foretell import LENIENT
from vehicle_sbi.mismatch.linear import Linearised, gained
from vehicle_sbi.physics.effects import CATALOGUE

DIFFERENT = 0.01  # p-value below which sizes differ


def disagreeing(model: Model) -> list[str]:
    """Effects of a model whose sizes differ between its recordings, but for those that are tied to the clock."""
    about = Linearised.of(model.fit)
    lasting = [name for name in model.effects if not CATALOGUE[name].timed]
    return [name for name in lasting if p_same(about, model, name) < DIFFERENT]


def p_same(about: Linearised, model: Model, effect: str) -> float:
    """How often an effect whose size is the same would seem to differ as much between recordings; 1 of a single one."""
    rows = np.array([*_apart(model, effect)]).reshape(-1, *model.fit.at.y.shape)
    return float(chi2.sf(2.0 * gained(about, rows) / LENIENT, len(rows))) if len(rows) else 1.0


def _apart(model: Model, effect: str) -> Iterator[Float[np.ndarray, "channels time"]]:
    """What each parameter of the effect does in each recording but the last."""
    windows, space = model.fit.simulator.windows, model.fit.simulator.space
    of = np.repeat(np.array(windows.recordings or ("",) * len(windows.t)), windows.t.shape[1])
    for k in np.flatnonzero(model.own):
        if space.names[k].split(".")[0] == effect:
            yield from (np.where(of == name, model.fit.at.J[k], 0.0) for name in sorted(set(of))[:-1])
