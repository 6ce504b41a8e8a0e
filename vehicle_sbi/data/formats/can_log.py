"""Logs of raw CAN frames, Vector's BLF and ASC, through `python-can`; a database says what the frames mean."""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import can
import numpy as np

from vehicle_sbi.data.formats.can_frames import Frames, decoded
from vehicle_sbi.data.formats.limits import Budget, Zlib
from vehicle_sbi.data.formats.table import Table, foreign
from vehicle_sbi.errors import InputError

FRAME = 200  # [bytes] that a frame takes as python-can has it, at least
CONTAINER, DEFLATED = 10, 2  # a BLF's object of packed frames, and how they are packed
OBJECT, PACKED = struct.Struct("<4s4xII"), struct.Struct("<H14x")  # how objects and containers begin
LONGEST = 64  # data bytes of a CAN FD frame


def read(path: Path, dbc: Path | None) -> tuple[Table, ...]:
    """A table a message of the database that the log holds; InputError if it is damaged or holds none."""
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty")
    if dbc is None:
        raise InputError(f"{path}: holds raw CAN frames: recording.dbc=FILE.dbc says what they mean")
    with foreign(path, "a CAN log"):
        _check_unpacked(path)
        found, budget = [], Budget(path)
        for message in _messages(path):
            budget.take(FRAME)
            found.append(message)
    if not found:
        raise InputError(f"{path}: holds no CAN frame")
    data = np.zeros((len(found), LONGEST), dtype=np.uint8)
    for row, message in zip(data, found, strict=True):
        row[: len(message.data)] = message.data
    buses = {name: i for i, name in enumerate(sorted({str(one.channel) for one in found}))}
    t = np.array([message.timestamp for message in found])
    frames = Frames(
        t=t - t[0],
        identifiers=np.array([message.arbitration_id for message in found]),
        data=data,
        lengths=np.array([len(message.data) for message in found]),
        bus=np.array([buses[str(message.channel)] for message in found]),
    )
    cut = path.suffix.lower() == ".asc" and b"end triggerblock" not in _end(path).lower()
    notes = (f"{path.name}: has no end mark; the log may have been cut",) if cut else ()
    return tuple(replace(table, notes=(*table.notes, *notes)) for table in decoded(path, frames, dbc))


def _check_unpacked(path: Path) -> None:
    """Raise InputError if the containers of a BLF unpack to too much, or to an object that would be read for ever."""
    if path.suffix.lower() != ".blf":
        return
    budget, left = Budget(path), b""
    with path.open("rb") as file:
        file.seek(struct.unpack("<4xI", file.read(8))[0])
        while len(begin := file.read(OBJECT.size)) == OBJECT.size:
            mark, size, kind = OBJECT.unpack(begin)
            if mark != b"LOBJ" or size < OBJECT.size:
                return  # which python-can refuses
            data = file.read(size - OBJECT.size)
            file.seek(size % 4, os.SEEK_CUR)
            if kind != CONTAINER or len(data) <= PACKED.size:
                continue
            content = data[PACKED.size :]
            if PACKED.unpack_from(data)[0] == DEFLATED:
                budget.count(content, Zlib)
                content = zlib.decompressobj().decompress(content)
            left = _after_whole_objects(left + content, path)


def _after_whole_objects(content: bytes, path: Path) -> bytes:
    """The end of a container's content, which goes on in the next; InputError for an object that has no length, at
    which python-can stays for ever."""
    begin = 0
    while (at := content.find(b"LOBJ", begin, begin + 8)) >= 0 and at + OBJECT.size <= len(content):
        size = OBJECT.unpack_from(content, at)[1]
        if size < OBJECT.size:
            raise InputError(f"{path}: an object of the log states a length of {size} bytes: it is damaged")
        if at + size > len(content):
            break
        begin = at + size
    return content[begin:]


def _end(path: Path) -> bytes:
    """The last bytes of a file."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 200))
        return file.read()


def _messages(path: Path) -> Iterator[can.Message]:
    """The data frames of a log; InputError if a BLF is shorter than it says."""
    if path.suffix.lower() == ".asc":
        with can.ASCReader(path) as reader:
            yield from (one for one in reader if not one.is_error_frame and not one.is_remote_frame)
        return
    with can.BLFReader(path) as reader:
        size = path.stat().st_size
        if reader.file_size > size:
            raise InputError(f"{path}: has {size} bytes of the {reader.file_size} that it states: it is truncated")
        yield from (one for one in reader if not one.is_error_frame and not one.is_remote_frame)
