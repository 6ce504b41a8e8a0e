"""Is anything missing, and where: everything that the base model leaves out, scored at first order about its fit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses.block import Stretch, lies_in, merged
from vehicle_sbi.mismatch.hypotheses.dictionary import Inventory, Repertoire
from vehicle_sbi.mismatch.selection.score_test import Scores, score

LEVEL = 0.05  # of the test whether anything is missing
ALIKE = 0.98  # coherence with a direction of the catalogue from which a law says nothing new


@dataclass(frozen=True)
class Place:
    """Where simulation and recording differ: times [s] of what is used of the recordings, one after another, and
    `within` each of them."""

    channel: str
    from_s: float
    to_s: float
    p_value: float
    share_of_misfit: float
    regime: str
    within: list[Stretch]


@dataclass(frozen=True)
class Examined:
    """The base model's fit with everything that it leaves out, and the scores of it all; each channel's blocks of time
    are scored together too."""

    fit: Fit
    free: Inventory
    scores: Scores

    @cached_property
    def p_value(self) -> float:
        """How often noise alone would leave as much over."""
        return self.scores.p_value()

    @property
    def detected(self) -> bool:
        return self.p_value < LEVEL

    @property
    def places(self) -> list[Place]:
        """Blocks in which the base model leaves more than noise would, the largest first."""
        if not self.detected:
            return []
        z, p = self.scores.z[self.free.of_blocks], self.scores.p_values[self.free.of_blocks]
        significant = np.flatnonzero(p < LEVEL)
        whole = merged([self.free.blocks[k] for k in significant], z[significant])
        total = sum(energy for _, energy in whole)
        smallest = {
            place: min(float(p[k]) for k in significant if place.holds(self.free.blocks[k])) for place, _ in whole
        }
        return [
            Place(b.channel, b.from_s, b.to_s, smallest[b], energy / total, b.regime, lies_in(self.fit.simulator, b))
            for b, energy in whole
        ]


def examine(repertoire: Repertoire, rng: np.random.Generator) -> Examined:
    """Scores of all in the repertoire about a fit, but for laws that do what an effect does."""
    about = Linearised.of(repertoire.about)
    new = about.coherence(repertoire.ruled, repertoire.named).max(axis=1, initial=0.0) < ALIKE
    free = repertoire.ruled_by(new)
    scores = score(repertoire.about, free.changes, *free.of.bounds, rng=rng, together=_stretches(free.of))
    return Examined(repertoire.about, free.of, scores)


def _stretches(free: Inventory) -> list[list[int]]:
    """Rows of the blocks of time of each channel."""
    rows: dict[str, list[int]] = {}
    for k, block in enumerate(free.blocks, start=free.of_blocks.start):
        if not block.regime:
            rows.setdefault(block.channel, []).append(k)
    return [*rows.values()]
