"""Files to edit after an inspection: NAME.mapping.yaml, which reading takes, and NAME.vehicle.yaml.

What every car's papers say (mass, wheelbase, steering ratio, driven axle) stands there as a text that no run accepts;
the rest may stay unknown.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.inspection.guess import Guess
from vehicle_sbi.data.inspection.inspection import Inspection, source_of
from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS, IMU_PRIORS, MEANINGS

PRIORS = {**GENERIC_PRIORS, **BODY_PRIORS, **IMU_PRIORS}
UNEDITED = "a number, or null"
RADIUS = 0.3  # [m], only to show where it goes: the line is a comment
UNITS = {
    "I_z": "kg m^2",
    "C_vert": "N/m",
    "K": "N/m",
    **dict.fromkeys(("steering_ratio", "drive_front", "brake_front"), "1"),
}
DRIVEN = "1 front, 0 rear, between if both"
USUAL = {"drive_front": json.dumps(DRIVEN), "brake_front": "0.6", "C_vert": ".inf", "K": ".inf"}
ADVICE = {"mu": "on dry asphalt state 0.95"}
"""Constants of which a value is known that is better than the range of their priors."""

EXAMPLES = {"v_x": "km/h", "a_y": "m/s2", "yaw_rate": "deg/s"}
"""Channels that every diagnosis needs, beside a steering, with a unit that a logger may have."""


def write(
    inspection: Inspection, folder: Path, *, vehicle: Path | None = None, overwrite: bool = False
) -> tuple[Path, Path]:
    """Write the mapping, and the vehicle file unless one is given; InputError, and nothing written, where one of them
    exists."""
    stem = inspection.path.stem
    files = {folder / f"{stem}.mapping.yaml": mapping_text(inspection)}
    if vehicle is None:
        text = vehicle_text(stem, steered="steering_wheel" in inspection.channels)
        files[folder / f"{stem}.vehicle.yaml"] = text
    existing = [path for path in files if path.exists()]
    if existing and not overwrite:
        listed = " and ".join(map(str, existing))
        raise InputError(f"{listed}: exists, left as it is; overwrite=true replaces it, to=FOLDER writes elsewhere")
    for path, text in files.items():
        write_text(path, text)
    mapping, *own = files
    return mapping, vehicle or own[0]


def write_vehicle(inspection: Inspection, folder: Path) -> tuple[Path, bool]:
    """The vehicle file, written unless it is there: what a given mapping leaves to edit. Whether it was written."""
    stem = inspection.path.stem
    path = folder / f"{stem}.vehicle.yaml"
    absent = not path.exists()
    if absent:
        write_text(path, vehicle_text(stem, steered="steering_wheel" in inspection.channels))
    return path, absent


def mapping_text(inspection: Inspection) -> str:
    """The guessed mapping, a line a channel, with how sure it is and what else there is."""
    absent = [name for name in CHANNELS if name not in [one.channel for one in inspection.guesses]]
    return "\n".join(
        [
            f"# Which column of {inspection.path.name} holds which channel, as its names suggest: check each line.",
            "# value = sign (scale unit(column) + offset), the offset in SI; group: imu, can or wheel_speed.",
            "# Signs are ISO 8855: x forward, y left, z up. In a left turn steering, yaw rate and a_y are positive;",
            "# sign: -1 turns a channel that is not. Look at one turn: mirrored in all three it passes every check.",
            *map(_line, inspection.guesses),
            *(f'# {name}: {{column: "its column", unit: {unit}}}' for name, unit in EXAMPLES.items() if name in absent),
            f"# not recognised: {', '.join(absent)}",
            "",
        ]
    )


def vehicle_text(name: str, *, steered: bool) -> str:
    """Every constant of a vehicle with its unit; unknown ones are null, and a prior stands for them."""
    return "\n".join([*_vehicle_lines(name, steered), ""])


def _line(one: Guess) -> str:
    settings = source_of(one) | ({"wheel_radius": RADIUS} if one.needs_radius else {})
    listed = ", ".join(f"{key}: {_yaml(value)}" for key, value in settings.items())
    why = "" if one.unit is None else f", unit {one.unit_from}"
    others = f"; or {', '.join(one.alternatives)}" if one.alternatives else ""
    radius = "; the rim's speed: uncomment with the wheel's radius [m]" if one.needs_radius else ""
    return f"{'# ' if one.needs_radius else ''}{one.channel}: {{{listed}}} # {one.sure}{why}{others}{radius}"


def _yaml(value: object) -> str:
    """A value inside braces, a text in quotes unless it is a plain word."""
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    text = str(value)
    plain = not isinstance(value, str) or re.fullmatch(r"[A-Za-z_][\w/²]*( m)?", text)
    return text if plain and text.lower() not in ("yes", "no", "on", "off", "y", "n", "null", "true", "false") else (
        json.dumps(text, ensure_ascii=False)
    )  # fmt: skip


def _vehicle_lines(name: str, steered: bool) -> Iterator[str]:
    yield f"# The vehicle of {name}: fill in what you know. null: not known, a prior over the range stands for it."
    yield "# l_f, C_alpha_f and C_alpha_r are inferred whatever stands here. On the command line prior.l_f=null takes"
    yield "# the value here as exact, and 'prior.C_alpha_f=[low,high]' states the range that you know. Ranges below are"
    yield "# usual ones; a run's prior may state others, which its table shows."
    yield f"name: {_yaml(name)}"
    for constant, what in MEANINGS.items():
        if constant == "track_f":
            yield "# from here on, what only model=full_vehicle has"
        asked = constant in ("m", "L") or (constant == "steering_ratio" and steered)
        prior = PRIORS.get(constant)
        unit = UNITS.get(constant) or (prior.unit if prior else "1")
        span = f"; usually {prior.low:g} to {prior.high:g}" if prior and constant not in IMU_PRIORS else ""
        span += f"; {ADVICE[constant]}" if constant in ADVICE else ""
        value = json.dumps(UNEDITED) if asked else USUAL.get(constant, "null")
        yield f"{constant}: {value} # [{unit}] {what}{span}"
