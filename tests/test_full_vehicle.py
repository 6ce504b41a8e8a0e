"""Laws of the four-wheel model: the single-track model inside it, balances of its bodies, closed forms, an oracle."""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference_full_vehicle as reference
from cars import (
    MILD,
    PAPER,
    RATE,
    coasting,
    disturb,
    finished,
    integrated,
    paper_manoeuvre,
    rate_of,
    record_of,
    smooth_inputs,
)
from hypothesis import given
from hypothesis import strategies as st
from reference_single_track import car_of

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.full_vehicle import PITCH, PITCH_RATE, ROLL, ROLL_RATE, STATES, WHEELS, loads
from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.sensors import MOTION, tilted
from vehicle_sbi.physics.single_track import DRIVES, INPUTS
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, Vehicle

EPS = np.finfo(float).eps
G, V = 9.81, 10.5
A_X, A_Y, YAW, OMEGA_F, OMEGA_R, V_X, V_Y, A_Z, P, Q = range(10)  # the rows of MEASUREMENTS
every_drive = pytest.mark.parametrize("drive", DRIVES)

# A body whose centre of gravity, 0.5 m up like the car's, sits above axles at R_f = 0.31 m.
M_S, K_ROLL, K_PITCH, H_ROLL, H_PITCH = 1350.0, 7e4, 1.1e5, 0.1, 0.15
H_S = (1500.0 * 0.5 - 150.0 * 0.31) / M_S
ROLL_LEVER, PITCH_LEVER = M_S * (H_S - H_ROLL), M_S * (H_S - H_PITCH)


def motion_of(car: Vehicle, drive: str, u: np.ndarray, initial: tuple[float, float, float]) -> dict[str, np.ndarray]:
    """MOTION by name, (time,) each."""
    motion = integrated(record_of(car), drive, u, initial, model="full_vehicle")
    return dict(zip(MOTION, motion.T, strict=True))


# --- the single-track model inside it -------------------------------------------------------------------------------


@every_drive
@pytest.mark.parametrize("K", [1.5e5, math.inf], ids=["relaxed", "direct"])
def test_without_track_and_sprung_mass_it_is_the_single_track_model(drive: str, K: float) -> None:
    # Same equations, same steps. Both load loops stop within 1e-9 m/s^2, which stays an error of 1e-9 m/s^2 in the
    # accelerations, times 2 s in speeds, times 2 s over a radius of 0.3 m in wheel speeds and what follows from it:
    # m 1e-9 N on a wheel of 3 kg m^2 at 0.3 m is 1.5e-7 rad/s^2 until its slip, within 3 ms, holds against it.
    slim = replace(PAPER, K=K, track_f=0.0, track_r=0.0, m_s=0.0)
    u, initial = smooth_inputs(), (10.5, 0.1, 0.02)
    u[:, :3] = np.concatenate([paper_manoeuvre(MILD, 2.0), paper_manoeuvre(MILD, 2.0)[-1:]])[:, :3]
    four, two = (finished(record_of(slim), drive, u, initial, model=m) for m in ("full_vehicle", "single_track"))
    assert np.abs(four - two).max() < 2e-8


def test_without_sprung_mass_it_is_the_single_track_model_whose_wheels_stand_apart() -> None:
    # Of a rigid car a turn moves m h a_y, each axle's share that of its weight: s = 2 h a_y/(g track) of its load.
    # Driven by its speed, where each wheel of an axle has half of the pull, and with slips that do not lag, which would
    # be a state of each wheel. Both loops stop within 1e-9 m/s^2, and so do speeds after 2 s, to within 2e-9 m/s.
    rigid = replace(PAPER, K=math.inf, track_f=1.5, track_r=1.5, m_s=0.0)
    apart = {"lateral_load_transfer_uneven": (2.0 * 0.5 / (G * 1.5)) ** 2, "lateral_load_transfer_track": 1.5}
    u, initial = smooth_inputs(), (10.5, 0.1, 0.02)
    u[:, 0] *= 4.0
    four = finished(record_of(rigid), "speed", u, initial, model="full_vehicle")
    light = replace(PAPER, K=math.inf, I_wf=1e-12, I_wr=1e-12)  # as with a given speed nothing turns the wheels
    two, one = (finished(record_of(light, **more), "speed", u, initial) for more in (apart, {}))
    np.testing.assert_allclose(two[[A_Y, YAW, V_Y]], four[[A_Y, YAW, V_Y]], rtol=0.0, atol=1e-8)
    assert np.abs(two[YAW] - one[YAW]).max() > 1e-3


# --- balances -------------------------------------------------------------------------------------------------------

thousand = st.floats(-3000.0, 3000.0)


def loads_at(p: np.void, pitching: float, springs: float, centres: float, press: tuple[float, float]) -> np.ndarray:
    return np.array(loads(p, pitching, springs, centres, *press))


@given(thousand, thousand, thousand, st.floats(0.0, 2000.0), st.floats(0.0, 2000.0))
def test_loads_carry_the_car_and_its_moments(
    pitching: float, springs: float, centres: float, press_f: float, press_r: float
) -> None:
    # m g and what the air presses; moments to the rear and to the right. A dozen roundings of 15 kN, 4e-12 each.
    p = record_of(PAPER)[0]
    derive(p)
    F_z = loads_at(p, pitching, springs, centres, (press_f, press_r))
    assert F_z.sum() == pytest.approx(1500.0 * G + press_f + press_r, abs=1e-10)
    assert 0.75 * (F_z[1] + F_z[3] - F_z[0] - F_z[2]) == pytest.approx(springs + centres, abs=1e-10)
    assert 1.4 * (F_z[2] + F_z[3] - press_r) - 1.3 * (F_z[0] + F_z[1] - press_f) == pytest.approx(pitching, abs=1e-10)


@given(st.floats(1.0, 50.0), st.sampled_from([-1.0, 1.0]))
def test_wheel_that_lifts_leaves_the_axle_s_load_to_the_other(times: float, side: float) -> None:
    p = record_of(PAPER)[0]
    derive(p)
    tipping = 1500.0 * G * 0.75  # all of the weight on the wheels of one side
    F_z = loads_at(p, 0.0, side * 2.0 * times * tipping, 0.0, (0.0, 0.0))
    assert (F_z[0 if side > 0 else 1], F_z[2 if side > 0 else 3]) == (0.0, 0.0)
    assert F_z.sum() == pytest.approx(1500.0 * G, rel=4 * EPS)


# --- steady states --------------------------------------------------------------------------------------------------


def test_steady_roll_angle() -> None:
    # Springs hold the centrifugal force and the weight of a body that leans: phi (K - m_s g h_s) = m_s h_s a_y. Roll
    # has settled after 8 s (damping 4/s: e^-32), the turn too.
    u = coasting(V, 8.0)
    u[:, 0] = 0.02
    motion = motion_of(PAPER, "speed", u, (V, 0.0, 0.0))
    a_y = motion["a_y"][-1]
    assert a_y > 0.5
    assert motion["roll"][-1] == pytest.approx(ROLL_LEVER * a_y / (K_ROLL - G * ROLL_LEVER), rel=1e-9)
    assert abs(motion["roll_rate"][-1]) < 1e-9


@pytest.mark.parametrize("a_x", [-3.0, 2.0])
def test_steady_pitch_angle(a_x: float) -> None:
    # Nose up under acceleration: theta (K - m_s g h_p) = -m_s h_p a_x; settled after 12 s (damping 2/s: e^-24).
    u = coasting(45.0, 12.0)
    u[:, 3], u[:, 4] = 45.0 + a_x * u[:, 7], a_x
    motion = motion_of(PAPER, "speed", u, (45.0, 0.0, 0.0))
    assert motion["pitch"][-1] == pytest.approx(-PITCH_LEVER * a_x / (K_PITCH - G * PITCH_LEVER), rel=1e-9)


def test_steady_turn_shifts_load_as_centre_of_gravity_and_lean_ask() -> None:
    # Moments about the ground: m h a_y from the accelerations, m_s g h_s phi because the body has moved outwards.
    p = record_of(PAPER)[0]
    derive(p)
    a_y = 3.0
    phi = ROLL_LEVER * a_y / (K_ROLL - G * ROLL_LEVER)
    F_z = loads_at(p, 0.0, K_ROLL * phi, (1500.0 * 0.5 - ROLL_LEVER) * a_y, (0.0, 0.0))
    to_the_right = 0.75 * (F_z[1] + F_z[3] - F_z[0] - F_z[2])
    assert to_the_right == pytest.approx(1500.0 * 0.5 * a_y + G * ROLL_LEVER * phi, rel=1e-12)


def test_free_roll_swings_at_its_natural_frequency() -> None:
    # No dampers, and tyres without side force: the body swings against the car, about the common centre of gravity,
    # omega^2 = (K - m_s g h_s)/(I_x + m_s h_s^2 - (m_s h_s)^2/m). RK4 takes phase steps of 0.014: (0.014)^4/120 = 3e-10
    # a radian over 22 of them; the load loop's 1e-9 m/s^2 is 1e-8 of a swing that starts at 0.1 m/s^2. 200 Hz, 2 s.
    J = 500.0 + M_S * (H_S - H_ROLL) ** 2 - ROLL_LEVER**2 / 1500.0
    omega = math.sqrt((K_ROLL - G * ROLL_LEVER) / J)
    car = replace(PAPER, D_roll=0.0, C_alpha_f=1e-6, C_alpha_r=1e-6, K=math.inf)
    u = coasting(V, 2.0)
    motion = motion_of(car, "speed", u, (V, 0.0, 0.01))
    first = motion["roll"][0]
    assert first == pytest.approx(ROLL_LEVER * V * 0.01 / (K_ROLL - G * ROLL_LEVER), rel=8 * EPS)
    assert np.abs(motion["roll"] / first - np.cos(omega * u[:, 7])).max() < 5e-8


# --- sensors on a body that moves -----------------------------------------------------------------------------------


def test_resting_imu_reads_gravity() -> None:
    y = finished(record_of(PAPER), "speed", coasting(V, 1.0), (V, 0.0, 0.0), model="full_vehicle")
    assert (y[A_Z] == G).all()
    assert not y[[A_X, A_Y, YAW, P, Q]].any()


def test_a_gyro_turns_with_the_body() -> None:
    # In a steady turn the body keeps its angles, and a strapdown gyro reads the turn's rate about its own axes.
    u = np.zeros((2000, len(INPUTS)))
    u[:, INPUTS.index("steering")], u[:, INPUTS.index("v_x")] = 0.03, 20.0
    motion = motion_of(PAPER, "speed", u, (20.0, 0.0, 0.0))
    y = finished(record_of(PAPER), "speed", u, (20.0, 0.0, 0.0), model="full_vehicle")[:, -1]
    roll, pitch, r = (motion[name][-1] for name in ("roll", "pitch", "r"))
    assert roll > 0.01
    expected = r * np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    settled = np.abs(motion["roll_rate"][-200:]).max() + np.abs(motion["pitch_rate"][-200:]).max()
    np.testing.assert_allclose(y[[P, Q, YAW]], expected, rtol=1e-9, atol=settled)


@pytest.mark.parametrize("C_vert", [2e5, np.inf])
def test_given_wheel_speeds_turn_the_car_as_its_torques_do(C_vert: float) -> None:
    # The mean speed of an axle's wheels, which an open differential drives alike, is all that is given. Under torques
    # both have the same force; here they have the same slip, which of tyres as stiff as these is the same but for what
    # inner and outer loads change.
    car, u = replace(PAPER, C_vert=C_vert), np.zeros((1000, len(INPUTS)))
    u[:, INPUTS.index("steering")] = np.minimum(0.03, 0.0003 * np.arange(1000))
    by_torque = finished(record_of(car), "torque", u, (V, 0.0, 0.0), model="full_vehicle")
    u[:, INPUTS.index("wheel_speed_front")], u[:, INPUTS.index("wheel_speed_rear")] = by_torque[[3, 4]]
    by_speed = finished(record_of(car), "wheel_speed", u, (V, 0.0, 0.0), model="full_vehicle")
    for row in (A_Y, YAW):
        assert np.abs(by_speed[row] - by_torque[row]).max() < 0.01 * np.abs(by_torque[row]).max()


def test_body_s_rates_are_measured_and_turn_the_imu() -> None:
    # Roll and pitch rates are the derivatives of the angles: the trapezoid rule is off by dt^3/12 of the rates' second
    # derivative, which a sample's change of the angular acceleration over dt gives but for its own change, twice it.
    u = paper_manoeuvre(MILD, 2.0)
    motion = motion_of(PAPER, "torque", u, (V, 0.0, 0.0))
    y = finished(record_of(PAPER), "torque", u, (V, 0.0, 0.0), model="full_vehicle")
    turning = [tilted(0.0, 0.0, *of) for of in zip(motion["r"], motion["roll"], motion["pitch"], strict=True)]
    for row, part, name in ((P, 0, "roll"), (Q, 1, "pitch")):
        assert np.array_equal(y[row], motion[f"{name}_rate"] + np.array(turning)[:, part])
        rate = motion[f"{name}_rate"]
        steps = 0.5 * (rate[1:] + rate[:-1]) / RATE
        second = np.abs(np.diff(motion[f"{name}_acceleration"])).max() * RATE
        assert np.abs(np.diff(motion[name]) - steps).max() < 2.0 * second / RATE**3 / 12.0
    lift = finished(record_of(PAPER, imu_lever_arm_z=0.5), "torque", u, (V, 0.0, 0.0), model="full_vehicle")
    assert np.abs(lift[A_Y] - y[A_Y]).max() > 0.01


# --- against the second implementation ------------------------------------------------------------------------------


def random_drive(rng: np.random.Generator, relaxed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A car anywhere in the boxes of constants and effects, in a state inside the model's range, and its inputs."""

    def within(p: Parameter) -> float:
        return rng.uniform(p.low, p.high)

    boxes = (*GENERIC_PRIORS.values(), *BODY_PRIORS.values(), *EFFECT_PARAMETERS.values())
    records = record_of(PAPER, **{field: within(p) for p in boxes for field in p.fields})
    records["m_s"] = np.minimum(records["m_s"], 0.9 * records["m"])
    records["C_vert"] = rng.uniform(2e5, 4e5)
    records["K"] = rng.uniform(5e4, 5e5) if relaxed else math.inf
    records["duration"], t = rng.uniform(3.0, 10.0), rng.uniform(0.0, 12.0)
    v_x = rng.uniform(5.0, 40.0)
    wheels = v_x / records["R_f"][0] * rng.uniform(0.8, 1.2, 4)
    body = rng.uniform(-1.0, 1.0, 4) * [0.05, 0.3, 0.05, 0.3]
    slips, angles = rng.uniform(-0.3, 0.3, 4), rng.uniform(-0.2, 0.2, 4)
    state = np.array([v_x, *rng.uniform(-0.5, 0.5, 2), *body, *wheels, *slips, *angles])
    given = [rng.uniform(-0.3, 0.3), *rng.uniform(-2000, 2000, 2), v_x, rng.uniform(-3, 3), *wheels[:2], t, 0.0]
    u = np.array(given)
    disturb(records, u, rng)
    return records, state, u


@pytest.mark.parametrize("relaxed", [True, False])
@every_drive
def test_right_hand_side_agrees_with_the_reference(drive: str, relaxed: bool) -> None:
    # The loops may be off by 1e-9 m/s^2, a force by m * 1e-9 = 4e-6 N, which the lightest wheel (half of 1 kg m^2,
    # lever 0.5 m) turns into 4e-6 rad/s^2; slips react to a load with C_kappa/(6 C_vert R) < 1 of that.
    rng = np.random.default_rng(24)
    for _ in range(100):
        records, state, u = random_drive(rng, relaxed)
        expected = reference.rates(car_of(records[0]), drive, state, u)
        assert rate_of(records, drive, state, u, model="full_vehicle") == pytest.approx(expected, rel=1e-9, abs=1e-5)


def test_states_are_in_the_order_that_the_reference_has() -> None:
    assert (ROLL, ROLL_RATE, PITCH, PITCH_RATE) == (3, 4, 5, 6)
    assert STATES == 7 + 3 * WHEELS
