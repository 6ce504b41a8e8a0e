"""The blocks of an MDF4 file, checked before a library follows their links: none ends beyond the file or in a circle.

ASAM MDF 4.1, sec. 5: a block is an identifier, its length and its links; lists are linked by their first link. Blocks
of data may be packed (DZ) and may be linked to many times: what they unpack to counts each time.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from vehicle_sbi.data.formats.limits import Budget, Zlib
from vehicle_sbi.errors import InputError

HEADER = struct.Struct("<4s4xQQ")
FIRST_BLOCK = 64
FOLLOWED = {
    b"##HD": (0, 1), b"##FH": (0,), b"##DG": (0, 1, 2), b"##CG": (0, 1), b"##CN": (0, 1, 4, 5), b"##HL": (0,),
    b"##DL": None, b"##LD": None, b"##CC": None, b"##CA": (0,), b"##AT": (0,), b"##EV": (0,), b"##CH": (0, 1),
}  # fmt: skip
"""The links that own what they point to, by kind of block; None: all of them."""

DATA = (b"##DT", b"##DV", b"##SD", b"##RD")
PACKED, DEFLATED = struct.Struct("<2sBxIQQ"), (0, 1)  # of a DZ block: of what kind, packed how, its length, here

MOST_BLOCKS = 2_000_000


def check_blocks(path: Path) -> None:
    """Raise InputError if the file is no MDF4, is cut, or its blocks lead in a circle."""
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: is empty")
    with path.open("rb") as file:
        start = file.read(FIRST_BLOCK)
        if start[:8].strip() not in (b"MDF", b"UnFinMF") or len(start) < FIRST_BLOCK:
            raise InputError(f"{path}: is no MDF file (is it truncated?)")
        version = struct.unpack_from("<H", start, 28)[0]
        if version < 400:
            raise InputError(f"{path}: is MDF {version / 100:.2f}; only MDF 4 is read: convert it, asammdf does")
        _walk(path, file, size, finished=start[:3] == b"MDF")


def _walk(path: Path, file: BinaryIO, size: int, *, finished: bool) -> None:
    """Depth first along the links; a block that is met again while what follows it is still open closes a circle."""
    open_blocks, closed, budget = {FIRST_BLOCK}, set(), Budget(path)
    held: dict[int, int] = {}  # what blocks of data unpack to [bytes]
    stack = [(FIRST_BLOCK, list(_links(path, file, FIRST_BLOCK, size, finished=finished)))]
    while stack:
        address, links = stack[-1]
        if not links:
            stack.pop()
            open_blocks.discard(address)
            closed.add(address)
            continue
        following = links.pop()
        if following in open_blocks:
            raise InputError(f"{path}: its blocks lead in a circle at byte {following}: it is damaged")
        if following in closed:
            budget.take(held.get(following, 0))
            continue
        if len(closed) + len(open_blocks) > MOST_BLOCKS:
            raise InputError(f"{path}: has more than {MOST_BLOCKS} blocks")
        open_blocks.add(following)
        stack.append((following, list(_links(path, file, following, size, finished=finished))))
        before = budget.left
        _count(file, following, budget)
        held[following] = before - budget.left


def _count(file: BinaryIO, address: int, budget: Budget) -> None:
    """Use up what a block of data holds, unpacked."""
    file.seek(address)
    kind, length, _ = HEADER.unpack(file.read(HEADER.size))
    if kind in DATA:
        budget.take(length)
    elif kind == b"##DZ":
        _, how, _, stated, packed = PACKED.unpack(file.read(PACKED.size))
        left = budget.left
        if how in DEFLATED:
            budget.count(file.read(packed), Zlib)
        budget.take(max(0, stated - (left - budget.left)))


def _links(path: Path, file: BinaryIO, address: int, size: int, *, finished: bool) -> Sequence[int]:
    """The links of a block that own what they point to; InputError if it does not lie in the file."""
    if address + HEADER.size > size:
        raise InputError(f"{path}: a link leads to byte {address} of {size}: the file is truncated")
    file.seek(address)
    kind, length, count = HEADER.unpack(file.read(HEADER.size))
    if kind[:2] != b"##":
        raise InputError(f"{path}: no block at byte {address}, where a link leads: it is damaged")
    if address + length > size and finished:
        raise InputError(f"{path}: a block ends at byte {address + length} of {size}: the file is truncated")
    if kind not in FOLLOWED or 8 * count > length:
        return ()
    links = struct.unpack(f"<{count}Q", file.read(8 * count)) if length <= size else ()
    followed = FOLLOWED[kind]
    chosen = links if followed is None else [links[i] for i in followed if i < len(links)]
    return [link for link in chosen if link]
