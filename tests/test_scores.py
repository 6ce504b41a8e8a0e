"""What the concealed-effects benchmark makes of verdicts: scores of each, and the page of them all."""

import json
import platform
from pathlib import Path

import campaign
import pandas as pd
import pytest
from concealed import benchmark, scores, summary


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
    plain["p_unknown_alone"] = unknown
    plain |= {"effects": {effect: p for names, p in explanations for effect in names}}
    return plain | {"mismatch": [], "indistinguishable": [], "unknown": None, "fit": {}, "base_parameters": {}} | more


def table(*scored: tuple[dict, dict]) -> pd.DataFrame:
    """Rows as of cases that were diagnosed, from truths and what they scored."""
    return pd.DataFrame(
        {
            "level": one["level"], "kind": one["kind"], "effects": " + ".join(one["effects"]), "snr": 8.0,
            "snr_beyond": 8.0, "detectable": True, "seconds": 1.0,
            "observer_fitted": 1.0, "observer_all": 1.0,
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
    mixed["p_unknown_alone"] = 0.05  # of 0.05 that is left, sets beside something unknown are not listed
    told = scores.score(real, mixed)
    assert (told["correct"], told["probability"], told["set_size"]) == (True, 0.6, 2)
    many = {"p_unknown_alone": 0.05, "effects": {"gyro_bias": 0.9}}  # sets of 0.35 in all are not listed
    told = scores.score(real, verdict([(["gyro_bias", "body_roll"], 0.2)], 0.0, 0.6) | many)
    assert (told["correct"], told["named"], told["probability"]) == (True, True, 0.2)
    assert scores.score(bias, mixed)["answer"] == "unknown"  # in simulation nothing unknown stands beside what is known


def test_a_known_effect_beside_something_unknown_is_told_from_something_unknown_alone() -> None:
    strange = truth("outside", {"cross_talk": {"leak": 1.0}})
    scored = []
    for beside in (0.0, 0.4, 0.5):  # of 0.9 that something is unknown; alone are 0.9, 0.5 and 0.4
        said = verdict([(["gyro_bias"], 0.1)], 0.0, 0.9)
        said["explanations"][0]["beside_unknown"] = beside
        said["p_unknown_alone"] -= beside
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
    strong = "top-1, SNR 8 and more, half for what is said to be alike"
    assert cell(table((bias, alike)), strong) == "0.50 of 1"
    assert strong not in set(summary.summary(table((bias, alike)).assign(snr=4.0))["metric"])


def test_on_real_recordings_one_name_is_held_against_one_name_of_simpler_methods() -> None:
    real = truth("single", {"gyro_bias": {"z": 0.01}}, level="L2")
    said = verdict([(["body_roll", "gyro_bias"], 0.9)], 0.0, 0.1)
    rows = []
    for effects in ({"gyro_bias": 0.95, "body_roll": 0.9}, {"body_roll": 0.95, "gyro_bias": 0.9}, {}):
        rows.append((real, scores.score(real, said | {"effects": effects})))
    assert [one["correct"] for _, one in rows] == [True] * 3
    beside = summary.beside_baselines(table(*rows), 40).set_index("method")
    assert beside["L2"]["this project"].startswith("0.33 ")
    none = scores.score(real, said | {"p_none": 1.0, "effects": {"gyro_bias": 0.95}})
    assert not none["first_right"]  # where the answer is that nothing is missing, no name is given


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
    untried = benchmark.gather(tmp_path, range(4))
    assert "4 cases, 0 of them diagnosed, 0 without a verdict" in summary.report(untried, "", "", 40)
    for case in (tmp_path / "cases").iterdir():
        (case / "diagnosis.json").write_text('{"seconds": 1800.0, "status": -9}')
    rows = benchmark.gather(tmp_path, range(4))
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


def test_whole_answers_of_simpler_methods_are_sets_and_nothing_is_one(tmp_path: Path) -> None:
    bias, drag = {"gyro_bias": {"z": 0.01}}, {"aero_drag": {"area": 0.5}}
    cases = [("none", {}, []), ("none", {}, ["gyro_bias"]), ("single", bias, ["gyro_bias"])]
    cases += [("single", bias, ["gyro_bias", "aero_drag"]), ("pair", bias | drag, ["aero_drag", "gyro_bias"])]
    cases += [("outside", {"cross_talk": {"leak": 1.0}}, ["gyro_bias"])]
    (tmp_path / "sealed").mkdir()
    for i, (kind, concealed, said) in enumerate(cases):
        case = tmp_path / "cases" / f"{i:04d}"
        case.mkdir(parents=True)
        one = truth(kind, concealed, world="", regime="", snr_drawn=8.0, snr=8.0, detectable=True)
        for fact in one["effects"].values():
            fact["snr_beyond"] = 8.0
        (tmp_path / "sealed" / f"{i:04d}.json").write_text(json.dumps(one))
        (case / "case.yaml").write_text("{drive: speed, recordings: [a], channels: [a_y, yaw_rate]}")
        (case / "baselines.json").write_text(json.dumps({"bic": said, "correlation": said}))
        (case / "diagnosis").mkdir()
        answer = verdict([(list(concealed), 1.0)] if concealed else [], 0.0 if concealed else 1.0, 0.0)
        (case / "diagnosis" / "verdict.json").write_text(json.dumps(answer))
    rows = benchmark.gather(tmp_path, range(len(cases)))
    assert list(rows["bic_correct"]) == [True, False, True, False, True, False]
    beside = summary.beside_baselines(rows, 40).set_index("method")
    whole, inside = beside["whole answer, L0 and L1"], beside["within the catalogue"]
    assert whole["forward selection by BIC"].startswith("0.50 ")
    assert inside["forward selection by BIC"].startswith("0.60 ")
    assert whole["this project"].startswith("0.83 ")  # all but the one outside the catalogue
    assert inside["this project"].startswith("1.00 ")
    assert whole["largest residual correlation"] == ""
    strong = summary.beside_baselines(rows.assign(snr=4.0), 40).set_index("method")["L0 and L1, SNR 8 and more"]
    assert (strong == "").all()


def test_names_are_held_against_those_of_the_observer() -> None:
    bias, bank = truth("single", {"gyro_bias": {"z": 0.01}}), verdict([(["road_bank"], 0.9)], 0.0, 0.1)
    right, wrong = (scores.score(bias, said) for said in (verdict([(["gyro_bias"], 0.9)], 0.0, 0.1), bank))
    rows = table((bias, right | {"observer_fitted": 0.95}), (bias, wrong | {"observer_fitted": 0.55}))
    assert cell(rows, "the observer, of single effects, from what is fitted") == "0.75 of 2"
    assert cell(rows, "this project's where the observer's from what is fitted is above 0.9") == "1.00 of 1"


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
    row = scores.score(real, said | {"p_unknown_alone": 0.1})
    assert row["correct"]
    assert (row["size_error"], row["size_covered"]) == (pytest.approx(0.1), 1.0)


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
