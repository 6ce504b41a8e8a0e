"""What makes a posterior of several rounds doubtful: a recording unlike what was simulated, rounds that disagree."""

from collections.abc import Sequence

import numpy as np
import torch
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from torch import Tensor

from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.parameters import ParameterSpace

QUANTILE_ROWS = 2_000  # simulations that tell a feature's range
TAIL = 0.01  # of them at either end of it that it leaves out
EXTRAPOLATED = 1.5  # surprise from which the recording counts as unlike the simulations
COMPARED = 2_000  # draws of two rounds' posteriors, that say whether they agree
DISAGREEING = 3.0  # standard deviations of the round before, by which a mean that moves contradicts it


def surprise(x: Tensor, x_o: Tensor, tail: float = TAIL) -> float:
    """How far x_o lies outside what was simulated: its largest distance beyond the middle 98 % of a feature.

    In units of that range's half width: below 1 inside it, well above 1 where the network has to extrapolate, because
    the model can hardly produce what was recorded. Effects that few cars have are in the tails: with those free the
    range leaves none out.
    """
    flat, at = x.reshape(len(x), -1), x_o.reshape(-1)
    low, high = torch.quantile(flat[:QUANTILE_ROWS], torch.tensor([tail, 1.0 - tail]), dim=0)
    half = (high - low).clamp_min(1e-12) / 2
    return float(((at - (low + high) / 2).abs() / half).max())


def unlike(surprise: float) -> str:
    """How far the recording lies outside of what a round simulated, in a sentence."""
    return (
        f"the recording lies outside what was simulated ({surprise:.1f} times the half width of a feature's "
        "range): the network extrapolates. Steering, speed or a stated constant may be wrong, or the model lacks "
        "something: `diagnose` says what."
    )


def disagreements(posteriors: Sequence[NeuralPosterior], space: ParameterSpace) -> list[tuple[str, float]]:
    """Parameters whose posterior mean the last round moved too far, and how far in standard deviations of the round
    before: where both are right, a later posterior lies within the earlier one."""
    if len(posteriors) < 2:
        return []
    before, last = (draw(posterior, space, COMPARED) for posterior in posteriors[-2:])
    moved = np.abs(last.mean(axis=0) - before.mean(axis=0)) / before.std(axis=0)
    return [(name, float(far)) for name, far in zip(space.names, moved, strict=True) if far > DISAGREEING]
