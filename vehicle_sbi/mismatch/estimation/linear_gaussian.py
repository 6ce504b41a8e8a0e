"""The expanded model at first order: every column that may matter, and its products with the others and the residual.

    r + X' c_0 = X' c + noise,   X whitened, noise independent and standard normal, c_0 the fit's own coefficients

Columns are those of parameters, in units in which they are believed to be about 1, and those of discrepancies. Further
recordings add their products: parameters are the same there, discrepancies have coefficients of their own.

Shapes of effects (a side wind's lever) are counted from the fit on (`origin`). Where an effect is not missing its
shapes are held there, so that their columns change nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.inference.information import SEEN
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import Fit


@dataclass(frozen=True)
class LinearGaussian:
    """Products H = X X' and b = X r of columns: base parameters, shapes, sizes, then groups of discrepancies, each of
    which ends at one of `stop`."""

    H: Float[np.ndarray, "n n"]
    b: Float[np.ndarray, " n"]
    stop: Int[np.ndarray, " groups"]


def linear_gaussian(
    expansion: Expansion, parts: Sequence[tuple[Fit, Sequence[Float[np.ndarray, "_ _"]]]]
) -> LinearGaussian:
    """Of fits of the same point of the expanded model to several recordings, each with its own discrepancies' columns
    (whitened)."""
    first = len(expansion.unit)
    widths = [len(one) for _, found in parts for one in found]
    n = first + sum(widths)
    H, b, at = np.zeros((n, n)), np.zeros(n), first
    for fit, found in parts:
        X, r = _columns(expansion, fit)
        X = np.concatenate([X, *found])
        where = np.concatenate([np.arange(first), at + np.arange(len(X) - first)])
        H[np.ix_(where, where)] += X @ X.T
        b[where] += X @ r
        at += len(X) - first
    return LinearGaussian(H, b, first + np.cumsum(widths, dtype=np.int64))


def showing(expansion: Expansion, problem: LinearGaussian) -> Bool[np.ndarray, " sizes"]:
    """Which sizes, as large as their boxes allow, change more than base parameters take over by what is seen."""
    left = _left(expansion, problem)[: len(expansion.unit) - len(expansion.base)]
    return np.sqrt(left[len(left) - len(expansion.sizes) :]) * expansion.reach >= SEEN


def beyond_base(
    expansion: Expansion, problem: LinearGaussian, coefficient: Float[np.ndarray, "n columns"]
) -> Float[np.ndarray, "n groups"]:
    """What each discrepancy changes with each row of coefficients, without what base parameters take over, as a
    signal-to-noise ratio: the root of its sum of squares in standard deviations of the noise."""
    own, first = len(expansion.base), len(expansion.unit)
    among, shared, H = problem.H[:own, :own] + np.eye(own), problem.H[:own], problem.H
    squares = []
    for start, stop in zip([first, *problem.stop], problem.stop, strict=False):
        here = slice(start, stop)
        left = H[here, here] - shared[:, here].T @ np.linalg.solve(among, shared[:, here])
        squares.append(np.einsum("ni,ij,nj->n", coefficient[:, here], left, coefficient[:, here], optimize=True))
    return np.sqrt(np.maximum(np.array(squares).reshape(len(squares), -1).T, 0.0))


def _left(expansion: Expansion, problem: LinearGaussian) -> Float[np.ndarray, " columns"]:
    """Squared norms of all columns behind the base parameters', without what those take over."""
    own = len(expansion.base)
    both = problem.H[:own, own:]
    taken = np.sum(both * np.linalg.solve(problem.H[:own, :own] + np.eye(own), both), axis=0)
    return np.maximum(np.diag(problem.H)[own:] - taken, 0.0)


def order(expansion: Expansion) -> np.ndarray:
    """Places of the parameters in the order of the columns: base, shapes, sizes."""
    counts = [len(one) for one in (expansion.base, expansion.sizes, expansion.shapes)]
    base, sizes, shapes = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    return np.concatenate([base, shapes, sizes])


def origin(expansion: Expansion, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Coefficients, in the order of the columns, of where those of a linear model about theta are zero: shapes as they
    are there, and `rest` of all others."""
    return np.where(expansion.shaping, expansion.coefficients(theta), 0.0)[order(expansion)]


def per_coefficient(expansion: Expansion, fit: Fit) -> Float[np.ndarray, " d"]:
    """By how many of the boxes' standard deviations parameters grow with their coefficients."""
    return expansion.slope(fit.theta) / fit.simulator.space.prior_std


def _columns(expansion: Expansion, fit: Fit) -> tuple[Float[np.ndarray, "d samples"], Float[np.ndarray, " samples"]]:
    """What parameters do per unit of their coefficients, and the residual from where all coefficients are zero."""
    X = fit.white * per_coefficient(expansion, fit)[:, None]
    X, off = X[order(expansion)], expansion.coefficients(fit.theta)[order(expansion)] - origin(expansion, fit.theta)
    return X, fit.metric(fit.residual).reshape(-1) + off @ X
