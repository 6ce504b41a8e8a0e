"""What is found with every effect free at once, said of draws from the posterior.

A linearisation tells what is true near its fit. Draws of several are pooled by what their states are worth, the log of
evidence times prior on average over the states that were drawn. Linear models being as inexact as they are, worths that
differ by what is just seen count as different by one.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.inference.information import SEEN
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.discrepancy import Remainder

EXACT = 0.5 * SEEN**2  # log likelihood that an effect adds which is just seen


@dataclass(frozen=True)
class Pruned:
    """Draws from the posterior over the expanded model: `theta` (n, d) in the parameters' units, `included` (n, sizes)
    says which sizes are away from their nulls, `discrepant` (n, groups) which discrepancies are as large as would be
    plain to see, `beyond` (d,) which share of draws lay beyond each parameter's box before they were folded back.
    `shows` (sizes) says which sizes would be seen beside the base parameters; others are not named, and only widen what
    is said of those."""

    expansion: Expansion
    theta: Float[np.ndarray, "n d"]
    included: Bool[np.ndarray, "n sizes"]
    discrepant: Bool[np.ndarray, "n groups"]
    beyond: Float[np.ndarray, " d"]
    shows: Bool[np.ndarray, " sizes"]
    fit: Fit
    remainders: list[Remainder]

    def away(self, effect: str) -> Bool[np.ndarray, " n"]:
        """In which draws an effect, whether it shows or not, is away from its null."""
        own = np.array([p.name.split(".")[0] == effect for p in self.expansion.sizes], dtype=bool)
        return np.any(self.included[:, own], axis=1)

    @cached_property
    def missing(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """In which draws each effect that shows is away from its null."""
        showing = itertools.compress(self.expansion.sizes, self.shows)
        return {effect: self.away(effect) for effect in dict.fromkeys(p.name.split(".")[0] for p in showing)}

    @property
    def effects(self) -> dict[str, float]:
        """The probability that each effect is missing, whatever else is; the largest first."""
        found = {name: float(there.mean()) for name, there in self.missing.items()}
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    def any_of(self, effects: Collection[str]) -> float:
        """The probability that at least one of some effects is missing."""
        return float(np.any([self.missing[name] for name in effects], axis=0).mean())

    @cached_property
    def unexplained(self) -> Bool[np.ndarray, " n"]:
        """In which draws there is a discrepancy, which no effect stands for, as large as would be plain to see."""
        return np.any(self.discrepant, axis=1)

    @cached_property
    def sets(self) -> dict[tuple[str, ...], Bool[np.ndarray, " n"]]:
        """Every set of effects that was drawn, with the draws that have it; the most frequent first."""
        names = np.array([*self.missing])
        drawn, of = np.unique(np.array([*self.missing.values()]).T, axis=0, return_inverse=True)
        order = np.argsort(-np.bincount(of.ravel()), kind="stable")
        return {tuple(sorted(names[drawn[k]].tolist())): of.ravel() == k for k in order}

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
    """What lies beyond a bound, as far within it, so that it keeps its spread: cut off, it would pile up at the bound
    and look sure, where it tells that the model is wrong."""
    mirrored = np.where(theta < low, 2.0 * low - theta, np.where(theta > high, 2.0 * high - theta, theta))
    return np.clip(mirrored, low, high)


def pooled(found: Sequence[Pruned], worth: Sequence[float]) -> Pruned:
    """Draws of several linearisations in one, as many as the first two have; what is left over is said of the one that
    is worth most."""
    number, best = [len(one.theta) for one in found], int(np.argmax(worth))
    share = np.exp((np.array(worth) - worth[best]) / EXACT)
    drawn = _evenly(np.repeat(share / number, number), sum(number[:2]))
    theta, included, discrepant = (
        np.concatenate([getattr(one, name) for one in found])[drawn] for name in ("theta", "included", "discrepant")
    )
    beyond = np.average([one.beyond for one in found], axis=0, weights=share)
    return replace(found[best], theta=theta, included=included, discrepant=discrepant, beyond=beyond)


def _evenly(weight: Float[np.ndarray, " n"], number: int) -> Int[np.ndarray, " number"]:
    """Places of so many draws, each as often as its weight says, to less than one (Kitagawa 1996)."""
    reached = np.cumsum(weight) / weight.sum()
    return np.searchsorted(reached, (np.arange(number) + 0.5) / number)
