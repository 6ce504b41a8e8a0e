"""Units at the end of a column's name: `a_y_mps2`, `Speed [km/h]`, `G lat (g)`, `yaw_rate_deg_s`."""

import re

from vehicle_sbi.data.units import UNITS, known_unit

BRACKETED = re.compile(r"(.+?)\s*(?:\[([^\]]+)\]|\(([^)]+)\)|\bin\s+(\S+))\s*")
WORDS = re.compile(r"[\s_.]+")
IN_NAMES = {"ms": "m/s", "ms2": "m/s2", "radps": "rad/s", "degps": "deg/s"}  # what other columns than times mean by it


def split(column: str, *, is_time: bool = False) -> tuple[str, str | None]:
    """A column's name without the unit that it ends in, and that unit (None: it ends in none)."""
    bracketed = BRACKETED.fullmatch(column.strip())
    if bracketed:
        unit = called(next(part for part in bracketed.groups()[1:] if part))
        return (bracketed[1], unit) if unit else (column, None)
    words = [word for word in WORDS.split(column) if word]
    for length in (3, 2, 1):  # the longest first: deg_per_s, rad_s, deg
        last = [word.lower() for word in words[-length:]]
        if len(words) <= length or last[0].isdigit():
            continue
        for written in ("/".join(last), " ".join(last)):
            unit = called(written if is_time else IN_NAMES.get(written, written))
            if unit is not None:
                return "_".join(words[:-length]), unit
    return column, None


def called(written: str | None) -> str | None:
    """The usual name of a unit, as a mapping may say it; None for what no channel has as a unit."""
    meant = known_unit(written) if written and written.strip() else None
    if written is None or meant is None:
        return None
    return next((name for name, one in UNITS.items() if one == meant), written.strip())


def si(unit: str) -> tuple[str, float]:
    """The SI unit that a known unit converts to, and the factor."""
    return known_unit(unit) or ("1", 1.0)
