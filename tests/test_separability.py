"""What a recording could show follows from its sensitivities: closed forms, and what is one and the same effect."""

from dataclasses import replace

import numpy as np
import pytest
from studies import constant_noise, simulator

from vehicle_sbi.inference.directions import beside, directions, slopes
from vehicle_sbi.inference.information import sensitivity
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.design.identifiability import SEEN, Card, card
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.report.card import could_show

MIDDLE = np.array([1.25])


def lateral(rho: float = 0.0) -> Simulator:
    """The mild manoeuvre driven by a measured speed, l_f free."""
    sim = simulator({"l_f": [1.0, 1.5]})
    u = sim.windows.u.copy()
    u[..., INPUTS.index("v_x")] = 12.0
    windows = replace(sim.windows, u=u, channels=("a_x", "a_y", "yaw_rate"), groups=("imu", "imu", "imu"))
    windows = replace(windows, y=windows.y[:3], valid=windows.valid[:3])
    sim = replace(sim, drive="speed", windows=windows)
    return sim.with_noise(constant_noise(windows, rho=rho))


def share_of_a_x(sim: Simulator, change: np.ndarray) -> float:
    """Of a change of the series (channels, time), in units of its noise."""
    white = (change / sim.noise.floor[:, None])[:, 1:]  # the first sample has no past
    return float(np.sum(white[0] ** 2) / np.sum(white**2))


def entry(of: Card, name: str) -> int:
    return [c.parameter.name for c in of.candidates].index(name)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_size_of_an_offset_that_is_seen_is_that_of_a_mean(rho: float) -> None:
    # A bias of a_x, which l_f has next to no effect on: 2.8 sigma over the root of the effective number of samples.
    sim = lateral(rho)
    n, sigma = sim.shape[1], sim.noise.floor[0]
    worth = 1 + (n - 1) * (1 - rho) / (1 + rho)
    found = card(sim, MIDDLE)
    bias = found.candidates[entry(found, "accelerometer_bias.x")]
    assert bias.size == pytest.approx(SEEN * sigma / np.sqrt(worth), rel=1e-3)
    assert bias.retained == pytest.approx(1.0, abs=1e-3)
    assert bias.visible


def test_what_is_fitted_is_no_candidate_and_absorbs_what_looks_like_it() -> None:
    # With the speed given, grade is g sin(angle) in a_x, as a bias is, and takes of the tyres' grip, which is what
    # a_y and the yaw rate see of it. Once the bias is fitted, its prior of standard deviation s leaves
    # 1/(1 + s^2 n/sigma^2) of what a_x sees. What l_f takes is at most what both do to a_x, and both to the rest.
    sim, bias = lateral(), CATALOGUE["accelerometer_bias"].parameters[0]
    fitted = replace(sim, space=ParameterSpace((*sim.space.parameters, bias)))
    before, after = card(sim, MIDDLE), card(fitted, np.array([1.25, 0.0]))
    assert not any(c.parameter.name == "accelerometer_bias.x" for c in after.candidates)
    free, absorbed = (found.candidates[entry(found, "road_grade.angle")] for found in (before, after))
    information = fitted.space.prior_std[1] ** 2 * sim.shape[1] / sim.noise.floor[0] ** 2
    grade = slopes(sim, MIDDLE, directions(sim, MIDDLE, CATALOGUE["road_grade"]))[0]
    grip, own = (1.0 - share_of_a_x(sim, change) for change in (grade, sensitivity(sim, MIDDLE).jacobian[0]))
    assert grip < 0.05
    assert 1.0 - (np.sqrt((1.0 - grip) * (1.0 - own)) + np.sqrt(grip * own)) ** 2 < free.retained <= 1.0
    assert (1.0 - grip) / (1 + information) < absorbed.retained < 1 / (1 + information) + grip
    assert abs(absorbed.absorbed["accelerometer_bias.x"]) > 10 * abs(absorbed.absorbed["l_f"])


def test_what_acts_does_so_whatever_absorbs_it() -> None:
    # A bias of a_x is a grade where the speed is given: with the one fitted the other shows less, and acts as before.
    sim, bias = lateral(), CATALOGUE["accelerometer_bias"].parameters[0]
    fitted = replace(sim, space=ParameterSpace((*sim.space.parameters, bias)))
    before, after = card(sim, MIDDLE), card(fitted, np.array([1.25, 0.0]))
    acting = [{c.parameter.name for c in found.candidates if c.acts} for found in (before, after)]
    assert acting[1] == acting[0] - {bias.name}
    assert {c.parameter.name for c in before.candidates if c.visible} <= acting[0]
    assert "road_grade.angle" in acting[1]
    assert (
        after.candidates[entry(after, "road_grade.angle")].share
        > before.candidates[entry(before, "road_grade.angle")].share
    )
    known = directions(fitted, np.array([1.25, 0.0]), CATALOGUE["road_grade"])
    assert card(fitted, np.array([1.25, 0.0]), known).acting(known) == known


def test_what_does_the_same_to_every_channel_is_one_group() -> None:
    # With the speed given, grade is nothing but g sin(angle) in a_x, as a bias is; roll is a gain of a_y.
    found = card(lateral(), MIDDLE)
    i, j = entry(found, "road_grade.angle"), entry(found, "accelerometer_bias.x")
    assert found.coherence[i, j] == pytest.approx(1.0, abs=1e-3)
    groups = found.groups()
    assert any({"road_grade.angle", "accelerometer_bias.x"} <= set(group) for group in groups)
    # With its lag in the middle of the prior, 0.15 s at a steering of 0.25 Hz, roll is a gain of a_y, 13 degrees late.
    k, gain = entry(found, "body_roll.gradient"), entry(found, "accelerometer_scale.y")
    assert 0.9 < found.coherence[k, gain] <= 1.0


def test_directions_are_those_that_leave_the_null() -> None:
    # A gust needs a duration to blow, and its force is what vanishes whatever its shape; a lag of the roll needs roll.
    sim = lateral()
    expected = {
        "gust": ["gust.force"],
        "body_roll": ["body_roll.gradient"],
        "accelerometer_scale": ["accelerometer_scale.x", "accelerometer_scale.y"],
        "drive_gain": [],  # nothing is driven by torque here
    }
    for name, parameters in expected.items():
        assert [d.parameter.name for d in directions(sim, MIDDLE, CATALOGUE[name])] == parameters


def test_what_changes_by_rounding_alone_does_not_act() -> None:
    # Loads that differ between the wheels change no force where no tyre slides, but for how its two halves are rounded.
    # On a slippery road they do, and how the axles share them and how they follow the body is then their shape.
    sim = lateral()
    slippery = sim.nominal.copy()
    slippery["mu"] = 0.35
    loads = CATALOGUE["lateral_load_transfer"]
    wheels = ["lateral_load_transfer.coefficient", "lateral_load_transfer.track"]
    assert [d.parameter.name for d in directions(sim, MIDDLE, loads)] == wheels
    found = {d.parameter.name: d for d in directions(replace(sim, nominal=slippery), MIDDLE, loads)}
    assert set(found) == {*wheels, "lateral_load_transfer.uneven"}
    shape = [f"lateral_load_transfer.{name}" for name in ("front", "period", "damping")]
    assert [p.name for p in found["lateral_load_transfer.uneven"].held] == shape


def test_what_parameters_take_of_an_effect_and_what_is_left_of_it_is_all_of_it() -> None:
    sim = lateral()
    bias = CATALOGUE["accelerometer_bias"].parameters[0]
    fitted = replace(sim, space=ParameterSpace((*sim.space.parameters, bias)))
    found = card(fitted, np.array([1.25, 0.0]))
    for one in found.candidates:
        assert one.retained + sum(one.taken.values()) == pytest.approx(1.0, abs=1e-6)
    assert found.candidates[entry(found, "road_grade.angle")].absorbers == ["accelerometer_bias.x"]
    assert found.candidates[entry(found, "imu_lever_arm.y")].absorbers == []  # a lateral lever: r' and r^2 in a_x, a_y


def test_each_effect_of_the_catalogue_could_show_or_could_not_or_is_fitted() -> None:
    sim, bias = lateral(), CATALOGUE["accelerometer_bias"].parameters
    found = card(replace(sim, space=ParameterSpace((*sim.space.parameters, *bias))), np.array([1.25, 0.0, 0.0]))
    shown, hidden, idle = found.could_show(), found.invisible(), found.cannot_act
    assert sorted([*shown, *hidden, *idle, "accelerometer_bias"]) == sorted(CATALOGUE)
    assert idle["drive_gain"] == idle["drive_delay"] == "drive mode speed takes a measured speed in place of torques"
    shares = [one.share for one in shown.values()]
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0
    assert shown["gyro_bias"].parameter.name == "gyro_bias.z"


def test_an_effect_that_shows_beside_others_alone_is_not_said_to_be_hidden() -> None:
    found = card(lateral(), np.array([1.25]))
    name = found.invisible()[0]
    rows = could_show(found, beside=[name]).set_index("effect")["visible"]
    assert {rows[row] for row in rows.index if row.split(".")[0] == name} == {"beside others"}
    assert set(rows) == {"yes", "no", "beside others"}


def test_how_high_an_imu_sits_is_a_direction_beside_a_body_that_leans() -> None:
    # By itself it changes nothing that a car in the plane reports; once known it is no such direction any more.
    sim = lateral()
    known = directions(sim, MIDDLE, CATALOGUE["imu_lever_arm"])
    assert "imu_lever_arm.z" not in [d.parameter.name for d in known]
    found = beside(sim, MIDDLE, known)
    (height,) = (d for d in found if d.parameter.name == "imu_lever_arm.z")
    assert not slopes(sim, MIDDLE, [height]).any()
    assert beside(sim, MIDDLE, [*known, *found]) == []


@pytest.mark.parametrize(
    "name", ["friction_level.factor", "friction_level.rear", "lateral_load_transfer.uneven", "downforce.area"]
)
def test_grip_is_a_direction_beside_a_tyre_that_bends_below_the_knee(name: str) -> None:
    # Dugoff's tyre is straight up to half of its grip: in a mild manoeuvre nothing that acts on grip alone shows.
    sim = lateral()
    by_itself = directions(sim, MIDDLE, CATALOGUE[name.split(".")[0]])
    assert name not in [d.parameter.name for d in by_itself if not d.asleep]
    assert name in [d.parameter.name for d in beside(sim, MIDDLE, [])]
