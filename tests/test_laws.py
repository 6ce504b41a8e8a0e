"""Laws outside the catalogue: what they do, and that they stand beside it rather than in its place."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, lateral
from studies import repeated

from vehicle_sbi.mismatch.hypotheses.regressor import STEP, Law, law_slopes, laws, under


def law(name: str) -> Law:
    sim = lateral()
    return next(one for one in laws(sim, TRUTH, sim.noise_free(TRUTH[None])[0]) if one.name == name)


def test_laws_follow_signals_that_change_with_a_root_mean_square_of_one() -> None:
    sim = lateral()
    found = {one.signal: one.course for one in laws(sim, TRUTH, sim.noise_free(TRUTH[None])[0])}
    assert {"steering", "a_y cubed", "yaw rate times time", "direction of steering"} <= found.keys()
    assert "speed" not in found  # it is constant here
    for course in found.values():
        assert np.mean(course**2) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["moment about z with steering", "error of the steering angle with |steering|",
                                  "error of the sensor of a_y with a_y cubed"])  # fmt: skip
def test_slopes_are_what_a_small_size_does(name: str) -> None:
    # Central differences, whose error is of second order, against the one-sided step of 5 % of the largest size: they
    # differ by the curvature, 5 % of the change where doubling the size would bend it by its own length.
    sim, one = lateral(), law(name)
    y = sim.noise_free(TRUTH[None])[0]
    size = 0.05 * one.target.size.high
    moved = under(sim, [one]).noise_free(np.array([[*TRUTH, size], [*TRUTH, -size]]))
    central = (moved[0] - moved[1]) / (2.0 * size)
    assert np.abs(law_slopes(sim, TRUTH, y, [one])[0] - central).max() < 0.05 * np.abs(central).max()


@pytest.mark.parametrize("acting", [[], [1], [0, 2]])
def test_where_a_law_does_not_act_nothing_changes(acting: list[int]) -> None:
    # Simulated in some windows alone, it does there what it does in all of them, digit by digit.
    once = lateral()
    sim = replace(once, windows=repeated(once.windows, 3))
    y = sim.noise_free(TRUTH[None])[0]
    target = law("moment about z with steering").target
    course = np.zeros_like(sim.windows.t)
    course[acting] = np.sin(sim.windows.t[0])
    size = STEP * target.size.high
    everywhere = under(sim, [Law(target, "alone", course)]).noise_free(np.array([[*TRUTH, size]]))[0]
    np.testing.assert_array_equal(law_slopes(sim, TRUTH, y, [Law(target, "alone", course)])[0], (everywhere - y) / size)
