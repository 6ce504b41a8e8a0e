"""The concealed-effects benchmark's cases: they follow from their seed, and ratios from projection."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from concealed import baselines, cases, concealment, drives, injected, oracle, outside, setups
from concealed.mix import slot
from concealed.strength import Given, Noise, Projection, fit, residual, snr
from concealed.twin import Twin
from concealed.worlds import OwnModel

from vehicle_sbi.inference.information import best_fit, sensitivity
from vehicle_sbi.physics.effects import CATALOGUE

RNG = np.random.default_rng(3)
CAR = drives.car(RNG, relaxed=False, body=False)
PRIOR = {
    "C_alpha_f": (0.7 * (CAR.C_alpha_f or 0.0), 1.5 * (CAR.C_alpha_f or 0.0)),
    "C_alpha_r": (0.7 * (CAR.C_alpha_r or 0.0), 1.5 * (CAR.C_alpha_r or 0.0)),
    "l_f": ((CAR.l_f or 0.0) - 0.2, (CAR.l_f or 0.0) + 0.2),
}
GIVEN = Given(vehicle=CAR, model="single_track", drive="speed", channels=("a_y", "yaw_rate"), prior=PRIOR)
NOISE = Noise(
    std={"a_y": 0.1, "yaw_rate": 0.004, "v_x": 0.003}, rho={"a_y": 0.6, "yaw_rate": 0.0, "v_x": 0.0}, tail="normal"
)
THETA = np.array([getattr(CAR, name) for name in PRIOR])


def plan(**steering: float) -> drives.Plan:
    """Ten seconds at 20 m/s; steering as a sine of `amplitude` [rad], or a step of `step` [rad] eased in."""
    t = np.arange(501) / 50.0
    delta = steering.get("amplitude", 0.0) * np.sin(math.pi * t) * np.clip(t, 0.0, 1.0)
    delta = delta + steering.get("step", 0.0) * np.clip(t - 1.0, 0.0, 1.0)
    return drives.Plan(t=t, steering=delta, acceleration=np.zeros_like(t), v_0=20.0, manoeuvre="test")


def setup() -> setups.Setup:
    world = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0)
    return setups.Setup(
        world=world, given=GIVEN, theta=THETA, train=(plan(amplitude=0.02),), heldout=(), noise=NOISE,
        regime="gentle", truth=CAR, world_name="test",
    )  # fmt: skip


# --- cases ----------------------------------------------------------------------------------------------------------


def test_a_block_has_the_stated_mix_and_deals_every_effect_equally_often() -> None:
    slots = [slot(5, i, list(injected.INJECTED)) for i in range(40 * 13)]
    kinds = pd.Series([one.kind for one in slots[:40]]).value_counts()
    assert dict(kinds) == {"single": 16, "none": 12, "outside": 6, "pair": 6}
    alone = [one.effects[0] for one in slots if one.kind == "single" and one.level != "L2"]
    times = pd.Series(alone).value_counts()
    assert set(times.index) == set(CATALOGUE)
    assert times.max() - times.min() <= 1
    for level in ("L0", "L1"):
        outer = pd.Series(
            [one.effects[0] for one in slots if (one.kind, one.level) == ("outside", level)]
        ).value_counts()
        dealt = [k for k, one in outside.OUTSIDE.items() if level == "L1" or one.kind != "twin"]
        assert set(outer.index) == set(dealt)
        assert outer.max() - outer.min() <= 1
    assert len(outside.OUTSIDE) >= 8
    assert not set(outside.OUTSIDE) & set(CATALOGUE)


def test_nothing_is_missing_in_any_case_of_that_mix() -> None:
    slots = [slot(5, i, [], "nothing") for i in range(50)]
    assert {one.kind for one in slots} == {"none"}
    assert [sum(one.level == level for one in slots) for level in ("L0", "L1")] == [35, 15]


def test_a_case_is_a_function_of_seed_and_index_and_its_truth_lies_elsewhere(tmp_path: Path) -> None:
    index = next(i for i in range(80) if (one := slot(1, i, [])).level == "L0" and one.kind == "none")
    for folder in (tmp_path / "one", tmp_path / "two"):
        cases.build(1, index, "concealed", folder, injected.build, [])
    name = f"{index:04d}"
    one, two = (sorted((tmp_path / k / "cases" / name).iterdir()) for k in ("one", "two"))
    assert [path.name for path in one] == [path.name for path in two]
    for a, b in zip(one, two, strict=True):
        assert a.read_text().replace("/one/", "/two/") == b.read_text()
    assert {path.suffix for path in one} == {".csv", ".yaml"}
    words = " ".join(path.read_text() for path in one if path.suffix == ".yaml")
    truth = json.loads((tmp_path / "one" / "sealed" / f"{name}.json").read_text())
    assert "sealed" not in words
    assert not any(f"{truth['vehicle'][key]}" in words for key in ("C_alpha_f", "C_alpha_r", "l_f"))
    before = one[0].stat().st_mtime_ns
    cases.build(1, index, "concealed", tmp_path / "one", injected.build, [])
    assert one[0].stat().st_mtime_ns == before  # what is built is not built again


def test_the_sealed_ratio_is_what_projection_on_all_sensitivities_gives() -> None:
    """M = (I + J'J)^-1 with all of J at once, against the two steps; both exact, so they agree to rounding.

    The initial states' differences have steps of 1e-3 in both, and the same formula.
    """
    hidden = concealment.Concealment(setup(), 1.0)
    draft = concealment.Draft(name="gyro_scale", scaled={"z": (1.0, 1.2)}, shape={})
    strength, reached = concealment.settle(lambda at: hidden.reach(draft, at), 8.0)
    assert reached == pytest.approx(8.0, rel=concealment.CLOSE)
    changed = hidden.change({"gyro_scale": draft.at(strength)})
    assert changed is not None
    simulator, noise = hidden.quiet, hidden.quiet.noise
    at = sensitivity(simulator, hidden.theta)
    spread = np.concatenate([simulator.space.prior_std, np.ones(len(simulator.nuisances))])
    white = noise.whiten(np.nan_to_num(np.concatenate([at.jacobian * spread[:, None, None], changed[None]])),
                         noise.std(at.y), simulator.windows.valid).reshape(len(spread) + 1, -1)  # fmt: skip
    J, d = white[:-1], white[-1]
    square = d @ d - (J @ d) @ np.linalg.solve(np.eye(len(J)) + J @ J.T, J @ d)
    assert reached == pytest.approx(math.sqrt(square), rel=1e-6)


def test_the_joint_fit_ends_where_best_fit_does() -> None:
    """Both minimise the same chi-square where noise is white, ours with linear initial states. A tenth of a unit
    moves the ratio of what differs where nothing is missing, 2 at most, by 0.1 / (2 x 2), a fortieth."""
    world = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0)
    noise = replace(NOISE, rho=dict.fromkeys(NOISE.rho, 0.0))
    drive, rng = plan(amplitude=0.02), np.random.default_rng(0)
    series = world.drive(drive, {})
    assert series is not None
    added = {name: noise.draw(name, len(drive.t), rng) for name in noise.std}
    simulator = GIVEN.simulator([setups.recording("a", drive, series, GIVEN, added)], noise)
    middle = (simulator.space.low + simulator.space.high) / 2
    ours = fit(simulator, simulator.windows.y, middle)
    theirs, _ = best_fit(simulator, np.nan_to_num(simulator.windows.y), middle[None])
    projection = Projection(simulator, theirs)
    chi_square = [
        snr(projection.without_states(residual(simulator, theta, simulator.windows.y)[None])) ** 2
        for theta in (ours, theirs)
    ]
    assert chi_square[0] < chi_square[1] + 0.1


def test_without_effects_the_own_model_is_the_base_model() -> None:
    hidden = concealment.Concealment(setup(), 1.0)
    assert hidden.ok
    assert snr(hidden.projection.left(residual(hidden.quiet, THETA, hidden.quiet.windows.y)[None])) < 1.0


# --- the twin -------------------------------------------------------------------------------------------------------


def test_the_twin_stays_straight_at_constant_speed_without_commands() -> None:
    """By mirror symmetry exactly; its speed settles by the wheels' load-dependent radius only, so not at all here."""
    series = Twin(car=CAR, gain=1.0).drive(plan(), {})
    assert series is not None
    assert not series["yaw_rate"].any()
    assert not series["a_y"].any()
    np.testing.assert_allclose(series["v_x"], 20.0, atol=1e-9)


def test_the_twin_turns_as_much_as_its_understeer_says() -> None:
    """r = v delta / (L + K v^2), exact for tan(alpha) = alpha and no load effects: at a_y of 0.4 m/s^2 both are below
    1e-3; the steering's cosine, drag in the turn and the curvature of the tyres take less than that again."""
    delta = 0.003
    series = Twin(car=CAR, gain=1.0).drive(plan(step=delta), {})
    assert series is not None
    assert CAR.L
    v, r = series["v_x"][-1], series["yaw_rate"][-1]
    assert r == pytest.approx(v * delta / (CAR.L + drives.understeer(CAR) * v**2), rel=2e-3)


def test_in_gentle_driving_twin_and_catalogue_mean_the_same_by_an_effect() -> None:
    """Coded independently, the changes agree to the twin's departure from linear tyres: a few per cent of theirs."""
    drive = plan(amplitude=0.015)
    twin, own = Twin(car=CAR, gain=1.0), OwnModel(car=CAR, model="single_track", drive_mode="torque", gain=1.0)
    for effects in (
        {"steering_delay": {"time": 0.05}}, {"roll_steer": {"coefficient": 0.001}}, {"road_bank": {"angle": 0.02}},
        {"crosswind": {"force": 300.0, "arm": 0.5}}, {"gyro_scale": {"z": 1.1}}, {"yaw_inertia": {"factor": 1.3}},
        {"payload": {"mass": 200.0, "x": -1.0}}, {"imu_misalignment": {"roll": 0.03, "pitch": 0.0, "yaw": 0.05}},
    ):  # fmt: skip
        moved = []
        for world in (twin, own):
            with_it, without = world.drive(drive, effects), world.drive(drive, {})
            assert with_it is not None
            assert without is not None
            moved.append(np.concatenate([(with_it[c] - without[c]) / NOISE.std[c] for c in GIVEN.channels]))
        assert np.linalg.norm(moved[0] - moved[1]) < 0.05 * np.linalg.norm(moved[1]), effects


def test_a_reader_of_half_a_catalogue_effect_leaves_the_recorded_command_alone() -> None:
    world = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0)
    drive = plan(amplitude=0.02)
    series = outside.drive(world, drive, {"stick_slip_steering": {"threshold": 0.01}})
    quiet = world.drive(drive, {})
    assert series is not None
    assert quiet is not None
    assert np.array_equal(series["steering"], drive.steering)
    assert not np.array_equal(series["yaw_rate"], quiet["yaw_rate"])


def test_a_zero_that_walks_goes_elsewhere_in_each_recording_and_grows_with_its_rate() -> None:
    world = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0)
    walks = []
    for drive, rate in ((plan(), 0.01), (plan(), 0.02), (replace(plan(), v_0=21.0), 0.01)):
        quiet, walked = (outside.drive(world, drive, e) for e in ({}, {"drifting_gyro": {"rate": rate, "draw": 5.0}}))
        assert quiet is not None
        assert walked is not None
        walks.append(walked["yaw_rate"] - quiet["yaw_rate"])
    assert np.allclose(walks[1], 2.0 * walks[0], rtol=1e-9, atol=1e-12)
    assert not np.allclose(walks[2], walks[0])


def test_wheels_that_turn_no_faster_turn_no_faster_and_one_side_leaves_the_other_alone() -> None:
    drive = plan(amplitude=0.02)
    slow = outside._commanded(drive, {"rate_limited_steering": {"clipped": 0.5}})
    assert np.abs(np.diff(slow)).max() <= 0.5 * np.abs(np.diff(drive.steering)).max() * (1.0 + 1e-12)
    left = outside._commanded(drive, {"one_sided_steering": {"gain": 0.3}})
    np.testing.assert_allclose(left, np.where(drive.steering > 0.0, 1.3, 1.0) * drive.steering)


def test_a_holding_accelerometer_reads_what_was_there_now_or_before() -> None:
    drive = plan()
    quiet = {name: np.arange(len(drive.t), dtype=float) for name in ("a_x", "a_y", "yaw_rate")}
    for share in (0.0, 0.6):
        held = outside._sensed(quiet, drive, {"holding_accelerometer": {"share": share, "draw": 3.0}})
        late = quiet["a_x"] - held["a_x"]
        assert late.min() == 0.0
        # Of n samples each is repeated with probability `share`, to within four standard deviations.
        assert np.mean(late > 0.0) == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / len(late)))
        np.testing.assert_array_equal(held["a_y"], held["a_x"])
        np.testing.assert_array_equal(held["yaw_rate"], quiet["yaw_rate"])


# --- baselines ------------------------------------------------------------------------------------------------------


def test_simpler_methods_see_what_is_large_and_only_that() -> None:
    world, drive = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0), plan(amplitude=0.02)
    heard = {}
    for size in (0.0, 0.02, 2.0):  # of a gyro's bias: none, five standard deviations of a sample, and beyond all prior
        series = outside.drive(world, drive, {"gyro_bias": {"z": size}})
        assert series is not None
        rng = np.random.default_rng(0)
        noise = {name: rng.normal(0.0, std, len(drive.t)) for name, std in NOISE.std.items()}
        heard[size] = baselines.said(GIVEN.simulator([setups.recording("a", drive, series, GIVEN, noise)]))
    assert heard[0.02]["bic"][0] == heard[0.02]["correlation"][0] == heard[2.0]["lasso"][0] == "gyro_bias"
    assert heard[0.0]["bic"] == heard[0.0]["lasso"] == heard[0.0]["mmd"] == []
    assert heard[2.0]["mmd"]


# --- the oracle -------------------------------------------------------------------------------------------------------


def test_an_oracle_is_no_better_than_the_noise_and_no_worse_than_who_does_not_know(tmp_path: Path) -> None:
    # What is left over cannot be less than the noise that was added, but for the initial states, which take up to 3 of
    # 500 samples, and its own scatter: 4 / sqrt(2 n) with the n of 5 s at 50 Hz, longer where noise is slow.
    def wanted(i: int) -> bool:
        one = slot(1, i, list(injected.INJECTED))
        return one.level == "L0" and one.kind == "single" and one.snr == 32.0 and one.effects[0] == "gyro_bias"

    index = next(i for i in range(5000) if wanted(i))
    cases.build(1, index, "concealed", tmp_path, injected.build, list(injected.INJECTED))
    case, sealed = tmp_path / "cases" / f"{index:04d}", tmp_path / "sealed" / f"{index:04d}.json"
    truth = json.loads(sealed.read_text())
    oracle.write(case, sealed)
    knowing = json.loads(sealed.with_suffix(".oracle.json").read_text())
    ignorant = oracle.errors(case, truth | {"effects": {}})
    held = oracle.held_out(case, truth)
    windows = held.simulator.windows
    for c, name in enumerate(windows.channels):
        n = windows.valid[c].sum() * (1.0 - truth["noise"]["rho"].get(name, 0.0))
        floor = truth["noise"]["std"][name] / np.std(held.observed[c, windows.valid[c]])
        assert knowing[name] > floor * (1.0 - 4.0 / np.sqrt(2.0 * n) - 0.01)
    assert knowing["yaw_rate"] < ignorant["yaw_rate"]
