"""Laws of the single-track model and its integrator: closed forms, a second implementation, symmetry, order.

Closed forms stand for tyres without relaxation (K infinite) and without vertical give (C_vert infinite).
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference_single_track as reference
from cars import MILD, PAPER, RATE, RIGID, STRONG, coasting, finished, paper_manoeuvre, record_of, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS, derive
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import DRIVES, STATES, derivatives, start
from vehicle_sbi.physics.simulation import NOT_FINITE, SPUN_OUT, fastest_rate, substeps_for
from vehicle_sbi.physics.vehicle import GENERIC_PRIORS

A_X, A_Y, R, OMEGA_F, OMEGA_R, V_X, V_Y = range(len(MEASUREMENTS))
EPS = np.finfo(float).eps
G, V = 9.81, 10.5
M, L, L_F, L_R, H, C_F, C_R = 1093.3, 2.5789, 1.1562, 1.4227, 0.57487, 100e3, 120e3
UNDERSTEER = M / L * (L_R / C_F - L_F / C_R)


def rate_of(records: np.ndarray, drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """d(state)/dt (9,) of the first record."""
    p, out = records[0], np.zeros(STATES)
    derive(p)
    derivatives(p, DRIVES[drive], u, state, out)
    return out


def rolling(v_x: float, radius: float = 0.344) -> np.ndarray:
    """The state of a car that rolls straight on."""
    return np.array([v_x, 0.0, 0.0, v_x / radius, v_x / radius, 0.0, 0.0, 0.0, 0.0])


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
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(7))[0]
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
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(7))[0]
    assert -a_x == pytest.approx(1.0489 * G, rel=1e-9)  # the load-transfer loop's 1e-9 m/s^2
    assert -a_x == pytest.approx(10.2897, abs=5e-5)


def test_braking_limit_with_the_rear_wheels_locked() -> None:
    state = rolling(V)
    state[4] = 0.0
    a_x = rate_of(record_of(RIGID), "wheel_speed", state, np.zeros(7))[0]
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
    u[:, 5:] = V / 0.344
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
    """The reference's motion (time, 8) in the order of MEASUREMENTS."""
    v_x, v_y, r, a_x, a_y, _, omega_f, omega_r = motion.T
    return np.array([a_x, a_y, r, omega_f, omega_r, v_x, v_y])


def smooth_inputs(seconds: float = 2.0) -> np.ndarray:
    """Everything a drive mode may ask for, smooth; wheel speeds that drive, then brake, near a slowly varying speed."""
    t = np.arange(round(seconds * RATE) + 1) / RATE
    u = np.zeros((len(t), 7))
    u[:, 0] = 0.05 * np.sin(math.pi * t)
    u[:, 1] = 400.0 * np.sin(2.0 * t) ** 2
    u[:, 2] = -300.0 * np.sin(1.5 * t) ** 2
    u[:, 3] = 10.5 + 0.8 * np.sin(1.2 * t)
    u[:, 4] = 0.96 * np.cos(1.2 * t)
    u[:, 5] = (10.5 + 0.5 * np.sin(1.2 * t)) / 0.305
    u[:, 6] = (10.5 + 0.5 * np.sin(1.2 * t)) / 0.3055
    return u


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
    assert (np.abs(fine - truth) / scale).max() < 1e-6


@pytest.mark.parametrize("car", [PAPER, replace(PAPER, K=math.inf)], ids=["relaxed", "direct"])
@pytest.mark.parametrize("drive", DRIVES)
def test_every_drive_mode_agrees_with_solve_ivp(drive: str, car: object) -> None:
    # Slopes are bounded by the fastest rate of 700/s: (rate * step)^4/5! with 16 substeps at 200 Hz is 2e-5 of a mode
    # that itself carries less than a hundredth of any channel on smooth inputs.
    u, initial = smooth_inputs(), np.array([10.5, 0.1, 0.02])
    records = record_of(car)  # pyright: ignore[reportArgumentType]
    c = reference.car_of(records[0])
    truth = as_measured(reference.integrate(c, drive, u, RATE, initial))
    y = finished(records, drive, u, initial, substeps=16)
    compared = slice(0, 3) if drive == "speed" else slice(0, 7)  # the reference holds no wheel speeds there
    scale = np.abs(truth).max(axis=1, keepdims=True)
    assert (np.abs(y - truth) / scale)[compared].max() < 2e-7


@pytest.mark.slow
def test_reference_does_not_depend_on_its_integrator() -> None:
    # An implicit method of another family; Radau's order 5 reaches rtol 1e-9 over a short, hard piece.
    u, initial = paper_manoeuvre(STRONG)[480:540], np.array([8.0, -0.1, 0.1])
    c = reference.car_of(record_of(PAPER)[0])
    explicit = reference.integrate(c, "torque", u, RATE, initial)
    implicit = reference.integrate(c, "torque", u, RATE, initial, rtol=1e-9, method="Radau")
    assert np.abs(explicit - implicit).max() < 1e-6


def random_drive(rng: np.random.Generator, relaxed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A car anywhere in the boxes of constants and effects, in a state inside the model's range, and its inputs."""

    def within(p: Parameter) -> float:
        return rng.uniform(p.low, p.high)

    fields = {field: within(p) for p in (*GENERIC_PRIORS.values(), *EFFECT_PARAMETERS.values()) for field in p.fields}
    records = record_of(PAPER, **fields)
    records["C_vert"] = rng.uniform(2e5, 4e5)
    records["K"] = rng.uniform(5e4, 5e5) if relaxed else math.inf
    v_x = rng.uniform(3.0, 40.0)
    radius = records["R_f"][0]
    wheel = v_x / radius * rng.uniform(0.8, 1.2, 2)
    slips, angles = rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.2, 0.2, 2)
    state = np.array([v_x, *rng.uniform(-0.5, 0.5, 2), *wheel, *slips, *angles])
    u = np.array([rng.uniform(-0.3, 0.3), *rng.uniform(-2000, 2000, 2), v_x, rng.uniform(-3, 3), *wheel])
    return records, state, u


@pytest.mark.parametrize("relaxed", [True, False])
@pytest.mark.parametrize("drive", DRIVES)
def test_right_hand_side_agrees_with_the_reference(drive: str, relaxed: bool) -> None:
    # The load-transfer loop may be off by 1e-9 m/s^2, a force by m * 1e-9 = 4e-6 N, which the lightest wheel (1 kg m^2,
    # lever 0.45 m) turns into 2e-6 rad/s^2; slips react to a load with C_kappa/(6 C_vert R) < 1 of that.
    rng = np.random.default_rng(20)
    for _ in range(200):
        records, state, u = random_drive(rng, relaxed)
        expected = reference.rates(reference.car_of(records[0]), drive, state, u)
        assert rate_of(records, drive, state, u) == pytest.approx(expected, rel=1e-9, abs=1e-5)


# --- integrator -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", DRIVES)
def test_convergence_is_of_fourth_order(drive: str) -> None:
    # Inputs are linear between samples and steps end on samples, so nothing is unsmooth inside a step. Errors far
    # enough from the asymptote's start and from the load-transfer loop's 1e-9 halve sixteenfold.
    rate = 20.0 if drive == "speed" else 50.0
    u = smooth_inputs(2.0)[:: round(RATE / rate)]
    initial = (10.5, 0.1, 0.02)
    truth = finished(record_of(PAPER), drive, u, initial, rate=rate, substeps=256)
    steps = np.array([4, 8, 16])
    states = [R, V_Y] if drive == "speed" else [OMEGA_F, V_X] if drive == "torque" else [V_X, V_Y]
    errors = [
        np.abs(finished(record_of(PAPER), drive, u, initial, rate=rate, substeps=int(n)) - truth)[states].max(axis=1)
        for n in steps
    ]
    assert np.min(errors) > 1e-12, "saturated"
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    assert ((slopes > 3.7) & (slopes < 4.3)).all(), slopes


def jacobian_of(records: np.ndarray, drive: str, v_x: float, columns: tuple[int, ...], step: float) -> np.ndarray:
    """d(rate)/d(state) about straight driving at v_x, by central differences."""
    p, state, u = records[0], np.zeros(STATES), np.zeros(7)
    derive(p)
    u[3] = v_x
    start(p, DRIVES["torque"], u, np.array([v_x, 0.0, 0.0]), state)
    slopes = []
    for column in columns:
        shifted = np.tile(state, (2, 1))
        shifted[0, column] += step
        shifted[1, column] -= step
        forward, backward = (rate_of(records, drive, x, u) for x in shifted)
        slopes.append((forward - backward)[list(columns)] / (2.0 * step))
    return np.array(slopes).T


FREE = {"torque": tuple(range(9)), "wheel_speed": (0, 1, 2, 5, 6, 7, 8), "speed": (1, 2, 5, 6, 7, 8)}


def fastest_eigenvalues(drive: str, relaxed: bool, C_vert: float) -> np.ndarray:
    """Fastest eigenvalue and what `fastest_rate` says [1/s], speed [m/s], for 200 cars of the prior box; (200, 3)."""
    rng, rows = np.random.default_rng(21), []
    for _ in range(200):
        records = record_of(PAPER, **{name: rng.uniform(p.low, p.high) for name, p in GENERIC_PRIORS.items()})
        records["K"] = rng.uniform(5e4, 6e5) if relaxed else math.inf
        records["C_vert"] = C_vert
        v_x = rng.uniform(1.1, 60.0)
        values = np.linalg.eigvals(jacobian_of(records, drive, v_x, FREE[drive], step=1e-6))
        rows.append((np.abs(values).max(), fastest_rate(records[0], drive, v_x), v_x))
    return np.array(rows)


@pytest.mark.parametrize("drive", DRIVES)
def test_fastest_rate_bounds_every_eigenvalue_of_rigid_tyres(drive: str) -> None:
    # Finite differences know an eigenvalue to 1e-6; the bound is not idle either, within a tenth of the truth.
    true, bound, _ = fastest_eigenvalues(drive, relaxed=False, C_vert=math.inf).T
    assert (true <= bound * (1.0 + 1e-6)).all()
    assert (true > 0.9 * bound).all()


@pytest.mark.parametrize("drive", DRIVES)
def test_steps_of_soft_and_relaxed_tyres_stay_stable(drive: str) -> None:
    # The law that counts: step times eigenvalue inside RK4's stability region, a half disc of radius 2.61 at least.
    for relaxed, C_vert in ((True, math.inf), (True, 2e5), (False, 2e5)):
        true, bound, _ = fastest_eigenvalues(drive, relaxed, C_vert).T
        assert (true / bound).max() < 2.61


def test_substeps_keep_the_fastest_record_below_the_limit() -> None:
    records = np.concatenate([record_of(PAPER), record_of(PAPER, I_wf=1.0), record_of(PAPER, K=math.inf)])
    n = substeps_for(records, "torque", 5.0, 100.0)
    fastest = max(fastest_rate(record, "torque", 5.0) for record in records)
    assert fastest / (100.0 * n) <= 1.0 < fastest / (100.0 * (n - 1))
    assert substeps_for(records[:1], "speed", 10.0, 200.0) == 1


# --- symmetry and invariance ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [MILD, STRONG], ids=["mild", "strong"])
@pytest.mark.parametrize("drive", DRIVES)
def test_mirrored_steering_gives_the_mirrored_drive_exactly(drive: str, size: tuple[float, float, float]) -> None:
    u = paper_manoeuvre(size, seconds=2.0)
    u[:, 3:] = smooth_inputs(2.0)[:400, 3:]
    mirrored = u * np.array([-1.0, 1, 1, 1, 1, 1, 1])
    left = finished(record_of(PAPER), drive, u, (10.5, 0.1, 0.05))
    right = finished(record_of(PAPER), drive, mirrored, (10.5, -0.1, -0.05))
    same, negated = [A_X, OMEGA_F, OMEGA_R, V_X], [A_Y, R, V_Y]
    assert np.array_equal(left[same], right[same])
    assert np.array_equal(left[negated], -right[negated])
    assert np.abs(left[A_Y]).max() > 1.0


@settings(max_examples=25)
@given(st.integers(1, 100))
def test_later_steering_gives_the_same_response_later(shift: int) -> None:
    u = coasting(V, 1.5)
    pulse = 0.05 * np.sin(np.linspace(0.0, 2.0 * math.pi, 200))
    u[1:201, 0] = pulse
    later = coasting(V, 1.5)
    later[1 + shift : 201 + shift, 0] = pulse
    y, y_later = (finished(record_of(RIGID), "torque", x, (V, 0.0, 0.0)) for x in (u, later))
    assert np.array_equal(y_later[:, shift:], y[:, :-shift])


def test_window_cut_out_of_a_drive_continues_it() -> None:
    # Without relaxation the lateral state is (v_y, r) alone: a window that starts from it goes the same way, bit for
    # bit, because the initial guess of the load transfer does not matter where v_x is given.
    u, car = smooth_inputs(), record_of(replace(PAPER, K=math.inf))
    whole = finished(car, "speed", u, (10.5, 0.1, 0.02))
    part = finished(car, "speed", u[150:], whole[[V_X, V_Y, R], 150])
    assert np.array_equal(part, whole[:, 150:])


def test_every_record_of_a_batch_is_simulated_as_if_alone() -> None:
    rng, n = np.random.default_rng(22), 9
    records = np.concatenate(
        [record_of(PAPER, m=m, l_f=l_f) for m, l_f in rng.uniform((1200, 1.0), (1800, 1.5), (n, 2))]
    )
    u = paper_manoeuvre(STRONG, seconds=1.0)
    stiffness, inputs = rng.normal(0.0, 3e3, (n, 1, 4)), rng.normal(0.0, 0.02, (n, len(u), 2))
    initial = np.column_stack([rng.uniform(10.0, 11.0, n), np.zeros((n, 2))])[:, np.newaxis]
    together, outcomes = simulate(records, "torque", u, initial, stiffness_noise=stiffness, input_noise=inputs)
    for i in range(n):
        one = slice(i, i + 1)
        alone, outcome = simulate(
            records[one], "torque", u, initial[one], stiffness_noise=stiffness[one], input_noise=inputs[one]
        )
        assert outcome[0] == outcomes[i]
        assert np.array_equal(alone[0], together[i])


def test_constant_stiffness_noise_is_another_stiffness() -> None:
    # One draw for the window, or the same draw at each sample, or another car: the same numbers.
    u, extra = paper_manoeuvre(STRONG, seconds=1.0), np.array([4e3, -2e3, 1e3, -3e3])
    names = ("C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r")
    other = record_of(PAPER, **{n: getattr(PAPER, n) + x for n, x in zip(names, extra, strict=True)})
    expected = finished(other, "torque", u, (V, 0.0, 0.0))
    once = finished(record_of(PAPER), "torque", u, (V, 0.0, 0.0), stiffness_noise=extra.reshape(1, 1, 4))
    always = np.broadcast_to(extra, (1, len(u), 4)).copy()
    assert np.array_equal(once, expected)
    assert np.array_equal(finished(record_of(PAPER), "torque", u, (V, 0, 0), stiffness_noise=always), expected)


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
    settling = d[5:] * 6e4 / 1.5e5 / state[0]
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
    R_f, R_r = (reference.effective_radius(c, F_z) for F_z in reference.axle_loads(c, 0.0))
    states = y[[V_X, V_Y, R]].T
    along = [reference.wheel_plane_speed(c, x, delta) for x, delta in zip(states, u[:, 0], strict=True)]
    assert y[OMEGA_F] == pytest.approx(np.array(along) / R_f, rel=16 * EPS)
    assert y[OMEGA_R] == pytest.approx(y[V_X] / R_r, rel=16 * EPS)


# --- where it ends --------------------------------------------------------------------------------------------------

everywhere = st.floats(-1e6, 1e6)


@given(st.tuples(*[everywhere] * STATES), st.tuples(*[everywhere] * 7), st.sampled_from(sorted(DRIVES)), st.booleans())
def test_finite_state_finite_rate(state: tuple[float, ...], u: tuple[float, ...], drive: str, relaxed: bool) -> None:
    # Lagged slips stay within what a slip can be, since they follow one: -1 and above.
    x = np.array(state)
    x[5:7] = np.maximum(x[5:7], -1.0)
    records = record_of(PAPER if relaxed else replace(PAPER, K=math.inf))
    assert np.isfinite(rate_of(records, drive, x, np.array(u))).all()


def test_car_that_comes_to_rest_under_its_brakes_stays_there() -> None:
    u = coasting(3.0, 4.0)
    u[:, 1], u[:, 2] = -600.0, -400.0
    y = finished(
        record_of(PAPER), "torque", u, (3.0, 0.0, 0.0), substeps=substeps_for(record_of(PAPER), "torque", 1.0, RATE)
    )
    assert np.isfinite(y).all()
    assert (np.diff(y[V_X]) < 1e-2).all()
    assert abs(y[V_X, -1]) < 0.05


def test_spin_out_is_counted_and_leaves_nan() -> None:
    u = coasting(20.0, 3.0)
    u[:, 0], u[:, 2] = 0.3, -4000.0
    y, outcomes = simulate(record_of(PAPER), "torque", u, (20.0, 0.0, 0.0))
    assert outcomes.tolist() == [SPUN_OUT]
    assert np.isnan(y).all()


def test_unknown_constant_is_not_finite_and_leaves_nan() -> None:
    y, outcomes = simulate(record_of(PAPER, m=math.nan), "torque", paper_manoeuvre(), (V, 0.0, 0.0))
    assert outcomes.tolist() == [NOT_FINITE]
    assert np.isnan(y).all()
