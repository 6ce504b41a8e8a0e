"""Units in the spellings of loggers mean what they mean on a car, and what is ambiguous or none is not guessed."""

import numpy as np
import pytest

from vehicle_sbi.data.units import SPELLINGS, factor, known_unit

EQUAL = {
    ("m/s²", 1.0): "m/s^2 m/s2 m/s/s m/s**2 m/sec² m/sec^2 (m/s²) m·s^-2 m.s-2 mps2",
    ("m/s²", 9.80665): "g G gn g0",
    ("m/s²", 0.00980665): "mg mG",
    ("m/s²", 0.3048): "ft/s² ft/s^2",
    ("m/s²", 1.0 / 3.6): "km/h/s",
    ("rad/s", 1.0): "rad/s rad/sec rad.s-1 rad*s^-1",
    ("rad/s", np.pi / 180.0): "deg/s °/s º/s °/sec deg/sec degrees/second Deg/S dps [deg/s] Grad/s grad/s Grad/sec",
    ("rad/s", np.pi / 30.0): "rpm RPM 1/min U/min r/min rev/min min-1 min^-1",
    ("m/s", 1.0 / 3.6): "km/h kph kmh KPH km/hr kmph",
    ("m/s", 0.44704): "mph MPH mi/h mile/h",
    ("m/s", 1852.0 / 3600.0): "kt kts knots kn",
    ("m/s", 1.0): "m/s mps m/sec meter/sec",
    ("m/s", 0.001): "mm/s",
    ("rad", np.pi / 180.0): "deg ° degree degrees Deg Grad grad",
    ("rad", 1e-3): "mrad",
    ("N m", 1.0): "Nm N·m N*m N-m N.m NewtonMet",
    ("N m", 1000.0): "kNm kN·m",
    ("N m", 0.3048 * 0.45359237 * 9.80665): "lbf·ft lb-ft ft-lb lbf*ft ftlb",
    ("1", 0.01): "% percent",
    ("s", 1e-3): "ms msec",
    ("s", 1e-6): "us µs μs",
}


@pytest.mark.parametrize("meant", EQUAL, ids=str)
def test_spellings_mean_the_same(meant):
    for spelling in EQUAL[meant].split():
        found = known_unit(spelling)
        assert found is not None, spelling
        assert found[0] == meant[0], spelling
        assert found[1] == pytest.approx(meant[1], rel=1e-12), spelling


@pytest.mark.parametrize(
    "unit", ["", "bar", "V", "°C", "C", "m^2", "(m/s)^2", "m/s^3", "rad/s^2", "1/s", "Hz", "m", "kg", "x"]
)
def test_what_is_no_unit_of_a_channel_is_not_guessed(unit):
    assert known_unit(unit) is None


def test_every_spelling_is_found_as_it_is_kept():
    assert [one for one in SPELLINGS if known_unit(one) is None] == []


def test_a_factor_is_of_the_kind_that_is_asked_for():
    assert factor("°/s", "rad/s", "") * 180.0 == pytest.approx(np.pi)
