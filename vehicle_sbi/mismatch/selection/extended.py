"""The model to go on with: the base model with the likeliest set of effects, fitted again."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.estimation.expansion import WIDER, Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.selection.pruned import Pruned

ALIKE = 0.05  # least probability of an effect that may stand for another
INSTEAD = -0.3  # correlation of two effects' being there, from which they stand for each other
NEEDED = 0.5  # probability that one of several effects is missing


@dataclass(frozen=True)
class Extended:
    """The likeliest model, and the one that has another effect in the place of one of its own, if there is one that
    these recordings cannot tell from it."""

    model: Model
    other: Model | None


def extended(base: Fit, pruned: Pruned | None, alike: Sequence[Sequence[str]], *, detected: bool) -> Extended:
    """The base model itself where nothing is detected, or no effect is likelier than any; `alike` as below."""
    none = Model.without_effects(base)
    if pruned is None or not detected:
        return Extended(none, None)
    effects = next(iter(pruned.sets))
    model = with_effects(base, pruned, effects) if effects else none
    if model is None:
        return Extended(none, None)
    exchanged = _exchanged(pruned, effects, alike)
    return Extended(model, with_effects(base, pruned, exchanged) if exchanged else None)


def with_effects(base: Fit, pruned: Pruned, effects: Collection[str]) -> Model | None:
    """The base model with some effects, by the sizes that each mostly has; None if it cannot be simulated."""
    expansion = pruned.expansion.only(pruned.mostly(effects))
    simulator = replace(base.simulator, substeps=pruned.fit.simulator.substeps)
    observation = base.observation.extended(simulator).freeing(expansion.space.parameters)
    *near, null = _starts(base, pruned, expansion)
    fit = expansion.likeliest(observation, np.full(len(expansion.sizes), WIDER), near=near, far=[null])
    return None if fit is None else Model(tuple(sorted(effects)), fit, base.simulator.space.names)


def _starts(base: Fit, pruned: Pruned, expansion: Expansion) -> Float[np.ndarray, "3 d"]:
    """The means of what was drawn, where the last expanded fit lies, and the base model with sizes at their nulls."""
    names, space = expansion.space.names, pruned.fit.simulator.space
    drawn = np.array([pruned.draws(name).mean() for name in names])
    fitted = pruned.fit.theta[[space.column(name) for name in names]]
    return np.stack([drawn, fitted, np.concatenate([base.theta, expansion.rest[len(base.theta) :]])])


def _exchanged(pruned: Pruned, effects: tuple[str, ...], alike: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """The set with the likeliest effect that stands for one of its own in that one's place; empty if there is none."""
    for group in alternatives(pruned, alike):
        own = [name for name in group if name in effects]
        others = sorted((name for name in group if name not in effects), key=lambda name: -pruned.effects[name])
        if own and others:
            return tuple(sorted({*effects, others[0]} - {own[0]}))
    return ()


def alternatives(pruned: Pruned, alike: Sequence[Sequence[str]]) -> list[list[str]]:
    """Groups of effects that stand for each other, one of which is likely to be missing: where one is, another is not,
    or they are `alike`, groups of effects that do the same to these recordings.

    The likeliest group first, and the likeliest effect in it; an effect is in one group.
    """
    open_ones = [name for name, p in pruned.effects.items() if ALIKE <= p <= 1.0 - ALIKE]
    groups, taken = list[list[str]](), set[str]()
    for candidates in (*_exclusive(pruned, open_ones), *alike):
        group = [name for name in open_ones if name in candidates and name not in taken]
        if len(group) > 1 and pruned.any_of(group) > NEEDED:
            groups.append(group)
            taken |= {*group}
    return sorted(groups, key=lambda group: -pruned.any_of(group))


def _exclusive(pruned: Pruned, names: Sequence[str]) -> list[list[str]]:
    """Each effect with those that are there where it is not."""
    if len(names) < 2:
        return []
    apart = np.corrcoef([pruned.missing[name] for name in names]) < INSTEAD
    return [
        [name, *(other for other, a in zip(names, row, strict=True) if a)]
        for name, row in zip(names, apart, strict=True)
    ]
