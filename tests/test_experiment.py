"""Which further recording separates: a distance of predictions, what a road does the other way, what is offered."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import PAPER
from recorded import TRUTH, fitted, lateral, recorded
from studies import constant_noise, simulator

from vehicle_sbi.inference.directions import responses
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.design import experiment
from vehicle_sbi.mismatch.design.experiment import (
    HIDDEN,
    MENU,
    WORTH,
    Experiment,
    advice,
    menu,
    separation,
    separation_in,
    separations,
)
from vehicle_sbi.mismatch.estimation.fit import linearise
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS, KNOTS
from vehicle_sbi.physics.single_track import DRIVES, INPUTS

OPPOSITE = MENU["a second run of the same road in the opposite direction"]
MIRRORED = MENU["the same drive with the steering mirrored"]
WALKING = "a stretch straight ahead at walking pace (1.5 m/s)"


def only(sim: Simulator, *channels: str) -> Simulator:
    """With nothing but some of its channels, their noise constant."""
    kept = [sim.windows.channels.index(name) for name in channels]
    groups = tuple(sim.windows.groups[k] for k in kept)
    valid, y = sim.windows.valid[kept], sim.windows.y[kept]
    windows = replace(sim.windows, channels=channels, groups=groups, valid=valid, y=y)
    return replace(sim, windows=windows).with_noise(constant_noise(windows))


def beside(sim: Simulator, *names: str) -> Simulator:
    """With parameters of the catalogue free beside its own."""
    extra = (EFFECT_PARAMETERS[name] for name in names)
    return replace(sim, space=ParameterSpace((*sim.space.parameters, *extra)))


def explained(observation: Observation, *names: str) -> Model:
    """The fit with parameters of one effect free."""
    free = beside(observation.simulator, *names)
    return Model((names[0].split(".")[0],), fitted(observation.extended(free)), observation.simulator.space.names)


def coherence(runs: list[Simulator]) -> float:
    """Of the last two parameters over runs together, the others and initial states at their best again."""
    theta = np.concatenate([TRUTH, [0.0, 0.0]])
    at = [linearise(run, theta) for run in runs]
    J = np.concatenate([(one.J / runs[0].noise.floor[:, None]).reshape(len(theta), -1) for one in at], axis=1)
    rest, (g, h) = J[:-2], J[-2:]
    known = np.linalg.inv(rest @ rest.T + np.eye(len(rest)))
    left = np.array([one - one @ rest.T @ known @ rest for one in (g, h)])
    return float(np.abs(left[0] @ left[1]) / np.linalg.norm(left[0]) / np.linalg.norm(left[1]))


@pytest.mark.parametrize(
    ("road", "car", "alone"),
    [("road_grade.angle", "accelerometer_bias.x", 0.95), ("road_bank.angle", "accelerometer_bias.y", 0.8)],
)
def test_the_road_and_the_car_s_own_offset_come_apart_in_the_opposite_direction(
    road: str, car: str, alone: float
) -> None:
    # Of equal runs one has the sum of both and the other their difference: what is left of their product vanishes but
    # for what the steering makes of a bank. Another drive that way does not do it.
    there = beside(lateral(), road, car)
    assert coherence([there]) > alone
    assert coherence([there, MIRRORED(there)]) > alone
    assert coherence([there, OPPOSITE(there)]) < 0.05


def test_two_names_for_one_slope_are_told_apart_by_driving_it_the_other_way() -> None:
    # A bias of g sin(angle), known to sigma / sqrt(n), would be off by twice itself in as long a run the other way. The
    # distance is that over the noise and both fits' own uncertainty: 2 b sqrt(n) / sigma / sqrt(1 + 1 + 1).
    observation = replace(recorded(lateral(), road_grade__angle=0.03), estimated=False)
    grade = explained(observation, "road_grade.angle")
    bias = explained(observation, "accelerometer_bias.x")
    n, sigma = observation.observed.shape[1], bias.fit.simulator.noise.floor[0]
    best, *others = separations(grade, bias)
    assert best.separation == pytest.approx(2.0 * bias.fit.theta[-1] * np.sqrt(n / 3.0) / sigma, rel=0.01)
    assert best.separation > 10.0 * max(one.separation for one in others)
    assert "record a second run of the same road in the opposite direction" in advice(grade, bias)


@pytest.mark.parametrize("effect", ["road_bank.angle", "crosswind.force"])
def test_what_road_and_wind_do_sideways_is_mirrored_the_other_way(effect: str) -> None:
    p = EFFECT_PARAMETERS[effect]
    here = beside(lateral(), effect)
    theta = np.array([[*TRUTH, 0.5 * p.high]])
    (a_x, a_y, r), turned = here.noise_free(theta)[0], OPPOSITE(here).noise_free(theta)[0]
    np.testing.assert_allclose(turned, [a_x, -a_y, -r], atol=1e-9)
    assert np.abs(MIRRORED(here).noise_free(theta)[0] - turned).max() > 1e-3


@pytest.mark.parametrize(
    "offset", ["steering_offset.angle", "gyro_bias.z", "accelerometer_bias.y", "yaw_moment.moment"]
)
def test_the_car_s_own_offsets_are_not(offset: str) -> None:
    here = beside(lateral(), offset)
    theta = np.array([[*TRUTH, 0.5 * EFFECT_PARAMETERS[offset].high]])
    np.testing.assert_array_equal(OPPOSITE(here).noise_free(theta), MIRRORED(here).noise_free(theta))


def test_a_profile_of_the_grade_comes_backwards_with_the_other_sign() -> None:
    # Steady and straight ahead the grade is all that a_x shows, the last slope first and downhill where it was uphill.
    names = [f"road_grade_profile.angle_{i}" for i in range(KNOTS)]
    here = beside(MENU["the same speeds straight ahead"](lateral()), *names)
    nominal = here.nominal.copy()
    nominal["duration"] = here.windows.u[..., INPUTS.index("time")].max()
    here = replace(here, nominal=nominal)
    theta = np.array([[*TRUTH, *np.linspace(-0.02, 0.1, KNOTS)]])
    uphill, downhill = (run.noise_free(theta)[0, 0] for run in (here, OPPOSITE(here)))
    np.testing.assert_allclose(downhill, -uphill[::-1], atol=1e-9)


def test_who_turns_round_twice_drives_the_same_road() -> None:
    here = beside(lateral(), *EFFECT_PARAMETERS)
    twice = OPPOSITE(OPPOSITE(here))
    assert twice.space == here.space
    np.testing.assert_array_equal(twice.windows.u, here.windows.u)
    np.testing.assert_array_equal(twice.windows.x0, here.windows.x0)


def test_a_steady_circle_does_not_tell_when_something_happens() -> None:
    # Nothing changes there, so that neither a late steering nor late sensors show.
    observation = replace(recorded(lateral(), steering_delay__time=0.05), estimated=False)
    steering, sensors = (explained(observation, name) for name in ("steering_delay.time", "sensor_delay.imu"))
    circle = MENU["a steady circle at the same speeds"]
    assert separation(steering.fit, sensors.fit, circle) < 0.1 * HIDDEN


def test_a_walking_pace_tells_the_gyro_s_zero_from_the_steering_s() -> None:
    # A wheel that is not straight turns the car in proportion to its speed, and hardly at a walk; a gyro's zero stays.
    observation = recorded(only(lateral(), "yaw_rate"), gyro_bias__z=0.01)
    gyro = explained(observation, "gyro_bias.z")
    steering = explained(observation, "steering_offset.angle")
    assert separations(gyro, steering)[0].drive == WALKING
    for one in (gyro, steering):
        walked = MENU[WALKING](one.fit.simulator).noise_free(one.fit.theta[None])
        angle = one.fit.theta[-1] if one is steering else 0.0
        bias = one.fit.theta[-1] if one is gyro else 0.0
        assert walked[0, 0, -1] == pytest.approx(bias + 1.5 * np.tan(angle) / PAPER.L, rel=0.02)


def test_a_separation_is_the_distance_in_the_covariance_of_both_predictions() -> None:
    # Independent noise and a known start: the covariance is that of noise and of both fits' parameters, written out.
    observation = replace(recorded(lateral(seconds=3.0), body_roll__gradient=0.012), estimated=False)
    a = explained(observation, "body_roll.gradient").fit
    b = explained(observation, "accelerometer_scale.y").fit
    std, change = a.simulator.noise.floor, MENU["the same steering at 1.3 times the speed"]
    at = [linearise(change(fit.simulator), fit.theta) for fit in (a, b)]
    d = ((at[1].y - at[0].y) / std[:, None]).ravel()
    covariance = np.eye(len(d))
    for fit, there in zip((a, b), at, strict=True):
        J = (there.J / std[:, None] / fit.simulator.space.prior_std[:, None, None]).reshape(len(fit.theta), -1)
        covariance += J.T @ fit.covariance @ J
    assert separation(a, b, change) == pytest.approx(np.sqrt(d @ np.linalg.solve(covariance, d)), rel=1e-6)
    assert separation(a, b, change) == pytest.approx(separation(b, a, change), rel=1e-6)


def fixed_drive(drive: str) -> Simulator:
    """The mild manoeuvre in a drive mode, at a steady speed where that is given."""
    sim = simulator()
    u = sim.windows.u.copy()
    u[..., INPUTS.index("v_x")] = sim.windows.x0[0, 0]
    for wheel in ("wheel_speed_front", "wheel_speed_rear"):
        u[..., INPUTS.index(wheel)] = sim.windows.x0[0, 0] / PAPER.R_f
    return replace(sim, drive=drive, windows=replace(sim.windows, u=u, channels=("v_x",), groups=("can",)))


@pytest.mark.parametrize("drive", DRIVES)
def test_a_drive_that_is_offered_at_another_speed_is_driven_at_that_speed(drive: str) -> None:
    here = fixed_drive(drive)
    speed = here.noise_free(TRUTH[None])[0, 0]
    wanted = {f"the same steering at {f} times the speed": f * speed for f in (0.7, 1.3)} | {WALKING: 1.5 + 0.0 * speed}
    offered = menu(here)
    assert (drive == "torque") == (not wanted.keys() & offered.keys())
    late = slice(len(speed) // 2, None)  # once the wheels' first slip is over; their load flattens them by some percent
    for words in wanted.keys() & offered.keys():
        driven = offered[words](here).noise_free(TRUTH[None])[0, 0]
        np.testing.assert_allclose(driven[late], wanted[words][late], rtol=0.04)


@pytest.fixture(scope="module")
def gains() -> tuple[Model, Model]:
    """Two names for a yaw rate that is too large, where nothing else is measured and torques drive the car gently."""
    sim = only(simulator({"l_f": [1.0, 1.5]}, steering_amplitude=0.02), "yaw_rate")
    truth = responses(sim, TRUTH[:1], [{EFFECT_PARAMETERS["gyro_scale.z"]: 1.1}])[0]
    noise = sim.noise.std(truth) * sim.noise.sample(truth.shape, np.random.default_rng(0))
    observation = Observation(sim, truth + noise, False)
    return explained(observation, "gyro_scale.z"), explained(observation, "steering_ratio.gain")


def test_another_sensor_is_asked_for_where_no_drive_separates(gains: tuple[Model, Model]) -> None:
    found = separations(*gains)
    assert max(one.separation for one in found if one.drive in MENU) < WORTH
    assert found[0].separation > WORTH
    assert found[0].drive == "the same drive with a_y measured too"
    assert found[0].drive in advice(*gains)


def test_a_further_channel_never_takes_separation_away(gains: tuple[Model, Model]) -> None:
    a, b = (one.fit for one in gains)
    again = separation(a, b, lambda recorded: recorded)
    sensors = [change for words, change in menu(a.simulator).items() if words not in MENU]
    assert sensors
    assert min(separation(a, b, change) for change in sensors) > again - 1e-9


def test_sensors_are_those_that_the_model_predicts_and_the_recording_lacks() -> None:
    for drive, model in (("speed", "single_track"), ("torque", "full_vehicle")):
        here = replace(lateral(), drive=drive, model=model)
        added = {change(here).windows.channels[-1] for words, change in menu(here).items() if words not in MENU}
        body = {"a_z", "roll_rate", "pitch_rate"} if model == "full_vehicle" else set()
        given = {"v_x"} if drive == "torque" else set()
        assert added == {"wheel_speed_front", "wheel_speed_rear", "v_y"} | body | given


def test_a_gust_does_not_blow_again() -> None:
    observation = recorded(lateral(), gust__force=800.0, gust__start=2.0, gust__duration=3.0)
    free = beside(observation.simulator, "gust.force", "gust.start", "gust.duration")
    gust = fitted(observation.extended(free))
    stronger = replace(gust, theta=gust.theta * [1.0, 1.0, 1.0, 2.0, 1.0, 1.0])
    assert separation(gust, stronger, MIRRORED) == 0.0


def test_nothing_is_recommended_where_noise_would_hide_the_difference() -> None:
    # Roll without a lag is a gain of a_y, at any speed and steering; the same model twice differs nowhere.
    observation = recorded(lateral(), body_roll__gradient=0.012)
    roll = explained(observation, "body_roll.gradient")
    scale = explained(observation, "accelerometer_scale.y")
    for other in (roll, scale):
        ranked = [one.separation for one in separations(roll, other)]
        assert ranked == sorted(ranked, reverse=True)
        assert ranked[0] < HIDDEN
        assert advice(roll, other).startswith(
            "None of the drives and sensors that were tried would tell body_roll from"
        )


@pytest.mark.parametrize(
    ("drive", "sensor", "named"), [(WORTH, 40.0, WALKING), (HIDDEN, 40.0, "a sensor"), (1.0, HIDDEN - 0.1, "None")]
)
def test_a_drive_that_is_worth_it_comes_before_a_sensor(
    monkeypatch: pytest.MonkeyPatch, drive: float, sensor: float, named: str
) -> None:
    found = [Experiment("a sensor", sensor), Experiment(WALKING, drive)]
    monkeypatch.setattr(experiment, "separations", lambda a, b: found)
    model: Any = SimpleNamespace(effects=("roll",))
    assert [words for words in (WALKING, "a sensor", "None") if words in advice(model, model)] == [named]


def test_recordings_that_were_held_out_separate_as_a_drive_like_theirs_would(gains: tuple[Model, Model]) -> None:
    a, b = (one.fit for one in gains)
    mirrored = MIRRORED(a.simulator)
    held_out = Observation(mirrored, mirrored.windows.y, False)
    assert separation_in(a, b, held_out) == pytest.approx(separation(a, b, MIRRORED), rel=1e-9)


@pytest.mark.parametrize(("apart", "enough"), [(WORTH, True), (WORTH - 0.1, False), (np.nan, False)])
def test_what_was_held_out_comes_before_another_drive(
    monkeypatch: pytest.MonkeyPatch, apart: float, enough: bool
) -> None:
    monkeypatch.setattr(experiment, "separations", lambda a, b: [Experiment(WALKING, 9.0)])
    monkeypatch.setattr(experiment, "separation_in", lambda a, b, held_out: apart)
    here = lateral()
    model: Any = SimpleNamespace(effects=("roll",), fit=None)
    said = advice(model, model, Observation(here, here.windows.y, False))
    assert ("fit what was held out too" in said, WALKING in said) == (enough, not enough)


def test_a_slower_drive_is_integrated_in_finer_steps() -> None:
    # Stiff tyres without relaxation: at 12 m/s one step a sample is enough, at a walk the mode is 8 times as fast.
    here = lateral()
    nominal = here.nominal.copy()
    nominal["K"], nominal["C_alpha_f"], nominal["C_alpha_r"] = np.inf, 2.4e5, 2.4e5
    windows = replace(here.windows, x0=np.array([[12.0, 0.0, 0.0]]))
    coarse = replace(beside(here, "steering_offset.angle"), nominal=nominal, substeps=1, windows=windows)
    walked = MENU[WALKING](coarse)
    theta = np.array([[*TRUTH, 0.02]])
    exact = replace(walked, substeps=10 * walked.substeps).noise_free(theta)
    np.testing.assert_allclose(walked.noise_free(theta), exact, atol=0.01 * np.abs(exact).max())
