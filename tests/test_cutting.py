"""Laws of the windows that a recording is cut into."""

import numpy as np
import pytest
from cars import derived
from made_up import RATE, in_windows, recording

from vehicle_sbi.data.cutting import REMEMBERED_S
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.commands import steer
from vehicle_sbi.physics.single_track import COMMANDS, INPUTS


@pytest.mark.parametrize("length_s", [0.37, 1.0, 5.0, 7.5])
def test_windows_cover_every_sample_exactly_once(length_s):
    rec = recording(15.0)
    windows = in_windows(rec, length_s=length_s, warmup_s=0.0)
    covered = np.sort(windows.y[windows.valid])
    n = round(length_s * RATE)
    left_over = len(rec.t) % n
    expected = len(rec.t) - (left_over if 2 * left_over < n else 0)
    np.testing.assert_array_equal(covered, np.arange(expected))


def test_last_window_is_padded_from_half_a_window_on():
    assert len(in_windows(recording(12.49)).t) == 2
    windows = in_windows(recording(12.5))
    assert len(windows.t) == 3
    y, valid = windows.y.reshape(3, -1), windows.valid.reshape(3, -1)
    assert np.isnan(y[2, 250:]).all()
    assert not valid[2, 250:].any()
    assert np.ptp(windows.u[2, 249:], axis=0) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.diff(windows.t), 1 / RATE)


def test_warmup_is_masked_in_each_window_and_nothing_else():
    valid = in_windows(recording(), warmup_s=0.5).valid.reshape(4, -1)
    assert not valid[:, :50].any()
    assert valid[:, 50:].all()


def test_a_time_shift_shifts_the_times_and_nothing_else():
    rec = recording()
    later = Recording(**{**vars(rec), "t": rec.t + 1000.0})
    windows, shifted = in_windows(rec), in_windows(later)
    np.testing.assert_allclose(shifted.t, windows.t + 1000.0)
    for name in ("u", "before", "y", "valid", "x0", "x0_std"):
        np.testing.assert_array_equal(getattr(shifted, name), getattr(windows, name))


def test_a_window_knows_the_commands_before_it():
    t = np.arange(2000) / RATE
    windows = in_windows(recording(steering=0.05 * np.sin(t)), warmup_s=0.0)
    earlier = windows.before.shape[1]
    assert earlier == round(REMEMBERED_S * RATE)
    whole = windows.u[..., : len(COMMANDS)].reshape(-1, len(COMMANDS))
    for before, start in zip(windows.before, np.arange(len(windows.t)) * windows.t.shape[1], strict=True):
        np.testing.assert_array_equal(before, whole[np.maximum(np.arange(start - earlier, start), 0)])


def test_a_window_knows_commands_that_are_masked():
    # What is held out are measurements; what was steered meanwhile is known.
    rec = recording(steering=0.05 * np.sin(np.arange(2000) / RATE))
    whole, later = in_windows(rec, warmup_s=0.0), in_windows(rec.masked(rec.t >= 10.0, "later"), warmup_s=0.0)
    assert later.t[0, 0] == whole.t[2, 0]
    np.testing.assert_allclose(later.before, whole.before[2:], rtol=0.0, atol=1e-12)


def test_a_play_in_a_window_stands_where_the_drive_before_it_left_it():
    # Wheels that steer to one side and back, then lie still in the play for 8 s on both sides of a window's start.
    t, width = np.arange(2000) / RATE, 0.01
    steering = np.interp(t, [0.0, 2.0, 6.0, 7.0], [0.0, 0.0, 0.05, 0.03]) + 1e-3 * np.sin(t)
    windows, whole = in_windows(recording(steering=steering), warmup_s=0.0, length_s=10.0), np.empty(len(t))
    steer(derived(steering_dead_band_width=width), windows.u[..., 0].reshape(-1), RATE, whole)
    assert abs(whole[1000] - steering[1000]) > 0.3 * width
    for before, u, start in zip(windows.before, windows.u, (0, 1000), strict=True):
        wheels = np.empty(len(u))
        steer(derived(steering_dead_band_width=width), np.concatenate([before[:, 0], u[:, 0]]), RATE, wheels)
        np.testing.assert_allclose(wheels, whole[start : start + 1000], rtol=0.0, atol=1e-12)


def test_where_the_commands_before_a_window_are_absent_it_takes_the_next():
    steering = 0.05 * np.sin(np.arange(2000) / RATE)
    steering[350:420] = np.nan
    windows = in_windows(recording(steering=steering), warmup_s=0.0)
    begun = np.flatnonzero(windows.t[:, 0] > 4.19)[0]
    before, first = windows.before[begun, :, 0], windows.u[begun, 0, 0]
    np.testing.assert_array_equal(before[-70:], first)
    assert np.ptp(before[:-70]) > 0.0


def test_start_and_stop_choose_a_stretch():
    windows = in_windows(recording(), start_s=3.0, stop_s=12.999, warmup_s=0.0)
    assert windows.y[0, 0] == 300.0
    assert windows.y[0, -1] == 1299.0


def test_windows_never_span_a_gap_of_an_input():
    steering = np.full(2000, 0.01)
    steering[700:800] = np.nan
    windows = in_windows(recording(steering=steering), warmup_s=0.0)
    assert np.isfinite(windows.u).all()
    inside = (windows.t >= 7.0 - 1e-9) & (windows.t < 8.0 - 1e-9) & windows.valid.reshape(windows.t.shape)
    assert not inside.any()
    assert any("without an input" in note for note in windows.notes)
    assert [float(t) for t in windows.t[:, 0]] == pytest.approx([0.0, 8.0, 13.0])


def test_a_gap_of_a_measurement_is_masked_without_a_cut():
    a_y = np.arange(2000.0)
    a_y[700:800] = np.nan
    windows = in_windows(recording(a_y=a_y), warmup_s=0.0)
    assert len(windows.t) == 4
    assert windows.valid.sum() == 1900
    assert not windows.valid[np.isnan(windows.y)].any()


def test_speeds_below_the_limit_are_left_out():
    v_x = np.minimum(np.arange(2000.0) / 100.0, 10.0)
    windows = in_windows(recording(v_x=v_x), v_min=2.0, warmup_s=0.0)
    assert windows.t[0, 0] == pytest.approx(2.0, abs=1.01 / RATE)
    assert windows.x0[0, 0] == pytest.approx(windows.t[0, 0])


def test_braking_is_left_out_where_torque_drives_only():
    brake = np.zeros(2000)
    brake[500:600] = 1.0
    rec = recording(brake=brake, torque_front=100.0)
    assert in_windows(rec, drive="torque", warmup_s=0.0).t[:, 0] == pytest.approx([0.0, 6.0, 11.0, 16.0])
    assert in_windows(rec, drive="speed", warmup_s=0.0).t[:, 0] == pytest.approx([0.0, 5.0, 10.0, 15.0])


def test_unused_inputs_are_zero_and_axles_are_means_of_their_wheels():
    wheels = {"wheel_speed_fl": 30.0, "wheel_speed_fr": 32.0, "wheel_speed_rl": 28.0, "wheel_speed_rr": 29.0}
    u = in_windows(recording(**wheels), drive="wheel_speed").u
    assert u[..., INPUTS.index("wheel_speed_front")] == pytest.approx(31.0)
    assert u[..., INPUTS.index("wheel_speed_rear")] == pytest.approx(28.5)
    assert not u[..., 1:5].any()


def test_steering_wheel_is_divided_by_the_ratio():
    rec = recording(steering_wheel=0.5)
    rec = Recording(**{**vars(rec), "channels": {k: v for k, v in rec.channels.items() if k != "steering"}})
    assert in_windows(rec, steering_ratio=16.0).u[..., 0] == pytest.approx(0.5 / 16.0)
    with pytest.raises(InputError, match="steering_ratio"):
        in_windows(rec)


def test_the_derivative_of_noise_is_smooth():
    # Where the speed is noise, a model's a_x is that noise's derivative: were it rough, a delayed or smoothed sensor
    # would explain it better. One pass of the filter (weights j / sum j^2, |j| <= 12) jumps by sqrt(312/1300) = 0.49 of
    # its standard deviation from sample to sample; half of that is asked for.
    v_x = 10.0 + 0.01 * np.random.default_rng(0).standard_normal(10_000)
    windows = in_windows(recording(100.0, v_x=v_x), warmup_s=0.0)
    found = windows.u[:, :, INPUTS.index("v_x_dot")]
    assert np.diff(found, axis=1).std() < 0.25 * found.std()


def test_initial_state_is_the_measurement_and_its_std_the_noise():
    noise = np.random.default_rng(0).normal(0.0, 0.02, 2000)
    windows = in_windows(recording(yaw_rate=0.3 + noise, v_y=-0.2))
    np.testing.assert_allclose(windows.x0, [[10.0, -0.2, 0.3]] * 4, atol=0.02)
    # a filter of 25 samples and order 2 keeps 1 - 9/100 of white noise in the residual; 2000 samples give 2 % of it
    assert windows.x0_std == pytest.approx([0.0, 0.0, 0.02], rel=0.1, abs=1e-9)


def test_initial_speed_from_the_rear_wheels_where_no_speed_is_recorded():
    rec = recording(torque_front=0.0, wheel_speed_rear=30.0)
    rec = Recording(**{**vars(rec), "channels": {k: v for k, v in rec.channels.items() if k != "v_x"}})
    assert in_windows(rec, drive="torque", wheel_radius=0.3).x0[:, 0] == pytest.approx(9.0)
    with pytest.raises(InputError, match="v_x_mps"):
        in_windows(rec, drive="torque")


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
        in_windows(recording(), **settings)
    assert "\n" not in str(error.value)
