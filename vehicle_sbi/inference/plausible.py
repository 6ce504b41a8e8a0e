"""Which effects of the catalogue may act on a recording unasked: all that can, but what is tied to its clock."""

from collections.abc import Collection

import numpy as np

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.directions import directions
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.inference.spike_slab import Slab, SpikeAndSlab
from vehicle_sbi.physics.effects import CATALOGUE

PLAUSIBLE = "plausible"  # what stands in the place of a list of effects


def plausible(simulator: Simulator, prior: EffectPrior, stated: Collection[str] = ()) -> SpikeAndSlab:
    """A slab for each parameter along which an effect can leave its null at the prior's centre.

    `stated` names parameters that are spoken for beside those that are inferred. One that acts only together with
    others gives its effect its shape, unless the prior lists it: then it has a slab of its own. Raises InputError where
    the simulation at the prior's centre fails.
    """
    theta = (simulator.space.low + simulator.space.high) / 2
    if not np.isfinite(simulator.noise_free(theta[None])).all():
        raise InputError(f"effects={PLAUSIBLE}: the simulation at the prior's centre fails; narrow the prior")
    lasting = (effect for effect in CATALOGUE.values() if not effect.timed)
    found = [d for effect in lasting for d in directions(simulator, theta, effect)]
    held = {p: {} for d in found for p in d.held if prior.lists(p)} | {d.parameter: d.held for d in found}
    free = {p: shape for p, shape in held.items() if p.name not in stated}
    return SpikeAndSlab(
        tuple(
            Slab(
                parameter=p,
                rate=prior.rate_of(p),
                size=prior.size_of(p),
                shape={other: x for other, x in shape.items() if other not in held and other.name not in stated},
            )
            for p, shape in free.items()
        )
    )


def sentence(free: SpikeAndSlab) -> str:
    """How many plausible effects were free, and which."""
    return (
        f"{len(free.effects)} plausible effects were free, {len(free)} parameters drawn anew in every simulation: "
        f"{', '.join(free.effects)}."
    )
