"""What is found with every effect free at once, said of draws from the posterior."""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.discrepancy import Remainder

NEEDED = 0.5  # probability, given that an effect is missing, from which it has a size


@dataclass(frozen=True)
class Pruned:
    """Draws from the posterior over the expanded model: `theta` (n, d) in the parameters' units, `included` (n, sizes)
    says which sizes are away from their nulls, `unexplained` (n,) whether a discrepancy, which no effect stands for, is
    large enough to be told from nothing, `beyond` (2, d) which shares of draws lay below and above each parameter's box
    before they were folded back (sizes are drawn within theirs, but for a profile over time). `shows` (sizes) says
    which sizes would be seen beside the base parameters; others are not named, and only widen what is said of those."""

    expansion: Expansion
    theta: Float[np.ndarray, "n d"]
    included: Bool[np.ndarray, "n sizes"]
    unexplained: Bool[np.ndarray, " n"]
    beyond: Float[np.ndarray, "2 d"]
    shows: Bool[np.ndarray, " sizes"]
    fit: Fit
    remainders: list[Remainder]

    def away(self, effect: str) -> Bool[np.ndarray, " n"]:
        """In which draws an effect, whether it shows or not, is away from its null."""
        return np.any(self.included[:, self.sizes_of(effect)], axis=1)

    def sizes_of(self, effect: str) -> Bool[np.ndarray, " sizes"]:
        """Which sizes are those of an effect."""
        return np.array([p.name.split(".")[0] == effect for p in self.expansion.sizes], dtype=bool)

    @cached_property
    def missing(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """In which draws each effect that shows is away from its null, by sizes that show."""
        showing = itertools.compress(self.expansion.sizes, self.shows)
        effects = dict.fromkeys(p.name.split(".")[0] for p in showing)
        return {name: np.any(self.included[:, self.shows & self.sizes_of(name)], axis=1) for name in effects}

    @property
    def effects(self) -> dict[str, float]:
        """The probability that each effect is missing, whatever else is; the largest first."""
        found = {name: float(there.mean()) for name, there in self.missing.items()}
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    def any_of(self, effects: Collection[str]) -> float:
        """The probability that at least one of some effects is missing."""
        return float(np.any([self.missing[name] for name in effects], axis=0).mean())

    @property
    def nothing(self) -> Bool[np.ndarray, " n"]:
        """In which draws no effect that shows is away from its null."""
        return self.sets.get((), np.zeros(len(self.theta), dtype=bool))

    @cached_property
    def sets(self) -> dict[tuple[str, ...], Bool[np.ndarray, " n"]]:
        """Every set of effects that was drawn, with the draws that have it; the most frequent first."""
        if not self.missing:
            return {(): np.ones(len(self.theta), dtype=bool)}
        names = np.array([*self.missing])
        drawn, of = np.unique(np.array([*self.missing.values()]).T, axis=0, return_inverse=True)
        order = np.argsort(-np.bincount(of.ravel()), kind="stable")
        return {tuple(sorted(names[drawn[k]].tolist())): of.ravel() == k for k in order}

    def mostly(self, effects: Collection[str], rows: Bool[np.ndarray, " n"] | None = None) -> list[str]:
        """Of each effect those sizes that show and that it has in most draws, of some `rows`, in which it is missing,
        the most frequent one at least."""
        found, names = list[str](), [p.name for p in self.expansion.sizes]
        for effect in effects:
            own, there = np.flatnonzero(self.shows & self.sizes_of(effect)), self.missing[effect]
            chosen = there & rows if rows is not None and (there & rows).any() else there
            share = self.included[chosen][:, own].mean(axis=0)
            found += [names[k] for k, s in zip(own, share, strict=True) if s > NEEDED or s == share.max()]
        return found

    def draws(self, name: str) -> Float[np.ndarray, " n"]:
        """Of one parameter; of an effect's size, those in which it is missing, if there are any."""
        space = self.fit.simulator.space
        values = self.theta[:, space.column(name)]
        sizes = [p.name for p in self.expansion.sizes]
        chosen = self.included[:, sizes.index(name)] if name in sizes else np.ones(len(values), dtype=bool)
        return values[chosen] if chosen.any() else values


def folded(
    theta: Float[np.ndarray, "n d"], low: Float[np.ndarray, " d"], high: Float[np.ndarray, " d"]
) -> Float[np.ndarray, "n d"]:
    """What lies beyond a bound, as far within it, but in that bound's half of the box, so that it keeps its spread: cut
    off, it would pile up at the bound and look sure, where it tells that the model is wrong."""
    middle = 0.5 * (low + high)
    below, above = np.minimum(2.0 * low - theta, middle), np.maximum(2.0 * high - theta, middle)
    return np.where(theta < low, below, np.where(theta > high, above, theta))


def pooled(found: Sequence[Pruned]) -> Pruned:
    """Draws of several linearisations together; what is left over is said of the last."""
    theta, included, unexplained = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("theta", "included", "unexplained")
    )
    beyond = np.mean([one.beyond for one in found], axis=0)
    return replace(found[-1], theta=theta, included=included, unexplained=unexplained, beyond=beyond)
