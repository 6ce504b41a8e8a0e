"""Which effects a fit supports: one whose size may as well be nothing is not named.

The 90 % interval of each parameter along which an effect leaves its null, under the tempered likelihood, has to leave
out that null for at least one of them. Where the null is the edge of a box, the interval is that of the normal about
the fit, which the box does not cut.
"""

from collections.abc import Collection, Iterator

import numpy as np
from scipy.stats import norm

from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

INTERVAL = (0.05, 0.95)


def unsupported(model: Model, sizes: Collection[str], power: float) -> list[str]:
    """Effects of a model whose `sizes` (names of parameters along which they leave their nulls) include these."""
    held = {name.split(".")[0] for name in _away(model, sizes, power)}
    return [effect for effect in model.effects if effect not in held]


def _away(model: Model, sizes: Collection[str], power: float) -> Iterator[str]:
    """Parameters that are away from their nulls for certain."""
    space = model.fit.simulator.space
    std = np.sqrt(np.diag(model.fit.tempered(power)))
    for k in np.flatnonzero(model.own):
        name = space.names[k]
        if name not in sizes:
            continue
        low, high = model.fit.theta[k] + std[k] * norm.ppf(INTERVAL)
        if model.posterior is not None:
            drawn = np.quantile(model.posterior[:, k], INTERVAL)
            low, high = min(low, float(drawn[0])), max(high, float(drawn[1]))
        null = EFFECT_PARAMETERS[name].null
        if null is not None and not low <= null <= high:
            yield name
