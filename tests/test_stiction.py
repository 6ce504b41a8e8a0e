"""A steering that sticks: where it stands, by which threshold, and that it is told from play."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.hypotheses.regressor import STEERING, targets
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.stiction import SPACING, likeliest, stuck, thresholds
from vehicle_sbi.physics.single_track import INPUTS

THRESHOLD = 0.004  # [rad], of a sine of 0.05


def commanded(sim: Simulator, steering: np.ndarray) -> Simulator:
    u = sim.windows.u.copy()
    u[..., INPUTS.index("steering")] = steering.reshape(u.shape[:2])
    return replace(sim, windows=replace(sim.windows, u=u))


def sticking(sim: Simulator) -> Observation:
    """What a car records whose wheels stick, and the simulator that is given the command."""
    command = sim.windows.u[..., INPUTS.index("steering")].reshape(-1)
    observation = recorded(commanded(sim, stuck(command, np.array([THRESHOLD]))[0]))
    return observation.extended(commanded(observation.simulator, command))


def test_wheels_stay_within_the_threshold_and_move_only_to_the_command() -> None:
    command = 0.05 * np.sin(np.linspace(0.0, 9.0, 400))
    for held, threshold in zip(stuck(command, np.array([0.0, 0.001, 0.01])), (0.0, 0.001, 0.01), strict=True):
        moves = np.flatnonzero(np.diff(held)) + 1
        assert np.abs(held - command).max() <= threshold
        np.testing.assert_array_equal(held[moves], command[moves])


def test_thresholds_reach_from_a_sample_s_movement_to_a_part_of_the_range() -> None:
    command = lateral().windows.u[..., INPUTS.index("steering")]
    tried = thresholds(lateral())
    assert tried.max() < np.ptp(command)
    assert tried.min() / SPACING**2 < np.median(np.abs(np.diff(command))) < tried.min() * SPACING
    assert not len(thresholds(commanded(lateral(), 0.0 * command)))


def test_the_threshold_comes_back() -> None:
    fit = fitted(sticking(lateral()))
    target = next(one for one in targets(fit.simulator, fit.at.y) if one.name == STEERING)
    found = likeliest(Linearised.of(fit), target)
    command = fit.simulator.windows.u[..., INPUTS.index("steering")]
    assert found is not None
    assert found.threshold == pytest.approx(THRESHOLD, abs=np.abs(np.diff(command)).max())  # wheels jump at samples
    assert found.size == pytest.approx(1.0, abs=4.0 / found.score)  # four standard deviations


def test_what_sticks_is_unknown_and_play_has_a_name() -> None:
    play = recorded(lateral(), steering_dead_band__width=2.0 * THRESHOLD)
    for observation, known in ((sticking(lateral()), False), (play, True)):
        base = fitted(observation)
        found = explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))
        assert found.detected
        assert (found.p_unknown < 0.5) == known
    assert found.models[0].effects == ("steering_dead_band",)


def test_nothing_sticks_where_nothing_is_missing() -> None:
    # One of n standard normals exceeds 2 sqrt(log n) in fewer than one of n recordings.
    fit = fitted(recorded(lateral()))
    target = next(one for one in targets(fit.simulator, fit.at.y) if one.name == STEERING)
    found = likeliest(Linearised.of(fit), target)
    assert found is not None
    assert 0.5 * found.score**2 < 2.0 * np.log(found.choice)
