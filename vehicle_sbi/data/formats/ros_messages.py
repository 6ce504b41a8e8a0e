"""The numbers in ROS messages: where they lie in the bytes of a message, and all messages of a topic at once.

A message is laid out by its definition: CDR aligns every number to its size, counted from the byte after the 4 of the
encapsulation (OMG DDSI-RTPS 2.3, sec. 10.2; sizes up to 8); ROS 1 packs them. Texts and sequences have a length in
front, so two messages lie alike if these lengths do. Definitions are parsed, never compiled: `rosbags` would generate
Python from a file's definitions and execute it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

SIZES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip

LONGEST_ARRAY = 9  # numbers of an array that become columns; longer ones are left out
MOST_FIELDS = 5000  # steps through a message, beyond which it is no measurement
MOST_LAYOUTS = 64  # of one topic, beyond which it is no measurement
DEEPEST = 12


class UnreadableMessageError(ValueError):
    """A message that its definition does not describe, or that holds too much."""


Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, Any]]]]
"""Type -> (constants, fields), as `rosbags` parses them."""


@dataclass
class Layout:
    """Where numbers lie in a message (name, offset, dtype), and the lengths that make it so (offset, dtype, length)."""

    numbers: list[tuple[str, int, str]] = field(default_factory=list)
    lengths: list[tuple[int, str, int]] = field(default_factory=list)

    def fits(self, messages: np.ndarray) -> np.ndarray:
        """Which of the messages (n, bytes) have these lengths."""
        fit = np.ones(len(messages), dtype=bool)
        for offset, dtype, length in self.lengths:
            fit &= _column(messages, offset, dtype) == length
        return fit


class Walk:
    """One walk through the bytes of a message along its definition."""

    def __init__(self, raw: bytes, definitions: Definitions, *, cdr: bool) -> None:
        self.raw, self.definitions, self.cdr = raw, definitions, cdr
        self.origin = 4 if cdr else 0
        self.order = ">" if cdr and len(raw) > 1 and not raw[1] & 1 else "<"
        self.position = self.origin
        self.steps = 0
        self.layout = Layout()

    def message(self, name: str, typename: str, depth: int = 0) -> None:
        """Walk through the fields of a type; UnreadableMessageError if the bytes end before or the type is unknown."""
        if typename not in self.definitions:
            raise UnreadableMessageError(f"the definition of {typename} is not in the bag")
        if depth > DEEPEST:
            raise UnreadableMessageError(f"{typename} is nested too deeply")
        for key, kind in self.definitions[typename][1]:
            self._field(f"{name}.{key}" if name else key, kind, depth)

    def _field(self, name: str, kind: Any, depth: int) -> None:
        node, content = kind
        if node == Nodetype.BASE:
            self._base(name, content[0])
        elif node == Nodetype.NAME:
            self.message(name, content, depth + 1)
        else:
            element, count = content
            if node == Nodetype.SEQUENCE:
                count = self._length()
            self._elements(name, element, count, depth)

    def _elements(self, name: str, element: Any, count: int, depth: int) -> None:
        node, content = element
        if node == Nodetype.BASE and content[0] in SIZES and count > LONGEST_ARRAY:
            size = int(SIZES[content[0]][1])
            self._align(size)
            self._advance(size * count)
            return
        if count > MOST_FIELDS:
            raise UnreadableMessageError(f"{name} holds {count} elements")
        for i in range(count):
            self._field(f"{name}.{i}", element, depth)

    def _base(self, name: str, base: str) -> None:
        if base in ("string", "wstring"):
            self._advance(self._length() * (1 if base == "string" else 2))
            return
        if base not in SIZES:
            raise UnreadableMessageError(f"{name} is of type {base}")
        dtype = self.order + SIZES[base]
        self.layout.numbers.append((name, self._take(dtype), dtype))

    def _length(self) -> int:
        dtype = self.order + "u4"
        offset = self._take(dtype)
        length = int(np.frombuffer(self.raw, dtype, 1, offset)[0])
        self.layout.lengths.append((offset, dtype, length))
        return length

    def _take(self, dtype: str) -> int:
        """The offset of a number of this type, and on to what follows it."""
        size = int(dtype[2])
        self._align(size)
        offset = self.position
        self._advance(size)
        return offset

    def _align(self, size: int) -> None:
        if self.cdr:
            self.position += -(self.position - self.origin) % size

    def _advance(self, size: int) -> None:
        self.position += size
        self.steps += 1
        if self.position > len(self.raw):
            raise UnreadableMessageError("a message ends before its definition does")
        if self.steps > MOST_FIELDS:
            raise UnreadableMessageError("a message has too many fields")


def numbers(raws: Sequence[bytes], typename: str, definitions: Definitions, *, cdr: bool) -> dict[str, np.ndarray]:
    """Every number of a topic's messages, as columns; NaN where a message does not have it.

    Raises UnreadableMessageError if a message is not what its type says, or if they are too various.
    """
    columns: dict[str, np.ndarray] = {}
    layouts = 0
    lengths = np.array([len(raw) for raw in raws])
    for length in np.unique(lengths):
        which = np.flatnonzero(lengths == length)
        messages = np.frombuffer(b"".join(raws[i] for i in which.tolist()), dtype=np.uint8).reshape(len(which), length)
        while len(which):
            layouts += 1
            if layouts > MOST_LAYOUTS:
                raise UnreadableMessageError(f"its messages are of more than {MOST_LAYOUTS} shapes")
            walk = Walk(raws[int(which[0])], definitions, cdr=cdr)
            walk.message("", typename)
            fits = walk.layout.fits(messages)
            if cdr:
                fits &= (messages[:, 1] & 1) == (messages[0, 1] & 1)
            for name, offset, dtype in walk.layout.numbers:
                column = columns.setdefault(name, _empty(len(raws), dtype))
                column[which[fits]] = _column(messages[fits], offset, dtype)
            which, messages = which[~fits], messages[~fits]
    return columns


def _empty(count: int, dtype: str) -> np.ndarray:
    """A column to be filled: whole numbers of stamps stay whole, as floats would round nanoseconds."""
    return np.zeros(count, dtype=np.int64) if dtype[1] in "iu" and dtype[2] == "4" else np.full(count, np.nan)


def _column(messages: np.ndarray, offset: int, dtype: str) -> np.ndarray:
    """The number at `offset` of each message."""
    return np.ascontiguousarray(messages[:, offset : offset + int(dtype[2])]).view(dtype)[:, 0]
