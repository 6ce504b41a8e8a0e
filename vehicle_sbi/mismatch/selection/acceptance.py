"""Is the extended model to be preferred: what held-out data must show before the answer is yes.

The held-out part has to be driven like the fitted one, or it cannot tell: an effect that stands out of the fitted part
with a signal-to-noise ratio of 8 is still seen (with a power of 80 %, from 2.8 on) in a part in which every channel
varies 0.35 times as much. The gain of log score has to be certain, no channel may be predicted worse, and each must be
predicted better than by its mean.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.information import PLAIN, SEEN
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import CONFIDENT, Gain, Prediction

ALIKE = SEEN / PLAIN  # of the fitted part's spread, that each channel of the held-out part needs
BY_MEAN = 1.0  # normalised error of a prediction by the mean


@dataclass(frozen=True)
class Acceptance:
    """Whether the extended model is accepted, and why or why not, as the end of a sentence."""

    accepted: bool
    because: str


def judged(
    fitted: Observation, held_out: Observation, predictions: Mapping[str, Prediction], gained: Gain | None
) -> Acceptance:
    """The extended model on held-out data; `predictions` are those of the base and the extended model there."""
    against = [*_unlike(spreads(fitted), spreads(held_out)), *_unproved(predictions, gained)]
    if against or gained is None:
        return Acceptance(False, "; ".join(against))
    return Acceptance(
        True,
        f"it gains {gained.mean:.2g} ± {gained.std:.1g} of log score a sample on {_scored(predictions)} (lower "
        f"{CONFIDENT:.0%} bound {gained.low:.2g}), and predicts every channel better than its mean and none worse",
    )


def _scored(predictions: Mapping[str, Prediction]) -> str:
    """On how much both models were scored."""
    return f"{predictions['extended'].seconds:.3g} s that were held out"


def _unlike(fitted: Mapping[str, float], held: Mapping[str, float]) -> Iterator[str]:
    """In which channels the held-out part is driven less than it takes to tell."""
    for name in (name for name in fitted if name in held):
        if held[name] < ALIKE * fitted[name]:
            yield (
                f"the held-out part is not driven like the fitted one: {name} varies by {held[name]:.2g} "
                f"{CHANNELS[name].unit} there, by {fitted[name]:.2g} in the fitted part; hold out a drive as lively"
            )


def spreads(observation: Observation) -> dict[str, float]:
    """Standard deviation of each channel, as far as it was measured."""
    windows = observation.simulator.windows
    rows = zip(windows.channels, observation.observed, windows.valid, strict=True)
    return {name: float(np.std(values[valid])) for name, values, valid in rows if valid.any()}


def _unproved(predictions: Mapping[str, Prediction], gained: Gain | None) -> Iterator[str]:
    """What of the predictions speaks against it."""
    if gained is None:
        missing = [name for name in ("base", "extended") if name not in predictions]
        yield f"the {' and the '.join(missing)} model cannot be simulated there"
        return
    if not gained.certain:
        yield (
            f"its gain of log score, {gained.mean:.2g} ± {gained.std:.1g} a sample on {_scored(predictions)}, is not "
            f"certain (lower {CONFIDENT:.0%} bound {gained.low:.2g})"
        )
    if gained.worse:
        yield f"it predicts {' and '.join(gained.worse)} worse than the base model"
    for name, error in predictions["extended"].nrmse.items():
        if error >= BY_MEAN:
            yield f"it predicts {name} no better than its mean (normalised error {error:.2g})"
