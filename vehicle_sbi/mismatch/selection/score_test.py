"""Is there a mismatch at all: every direction that could explain the residual, with one null for all.

With l(k) how likely the recording is with a little of direction k under the noise that is then left over (of first
order, `linear`), z_k = sign(a) sqrt(2 (l(k) - l(none))) is its directed score, a its size. The noise has to be
estimated with and without the direction: under the base model's alone a mismatch counts as slow noise that excuses
itself.

Under the fitted model scores are standard normal, correlated as the directions are after what the fit absorbs. So the
null of the largest of any set comes from noise that is drawn, fitted and scored. So does that of several directions
together, which slow noise lets gain more than a chi-square has: with each of them it is estimated to be less slow.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import (
    ITERATIONS,
    LEAST_VARIANCE,
    Linearised,
    Products,
    Quadratic,
    ar1,
    kinds,
    profile,
)
from vehicle_sbi.mismatch.hypotheses.quantisation import Staircase, Staircases

DRAWS = 500  # of noise, behind a p-value
CHUNK = 100  # of them, and of directions, at once


@dataclass(frozen=True)
class Group:
    """What is also tested: the log likelihood that several directions gain together, at sizes of their own, or the best
    of many steps of a channel, in the recording and in drawn noise."""

    gain: float
    null: Float[np.ndarray, " draws"]


@dataclass(frozen=True)
class Scores:
    """Directions at first order: likelihood gained, size, the information about it, the sizes that the prior allows.

    `null` (draws, k) are the scores of drawn noise, `groups` those that are also tested together.
    """

    gain: Float[np.ndarray, " k"]
    size: Float[np.ndarray, " k"]
    information: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    null: Float[np.ndarray, "draws k"]
    groups: tuple[Group, ...] = ()

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        return np.sign(self.size) * np.sqrt(2.0 * self.gain)

    @property
    def p_values(self) -> Float[np.ndarray, " k"]:
        """Of each direction, for the largest of all: how often noise alone scores as high anywhere."""
        highest = np.abs(self.null).max(axis=1, initial=0.0)
        return (1.0 + (highest[:, None] >= np.abs(self.z)).sum(axis=0)) / (len(highest) + 1.0)

    def p_value(self, *, tolerated: float = 0.0) -> float:
        """How often noise alone is as extreme: by its largest score, or by what a group of directions gains together.

        A mismatch that comes and goes has many small scores in a row, not one large one. `tolerated` is a score that is
        left over by a model that counts as right, in whose units larger ones are then taken.
        """
        shrink = 1.0 / (1.0 + tolerated**2)
        highest = np.abs(self.null).max(axis=1, initial=0.0)
        statistics = [np.append(np.sqrt(shrink) * np.abs(self.z).max(initial=0.0), highest)]
        statistics += [np.append(shrink * group.gain, group.null) for group in self.groups]
        ranks = [rankdata(-one, method="max") for one in statistics]
        least = np.min(ranks, axis=0)
        return float((least <= least[0]).sum() / len(least))


def score(
    fit: Fit,
    changes: Float[np.ndarray, "k channels time"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
    *,
    rng: np.random.Generator,
    draws: int = DRAWS,
    together: Sequence[Sequence[int]] = (),
) -> Scores:
    """Scores of `changes` (per unit of a size that the prior bounds between low and high) at a fit, and of those rows
    of them that are also tested `together`, at any size; with a null also whether a channel reads in steps."""
    about = Linearised.of(fit)
    each = profile(about, changes[:, None], low[:, None], high[:, None])
    gain = np.maximum(each.log_likelihood - about.alone, 0.0)
    information = np.maximum(each.information[:, 0, 0], 1e-12)
    groups = [Together.of(about, changes[[*rows]]) for rows in together]
    groups = [*groups, Staircases(Staircase.of_each(about))] if draws else groups
    observed = about.absorbed(about.residual)
    gained_here = [float(group.gains(observed)[0]) for group in groups]
    null, gained_there = np.zeros((0, len(changes))), np.zeros((0, len(groups)))
    if draws:
        null, gained_there = _drawn(about, Singles.of(about, changes, low, high), groups, draws, rng)
    tested = tuple(Group(one, many) for one, many in zip(gained_here, gained_there.T, strict=True))
    return Scores(gain, each.size[:, 0], information, low, high, null, tested)


def _drawn(
    about: Linearised,
    singles: "Singles",
    groups: Sequence["Together | Staircases"],
    draws: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "draws k"], Float[np.ndarray, "draws groups"]]:
    """Scores of drawn noise, and what each group gains in it."""
    scored, gains = [], []
    for n in np.diff([*range(0, draws, CHUNK), draws]):
        drawn = about.absorbed(about.drawn(int(n), rng))
        scored.append(singles.scores(drawn))
        gains.append(np.array([group.gains(drawn) for group in groups]).reshape(len(groups), int(n)).T)
    return np.concatenate(scored), np.concatenate(gains)


@dataclass(frozen=True)
class Singles:
    """What a fit leaves of directions once it has absorbed what it can, to score drawn noise by, one at a time.

    `left` (k, channels, time) in single precision, which is a thousand times finer than what the number of draws leaves
    uncertain, and in units in which all of them are as large; `squares` of each; sizes within `low` and `high`.
    """

    about: Linearised
    left: Float[np.ndarray, "k channels time"]
    squares: Float[np.ndarray, "3 channels 1 k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls,
        about: Linearised,
        changes: Float[np.ndarray, "k channels time"],
        low: Float[np.ndarray, " k"],
        high: Float[np.ndarray, " k"],
    ) -> "Singles":
        """Of directions whose sizes are within low and high."""
        left, scale = np.empty(changes.shape, np.float32), np.empty(len(changes))
        for part in (slice(first, first + CHUNK) for first in range(0, len(changes), CHUNK)):
            G = about.absorbed(np.nan_to_num(changes[part]))
            scale[part] = np.sqrt(np.maximum(np.mean(G**2, axis=(1, 2)), LEAST_VARIANCE))
            left[part] = G / scale[part, None, None]
        return cls(about, left, about.squares(left)[:, :, None].astype(float), low * scale, high * scale)

    def scores(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, "n k"]:
        """Directed scores of absorbed series, the noise estimated again at each size, as in `profile`."""
        ee = self.about.squares(e)[..., None]
        eg = self.about.products(e.astype(np.float32), self.left).astype(float)
        count = self.about.count

        def noise(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            over = ee - 2.0 * size * eg + size**2 * self.squares
            return ar1(over, count[:, None, None], self.about.largest_rho)

        size = np.zeros(eg.shape[2:])
        none = np.tensordot(count, np.log(noise(size)[1]), 1)
        for _ in range(ITERATIONS):
            rho, S = noise(size)
            weight = kinds(rho) / S
            information = np.maximum(np.sum(weight * self.squares, axis=(0, 1)), 1e-12)
            size = np.clip(np.sum(weight * eg, axis=(0, 1)) / information, self.low, self.high)
        gain = 0.5 * (none - np.tensordot(count, np.log(noise(size)[1]), 1))
        return np.sign(size) * np.sqrt(2.0 * np.maximum(gain, 0.0))


@dataclass(frozen=True)
class Together:
    """What a fit leaves of q directions, to test all of them at once, with their products."""

    about: Linearised
    left: Float[np.ndarray, "q channels time"]
    products: Products

    @classmethod
    def of(cls, about: Linearised, changes: Float[np.ndarray, "q channels time"]) -> "Together":
        left = about.absorbed(np.nan_to_num(changes))
        return cls(about, left, about.products(left, left))

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """Log likelihood that all directions gain in each absorbed series, at any size, under noise of its own."""
        n, q = len(e), len(self.left)
        H = np.broadcast_to(self.products[:, :, None], (*self.products.shape[:2], n, q, q))
        over = Quadratic(
            H, self.about.products(e, self.left), self.about.squares(e), self.about.count, self.about.largest_rho
        )
        free = np.full((1, q), np.inf)
        x = over.solved(np.zeros((q, q)), -free, free)
        return np.maximum(over.log_likelihood(x) - over.log_likelihood(np.zeros_like(x)), 0.0)
