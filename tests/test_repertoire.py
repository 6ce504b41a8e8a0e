"""What a little of an effect does over a while is the sum of what it does over the parts of it."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.inference.directions import STEPS, directions, shared, slopes
from vehicle_sbi.mismatch.estimation.fit import linearise
from vehicle_sbi.mismatch.hypotheses.dictionary import Repertoire
from vehicle_sbi.mismatch.selection.detection import NEAR, Model, glance, versions
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.single_track import INPUTS


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
    found = directions(sim, TRUTH, CATALOGUE["friction_level"])
    small = directions(sim, TRUTH, CATALOGUE["body_roll"])
    assert found[0].parameter.name == "friction_level.factor"
    for known in found:
        assert known.step > STEPS[0] == small[0].step
        assert known.parameter.low < known.away < known.parameter.high
        assert np.abs(slopes(sim, TRUTH, [known])).max() > 0.0


def test_times_of_channels_are_offered_where_they_differ_from_their_groups() -> None:
    # Three channels of an IMU, and the speed that drives the model, which changes, as the only one of its group.
    imu, sim = ["a_x", "a_y", "yaw_rate"], lateral()
    u = sim.windows.u.copy()
    u[..., INPUTS.index("v_x")] += 0.5 * np.sin(u[..., INPUTS.index("time")])
    sim = replace(sim, windows=replace(sim.windows, u=u))
    for name in ("sensor_delay", "sensor_lag"):
        offered = [d.parameter.name.split(".")[1] for d in directions(sim, TRUTH, CATALOGUE[name])]
        assert offered == ["imu", "can", *imu]
        # Free together, times of all three channels stand for the IMU's; nothing else stands for the speed's.
        assert [one for one in offered if not shared(sim, f"{name}.{one}", offered)] == ["can", *imu]
        split = replace(sim, windows=replace(sim.windows, groups=("imu", "imu", "can")))
        offered = [d.parameter.name.split(".")[1] for d in directions(split, TRUTH, CATALOGUE[name])]
        assert offered == ["imu", "can", *imu, "v_x"]
        assert [one for one in offered if not shared(split, f"{name}.{one}", offered)] == [*imu, "v_x"]


def test_larger_steps_are_tried_where_they_do_not_change_as_much_in_proportion() -> None:
    # A bias adds itself whatever its size; grip changes nothing until it is used up.
    fit = replace(fitted(recorded(lateral())), theta=TRUTH)
    known = [d for name in ("gyro_bias", "friction_level") for d in directions(fit.simulator, TRUTH, CATALOGUE[name])]
    steps: dict[str, set[float]] = {}
    for d in Repertoire.around(fit, known).of.directions:
        steps.setdefault(d.effect, set()).add(d.step)
    assert steps["gyro_bias"] == {STEPS[0]}
    assert max(steps["friction_level"]) > min(steps["friction_level"])


def test_changes_are_simulated_anew_where_parameters_act_otherwise() -> None:
    # Twice the stiffness halves the slip angles: what parameters do there is not what they do here.
    fit = fitted(recorded(lateral()))
    known = directions(fit.simulator, fit.theta, CATALOGUE["steering_ratio"])
    repertoire = Repertoire.around(fit, known)
    near = repertoire.beyond(fit)
    assert near.about is fit
    assert near.named is not repertoire.named
    assert np.array_equal(near.named, repertoire.named)
    theta = fit.theta + np.array([0.0, 0.25, 0.25])
    far = replace(fit, theta=theta, at=linearise(fit.simulator, theta))
    again = repertoire.beyond(far)
    assert again.about is far
    assert np.array_equal(again.named, slopes(fit.simulator, theta, again.of.directions))


def test_a_force_is_fitted_from_every_place_that_comes_near_the_best() -> None:
    fit = fitted(recorded(lateral(), crosswind__force=150.0, crosswind__arm=0.2))
    known = directions(fit.simulator, fit.theta, CATALOGUE["crosswind"])
    seen = glance(Model((), fit, 0.0), Repertoire.around(fit, known), np.random.default_rng(0))
    (version,) = versions(seen)
    arm = next(p for p in version.starts[0] if p.name == "crosswind.arm")
    evidence = {d.held[arm]: float(e) for d, e in zip(seen.free.directions, seen.scores.log_evidence, strict=True)}
    near = {value for value, e in evidence.items() if e > max(evidence.values()) - NEAR}
    assert len(near) > 1
    assert {start[arm] for start in version.starts} == near
    assert version.starts[0][arm] == max(evidence, key=lambda value: evidence[value])


def test_every_start_of_a_version_is_along_the_parameter_that_was_scored() -> None:
    fit = fitted(recorded(lateral(), imu_misalignment__pitch=0.05))
    known = directions(fit.simulator, fit.theta, CATALOGUE["imu_misalignment"])
    seen = glance(Model((), fit, 0.0), Repertoire.around(fit, known), np.random.default_rng(0))
    likeliest = seen.free.directions[int(np.argmax(seen.scores.log_evidence))].parameter
    others = {d.parameter for d in known} - {likeliest}
    assert likeliest in seen.starts
    assert others
    (version,) = versions(replace(seen, joint={}, starts=seen.starts | {p: [{p: 0.06}] for p in others}))
    assert len(version.starts) > 1
    assert all(set(start) == {likeliest} for start in version.starts)
