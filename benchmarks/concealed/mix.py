"""What each case of the benchmark is to be: its kind, its level, which effects and how strong.

Every block of 40 cases has the same mix in a shuffled order, and effects are dealt from shuffled decks, so that any
number of cases is balanced.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from concealed import outside
from vehicle_sbi.physics.effects import CATALOGUE

MIX: Mapping[tuple[str, str], int] = {
    ("none", "L0"): 7, ("single", "L0"): 7, ("outside", "L0"): 2, ("pair", "L0"): 4,
    ("none", "L1"): 3, ("single", "L1"): 5, ("outside", "L1"): 4, ("pair", "L1"): 2,
    ("none", "L2"): 2, ("single", "L2"): 4,
}  # fmt: skip
"""Cases of each kind and level in a block."""

MIXES: Mapping[str, Mapping[tuple[str, str], int]] = {
    "concealed": MIX,
    "nothing": {cell: n for cell, n in MIX.items() if cell[0] == "none" and cell[1] != "L2"},
}
"""By name; the second is for false alarms alone, of which a thousand cases are needed to see one in a hundred."""

SNRS = (4.0, 8.0, 16.0, 32.0)


@dataclass(frozen=True)
class Slot:
    """What a case is to be, before anything of it is drawn."""

    index: int
    kind: str
    level: str
    effects: tuple[str, ...]
    snr: float


def _dealt(deck: Sequence[str], n: int, seed: int, stream: int) -> str:
    """The n-th card of a deck that is shuffled anew each time it is through."""
    order = np.random.default_rng((seed, stream, n // len(deck))).permutation(len(deck))
    return deck[int(order[n % len(deck)])]


def _deck(kind: str, level: str) -> str:
    """Cases of a kind that are dealt from one deck: real recordings apart, and effects that only a twin has."""
    return level if kind == "outside" or level == "L2" else "simulated"


def slot(seed: int, index: int, injectable: Sequence[str], mix: str = "concealed") -> Slot:
    """What case `index` is to be; `injectable` are the effects that real recordings can be given."""
    of_each = MIXES[mix]
    block, place = divmod(index, sum(of_each.values()))
    cells = [cell for cell, n in of_each.items() for _ in range(n)]
    order = np.random.default_rng((seed, 1, block)).permutation(len(cells))
    kind, level = cells[order[place]]
    alike = [cell for cell in of_each if cell[0] == kind and _deck(*cell) == _deck(kind, level)]
    before = sum(cells[k] in alike for k in order[:place])
    each = sum(of_each[cell] for cell in alike)
    n, inside = block * each + before, list(CATALOGUE)
    strength = _dealt([str(v) for v in (SNRS if kind in ("single", "pair") else SNRS[1:])], n, seed, 2)
    if kind == "none":
        return Slot(index, kind, level, (), 0.0)
    if kind == "outside":
        deck = [k for k, one in outside.OUTSIDE.items() if level == "L1" or one.kind != "twin"]
        return Slot(index, kind, level, (_dealt(deck, n, seed, 3 if level == "L1" else 4),), float(strength))
    if kind == "pair":
        first, second = (_dealt(inside, 2 * n + i, seed, 5) for i in (0, 1))
        if first == second:
            second = inside[(inside.index(second) + 1) % len(inside)]
        return Slot(index, kind, level, (first, second), float(strength))
    if level == "L2":
        return Slot(index, kind, level, (_dealt(injectable, n, seed, 6),), float(strength))
    return Slot(index, kind, level, (_dealt(inside, n, seed, 7),), float(strength))
