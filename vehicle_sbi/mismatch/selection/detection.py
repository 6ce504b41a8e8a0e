"""Is anything missing, and where: everything that the base model leaves out, scored at first order about its fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses.block import Stretch, lies_in, touching
from vehicle_sbi.mismatch.hypotheses.dictionary import tested, together
from vehicle_sbi.mismatch.hypotheses.hypothesis import Block, Hypothesis
from vehicle_sbi.mismatch.selection.score_test import Scores, score

LEVEL = 0.05  # of the test whether anything is missing


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
    """The base model's fit, how often noise alone would leave as much over, and where it leaves more than noise would,
    the largest first."""

    fit: Fit
    p_value: float
    places: list[Place]

    @property
    def detected(self) -> bool:
        return self.p_value < LEVEL


def examine(fit: Fit, known: Sequence[Direction], rng: np.random.Generator) -> Examined:
    """Everything that may be missing about a fit, scored; of effects, the directions that are known to act."""
    about = Linearised.of(fit)
    alone = tested(about, known)
    scores = score(about, alone, together(about, alone), rng=rng)
    p_value = scores.p_value()
    return Examined(fit, p_value, _places(fit, alone, scores) if p_value < LEVEL else [])


def _places(fit: Fit, alone: Sequence[Hypothesis], scores: Scores) -> list[Place]:
    """Blocks that score higher than noise does anywhere, those that touch as one."""
    both = zip(alone, scores.z, scores.p_values, strict=True)
    found = [(one.block, float(z**2), float(p)) for one, z, p in both if one.block and p < LEVEL]
    whole = list[tuple[Block, float, float]]()
    for rows in touching([block for block, _, _ in found]):
        blocks, energy, p = zip(*(found[k] for k in rows), strict=True)
        whole.append((replace(blocks[0], to_s=blocks[-1].to_s), sum(energy), min(p)))
    whole = sorted(whole, key=lambda one: -one[1])
    total = sum(energy for _, energy, _ in whole)
    return [
        Place(b.channel, b.from_s, b.to_s, p, energy / total, b.regime, lies_in(fit.simulator, b))
        for b, energy, p in whole
    ]
