"""Every kind of hypothesis there is. A new kind is a file beside this one, and an entry in one of these lists."""

from collections.abc import Sequence

from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses import block, discrepancy, effect, quantisation, regressor
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy, Source
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief, Hypothesis, Together


def tested(about: Linearised, known: Sequence[Direction]) -> list[Hypothesis]:
    """What is tested alone about a fit: directions that are known to act, blocks, and laws that are no effect."""
    effects = effect.tested(about.fit, known)
    return [*effects, *block.tested(about.fit), *regressor.tested(about, effects)]


def together(about: Linearised, alone: Sequence[Hypothesis]) -> list[Together]:
    """What is tested at once: stretches of each channel, and whether any channel reads in steps."""
    return [*block.together(about, alone), *quantisation.together(about)]


def sources(fit: Fit) -> list[Source]:
    """What is sampled beside effects: loads and errors that no effect stands for, and readings in steps."""
    return [*discrepancy.responses(fit), *quantisation.readings(fit)]


def believed(expansion: Expansion, off: Sequence[Discrepancy], prior: EffectPrior) -> list[Belief]:
    """Of what is sampled: sizes of effects, then discrepancies."""
    return [*effect.believed(expansion, prior), *(one.believed(prior) for one in off)]
