"""The concealed-effects benchmark: cases follow from their seed, ratios from projection, scores from verdicts."""

import json
import math
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from concealed import (
    baselines,
    campaign,
    cases,
    concealment,
    drives,
    injected,
    oracle,
    outside,
    scores,
    setups,
    summary,
)
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
    assert heard[0.02]["bic"][0] == heard[0.02]["lasso"][0] == heard[0.02]["correlation"][0] == "gyro_bias"
    assert heard[0.0]["bic"] == heard[0.0]["lasso"] == heard[0.0]["mmd"] == []
    assert heard[2.0]["mmd"]


# --- scores ---------------------------------------------------------------------------------------------------------


def truth(kind: str, effects: dict[str, dict[str, float]], level: str = "L0", **more: object) -> dict:
    facts = {
        name: {"parameters": values, "active": list(values), "spans": {"a": (2.0, 4.0)} if "start" in values else {}}
        for name, values in effects.items()
    }
    base = {"kind": kind, "level": level, "effects": facts, "base_parameters": {"l_f": 1.2}, "heldout_comparable": True}
    return base | more


def verdict(explanations: list[tuple[list[str], float]], none: float, unknown: float, **more: object) -> dict:
    named = [{"effects": names, "probability": p, "parameters": {}, "acts": {}} for names, p in explanations]
    plain = {"detected": True, "p_value": 0.001, "explanations": named, "p_none": none, "p_unknown": unknown}
    plain |= {"effects": {effect: p for names, p in explanations for effect in names}}
    return plain | {"mismatch": [], "indistinguishable": [], "unknown": None, "fit": {}, "base_parameters": {}} | more


def table(*scored: tuple[dict, dict]) -> pd.DataFrame:
    """Rows as of cases that were diagnosed, from truths and what they scored."""
    return pd.DataFrame(
        {
            "level": one["level"], "kind": one["kind"], "effects": " + ".join(one["effects"]), "snr": 8.0,
            "snr_beyond": 8.0, "detectable": True, "seconds": 1.0,
        } | row
        for one, row in scored
    )  # fmt: skip


def cell(rows: pd.DataFrame, metric: str) -> str:
    """What the page says of a metric over all cases, and of how many."""
    middle, _, rest = summary.summary(rows).set_index("metric")["all"][metric].partition(" (")
    return f"{middle} of {rest.rstrip(')').split('; ')[1]}"


def test_scores_of_hand_made_verdicts() -> None:
    bias = truth("single", {"gyro_bias": {"z": 0.01}})
    good = scores.score(bias, verdict([(["gyro_bias"], 0.85), (["road_bank"], 0.1)], 0.0, 0.05))
    assert (good["top1"], good["top2"], good["in_set"], good["set_size"], good["detected"]) == (1.0, 1.0, True, 2, True)
    second = scores.score(bias, verdict([(["road_bank"], 0.5), (["gyro_bias"], 0.4)], 0.0, 0.1))
    assert (second["top1"], second["top2"], second["in_set"]) == (0.0, 1.0, True)
    half = scores.score(bias, verdict([(["road_bank"], 0.9)], 0.0, 0.1, indistinguishable=[["road_bank", "gyro_bias"]]))
    assert (half["top1"], half["top2"], half["in_set"], half["set_size"]) == (0.5, 0.5, False, 1)
    pair = truth("pair", {"gyro_bias": {"z": 0.01}, "aero_drag": {"area": 0.5}})
    assert scores.score(pair, verdict([(["aero_drag", "gyro_bias"], 0.9)], 0.0, 0.1))["both"]
    assert not scores.score(pair, verdict([(["aero_drag"], 0.9)], 0.0, 0.1))["both"]
    strange = truth("outside", {"cross_talk": {"leak": 1.0}})
    wrong = scores.score(strange, verdict([(["gyro_bias"], 0.5)], 0.1, 0.4))
    assert (wrong["wrong_name"], wrong["said_unknown"]) == (True, False)
    honest = scores.score(strange, verdict([(["gyro_bias"], 0.3)], 0.1, 0.6))
    assert (honest["wrong_name"], honest["said_unknown"], honest["correct"]) == (False, True, True)
    real = truth("single", {"gyro_bias": {"z": 0.01}}, level="L2")
    assert scores.score(real, verdict([(["gyro_bias", "body_roll"], 0.9)], 0.0, 0.1))["correct"]
    mixed = verdict([(["gyro_bias"], 0.0), (["road_bank"], 0.0)], 0.0, 1.0)
    for one, beside in zip(mixed["explanations"], (0.6, 0.3), strict=True):
        one["beside_unknown"] = beside
    told = scores.score(real, mixed)
    assert (told["correct"], told["probability"], told["set_size"]) == (True, 0.6, 2)
    assert scores.score(bias, mixed)["answer"] == "unknown"  # in simulation nothing unknown stands beside what is known


def test_a_known_effect_beside_something_unknown_is_told_from_something_unknown_alone() -> None:
    strange = truth("outside", {"cross_talk": {"leak": 1.0}})
    scored = []
    for beside in (0.0, 0.4, 0.5):  # of 0.9 that something is unknown; alone are 0.9, 0.5 and 0.4
        said = verdict([(["gyro_bias"], 0.1)], 0.0, 0.9)
        said["explanations"][0]["beside_unknown"] = beside
        scored.append(scores.score(strange, said))
    assert [one["named_beside"] for one in scored] == [False, False, True]
    assert all(one["said_unknown"] and not one["wrong_name"] for one in scored)
    scored.append(scores.score(strange, verdict([(["gyro_bias"], 0.6)], 0.0, 0.4)))  # not called unknown: not asked
    rows = table(*((strange, one) for one in scored))
    assert cell(rows, "called unknown, but a known effect named beside it") == "0.33 of 3"
    assert cell(rows, "wrong name, truth outside the catalogue") == "0.25 of 4"


def test_a_name_that_is_said_to_be_alike_is_worth_half_in_one_row_and_nothing_in_the_next() -> None:
    bias = truth("single", {"gyro_bias": {"z": 0.01}})
    alike = scores.score(
        bias, verdict([(["road_bank"], 1.0)], 0.0, 0.0, indistinguishable=[["road_bank", "gyro_bias"]])
    )
    assert cell(table((bias, alike)), "top-1, given detected, half for what is said to be alike") == "0.50 of 1"
    assert cell(table((bias, alike)), "the same, nothing for what is alike") == "0.00 of 1"


def test_on_real_recordings_one_name_is_held_against_one_name_of_simpler_methods() -> None:
    real = truth("single", {"gyro_bias": {"z": 0.01}}, level="L2")
    said = verdict([(["body_roll", "gyro_bias"], 0.9)], 0.0, 0.1)
    rows = []
    for effects in ({"gyro_bias": 0.95, "body_roll": 0.9}, {"body_roll": 0.95, "gyro_bias": 0.9}, {}):
        rows.append((real, scores.score(real, said | {"effects": effects})))
    assert [one["correct"] for _, one in rows] == [True] * 3
    beside = summary.beside_baselines(table(*rows), 40).set_index("method")
    assert beside["L2"]["this project"].startswith("0.33 ")
    known = truth("single", {"gyro_bias": {"z": 0.01}})  # in simulation the answer has to be that effect alone
    assert not scores.score(known, said | {"effects": {"gyro_bias": 0.95, "body_roll": 0.9}})["first_right"]


def test_a_diagnosis_without_a_verdict_is_wrong_in_every_row_of_its_kind(tmp_path: Path) -> None:
    facts = {"world": "", "regime": "", "snr_drawn": 8.0, "snr": 8.0, "detectable": True}
    effects: dict[str, dict[str, dict[str, float]]] = {
        "none": {}, "single": {"gust": {"force": 1.0, "start": 2.0}}, "outside": {"cross_talk": {"leak": 1.0}},
        "pair": {"gyro_bias": {"z": 0.01}, "aero_drag": {"area": 0.5}},
    }  # fmt: skip
    (tmp_path / "sealed").mkdir()
    for i, (kind, concealed) in enumerate(effects.items()):
        case, one = tmp_path / "cases" / f"{i:04d}", truth(kind, concealed, **facts)
        for fact in one["effects"].values():
            fact["snr_beyond"] = 8.0
        case.mkdir(parents=True)
        (case / "case.yaml").write_text("{drive: speed, recordings: [a], channels: [a_y, yaw_rate]}")
        (tmp_path / "sealed" / f"{i:04d}.json").write_text(json.dumps(one))
    untried = campaign.gather(tmp_path, 4)
    assert "4 cases, 0 of them diagnosed, 0 without a verdict" in summary.report(untried, "", "", 40)
    for case in (tmp_path / "cases").iterdir():
        (case / "run.json").write_text('{"seconds": 1800.0, "status": -9}')
    rows = campaign.gather(tmp_path, 4)
    assert "4 cases, 4 of them diagnosed, 4 without a verdict" in summary.report(rows, "", "", 40)
    worst = {
        "false alarms, nothing missing, p < 0.05": "1.00 of 1",
        "false alarms, nothing missing, p < 0.01": "1.00 of 1",
        "detected at SNR 8": "0.00 of 2",
        "top-1, given detected, half for what is said to be alike": "0.00 of 1",
        "top-2, given detected, half for what is said to be alike": "0.00 of 1",
        "truth in the 90 % set": "0.00 of 2",
        "wrong name, truth outside the catalogue": "1.00 of 1",
        "both of a pair, given detected": "0.00 of 1",
        "at least half of a pair, given detected": "0.00 of 1",
        "overlap (IoU) of a time-local effect": "0.00 of 1",
        "seconds a diagnosis": "1800.0 of 4",
    }
    assert {metric: cell(rows, metric) for metric in worst} == worst
    assert not summary.summary(rows)["metric"].str.contains("size of the 90 % set").any()  # there is none
    assert summary.beside_baselines(rows, 40).set_index("method")["L0"]["this project"].startswith("0.00 ")
    assert summary.misses(rows).set_index("effect")["said instead"]["gust"] == "no verdict (1)"


def test_the_page_says_by_which_command_and_on_which_processor_it_was_made() -> None:
    nothing = truth("none", {})
    rows = table((nothing, scores.score(nothing, verdict([], 1.0, 0.0))))
    where = campaign.machine(2)
    page = summary.report(rows, "python scripts/prove.py cases=1 seed=0 mix=concealed", where, 40)
    assert page.startswith("# Concealed effects\n\n`python scripts/prove.py cases=1 seed=0 mix=concealed`\n\n1 cases, ")
    assert page.endswith(f"{where}\n")
    assert campaign.processor()
    assert f", {campaign.processor()}, " in where
    assert platform.platform() not in where


def test_sizes_places_and_misfits_of_a_hand_made_verdict() -> None:
    gust = truth("single", {"gust": {"force": 1000.0, "start": 2.0, "duration": 2.0}})
    said = verdict([(["gust"], 1.0)], 0.0, 0.0)
    said["explanations"][0]["parameters"] = {
        "gust.force": {"mean": 1100.0, "q05": 950.0, "q95": 1250.0},
        "gust.start": {"mean": 3.0, "q05": 2.9, "q95": 3.1},
        "gust.duration": {"mean": 2.0, "q05": 1.9, "q95": 2.1},
    }
    said["explanations"][0]["acts"] = {"gust": [{"recording": "a", "from_s": 3.0, "to_s": 5.0}]}
    said["base_parameters"] = {"l_f": {"before": {"mean": 1.3, "std": 0.05}, "after": {"mean": 1.21, "std": 0.02}}}
    said["fit"] = {"base": {"nrmse": {"a_y": 0.5}}, "extended": {"nrmse": {"a_y": 0.2}}}
    row = scores.score(gust, said, {"a_y": 0.1})
    assert row["iou"] == pytest.approx(1 / 3)  # 3 to 4 s of 2 to 5 s
    assert row["onset_error"] == pytest.approx(1.0)
    assert row["size_error"] == pytest.approx((0.1 + 0.5 + 0.0) / 3)
    assert row["size_alone"] == pytest.approx(0.1)
    assert row["size_covered"] == pytest.approx(2 / 3)
    assert (row["bias_before"], row["bias_after"]) == (pytest.approx(2.0), pytest.approx(0.5))
    assert row["removed"] == pytest.approx(0.75)
    mute = verdict([(["gust"], 1.0)], 0.0, 0.0)  # names the effect, and no time
    rows = table((gust, row), (gust, scores.score(gust, mute)))
    assert cell(rows, "overlap (IoU) of a time-local effect").endswith(" of 2")
    assert cell(rows, "its onset's error where one is stated [s]") == "1.00 of 1"


def test_of_what_is_reducible_the_oracle_removes_all_the_base_model_nothing_and_what_is_spoilt_counts() -> None:
    gust = truth("single", {"gust": {"force": 1000.0}})
    base, knowing = {"a_y": 0.5, "yaw_rate": 0.30}, {"a_y": 0.1, "yaw_rate": 0.29}  # a_y is reducible, yaw rate hardly

    def removed(extended: dict[str, float], base: dict[str, float] = base) -> float | None:
        fit = {"base": {"nrmse": base}, "extended": {"nrmse": extended}}
        return scores.score(gust, verdict([(["gust"], 1.0)], 0.0, 0.0, fit=fit), knowing)["removed"]

    assert removed(knowing) == pytest.approx(1.0)
    assert removed(base) == 0.0
    assert removed(knowing | {"yaw_rate": 0.50}) == pytest.approx((0.4 - 0.2) / 0.41)
    assert removed(knowing, knowing | {"yaw_rate": 0.30}) is None


def test_places_are_held_against_the_truth_in_each_recording() -> None:
    drag = truth("outside", {"dragging_rear_wheel": {"start": 2.0, "torque": 20.0}})
    drag["effects"]["dragging_rear_wheel"]["spans"] = {"a": (2.0, 6.0), "b": (2.0, 8.0)}
    ends, early, late, unlikely = (
        {"recording": name, "from_s": start, "to_s": stop}
        for name, start, stop in (("a", 5.0, 6.0), ("b", 0.0, 1.0), ("b", 4.0, 8.0), ("b", 6.0, 9.0))
    )
    places = [
        {"p_value": p, "regime": "", "within": within}
        for p, within in ((0.01, [ends, early]), (0.01, [late]), (0.2, [unlikely]))
    ]
    row = scores.score(drag, verdict([(["gust"], 0.1)], 0.0, 0.9, mismatch=places))
    assert row["iou"] == pytest.approx((1.0 + 4.0) / (4.0 + 6.0 + 1.0))
    assert row["onset_error"] == pytest.approx(3.0)
    assert scores.score(drag, verdict([(["gust"], 0.1)], 0.0, 0.9))["iou"] == 0.0
    laws = [{"acts": [{"recording": "b", "from_s": 5.0, "to_s": 8.0}]}, {"acts": []}]
    said = verdict([(["gust"], 0.1)], 0.0, 0.9, mismatch=places) | {"unknown": {"laws": laws}}
    assert scores.score(drag, said)["iou"] == pytest.approx(3.0 / 10.0)
    said = verdict([(["gust"], 0.9)], 0.0, 0.1, mismatch=places) | {"unknown": {"laws": laws}}
    assert scores.score(drag, said)["iou"] == pytest.approx((1.0 + 4.0) / (4.0 + 6.0 + 1.0))


def test_a_profile_has_one_error_and_what_is_not_said_of_it_counts_as_none() -> None:
    grade = truth("single", {"road_grade_profile": {"angle_1": 0.03, "angle_11": 0.04, "angle_9": 0.0}})
    said = verdict([(["road_grade_profile"], 1.0)], 0.0, 0.0)
    said["explanations"][0]["parameters"] = {
        "road_grade_profile.angle_1": {"mean": 0.06, "q05": 0.04, "q95": 0.08},
        "road_grade_profile.angle_5": {"mean": 0.01, "q05": 0.0, "q95": 0.02},
    }
    row = scores.score(grade, said)
    assert row["size_error"] == pytest.approx(1.0)  # (0.03, -0.04, 0) of (0.03, 0.04, 0)
    assert row["size_covered"] == 0.0


def test_what_is_not_said_of_a_named_effect_counts_as_none() -> None:
    bias = truth("single", {"accelerometer_bias": {"x": 0.2, "y": 0.1}})
    said = verdict([(["accelerometer_bias"], 1.0)], 0.0, 0.0)
    said["explanations"][0]["parameters"] = {"accelerometer_bias.y": {"mean": 0.1, "q05": 0.05, "q95": 0.15}}
    row = scores.score(bias, said)
    assert (row["size_error"], row["size_covered"]) == (pytest.approx(0.5), 0.5)  # nothing and all of what there is
    said["explanations"][0]["parameters"] = {}
    row = scores.score(bias, said)
    assert (row["size_error"], row["size_covered"]) == (1.0, 0.0)


def test_sizes_are_those_of_the_set_that_is_likeliest_by_itself_or_beside_something_unknown() -> None:
    real = truth("single", {"gyro_bias": {"z": 0.01}}, level="L2")
    said = verdict([(["body_roll"], 0.1), (["gyro_bias"], 0.0)], 0.0, 0.9)
    said["explanations"][1] |= {
        "beside_unknown": 0.8, "parameters": {"gyro_bias.z": {"mean": 0.011, "q05": 0.009, "q95": 0.013}}
    }  # fmt: skip
    row = scores.score(real, said)
    assert row["correct"]
    assert (row["size_error"], row["size_covered"]) == (pytest.approx(0.1), 1.0)


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


def test_intervals_and_calibration_by_hand() -> None:
    """No event in n: Clopper and Pearson's upper bound is 1 - (alpha/2)^(1/n)."""
    ten = pd.DataFrame({"probability": [0.5] * 10, "correct": [True] * 10})
    # |k - 5| / 10 of k heads in ten throws, 0.123; 300 draws of a standard deviation of 0.1 leave 4 of 0.006 uncertain
    assert summary.calibrated(ten) == pytest.approx(0.123, abs=0.024)
    assert summary.interval([0.0] * 10) == (0.0, pytest.approx(1 - 0.05**0.1))
    assert summary.interval([1.0] * 10) == (pytest.approx(0.05**0.1), 1.0)
    table = pd.DataFrame({"probability": [0.95, 0.95, 0.65, 0.65], "correct": [1.0, 1.0, 1.0, 0.0]})
    assert summary.calibration_error(table) == pytest.approx(0.5 * 0.05 + 0.5 * 0.15)


def test_a_sensor_that_is_not_recorded_has_no_size() -> None:
    assert not scores._recorded("accelerometer_scale.x", ["a_y", "yaw_rate"])
    assert scores._recorded("accelerometer_scale.y", ["a_y", "yaw_rate"])
    assert scores._recorded("body_roll.gradient", ["a_x"])
