"""All that a model could have left out, and what a little of each does to the series: effects, blocks and laws.

The changes are simulated once, at the base model's fit. Extended models are near enough to it for what they leave over
to be scored by the same changes; what is then put into a model is simulated in full.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.mismatch.candidates import Direction, shapes, slopes, tiles
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import Law, law_slopes, laws
from vehicle_sbi.mismatch.locate import Block, blocks


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
        """At a fit, of the directions that are known to act there."""
        simulator, theta, y = fit.simulator, fit.theta, fit.at.y
        found = [shape for direction in known for shape in shapes(simulator, direction)]
        places, bumps = blocks(simulator, y)
        given = laws(simulator, theta, y)
        ruled = law_slopes(simulator, theta, y, given)
        return cls(Inventory(found, places, given), _summed(fit, found), bumps, ruled)

    @property
    def changes(self) -> Float[np.ndarray, "k channels time"]:
        """Of directions, then blocks, then laws."""
        return np.concatenate([self.named, self.bumps, self.ruled])

    def beyond(self, fit: Fit) -> "Repertoire":
        """What a fit has not got: directions along none of its parameters."""
        fitted = set(fit.simulator.space.names)
        used = [{d.parameter.name, *(p.name for p in d.held)} for d in self.of.directions]
        return self._directed([not fitted & names for names in used])

    def only(self, effects: set[str]) -> "Repertoire":
        """Directions of some effects."""
        return self._directed([d.effect in effects for d in self.of.directions])

    def _directed(self, kept: Sequence[bool]) -> "Repertoire":
        left = replace(self.of, directions=list(compress(self.of.directions, kept)))
        return replace(self, of=left, named=self.named[np.array(kept, dtype=bool)])

    def ruled_by(self, kept: Bool[np.ndarray, " n"]) -> "Repertoire":
        """With some of the laws alone."""
        return replace(self, of=replace(self.of, laws=list(compress(self.of.laws, kept))), ruled=self.ruled[kept])

    def alone(self) -> "Repertoire":
        """Directions without blocks and laws."""
        return replace(self, of=replace(self.of, blocks=[], laws=[]), bumps=self.bumps[:0], ruled=self.ruled[:0])


def _summed(fit: Fit, found: Sequence[Direction]) -> Float[np.ndarray, "k channels time"]:
    """Change of the series per unit of each direction; spans of time are put together from their tiles."""
    made_of = [tiles(fit.simulator, direction) for direction in found]
    single = {one.key: one for parts in made_of for one in parts}
    change = dict(zip(single, slopes(fit.simulator, fit.theta, [*single.values()]), strict=True))
    return np.array([sum(change[one.key] for one in parts) for parts in made_of])
