"""Where fits start beside the nearest optimum: off rims, from the vehicle file; and what is said of those on rims."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.mismatch.answer.verdict import _cornered, _rim
from vehicle_sbi.mismatch.estimation.base_fit import as_stated, likelier, off_rims
from vehicle_sbi.mismatch.estimation.fit import Fit, linearise
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS


def held_at(observation: Observation, theta: np.ndarray) -> Fit:
    """A fit that stopped at theta, under noise as it is."""
    return Fit(observation, theta, linearise(observation.simulator, theta))


@pytest.fixture(scope="module")
def cornered() -> Fit:
    observation = recorded(lateral())
    space = observation.simulator.space
    return held_at(observation, np.array([space.high[0], space.low[1], TRUTH[2]]))


def test_a_start_off_the_rims_moves_what_lies_on_them_and_nothing_else(cornered: Fit) -> None:
    space = cornered.simulator.space
    start = off_rims(cornered)
    quarter = 0.25 * (space.high - space.low)
    assert start == pytest.approx([space.high[0] - quarter[0], space.low[1] + quarter[1], TRUTH[2]])
    assert np.array_equal(off_rims(held_at(cornered.observation, TRUTH)), TRUTH)


def test_a_start_from_the_vehicle_file_has_its_constants_and_effects_at_their_nulls() -> None:
    simulator = lateral()
    effect = EFFECT_PARAMETERS["gyro_scale.z"]
    space = replace(simulator.space, parameters=(*simulator.space.parameters, effect))
    l_f, *relative, scale = as_stated(replace(simulator, space=space))
    assert l_f == pytest.approx(float(simulator.nominal["l_f"]))
    assert relative == [0.0, 0.0]  # of what the file states
    assert scale == 1.0
    unknown = simulator.nominal.copy()
    unknown["l_f"] = np.nan
    box = simulator.space.parameters[0]
    assert as_stated(replace(simulator, nominal=unknown))[0] == 0.5 * (box.low + box.high)


def test_a_fit_in_a_corner_is_left_for_a_likelier_one_and_the_likeliest_stays(cornered: Fit) -> None:
    better = likelier(cornered, [off_rims(cornered)])
    assert better.log_likelihood > cornered.log_likelihood + 100.0
    assert better.inside.all()
    optimum = fitted(cornered.observation)
    assert likelier(optimum, [off_rims(optimum), TRUTH]) is optimum


def test_a_model_on_several_rims_is_named_first_and_its_effects_are_none_of_them(cornered: Fit) -> None:
    model = Model((), cornered, cornered.simulator.space.names)
    said = _rim(model, "extended")
    assert [line.split(":")[0] for line in said] == list(cornered.simulator.space.names[:2])
    (first,) = _cornered(model, "extended")
    assert first.startswith("The extended model's best fit is at bounds of 2 priors at once")
    assert all(f"'prior.{p.name}=[" in first for p in cornered.simulator.space.parameters[:2])
    own = replace(model, base=cornered.simulator.space.names[1:], effects=("l_f",))
    assert len(_rim(own, "extended")) == 1
    assert _cornered(own, "extended") == []
