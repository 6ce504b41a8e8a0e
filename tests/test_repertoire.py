"""What a little of an effect does over a while is the sum of what it does over the parts of it."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.mismatch.candidates import STEPS, directions, slopes
from vehicle_sbi.mismatch.repertoire import Repertoire
from vehicle_sbi.physics.effects import CATALOGUE


@pytest.mark.parametrize("name", ["gust", "friction_step"])
def test_spans_are_the_sum_of_their_tiles(name: str) -> None:
    fit = fitted(recorded(lateral()))
    known = directions(fit.simulator, TRUTH, CATALOGUE[name])
    repertoire = Repertoire.around(replace(fit, theta=TRUTH), known)
    whole = slopes(fit.simulator, TRUTH, repertoire.of.directions)
    # Both are differences over a step of which the next order is left out: a relative error of the step's size, over
    # as many tiles as a span has at most. Spans by larger steps are not put together.
    off = np.sqrt(np.mean((repertoire.named - whole) ** 2, axis=(1, 2)))
    assert np.all(off < STEPS[0] * np.sqrt(np.mean(whole**2, axis=(1, 2))).max())
    assert np.any(whole != 0.0)


def test_grip_that_is_not_used_up_is_a_direction_by_a_step_that_uses_it_up() -> None:
    sim = lateral()
    (known,) = directions(sim, TRUTH, CATALOGUE["friction_level"])
    small = directions(sim, TRUTH, CATALOGUE["body_roll"])
    assert known.step > STEPS[0] == small[0].step
    assert known.parameter.low < known.away < known.parameter.high
    assert np.abs(slopes(sim, TRUTH, [known])).max() > 0.0
