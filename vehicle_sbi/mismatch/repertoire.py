"""All that a model could have left out, and what a little of each does to the series: effects, blocks and laws.

The changes are simulated at a model's fit; what is then put into the model is simulated in full.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.mismatch.candidates import STEPS, Direction, shapes, slopes, tiles
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import Law, law_slopes, laws
from vehicle_sbi.mismatch.locate import Block, blocks

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

    @property
    def of_laws(self) -> slice:
        """Where laws are among all."""
        return slice(len(self.directions) + len(self.blocks), None)


@dataclass(frozen=True)
class Repertoire:
    """An inventory, and the change of the series per unit of each of its directions, blocks and laws."""

    of: Inventory
    named: Float[np.ndarray, "directions channels time"]
    bumps: Float[np.ndarray, "blocks channels time"]
    ruled: Float[np.ndarray, "laws channels time"]

    @classmethod
    def around(cls, fit: Fit, known: Sequence[Direction]) -> "Repertoire":
        """At a fit, of the directions that are known to act, along none of the parameters that it has already."""
        simulator, theta, y = fit.simulator, fit.theta, fit.at.y
        places, bumps = blocks(simulator, y)
        given = laws(simulator, theta, y)
        ruled = law_slopes(simulator, theta, y, given)
        alone = cls.of_effects(fit, known)
        return replace(alone, of=replace(alone.of, blocks=places, laws=given), bumps=bumps, ruled=ruled)

    @classmethod
    def of_effects(cls, fit: Fit, known: Sequence[Direction]) -> "Repertoire":
        """The same without blocks and laws."""
        fitted = set(fit.simulator.space.names)
        new = [d for d in known if not fitted & {d.parameter.name, *(p.name for p in d.held)}]
        stepped = [pair for direction in new for pair in _stepped(fit, shapes(fit.simulator, direction))]
        named = np.array([change for _, change in stepped]).reshape(-1, *fit.at.y.shape)
        return cls(Inventory([one for one, _ in stepped], [], []), named, named[:0], named[:0])

    @property
    def changes(self) -> Float[np.ndarray, "k channels time"]:
        """Of directions, then blocks, then laws."""
        return np.concatenate([self.named, self.bumps, self.ruled])

    def ruled_by(self, kept: Bool[np.ndarray, " n"]) -> "Repertoire":
        """With some of the laws alone."""
        return replace(self, of=replace(self.of, laws=list(compress(self.of.laws, kept))), ruled=self.ruled[kept])


def _stepped(fit: Fit, found: Sequence[Direction]) -> list[tuple[Direction, Float[np.ndarray, "channels time"]]]:
    """Directions with their changes, and again by larger steps where those do not change as much in proportion."""
    kept = [*zip(found, _changes(fit, found), strict=True)]
    last = kept
    for step in STEPS:
        larger = [replace(d, step=step) for d, _ in last if d.step < step]
        if larger:
            before = [change for d, change in last if d.step < step]
            pairs = zip(larger, _changes(fit, larger), strict=True)
            last = [pair for pair, old in zip(pairs, before, strict=True) if _differ(fit, pair[1], old)]
            kept += last
    return kept


def _differ(fit: Fit, change: Float[np.ndarray, "channels time"], other: Float[np.ndarray, "channels time"]) -> bool:
    """Whether two changes differ by more than a part of the smaller one, in units of the noise."""
    a, b, off = (float(np.linalg.norm(fit.metric(one))) for one in (change, other, change - other))
    return off > NONLINEAR * min(a, b)


def _changes(fit: Fit, found: Sequence[Direction]) -> Float[np.ndarray, "k channels time"]:
    """Change of the series per unit of each direction; by small steps, spans of time are put together from their tiles.

    What larger ones do in one tile changes what they do in the next.
    """
    made_of = [tiles(fit.simulator, d) if d.step == STEPS[0] else [d] for d in found]
    single = {one.key: one for parts in made_of for one in parts}
    change = dict(zip(single, slopes(fit.simulator, fit.theta, [*single.values()]), strict=True))
    return np.array([sum(change[one.key] for one in parts) for parts in made_of])
