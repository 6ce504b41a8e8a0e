"""Laws of windows, masks and the hold-out split."""

from collections.abc import Mapping

import numpy as np
import pytest

from vehicle_sbi.data.recording import CHANNELS, INPUTS, Recording, smoothed
from vehicle_sbi.errors import InputError

RATE = 100.0


def recording(seconds: float = 20.0, **channels: np.ndarray | float) -> Recording:
    """A made-up drive at 10 m/s whose a_y holds the sample number, so that a window shows what it was cut from."""
    t = np.arange(round(seconds * RATE)) / RATE
    given: Mapping[str, np.ndarray | float] = {
        "steering": 0.01 * np.sin(t),
        "v_x": 10.0,
        "yaw_rate": 0.1 * np.sin(t),
        "a_y": np.arange(len(t), dtype=float),
        **channels,
    }
    values = {name: np.broadcast_to(np.asarray(value, dtype=float), t.shape).copy() for name, value in given.items()}
    return Recording(
        name="made_up",
        rate=RATE,
        t=t,
        channels=values,
        valid={name: np.isfinite(value) for name, value in values.items()},
        groups={"a_y": "can"},
        source="made_up.csv",
        sha256="",
    )


def cut(rec: Recording, **settings):
    return rec.windows(**{"drive": "speed", "channels": ["a_y"], "length_s": 5.0, "steering_ratio": None, **settings})


def test_native_column_is_name_and_suffix():
    assert CHANNELS["a_x"].column == "a_x_mps2"
    assert all(name == channel.name for name, channel in CHANNELS.items())


@pytest.mark.parametrize("length_s", [0.37, 1.0, 5.0, 7.5])
def test_windows_cover_every_sample_exactly_once(length_s):
    rec = recording(15.0)
    windows = cut(rec, length_s=length_s, warmup_s=0.0)
    covered = np.sort(windows.y[windows.valid])
    n = round(length_s * RATE)
    left_over = len(rec.t) % n
    expected = len(rec.t) - (left_over if 2 * left_over < n else 0)
    np.testing.assert_array_equal(covered, np.arange(expected))


def test_last_window_is_padded_from_half_a_window_on():
    assert len(cut(recording(12.49)).t) == 2
    windows = cut(recording(12.5))
    assert len(windows.t) == 3
    y, valid = windows.y.reshape(3, -1), windows.valid.reshape(3, -1)
    assert np.isnan(y[2, 250:]).all()
    assert not valid[2, 250:].any()
    assert np.ptp(windows.u[2, 249:], axis=0) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.diff(windows.t), 1 / RATE)


def test_warmup_is_masked_in_each_window_and_nothing_else():
    valid = cut(recording(), warmup_s=0.5).valid.reshape(4, -1)
    assert not valid[:, :50].any()
    assert valid[:, 50:].all()


def test_a_time_shift_shifts_the_times_and_nothing_else():
    rec = recording()
    later = Recording(**{**vars(rec), "t": rec.t + 1000.0})
    windows, shifted = cut(rec), cut(later)
    np.testing.assert_allclose(shifted.t, windows.t + 1000.0)
    for name in ("u", "y", "valid", "x0", "x0_std"):
        np.testing.assert_array_equal(getattr(shifted, name), getattr(windows, name))


def test_start_and_stop_choose_a_stretch():
    windows = cut(recording(), start_s=3.0, stop_s=12.999, warmup_s=0.0)
    assert windows.y[0, 0] == 300.0
    assert windows.y[0, -1] == 1299.0


def test_windows_never_span_a_gap_of_an_input():
    steering = np.full(2000, 0.01)
    steering[700:800] = np.nan
    windows = cut(recording(steering=steering), warmup_s=0.0)
    assert np.isfinite(windows.u).all()
    inside = (windows.t >= 7.0 - 1e-9) & (windows.t < 8.0 - 1e-9) & windows.valid.reshape(windows.t.shape)
    assert not inside.any()
    assert any("without an input" in note for note in windows.notes)
    assert [float(t) for t in windows.t[:, 0]] == pytest.approx([0.0, 8.0, 13.0])


def test_a_gap_of_a_measurement_is_masked_without_a_cut():
    a_y = np.arange(2000.0)
    a_y[700:800] = np.nan
    windows = cut(recording(a_y=a_y), warmup_s=0.0)
    assert len(windows.t) == 4
    assert windows.valid.sum() == 1900
    assert not windows.valid[np.isnan(windows.y)].any()


def test_speeds_below_the_limit_are_left_out():
    v_x = np.minimum(np.arange(2000.0) / 100.0, 10.0)
    windows = cut(recording(v_x=v_x), v_min=2.0, warmup_s=0.0)
    assert windows.t[0, 0] == pytest.approx(2.0, abs=1.01 / RATE)
    assert windows.x0[0, 0] == pytest.approx(windows.t[0, 0])


def test_braking_is_left_out_where_torque_drives_only():
    brake = np.zeros(2000)
    brake[500:600] = 1.0
    rec = recording(brake=brake, torque_front=100.0)
    assert cut(rec, drive="torque", warmup_s=0.0).t[:, 0] == pytest.approx([0.0, 6.0, 11.0, 16.0])
    assert cut(rec, drive="speed", warmup_s=0.0).t[:, 0] == pytest.approx([0.0, 5.0, 10.0, 15.0])


def test_unused_inputs_are_zero_and_axles_are_means_of_their_wheels():
    wheels = {"wheel_speed_fl": 30.0, "wheel_speed_fr": 32.0, "wheel_speed_rl": 28.0, "wheel_speed_rr": 29.0}
    u = cut(recording(**wheels), drive="wheel_speed").u
    assert u[..., INPUTS.index("wheel_speed_front")] == pytest.approx(31.0)
    assert u[..., INPUTS.index("wheel_speed_rear")] == pytest.approx(28.5)
    assert not u[..., 1:5].any()


def test_steering_wheel_is_divided_by_the_ratio():
    rec = recording(steering_wheel=0.5)
    rec = Recording(**{**vars(rec), "channels": {k: v for k, v in rec.channels.items() if k != "steering"}})
    assert cut(rec, steering_ratio=16.0).u[..., 0] == pytest.approx(0.5 / 16.0)
    with pytest.raises(InputError, match="steering_ratio"):
        cut(rec)


def test_derivative_of_a_parabola_is_exact():
    t = np.arange(500) / RATE
    v_x = 10.0 + 0.3 * t - 0.7 * t**2 + 5.0
    np.testing.assert_allclose(smoothed(v_x, RATE, ""), v_x, atol=1e-10)
    np.testing.assert_allclose(smoothed(v_x, RATE, "", derivative=1), 0.3 - 1.4 * t, atol=1e-8)


def test_the_derivative_of_noise_is_smooth():
    # Where the speed is noise, a model's a_x is that noise's derivative: were it rough, a delayed or smoothed sensor
    # would explain it better. One pass of the filter (weights j / sum j^2, |j| <= 12) jumps by sqrt(312/1300) = 0.49 of
    # its standard deviation from sample to sample; half of that is asked for.
    v_x = 10.0 + 0.01 * np.random.default_rng(0).standard_normal(10_000)
    windows = cut(recording(100.0, v_x=v_x), warmup_s=0.0)
    found = windows.u[:, :, INPUTS.index("v_x_dot")]
    assert np.diff(found, axis=1).std() < 0.25 * found.std()


def test_initial_state_is_the_measurement_and_its_std_the_noise():
    noise = np.random.default_rng(0).normal(0.0, 0.02, 2000)
    windows = cut(recording(yaw_rate=0.3 + noise, v_y=-0.2))
    np.testing.assert_allclose(windows.x0, [[10.0, -0.2, 0.3]] * 4, atol=0.02)
    # a filter of 25 samples and order 2 keeps 1 - 9/100 of white noise in the residual; 2000 samples give 2 % of it
    assert windows.x0_std == pytest.approx([0.0, 0.0, 0.02], rel=0.1, abs=1e-9)


def test_initial_speed_from_the_rear_wheels_where_no_speed_is_recorded():
    rec = recording(torque_front=0.0, wheel_speed_rear=30.0)
    rec = Recording(**{**vars(rec), "channels": {k: v for k, v in rec.channels.items() if k != "v_x"}})
    assert cut(rec, drive="torque", wheel_radius=0.3).x0[:, 0] == pytest.approx(9.0)
    with pytest.raises(InputError, match="v_x_mps"):
        cut(rec, drive="torque")


def test_holdout_parts_share_no_sample_and_keep_their_distance():
    rec = recording(60.0)
    training, held = rec.holdout(share=0.25, block_s=5.0, buffer_s=1.0)
    a, b = training.valid["a_y"], held.valid["a_y"]
    assert not (a & b).any()
    assert b.mean() == pytest.approx(0.25)
    distance = np.abs(np.flatnonzero(a)[:, None] - np.flatnonzero(b)[None, :]).min()
    assert distance == 101
    assert all(np.isnan(values[~a]).all() for values in training.channels.values())
    assert "held out" in training.notes[-1]
    assert not any("without an input" in note for note in cut(training).notes)  # it is there, but held out
    assert cut(held).valid.any()


def test_holdout_of_a_short_recording_has_both_parts():
    training, held = recording(4.0).holdout(share=0.25, buffer_s=0.1)
    assert training.valid["a_y"].any()
    assert held.valid["a_y"].any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"drive": "torque"},
            r"made_up.csv: drive mode 'torque' needs channel 'torque_front' \(column torque_front_nm\)",
        ),
        ({"drive": "wheel_speed"}, "'wheel_speed' needs channel 'wheel_speed_front'"),
        ({"drive": "sped"}, "unknown drive mode 'sped'; known: speed"),
        ({"channels": ["a_z"]}, r"the fit needs channel 'a_z' \(column a_z_mps2\)"),
        ({"channels": ["ay"]}, "unknown channel 'ay'; known: a_y"),
        ({"channels": ["v_x"]}, "v_x drives the model in drive mode 'speed'"),
        ({"length_s": 0.4}, "warm-up"),
        (
            {"length_s": 50.0},
            r"no window of 50 s is left; stretches that can be used: 0.00 to 19.99 s; window_s=20 fits the longest",
        ),
        ({"v_min": 11.0}, "no stretch can be used; 20.00 s below 11 m/s: not used"),
    ],
)
def test_wrong_settings_are_one_clear_line(settings, message):
    with pytest.raises(InputError, match=message) as error:
        cut(recording(), **settings)
    assert "\n" not in str(error.value)


def test_recordings_refuse_unknown_channels_and_impossible_splits():
    rec = recording()
    with pytest.raises(InputError, match="unknown channel 'ay'"):
        Recording(**{**vars(rec), "channels": {"ay": rec.t}, "valid": {"ay": rec.t > 0}})
    with pytest.raises(InputError, match="0 < share < 1"):
        rec.holdout(share=1.5)
    with pytest.raises(InputError, match="leaves nothing to train on"):
        rec.holdout(buffer_s=100.0)
