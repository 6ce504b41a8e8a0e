"""Signs and axes: which channel runs against the others, and whether two axes of the accelerometer are swapped.

A flipped channel turns the sign of every relation that it is part of, so the pattern names it where enough is recorded.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from vehicle_sbi.data.checks.drive import ALIKE, LEAST, STEERINGS, UNLIKE, Drive, Finding, relation

TOLD: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "a_y": frozenset({"a_y", "yaw_rate", "v_x"}),
        "a_x": frozenset({"a_x", "v_x"}),
        "steering": frozenset({"steering", "yaw_rate", "v_x"}),
        "steering_wheel": frozenset({"steering_wheel", "yaw_rate", "v_x"}),
    }
)
"""The channel that a relation is named after -> the channels that turn its sign."""

OPPOSITE: Mapping[str, str] = MappingProxyType(
    {"a_y": "v_x times yaw_rate", "a_x": "dv_x/dt", "steering": "yaw_rate", "steering_wheel": "yaw_rate"}
)
EITHER = " Give either sign: -1; a car is symmetric."
COURSES: Mapping[str, str] = MappingProxyType({"turning": "v_x times yaw_rate", "gaining": "dv_x/dt"})


def flipped(drive: Drive) -> Iterator[Finding]:
    """The channel whose sign alone explains what runs against what; else each contradiction by itself."""
    signs = _correlations(drive)
    wrong = frozenset(name for name, correlation in signs.items() if correlation < 0.0)
    if not wrong:
        return
    suspects = [name for name in _channels() if frozenset(r for r in signs if name in TOLD[r]) == wrong]
    if np.nanmedian(drive["v_x"]) >= 0.0:  # cars drive forwards
        suspects = [name for name in suspects if name != "v_x"]
    if len(wrong) > 1 and suspects:
        names, cause = " and ".join(sorted(wrong)), suspects[0]
        listed = ", ".join(f"{signs[name]:.2f}" for name in sorted(wrong))
        yield Finding(
            cause,
            "sign",
            f"{names} have the opposite sign of what {cause} gives (correlations {listed}): is {cause} flipped?",
        )
        return
    for name in sorted(wrong):
        likely = " or ".join(suspects or sorted(TOLD[name] - {"v_x"}))
        also = ", or a_y with yaw_rate" if name in STEERINGS and "a_y" in signs and suspects else ""
        yield Finding(
            (suspects or [name])[0],
            "sign",
            f"{name} has the opposite sign of {OPPOSITE[name]} (correlation {signs[name]:.2f}): "
            f"is {likely}{also} flipped?{EITHER if also else ''}",
        )


def swapped(drive: Drive) -> Iterator[Finding]:
    """Whether one axis of the accelerometer reads what the other should."""
    for course, own, other in (("turning", "a_y", "a_x"), ("gaining", "a_x", "a_y")):
        right, wrong = (relation(drive[name], drive[course], LEAST["a"]) for name in (own, other))
        if wrong is None or abs(wrong.correlation) < ALIKE or (right and abs(right.correlation) > UNLIKE):
            continue
        if right is None and np.isfinite(drive[own]).any():
            continue  # it is recorded, but varies too little to tell
        yield Finding(
            other,
            "axes",
            f"{other} follows {COURSES[course]} (correlation {wrong.correlation:.2f}), and {own} does not: "
            "are the axes swapped?",
        )
        return


def _channels() -> list[str]:
    """Every channel that turns a sign, those that are named after a relation first."""
    return ["a_y", "a_x", *STEERINGS, "yaw_rate", "v_x"]


def _correlations(drive: Drive) -> dict[str, float]:
    """The relations that tell, and their correlations."""
    each = {
        "a_y": relation(drive["a_y"], drive["turning"], LEAST["a"]),
        "a_x": relation(drive["a_x"], drive["gaining"], LEAST["a"]),
    } | {name: relation(drive[name], drive["turn"], LEAST["steering"]) for name in STEERINGS}
    return {name: one.correlation for name, one in each.items() if one is not None and abs(one.correlation) > ALIKE}
