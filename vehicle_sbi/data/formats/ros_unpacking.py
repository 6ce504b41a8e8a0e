"""Chunks, messages and files of ROS bags, unpacked within a budget: `rosbags` itself unpacks whatever it is given.

It looks its unpackers up in tables of its modules, which hold ours while a bag is read (one bag at a time).
"""

import bz2
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2 import reader as ros2
from rosbags.rosbag2 import storage_mcap as mcap

from vehicle_sbi.data.formats.limits import Budget, Unpacker

zstd: Any = vars(ros2)["zstd"]  # of the standard library, or its backport
lz4: Any = LZ4FrameDecompressor  # whose types say None of what has begun


@contextmanager
def bounded(budget: Budget) -> Iterator[None]:
    """What `rosbags` unpacks inside uses the budget up; InputError when it is spent."""

    def unpacker(kind: Callable[[], Unpacker]) -> Callable[..., bytes]:
        return lambda data, *_: budget.unpacked(bytes(data), kind)

    of_zstd, of_lz4 = unpacker(zstd.ZstdDecompressor), unpacker(lz4)
    with ExitStack() as replaced:
        for tables, unpackers in (
            (mcap.DECOMPRESSORS, {"zstd": of_zstd, "lz4": of_lz4}),
            (ros1.decompressors, {"bz2": unpacker(bz2.BZ2Decompressor), "lz4": of_lz4}),
        ):
            replaced.enter_context(patch.dict(tables, unpackers))
        packed = SimpleNamespace(decompress=of_zstd, open=lambda file, mode: Unpacking(budget, zstd.open(file, mode)))
        replaced.enter_context(patch.object(ros2, "zstd", packed))
        yield


class Unpacking:
    """A packed file that is read within a budget."""

    def __init__(self, budget: Budget, file: Any) -> None:
        self.budget, self.file = budget, file

    def __enter__(self) -> "Unpacking":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def read(self, size: int = -1) -> bytes:
        data = self.file.read(size)
        self.budget.take(len(data))
        return data
