"""Units as people and loggers write them, and the factor that turns each into SI.

Every factor is exact by definition (SI brochure, 9th edition; international foot, pound and nautical mile of 1959;
standard gravity of the 3rd CGPM). A table and no library: `G`, `1/min` and `°/s` mean here what they mean on a car.
"""

import math
import re
from collections.abc import Mapping
from itertools import product
from types import MappingProxyType

from vehicle_sbi.errors import InputError, unknown

G = 9.80665
FOOT, MILE, NAUTICAL_MILE = 0.3048, 1609.344, 1852.0  # [m]
POUND_FORCE = 0.45359237 * G  # [N]
TURN = 2.0 * math.pi  # [rad]

UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "1": ("1", 1.0), "%": ("1", 0.01),
        "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180.0),
        "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", math.pi / 180.0), "rpm": ("rad/s", math.pi / 30.0),
        "m/s": ("m/s", 1.0), "km/h": ("m/s", 1.0 / 3.6), "mph": ("m/s", 0.44704), "knot": ("m/s", 1852.0 / 3600.0),
        "m/s²": ("m/s²", 1.0), "m/s2": ("m/s²", 1.0), "g": ("m/s²", G),
        "N m": ("N m", 1.0), "Nm": ("N m", 1.0), "kNm": ("N m", 1000.0),
        "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
    }
)  # fmt: skip
"""Unit -> (SI unit, factor), the usual spelling of each: those that messages list."""

TIMES = {
    "s": 1.0,
    "sec": 1.0,
    "sek": 1.0,
    "second": 1.0,
    "ms": 1e-3,
    "min": 60.0,
    "minute": 60.0,
    "h": 3600.0,
    "hr": 3600.0,
}
ANGLES = {
    "rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3,
    "deg": math.pi / 180.0, "degree": math.pi / 180.0, "degrees": math.pi / 180.0, "degs": math.pi / 180.0,
    "grad": math.pi / 180.0,  # German for degree; nobody steers in gon
    "rev": TURN, "turn": TURN,
}  # fmt: skip
LENGTHS = {
    "m": 1.0, "meter": 1.0, "metre": 1.0, "meters": 1.0, "metres": 1.0, "km": 1e3, "kilometers": 1e3, "cm": 1e-2,
    "mm": 1e-3,
    "mile": MILE, "miles": MILE, "mi": MILE, "ft": FOOT, "feet": FOOT, "in": FOOT / 12.0, "nm": NAUTICAL_MILE,
}  # fmt: skip
FORCES = {"n": 1.0, "newton": 1.0, "kn": 1e3, "mn": 1e-3, "dan": 10.0, "kgf": G, "lbf": POUND_FORCE, "lb": POUND_FORCE}
ARMS = {"m": 1.0, "met": 1.0, "meter": 1.0, "metre": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": FOOT, "in": FOOT / 12.0}


def _derived() -> dict[str, tuple[str, float]]:
    """Every combination that is a unit of a channel, in the spelling of `_plain`."""
    found: dict[str, tuple[str, float]] = {}
    for (angle, size), (time, duration) in product(ANGLES.items(), TIMES.items()):
        found[f"{angle}/{time}"] = ("rad/s", size / duration)
    for (length, size), (time, duration) in product(LENGTHS.items(), TIMES.items()):
        found[f"{length}/{time}"] = ("m/s", size / duration)
        found[f"{length}/{time}2"] = found[f"{length}/{time}/{time}"] = ("m/s²", size / duration**2)
        found[f"{length}/{time}/s"] = ("m/s²", size / duration)
    for (force, size), (arm, length) in product(FORCES.items(), ARMS.items()):
        found[f"{force}{arm}"] = found[f"{arm}{force}"] = ("N m", size * length)
    return found


SPELLINGS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        **_derived(),
        **{name: ("rad", size) for name, size in ANGLES.items()},
        **dict.fromkeys(("1", "ratio", "fraction", "bool", "flag"), ("1", 1.0)),
        **dict.fromkeys(("%", "percent", "pct"), ("1", 0.01)),
        **dict.fromkeys(("rpm", "r/min", "u/min", "revs/min", "1/min", "min-1"), ("rad/s", TURN / 60.0)),
        **dict.fromkeys(("rps", "r/s"), ("rad/s", TURN)),
        **dict.fromkeys(("dps", "degs/s"), ("rad/s", math.pi / 180.0)),
        **dict.fromkeys(("kph", "kmh", "kmph", "kmhr", "km/hour"), ("m/s", 1.0 / 3.6)),
        **dict.fromkeys(("mps", "ms-1"), ("m/s", 1.0)),
        **dict.fromkeys(("mph", "miles/hour"), ("m/s", 0.44704)),
        **dict.fromkeys(("knot", "knots", "kn", "kt", "kts"), ("m/s", NAUTICAL_MILE / 3600.0)),
        **dict.fromkeys(("fps",), ("m/s", FOOT)),
        **dict.fromkeys(("mps2", "ms-2", "m/ss", "mpss"), ("m/s²", 1.0)),
        **dict.fromkeys(("g", "gn", "g0", "gee", "gforce", "g-force"), ("m/s²", G)),
        **dict.fromkeys(("mg",), ("m/s²", G / 1000.0)),
        **dict.fromkeys(("gal",), ("m/s²", 0.01)),
        **dict.fromkeys(("newtonmet", "newtonmeter", "newtonmetre", "newtonmeters"), ("N m", 1.0)),
        **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek"), ("s", 1.0)),
        **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), ("s", 1e-3)),
        **dict.fromkeys(("us", "usec", "microsecond", "microseconds"), ("s", 1e-6)),
        **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), ("s", 1e-9)),
    }
)
"""Every other spelling, as `_plain` leaves it."""

BRACKETS = re.compile(r"\s*([\[(])([^\[\]()]+)[\])]\s*$")
"""What stands in brackets at the end of a column's name."""


def in_brackets(name: str) -> str:
    """The unit in brackets at the end of a column's name, "" if there is none.

    Square brackets hold nothing but units, except a number that counts columns; in round ones known units alone count.
    """
    found = BRACKETS.search(name)
    if found is None or (known_unit(found[2]) is None and (found[1] == "(" or found[2].strip().isdigit())):
        return ""
    return found[2]


def not_understood(name: str) -> str:
    """What stands in brackets at the end of a column's name where that is no known unit, else ""."""
    found = BRACKETS.search(name)
    return "" if found is None or known_unit(found[2]) or found[2].strip().isdigit() else found[2].strip()


def without_brackets(name: str) -> str:
    """A column's name without what stands in brackets at its end."""
    return BRACKETS.sub("", name)


def _plain(unit: str) -> str:
    """A unit without what people write differently: case, brackets, blanks, degree signs, powers, dots, `per`."""
    text = unit.strip().strip("[](){}").lower()
    for written, meant in (
        ("²", "2"), ("^", ""), ("**", ""), ("µ", "u"), ("μ", "u"), ("º", "°"), ("°", "deg"), ("degdeg", "deg"),
        (" per ", "/"), ("⁻¹", "-1"), ("⁻2", "-2"), ("·", ""), ("⋅", ""), ("*", ""),
    ):  # fmt: skip
        text = text.replace(written, meant)
    text = re.sub(r"[\s._]+", "", text)
    text = re.sub(r"\((.*)\)", r"\1", text)
    text = re.sub(r"/(sec|second)(?=\d|/|$)", "/s", text)
    text = re.sub(r"/(sec|second|seconds)(?=\d|/|$)", "/s", text)
    text = re.sub(r"^(rad|deg|m|mm|ft|km)s-1$", r"\1/s", text)
    text = re.sub(r"^(m|mm|ft)s-2$", r"\1/s2", text)
    return re.sub(r"(?<=[a-z])-(?=[a-z])", "", text)


def known_unit(unit: str) -> tuple[str, float] | None:
    """The SI unit and factor of a unit in any usual spelling; None if it is none that a channel has."""
    if unit in UNITS:
        return UNITS[unit]
    return SPELLINGS.get(_plain(unit))


def factor(unit: str, si: str, where: str) -> float:
    """What a number in `unit` is multiplied by to be in `si`; InputError if the unit is unknown or of another kind."""
    found = known_unit(unit)
    if found is None:
        raise unknown("unit", unit, UNITS, where)
    if found[0] != si:
        allowed = ", ".join(name for name, (kind, _) in UNITS.items() if kind == si)
        raise InputError(f"{where}: unit '{unit}' does not convert to {si}; allowed: {allowed}")
    return found[1]
