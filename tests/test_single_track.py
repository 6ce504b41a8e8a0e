"""Laws of the single-track model: closed forms, a second implementation, where it starts.

Closed forms stand for tyres without relaxation (K infinite) and without vertical give (C_vert infinite).
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference_single_track as reference
from cars import (
    MILD,
    PAPER,
    RATE,
    RIGID,
    STRONG,
    coasting,
    disturb,
    finished,
    jacobian_of,
    paper_manoeuvre,
    rate_of,
    record_of,
    simulate,
    smooth_inputs,
)
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS, SPRINGS_BEAR
from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.simulation import FINISHED, substeps_for
from vehicle_sbi.physics.single_track import ALPHA_FL, ALPHA_FR, DRIVES, INPUTS, STATES, start, states
from vehicle_sbi.physics.tyre import dugoff_side
from vehicle_sbi.physics.tyre_effects import lean_period, lean_share
from vehicle_sbi.physics.vehicle import GENERIC_PRIORS

A_X, A_Y, R, OMEGA_F, OMEGA_R, V_X, V_Y = range(7)  # of the rows of MEASUREMENTS
EPS = np.finfo(float).eps
G, V = 9.81, 10.5
M, L, L_F, L_R, H, C_F, C_R = 1093.3, 2.5789, 1.1562, 1.4227, 0.57487, 100e3, 120e3
UNDERSTEER = M / L * (L_R / C_F - L_F / C_R)


def rolling(v_x: float, radius: float = 0.344) -> np.ndarray:
    """The state of a car that rolls straight on."""
    state = np.zeros(STATES)
    state[[0, 3, 4]] = v_x, v_x / radius, v_x / radius
    return state


# --- closed forms ---------------------------------------------------------------------------------------------------


def test_load_transfer_per_acceleration() -> None:
    p = record_of(RIGID)[0]
    derive(p)
    assert p["load_transfer"] == pytest.approx(M * H / L, rel=4 * EPS)
    assert p["load_transfer"] == pytest.approx(243.711, abs=5e-4)


def test_braking_moves_load_from_the_rear_to_the_front() -> None:
    # Rear wheel locked at |a_x| = mu F_zr/m: the force that is missing from mu m g l_f/L is mu m h a_x/L.
    state = rolling(V)
    state[4] = 0.0
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(len(INPUTS)))[0]
    missing = 1.0489 * M * G * L_F / L + M * a_x
    # The load-transfer loop stops within 1e-9 m/s^2, so forces are known to m * 1e-9.
    assert missing == pytest.approx(1.0489 * 243.711 * -a_x, abs=1.0489 * 5e-4 * -a_x + 2e-9 * M)


def test_steady_cornering_understeer_and_yaw_gain() -> None:
    # r/delta = V/(L + K V^2) is the limit of small angles: the model's is exact to delta^2, 1e-8 here, and has settled
    # after 5 s (e^-97). K from two speeds: L/V and K V are of one size, so K loses less than a digit.
    delta, gains = 1e-4, []
    for v_x in (V, 2 * V):
        u = coasting(v_x, 5.0)
        u[:, 0] = delta
        gains.append(finished(record_of(RIGID), "speed", u, (v_x, 0.0, 0.0))[R, -1] / delta)
    assert gains[0] == pytest.approx(V / (L + UNDERSTEER * V**2), rel=10 * delta**2)
    assert gains[0] == pytest.approx(3.758689, abs=1e-6)
    K = (2 * V / gains[1] - V / gains[0]) / (3 * V**2)
    assert pytest.approx(UNDERSTEER, rel=1e-6) == K
    assert pytest.approx(0.00194673, abs=5e-9) == K


def test_steady_cornering_sideslip_gain() -> None:
    delta, u = 1e-4, coasting(V, 5.0)
    u[:, 0] = delta
    y = finished(record_of(RIGID), "speed", u, (V, 0.0, 0.0))
    gain = math.atan(y[V_Y, -1] / V) / delta
    assert gain == pytest.approx((L_R - L_F * M * V**2 / (C_R * L)) / (L + UNDERSTEER * V**2), rel=10 * delta**2)
    assert gain == pytest.approx(0.348078, abs=5e-7)


def test_yaw_mode_frequency_and_damping() -> None:
    # Eigenvalues of the lateral Jacobian by central differences; steps of 1e-5 leave 1e-10 of curvature and rounding.
    jacobian = jacobian_of(record_of(RIGID), "speed", V, (1, 2), step=1e-5)
    omega_n = math.sqrt(np.linalg.det(jacobian))
    zeta = -np.trace(jacobian) / (2.0 * omega_n)
    I_z = M * L_F * L_R
    assert omega_n**2 == pytest.approx((L / V) ** 2 * C_F * C_R * (1 + UNDERSTEER * V**2 / L) / (M * I_z), rel=1e-8)
    assert omega_n == pytest.approx(19.9702, abs=5e-5)
    assert zeta == pytest.approx(0.97912, abs=5e-6)


def test_free_response_shows_the_yaw_mode() -> None:
    # The integrated response to a small yaw rate against the matrix exponential of the closed form's own matrix.
    I_z, dt, kick = M * L_F * L_R, 1.0 / RATE, 1e-5
    coupling = (L_F * C_F - L_R * C_R) / V
    matrix = np.array(
        [[-(C_F + C_R) / (M * V), -coupling / M - V], [-coupling / I_z, -(L_F**2 * C_F + L_R**2 * C_R) / (I_z * V)]]
    )
    values, vectors = np.linalg.eig(matrix)
    y = finished(record_of(RIGID), "speed", coasting(V, 0.3), (V, 0.0, kick), substeps=16)
    t = dt * np.arange(y.shape[1])
    expected = (vectors @ (np.linalg.solve(vectors, [0.0, kick])[:, None] * np.exp(np.outer(values, t)))).real
    # RK4: (step * 20/s)^4/5! = 1e-11 a unit of the mode's time; nonlinearity kick^2 = 1e-10.
    assert np.abs(y[[V_Y, R]] - expected).max() < 1e-8 * np.abs(expected).max()


def test_braking_limit_with_all_wheels_locked_is_mu_g() -> None:
    state = rolling(V)
    state[3:5] = 0.0
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(len(INPUTS)))[0]
    assert -a_x == pytest.approx(1.0489 * G, rel=1e-9)  # the load-transfer loop's 1e-9 m/s^2
    assert -a_x == pytest.approx(10.2897, abs=5e-5)


def test_braking_limit_with_the_rear_wheels_locked() -> None:
    state = rolling(V)
    state[4] = 0.0
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(len(INPUTS)))[0]
    assert -a_x == pytest.approx(1.0489 * G * L_F / (L + 1.0489 * H), rel=1e-9)
    assert -a_x == pytest.approx(3.73897, abs=5e-6)


@pytest.mark.parametrize("axle", [1, 2])
def test_drive_step_on_one_axle_accelerates_car_and_wheels(axle: int) -> None:
    # a = T/(R (m + sum I_w/R^2)) for wheels that follow the car. They turn faster by the slip kappa of the driven axle
    # (R omega' = a/(1 - kappa)), the free one slower by its own: both below kappa = F/C, of I_w/R^2 each.
    T, u = 200.0, coasting(V, 1.0)
    u[:, axle] = T
    y = finished(record_of(RIGID), "torque", u, (V, 0.0, 0.0))
    inertia = 3.4 / 0.344**2
    a_x = T / (0.344 * (M + 2 * inertia))
    kappa = T / 0.344 / 107242.0
    assert y[A_X, -1] == pytest.approx(a_x, rel=2 * kappa * 2 * inertia / M)


def test_coast_down() -> None:
    # A + B v^2 against a mass that includes the wheels, whose 5 % of the momentum run ahead by the slip that
    # brakes them, I_w a/(R^2 C) < 4.6e-5: the body is slower by that share. Forgetting the wheels would cost 0.08 m/s.
    A, B, seconds = 150.0, 0.4, 10.0
    records = record_of(RIGID, rolling_resistance_coefficient=A / (M * G), aero_drag_area=2 * B / 1.225)
    v_x = finished(records, "torque", coasting(V, seconds), (V, 0.0, 0.0))[V_X, -1]
    mass = M + 2 * 3.4 / 0.344**2
    closed = math.sqrt(A / B) * math.tan(math.atan(V * math.sqrt(B / A)) - math.sqrt(A * B) * seconds / mass)
    assert closed == pytest.approx(8.87031, abs=5e-6)
    assert v_x == pytest.approx(closed, rel=4.6e-5 * (1.0 - M / mass))


@pytest.mark.parametrize("drive", DRIVES)
def test_free_rolling_keeps_its_speed_exactly(drive: str) -> None:
    u = coasting(V, 5.0)
    u[:, 5:7] = V / 0.344
    y = finished(record_of(RIGID), drive, u, (V, 0.0, 0.0))
    assert (y[V_X] == V).all()
    assert (y[OMEGA_F] == V / 0.344).all()
    assert (y[OMEGA_R] == V / 0.344).all()
    assert not y[[A_X, A_Y, R, V_Y]].any()


def test_relaxation_length_is_the_way_to_63_percent() -> None:
    # The car is made too heavy to move, so the side force shows the lagged slip alone: F = C (1 - e^(-x/sigma)).
    # The step in steering is a ramp over one sample, a delay of half a sample up to (dt/tau)^2/24 = 2e-7.
    sigma, rate, delta = 0.5, 10_000.0, 1e-4
    heavy = replace(RIGID, m=1e9, K=C_F / sigma)
    u = coasting(V, 0.1, rate)
    u[1:, 0] = delta
    y = finished(record_of(heavy), "speed", u, (V, 0.0, 0.0), rate=rate, substeps=1)
    share = y[A_Y] * 1e9 / (C_F * delta)
    t = np.arange(len(share)) / rate - 0.5 / rate
    # The car yields by C/(m V) t = 1e-6; cos and tan of delta leave 1e-8.
    assert np.abs(share[2:] - (1.0 - np.exp(-V * t[2:] / sigma))).max() < 2e-6
    reached = np.interp(1.0 - math.exp(-1.0), share, t)
    assert reached * V == pytest.approx(0.5, abs=1e-5)
    assert reached == pytest.approx(0.0476, abs=5e-5)


# --- against the second implementation ------------------------------------------------------------------------------


def as_measured(motion: np.ndarray) -> np.ndarray:
    """The reference's motion (time, 8) in the order of the first seven MEASUREMENTS."""
    v_x, v_y, r, a_x, a_y, _, omega_f, omega_r = motion.T
    return np.array([a_x, a_y, r, omega_f, omega_r, v_x, v_y])


def nats(y: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How much better than the truth a likelihood with the paper's noise can rate y at most, per channel [nats].

    Noise of 10 % of the measured accelerations and 5 % of wheel speeds and yaw rate, a floor at 1 % of each channel's
    root mean square.
    """
    share = np.array([0.1, 0.1, 0.05, 0.05, 0.05])[:, np.newaxis]
    floor = 0.01 * np.sqrt(np.mean(truth[:5] ** 2, axis=1, keepdims=True))
    return 0.5 * np.sum(((y[:5] - truth[:5]) / np.maximum(share * np.abs(truth[:5]), floor)) ** 2, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("size", [MILD, STRONG], ids=["mild", "strong"])
def test_paper_manoeuvre_agrees_with_solve_ivp(size: tuple[float, float, float]) -> None:
    # With the substeps that a study takes, the error is invisible to any inference from the paper's noise: below a
    # tenth of a nat in all channels together. With sixteen it is at the 1e-6 that RK4's order leaves of it (16^-4).
    u, initial = paper_manoeuvre(size), np.array([10.5, 0.0, 0.0])
    truth = as_measured(reference.integrate(reference.car_of(record_of(PAPER)[0]), "torque", u, RATE, initial))
    substeps = substeps_for(record_of(PAPER), "torque", truth[V_X].min(), RATE)
    assert nats(finished(record_of(PAPER), "torque", u, initial, substeps=substeps), truth).sum() < 0.1
    scale = np.abs(truth).max(axis=1, keepdims=True)
    fine = finished(record_of(PAPER), "torque", u, initial, substeps=16 * substeps)
    assert (np.abs(fine[:7] - truth) / scale).max() < 1e-6


@pytest.mark.parametrize("car", [PAPER, replace(PAPER, K=math.inf)], ids=["relaxed", "direct"])
@pytest.mark.parametrize("drive", DRIVES)
def test_every_drive_mode_agrees_with_solve_ivp(drive: str, car: object) -> None:
    # Slopes are bounded by the fastest rate of 700/s: (rate * step)^4/5! with 16 substeps at 200 Hz is 2e-5 of a mode
    # that itself carries less than a hundredth of any channel on smooth inputs.
    u, initial = smooth_inputs(0.5), np.array([10.5, 0.1, 0.02])
    records = record_of(car)  # pyright: ignore[reportArgumentType]
    c = reference.car_of(records[0])
    truth = as_measured(reference.integrate(c, drive, u, RATE, initial))
    y = finished(records, drive, u, initial, substeps=16)
    compared = slice(0, 3) if drive == "speed" else slice(0, 7)  # the reference holds no wheel speeds there
    scale = np.abs(truth).max(axis=1, keepdims=True)
    assert (np.abs(y[:7] - truth) / scale)[compared].max() < 2e-7


LEANING = {"lateral_load_transfer_uneven": 0.006, "lateral_load_transfer_period": 0.6}


PITCHING = {"load_sensitivity_coefficient": 0.8, "load_sensitivity_sprung": 0.9, "load_sensitivity_period": 0.6}


@pytest.mark.parametrize(
    ("late", "null"),
    [(LEANING, {"lateral_load_transfer_period": 0.0}), (PITCHING, {"load_sensitivity_sprung": 0.0})],
)
def test_a_body_that_moves_load_late_agrees_with_solve_ivp(late: dict[str, float], null: dict[str, float]) -> None:
    # As above; the steering is quick and large enough for the inner wheel to slide, so how load moves matters, by more
    # than a thousand times what the integrator leaves.
    u, initial = smooth_inputs(0.3), np.array([10.5, 0.1, 0.02])
    u[:, 0] *= 3.0
    records = record_of(PAPER, **late)
    truth = as_measured(reference.integrate(reference.car_of(records[0]), "speed", u, RATE, initial))
    y, at_once = (finished(one, "speed", u, initial, substeps=16) for one in (records, record_of(PAPER, **late | null)))
    scale = np.abs(truth[:3]).max(axis=1, keepdims=True)
    assert (np.abs(y[:3] - truth[:3]) / scale).max() < 2e-7
    assert (np.abs(at_once[:3] - y[:3]) / scale).max() > 2e-4


@pytest.mark.parametrize("drive", DRIVES)
def test_derivatives_by_short_steps_are_those_by_long_ones(drive: str) -> None:
    # Fits take differences over 3e-5 of a box; over 1e-3 of one rounding and the ends of loops are 30 times less. The
    # curvature over that step is left, which is of the order of 1e-3 of the slope.
    u, fields = smooth_inputs(1.5), LEANING | {"lateral_load_transfer_track": 1.5, "relaxation_front": 0.4}
    u[:, 0] *= 2.0
    moved = ("C_alpha_f", "mu", "lateral_load_transfer_uneven", "lateral_load_transfer_period", "relaxation_front")
    boxes = {field: p for p in (*GENERIC_PRIORS.values(), *EFFECT_PARAMETERS.values()) for field in p.fields}

    def response(field: str, step: float) -> np.ndarray:
        records = record_of(PAPER, **fields)
        records[field] += step
        return finished(records, drive, u, (10.5, 0.1, 0.02), substeps=4)[:3]

    for field in moved:
        width, rest = boxes[field].high - boxes[field].low, response(field, 0.0)
        short, long = ((response(field, share * width) - rest) / (share * width) for share in (3e-5, 1e-3))
        assert np.abs(short - long).max() < 0.01 * np.abs(long).max(), field


def test_in_a_steady_turn_it_does_not_matter_how_late_load_moves() -> None:
    # The slowest mode left, the body's, decays as exp(-0.3 w t), w = 2 pi / 0.6 s: by exp(-31) in 10 s.
    u = smooth_inputs(10.0)
    u[:, 0], u[:, 3], u[:, 4] = 0.12 * np.minimum(u[:, 7], 1.0), 10.5, 0.0
    late, at_once = (
        finished(record_of(PAPER, **LEANING | {"lateral_load_transfer_period": period}), "speed", u, (10.5, 0.0, 0.0))
        for period in (0.6, 0.0)
    )
    assert late[:3, -1] == pytest.approx(at_once[:3, -1], rel=1e-8)


def test_under_a_steady_thrust_it_does_not_matter_how_late_load_moves() -> None:
    # As above, exp(-31); the car turns at a constant 2 m/s^2 along it, whose load an axle's stiffness grows with.
    u = smooth_inputs(10.0)
    u[:, 0], u[:, 3], u[:, 4] = 0.02, 10.5 + 2.0 * u[:, 7], 2.0
    late, at_once = (
        finished(record_of(PAPER, **PITCHING | {"load_sensitivity_sprung": sprung}), "speed", u, (10.5, 0.0, 0.0))
        for sprung in (0.9, 0.0)
    )
    assert late[:3, -1] == pytest.approx(at_once[:3, -1], rel=1e-4)


def test_a_period_too_short_for_the_integrator_answers_as_itself_to_second_order() -> None:
    records = record_of(PAPER, **LEANING)
    p, before = records[0], 0.0
    p["step"] = 0.005
    for period in (1e-4, 1e-3, 0.01, 0.02 - 1e-9, 0.02, 0.1):
        p["lateral_load_transfer_period"] = period
        answer = lean_share(p) * lean_period(p) ** 2
        assert answer == pytest.approx(SPRINGS_BEAR * (period / (2.0 * math.pi)) ** 2, rel=1e-12)
        assert lean_share(p) >= before
        before = lean_share(p)


@pytest.mark.slow
def test_reference_does_not_depend_on_its_integrator() -> None:
    # An implicit method of another family; Radau's order 5 reaches rtol 1e-9 over a short, hard piece.
    u, initial = paper_manoeuvre(STRONG)[480:540], np.array([8.0, -0.1, 0.1])
    c = reference.car_of(record_of(PAPER)[0])
    explicit = reference.integrate(c, "torque", u, RATE, initial)
    implicit = reference.integrate(c, "torque", u, RATE, initial, rtol=1e-9, method="Radau")
    assert np.abs(explicit - implicit).max() < 1e-6


def random_drive(rng: np.random.Generator, relaxed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A car anywhere in the boxes of constants and effects, in a state inside the model's range, and its inputs.

    Half of them slip so little that tyres grip; each of the effects by which a load would still change their forces,
    and steering compliance, whose own loop hides that of the loads, is there in half of them. Where an axle has two
    wheels, they slip little along: beyond their peaks they could share a torque in several ways.
    """

    def within(p: Parameter) -> float:
        return rng.uniform(p.low, p.high)

    fields = {field: within(p) for p in (*GENERIC_PRIORS.values(), *EFFECT_PARAMETERS.values()) for field in p.fields}
    records = record_of(PAPER, **fields)
    switched = ("load_sensitivity_coefficient", "tyre_curve_peak", "steering_compliance_coefficient")
    for field in switched:
        records[field] *= rng.integers(2)
    two = bool(rng.integers(2))
    for field in ("lateral_load_transfer_uneven", "lateral_load_transfer_track"):
        records[field] *= two
    records["C_vert"] = rng.uniform(2e5, 4e5)
    records["K"] = rng.uniform(5e4, 5e5) if relaxed else math.inf
    v_x = rng.uniform(3.0, 40.0)
    radius = records["R_f"][0]
    much = rng.choice([1.0, 0.03])
    most = 0.02 if two else 0.3
    wheel = v_x / radius * (1.0 + 0.7 * most * rng.uniform(-1.0, 1.0, 2))
    slips, angles = much * most * rng.uniform(-1.0, 1.0, 2), much * rng.uniform(-0.2, 0.2, 4)
    if not records["lateral_load_transfer_track"][0]:
        angles = np.tile(angles[:2], 2)  # both wheels of an axle have the same
    records["lateral_load_transfer_period"] += 0.1  # as it is for a step of 5 ms
    lean = rng.uniform(-8.0, 8.0, 4)
    state = np.array([v_x, *rng.uniform(-0.5, 0.5, 2), *wheel, *slips, *angles, *lean])
    records["duration"], t = rng.uniform(3.0, 10.0), rng.uniform(0.0, 12.0)
    u = np.array([rng.uniform(-0.3, 0.3), *rng.uniform(-2000, 2000, 2), v_x, rng.uniform(-3, 3), *wheel, t, 0.0])
    disturb(records, u, rng)
    return records, state, u


@pytest.mark.parametrize("relaxed", [True, False])
@pytest.mark.parametrize("drive", DRIVES)
def test_right_hand_side_agrees_with_the_reference(drive: str, relaxed: bool) -> None:
    # The load-transfer loop may be off by 1e-9 m/s^2, a force by m * 1e-9 = 4e-6 N, which the lightest wheel (1 kg m^2,
    # lever 0.45 m) turns into 2e-6 rad/s^2; slips react to a load with C_kappa/(6 C_vert R) < 1 of that.
    rng = np.random.default_rng(20)
    for _ in range(100):
        records, state, u = random_drive(rng, relaxed)
        expected = reference.rates(reference.car_of(records[0]), drive, state, u)
        changing = slice(states(records[0]))
        assert rate_of(records, drive, state, u)[changing] == pytest.approx(expected[changing], rel=1e-9, abs=1e-5)


# --- where it starts ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", DRIVES)
def test_start_is_settled(drive: str) -> None:
    # Lagged slips equal the slips at static load, so in the first instant they do not move but for the load that the
    # first forces shift: the radius follows with m h a_x/(6 L C_vert), the slip with that over a radius above 0.3 m.
    u, state = smooth_inputs()[0], np.zeros(STATES)
    u[0], u[1:3] = 0.15, 0.0
    records = record_of(PAPER)
    derive(records[0])
    start(records[0], DRIVES[drive], u, np.array([10.5, 0.1, 0.02]), state)
    d = rate_of(records, drive, state, u)
    settling = d[5:11] * 6e4 / 1.5e5 / state[0]
    a_x = abs(d[0] - state[1] * state[2])
    assert np.abs(settling[2:]).max() < 4 * EPS
    assert np.abs(settling[:2]).max() <= 1500.0 * 0.5 * a_x / (6.0 * 2.7 * 2e5) / 0.3 + 4 * EPS
    if drive != "wheel_speed":
        assert not state[5:7].any()


def test_free_wheels_roll_in_their_own_plane() -> None:
    # What the drive mode that does not solve for wheel speeds reports: the contact speed along the wheel over the
    # effective radius at the static load; the same double-precision products in another order.
    u, c = smooth_inputs(), reference.car_of(record_of(PAPER)[0])
    y = finished(record_of(PAPER), "speed", u, (10.5, 0.1, 0.02))
    F_zf, F_zr = reference.axle_loads(c, reference.at(c, 0.0), 0.0, np.zeros(STATES))
    R_f, R_r = reference.effective_radius(c, F_zf, "front"), reference.effective_radius(c, F_zr, "rear")
    states = y[[V_X, V_Y, R]].T
    along = [reference.wheel_plane_speed(c, x, delta) for x, delta in zip(states, u[:, 0], strict=True)]
    assert y[OMEGA_F] == pytest.approx(np.array(along) / R_f, rel=16 * EPS)
    assert y[OMEGA_R] == pytest.approx(y[V_X] / R_r, rel=16 * EPS)


NO_CARCASS = replace(PAPER, K=math.inf, C_vert=math.inf)  # a file that states neither, as real ones do


def side_slip_force(length: float, v: float, substeps: int, seconds: float = 1.0) -> np.ndarray:
    """Yaw rate [rad/s] after a sudden small steering angle at speed v, of a car whose tyres relax over a length."""
    u = coasting(v, seconds, rate=100.0)
    u[1:, 0] = 1e-3
    records = record_of(NO_CARCASS, relaxation_front=length, relaxation_rear=length)
    y, outcomes = simulate(records, "speed", u, (v, 0.0, 0.0), rate=100.0, substeps=substeps)
    assert outcomes.tolist() == [FINISHED]
    return y[0, MEASUREMENTS.index("yaw_rate")]


def test_relaxation_acts_with_a_vehicle_file_that_has_no_carcass_stiffness() -> None:
    # The front force is 63.2 % of its own after half a metre has been rolled (the rear has none yet): r' = l_f F / I_z.
    p, v = record_of(NO_CARCASS, relaxation_front=0.5, relaxation_rear=0.5), 10.0
    derive(p[0])
    state, u = np.zeros(STATES), np.zeros(len(INPUTS))
    state[0], u[3], u[0] = v, v, 1e-3
    lagging = rate_of(p, "speed", state, u)
    assert lagging[ALPHA_FR] == pytest.approx(v / 0.5 * 1e-3)  # d(alpha^)/dt = v/sigma (alpha - alpha^)
    state[[ALPHA_FR, ALPHA_FL]] = (1.0 - math.exp(-1.0)) * 1e-3
    reached = rate_of(p, "speed", state, u)[2]
    state[[ALPHA_FR, ALPHA_FL]] = 1e-3
    assert reached / rate_of(p, "speed", state, u)[2] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-5)


def test_relaxation_sets_in_continuously_and_in_proportion() -> None:
    # Lengths below and above the least one that lags as it is, 0.5 v h = 12.5 mm: the change is linear to first order.
    none = side_slip_force(0.0, 10.0, 4)
    small, twice = (side_slip_force(length, 10.0, 4) - none for length in (2e-4, 4e-4))
    np.testing.assert_allclose(twice, 2.0 * small, atol=0.03 * np.abs(twice).max())
    below, above = (side_slip_force(0.0125 * factor, 10.0, 4) for factor in (1.0 - 1e-6, 1.0 + 1e-6))
    np.testing.assert_allclose(below, above, atol=1e-5 * np.abs(above).max())


@pytest.mark.parametrize("v", [1.5, 10.0, 60.0])
@pytest.mark.parametrize("length", [1e-3, 1e-2, 0.1, 1.0])
def test_relaxation_of_any_length_is_stable_in_steps_that_suit_the_car_without(v: float, length: float) -> None:
    # As many steps as the car without relaxation takes: it settles where that one does.
    records = record_of(NO_CARCASS)
    substeps = substeps_for(records, "speed", v, 100.0)
    with_it, without = (side_slip_force(one, v, substeps, seconds=8.0) for one in (length, 0.0))
    assert np.abs(with_it).max() < 3.0 * np.abs(without).max()
    assert with_it[-1] == pytest.approx(without[-1], rel=0.01)


# --- the longitudinal force that a given speed implies --------------------------------------------------------------


def test_the_speed_implies_a_longitudinal_force_that_takes_its_part_of_the_grip() -> None:
    """Braking takes side force from the axle that brakes, by Dugoff's law, and none below half the grip."""
    grip, demand = 4000.0, 2500.0
    free, S = dugoff_side(0.0, demand, grip)
    assert (free, S) == (pytest.approx(grip - grip**2 / (4.0 * demand)), pytest.approx(demand))
    for F_x in (500.0, 1500.0, 3000.0, -3000.0):
        F_y, S = dugoff_side(F_x, demand, grip)
        assert math.hypot(F_x, F_y) == pytest.approx(grip - grip**2 / (4.0 * S), rel=1e-9)  # on Dugoff's curve
        assert F_y / demand == pytest.approx(math.hypot(F_x, F_y) / S, rel=1e-9)  # along the demand
        assert 0.0 < F_y < free
    assert dugoff_side(1000.0, 1000.0, grip)[0] == 1000.0


@given(st.floats(-0.99, 0.99), st.floats(-1e6, 1e6), st.floats(1e-3, 1e5))
def test_a_given_longitudinal_force_leaves_a_finite_side_force_within_the_grip(x: float, D: float, grip: float) -> None:
    F_y, S = dugoff_side(x * grip, D, grip)
    assert math.isfinite(F_y)
    assert math.isfinite(S)
    assert math.hypot(x * grip, F_y) <= grip * (1.0 + 1e-9)
    assert F_y * D >= 0.0


@pytest.mark.parametrize("torques", [(600.0, 0.0), (-700.0, -500.0)])
def test_a_drive_by_torque_is_followed_by_its_speed_alone(torques: tuple[float, float]) -> None:
    # Stiff tyres, so that slips stay below 2 %; drive and brake shares as the torques have them. Dugoff's (1 + kappa)
    # and the wheels' inertia, which the speed knows nothing of, are what differs: of the order of the slip.
    car = replace(PAPER, K=math.inf, C_vert=math.inf, C_kappa_f=4e5, C_kappa_r=4e5, mu=0.7, I_wf=0.5, I_wr=0.5)
    share = torques[0] / sum(torques)
    records = record_of(replace(car, drive_front=share, brake_front=share))
    u = coasting(18.0, 2.0)
    u[:, 0] = 0.05 * np.sin(math.pi * u[:, 7])
    u[:, 1], u[:, 2] = torques
    y, _ = simulate(records, "torque", u, (18.0, 0.0, 0.0), substeps=40)
    names = [MEASUREMENTS.index(name) for name in ("v_x", "yaw_rate", "a_y")]
    v_x, yaw_rate, a_y = y[0, names]
    driven = u.copy()
    driven[:, 3], driven[:, 4] = v_x, np.gradient(v_x, 1.0 / RATE, edge_order=2)
    followed, _ = simulate(records, "speed", driven, (18.0, 0.0, 0.0), substeps=8)
    for of, channel in ((yaw_rate, names[1]), (a_y, names[2])):
        np.testing.assert_allclose(followed[0, channel], of, atol=0.02 * np.abs(of).max())
