"""The benchmark of whole cars: what is drawn is what is stated, truth stays sealed, and scores are what they say."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from concealed.actuators_and_sensors import sensed
from concealed.multibody_car import STEER, V_X, V_Y, YAW_RATE, parameters
from concealed.outside import OUTSIDE
from concealed.twin import CAR, ROLL_GRADIENT, magic
from measures import shown
from score_files import called, lines_of
from vehiclemodels import vehicle_dynamics_mb
from vehiclemodels.init_mb import init_mb
from whole_car import cases, oracle, page
from whole_car.benchmark import WholeCars
from whole_car.cars import INHERENT, LATERAL, OFF, OWN, RATE, whole_car
from whole_car.cases import base_model, driven
from whole_car.missing import FEWEST, MOST, REAL
from whole_car.scores import Scored, as_line, from_line, scored, standing
from whole_car.scores import parameters as errors_of

from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.vehicle import GRAVITY


def test_every_effect_and_size_is_one_of_the_catalogue_s_within_its_box() -> None:
    assert REAL.keys() <= CATALOGUE.keys()
    for name, one in REAL.items():
        for key, (least, most) in one.sizes.items():
            p = EFFECT_PARAMETERS[f"{name}.{key}"]
            assert p.null is not None
            assert 0.0 < least < most
            assert p.null + most <= p.high
            assert not one.either or p.null - most >= p.low


def test_cars_have_as_much_missing_as_is_stated() -> None:
    cars = [whole_car(np.random.default_rng((0, i))) for i in range(60)]
    for car in cars:
        inside = [name for name in car.effects if name in CATALOGUE]
        assert FEWEST <= len(inside) <= MOST
        assert len(car.effects) - len(inside) <= 1
        assert not {name.split(".")[0] for name in car.base} & set(car.effects)  # what is fitted is not missing
        assert car.peak <= LATERAL[1]
        given: Any = car.given.vehicle
        for name in ("C_alpha_f", "C_alpha_r"):
            assert abs(getattr(given, name) / car.base[name] - 1.0) <= OFF + 1e-4
        for name, (low, high) in car.given.prior.items():
            assert low < car.base[name] < high
    shares = {world: np.mean([car.world_name == world for car in cars]) for world in INHERENT}
    # Binomial: three standard deviations of 60 draws are 0.19.
    assert shares["multi-body car"] == pytest.approx(0.2, abs=0.16)
    assert np.mean([bool(set(car.effects) & set(OUTSIDE)) for car in cars]) == pytest.approx(1 / 3, abs=0.19)
    assert np.mean(["relaxation" in car.effects for car in cars if car.world_name != "multi-body car"]) > 0.5


def test_what_a_world_has_by_itself_is_what_it_does_with_nothing_put_into_it() -> None:
    """The twin whose IMU leans reads what one on a level platform reads with that much of `body_roll`."""
    car = next(car for i in range(9) if (car := whole_car(np.random.default_rng((0, i)))).world_name == "twin")
    twin: Any = car.world
    level, leaning = (replace(twin, on_body=on_body).drive(car.train[0], {}) for on_body in (False, True))
    assert level is not None
    assert leaning is not None
    gain = float(np.dot(leaning["a_y"], level["a_y"]) / np.dot(level["a_y"], level["a_y"]))
    assert gain == pytest.approx(1.0 + GRAVITY * ROLL_GRADIENT, abs=0.02)  # the body lags, and swings a little
    assert "body_roll" in INHERENT["twin, IMU on the body"]
    assert "body_roll" not in INHERENT["twin"]
    assert "accelerometer_scale" in standing({"effects": {}, "inherent": ["body_roll"]})


def test_an_imu_above_a_body_that_leans_is_taken_along() -> None:
    # A roll of A sin(w t) takes what is z above outwards and back: a_y is larger by z w^2 A sin(w t), gravity the same.
    t = np.linspace(0.0, 8.0, 4001)
    w, A, z = 2.0 * np.pi * 0.5, 0.03, 0.5
    names = ("a_x", "a_y", "yaw_rate", "r_dot", "g_x", "g_y", "v_x", "v_y", "wheel_speed_front", "wheel_speed_rear")
    motion = dict.fromkeys(names, np.zeros_like(t)) | {"roll": A * np.sin(w * t), "pitch": np.zeros_like(t)}
    low, high = (sensed(motion, t, {"imu_lever_arm": {"x": 0.0, "y": 0.0, "z": height}})["a_y"] for height in (0.0, z))
    inner = slice(10, -10)  # derivatives at the ends are one-sided
    swayed = z * w**2 * motion["roll"]
    # Twice differenced, a sine of w is short by (w dt)^2 / 3, here 1e-5 of it.
    np.testing.assert_allclose((high - low)[inner], swayed[inner], atol=2e-5 * z * w**2 * A)


def test_a_car_that_is_the_tool_s_own_model_is_one_that_its_oracle_can_follow() -> None:
    """Told what is missing and how large, the model's series are those that were recorded, from straight driving on."""
    car, series = driven(0, 0, {OWN: 1.0})
    assert {"tyre_curve", "lateral_load_transfer"} <= set(car.effects) <= CATALOGUE.keys()
    simulator = base_model(car, series[: len(car.train)])
    own = {f"{name}.{key}": x for name, values in car.effects.items() for key, x in values.items()}
    space = ParameterSpace((*simulator.space.parameters, *(EFFECT_PARAMETERS[name] for name in own)))
    knowing = replace(simulator, space=space)
    null = [EFFECT_PARAMETERS[name].null or 0.0 for name in own]
    with_them, without = knowing.noise_free(np.array([[*car.base.values(), *x] for x in (own.values(), null)]))
    row, first = simulator.windows.channels.index("a_y"), simulator.windows.t.shape[1]
    true = simulator.windows.y[row, :first]
    # commands are straight between samples, torques and steering arrive later: a hundredth of a_y is not followed
    assert np.std(with_them[row, :first] - true) < 0.01 * np.std(true)
    assert np.std(without[row, :first] - true) > 0.1 * np.std(true)


def test_the_twin_s_axles_lose_side_force_as_their_loads_become_uneven() -> None:
    # Both wheels of an axle have half its demand z G, and (1 + s)/2, (1 - s)/2 of its grip: less than with even loads,
    # as the tyre's curve bends downwards.
    even, uneven = (sum(magic_of(0.4, 0.5 * (1.0 + sign * s)) for sign in (-1, 1)) for s in (0.0, 0.4))
    assert uneven < 0.99 * even
    for world in ("twin", "twin, IMU on the body"):
        assert "lateral_load_transfer" in INHERENT[world]


def magic_of(demand: float, grip: float) -> float:
    car = next(car for i in range(9) if (car := whole_car(np.random.default_rng((0, i)))).world_name == "twin")
    world: Any = car.world
    p = np.zeros(1, CAR)
    p["C"], p["E"] = world.C, world.E
    return magic(p[0], demand, grip)


def test_the_multi_body_car_s_front_axle_relaxes_over_a_rolled_length() -> None:
    """Its axles give way sideways: side forces follow the slip angles of the car as C/(1 + i w sigma/v) of one."""
    p, (v, amplitude, w, h) = parameters(2), (15.0, 0.004, 2.0 * np.pi, 2e-3)  # one turn a second

    def rate(x: np.ndarray, t: float) -> np.ndarray:
        return np.array(vehicle_dynamics_mb.vehicle_dynamics_mb(list(x), [amplitude * w * np.cos(w * t), 0.0], p))

    x, rows = np.array(init_mb([0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0], p)), []
    for t in h * np.arange(1500):
        k1 = rate(x, t)
        rows.append((x[STEER], x[V_Y], x[YAW_RATE], k1[V_Y] + x[YAW_RATE] * x[V_X], k1[YAW_RATE]))
        x = x + h * rate(x + 0.5 * h * k1, t + 0.5 * h)
    turns = np.exp(-1j * w * h * np.arange(500, 1500))  # two whole turns, once it has settled
    delta, v_y, r, a_y, r_dot = turns @ np.array(rows)[500:]
    force = (p.m * a_y * p.b + p.I_z * r_dot) / (p.a + p.b)
    sigma = -np.angle(force / (delta - (v_y + p.a * r) / v)) / w * v
    assert 0.1 < sigma < 0.5  # [m]; a tyre without a compliant axle has none
    assert "relaxation" in INHERENT["multi-body car"]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole_car")
    for index in (1, 2):  # of those, none takes long
        cases.build(0, index, folder)
    return folder


def truth_of(folder: Path, index: int) -> dict[str, Any]:
    return json.loads((folder / "sealed" / f"{index:04d}.json").read_text())


def test_a_case_is_a_function_of_its_seed_and_index_and_tells_nothing(built: Path, tmp_path: Path) -> None:
    cases.build(0, 1, tmp_path)
    names = sorted(file.name for file in (built / "cases" / "0001").iterdir())
    for name in names:
        if name != "case.yaml":  # which has the paths
            assert (tmp_path / "cases/0001" / name).read_bytes() == (built / "cases/0001" / name).read_bytes()
    told = (built / "cases/0001/case.yaml").read_text()
    assert not any(f"{effect}." in told for effect in truth_of(built, 1)["effects"])
    assert yaml.safe_load(told)["heldout"] == ["heldout_0.csv"]


@pytest.mark.parametrize("index", [1, 2])
def test_what_shows_beyond_others_is_no_more_than_what_shows(built: Path, index: int) -> None:
    truth = truth_of(built, index)
    for one in truth["effects"].values():
        assert 0.0 <= one["snr_beyond"] <= one["snr"] * (1.0 + 1e-9)
    assert RATE == 50.0


def test_the_oracle_predicts_better_than_who_knows_nothing(built: Path) -> None:
    truth = truth_of(built, 1)
    found = oracle.knowing(built / "cases/0001", truth)
    nothing = oracle.knowing(built / "cases/0001", truth | {"effects": {}, "inherent": []})
    assert found is not None
    assert nothing is not None
    assert sum(found["nrmse"].values()) < sum(nothing["nrmse"].values())


def verdict(effects: dict[str, float], base: dict[str, float]) -> dict[str, Any]:
    one = {name: {"mean": 1.1 * x, "std": 0.05 * x} for name, x in base.items()}
    two = {name: {"mean": 1.02 * x, "std": 0.05 * x, "q05": 0.95 * x, "q95": 1.05 * x} for name, x in base.items()}
    return {
        "effects": effects, "p_unknown": 0.7, "explanations": [], "fit": {"accepted": True},
        "base_parameters": {name: {"before": one[name], "after": two[name], "unit": "1"} for name in base},
    }  # fmt: skip


def test_names_are_held_against_what_is_there_and_what_is_like_it(built: Path) -> None:
    truth = truth_of(built, 1)
    there = next(iter(truth["effects"]))
    truth["effects"][there] |= {"snr": 25.0, "snr_beyond": 20.0, "alike": ["gust"]}
    (built / "sealed" / "0001.json").write_text(json.dumps(truth))
    absent = next(name for name in CATALOGUE if name not in truth["effects"] and name != "gust" and not any(
        name in one["alike"] for one in truth["effects"].values()) and name not in truth["inherent"]
    )  # fmt: skip
    folder = built / "cases/0001/mine"
    folder.mkdir()
    said = {there: 0.4, "gust": 0.6, absent: 0.9}
    (folder / "verdict.json").write_text(json.dumps(verdict(said, truth["base_parameters"])))
    one = scored(built, 1, "mine")
    assert one is not None
    assert set(one.names) == {"gust", absent}
    assert one.wrong == [absent]
    assert (one.strong[there], one.alike[there]) == (0.4, 0.6)
    assert one.before is not None
    assert one.after is not None
    assert one.before.relative == pytest.approx(0.1)
    assert not one.before.held.any()  # twice their standard deviation off
    assert one.after.held.all()
    assert one.after.in_std == pytest.approx(0.4)
    assert one.inclusion.shape == (len(CATALOGUE), 2)
    truth["effects"][there]["snr"] = 1.0  # what hardly shows excuses no name
    assert "gust" not in standing(truth)
    text = page.report({"mine": [one]}, {"mine": [7]}, "python scripts/prove.py mix=whole_car", "here")
    assert "Without an answer, and so in no row: mine 1 (7)." in text
    assert "| names above 0.5 that are not there, a case | 1.00 (1.00 to 1.00; 1) | 0.3 | 0.1 |" in text
    assert len(page.table([one])) == 1
    again = from_line(as_line(one))  # a score that is kept is the same one
    assert page.report({"mine": [again]}, {"mine": [7]}, "python scripts/prove.py mix=whole_car", "here") == text


def test_scores_that_are_kept_stand_for_cases_that_are_not_there(built: Path, tmp_path: Path) -> None:
    kept = WholeCars().kept(built, [1, 2], "mine")
    assert [*kept] == [1]
    file = tmp_path / "whole_car_0_mine.jsonl"
    file.write_text(f"{kept[1]}\n")
    assert lines_of(file) == kept
    assert called(str(file)) == "mine"
    table, text = WholeCars().judged(tmp_path, [1, 2], (str(file),), "a command", "here")
    assert table["case"].tolist() == [1]
    assert "| measure | mine | good | the aim |" in text


def test_a_calibrated_probability_has_no_error_and_a_sure_one_that_is_wrong_all() -> None:
    right = np.array([[0.25, 0.0], [0.25, 0.0], [0.25, 0.0], [0.25, 1.0], [1.0, 1.0]])
    assert page.calibration(right) == pytest.approx(0.0)
    assert page.calibration(np.array([[1.0, 0.0], [0.0, 1.0]])) == pytest.approx(1.0)


def test_names_are_counted_beside_something_unknown_and_without_it_and_by_effect() -> None:
    nothing: dict[str, Any] = {"world": "", "drive": "", "truth": (), "outside": "", "strong": {}, "alike": {}}
    sure = Scored(case=0, names={"gust": 0.9, "payload": 0.7}, wrong=["gust"], p_unknown=0.95, **nothing)
    unsure = Scored(case=1, names={"gust": 0.6}, wrong=[], p_unknown=0.1, **nothing)
    rows = page.compared({"mine": [sure, unsure]})
    first = rows.index[rows["measure"] == "names that are right, p_unknown above 0.9"][0]
    values = [float(cell.split()[0]) for cell in rows["mine"][first : first + 4]]
    assert values == pytest.approx([0.5, 0.8, 1.0, 0.6])
    wrong = page.wrong_names({"mine": [sure, unsure], "other": [unsure]})
    assert wrong.to_dict("records") == [{"effect": "gust", "mine": "1 of 2; 0.5 expected", "other": ""}]


def test_an_estimate_without_an_interval_has_the_normal_one() -> None:
    said = {"a": {"mean": 1.0, "std": 0.1}, "b": {"mean": 1.0, "std": 0.1}}
    found = errors_of({"a": 1.16, "b": 1.17}, said)
    assert found is not None
    assert found.held.tolist() == [True, False]  # 1.645 standard deviations
    assert errors_of({"c": 1.0}, said) is None


def test_an_interval_of_a_measure_holds_its_value_and_narrows_with_cases() -> None:
    def cars(n: int) -> list[Scored]:
        return [
            Scored(
                case=i, world="", drive="", truth=(), outside="", names={}, wrong=["x"] * (i % 2), strong={}, alike={}
            )
            for i in range(n)
        ]  # fmt: skip

    measure = next(m for m in page.MEASURES if "not there" in m.label)
    widths = []
    for n in (10, 1000):
        value, low, high = map(float, re.findall(r"\d\.\d+", shown(measure, cars(n))))
        assert low <= value <= high
        widths.append(high - low)
    assert widths[1] < widths[0]
