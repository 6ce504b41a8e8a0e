"""Laws of a simulation, whatever its model: the integrator's order and steps, symmetry, batches, where it ends."""

import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from cars import (
    MILD,
    PAPER,
    RATE,
    RIGID,
    STRONG,
    coasting,
    finished,
    jacobian_of,
    paper_manoeuvre,
    rate_of,
    record_of,
    simulate,
    smooth_inputs,
)
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_sbi.physics import full_vehicle, single_track
from vehicle_sbi.physics.balance import LOAD_TOLERANCE
from vehicle_sbi.physics.record import derive
from vehicle_sbi.physics.simulation import (
    MODELS,
    NOT_FINITE,
    ROLLING,
    SPUN_OUT,
    actuate,
    fastest_rate,
    substeps_for,
)
from vehicle_sbi.physics.single_track import DRIVES, INPUTS
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, Vehicle

A_X, A_Y, R, OMEGA_F, OMEGA_R, V_X, V_Y, A_Z, ROLL_RATE, PITCH_RATE = range(10)  # the rows of MEASUREMENTS
V = 10.5

RIGID_BODY = replace(PAPER, C_vert=math.inf, R_f=0.344)  # 10.5 / 0.344 * 0.344 is 10.5: it rolls without rounding

every_drive = pytest.mark.parametrize("drive", DRIVES)
every_model = pytest.mark.parametrize("model", MODELS)
rolling_as_recorded = pytest.mark.parametrize("drive", [drive for drive in DRIVES if drive != "torque"])


# --- integrator -----------------------------------------------------------------------------------------------------


@every_drive
@every_model
def test_convergence_is_of_fourth_order(drive: str, model: str) -> None:
    # Inputs are linear between samples and steps end on samples, so nothing is unsmooth inside a step. Errors far
    # enough from the asymptote's start and from the load-transfer loop's 1e-9 halve sixteenfold.
    rate = 20.0 if drive == "speed" else 50.0
    u = smooth_inputs(2.0)[:: round(RATE / rate)]
    initial = (10.5, 0.1, 0.02)
    truth = finished(record_of(PAPER), drive, u, initial, model=model, rate=rate, substeps=256)
    steps = (4, 8, 16)
    states = [R, V_Y] if drive == "speed" else [OMEGA_F, V_X] if drive == "torque" else [V_X, V_Y]
    states += [ROLL_RATE] if model == "full_vehicle" else []
    errors = [
        np.abs(finished(record_of(PAPER), drive, u, initial, model=model, rate=rate, substeps=n) - truth)[states]
        for n in steps
    ]
    largest = np.max(errors, axis=2)
    assert largest.min() > 1e-12, "saturated"
    slopes = np.log2(largest[:-1] / largest[1:])
    assert ((slopes > 3.7) & (slopes < 4.3)).all(), slopes


FREE = {
    ("single_track", "torque"): tuple(range(9)),
    ("single_track", "wheel_speed"): (0, 1, 2, 5, 6, 7, 8),
    ("single_track", "speed"): (1, 2, 5, 6, 7, 8),
    ("full_vehicle", "torque"): tuple(range(19)),
    ("full_vehicle", "wheel_speed"): (*range(7), *range(11, 19)),
    ("full_vehicle", "speed"): (*range(1, 7), *range(11, 19)),
}


def car_anywhere(rng: np.random.Generator, model: str) -> np.ndarray:
    """A car of the prior box, no more than all of it sprung."""
    boxes = (*GENERIC_PRIORS.values(), *(BODY_PRIORS.values() if model == "full_vehicle" else ()))
    return record_of(PAPER, **{p.name: rng.uniform(p.low, p.high) for p in boxes})


TYRES = ((False, math.inf), (True, math.inf), (True, 2e5), (False, 2e5))  # whether slips lag, stiffness [N/m]


def tyres_anywhere(rng: np.random.Generator, model: str, relaxed: bool, C_vert: float) -> np.ndarray:
    """A car of the prior box, on tyres of such a kind, with any load."""
    records = car_anywhere(rng, model)
    records["K"] = rng.uniform(5e4, 6e5) if relaxed else math.inf
    records["relaxation_front"], records["relaxation_rear"] = rng.uniform(0.0, 1.0, 2) if relaxed else (0.0, 0.0)
    records["wheel_radius_front"], records["wheel_radius_rear"] = rng.uniform(0.9, 1.1, 2)
    records["payload_mass"] = rng.uniform(0.0, 500.0)
    records["C_vert"] = C_vert
    return records


def fastest_eigenvalues(model: str, drive: str, relaxed: bool, C_vert: float) -> np.ndarray:
    """Fastest eigenvalue and what `fastest_rate` says [1/s], for 200 cars of the prior box at any speed; (200, 2)."""
    rng, rows = np.random.default_rng(21), []
    for _ in range(200):
        records = tyres_anywhere(rng, model, relaxed, C_vert)
        v_x = rng.uniform(1.1, 60.0)
        bound = fastest_rate(records[0], drive, v_x, model)
        records["step"] = 1.0 / bound  # the integrator's, on which the least length that lags depends
        values = np.linalg.eigvals(jacobian_of(records, drive, v_x, FREE[model, drive], step=1e-6, model=model))
        rows.append((np.abs(values).max(), bound))
    return np.array(rows)


@rolling_as_recorded
def test_fastest_rate_bounds_every_eigenvalue_of_rigid_tyres(drive: str) -> None:
    # Finite differences know an eigenvalue to 1e-6; the bound is not idle either, within a tenth of the truth.
    true, bound = fastest_eigenvalues("single_track", drive, relaxed=False, C_vert=math.inf).T
    assert (true <= bound * (1.0 + 1e-6)).all()
    assert (true > 0.9 * bound).all()


@rolling_as_recorded
@every_model
def test_steps_stay_stable(drive: str, model: str) -> None:
    # The law that counts: step times eigenvalue inside RK4's stability region, a half disc of radius 2.61 at least.
    for relaxed, C_vert in TYRES:
        true, bound = fastest_eigenvalues(model, drive, relaxed, C_vert).T
        assert (true / bound).max() < 2.61


@every_model
@pytest.mark.parametrize(("relaxed", "C_vert"), TYRES)
def test_steps_stay_stable_and_near_however_fast_the_wheels(model: str, relaxed: bool, C_vert: float) -> None:
    # Of cars of the prior box at any speed, with the fewest steps that a diagnosis takes: a drive that is pushed in all
    # directions goes as with eight times as many steps. Unstable steps are off by more than all of it; stable ones were
    # off by 2.5 % of a channel's range at most, by tenths of a percent mostly. The bound is twice that, not derived.
    rng, rate = np.random.default_rng(21), 100.0
    for _ in range(30):
        records = tyres_anywhere(rng, model, relaxed, C_vert)
        v = rng.uniform(1.1, 60.0)
        steps = substeps_for(records, "torque", v, rate, limit=2.0, model=model)
        u = coasting(v, 0.5)[::2]
        u[5:, 2], u[20:, 0] = 100.0, 1e-3
        few, many = (
            finished(records, "torque", u, (v, 1e-3 * v, 0.01), model=model, rate=rate, substeps=n)[[A_X, A_Y, R, 3, 4]]
            for n in (steps, 8 * steps)
        )
        assert (np.abs(few - many).max(axis=1) < 0.05 * np.ptp(many, axis=1)).all()


def test_wheels_count_by_a_part() -> None:
    # The same car, its wheels half as heavy: as many more steps, of which wheels as fast as the rest need none.
    heavy, light = (record_of(RIGID, I_wf=1.7 * k, I_wr=1.7 * k)[0] for k in (1.0, 0.5))
    assert fastest_rate(light, "torque", 5.0) == pytest.approx(2.0 * fastest_rate(heavy, "torque", 5.0), rel=1e-12)
    stiffest = max(heavy["C_kappa_f"], heavy["C_kappa_r"])
    expected = heavy["R_f"] ** 2 * stiffest / (1.7 * 5.0) / ROLLING
    assert fastest_rate(heavy, "torque", 5.0) == pytest.approx(expected, rel=1e-12)


def test_substeps_keep_the_fastest_record_below_the_limit() -> None:
    records = np.concatenate([record_of(PAPER), record_of(PAPER, I_wf=1.0), record_of(PAPER, K=math.inf)])
    n = substeps_for(records, "torque", 2.0, 50.0)
    fastest = max(fastest_rate(record, "torque", 2.0) for record in records)
    assert fastest / (50.0 * n) <= 1.0 < fastest / (50.0 * (n - 1))
    assert substeps_for(records[:1], "speed", 10.0, 200.0) == 1


# --- symmetry and invariance ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [MILD, STRONG], ids=["mild", "strong"])
@every_drive
@every_model
def test_mirrored_steering_gives_the_mirrored_drive_exactly(
    model: str, drive: str, size: tuple[float, float, float]
) -> None:
    u = paper_manoeuvre(size, seconds=2.0)
    u[:, 3:7] = smooth_inputs(2.0)[:400, 3:7]
    mirrored = u * np.array([-1.0 if name == "steering" else 1.0 for name in INPUTS])
    left = finished(record_of(PAPER), drive, u, (10.5, 0.1, 0.05), model=model)
    right = finished(record_of(PAPER), drive, mirrored, (10.5, -0.1, -0.05), model=model)
    same, negated = [A_X, OMEGA_F, OMEGA_R, V_X, A_Z, PITCH_RATE], [A_Y, R, V_Y, ROLL_RATE]
    assert np.array_equal(left[same], right[same])
    assert np.array_equal(left[negated], -right[negated])
    assert np.abs(left[A_Y]).max() > 1.0


@settings(max_examples=25)
@given(st.integers(1, 100), st.sampled_from([("single_track", RIGID), ("full_vehicle", RIGID_BODY)]))
def test_later_steering_gives_the_same_response_later(shift: int, chosen: tuple[str, Vehicle]) -> None:
    model, car = chosen
    u = coasting(V, 1.5)
    pulse = 0.05 * np.sin(np.linspace(0.0, 2.0 * math.pi, 200))
    u[1:201, 0] = pulse
    later = coasting(V, 1.5)
    later[1 + shift : 201 + shift, 0] = pulse
    y, y_later = (finished(record_of(car), "torque", x, (V, 0.0, 0.0), model=model) for x in (u, later))
    assert np.array_equal(y_later[:, shift:], y[:, :-shift])


def test_window_cut_out_of_a_drive_continues_it() -> None:
    # Without relaxation the lateral state is (v_y, r) alone: a window that starts from it goes the same way, as far as
    # the loop of loads and forces, which starts elsewhere, leaves each acceleration open. Lateral modes damp what that
    # adds up to within a fraction of a second.
    u, car = smooth_inputs(), record_of(replace(PAPER, K=math.inf))
    whole = finished(car, "speed", u, (10.5, 0.1, 0.02))
    part = finished(car, "speed", u[150:], whole[[V_X, V_Y, R], 150])
    np.testing.assert_allclose(part, whole[:, 150:], rtol=0.0, atol=2.0 * LOAD_TOLERANCE)


@every_model
def test_every_record_of_a_batch_is_simulated_as_if_alone(model: str) -> None:
    rng, n = np.random.default_rng(22), 9
    records = np.concatenate(
        [record_of(PAPER, m=m, l_f=l_f) for m, l_f in rng.uniform((1400, 1.0), (1800, 1.5), (n, 2))]
    )
    u = paper_manoeuvre(STRONG, seconds=1.0)
    stiffness, inputs = rng.normal(0.0, 3e3, (n, 1, 4)), rng.normal(0.0, 0.02, (n, len(u), 2))
    initial = np.column_stack([rng.uniform(10.0, 11.0, n), np.zeros((n, 2))])[:, np.newaxis]
    together, outcomes = simulate(
        records, "torque", u, initial, model=model, stiffness_noise=stiffness, input_noise=inputs
    )
    for i in range(n):
        one = slice(i, i + 1)
        alone, outcome = simulate(
            records[one],
            "torque",
            u,
            initial[one],
            model=model,
            stiffness_noise=stiffness[one],
            input_noise=inputs[one],
        )
        assert outcome[0] == outcomes[i]
        assert np.array_equal(alone[0], together[i])


@every_model
def test_constant_stiffness_noise_is_another_stiffness(model: str) -> None:
    # One draw for the window, or the same draw at each sample, or another car: the same numbers.
    u, extra = paper_manoeuvre(STRONG, seconds=1.0), np.array([4e3, -2e3, 1e3, -3e3])
    names = ("C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r")
    other = record_of(PAPER, **{n: getattr(PAPER, n) + x for n, x in zip(names, extra, strict=True)})
    always = np.broadcast_to(extra, (1, len(u), 4)).copy()

    def drive(records: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
        return finished(records, "torque", u, (V, 0.0, 0.0), model=model, stiffness_noise=noise)

    expected = drive(other)
    assert np.array_equal(drive(record_of(PAPER), extra.reshape(1, 1, 4)), expected)
    assert np.array_equal(drive(record_of(PAPER), always), expected)


def test_input_noise_scales_steering_and_torques() -> None:
    p, u = record_of(PAPER)[0], paper_manoeuvre(STRONG, seconds=1.0)
    acting = np.empty_like(u)
    derive(p)
    actuate(p, u[:0, :3], u, np.array([[0.25, -0.5]]), RATE, acting)
    assert np.array_equal(acting, u * np.array([1.25, 0.5, 0.5, *[1.0] * (len(INPUTS) - 3)]))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("steering_lag_time", 0.5),
        ("steering_delay_time", 0.3),
        ("steering_dead_band_width", 0.02),
        ("drive_delay_time", 0.3),
    ],
)
def test_actuators_follow_what_came_before_a_window(field: str, value: float) -> None:
    p, u, half = record_of(PAPER, **{field: value})[0], paper_manoeuvre(STRONG, seconds=8.0), round(4.0 * RATE)
    u[:, :3] += np.random.default_rng(0).normal(0.0, [0.01, 50.0, 50.0], (len(u), 3))
    none, whole, later, alone = np.zeros((1, 2)), np.empty_like(u), np.empty_like(u[half:]), np.empty_like(u[half:])
    derive(p)
    actuate(p, u[:0, :3], u, none, RATE, whole)
    actuate(p, u[:half, :3], u[half:], none, RATE, later)
    actuate(p, u[:0, :3], u[half:], none, RATE, alone)
    np.testing.assert_array_equal(later, whole[half:])
    assert np.abs(alone - later)[:10].max() > 0.0


# --- where it ends --------------------------------------------------------------------------------------------------

everywhere = st.floats(-1e6, 1e6)
inputs = st.tuples(*[everywhere] * len(INPUTS))


@given(st.tuples(*[everywhere] * single_track.STATES), inputs, st.sampled_from(sorted(DRIVES)), st.booleans())
def test_finite_state_finite_rate(state: tuple[float, ...], u: tuple[float, ...], drive: str, relaxed: bool) -> None:
    # Lagged slips stay within what a slip can be, since they follow one: -1 and above.
    x = np.array(state)
    x[5:7] = np.maximum(x[5:7], -1.0)
    records = record_of(PAPER if relaxed else replace(PAPER, K=math.inf))
    assert np.isfinite(rate_of(records, drive, x, np.array(u))).all()


@given(st.tuples(*[everywhere] * full_vehicle.STATES), inputs, st.sampled_from(sorted(DRIVES)), st.booleans())
def test_finite_state_finite_rate_of_four_wheels(
    state: tuple[float, ...], u: tuple[float, ...], drive: str, relaxed: bool
) -> None:
    # Likewise; the body's angles and their rates [rad, rad/s] stay where springs of 1e5 N m/rad leave the loop's
    # 1e-9 m/s^2 above the rounding of the forces: 1e5 1 N m / 1e3 kg m 1e-16.
    x = np.array(state)
    x[3:7] = np.clip(x[3:7] / 1e6, -1.0, 1.0)
    x[11:15] = np.maximum(x[11:15], -1.0)
    records = record_of(PAPER if relaxed else replace(PAPER, K=math.inf))
    assert np.isfinite(rate_of(records, drive, x, np.array(u), model="full_vehicle")).all()


@every_model
def test_car_that_comes_to_rest_under_its_brakes_stays_there(model: str) -> None:
    u, records = coasting(3.0, 4.0), record_of(PAPER)
    u[:, 1], u[:, 2] = -600.0, -400.0
    substeps = substeps_for(records, "torque", 1.0, RATE, model=model)
    y = finished(records, "torque", u, (3.0, 0.0, 0.0), substeps=substeps, model=model)
    assert np.isfinite(y).all()
    assert (np.diff(y[V_X]) < 1e-2).all()
    assert abs(y[V_X, -1]) < 0.05


@every_model
def test_spin_out_is_counted_and_leaves_nan(model: str) -> None:
    u = coasting(20.0, 3.0)
    u[:, 0], u[:, 2] = 0.3, -4000.0
    y, outcomes = simulate(record_of(PAPER), "torque", u, (20.0, 0.0, 0.0), model=model)
    assert outcomes.tolist() == [SPUN_OUT]
    assert np.isnan(y).all()


@every_model
def test_unknown_constant_is_not_finite_and_leaves_nan(model: str) -> None:
    records = record_of(PAPER, m=math.nan)
    y, outcomes = simulate(records, "torque", paper_manoeuvre(), (V, 0.0, 0.0), model=model)
    assert outcomes.tolist() == [NOT_FINITE]
    assert np.isnan(y).all()


def test_only_the_full_vehicle_needs_to_know_its_body() -> None:
    u = paper_manoeuvre()
    assert simulate(record_of(RIGID), "torque", u, (V, 0.0, 0.0))[1][0] != NOT_FINITE
    assert simulate(record_of(RIGID), "torque", u, (V, 0.0, 0.0), model="full_vehicle")[1][0] == NOT_FINITE


@pytest.mark.slow
def test_the_catalogue_at_its_null_costs_less_than_half_of_the_bare_model() -> None:
    command = [sys.executable, "benchmarks/simulator.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    costs = re.search(r"the catalogue at its null costs ([\d.]+) times the bare model", done.stdout)
    assert costs is not None
    assert float(costs[1]) < 1.5
