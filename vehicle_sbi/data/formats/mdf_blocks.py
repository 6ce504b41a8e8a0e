"""The blocks of an MDF4 file, checked before a library follows their links: none ends beyond the file or in a circle.

ASAM MDF 4.1, sec. 5: a block is an identifier, its length and its links; lists are linked by their first link.
"""

import struct
from collections.abc import Sequence
from pathlib import Path

from vehicle_sbi.errors import InputError

HEADER = struct.Struct("<4s4xQQ")
FIRST_BLOCK = 64
FOLLOWED = {
    b"##HD": (0, 1), b"##FH": (0,), b"##DG": (0, 1, 2), b"##CG": (0, 1), b"##CN": (0, 1, 4, 5), b"##HL": (0,),
    b"##DL": None, b"##LD": None, b"##CC": None, b"##CA": (0,), b"##AT": (0,), b"##EV": (0,), b"##CH": (0, 1),
}  # fmt: skip
"""The links that own what they point to, by kind of block; None: all of them."""

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


def _walk(path: Path, file, size: int, *, finished: bool) -> None:
    """Depth first along the links; a block that is met again while what follows it is still open closes a circle."""
    open_blocks, closed = {FIRST_BLOCK}, set()
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
            continue
        if len(closed) + len(open_blocks) > MOST_BLOCKS:
            raise InputError(f"{path}: has more than {MOST_BLOCKS} blocks")
        open_blocks.add(following)
        stack.append((following, list(_links(path, file, following, size, finished=finished))))


def _links(path: Path, file, address: int, size: int, *, finished: bool) -> Sequence[int]:
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
