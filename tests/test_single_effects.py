"""What single effects amount to: closed forms, or the same drive by another route."""

import math

import numpy as np
import pytest
from cars import PAPER, RATE, RIGID, V, coasting, derived, exciting, finished, integrated, rate_of, record_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from vehicle_sbi.physics.body_forces import downforce, gust, road_grade
from vehicle_sbi.physics.commands import steer, torques
from vehicle_sbi.physics.effects import KNOTS
from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.sensors import MOTION
from vehicle_sbi.physics.signals import EDGE, interpolate
from vehicle_sbi.physics.simulation import MODELS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.tyre_effects import side_force as beside_given
from vehicle_sbi.physics.tyre_effects import tyre_force

EPS = np.finfo(float).eps
G, RHO = 9.81, 1.225
M, L, L_F, L_R, H, C_F, C_R, MU = 1093.3, 2.5789, 1.1562, 1.4227, 0.57487, 100e3, 120e3, 1.0489  # RIGID
UNDERSTEER = M / L * (L_R / C_F - L_F / C_R)
A_X, A_Y, YAW, OMEGA_F, OMEGA_R, V_X, V_Y = range(7)  # of the rows of MEASUREMENTS


def rolling(*, wheels: float = V / 0.344) -> np.ndarray:
    """The state of a car that goes straight on."""
    return np.array([V, 0.0, 0.0, wheels, wheels, 0.0, 0.0, 0.0, 0.0])


def inputs(t: float = 0.0) -> np.ndarray:
    return np.array([t if name == "time" else 0.0 for name in INPUTS])


# --- command to wheels ----------------------------------------------------------------------------------------------


def test_delayed_steering_is_the_command_later() -> None:
    # 0.1 s are 20 samples to the rounding of 0.1 * 200.
    u, later = exciting(4.0), exciting(4.0)
    later[20:, 0], later[:20, 0] = u[:-20, 0], u[0, 0]
    delayed = finished(record_of(PAPER, steering_delay_time=0.1), "torque", u, (V, 0.0, 0.0))
    assert np.allclose(delayed, finished(record_of(PAPER), "torque", later, (V, 0.0, 0.0)), rtol=0.0, atol=1e-10)


def test_steering_ratio_and_offset_act_on_the_command_in_that_order() -> None:
    u, turned = exciting(4.0), exciting(4.0)
    turned[:, 0] = 1.25 * u[:, 0] + 0.01
    crooked = record_of(PAPER, steering_ratio_gain=1.25, steering_offset_angle=0.01)
    assert np.array_equal(
        finished(crooked, "torque", u, (V, 0, 0)), finished(record_of(PAPER), "torque", turned, (V, 0, 0))
    )


def steered(command: np.ndarray, **fields: float) -> np.ndarray:
    """What the wheels do on a command."""
    out = np.empty(len(command))
    steer(derived(**fields), command, RATE, out)
    return out


def test_lagging_steering_trails_a_ramp_by_its_lag() -> None:
    # A command linear between samples: t - T (1 - exp(-t/T)) for a ramp from rest, to the rounding of a hundred steps.
    T, t = 0.12, np.arange(101) / RATE
    expected = t - T * (1.0 - np.exp(-t / T))
    assert steered(t, steering_lag_time=T) == pytest.approx(expected, rel=0.0, abs=100 * EPS)


def test_lag_far_below_a_sample_takes_itself_times_the_slope_off() -> None:
    # exp(-5) of a lag a fifth of a sample is left of where it comes from, so the effect is linear in the lag.
    T, t = 0.2 / RATE, np.arange(10) / RATE
    behind = t - steered(t, steering_lag_time=T)
    assert behind[1:] == pytest.approx(T * np.ones(9), rel=math.exp(-5.0) + 1e-12)
    assert np.array_equal(steered(t, steering_lag_time=0.0), t)


def test_dead_band_is_play() -> None:
    # Up: half the width behind. Back: still until the command has crossed the whole width, then half of it ahead.
    width, up = 0.01, np.linspace(0.0, 0.05, 51)
    wheels = steered(np.concatenate([up, up[::-1]]), steering_dead_band_width=width)
    assert np.array_equal(wheels[:51], np.maximum(up - width / 2, 0.0))
    assert np.array_equal(wheels[51:], np.minimum(0.05 - width / 2, up[::-1] + width / 2))


@pytest.mark.parametrize(("effect", "value", "gradient"), [
    ("steering_compliance_coefficient", 2e-6, 2e-6 * M * L_R / L),
    ("roll_steer_coefficient", 0.002, -0.002),
])  # fmt: skip
def test_steering_that_gives_way_is_an_understeer_gradient(effect: str, value: float, gradient: float) -> None:
    # In a steady turn F_yf = m l_r/L a_y, so delta = command - c F_yf makes K + c m l_r/L of K; roll steer alike. Exact
    # for small angles, to delta^2.
    delta, u = 1e-4, coasting(V, 5.0)
    u[:, 0] = delta
    y = finished(record_of(RIGID, **{effect: value}), "speed", u, (V, 0.0, 0.0))
    assert y[YAW, -1] / delta == pytest.approx(V / (L + (UNDERSTEER + gradient) * V**2), rel=10 * delta**2)


def test_gains_scale_drive_and_brakes_by_themselves() -> None:
    u, scaled = exciting(4.0), exciting(4.0)
    scaled[:, 1:3] *= np.where(u[:, 1:3] > 0.0, 1.25, 0.75)
    y = finished(record_of(PAPER, drive_gain_gain=1.25, brake_gain_gain=0.75), "torque", u, (V, 0.0, 0.0))
    assert np.array_equal(y, finished(record_of(PAPER), "torque", scaled, (V, 0.0, 0.0)))


@given(st.floats(-3000.0, 1000.0), st.floats(-3000.0, 1000.0), st.floats(-0.3, 0.3))
def test_brake_balance_moves_braking_and_keeps_the_sum(front: float, rear: float, shift: float) -> None:
    T_f, T_r = torques(derived(brake_balance_shift=shift), np.array([front]), np.array([rear]), 0, RATE)
    braking = front <= 0.0 and rear <= 0.0
    assert T_f + T_r == pytest.approx(front + rear, rel=0.0, abs=4 * 6000.0 * EPS)
    moved = np.clip(shift * (front + rear), rear, -front) if braking else 0.0
    assert T_f - front == pytest.approx(moved, rel=0.0, abs=4 * 6000.0 * EPS)
    assert not braking or (T_f <= 4 * 6000.0 * EPS and T_r <= 4 * 6000.0 * EPS)  # a brake drives no wheel


def test_delayed_torque_is_the_command_later() -> None:
    # 0.1 s are 20 samples to the rounding of 0.1 * 200; the load loop ends within 1e-9 m/s^2 either way, over 4 s and a
    # wheel of 0.3 m.
    u, later = exciting(4.0), exciting(4.0)
    later[20:, 1:3], later[:20, 1:3] = u[:-20, 1:3], u[0, 1:3]
    delayed = finished(record_of(PAPER, drive_delay_time=0.1), "torque", u, (V, 0.0, 0.0))
    expected = finished(record_of(PAPER), "torque", later, (V, 0.0, 0.0))
    assert np.allclose(delayed, expected, rtol=0.0, atol=1e-9 * 4.0 / 0.3)


# --- forces on the body ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [-0.12, 0.08])
def test_slope_accelerates_a_rolling_car(angle: float) -> None:
    # -m g sin(grade) moves the body and two axles that turn; wheels lag by a slip of I_w a/(R^2 C) = 3e-4 of 5 %.
    mass = 1093.3 + 2 * 3.4 / 0.344**2
    y = finished(record_of(RIGID, road_grade_angle=angle), "torque", coasting(V, 1.0), (V, 0.0, 0.0))
    assert y[V_X, -1] - y[V_X, -2] == pytest.approx(-1093.3 * G * math.sin(angle) / mass / RATE, rel=1e-4)


@pytest.mark.parametrize("angle", [-0.15, 0.1])
def test_loads_on_a_slope_balance_the_moment_of_gravity(angle: float) -> None:
    # Parked, about the rear contact point: F_zf L = m g (l_r cos - h sin). About the front one likewise. What the
    # tyres hold the car with, m g sin, is the acceleration that an accelerometer measures: a_x + g_x.
    p = record_of(RIGID, road_grade_angle=angle)[0]
    derive(p)
    weight, l_r = 1093.3 * G, 2.5789 - 1.1562
    shift = p["load_transfer"] * road_grade(p, 0.0)
    F_zf, F_zr = p["F_zf_static"] - shift, p["F_zr_static"] + shift
    assert F_zf * 2.5789 == pytest.approx(weight * (l_r * math.cos(angle) - 0.57487 * math.sin(angle)))
    assert F_zr * 2.5789 == pytest.approx(weight * (1.1562 * math.cos(angle) + 0.57487 * math.sin(angle)))


def test_banked_road_is_held_by_steering_towards_its_high_side() -> None:
    # Straight on along the bank both axles carry m g sin(bank) by their share, F_f = m g sin l_r/L: alpha = F/C each,
    # so v_y = -V alpha_r and delta = alpha_f - alpha_r. Linear tyres; arctan and cos leave the squares of 0.01.
    bank, m, l_r = 0.01, 1093.3, 2.5789 - 1.1562
    alpha_f, alpha_r = m * G * bank * l_r / 2.5789 / 100e3, m * G * bank * 1.1562 / 2.5789 / 120e3
    u = coasting(V, 5.0)
    u[:, 0] = alpha_f - alpha_r
    y = finished(record_of(RIGID, road_bank_angle=bank), "speed", u, (V, 0.0, 0.0))
    assert abs(y[YAW, -1]) < 1e-4 * bank
    assert y[V_Y, -1] == pytest.approx(-V * alpha_r, rel=1e-3)
    assert y[A_Y, -1] == pytest.approx(G * bank, rel=1e-3)


def test_yaw_inertia_slows_the_yaw_and_nothing_else_at_the_first_sample() -> None:
    u = coasting(V, 0.1)
    u[:, 0] = 0.01
    cars = (record_of(RIGID, yaw_inertia_factor=factor) for factor in (1.0, 1.3))
    motion = np.array([integrated(car, "speed", u, (V, 0.0, 0.0)) for car in cars])
    r_dot = motion[:, 0, MOTION.index("r_dot")]
    assert r_dot[0] / r_dot[1] == pytest.approx(1.3, rel=8 * EPS)
    others = [i for i, name in enumerate(MOTION) if name != "r_dot"]
    assert np.array_equal(motion[0, 0, others], motion[1, 0, others])


@given(st.floats(0.0, 4.0), st.floats(0.2, 0.8), st.floats(0.0, 60.0))
def test_downforce_is_shared_by_the_axles(area: float, share: float, v_x: float) -> None:
    front, rear = downforce(derived(downforce_area=area, downforce_front_share=share), v_x)
    assert front + rear == pytest.approx(RHO / 2.0 * area * v_x**2, rel=4 * EPS)
    assert front == pytest.approx(share * (front + rear), rel=4 * EPS)


def test_downforce_adds_to_the_braking_limit() -> None:
    # All wheels locked: mu (m g + F_z)/m, as far as the load loop's 1e-9 m/s^2.
    a_x = rate_of(record_of(RIGID, downforce_area=3.0), "wheel_speed", rolling(wheels=0.0), inputs())[0]
    assert -a_x == pytest.approx(MU * (G + RHO / 2.0 * 3.0 * V**2 / M), rel=1e-9)


def test_payload_makes_another_car() -> None:
    # Both masses' balance about the front axle, their inertia about the common centre: to the rounding of 800 samples.
    load, x, u = 200.0, 0.5, exciting(4.0)
    mass, l_f = M + load, (M * L_F + load * (L_F - x)) / (M + load)
    I_z = M * L_F * L_R + M * (L_F - l_f) ** 2 + load * (x - (L_F - l_f)) ** 2
    other = record_of(RIGID, m=mass, l_f=l_f, I_z_stated=I_z)
    y = finished(record_of(RIGID, payload_mass=load, payload_x=x), "speed", u, (V, 0.0, 0.0))
    assert np.allclose(y, finished(other, "speed", u, (V, 0.0, 0.0)), rtol=0.0, atol=800 * 100 * EPS)


def test_wind_and_moment_push_and_turn() -> None:
    # A car that rolls straight on, in its first instant: Newton and Euler.
    p = {"crosswind_force": 800.0, "crosswind_arm": 0.4, "gust_force": -300.0, "gust_arm": -0.5, "gust_duration": 2.0}
    records = record_of(RIGID, **p, gust_start=1.0, yaw_moment_moment=250.0)
    rate = rate_of(records, "speed", rolling(), inputs(t=2.0))
    assert rate[1] == pytest.approx(500.0 / M, rel=8 * EPS)
    assert rate[2] == pytest.approx((800.0 * 0.4 + 300.0 * 0.5 + 250.0) / (M * L_F * L_R), rel=8 * EPS)


@pytest.mark.parametrize(("y", "a_x"), [(0.05, 3.0), (-0.05, -3.0)])
def test_a_centre_of_gravity_off_the_middle_turns_the_car_as_it_speeds_up(y: float, a_x: float) -> None:
    # Straight on, in the first instant, at a given dv/dt: all tyres pull with m a, y to the right of the centre.
    u = inputs()
    u[INPUTS.index("v_x_dot")] = a_x
    rate = rate_of(record_of(RIGID, lateral_cog_y=y), "speed", rolling(), u)
    assert rate[1] == 0.0
    assert rate[2] == pytest.approx(y * M * a_x / (M * L_F * L_R), rel=8 * EPS)


def test_gust_begins_and_ends_when_it_says() -> None:
    # Nothing before, all of it after an edge, nothing an edge after its end: its impulse is force times duration, by
    # the midpoint rule over smooth edges to (1e-4 s)^2 of their curvature.
    p = derived(gust_force=1000.0, gust_start=1.0, gust_duration=0.5)
    before, full, after = np.arange(0.0, 1.0, 0.05), np.arange(1.0 + EDGE, 1.5, 0.05), np.arange(1.5 + EDGE, 5.0, 0.05)
    assert [gust(p, t)[0] for t in before] == [0.0] * len(before)
    assert [gust(p, t)[0] for t in full + EPS] == [1000.0] * len(full)
    assert [gust(p, t)[0] for t in after + 2 * EPS] == [0.0] * len(after)
    middles = np.arange(0.5e-4, 2.0, 1e-4)
    assert sum(gust(p, t)[0] for t in middles) * 1e-4 == pytest.approx(500.0, rel=1e-6)


def following(u: np.ndarray, course: np.ndarray) -> np.ndarray:
    """The inputs with what a latent load follows."""
    u = u.copy()
    u[:, INPUTS.index("latent")] = course
    return u


@pytest.mark.parametrize("model", MODELS)
def test_latent_side_force_and_moment_that_last_are_a_crosswind(model: str) -> None:
    # An arm of 1/2 m multiplies without rounding: bit for bit the same drive.
    u = exciting(4.0)
    wind = record_of(PAPER, crosswind_force=900.0, crosswind_arm=0.5)
    load = record_of(PAPER, latent_y=900.0, latent_z=450.0)
    y = finished(load, "torque", following(u, np.ones(len(u))), (V, 0.0, 0.0), model=model)
    assert np.array_equal(y, finished(wind, "torque", u, (V, 0.0, 0.0), model=model))
    assert not np.array_equal(y, finished(record_of(PAPER), "torque", u, (V, 0.0, 0.0), model=model))


@pytest.mark.parametrize("model", MODELS)
def test_latent_load_that_follows_nothing_is_none(model: str) -> None:
    idle = record_of(PAPER, latent_x=-800.0, latent_y=500.0, latent_z=300.0, latent_steering=0.1, latent_sensor=1.0)
    y, plain = (finished(p, "torque", exciting(4.0), (V, 0.0, 0.0), model=model) for p in (idle, record_of(PAPER)))
    assert np.array_equal(y, plain)


def test_latent_force_along_accelerates_a_rolling_car_while_it_lasts() -> None:
    # F_x = -m g sin(angle) moves the body and two axles that turn; wheels lag by a slip of I_w a/(R^2 C) = 3e-4 of 5 %.
    # An accelerometer reads it, which on a real slope gravity hides. Inputs are linear between samples.
    angle, mass = 0.05, M + 2 * 3.4 / 0.344**2
    u = coasting(V, 2.0)
    t = np.arange(len(u)) / RATE
    course = ((t > 0.5) & (t < 1.5)).astype(float)
    y = finished(record_of(RIGID, latent_x=-M * G * math.sin(angle)), "torque", following(u, course), (V, 0.0, 0.0))
    assert not y[A_X, t < 0.5].any()
    during = (t > 0.5 + 2.0 * EDGE) & (t < 1.5)
    assert y[A_X, during] == pytest.approx(-M * G * math.sin(angle) / mass, rel=1e-4)
    assert np.abs(y[A_X, t > 1.5 + 2.0 * EDGE]).max() < 1e-4 * G * math.sin(angle)


def test_latent_steering_in_proportion_to_steering_is_its_ratio() -> None:
    # To the rounding of delta + 0.1 delta against 1.1 delta, which a stable car does not enlarge.
    u = exciting(4.0)
    y = finished(record_of(PAPER, latent_steering=0.1), "torque", following(u, u[:, 0]), (V, 0.0, 0.0))
    turned = u.copy()
    turned[:, 0] *= 1.1
    assert np.allclose(y, finished(record_of(PAPER), "torque", turned, (V, 0.0, 0.0)), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("row", [A_X, A_Y, YAW])
def test_latent_error_of_a_sensor_is_in_its_row_alone(row: int) -> None:
    u = exciting(4.0)
    course = np.sin(np.arange(len(u)) / 50.0)
    p = record_of(PAPER, latent_sensor=0.3, latent_row=float(row))
    plain = finished(record_of(PAPER), "torque", u, (V, 0.0, 0.0))
    expected = plain.copy()
    expected[row] += 0.3 * course
    assert np.array_equal(finished(p, "torque", following(u, course), (V, 0.0, 0.0)), expected)


def test_profile_of_equal_knots_is_a_constant_grade() -> None:
    # The same g sin(angle), bit for bit. The profile leaves the loads those of a level road, 1 - cos(angle) more, which
    # rigid tyres below their knee do not feel.
    knots = {f"road_grade_profile_angle_{i}": 0.05 for i in range(KNOTS)}
    u = coasting(V, 2.0)
    u[:, 0], u[:, 1] = 0.01, 200.0
    profiled, constant = record_of(RIGID, duration=2.0, **knots), record_of(RIGID, road_grade_angle=0.05)
    y, expected = (finished(x, "torque", u, (V, 0.0, 0.0)) for x in (profiled, constant))
    assert np.allclose(y, expected, rtol=0.0, atol=1e-9 * 2.0 / 0.344)  # the load loop's 1e-9 m/s^2 for 2 s


@given(st.lists(st.floats(-0.1, 0.1), min_size=KNOTS, max_size=KNOTS), st.floats(-1.0, KNOTS + 1.0))
def test_profile_is_linear_between_its_knots(angles: list[float], t: float) -> None:
    p = derived(
        duration=KNOTS - 1.0,
        road_grade_angle=0.02,
        **{f"road_grade_profile_angle_{i}": a for i, a in enumerate(angles)},
    )
    expected = G * math.sin(0.02 + np.interp(t, np.arange(KNOTS), angles))
    assert road_grade(p, t) == pytest.approx(expected, rel=0.0, abs=1e-14)


# --- tyres ----------------------------------------------------------------------------------------------------------


def test_friction_level_is_another_mu() -> None:
    slippery = finished(record_of(PAPER, friction_level_factor=0.5), "torque", exciting(4.0), (V, 0.0, 0.0))
    assert np.array_equal(slippery, finished(record_of(PAPER, mu=0.45), "torque", exciting(4.0), (V, 0.0, 0.0)))


@pytest.mark.parametrize(("t", "factor"), [(0.9, 1.0), (1.1, 0.5), (1.9, 0.5), (2.2, 1.0)])
def test_friction_step_is_another_mu_for_a_while(t: float, factor: float) -> None:
    # All wheels locked: mu g, to the load loop's 1e-9 m/s^2.
    step = {"friction_step_factor": 0.5, "friction_step_start": 1.0, "friction_step_duration": 1.0}
    a_x = rate_of(record_of(RIGID, **step), "wheel_speed", rolling(wheels=0.0), inputs(t + EPS))[0]
    assert -a_x == pytest.approx(factor * MU * G, rel=1e-9)


def side_force(p: np.void, tan_alpha: float, *, F_z: float = 6000.0, load: float = 1.0, a_y: float = 0.0) -> float:
    return tyre_force(p, 1e5, 8e4, 1.0, F_z, load, 0.0, tan_alpha, a_y)[1]


@pytest.mark.parametrize("peak", [0.3, 1.0])
def test_tyre_curve_keeps_its_slope(peak: float) -> None:
    # sin(C atan(z/C)) = z - (1/6 C^2 + 1/3) z^3/C^2...: below z^2 at z = 1e-5.
    z = 1e-5
    assert side_force(derived(tyre_curve_peak=peak), z * 6000.0 / 8e4) == pytest.approx(z * 6000.0, rel=z**2)


def test_tyre_curve_peaks_at_all_of_the_grip() -> None:
    # sin(3/2 atan(2/3 z)) is 1 where atan(2/3 z) = pi/3 and less on both sides. test_magic_formula.py has the 1e-11.
    p, top = derived(tyre_curve_peak=1.0), 1.5 * math.tan(math.pi / 3.0)
    forces = [side_force(p, z * 6000.0 / 8e4) for z in (0.9 * top, top, 1.1 * top, 100.0 * top)]
    assert forces[1] == pytest.approx(6000.0, rel=1e-11)
    assert forces[0] < forces[1] > forces[2] > forces[3]


def test_a_full_tyre_curve_bends_by_no_third_power_and_lies_above_dugoff_s() -> None:
    # sin(C atan(w - E (w - atan w))) with E = -(1 + C^2/2) is z - O(z^5) with z = C w; at a tenth of the grip 1e-5, the
    # next term's factor being below 1. Above the knee it is nearer the grip than 1 - 1/(4 z), and never beyond it.
    p = derived(tyre_curve_fullness=1.0)
    assert side_force(p, 0.1 * 6000.0 / 8e4) == pytest.approx(600.0, rel=0.1**4)
    for z in (0.7, 1.0, 1.5, 3.0):
        force = side_force(p, z * 6000.0 / 8e4)
        assert (1.0 - 0.25 / z) * 6000.0 < force <= 6000.0 * (1.0 + 8 * EPS)


@pytest.mark.parametrize("z", [0.01, 0.5, 2.0, 50.0])
def test_an_early_tyre_curve_is_a_hyperbola_that_nears_the_grip(z: float) -> None:
    # sin(atan z) = z / sqrt(1 + z^2): F^2 (1 + 1/z^2) = (mu F_z)^2.
    force = side_force(derived(tyre_curve_early=1.0), z * 6000.0 / 8e4)
    assert math.hypot(force, force / z) == pytest.approx(6000.0, rel=8 * EPS)


@pytest.mark.parametrize("weight", [0.0, 0.4, 1.0])
def test_driving_takes_a_weighed_share_of_the_side_force(weight: float) -> None:
    # Beyond the knee F_y/D_y = G/(2 S_y) (2 - G (1 + kappa)/(2 S_y)) with S_y = |(weight C_kappa kappa, D_y)|, whatever
    # the weight F_x, of S_x; without curve, at kappa = 0.05: C_kappa kappa = 5000 N, D_y = 4000 N, G = 6000 N.
    p, kappa, D_y, G_ = derived(combined_slip_weight=weight), 0.05, 4000.0, 6000.0
    F_x, F_y = tyre_force(p, 1e5, 8e4, 1.0, G_, 1.0, kappa, D_y / 8e4, 0.0)
    for force, demand, S in ((F_x, 5000.0, math.hypot(5e3, D_y)), (F_y, D_y, math.hypot(weight * 5e3, D_y))):
        assert force == pytest.approx(0.5 * G_ / S * (2.0 - 0.5 * G_ * (1.0 + kappa) / S) * demand, rel=8 * EPS)


@pytest.mark.parametrize("weight", [0.0, 0.4])
def test_a_given_longitudinal_force_takes_as_little_of_it(weight: float) -> None:
    # As from slips, whose factor 1 + kappa is 1 within 1e-7; the given force is that of a friction circle, no curve.
    p, stiff, kappa, tan_alpha = derived(combined_slip_weight=weight, tyre_curve_early=0.3), 1e11, 4e-8, 3000.0 / 8e4
    _, F_y = tyre_force(p, stiff, 8e4, 1.0, 6000.0, 1.0, kappa, tan_alpha, 0.0)
    F_x, _ = tyre_force(derived(), stiff, 8e4, 1.0, 6000.0, 1.0, kappa, tan_alpha, 0.0)
    assert beside_given(p, 8e4, 1.0, 6000.0, 1.0, F_x, tan_alpha, 0.0)[1] == pytest.approx(F_y, rel=1e-6)


def test_stiffness_follows_load_and_turning() -> None:
    # Below the knee the force is stiffness times slip, to the rounding of a few products.
    stiff = side_force(derived(load_sensitivity_coefficient=0.8), 1e-3, F_z=9000.0, load=1.5)
    assert stiff == pytest.approx(80.0 * (1.0 + 0.8 * 0.5), rel=8 * EPS)
    soft = side_force(derived(lateral_load_transfer_coefficient=0.01), 1e-3, a_y=5.0)
    assert soft == pytest.approx(80.0 * (1.0 - 0.01 * 25.0), rel=8 * EPS)


def test_relaxation_adds_to_the_relaxation_length() -> None:
    p = record_of(PAPER, relaxation_front=0.3, relaxation_rear=0.1)[0]
    derive(p)
    assert (p["sigma_f"], p["sigma_r"]) == (6e4 / 1.5e5 + 0.3, 6e4 / 1.5e5 + 0.1)


def test_larger_wheels_turn_slower() -> None:
    records = record_of(RIGID, wheel_radius_front=1.1, wheel_radius_rear=0.9)
    y = finished(records, "torque", coasting(V, 1.0), (V, 0.0, 0.0))
    assert y[[OMEGA_F, OMEGA_R], -1] == pytest.approx([V / (1.1 * 0.344), V / (0.9 * 0.344)], rel=1e-12)


# --- signals --------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=20), st.floats(-30.0, 30.0))
def test_interpolation_is_scipy_s_cubic_with_numpy_s_slopes_and_holds_its_ends(
    signal: list[float], position: float
) -> None:
    values, places = np.array(signal), np.arange(float(len(signal)))
    cubic = CubicHermiteSpline(places, values, np.gradient(values))
    expected = cubic(np.clip(position, 0.0, places[-1]))
    assert interpolate(values, position) == pytest.approx(expected, rel=1e-12, abs=1e-10)
    assert interpolate(values[:1], position) == values[0]


def test_a_dead_time_has_no_kink_at_a_whole_sample() -> None:
    # Slopes on both sides are those of the same cubic; they differ by its second derivative times the step.
    values, step = np.cos(0.4 * np.arange(40.0)), 1e-6
    for k in range(1, 39):
        sides = [(interpolate(values, k + s) - values[k]) / s for s in (-step, step)]
        assert abs(sides[1] - sides[0]) < 2.0 * step
