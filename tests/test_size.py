"""Boxes fit the car: nothing changes among passenger cars, and beyond them what has a unit scales as bodies do."""

from dataclasses import replace

import pytest
from cars import PAPER

from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.size import POWERS, Size, size_of
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, GRAVITY

ALL = [*EFFECT_PARAMETERS.values(), *GENERIC_PRIORS.values(), *BODY_PRIORS.values()]


@pytest.mark.parametrize(("m", "L"), [(700.0, 2.2), (1500.0, 2.7), (3500.0, 3.5), (None, 2.5), (1200.0, None)])
def test_a_passenger_car_has_the_boxes_of_passenger_cars(m: float | None, L: float | None) -> None:
    size = size_of(m, L)
    assert all(size.fitted(p) == p for p in ALL)


def test_what_is_not_known_of_a_car_is_told_from_the_rest() -> None:
    assert size_of(None, None) == size_of(float("nan"), float("nan")) == Size()
    assert size_of(None, 0.27).length == pytest.approx(0.27 / 2.2)
    assert size_of(None, 0.27).mass == pytest.approx(1.5 / 700.0)  # a tenth as long, a thousandth of the mass
    assert size_of(18e3, None).length == pytest.approx(2.7 * 12.0 ** (1 / 3) / 3.5)


@pytest.mark.parametrize(
    ("m", "L"), [(18e3, 6.0), (12e3, 6.1), (8e3, 4.5), (3.5, 0.33), (1.58, 0.175)]
)  # lorry, bus, van, F1TENTH, JetRacer
def test_the_box_of_an_unknown_mass_holds_that_of_real_cars_of_a_wheelbase(m: float, L: float) -> None:
    box = size_of(None, L).fitted(GENERIC_PRIORS["m"])
    assert 1.2 * box.low < m < box.high / 1.2  # and not at its rim


@pytest.mark.parametrize("p", [p for p in ALL if p.unit in POWERS], ids=lambda p: p.name)
def test_two_cars_that_are_alike_have_boxes_that_are_alike(p: Parameter) -> None:
    """Powers of mass and length are those of the unit, time as sqrt(length/g): what has no unit left is the same."""
    powers = {"N": (1, 1, -2), "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "rad": (0, 0, 0), "1": (0, 0, 0)}
    mass = length = time = 0.0
    over = 1.0
    for word in p.unit.replace("/", " / ").split():
        if word == "/":
            over = -1.0
            continue
        name, _, power = word.partition("^")
        each = [over * float(power or 1) * one for one in powers[name]]
        mass, length, time = mass + each[0], length + each[1], time + each[2]
    assert POWERS[p.unit] == (mass, length + 0.5 * time)  # s = sqrt(m / g)


def test_a_toy_car_carries_a_load_of_its_own_size() -> None:
    toy = replace(PAPER, m_s=1.2, m=1.58, L=0.1735, l_f=0.08)
    effects = ["payload", "yaw_moment", "imu_lever_arm", "gust"]
    space = parameter_space({"mu": [0.5, 1.0]}, vehicle=toy, model="single_track", effects=effects)
    box = {p.name: p for p in space.parameters}
    assert toy.m is not None
    assert toy.L is not None
    assert 0.1 * toy.m < box["payload.mass"].high < toy.m
    assert 0.01 < box["yaw_moment.moment"].high / (toy.m * GRAVITY * toy.L) < 0.2
    assert box["imu_lever_arm.x"].high < toy.L
    assert box["gust.duration"] == EFFECT_PARAMETERS["gust.duration"]


def test_a_stated_box_stays_as_stated() -> None:
    lorry = replace(PAPER, m=18e3, L=5.5, l_f=2.0)
    stated = {"payload": {"mass": [0.0, 100.0]}}
    space = parameter_space(stated, vehicle=lorry, model="single_track", effects=["payload"])
    assert space.parameters[0].high == 100.0
    assert [p.high for p in space.parameters[1:]] == [pytest.approx(1.5 * 5.5 / 3.5)]


def test_every_unit_that_a_size_of_the_car_enters_scales() -> None:
    free = {"rad", "1", "s", "m/s^2", "rad/s", "rad/(m/s^2)", "1/(m/s^2)^2"}
    assert {p.unit for p in ALL} <= free | set(POWERS)
