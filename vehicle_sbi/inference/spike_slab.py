"""Spike and slab: what a car may have beside its model, drawn anew in every simulation.

A parameter x of an effect has left its null x_0 with probability `rate`, by a normal of standard deviation `size`:

    x = x_0 with probability 1 - rate,   else   x - x_0 ~ N(0, size^2) inside the box of x

so E (x - x_0)^2 = rate size^2, the variance by which a linear model shrinks it (Mitchell & Beauchamp, Bayesian
variable selection in linear regression, J. Am. Stat. Assoc. 83, 1988). Where the null is an edge of the box the normal
has one side only. What gives an effect its shape (a lag, a lever) says nothing at the null; it is uniform in its box.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from vehicle_sbi.parameters import Parameter

STEP = 0.25  # of a size, over which derivatives are taken; fits that take them over all of it end early


@dataclass(frozen=True, kw_only=True)
class Slab:
    """A parameter that may leave its null; `shape` has the parameters that give its effect its shape where it has, at
    the values that derivatives take them to have."""

    parameter: Parameter
    rate: float
    size: float  # [the parameter's unit]
    shape: Mapping[Parameter, float] = field(default_factory=dict)

    @property
    def null(self) -> float:
        return self.parameter.null or 0.0

    @property
    def spread(self) -> float:
        """Root mean square distance from the null, spikes included."""
        return float(np.sqrt(self.rate)) * self.size


@dataclass(frozen=True)
class SpikeAndSlab:
    """Independent slabs. A row of values has a column for each of `parameters`: those of slabs, then those of shape."""

    slabs: tuple[Slab, ...] = ()

    def __len__(self) -> int:
        return len(self.slabs)

    @cached_property
    def shape(self) -> dict[Parameter, float]:
        """Parameters of shape and the values that derivatives take them to have."""
        return {p: value for slab in self.slabs for p, value in slab.shape.items()}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return *(slab.parameter for slab in self.slabs), *self.shape

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects they belong to."""
        return tuple(dict.fromkeys(slab.parameter.name.partition(".")[0] for slab in self.slabs))

    @property
    def low(self) -> Float[np.ndarray, " k"]:
        """Lower edge of each slab's box, as distance from its null in units of its spread."""
        return np.array([(slab.parameter.low - slab.null) / slab.spread for slab in self.slabs])

    @property
    def high(self) -> Float[np.ndarray, " k"]:
        """Its upper edge."""
        return np.array([(slab.parameter.high - slab.null) / slab.spread for slab in self.slabs])

    @property
    def steps(self) -> Float[np.ndarray, " k"]:
        """Over how much of each, in units of its spread, derivatives are taken."""
        return np.array([STEP * slab.size / slab.spread for slab in self.slabs])

    def at(self, eta: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n p"]:
        """Values at distances from the nulls in units of the spreads, drawn back to the boxes."""
        null, spread = (np.array([getattr(slab, key) for slab in self.slabs]) for key in ("null", "spread"))
        values = null + spread * np.clip(eta, self.low, self.high)
        return np.concatenate([values, np.tile([*self.shape.values()], (len(eta), 1))], axis=1)

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, "1 p"]:
        """One draw; none is taken from the generator where there is no slab."""
        drawn = [_drawn(slab, *rng.random(2)) for slab in self.slabs]
        away = {p for slab, x in zip(self.slabs, drawn, strict=True) if x != slab.null for p in slab.shape}
        shape = [rng.uniform(p.low, p.high) if p in away else (p.null or 0.0) for p in self.shape]
        return np.array([[*drawn, *shape]], dtype=float)


def _drawn(slab: Slab, chance: float, quantile: float) -> float:
    """The null, or a quantile of the normal inside the box."""
    p = slab.parameter
    if chance >= slab.rate:
        return slab.null
    low, high = ndtr((p.low - slab.null) / slab.size), ndtr((p.high - slab.null) / slab.size)
    return float(np.clip(slab.null + slab.size * ndtri(low + quantile * (high - low)), p.low, p.high))
