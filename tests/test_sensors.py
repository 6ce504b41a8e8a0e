"""Laws of the sensors: rigid-body kinematics, gravity that leaks in, and delays that lose nothing but time."""

import math

import numpy as np
import pytest
from cars import RATE, RIGID, coasting, finished, record_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.signal import lsim
from scipy.spatial.transform import Rotation

from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.sensors import (
    GROUPS,
    MEASUREMENTS,
    MOTION,
    imu_misalignment,
    lever_arm,
    measure,
    report,
    unreported,
)

EPS = np.finfo(float).eps
G, V = 9.81, 10.5
A_X, A_Y, YAW, OMEGA_F, OMEGA_R, V_X, V_Y, A_Z, P, Q = range(len(MEASUREMENTS))
LEAN = math.radians(4.5) / G  # 4.5 deg per g, in rad/(m/s^2)


def measured(motion: np.ndarray, rate: float = RATE, **fields: float) -> np.ndarray:
    """MEASUREMENTS (10, time) of a motion (time, 14)."""
    p, y = record_of(RIGID, **fields)[0], np.empty((len(MEASUREMENTS), len(motion)))
    derive(p)
    measure(p, motion, np.arange(len(motion)) / rate, rate, y)
    return y


def motion_of(time: int = 50, **columns: float) -> np.ndarray:
    """A motion that holds the given columns of MOTION and is zero elsewhere."""
    motion = np.zeros((time, len(MOTION)))
    for name, value in columns.items():
        motion[:, MOTION.index(name)] = value
    return motion


def test_perfect_sensors_report_the_motion_bit_for_bit() -> None:
    # An upright body at the centre of gravity; a leaning one turns the sensors' axes.
    motion = np.random.default_rng(30).normal(size=(100, len(MOTION)))
    motion[:, [MOTION.index("roll"), MOTION.index("pitch")]] = 0.0
    y = measured(motion)
    for row, name in enumerate(("a_x", "a_y", "r", "omega_f", "omega_r", "v_x", "v_y")):
        assert np.array_equal(y[row], motion[:, MOTION.index(name)])
    assert np.array_equal(y[[P, Q]].T, motion[:, [MOTION.index("roll_rate"), MOTION.index("pitch_rate")]])
    assert (y[A_Z] == G).all()


def test_lever_arm_adds_centripetal_and_angular_acceleration() -> None:
    y = measured(motion_of(r=0.3, r_dot=0.5), imu_lever_arm_x=-0.3)
    assert y[A_X] == pytest.approx(0.027, rel=8 * EPS)
    assert y[A_Y] == pytest.approx(-0.15, rel=8 * EPS)


centimetres = st.floats(-2.0, 2.0)


@given(centimetres, centimetres, st.floats(1.0, 40.0), st.floats(-3.0, 3.0), st.floats(0.05, 2.0))
def test_on_a_steady_circle_every_point_accelerates_towards_the_centre(
    x: float, y: float, v_x: float, v_y: float, r: float
) -> None:
    # The centre of rotation lies at (-v_y/r, v_x/r) in body axes; a point falls towards it with r^2 times its distance.
    p = imu_at(x, y, 0.0)
    expected = r * r * np.array([-v_y / r - x, v_x / r - y, 0.0])
    measured = lever_arm(p, -v_y * r, v_x * r, 0.0, 0.0, r, 0.0, 0.0, 0.0)
    assert measured == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(centimetres, centimetres, st.floats(-5.0, 5.0))
def test_angular_acceleration_is_felt_square_to_the_arm(x: float, y: float, r_dot: float) -> None:
    a_x, a_y, a_z = lever_arm(imu_at(x, y, 0.3), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, r_dot)
    assert a_z == 0.0
    assert a_x * x + a_y * y == pytest.approx(0.0, abs=1e-13)
    assert math.hypot(a_x, a_y) == pytest.approx(abs(r_dot) * math.hypot(x, y), rel=4 * EPS)


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3), st.tuples(*[st.floats(-5.0, 5.0)] * 6))
def test_lever_arm_is_the_vector_formula(arm: tuple[float, ...], turning: tuple[float, ...]) -> None:
    # a + dw x p + w x (w x p), by numpy's cross product: sums of a dozen products below 2 * 50, to their rounding.
    w, dw, p = np.array(turning[:3]), np.array(turning[3:]), np.array(arm)
    expected = np.array([1.0, -2.0, 0.0]) + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    assert lever_arm(imu_at(*arm), 1.0, -2.0, *turning) == pytest.approx(expected, rel=0.0, abs=12 * 100 * EPS)


@given(st.floats(-5.0, 5.0), st.floats(-1.0, 1.0))
def test_high_imu_feels_a_body_that_starts_to_roll(dw_x: float, z: float) -> None:
    # To the right about a point below it: a point above moves to the right, -y.
    y = measured(motion_of(1, roll_acceleration=dw_x), imu_lever_arm_z=z)
    assert y[A_Y, 0] == -dw_x * z


def test_imu_s_place_may_be_stated_from_the_rear_axle_on_the_ground() -> None:
    p = record_of(RIGID, imu_x=0.5, imu_y=0.2, imu_z=1.0, imu_lever_arm_z=0.25)[0]
    derive(p)
    assert (p["arm_x"], p["arm_y"], p["arm_z"]) == pytest.approx((0.5 - (2.5789 - 1.1562), 0.2, 1.25 - 0.57487))


angles = st.floats(-0.1, 0.1)


@given(angles, angles, angles, st.tuples(*[st.floats(-20.0, 20.0)] * 3))
def test_misaligned_imu_reads_the_same_vector_in_turned_axes(
    roll: float, pitch: float, yaw: float, f: tuple[float, float, float]
) -> None:
    # scipy's intrinsic rotation z, y, x takes the IMU's axes to the car's; its inverse takes vectors the other way.
    # Length is kept, both to the rounding of nine products below 20.
    p = record_of(RIGID, imu_misalignment_roll=roll, imu_misalignment_pitch=pitch, imu_misalignment_yaw=yaw)[0]
    turned = np.array(imu_misalignment(p, *f))
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(f), rel=0.0, abs=9 * 20 * EPS)
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().apply(f)
    assert turned == pytest.approx(expected, rel=0.0, abs=18 * 20 * EPS)


@given(angles, angles)
def test_resting_imu_reads_g_on_any_road(grade: float, bank: float) -> None:
    y = measured(motion_of(1), road_grade_angle=grade, road_bank_angle=bank)
    assert np.linalg.norm(y[[A_X, A_Y, A_Z], 0]) == pytest.approx(G, rel=4 * EPS)
    assert measured(motion_of(1))[[A_X, A_Y, A_Z], 0].tolist() == [0.0, 0.0, G]


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_leaning_body_leaks_gravity_and_keeps_its_length(roll: float, pitch: float) -> None:
    # Right side down: the IMU's y axis points up to the left by the roll angle, so a_y gains g sin(roll); nose down:
    # its x axis points down, so a_x loses g sin(pitch).
    y = measured(motion_of(1, roll=roll, pitch=pitch))[[A_X, A_Y, A_Z], 0]
    expected = G * np.array([-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])
    assert y == pytest.approx(expected, rel=0.0, abs=4 * G * EPS)


def imu_at(x: float, y: float, z: float) -> np.void:
    """A record whose IMU sits at (x, y, z) from the centre of gravity."""
    p = record_of(RIGID, imu_lever_arm_x=x, imu_lever_arm_y=y, imu_lever_arm_z=z)[0]
    derive(p)
    return p


def test_body_roll_adds_eight_percent_to_steady_lateral_acceleration() -> None:
    # cos(phi) + g sin(phi)/a_y with phi = gradient a_y: 1 + g gradient to phi^2 (1/2 + g gradient/6).
    delta, u = 0.01, coasting(V, 4.0)
    u[:, 0] = delta
    at_cog = finished(record_of(RIGID), "speed", u, (V, 0.0, 0.0))[A_Y, -1]
    leaning = finished(record_of(RIGID, body_roll_gradient=LEAN, body_roll_lag=0.1), "speed", u, (V, 0.0, 0.0))[A_Y, -1]
    phi = LEAN * at_cog
    assert leaning / at_cog == pytest.approx(1.0 + G * 0.0785 / 9.81, abs=phi**2 + 5e-5)  # 0.0785 has three digits
    assert leaning / at_cog == pytest.approx(1.079, abs=phi**2 + 6e-4)
    assert leaning == pytest.approx(at_cog * math.cos(phi) + G * math.sin(phi), rel=1e-9)


def answer_to_a_rise(steps: int, lag: float) -> np.ndarray:
    """A first-order lag at the samples, its input rising from 0 to 1 over the first; shape (steps + 1,).

    T dy/dt = u - y: 1 - T/dt (1 - exp(-dt/T)) at the end of the rise, and the rest of it decays.
    """
    left = RATE * lag * -math.expm1(-1.0 / (RATE * lag))
    return np.concatenate([[0.0], 1.0 - left * np.exp(-np.arange(steps) / (RATE * lag))])


def test_body_roll_follows_a_rise_as_a_first_order_lag() -> None:
    # a_y linear between samples, so the discrete lag is the continuous one at the samples, to rounding.
    lag, a_y = 0.12, 3.0
    motion = motion_of(61, a_y=a_y)
    motion[0, MOTION.index("a_y")] = 0.0
    roll = LEAN * a_y * answer_to_a_rise(60, lag)
    y = measured(motion, body_roll_gradient=LEAN, body_roll_lag=lag)
    assert y[A_Y, 1:] == pytest.approx(a_y * np.cos(roll[1:]) + G * np.sin(roll[1:]), rel=1e-12)
    assert y[A_Y, 0] == 0.0


@pytest.mark.parametrize("period", [0.02, 0.2, 0.55, 1.0])
@pytest.mark.parametrize("lag", [0.0, 0.03, 0.3])
def test_body_roll_sways_as_a_mass_on_a_spring_and_a_damper(lag: float, period: float) -> None:
    # The linear system behind a_y that is linear between samples, by scipy's matrix exponential (lsim).
    rng, T, a_y = np.random.default_rng(0), period / (2.0 * math.pi), 3.0
    motion = motion_of(81, a_y=a_y)
    motion[1:, MOTION.index("a_y")] += rng.normal(0.0, 1.0, 80)
    system = ([1.0], [T**2, lag + 0.3 * T, 1.0])
    off = motion[:, MOTION.index("a_y")] - a_y
    _, swayed, _ = lsim(system, off, np.arange(81) / RATE)
    roll = LEAN * (a_y + swayed)
    y = measured(motion, body_roll_gradient=LEAN, body_roll_lag=lag, body_roll_period=period)
    expected = motion[:, MOTION.index("a_y")] * np.cos(roll) + G * np.sin(roll)
    np.testing.assert_allclose(y[A_Y], expected, rtol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_a_high_imu_feels_the_body_sway(lag: float) -> None:
    # A rigid body that turns about its centre of gravity, derivatives of its angles being those of a spline. What the
    # angles follow is linear between samples, off by dt^2 / 8 of its second derivative (0.8), and times 1 / T^2 that is
    # 2e-6 rad/s^2 in both of them.
    rate, period, x, y, z, r = 2000.0, 0.7, 0.3, -0.2, 0.5, 0.25
    t = np.arange(4001) / rate
    motion = motion_of(len(t), r=r)
    motion[:, MOTION.index("a_y")], motion[:, MOTION.index("a_x")] = 4.0 * np.sin(5.0 * t), 1.5 * np.sin(3.0 * t)
    swaying = {"lag": lag, "period": period}
    lean = {f"body_roll_{key}": value for key, value in swaying.items()} | {"body_roll_gradient": LEAN}
    dive = {f"body_pitch_{key}": value for key, value in swaying.items()} | {"body_pitch_gradient": 0.004}
    found = measured(motion, rate, **lean, **dive, imu_lever_arm_x=x, imu_lever_arm_y=y, imu_lever_arm_z=z)
    T = period / (2.0 * math.pi)
    system = ([1.0], [T**2, lag + 0.3 * T, 1.0])
    roll = CubicSpline(t, LEAN * lsim(system, motion[:, MOTION.index("a_y")], t)[1])
    pitch = CubicSpline(t, -0.004 * lsim(system, motion[:, MOTION.index("a_x")], t)[1])
    w = np.stack([roll(t, 1), pitch(t, 1), np.full(len(t), r)], axis=1)
    dw = np.stack([roll(t, 2), pitch(t, 2), np.zeros(len(t))], axis=1)
    arm = np.array([x, y, z])
    f = np.cross(dw, arm) + np.cross(w, np.cross(w, arm)) + [0.0, 0.0, G]
    f[:, :2] += motion[:, [MOTION.index("a_x"), MOTION.index("a_y")]]
    attitude = Rotation.from_euler("YX", np.stack([pitch(t), roll(t)], axis=1)).inv()
    inside = slice(20, -20)
    np.testing.assert_allclose(found[[A_X, A_Y, A_Z]].T[inside], attitude.apply(f)[inside], rtol=0.0, atol=4e-6)
    np.testing.assert_allclose(found[[P, Q, YAW]].T[inside], w[inside], rtol=0.0, atol=1e-6)


def test_body_roll_without_a_period_is_what_it_is_with_a_short_one() -> None:
    motion = motion_of(61, a_y=3.0)
    motion[0, MOTION.index("a_y")] = 0.0
    short, none = (measured(motion, body_roll_gradient=LEAN, body_roll_lag=0.1, body_roll_period=p) for p in (1e-6, 0))
    np.testing.assert_allclose(short, none, rtol=1e-6)


@pytest.mark.parametrize("period", [0.0, 1e-6, 0.5])
def test_differences_by_a_lag_about_its_null_reach_below_it_and_find_none(period: float) -> None:
    motion = motion_of(61, a_y=3.0)
    motion[0, MOTION.index("a_y")] = 0.0
    below, none = (
        measured(motion, body_roll_gradient=LEAN, body_roll_lag=lag, body_roll_period=period) for lag in (-1e-4, 0.0)
    )
    np.testing.assert_array_equal(below, none)


def test_body_roll_of_a_window_starts_settled() -> None:
    y = measured(motion_of(a_y=3.0), body_roll_gradient=LEAN, body_roll_lag=0.2)
    assert np.ptp(y[A_Y]) < 1e-12


@pytest.mark.parametrize("angle", [-0.1, 0.05])
def test_constant_speed_up_a_slope_reads_gravity(angle: float) -> None:
    y = finished(record_of(RIGID, road_grade_angle=angle), "speed", coasting(V, 1.0), (V, 0.0, 0.0))
    assert y[A_X] == pytest.approx(G * math.sin(angle), rel=4 * EPS)
    assert not y[[A_Y, YAW]].any()


def test_freely_sliding_down_a_slope_reads_nothing() -> None:
    # With next to no inertia in its wheels a rolling car falls freely along the slope: specific force zero. What is
    # left is the share of the wheels, I_w/(R^2 m) = 1.5e-8 each, after their slip has settled.
    car = record_of(RIGID, road_grade_angle=-0.1, I_wf=2e-6, I_wr=2e-6)
    y = finished(car, "wheel_speed", free_fall(), (V, 0.0, 0.0), substeps=1)
    assert np.diff(y[V_X]) * RATE == pytest.approx(G * math.sin(0.1), rel=1e-6)
    assert np.abs(y[A_X]).max() < 1e-6


def free_fall() -> np.ndarray:
    """Wheel speeds of a car that falls along a slope of -0.1 rad."""
    u = coasting(V, 1.0)
    u[:, 5] = u[:, 6] = (V + G * math.sin(0.1) * np.arange(len(u)) / RATE) / 0.344
    return u


def test_parked_across_a_slope_reads_gravity_sideways() -> None:
    # A car that the tyres hold against the bank has no lateral acceleration in the end but feels g sin(bank).
    y = measured(motion_of(), road_bank_angle=0.08)
    assert y[A_Y] == pytest.approx(G * math.sin(0.08), rel=4 * EPS)


def test_biases_are_added_to_their_own_channel() -> None:
    motion = motion_of(a_x=1.0, a_y=2.0, r=0.3)
    y = measured(motion, accelerometer_bias_x=0.25, accelerometer_bias_y=-0.5, gyro_bias_z=0.0078125)
    assert np.array_equal(y[[A_X, A_Y, YAW], 0], [1.25, 1.5, 0.3 + 0.0078125])
    assert np.array_equal(y[3:], measured(motion)[3:])


@pytest.mark.parametrize("group", range(len(GROUPS)))
def test_lagging_sensors_follow_a_rise_as_a_first_order_lag(group: int) -> None:
    # A signal linear between samples, to the rounding of fifty steps of numbers below T/dt = 16.
    T, signal, out = 0.08, np.ones(51), np.empty(51)
    signal[0] = 0.0
    report(record_of(RIGID, **{f"sensor_lag_{GROUPS[group]}": T})[0], signal, group, A_X, RATE, out)
    assert out == pytest.approx(answer_to_a_rise(50, T), rel=0.0, abs=50 * 16 * EPS)


@pytest.mark.parametrize("group", range(len(GROUPS)))
def test_delay_moves_its_group_and_no_other(group: int) -> None:
    signal, out = np.random.default_rng(31).normal(size=100), np.empty(100)
    p = record_of(RIGID, **{f"sensor_delay_{GROUPS[group]}": 7 / RATE})[0]
    for other in range(len(GROUPS)):
        report(p, signal, other, A_X, RATE, out)
        if other == group:
            # A delay of whole samples is a shift, to the rounding of 7/200 * 200; before it the first value holds.
            assert out[7:] == pytest.approx(signal[:-7], abs=1e-12)
            assert out[:7] == pytest.approx(np.full(7, signal[0]), abs=1e-12)
        else:
            assert np.array_equal(out, signal)


@pytest.mark.parametrize("row", range(len(MEASUREMENTS)))
def test_a_channel_s_own_delay_and_lag_add_to_its_group_s_and_move_no_other(row: int) -> None:
    signal, out, alone = np.ones(100), np.empty(100), np.empty(100)
    signal[0] = 0.0
    name = MEASUREMENTS[row]
    both = record_of(RIGID, sensor_lag_imu=0.05, sensor_delay_imu=3 / RATE)[0]
    own = {f"sensor_lag_{name}": 0.03, f"sensor_delay_{name}": 4 / RATE}
    p = record_of(RIGID, sensor_lag_imu=0.05, sensor_delay_imu=3 / RATE, **own)[0]
    summed = record_of(RIGID, sensor_lag_imu=0.08, sensor_delay_imu=7 / RATE)[0]
    for other in range(len(MEASUREMENTS)):  # what is lagged is written over
        report(p, signal.copy(), 0, other, RATE, out)
        report(summed if other == row else both, signal.copy(), 0, other, RATE, alone)
        assert out == pytest.approx(alone, rel=0.0, abs=1e-12)


@pytest.mark.parametrize("row", range(len(MEASUREMENTS)))
def test_lag_of_a_channel_answers_a_step_exponentially(row: int) -> None:
    # 1 - exp(-t/T) from the middle of the sample over which the step rises, to second order in its length over T.
    T, step, out = 0.08, np.ones(51), np.empty(51)
    step[0] = 0.0
    p = record_of(RIGID, **{f"sensor_lag_{MEASUREMENTS[row]}": T})[0]
    report(p, step.copy(), 1, row, RATE, out)
    t = (np.arange(1, 51) - 0.5) / RATE
    assert out[1:] == pytest.approx(1.0 - np.exp(-t / T), rel=0.0, abs=(1.0 / (RATE * T)) ** 2 / 8.0)
    report(p, step.copy(), 1, (row + 1) % len(MEASUREMENTS), RATE, out)
    assert np.array_equal(out, step)


def test_a_gain_scales_its_own_channel() -> None:
    motion = motion_of(a_x=1.0, a_y=2.0, r=0.3, v_x=20.0)
    gains = {"accelerometer_scale_z": A_Z, "gyro_scale_z": YAW, "speed_scale_gain": V_X}
    for field, row in gains.items():
        y, plain = measured(motion, **{field: 1.25}), measured(motion)
        plain[row] *= 1.25
        assert np.array_equal(y, plain)
    rolling = measured(motion_of(roll_rate=0.2, pitch_rate=-0.1), gyro_scale_x=1.5, gyro_scale_y=0.5, gyro_bias_x=0.25)
    assert np.array_equal(rolling[[P, Q], 0], [0.3 + 0.25, -0.05])


@given(st.floats(0.0, 0.2))
def test_any_delay_of_a_ramp_is_exact(delay: float) -> None:
    # A cubic reproduces a straight line, so a fraction of a sample counts too.
    t, out = np.arange(200) / RATE, np.empty(200)
    report(record_of(RIGID, sensor_delay_imu=delay)[0], t, 0, A_X, RATE, out)
    assert out == pytest.approx(np.maximum(t - delay, 0.0), abs=1e-13)


@pytest.mark.parametrize("group", range(len(GROUPS)))
def test_what_a_group_reported_leads_back_to_what_there_was(group: int) -> None:
    # A speed that rises and falls, through the closed form of a lag's steady answer to a sine. The derivative is a
    # central difference, (w h)^2 / 6 short of the true one, and so are slopes at samples, by which cubics between them
    # are up to 0.1 (w h)^3 / 6 of the amplitude off; at the end series go on as their reflection, which is off by the
    # curvature times the square of how far that is.
    w, lag, delay, h = 2.0, 0.1, 0.083, 1.0 / RATE
    t = np.arange(round(6.0 * RATE)) * h
    truth = 20.0 + 3.0 * np.sin(w * t)
    phase = w * (t - delay) - math.atan(w * lag)
    reported = 20.0 + 3.0 / math.hypot(1.0, w * lag) * np.sin(phase)
    p = record_of(RIGID, **{f"sensor_lag_{GROUPS[group]}": lag, f"sensor_delay_{GROUPS[group]}": delay})[0]
    found = truth.copy()
    unreported(p, reported, group, A_X, RATE, found)
    inside = t < t[-1] - delay - 2.0 * h  # the slope at the last sample is one-sided
    assert np.abs(found - truth)[inside].max() < 3.0 * (w * h) ** 2 * (0.1 * w * h + w * lag) / 6.0 * 1.1
    assert np.abs(found - truth).max() < 3.0 * w**2 * (delay + h) * (delay + h + 2.0 * lag)
    untouched = np.zeros(4)
    unreported(record_of(RIGID)[0], reported[:4], group, A_X, RATE, untouched)
    assert np.array_equal(untouched, np.zeros(4))
