"""A vehicle that cannot exist is refused in one line that says what was given and where."""

import math
from pathlib import Path
from typing import Any

import jaxtyping
import numpy as np
import pytest
from cars import PAPER

from vehicle_sbi.errors import InputError
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.vehicle import BODY_PRIORS, CONSTANTS, GENERIC_PRIORS, IMU_PLACE, MAY_BE_ZERO, Vehicle, read


@pytest.fixture(autouse=True)
def _types_unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user's program has no type checker in it: what a YAML file holds reaches the vehicle as it is."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"m": -1500.0}, ("m = -1500", "positive")),
        ({"m": 0.0}, ("m = 0", "positive")),
        ({"mu": math.nan}, ("mu = nan", "positive")),
        ({"L": math.inf}, ("L = inf", "finite")),
        ({"m": "1500 kg"}, ("m = '1500 kg'", "a number has to stand there")),
        ({"m": True}, ("m = True", "a number has to stand there")),
        ({"l_f": 2.8, "L": 2.7}, ("l_f = 2.8 m", "L = 2.7 m")),
        ({"l_f": 2.7, "L": 2.7}, ("l_f = 2.7 m", "L = 2.7 m")),
        ({"L": 2417.0}, ("L = 2417 m", "in millimetres?")),
        ({"drive_front": 1.2}, ("drive_front = 1.2", "between 0 and 1")),
        ({"brake_front": -0.1}, ("brake_front = -0.1", "positive")),
        ({"roll_front": 1.2}, ("roll_front = 1.2", "between 0 and 1")),
        ({"m_s": 1600.0, "m": 1500.0}, ("m_s = 1600 kg", "m = 1500 kg")),
        ({"imu_z": math.nan}, ("imu_z = nan",)),
        ({"C_vert": 0.0}, ("C_vert = 0", "positive")),
        ({"steering_ratio": -16.0}, ("steering_ratio = -16", "positive")),
    ],
)
def test_impossible_constant_gets_one_line(wrong: dict[str, Any], said: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        Vehicle(name="shopping cart", **wrong)
    line = str(error.value)
    assert "\n" not in line
    assert all(part in line for part in ("vehicle 'shopping cart'", *said)), line


@pytest.mark.parametrize("name", [name for name in CONSTANTS if name not in IMU_PLACE])
@pytest.mark.parametrize("value", [-1.0, 0.0, math.nan, -math.inf, "much"])
def test_every_constant_is_checked(name: str, value: Any) -> None:
    if value == 0.0 and name in MAY_BE_ZERO:
        assert getattr(Vehicle(name="car", **{name: value}), name) == 0.0
        return
    with pytest.raises(InputError, match=name):
        Vehicle(name="car", **{name: value})


@pytest.mark.parametrize(("name", "usual"), [("drive_front", "1"), ("brake_front", "0.6"), ("K", "inf")])
def test_a_null_for_what_has_to_be_a_number_names_what_leaving_it_out_means(name: str, usual: str) -> None:
    unstated: dict[str, Any] = {name: None}
    with pytest.raises(InputError, match=rf"{name} = null; state a number, or leave the line out for {usual}$"):
        Vehicle(name="car", **unstated)


def test_what_may_be_zero_or_infinite() -> None:
    Vehicle(name="slab", h_cog=0.0, drive_front=0.0, brake_front=0.0, K=math.inf, C_vert=math.inf)


def test_what_is_left_out_is_missing_and_nan_in_the_record() -> None:
    car = Vehicle(name="half known", m=1500.0, L=2.7)
    assert set(car.missing("single_track")) == set(GENERIC_PRIORS) - {"m", "L"}
    assert set(car.missing("full_vehicle")) == {*GENERIC_PRIORS, *BODY_PRIORS} - {"m", "L"}
    record = nominal_record(car)
    assert record["m"] == 1500.0
    assert all(np.isnan(record[name]) for name in car.missing("full_vehicle"))
    assert PAPER.missing("full_vehicle") == ()


def test_nominal_record_rests_at_every_null() -> None:
    record = nominal_record(PAPER)
    assert all(record[field] == p.null for p in EFFECT_PARAMETERS.values() for field in p.fields)
    assert all(record[name] == value for name, value in PAPER.constants().items())


def test_records_set_free_fields_and_nothing_else() -> None:
    space = ParameterSpace((GENERIC_PRIORS["mu"], *EFFECT_PARAMETERS.values()))
    theta = 0.5 * (space.low + space.high)
    nominal = nominal_record(PAPER)
    (record,) = space.records(theta[np.newaxis], nominal)
    free = {field: value for p, value in zip(space.parameters, theta, strict=True) for field in p.fields}
    names = nominal.dtype.names
    assert names is not None
    assert all(np.array_equal(record[n], free.get(n, nominal[n]), equal_nan=True) for n in names)


def test_generic_priors_hold_possible_cars_only() -> None:
    assert GENERIC_PRIORS["l_f"].high < GENERIC_PRIORS["L"].low
    assert all(0.0 < p.low < p.high for p in GENERIC_PRIORS.values())


def test_a_parameter_file_of_ros_is_no_vehicle_file(tmp_path: Path) -> None:
    (tmp_path / "vehicle_info.param.yaml").write_text("/**:\n  ros__parameters:\n    wheel_base: 2.79\n")
    with pytest.raises(InputError, match=r"is a parameter file of ROS; .* wheel_base is L there"):
        read(str(tmp_path / "vehicle_info.param.yaml"))
