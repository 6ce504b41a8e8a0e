"""Which groups of columns a linear model needs: the posterior over their amplitudes by Gibbs sampling.

With H = X X' and b = X r of whitened columns X and residual r, coefficients normal about zero with precision L(s),

    log p(r | s) = 1/2 b' A^-1 b - 1/2 log det A + 1/2 log det L + const,   A = H + L(s),

where the state s gives each group of columns one of a few amplitudes. A named effect has a *spike*, a size so small
that it is negligible, and *slabs*, sizes that it has where it is missing (George and McCulloch 1993, stochastic search
variable selection). How much is missing at all is learned, as a factor on the odds of all rates. A coefficient in a
slab counts by its expected square within the effect's bounds, over what the slab itself has there; one that is always
there by its mass within its box. Expectations of several are taken for independent. Coefficients are integrated out;
those of the states that are kept are drawn afterwards. The chain is in `gibbs`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief
from vehicle_sbi.mismatch.selection.gibbs import Believed, run_chain
from vehicle_sbi.mismatch.selection.likeness import likeness
from vehicle_sbi.threads import each


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Sweeps of each of several chains that start apart, how many are forgotten, and every how many one is kept."""

    chains: int = 4
    sweeps: int = 600
    forgotten: int = 150
    every: int = 3


@dataclass(frozen=True, kw_only=True)
class Groups:
    """What is believed of groups of neighbouring columns, as arrays.

    `stop` is where each group's columns end. The first `boxes` columns are always there, with a precision of 1, and lie
    within `low` and `high`, but with probability `outside`; a named coefficient does where it is missing. Those from
    there to `start` are shapes of the groups that `shaped` says: there where any of these is, and held to zero where
    none is. One of no group is always there. Levels begin with nothing, the spike of a named group, and end with zeros
    where a group has fewer.
    """

    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    boxes: int
    outside: float
    start: int
    stop: Int[np.ndarray, " k"]
    amplitude: Float[np.ndarray, "k levels"]
    share: Float[np.ndarray, "k levels"]
    rate: Float[np.ndarray, " k"]
    named: Bool[np.ndarray, " k"]
    shaped: Bool[np.ndarray, "shapes k"]

    @classmethod
    def of(
        cls,
        believed: Sequence[Belief],
        shaped: Bool[np.ndarray, "shapes k"],
        *,
        low: Float[np.ndarray, " boxes"],
        high: Float[np.ndarray, " boxes"],
        outside: float,
    ) -> "Groups":
        """Hypotheses one after another, behind what lies in boxes and the shapes of some of them."""
        levels, free = max((len(one.amplitude) for one in believed), default=0), np.full(len(shaped), np.inf)
        start = len(low) + len(shaped)
        return cls(
            low=np.concatenate([low, -free, *(one.low for one in believed)]),
            high=np.concatenate([high, free, *(one.high for one in believed)]),
            boxes=len(low),
            outside=outside,
            start=start,
            stop=start + np.cumsum([len(one.low) for one in believed], dtype=np.int64),
            amplitude=np.array([_levels(one.nothing, one.amplitude, levels) for one in believed]),
            share=np.array([_levels(1.0, one.share, levels) for one in believed]),
            rate=np.array([one.rate for one in believed]),
            named=np.array([one.named for one in believed]),
            shaped=shaped,
        )

    @property
    def believed(self) -> Believed:
        """The same for the chain."""
        first = np.concatenate([[self.start], self.stop[:-1]])
        return Believed(
            first=first,
            stop=self.stop,
            amplitude=self.amplitude,
            share=self.share,
            named=self.named,
            low=self.low,
            high=self.high,
            boxes=self.boxes,
            outside=self.outside,
            shaped=self.shaped,
        )


def _levels(first: float, others: Float[np.ndarray, " given"], most: int) -> Float[np.ndarray, " levels"]:
    """Values of the first level, of the others that there are, and 0 for the rest."""
    return np.concatenate([[first], others, np.zeros(most - len(others))])


@dataclass(frozen=True, kw_only=True)
class Shared:
    """What all groups share and is learned: factors on the odds of effects and of discrepancies, each as likely as the
    others of its list before."""

    missing: Sequence[float] = (0.03, 0.1, 0.3, 1.0)
    discrepant: Sequence[float] = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class Sampled:
    """States and coefficients that were kept: `level` of each group, `coefficient` of each column, and its `mean` over
    all draws with these levels, where no bound is in its way."""

    level: Int[np.ndarray, "n k"]
    coefficient: Float[np.ndarray, "n columns"]
    mean: Float[np.ndarray, "n columns"]

    @property
    def included(self) -> Bool[np.ndarray, "n k"]:
        """Whether each group is away from its first level."""
        return self.level > 0

    def about(self, origin: Float[np.ndarray, " first"]) -> "Sampled":
        """With the coefficients of the first columns counted from where an origin is not zero."""
        shift = np.pad(origin, (0, self.mean.shape[1] - len(origin)))
        return replace(self, coefficient=self.coefficient + shift, mean=self.mean + shift)


def sample(
    H: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, " n"],
    groups: Groups,
    shared: Shared,
    chain: Chain,
    rng: np.random.Generator,
) -> Sampled:
    """Draws from the posterior over states and coefficients; chains start with all groups in and with none, in turn,
    and run beside each other on as many threads as simulations do."""
    alike, odds = likeness(H, groups.boxes, groups.start, groups.stop), groups.rate / (1.0 - groups.rate)
    factors = np.array(shared.missing), np.array(shared.discrepant)
    counts = chain.sweeps, chain.forgotten, chain.every

    def run(begun: tuple[np.ndarray, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return run_chain(H, b, groups.believed, alike, odds, factors, begun[0], counts, begun[1])

    begins = [np.full(len(groups.stop), k % 2, dtype=np.int64) for k in range(chain.chains)]
    found = each(run, [(begin, int(rng.integers(2**31))) for begin in begins])
    return Sampled(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
