"""Laws outside the catalogue: what they do, and that they stand beside it rather than in its place."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.hypotheses.regressor import Law, law_slopes, laws, moved, under
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.physics.single_track import INPUTS


def explained(observation: Observation) -> Explanation:
    base = fitted(observation)
    return explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))


def law(name: str) -> Law:
    sim = lateral()
    return next(one for one in laws(sim, TRUTH, sim.noise_free(TRUTH[None])[0]) if one.name == name)


def under_law(name: str, size: float) -> Observation:
    """What a car with the law at `size` times its largest would have recorded."""
    sim, hidden = lateral(), law(name)
    theta = np.array([[*TRUTH, 0.0], [*TRUTH, size * hidden.target.size.high]])
    change = np.subtract(*under(sim, hidden).noise_free(theta)[::-1])
    observation = recorded(sim, seed=3)
    return replace(observation, observed=observation.observed + change)


def test_laws_follow_signals_that_change_with_a_root_mean_square_of_one() -> None:
    sim = lateral()
    found = {one.signal: one.course for one in laws(sim, TRUTH, sim.noise_free(TRUTH[None])[0])}
    assert {"steering", "a_y cubed", "yaw rate times time", "direction of steering"} <= found.keys()
    assert "speed" not in found  # it is constant here
    for course in found.values():
        assert np.mean(course**2) == pytest.approx(1.0)


@pytest.mark.parametrize("signal", ["steering", "a_y cubed", "steering times time", "|yaw rate|"])
def test_a_law_keeps_its_units_in_another_recording(signal: str) -> None:
    """In a drive that steers half as much a law that it found keeps its size: the very same course, as far as theory
    is linear or the signal an input."""
    sim, one = lateral(), law(f"moment about z with {signal}")
    assert np.array_equal(moved(one, sim, TRUTH).course, one.course)
    u = sim.windows.u.copy()
    u[..., INPUTS.index("steering")] *= 0.5
    gentler = replace(sim, windows=replace(sim.windows, u=u))
    there = moved(one, gentler, TRUTH).course
    factor = 0.5 ** (3 if "cubed" in signal else 1)
    assert np.sqrt(np.mean(there**2)) == pytest.approx(factor, rel=0.05 if "steering" not in signal else 1e-9)


@pytest.mark.parametrize("name", ["moment about z with steering", "error of the steering angle with |steering|",
                                  "error of the sensor of a_y with a_y cubed"])  # fmt: skip
def test_slopes_are_what_a_small_size_does(name: str) -> None:
    # Central differences, whose error is of second order, against the one-sided step of 5 % of the largest size: they
    # differ by the curvature, 5 % of the change where doubling the size would bend it by its own length.
    sim, one = lateral(), law(name)
    y = sim.noise_free(TRUTH[None])[0]
    size = 0.05 * one.target.size.high
    moved = under(sim, one).noise_free(np.array([[*TRUTH, size], [*TRUTH, -size]]))
    central = (moved[0] - moved[1]) / (2.0 * size)
    assert np.abs(law_slopes(sim, TRUTH, y, [one])[0] - central).max() < 0.05 * np.abs(central).max()


@pytest.mark.parametrize("name", ["moment about z with a_y times time", "error of the sensor of a_y with |yaw rate|"])
def test_a_law_outside_the_catalogue_is_unknown(name: str) -> None:
    found = explained(under_law(name, 0.5))
    assert found.detected
    assert found.p_unknown > max(found.probability, default=0.0)
    best = found.unnamed[0].outside
    assert isinstance(best, Law)
    assert best.target.name == law(name).target.name


def test_an_effect_of_the_catalogue_keeps_its_name_beside_all_laws() -> None:
    found = explained(recorded(lateral(), seed=3, imu_lever_arm__x=1.0))
    assert found.models[0].effects == ("imu_lever_arm",)
    assert found.probability[0] > found.p_unknown
