"""From a prior file to a box, and the one line that each kind of bad prior gets."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from cars import PAPER
from conftest import ROOT

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.prior import KNOWN, flatten, parameter_space
from vehicle_sbi.inference.proposal import box
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, Vehicle


def test_nested_names_are_joined_by_dots_and_null_takes_a_parameter_out() -> None:
    nested = {"l_f": [1, 2], "aero_drag": {"area": [0, 1]}, "sensor_delay": {"imu": None, "can": [0, 0.1]}, "mu": None}
    assert flatten(nested) == {"l_f": [1, 2], "aero_drag.area": [0, 1], "sensor_delay.can": [0, 0.1]}


def test_a_box_holds_what_the_file_states() -> None:
    space = parameter_space(
        {"l_f": [1, 1.5], "body_roll": {"gradient": [0.0, 0.01]}}, vehicle=PAPER, model="single_track"
    )
    assert space.names == ("l_f", "body_roll.gradient")
    np.testing.assert_array_equal(space.low, [1.0, 0.0])
    np.testing.assert_array_equal(space.high, [1.5, 0.01])
    prior = box(space)
    draws = prior.sample((1000,)).numpy()
    assert (draws >= space.low.astype(np.float32)).all()
    assert (draws <= space.high.astype(np.float32)).all()
    # Uniform: the log density is minus that of the volume (float32).
    inside = torch.tensor([[1.2, 0.004]])
    assert float(prior.log_prob(inside)) == pytest.approx(-np.log(0.5 * 0.01), abs=1e-5)


@pytest.mark.parametrize("name", [file.stem for file in (ROOT / "conf/prior").glob("*.yaml")])
def test_every_prior_file_is_one_for_its_car(name: str) -> None:
    content = yaml.safe_load((ROOT / f"conf/prior/{name}.yaml").read_text())
    car = {"lateral": "volvo_s90", "dart": "dart"}.get(name, "paper")
    vehicle = yaml.safe_load((ROOT / f"conf/vehicle/{car}.yaml").read_text())
    vehicle.pop("_target_")
    assert parameter_space(content, vehicle=Vehicle(**vehicle), model="single_track").names == tuple(flatten(content))


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_brings_its_parameters_unless_the_prior_narrows_them(name: str) -> None:
    own = {p.name: (p.low, p.high) for p in CATALOGUE[name].parameters}
    space = parameter_space({"l_f": [1.0, 1.5]}, vehicle=PAPER, model="single_track", effects=[name])
    assert {p.name: (p.low, p.high) for p in space.parameters[1:]} == own
    first = CATALOGUE[name].parameters[0]
    narrowed = {first.name.partition(".")[0]: {first.name.partition(".")[2]: [first.low, (first.low + first.high) / 2]}}
    space = parameter_space(narrowed, vehicle=PAPER, model="single_track", effects=[name])
    assert len(space) == len(own)
    assert space.parameters[0].high == (first.low + first.high) / 2


def test_null_keeps_a_parameter_of_an_effect_where_the_effect_vanishes() -> None:
    prior = {"l_f": [1.0, 1.5], "body_roll": {"lag": None}}
    space = parameter_space(prior, vehicle=PAPER, model="single_track", effects=["body_roll"])
    assert space.names == ("l_f", "body_roll.gradient", "body_roll.period")


def test_what_the_vehicle_file_leaves_out_gets_a_generic_prior() -> None:
    unknown = replace(PAPER, mu=None, C_alpha_f=None, l_f=None)
    space = parameter_space({"l_f": [1.0, 1.5]}, vehicle=unknown, model="single_track")
    assert space.names == ("l_f", "C_alpha_f", "mu")
    assert space.parameters[0].high == 1.5
    assert space.parameters[1:] == (GENERIC_PRIORS["C_alpha_f"], GENERIC_PRIORS["mu"])


def test_the_usual_box_of_where_the_mass_is_follows_the_wheelbase_that_of_a_stiffness_the_mass() -> None:
    prior = {"l_f": "usual", "C_alpha_f": "usual"}
    for m, L, heavier in ((1500.0, 2.7, 1.0), (7000.0, 3.4, 2.0), (1.58, 0.25, 1.58 / 700.0)):
        car = replace(PAPER, m=m, L=L, l_f=0.5 * L, m_s=None, I_x=None, I_y=None)
        l_f, stiffness = parameter_space(prior, vehicle=car, model="single_track").parameters
        assert (l_f.low, l_f.high) == pytest.approx((0.35 * L, 0.65 * L))
        usual = GENERIC_PRIORS["C_alpha_f"]
        assert (stiffness.low, stiffness.high) == pytest.approx((heavier * usual.low, heavier * usual.high))
    unknown = replace(PAPER, L=None, l_f=None)
    space = parameter_space({"l_f": "usual"}, vehicle=unknown, model="single_track")
    assert space.parameters[0] == GENERIC_PRIORS["l_f"]


def test_a_vehicle_without_any_constant_can_be_inferred_from_generic_priors() -> None:
    assert set(parameter_space({}, vehicle=Vehicle(name="unknown"), model="single_track").names) == set(GENERIC_PRIORS)
    whole = parameter_space({}, vehicle=Vehicle(name="unknown"), model="full_vehicle")
    assert set(whole.names) == {*GENERIC_PRIORS, *BODY_PRIORS}


WRONG: Mapping[str, tuple[dict, str]] = {
    "low above high": ({"l_f": [1.5, 1.0]}, r"prior: l_f = \[1\.5, 1\]; low must be below high"),
    "low is high": ({"l_f": [1.2, 1.2]}, "low must be below high"),
    "not a number": ({"l_f": [float("nan"), 1.2]}, r"prior: l_f = \[nan, 1\.2\]; low must be below high"),
    "infinite": ({"l_f": [1.0, float("inf")]}, r"prior: l_f = \[1, inf\]"),
    "one number": ({"l_f": 1.2}, r"prior: l_f = 1\.2; a prior is a pair \[low, high\]"),
    "text": ({"l_f": "1 to 2"}, r"prior: l_f = '1 to 2'; a prior is a pair \[low, high\]"),
    "three numbers": ({"l_f": [1, 2, 3]}, "a prior is a pair"),
    "words": ({"l_f": ["short", "long"]}, "low and high must be numbers"),
    "unknown": ({"l_r": [1.0, 1.5]}, "prior: unknown parameter 'l_r'; known: l_f, "),
    "misspelt": ({"delta_C_kapa_f": [0, 1]}, "unknown parameter 'delta_C_kapa_f'; known: delta_C_kappa_f, "),
    "unknown effect": ({"aero_drug": {"area": [0, 1]}}, r"unknown parameter 'aero_drug\.area'; known: aero_drag\.area"),
    "l_f behind the rear axle": ({"l_f": [1.0, 2.8]}, r"prior: l_f up to 2\.8 m reaches past the wheelbase 2\.7 m"),
    "wheelbase before the centre of gravity": ({"L": [1.2, 3.0]}, r"l_f up to 1\.3 m reaches past .* 1\.2 m"),
    "l_f past the shortest wheelbase": (
        {"L": [1.4, 3.0], "l_f": [1.0, 1.5]},
        r"l_f up to 1\.5 m reaches past the wheelbase 1\.4 m",
    ),
    "negative": ({"C_alpha_f": [-1.0, 1e5]}, r"prior: C_alpha_f = \[-1, 100000\] reaches C_alpha_f = -1; it must"),
    "offset to below nothing": (
        {"delta_C_alpha_f": [-0.7, 0.3]},
        r"prior: delta_C_alpha_f = \[-0\.7, 0\.3\] reaches C_alpha_f = -10000; it must be positive",
    ),
    "twice": ({"delta_C_kappa": [0, 0.1], "delta_C_kappa_f": [0, 0.1]}, "more than one parameter sets C_kappa_f"),
    "nothing": ({"l_f": None}, "prior: no parameter is free"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_bad_prior_is_one_clear_line(case: str) -> None:
    given, message = WRONG[case]
    with pytest.raises(InputError, match=message) as error:
        parameter_space(given, vehicle=PAPER, model="single_track")
    assert "\n" not in str(error.value)


def test_an_offset_needs_a_constant_to_be_offset_from() -> None:
    unknown = replace(PAPER, C_alpha_f=None)
    with pytest.raises(InputError, match="delta_C_alpha_f is an offset, but vehicle 'paper' states no C_alpha_f"):
        parameter_space({"delta_C_alpha_f": [-0.1, 0.1]}, vehicle=unknown, model="single_track")


def test_one_parameter_of_an_effect_is_freed_by_its_name() -> None:
    space = parameter_space(
        {"l_f": [1.0, 1.5]}, vehicle=PAPER, model="single_track", effects=["sensor_lag.imu", "body_roll"]
    )
    assert space.names == ("l_f", "sensor_lag.imu", *(p.name for p in CATALOGUE["body_roll"].parameters))


def test_what_a_channel_has_beside_its_group_of_sensors_is_free_only_where_it_is_named() -> None:
    def freed(*effects: str) -> tuple[str, ...]:
        sensed = {"a_x": "imu", "a_y": "imu", "yaw_rate": "imu", "v_x": "can"}
        return parameter_space({}, vehicle=PAPER, model="single_track", effects=effects, sensed=sensed).names

    assert freed("sensor_delay") == ("sensor_delay.imu", "sensor_delay.can")
    assert freed("sensor_delay.imu", "sensor_delay.a_y") == ("sensor_delay.imu", "sensor_delay.a_y")


def test_an_unknown_effect_is_refused_with_the_nearest_first() -> None:
    with pytest.raises(InputError, match="effects: unknown effect 'aero_drug'; known: aero_drag, "):
        parameter_space({"l_f": [1.0, 1.5]}, vehicle=PAPER, model="single_track", effects=["aero_drug"])


def test_known_names_are_the_parameters_own() -> None:
    assert all(name == parameter.name for name, parameter in KNOWN.items())
