"""The command line: users name a file where Hydra wants the group's `file` option and a path."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

SUFFIXES: Mapping[str, tuple[str, ...]] = {
    "recording": (".csv", ".txt", ".parquet", ".vbo"),
    "vehicle": (".yaml", ".yml"),
}
"""The groups that take a file, and what its name ends in."""


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """The user's arguments as Hydra reads them."""
    return [word for argument in _with_recording(arguments) for word in _with_file_option(argument)]


def is_file(group: str, value: str) -> bool:
    """Whether `value` means a file rather than an option of the group, from how it is written."""
    return group in SUFFIXES and ("/" in value or Path(value).suffix.lower() in SUFFIXES[group])


def _with_file_option(argument: str) -> list[str]:
    """`recording=PATH` and `vehicle=PATH` as the group's `file` option and its path, anything else as it is."""
    group, _, value = argument.partition("=")
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
