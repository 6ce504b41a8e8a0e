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
TIME = "recording.time"  # which takes a column's name


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """The user's arguments as Hydra reads them."""
    return [word for argument in _with_recording(arguments) for word in _with_file_option(argument)]


def as_typed(overrides: Sequence[str]) -> list[str]:
    """Hydra's overrides as a user types them, the inverse of `spelled_out`: a file in its group's place."""
    pairs = [override.partition("=") for override in overrides]
    files = {key.removesuffix(".path"): _unquoted(value) for key, _, value in pairs if key.endswith(".path")}
    chosen = {group for group, path in files.items() if f"{group}=file" in overrides and is_file(group, path)}
    typed = [
        f"{key.removesuffix('.path')}={_unquoted(value)}" if key.removesuffix(".path") in chosen else _mapping(override)
        for override, (key, _, value) in zip(overrides, pairs, strict=True)
        if not (key in chosen and value == "file")
    ]
    implied = {f"recording={first}" for one in typed if (first := _first_recording(one))}
    return [one for one in typed if one not in implied]


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

    `mapping=PATH` is the path in the place of the recording's mapping. A column's name may hold what Hydra's grammar
    reserves, as in `Time [s]`.
    """
    group, _, value = argument.partition("=")
    if group == TIME and not re.fullmatch(r"[\w.-]*|'.*'|\".*\"", value):
        return [f"{TIME}={json.dumps(value, ensure_ascii=False)}"]
    if group == "mapping" and is_file(group, value):
        return [f"recording.mapping={json.dumps(value)}"]
    return [f"{group}=file", f"{group}.path={json.dumps(value)}"] if is_file(group, value) else [argument]


def _with_recording(arguments: Sequence[str]) -> list[str]:
    """`recordings=[A,…]` chooses `recording=A` too, unless the user does: its settings are how all are read."""
    if any(argument.startswith("recording=") for argument in arguments):
        return list(arguments)
    first = next((name for argument in arguments if (name := _first_recording(argument))), None)
    return [*arguments, f"recording={first}"] if first else list(arguments)


def _first_recording(argument: str) -> str | None:
    """The first of `recordings=[A,…]`, None of any other argument."""
    found = re.fullmatch(r"recordings=\[?\s*['\"]?([^,'\"\[\]]+).*", argument)
    return found[1].strip() if found else None


def _mapping(override: str) -> str:
    """`recording.mapping="PATH"` as `mapping=PATH`, a column of times without quotes, anything else as it is."""
    if override.startswith(f"{TIME}="):
        return f"{TIME}={_unquoted(override.removeprefix(f'{TIME}='))}"
    path = _unquoted(override.removeprefix("recording.mapping="))
    return f"mapping={path}" if path != override and is_file("mapping", path) else override


def _unquoted(value: str) -> str:
    """A text without the quotes that `spelled_out` has put around it."""
    try:
        return str(json.loads(value)) if value.startswith('"') else value
    except json.JSONDecodeError:
        return value
