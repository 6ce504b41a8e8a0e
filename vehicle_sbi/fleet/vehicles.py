"""Whose recordings a folder holds: a subfolder for each vehicle, or a file.

FOLDER/NAME/*.csv …          recordings of the vehicle NAME, those in FOLDER/NAME/heldout/ held out
FOLDER/NAME.csv              one recording of the vehicle NAME
vehicle.yaml, mapping.yaml   in a subfolder its own, in FOLDER those of all that have none
NAME.vehicle.yaml, NAME.mapping.yaml   of a single file, as `inspect` writes them

What describes a folder is no recording: README and LICENSE of any suffix, and a .txt without a row of numbers.
"""

import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from vehicle_sbi import plain_yaml
from vehicle_sbi.data.formats.registry import FORMATS, format_of
from vehicle_sbi.errors import InputError
from vehicle_sbi.quoting import quoted

HELD_OUT = "heldout"
DESCRIBED = ("vehicle", "mapping", "options")  # by a file of each
DESCRIBING = ("README", "LICENSE")  # what the names of files begin with that are no recordings
FIRST_LINES = 200  # of a .txt, among which a recording has numbers


@dataclass(frozen=True, kw_only=True)
class Member:
    """A vehicle of a fleet: its recordings, and what describes it (None: what the options of all say)."""

    name: str
    recordings: tuple[Path, ...]
    heldout: tuple[Path, ...] = ()
    vehicle: Path | None = None
    mapping: Path | None = None
    options: tuple[str, ...] = ()

    @property
    def words(self) -> list[str]:
        """What a diagnosis is asked on its command line."""
        described = {"vehicle": self.vehicle, "mapping": self.mapping}
        return [
            _listed("recordings", self.recordings),
            *([_listed("heldout", self.heldout)] if self.heldout else []),
            *(f"{name}={path}" for name, path in described.items() if path is not None),
            *self.options,
        ]


def members(folder: Path) -> list[Member]:
    """Every vehicle of a folder by name; InputError where there is none, or where two have the same name."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    entries = sorted(path for path in folder.resolve().iterdir() if not path.name.startswith("."))
    found = [one for path in entries if (one := _member(path, folder.resolve())) is not None]
    if not found:
        raise InputError(f"{folder}: no recordings here or in subfolders; what is read: {', '.join(FORMATS)}")
    names = [one.name for one in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{folder}: two vehicles are called {twice[0]}; rename one of them")
    return found


def _member(path: Path, fleet: Path) -> Member | None:
    """The vehicle of a subfolder or of a file, if there is any."""
    alone = _is_recording(path)
    recordings = (path,) if alone else _recordings(path)
    if not recordings:
        return None
    vehicle, mapping, options = (
        _first(path.with_suffix(f".{name}.yaml") if alone else path / f"{name}.yaml", fleet / f"{name}.yaml")
        for name in DESCRIBED
    )
    return Member(
        name=path.stem if alone else path.name,
        recordings=recordings,
        heldout=() if alone else _recordings(path / HELD_OUT),
        vehicle=vehicle,
        mapping=mapping,
        options=_options(options),
    )


def _options(file: Path | None) -> tuple[str, ...]:
    """The words of a file; InputError for anything else than a list of them."""
    try:
        words = [] if file is None else plain_yaml.load(file)
    except plain_yaml.UnreadableYaml as error:
        raise InputError(f"{file}: {error}") from None
    if not (isinstance(words, list) and all(isinstance(word, str) and "=" in word for word in words)):
        raise InputError(f"{file}: it must be a list of options, `- window_s=5` a line")
    return tuple(words)


def _is_recording(path: Path) -> bool:
    """Whether a file is of a known format and holds more than words, or a folder is of one."""
    if path.is_dir():
        return _is_read(path)
    if path.suffix.lower() not in FORMATS or path.name.upper().startswith(DESCRIBING):
        return False
    return path.suffix.lower() != ".txt" or _has_numbers(path)


def _is_read(folder: Path) -> bool:
    """Whether a folder itself is what a reader takes."""
    try:
        format_of(folder)
    except InputError:
        return False
    return True


def _has_numbers(path: Path) -> bool:
    """Whether one of the first rows of a text has two or more numbers between its separators."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return any(sum(map(_is_number, re.split(r"[,;\t]", row))) >= 2 for row in islice(file, FIRST_LINES))
    except OSError:
        return True  # its reader says why it cannot be read


def _is_number(field: str) -> bool:
    try:
        float(field.strip(' "\n'))
    except ValueError:
        return False
    return True


def _recordings(folder: Path) -> tuple[Path, ...]:
    return tuple(sorted(path for path in folder.iterdir() if _is_recording(path))) if folder.is_dir() else ()


def _first(*paths: Path) -> Path | None:
    return next((path for path in paths if path.is_file()), None)


def _listed(key: str, paths: tuple[Path, ...]) -> str:
    """`key=['a','b']` as Hydra reads it, whatever is in the names."""
    return f"{key}=[{','.join(quoted(str(path)) for path in paths)}]"
