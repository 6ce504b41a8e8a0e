"""An inspection: what a recording's file holds, a mapping of its columns, and what the drive contradicts with it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vehicle_sbi.data.channels import NEEDED
from vehicle_sbi.data.checks.drive import STEERINGS
from vehicle_sbi.data.inspection.contents import Contents, contents
from vehicle_sbi.data.inspection.excitation import excitation
from vehicle_sbi.data.inspection.guess import Guess, guess
from vehicle_sbi.data.mapping import mapping_file
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What was found: `guesses` is empty for a mapping that was given; `lively` says what the drive can tell at most,
    `unread` why it cannot be read."""

    path: Path
    tables: tuple[Contents, ...]
    given: bool
    guesses: tuple[Guess, ...]
    channels: tuple[str, ...]
    lively: tuple[str, ...]
    wrong: tuple[str, ...]
    notes: tuple[str, ...]
    unread: str | None

    @property
    def missing(self) -> tuple[str, ...]:
        """What driving the model by a recorded speed needs, and what is compared by default, that the mapping does not
        have."""
        steered = any(name in self.channels for name in STEERINGS)
        wanted = (*NEEDED["speed"], *RecordingFile.channels)
        return (*(() if steered else ("steering",)), *(name for name in wanted if name not in self.channels))


def inspect(recording: RecordingFile) -> Inspection:
    """Inspect a recording's file with the mapping that it has, or, where it has none, with one that is guessed.

    Raises InputError for a file that cannot be read or has no times; what else is wrong is said in the answer.
    """
    if not isinstance(recording, RecordingFile):
        raise InputError("recording: is no file; recording=FILE, or a name that conf/recording has of one")
    path = Path(recording.path)
    tables = contents(path, time=recording.time, dbc=recording.dbc)
    given = bool(recording.mapping)
    guesses = () if given else guess([column for table in tables for column in table.columns])
    asked = recording if given else replace(recording, mapping=mapping_of(guesses), **_times(recording, tables[0]))
    channels, lively, wrong, notes, unread = _read(asked)
    return Inspection(
        path=path,
        tables=tables,
        given=given,
        guesses=guesses,
        channels=channels,
        lively=lively,
        wrong=wrong,
        notes=notes,
        unread=unread,
    )


def mapping_of(guesses: tuple[Guess, ...]) -> dict[str, dict[str, Any]]:
    """The guesses as a recording's mapping; what a wheel's radius has to be known for is left out."""
    return {one.channel: source_of(one) for one in guesses if not one.needs_radius}


def source_of(one: Guess) -> dict[str, Any]:
    """The settings of one channel's source."""
    columns: str | list[str] = one.columns[0] if len(one.columns) == 1 else list(one.columns)
    unit = {} if one.unit is None else {"unit": one.unit}
    return {"column": columns, **unit, **({"sign": one.sign} if one.sign != 1 else {})}


def _times(recording: RecordingFile, table: Contents) -> Mapping[str, Any]:
    """The time column and unit, where they are not those that readers take by themselves."""
    return time_settings(table) if recording.time is None else {}


def time_settings(table: Contents) -> dict[str, str]:
    """What a recording's settings have to say of the time column."""
    clock = table.clock
    name = {} if clock.usual else {"time": clock.time}
    return name | ({} if clock.time_unit == "s" and clock.understood else {"time_unit": clock.time_unit})


def _read(
    recording: RecordingFile,
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], tuple[str, ...], str | None]:
    """The drive's channels, how lively it is, what it contradicts, what was done to it as it was read, and why it
    cannot be read."""
    if not recording.mapping:
        return (), (), (), (), "no column is recognised as a channel"
    try:
        drive = recording.load()
    except InputError as error:
        mapped = recording.mapping if isinstance(recording.mapping, Mapping) else mapping_file(Path(recording.mapping))
        return tuple(map(str, mapped)), (), (), (), str(error)
    return tuple(drive.channels), excitation(drive), drive.warnings, drive.notes, None
