"""Recordings of one vehicle that are read together: each with its file, under a name of its own."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError

Read = list[tuple[RecordingFile, Recording]]


def read(given: Sequence[str | RecordingFile], shared: RecordingFile) -> Read:
    """Recordings with the files that they come from: paths with the settings of `shared`, others with their own."""
    files = [replace(shared, path=one, name=None) if isinstance(one, str) else one for one in given]
    return [(file, file.load()) for file in files]


def check_once(fitted: Read, held: Read) -> None:
    """InputError for data that is given twice, whatever its file is called; two stretches of a file are other data."""
    used, apart = (
        [(recording.source, (*recording.files.values(), file.start_s, file.stop_s)) for file, recording in part]
        for part in (fitted, held)
    )
    counts = Counter(data for _, data in used)
    for where, recordings, known, why in (
        ("heldout", apart, counts, "is also fitted; hold out another recording"),
        ("recordings", used, [k for k, n in counts.items() if n > 1], "would count twice: it is the same data"),
    ):
        if twice := sorted({source for source, data in recordings if data in known}):
            raise InputError(f"{where}: {', '.join(twice)} {why}")


def under_own_names(*parts: Read) -> list[Read]:
    """Recordings by their names, or by their paths where several have the same."""
    names = Counter(recording.name for part in parts for _, recording in part)
    return [
        [(file, one if names[one.name] == 1 else replace(one, name=one.source)) for file, one in part] for part in parts
    ]
