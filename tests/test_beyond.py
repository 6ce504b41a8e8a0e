"""Base parameters beyond their boxes: found where the truth lies outside, and left alone where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.beyond import Beyond, let_out, on_rim
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.detection import Model
from vehicle_sbi.mismatch.unnamed import beyond_boxes
from vehicle_sbi.parameters import ParameterSpace


def boxed(name: str, low: float, high: float) -> Observation:
    """A recording of the car, and the simulator with another box for one of its parameters."""
    observation = recorded(lateral())
    sim = observation.simulator
    boxes = [replace(p, low=low, high=high) if p.name == name else p for p in sim.space.parameters]
    return observation.extended(replace(sim, space=ParameterSpace(tuple(boxes))))


def test_a_box_becomes_as_wide_again_beyond_the_rim_that_holds_the_fit() -> None:
    for low, high, wider in ((1.4, 1.6, (1.4**2 / 1.6, 1.6)), (1.0, 1.1, (1.0, 1.1**2 / 1.0))):
        fit = fitted(boxed("l_f", low, high))
        assert on_rim(fit, ["l_f"]) == ["l_f"]
        assert on_rim(fit, []) == []
        p = let_out(fit, ["l_f"]).space.parameters[fit.simulator.space.column("l_f")]
        assert (p.low, p.high) == pytest.approx(wider)


def test_a_centre_of_gravity_outside_its_prior_is_found_there() -> None:
    # l_f is 1.25 m: five posterior standard deviations hold it in all but one of a million recordings.
    base = fitted(boxed("l_f", 1.4, 1.6))
    model = next(beyond_boxes(Model((), base, 0.0), base.simulator.space))
    assert isinstance(model.outside, Beyond)
    assert model.outside.boxes == {"l_f": (1.4, 1.6)}
    k = model.fit.simulator.space.column("l_f")
    assert model.fit.theta[k] == pytest.approx(1.25, abs=5.0 * np.sqrt(model.fit.covariance[k, k]))
    found = explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))
    assert found.detected
    likeliest = found.models[0]  # a lever arm of the IMU does nearly the same, and which is likelier the prior says
    assert likeliest.effects == ("imu_lever_arm",)
    assert found.p_unknown > 0.5 * found.probability[0]
    assert isinstance(found.unnamed[0].outside, Beyond)


def test_parameters_inside_their_boxes_stay_there() -> None:
    base = fitted(recorded(lateral()))
    assert not list(beyond_boxes(Model((), base, 0.0), base.simulator.space))
