"""An extended model is accepted only on held-out data that could have told, and that did."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import lateral, recorded

from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.acceptance import ALIKE, judged, spreads
from vehicle_sbi.mismatch.selection.predictive import Gain, Prediction

SERIES, SCORE = np.zeros((1, 4)), np.zeros(2)
CERTAIN = Gain(0.5, 0.1, 0.3, 0.7)


def predicted(**nrmse: float) -> Prediction:
    return Prediction(nrmse, 0.9, SCORE, {}, SERIES, SERIES, {}, 12.0)


def calmer(observation: Observation, factor: float) -> Observation:
    return replace(observation, observed=factor * observation.observed)


BOTH = {"base": predicted(a_y=0.5), "extended": predicted(a_y=0.3)}
DRIVEN = recorded(lateral())


def test_what_gains_for_certain_on_a_drive_that_is_alike_is_accepted() -> None:
    found = judged(DRIVEN, DRIVEN, BOTH, CERTAIN)
    assert found.accepted
    assert "0.5 ± 0.1 of log score a sample on 12 s that were held out" in found.because
    assert "lower 90% bound 0.3" in found.because


@pytest.mark.parametrize(("factor", "accepted"), [(1.1 * ALIKE, True), (0.9 * ALIKE, False), (1 / 30, False)])
def test_a_held_out_part_in_which_less_happens_proves_nothing(factor: float, accepted: bool) -> None:
    found = judged(DRIVEN, calmer(DRIVEN, factor), BOTH, CERTAIN)
    assert found.accepted is accepted
    if not accepted:
        spread = spreads(DRIVEN)["a_y"]
        assert f"a_y varies by {factor * spread:.2g} m/s² there, by {spread:.2g} in the fitted part" in found.because


@pytest.mark.parametrize(
    ("extended", "gained", "why"),
    [
        (predicted(a_y=0.3), Gain(0.1, 0.2, -0.15, 0.35), "is not certain (lower 90% bound -0.15)"),
        (predicted(a_y=0.3), replace(CERTAIN, worse=("yaw_rate",)), "predicts yaw_rate worse"),
        (predicted(a_y=0.3, yaw_rate=1.27), CERTAIN, "yaw_rate no better than its mean (normalised error 1.3)"),
    ],
)
def test_each_thing_that_speaks_against_it_is_said(extended: Prediction, gained: Gain, why: str) -> None:
    found = judged(DRIVEN, DRIVEN, {"base": predicted(a_y=0.5), "extended": extended}, gained)
    assert not found.accepted
    assert why in found.because


def test_what_cannot_be_simulated_there_is_not_accepted() -> None:
    found = judged(DRIVEN, DRIVEN, {"base": predicted(a_y=0.5)}, None)
    assert not found.accepted
    assert found.because == "the extended model cannot be simulated there"
