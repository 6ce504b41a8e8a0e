"""What a model may lack: the one form in which every kind of hypothesis comes, whoever made it.

A kind is a file of this folder with one or more of the functions `tested`, `together` and `believed`, which make these:

    Hypothesis   tested alone, about the base model's fit: bounds of a size, and the change of the series per unit of it
    Together     several that are tested at once, about the same fit: the log likelihood that they gain at their best
    Belief       what is believed, before the recording is seen, of columns that are sampled beside all others

A source of discrepancy (`discrepancy.Source`) is sampled too, and makes its columns anew about each fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Block:
    """A place where simulation and recording may differ; times [s] are those of the recordings, one after another, and
    the regime reads "speed above 20 m/s" or "in proportion to speed"."""

    channel: str
    from_s: float
    to_s: float
    regime: str = ""


@dataclass(frozen=True)
class Hypothesis:
    """What is tested alone. Its size lies between `low` and `high`, which enclose 0, where nothing is missing. `change`
    is what a unit of it does to the series, in the channels' units. One that says where something is missing, and not
    what, has a `block`."""

    name: str
    low: float
    high: float
    change: Float[np.ndarray, "channels time"]
    block: Block | None = None


class Together(Protocol):
    """What is tested at once."""

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """The log likelihood that it gains at best in each series, of which the fit has absorbed what it can."""
        ...


@dataclass(frozen=True, kw_only=True)
class Belief:
    """What is believed of neighbouring columns of the linear model, which are missing together.

    They are missing with probability `rate`. Their coefficients then have one of the standard deviations `amplitude`,
    with probabilities `share`, else `nothing`, which is negligible. An effect is `named`. Where it is missing, a
    coefficient lies between `low` and `high`, which enclose 0 or begin or end there.
    """

    named: bool
    rate: float
    nothing: float
    amplitude: Float[np.ndarray, " levels"]
    share: Float[np.ndarray, " levels"]
    low: Float[np.ndarray, " columns"]
    high: Float[np.ndarray, " columns"]


def changes_of(alone: Sequence[Hypothesis], shape: tuple[int, ...]) -> Float[np.ndarray, "k channels time"]:
    """Changes of series of a shape, one after another."""
    return np.array([one.change for one in alone]).reshape(-1, *shape)
