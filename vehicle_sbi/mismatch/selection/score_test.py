"""Is there a mismatch at all: every direction that could explain the residual, with one null for all.

With l(k) how likely the recording is with a little of direction k under the noise that is then left over (of first
order, `linearised`), z_k = sign(a) sqrt(2 (l(k) - l(none))) is its directed score, a its size. The noise has to be
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

from vehicle_sbi.mismatch.estimation.linearised import ITERATIONS, LEAST_VARIANCE, Linearised, ar1, kinds, profile
from vehicle_sbi.mismatch.hypotheses.hypothesis import Hypothesis, Together, changes_of
from vehicle_sbi.threads import each

DRAWS = 500  # of noise, behind a p-value
CHUNK = 100  # of them, and of directions, at once


@dataclass(frozen=True)
class Scores:
    """Hypotheses at first order: the likelihood that each gains, and its size then.

    `null` are the scores of drawn noise; `together` is what those that are tested at once gain, `null_together` what
    they do in drawn noise.
    """

    gain: Float[np.ndarray, " k"]
    size: Float[np.ndarray, " k"]
    null: Float[np.ndarray, "draws k"]
    together: Float[np.ndarray, " groups"]
    null_together: Float[np.ndarray, "draws groups"]

    @property
    def z(self) -> Float[np.ndarray, " k"]:
        return np.sign(self.size) * np.sqrt(2.0 * self.gain)

    @property
    def p_values(self) -> Float[np.ndarray, " k"]:
        """Of each hypothesis, for the largest of all: how often noise alone scores as high anywhere."""
        highest = np.abs(self.null).max(axis=1, initial=0.0)
        return (1.0 + (highest[:, None] >= np.abs(self.z)).sum(axis=0)) / (len(highest) + 1.0)

    def p_value(self) -> float:
        """How often noise alone is as extreme: by its largest score, or by what a group gains together.

        A mismatch that comes and goes has many small scores in a row, not one large one.
        """
        here = np.append(np.abs(self.z).max(initial=0.0), self.together)
        there = np.column_stack([np.abs(self.null).max(axis=1, initial=0.0), self.null_together])
        least = rankdata(-np.vstack([here, there]), method="max", axis=0).min(axis=1)
        return float((least <= least[0]).sum() / len(least))


def score(
    about: Linearised,
    alone: Sequence[Hypothesis],
    together: Sequence[Together],
    *,
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Scores:
    """Scores of hypotheses about a fit, each alone, and of those that are also tested together."""
    changes = changes_of(alone, about.fit.at.y.shape)
    low, high = np.array([one.low for one in alone]), np.array([one.high for one in alone])
    fitted = profile(about, changes[:, None], low[:, None], high[:, None])
    gain = np.maximum(fitted.log_likelihood - about.alone, 0.0)
    singles = Singles.of(about, changes, low, high)

    def nothing_missing(drawn: tuple[int, np.random.Generator]) -> tuple[np.ndarray, np.ndarray]:
        noise = about.absorbed(about.drawn(*drawn))
        return singles.scores(noise), _gains(together, noise)

    chunks = np.diff([*range(0, draws, CHUNK), draws]).tolist()
    null, null_together = zip(*each(nothing_missing, zip(chunks, rng.spawn(len(chunks)), strict=True)), strict=True)
    here = _gains(together, about.absorbed(about.residual))[0]
    return Scores(gain, fitted.size[:, 0], np.concatenate(null), here, np.concatenate(null_together))


def _gains(together: Sequence[Together], e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, "n groups"]:
    """What hypotheses gain together in each absorbed series."""
    return np.array([one.gains(e) for one in together]).reshape(len(together), len(e)).T


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
