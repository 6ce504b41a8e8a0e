"""All that a model could have left out, and what a little of each does to the series: effects, blocks and laws.

The changes are simulated at the base model's fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.directions import STEPS, Direction, extent, shapes, slopes, tiles
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.block import Block, blocks
from vehicle_sbi.mismatch.hypotheses.regressor import Law, law_slopes, laws
from vehicle_sbi.parameters import Parameter

NONLINEAR = 0.3  # of the smaller change, by which those of two steps differ for both to be tried


@dataclass(frozen=True)
class Inventory:
    """Directions of effects in each of their shapes, then blocks, then laws."""

    directions: list[Direction]
    blocks: list[Block]
    laws: list[Law]

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """How far the prior lets each size reach below and above nothing."""
        far = [np.inf] * len(self.blocks)
        low = [d.low for d in self.directions] + [-x for x in far] + [law.target.size.low for law in self.laws]
        high = [d.high for d in self.directions] + far + [law.target.size.high for law in self.laws]
        return np.array(low), np.array(high)

    @property
    def of_blocks(self) -> slice:
        """Where blocks are among all."""
        return slice(len(self.directions), len(self.directions) + len(self.blocks))


@dataclass(frozen=True)
class Repertoire:
    """An inventory, and the change of the series per unit of each of its directions, blocks and laws about a fit."""

    about: Fit
    of: Inventory
    named: Float[np.ndarray, "directions channels time"]
    bumps: Float[np.ndarray, "blocks channels time"]
    ruled: Float[np.ndarray, "laws channels time"]

    @classmethod
    def around(cls, fit: Fit, known: Sequence[Direction]) -> "Repertoire":
        """At a fit, of the directions that are known to act, along none of the parameters that it has already."""
        simulator, theta, y = fit.simulator, fit.theta, fit.at.y
        new = [d for d in known if not _fitted(fit, d)]
        stepped = _stepped(fit, new)
        places, bumps = blocks(simulator, theta, y)
        given = laws(simulator, theta, y)
        ruled = law_slopes(simulator, theta, y, given)
        named = np.array([change for _, change in stepped]).reshape(-1, *y.shape)
        return cls(fit, Inventory([d for d, _ in stepped], places, given), named, bumps, ruled)

    @property
    def changes(self) -> Float[np.ndarray, "k channels time"]:
        """Of directions, then blocks, then laws."""
        return np.concatenate([self.named, self.bumps, self.ruled])

    def ruled_by(self, kept: Bool[np.ndarray, " n"]) -> "Repertoire":
        """With some of the laws alone."""
        return replace(self, of=replace(self.of, laws=list(compress(self.of.laws, kept))), ruled=self.ruled[kept])


def _fitted(fit: Fit, direction: Direction) -> bool:
    """Whether a fit has any of a direction's parameters."""
    return bool({direction.parameter.name, *(p.name for p in direction.held)} & set(fit.simulator.space.names))


def _stepped(fit: Fit, known: Sequence[Direction]) -> list[tuple[Direction, Float[np.ndarray, "channels time"]]]:
    """Every shape of directions with its change, and again by larger steps where those do not change as much in
    proportion; of which parameters that may be, what they do throughout the recordings says."""
    latest = _changed(fit, [shape for d in known for shape in shapes(fit.simulator, d)])
    kept, bent = [*latest], _bent(fit, known)
    for step in STEPS:
        rows = [k for k, (d, _) in enumerate(latest) if d.step < step and d.parameter in bent]
        larger = _changed(fit, [replace(latest[k][0], step=step) for k in rows])
        for k, pair in zip(rows, larger, strict=True):
            if _differ(fit, pair[1], latest[k][1]):
                latest[k] = pair
                kept.append(pair)
    return kept


def _bent(fit: Fit, known: Sequence[Direction]) -> set[Parameter]:
    """Parameters whose largest step does not change as much in proportion as their smallest."""
    throughout = [d.during(0.0, extent(fit.simulator)) if d.clocked else d for d in known]
    small = _changed(fit, throughout)
    large = _changed(fit, [replace(d, step=STEPS[-1]) for d in throughout])
    return {d.parameter for (d, a), (_, b) in zip(small, large, strict=True) if _differ(fit, a, b)}


def _differ(
    fit: Fit, change: Float[np.ndarray, "*k channels time"], other: Float[np.ndarray, "*k channels time"]
) -> bool:
    """Whether two changes differ by more than a part of the smaller one, in units of the noise."""
    a, b, off = (float(np.linalg.norm(fit.metric(one))) for one in (change, other, change - other))
    return off > NONLINEAR * min(a, b)


def _changed(fit: Fit, found: Sequence[Direction]) -> list[tuple[Direction, Float[np.ndarray, "channels time"]]]:
    """Directions with their changes."""
    return [*zip(found, _changes(fit, found), strict=True)] if found else []


def _changes(fit: Fit, found: Sequence[Direction]) -> Float[np.ndarray, "k channels time"]:
    """Change of the series per unit of each direction; by small steps, spans of time are put together from their tiles.

    What larger ones do in one tile changes what they do in the next.
    """
    made_of = [tiles(fit.simulator, d) if d.step == STEPS[0] else [d] for d in found]
    single = {one.key: one for parts in made_of for one in parts}
    change = dict(zip(single, slopes(fit.simulator, fit.theta, [*single.values()]), strict=True))
    return np.array([sum(change[one.key] for one in parts) for parts in made_of])
