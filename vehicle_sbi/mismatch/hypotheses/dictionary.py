"""Every kind of hypothesis there is. A new kind is a file beside this one, and an entry in one of these lists."""

from collections.abc import Sequence

from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses import block, discrepancy, effect, quantisation, regressor
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief, Hypothesis, Together


def tested(about: Linearised, known: Sequence[Direction]) -> list[Hypothesis]:
    """What is tested alone about a fit: directions that are known to act, blocks, and laws that are no effect."""
    effects = effect.tested(about.fit, known)
    return [*effects, *block.tested(about.fit), *regressor.tested(about, effects)]


def together(about: Linearised, alone: Sequence[Hypothesis]) -> list[Together]:
    """What is tested at once: stretches of each channel, and whether any channel reads in steps."""
    return [*block.together(about, alone), *quantisation.together(about)]


def believed(expansion: Expansion, widths: Sequence[int], prior: EffectPrior) -> list[Belief]:
    """What is sampled: sizes of effects, then discrepancies of so many columns each."""
    return [*effect.believed(expansion, prior), *(discrepancy.believed(columns, prior) for columns in widths)]
