"""A guessed mapping: which column holds which channel, by the names in common use and by the column's unit."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.checks.drive import ALIKE
from vehicle_sbi.data.checks.limits import LIMITS
from vehicle_sbi.data.inspection.contents import Column
from vehicle_sbi.data.inspection.names import (
    COMMANDS,
    CORNERS,
    EITHER_STEERING,
    EXCLUDED,
    FILTERED,
    LESS,
    NAMES,
    NATIVE,
    NEVER,
    NOT_SPEED,
    NOT_TORQUE,
    OPPOSITE,
    TORQUE,
    WHEEL,
)  # fmt: skip
from vehicle_sbi.data.inspection.units import si, split
from vehicle_sbi.data.units import without_brackets

ROAD_WHEELS_TURN = 0.8  # [rad], 46 degrees: a steering that goes further is the steering wheel's
UNSURE = 2  # rank of a name from which it is unsure
UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
OF_GREAT_VALUES = {"rad": "deg", "rad/s": "deg/s", "m/s": "km/h"}  # what SI would make impossible


@dataclass(frozen=True, kw_only=True)
class Guess:
    """A channel's column (or two, to be summed), its unit, how sure that is and why, and what else it could be.

    `sign` is -1 where the name says an axis to the right or down.
    `needs_radius`: the column is the speed of the rim, and the wheel's radius has to be filled in.
    """

    channel: str
    columns: tuple[str, ...]
    unit: str | None
    unit_from: str
    sure: str
    alternatives: tuple[str, ...] = ()
    sign: int = 1
    needs_radius: bool = False


def guess(columns: Sequence[Column]) -> tuple[Guess, ...]:
    """The mapping that names and units speak for, in the order of CHANNELS; each column is used once."""
    ranked: dict[str, list[tuple[int, Column]]] = {}
    for column in columns:
        found = _channel(column) if column.varies and column.absent <= 0.5 else None
        if found is not None:
            ranked.setdefault(found[0], []).append((found[1], column))
    guesses = [_guess(name, ranked[name]) for name in CHANNELS if name in ranked]
    taken = {one.channel for one in guesses}
    for axle, corners in (("front", ("fl", "fr")), ("rear", ("rl", "rr"))):
        torque = _axle_torque(columns, corners)
        if f"torque_{axle}" not in taken and torque is not None:
            guesses.append(_guess(f"torque_{axle}", [(0, torque[0])], both=torque))
    return tuple(sorted(guesses, key=lambda one: list(CHANNELS).index(one.channel)))


def plain(name: str) -> str:
    """A name without its unit in small letters, words joined by underscores: VehSpdLgt becomes veh_spd_lgt."""
    parted = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", split(name)[0])
    return re.sub(r"[^a-z0-9]+", "_", parted.lower().translate(UMLAUTS)).strip("_")


def _channel(column: Column) -> tuple[str, int] | None:
    """The channel that a column's name speaks for and the rank of the name, 0 the surest; None for no channel.

    What a message or group is called speaks where the field's own name does not; what stands in brackets may say which
    wheel it is, and is left off where no name is found with it.
    """
    if column.name in NATIVE:
        return NATIVE[column.name], -1
    if re.search(COMMANDS, plain(column.name)) or re.search(NEVER, plain(column.field)):
        return None
    whole = (column.field, column.name)
    names = dict.fromkeys(map(plain, (*whole, *map(without_brackets, whole))))
    return next((found for name in names if (found := _called(name, column)) is not None), None)


def _called(name: str, column: Column) -> tuple[str, int] | None:
    """The channel that a plain name speaks for, and its rank."""
    penalty = 10 * bool(re.search(LESS, name) or re.search(FILTERED, plain(column.address)))
    corner = _corner(name)
    if re.search(WHEEL, name) and corner is not None and not re.search(NOT_SPEED, name):
        return _fitting(f"wheel_speed_{corner}", column, penalty)
    for channel, patterns in NAMES.items():
        rank = next((k for k, pattern in enumerate(patterns) if re.search(pattern, name)), None)
        if rank is not None and not _excluded(channel, name, column):
            found = _fitting(channel, column, rank + penalty)
            if found is not None:
                return found
    if re.search(EITHER_STEERING, name) and not re.search(TORQUE, name):
        size = column.largest * (si(column.unit)[1] if column.unit else 1.0)
        return _fitting("steering_wheel" if size > ROAD_WHEELS_TURN else "steering", column, UNSURE + penalty)
    return None


def _excluded(channel: str, name: str, column: Column) -> bool:
    """Names that hold a channel's words and mean something else; a brake's flag is 0 or 1."""
    if channel == "brake":
        return not set(np.unique(column.values[np.isfinite(column.values)])) <= {0.0, 1.0}
    return channel in EXCLUDED and bool(re.search(EXCLUDED[channel], name))


def _corner(name: str) -> str | None:
    return next((at for at, pattern in CORNERS.items() if re.search(pattern, name)), None)


def _fitting(channel: str, column: Column, rank: int) -> tuple[str, int] | None:
    """The channel, unless the column's unit is of another kind; a wheel's speed may be that of its rim."""
    if column.unit is None or channel == "brake":
        return channel, rank
    allowed = {CHANNELS[channel].unit} | ({"m/s"} if channel.startswith("wheel_speed") else set())
    return (channel, rank) if si(column.unit)[0] in allowed else None


def _guess(channel: str, ranked: Sequence[tuple[int, Column]], both: Sequence[Column] = ()) -> Guess:
    """The first of the surest columns, the others as alternatives."""
    order = sorted(ranked, key=lambda one: one[0])
    rank, column = order[0]
    unit, source = column.unit, column.unit_from
    if unit is None and channel != "brake":
        own = CHANNELS[channel].unit
        great = column.largest > LIMITS.get(channel, np.inf) and own in OF_GREAT_VALUES
        unit = OF_GREAT_VALUES[own] if great else own
        source = f"its values go to {max(abs(column.low), abs(column.high)):.3g}" if great else "assumed"
        source += f", as unit '{column.odd_unit}' is not understood" if column.odd_unit else ""
    return Guess(
        channel=channel,
        columns=tuple(one.address for one in both) or (column.address,),
        unit=unit,
        unit_from=source,
        sure="unsure" if rank >= UNSURE else "likely" if column.unit is None and channel != "brake" else "sure",
        alternatives=tuple(_alternative(other, column) for _, other in order[1:]),
        sign=-1 if re.search(OPPOSITE, plain(column.name)) else 1,
        needs_radius=channel.startswith("wheel_speed") and unit is not None and si(unit)[0] == "m/s",
    )


def _alternative(other: Column, chosen: Column) -> str:
    """Another column of the channel, with its sign where that is the opposite of the chosen one's."""
    if len(other.values) != len(chosen.values):
        return other.address
    both = np.isfinite(other.values) & np.isfinite(chosen.values)
    x, y = other.values[both], chosen.values[both]
    if not len(x) or np.ptp(x) == 0.0 or np.ptp(y) == 0.0 or np.corrcoef(x, y)[0, 1] > -ALIKE:
        return other.address
    return f"{other.address} (of opposite sign)"


def _axle_torque(columns: Iterable[Column], corners: tuple[str, str]) -> tuple[Column, ...] | None:
    """The torques of both wheels of an axle, left and right."""
    found: dict[str, Column] = {}
    for column in columns:
        name = plain(column.name)
        corner = _corner(name)
        if corner in corners and column.varies and re.search(TORQUE, name) and not re.search(NOT_TORQUE, name):
            found.setdefault(str(corner), column)
    return tuple(found[at] for at in corners) if len(found) == 2 else None
