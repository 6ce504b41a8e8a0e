"""The command line: users name a file where Hydra wants the group's `file` option and a path."""

from _entry import configuration
from _entry.user_files import config_folders

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from vehicle_sbi.data.formats.registry import FORMATS
from vehicle_sbi.quoting import QUOTED, quoted, unquoted

SUFFIXES: Mapping[str, tuple[str, ...]] = {
    "recording": tuple(FORMATS),
    "vehicle": (".yaml", ".yml"),
    "mapping": (".yaml", ".yml"),
}
"""The groups that take a file, and what its name ends in."""
TIME = "recording.time"  # which takes a column's name


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """The user's arguments as Hydra reads them."""
    own = [*map(Path, config_folders(arguments))]
    return [word for argument in _with_recording(arguments) for word in _with_file_option(argument, own)]


def as_typed(overrides: Sequence[str]) -> list[str]:
    """Hydra's overrides as a user types them, the inverse of `spelled_out`: a file in its group's place."""
    pairs = [override.partition("=") for override in overrides]
    files = {key.removesuffix(".path"): unquoted(value) for key, _, value in pairs if key.endswith(".path")}
    chosen = {group for group, path in files.items() if f"{group}=file" in overrides and is_file(group, path)}
    typed = [
        f"{key.removesuffix('.path')}={unquoted(value)}" if key.removesuffix(".path") in chosen else _unquoted(override)
        for override, (key, _, value) in zip(overrides, pairs, strict=True)
        if not (key in chosen and value == "file")
    ]
    implied = {f"recording={first}" for one in typed if (first := _first_recording(one))}
    return [one for one in typed if one not in implied]


def is_file(group: str, value: str, own: Sequence[Path] = ()) -> bool:
    """Whether `value` means a file rather than an option of the group, from how it is written.

    A recording of an unknown suffix is one too, which its reader then refuses. So is a folder that is there, unless the
    project's configuration, or one of the user's `own` folders of it, has a recording of its name.
    """
    if group not in SUFFIXES or value in ("", "null"):
        return False
    suffix = Path(value).suffix.lower()
    if "/" in value or suffix in SUFFIXES[group]:
        return True
    return group == "recording" and (bool(re.fullmatch(r"\.\w+", suffix)) or _is_folder(value, own))


def _is_folder(value: str, own: Sequence[Path]) -> bool:
    """Whether a folder is there, of a name that no configured recording has; no name is too long to ask."""
    configured = [folder / "recording" / f"{value}.yaml" for folder in (configuration.CONF, *own)]
    return os.path.isdir(value) and not any(map(os.path.isfile, configured))


def _with_file_option(argument: str, own: Sequence[Path]) -> list[str]:
    """`recording=PATH` and `vehicle=PATH` as the group's `file` option and its path, anything else as it is.

    `mapping=PATH` is the path in the place of the recording's mapping. A column's name may hold what Hydra's grammar
    reserves, as in `Time [s]`, and any value letters that it does not know. A parameter may be new to the prior.
    """
    key, equals, value = argument.partition("=")
    key = re.sub(r"^\+?(?=prior\.)", "++", key)
    if is_file(key, unquoted(value), own):
        value = unquoted(value)
    if key == TIME and not re.fullmatch(r"[\w.-]*|'.*'|\".*\"", value):
        return [f"{TIME}={quoted(value)}"]
    if not is_file(key, value, own):
        return [f"{key}{equals}{_with_quotes(value)}"]
    if key == "mapping":
        return [f"recording.mapping={quoted(value)}"]
    return [f"{key}=file", f"{key}.path={quoted(value)}"]


def _with_quotes(value: str) -> str:
    """A word, or a list of words, between quotes if it has letters that Hydra's grammar does not know."""
    words = re.fullmatch(r"\[(.*)\]", value)
    if words and _is_foreign_word(words[1].replace(",", "")):
        return f"[{','.join(quoted(word.strip()) for word in words[1].split(','))}]"
    return quoted(value) if _is_foreign_word(value) else value


def _is_foreign_word(value: str) -> bool:
    """Whether a value is one text with letters that Hydra's grammar does not know: no list, and no values to sweep."""
    return not value.isascii() and not re.search(r"[,'\"()\[\]{}]", value)


def _with_recording(arguments: Sequence[str]) -> list[str]:
    """`recordings=[A,…]` chooses `recording=A` too, unless the user does: its settings are how all are read."""
    if any(argument.startswith("recording=") for argument in arguments):
        return list(arguments)
    first = next((name for argument in arguments if (name := _first_recording(argument))), None)
    return [*arguments, f"recording={first}"] if first else list(arguments)


def _first_recording(argument: str) -> str | None:
    """The first of `recordings=[A,…]`, None of any other argument."""
    found = re.match(rf"recordings=\[?\s*({QUOTED}|[^,'\"\[\]]+)", argument)
    return unquoted(found[1].strip()) if found else None


def _unquoted(override: str) -> str:
    """`recording.mapping='PATH'` as `mapping=PATH`, what was quoted for its letters without quotes, else as it is."""
    if override.startswith(f"{TIME}="):
        return f"{TIME}={unquoted(override.removeprefix(f'{TIME}='))}"
    path = unquoted(override.removeprefix("recording.mapping="))
    if path != override and is_file("mapping", path):
        return f"mapping={path}"
    key, equals, value = override.partition("=")
    word = unquoted(value) if _is_foreign_word(unquoted(value)) else value
    return f"{key.removeprefix('++') if key.startswith('++prior.') else key}{equals}{word}"
