"""The command line: users name a file where Hydra wants the group's `file` option and a path."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from vehicle_sbi.data.formats.registry import FORMATS

SUFFIXES: Mapping[str, tuple[str, ...]] = {
    "recording": tuple(FORMATS),
    "vehicle": (".yaml", ".yml"),
    "mapping": (".yaml", ".yml"),
}
"""The groups that take a file, and what its name ends in."""


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """The user's arguments as Hydra reads them."""
    return [word for argument in _with_recording(arguments) for word in _with_file_option(argument)]


def is_file(group: str, value: str) -> bool:
    """Whether `value` means a file rather than an option of the group, from how it is written.

    A recording of an unknown suffix is one too, which its reader then refuses, and so is the folder of a ROS bag.
    """
    if group not in SUFFIXES or value in ("", "null"):
        return False
    suffix = Path(value).suffix.lower()
    recorded = group == "recording" and (bool(re.fullmatch(r"\.\w+", suffix)) or Path(value, "metadata.yaml").is_file())
    return "/" in value or suffix in SUFFIXES[group] or recorded


def _with_file_option(argument: str) -> list[str]:
    """`recording=PATH` and `vehicle=PATH` as the group's `file` option and its path, anything else as it is.

    `mapping=PATH` is the path in the place of the recording's mapping.
    """
    group, _, value = argument.partition("=")
    if group == "mapping" and is_file(group, value):
        return [f"recording.mapping={json.dumps(value)}"]
    return [f"{group}=file", f"{group}.path={json.dumps(value)}"] if is_file(group, value) else [argument]


def _with_recording(arguments: Sequence[str]) -> list[str]:
    """`recordings=[A,…]` chooses `recording=A` too, unless the user does: its settings are how all are read."""
    if any(argument.startswith("recording=") for argument in arguments):
        return list(arguments)
    for argument in arguments:
        first = re.fullmatch(r"recordings=\[?\s*['\"]?([^,'\"\[\]]+).*", argument)
        if first:
            return [*arguments, f"recording={first[1].strip()}"]
    return list(arguments)
