"""CAN frames decoded with a database (DBC, KCD, SYM, ARXML), through `cantools`: a table a message.

Signals are called `Message.Signal`. All frames of a message are decoded at once: a signal's bits are gathered in the
order that the database gives (least significant first for Intel, most significant first for Motorola byte order) and
scaled. Signals that a multiplexer selects come in a table of their own, with the frames that carry them.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cantools
import numpy as np
from cantools.database.can import Database, Message, Signal
from jaxtyping import Bool, Float, Int, UInt8

from vehicle_sbi.data.formats.table import Table, foreign
from vehicle_sbi.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Frames:
    """CAN frames: times [s], identifiers, data bytes, how many of them count, and a number for their bus."""

    t: Float[np.ndarray, " frames"]
    identifiers: Int[np.ndarray, " frames"]
    data: UInt8[np.ndarray, "frames bytes"]
    lengths: Int[np.ndarray, " frames"]
    bus: Int[np.ndarray, " frames"]

    @classmethod
    def joined(cls, parts: Iterable["Frames"]) -> "Frames":
        """Several groups of frames as one, in the order of time."""
        listed = list(parts)
        widest = max(one.data.shape[1] for one in listed)
        data = np.concatenate([np.pad(one.data, ((0, 0), (0, widest - one.data.shape[1]))) for one in listed])
        t = np.concatenate([one.t for one in listed])
        order = np.argsort(t, kind="stable")
        return cls(
            t=t[order],
            identifiers=np.concatenate([one.identifiers for one in listed])[order],
            data=data[order],
            lengths=np.concatenate([one.lengths for one in listed])[order],
            bus=np.concatenate([one.bus for one in listed])[order],
        )

    def where(self, which: Bool[np.ndarray, " frames"]) -> "Frames":
        return Frames(
            t=self.t[which],
            identifiers=self.identifiers[which],
            data=self.data[which],
            lengths=self.lengths[which],
            bus=self.bus[which],
        )


def decoded(path: Path, frames: Frames, dbc: Path) -> tuple[Table, ...]:
    """A table for each message of the database that is among the frames; InputError if none is."""
    database = _database(dbc)
    tables: list[Table] = []
    for message in database.messages:
        with foreign(dbc, "a CAN database"):
            tables += _message(path, message, frames.where(frames.identifiers == message.frame_id))
    if not tables:
        seen = ", ".join(f"0x{i:X}" for i in np.unique(frames.identifiers)[:8])
        raise InputError(f"{path}: holds none of the {len(database.messages)} messages of {dbc}; it holds {seen}, …")
    return tuple(tables)


def _database(dbc: Path) -> Database:
    with foreign(dbc, "a CAN database"):
        database = cantools.database.load_file(dbc, strict=False, cache_dir=None)
    if not isinstance(database, Database):
        raise InputError(f"{dbc}: is no CAN database")
    return database


def _message(path: Path, message: Message, frames: Frames) -> Iterator[Table]:
    """The signals of a message, those of each multiplexer's value in a table of their own."""
    frames, notes = _on_one_bus(message, frames)
    frames = frames.where(frames.lengths >= min(message.length, frames.data.shape[1]))
    groups: dict[tuple[str | None, tuple[int, ...]], list[Signal]] = {}
    for signal in message.signals:
        groups.setdefault((signal.multiplexer_signal, tuple(signal.multiplexer_ids or ())), []).append(signal)
    for (multiplexer, values), signals in groups.items():
        chosen = frames.where(_selected(message, signals[0], frames))
        if not len(chosen.t):
            continue
        clock = message.name if multiplexer is None else f"{message.name}[{multiplexer}={'|'.join(map(str, values))}]"
        bits = np.unpackbits(chosen.data[:, : message.length], axis=1, bitorder="little")
        yield Table(
            path=path,
            columns={"t": chosen.t, **{f"{message.name}.{one.name}": physical(one, bits) for one in signals}},
            time="t",
            clock=clock,
            units={"t": "s", **{f"{message.name}.{one.name}": one.unit or "" for one in signals}},
            notes=notes,
        )


def _on_one_bus(message: Message, frames: Frames) -> tuple[Frames, tuple[str, ...]]:
    """The frames of the bus that has most of them, and a note if there are several."""
    buses, counts = np.unique(frames.bus, return_counts=True)
    if len(buses) < 2:
        return frames, ()
    kept = buses[np.argmax(counts)]
    note = f"{message.name}: read from bus {kept}, which has most of its frames; {len(buses) - 1} other buses have some"
    return frames.where(frames.bus == kept), (note,)


def _selected(message: Message, signal: Signal, frames: Frames) -> Bool[np.ndarray, " frames"]:
    """The frames that carry a signal: all, or those whose multiplexer (itself carried) has one of its values."""
    which = np.ones(len(frames.t), dtype=bool)
    seen: set[str] = set()
    while signal.multiplexer_signal is not None and signal.multiplexer_signal not in seen:
        seen.add(signal.multiplexer_signal)
        multiplexer = message.get_signal_by_name(signal.multiplexer_signal)
        bits = np.unpackbits(frames.data[:, : message.length], axis=1, bitorder="little")
        which &= np.isin(raw(multiplexer, bits), list(signal.multiplexer_ids or ()))
        signal = multiplexer
    return which


def physical(signal: Signal, bits: UInt8[np.ndarray, "frames bits"]) -> Float[np.ndarray, " frames"]:
    """A signal's physical values: scale raw + offset."""
    values = raw(signal, bits)
    if signal.is_float:
        width = {16: "<f2", 32: "<f4", 64: "<f8"}[signal.length]
        values = values.astype(f"<u{signal.length // 8}").view(width)
    return np.asarray(values, dtype=float) * float(signal.scale) + float(signal.offset)


def raw(signal: Signal, bits: UInt8[np.ndarray, "frames bits"]) -> np.ndarray:
    """A signal's whole numbers, with their sign; `bits` begins with the least significant bit of byte 0."""
    value = np.zeros(len(bits), dtype=np.uint64)
    for exponent, position in enumerate(_positions(signal)):
        value |= bits[:, position].astype(np.uint64) << np.uint64(exponent)
    if not signal.is_signed or signal.is_float:
        return value
    unused = np.uint64(64 - signal.length)
    return (value << unused).view(np.int64) >> np.int64(unused)


def _positions(signal: Signal) -> list[int]:
    """Where a signal's bits lie, the least significant first."""
    if signal.byte_order == "little_endian":
        return list(range(signal.start, signal.start + signal.length))
    positions = [signal.start]
    while len(positions) < signal.length:
        last = positions[-1]
        positions.append(last - 1 if last % 8 else last + 15)
    return positions[::-1]
