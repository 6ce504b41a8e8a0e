"""How much a file may unpack to: a few bytes of zeros, packed again and again, would fill any memory.

Sensor data packs 2 to 10 times, constant channels more. What a file states of its sizes is checked before anything is
read, and what a packer makes of its bytes is counted without being kept, since a hostile file states what it likes.
"""

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from vehicle_sbi.errors import InputError

RATIO = 50
"""What a file unpacks to, in sizes of the file, at most."""

ALWAYS = 256 * 2**20  # [bytes] that any file may unpack to
BLOCK = 2**20  # [bytes] that are unpacked at once
MOST_FRAMES = 1000  # packed pieces one after another in one place; writers make one


class TooLargeError(InputError):
    """More than a file may unpack to."""


class Unpacker(Protocol):
    """What the decompressors of the modules bz2, lz4 and zstd share."""

    @property
    def eof(self) -> bool: ...

    @property
    def needs_input(self) -> bool: ...

    @property
    def unused_data(self) -> bytes | None: ...

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


class Budget:
    """What is left of the bytes that a file may unpack to."""

    def __init__(self, path: Path) -> None:
        size = path.stat().st_size if path.is_file() else sum(one.stat().st_size for one in path.rglob("*"))
        self.path, self.size, self.left = path, size, max(ALWAYS, RATIO * size)
        self.most = self.left

    def take(self, size: int) -> None:
        """Use up `size` bytes; TooLargeError, and none used up, if fewer are left."""
        if size > self.left:
            raise TooLargeError(
                f"{self.path}: unpacks to more than {self.most / 1e6:.0f} MB from {self.size / 1e6:.3g} MB, "
                "which no recording does: it is not read"
            )
        self.left -= size

    def count(self, data: bytes, unpacker: Callable[[], Unpacker]) -> None:
        """Use up what `data` unpacks to, of which nothing is kept; damaged data raises as the unpacker does."""
        for _ in self._pieces(data, unpacker):
            pass

    def unpacked(self, data: bytes, unpacker: Callable[[], Unpacker]) -> bytes:
        """What `data` unpacks to, used up as it grows."""
        return b"".join(self._pieces(data, unpacker))

    def _pieces(self, data: bytes, unpacker: Callable[[], Unpacker]) -> Iterator[bytes]:
        for _ in range(MOST_FRAMES):
            frame = unpacker()
            piece = frame.decompress(data, BLOCK)
            while piece or not (frame.eof or frame.needs_input):
                self.take(len(piece))
                yield piece
                piece = b"" if frame.eof else frame.decompress(b"", BLOCK)
            if not frame.eof:
                raise EOFError("packed data ends early")
            data = frame.unused_data or b""
            if not data:
                return
        raise InputError(f"{self.path}: is packed in more than {MOST_FRAMES} pieces in one place: it is not read")


class Zlib:
    """zlib's decompressor with the others' interface."""

    def __init__(self) -> None:
        self._inner, self._rest = zlib.decompressobj(), b""

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def needs_input(self) -> bool:
        return not self._inner.unconsumed_tail

    @property
    def unused_data(self) -> bytes:
        return b""  # what follows a stream is not unpacked

    def decompress(self, data: bytes, max_length: int) -> bytes:
        return self._inner.decompress(data or self._inner.unconsumed_tail, max_length)
