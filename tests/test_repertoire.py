"""What a little of an effect does over a while is the sum of what it does over the parts of it."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.inference.directions import STEPS, directions, shapes, shared, slopes
from vehicle_sbi.mismatch.hypotheses import effect
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.single_track import INPUTS


@pytest.mark.parametrize("name", ["gust", "friction_step"])
def test_spans_are_the_sum_of_their_tiles(name: str) -> None:
    fit = fitted(recorded(lateral()))
    known = directions(fit.simulator, TRUTH, CATALOGUE[name])
    tried = [shape for d in known for shape in shapes(fit.simulator, d)]
    whole = slopes(fit.simulator, TRUTH, tried)
    summed = np.array([one.change for one in effect.tested(replace(fit, theta=TRUTH), known)[: len(tried)]])
    # Both are differences over a step of which the next order is left out: a relative error of the step's size, over
    # as many tiles as a span has at most. Spans by larger steps are not put together.
    off = np.sqrt(np.mean((summed - whole) ** 2, axis=(1, 2)))
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
    found = [one.name for one in effect.tested(fit, known)]
    small = f" by {STEPS[0]:g} "
    assert all(small in name for name in found if name.startswith("gyro_bias"))
    assert any(small not in name for name in found if name.startswith("friction_level"))
