"""Which groups of columns of a linear model can stand for each other."""

import numpy as np
from jaxtyping import Float, Int

UNLIKE = 0.01  # the least that is said of two groups, so that any may be exchanged
HARDLY = 1e-9  # part of the largest, below which a direction or a column is rounding


def likeness(
    H: Float[np.ndarray, "n n"], always: int, start: int, stop: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k k"]:
    """How well groups can stand for each other beside what is always there, from `UNLIKE` to 1: the mean squared cosine
    between the directions of the smaller group and the span of the larger.

    H (n, n) are products of columns. The first, as many as `always` says, are there with a precision of 1; groups begin
    at `start`, and each ends at one of `stop`. A column that those take over altogether is like no other.
    """
    across = _beside(H, always, start)
    ends = stop - start
    begins = np.concatenate([[0], ends[:-1]]).astype(np.int64)
    for begin, end in zip(begins, ends, strict=True):
        root = _inverse_root(across[begin:end, begin:end])
        across[begin:end] = root @ across[begin:end]
        across[:, begin:end] = across[:, begin:end] @ root
    squares = np.add.reduceat(np.add.reduceat(across**2, begins, axis=0), begins, axis=1)
    return np.clip(squares / np.minimum.outer(ends - begins, ends - begins), UNLIKE, 1.0)


def _beside(H: Float[np.ndarray, "n n"], always: int, start: int) -> Float[np.ndarray, "m m"]:
    """Products of what is left of columns from `start` on after the first take over what they can, scaled to ones on
    the diagonal."""
    taken = np.linalg.solve(H[:always, :always] + np.eye(always), H[:always, start:])
    left = H[start:, start:] - H[start:, :always] @ taken
    scale = np.sqrt(np.maximum(np.diag(left), HARDLY * np.diag(H)[start:]) + np.finfo(float).tiny)
    return left / np.outer(scale, scale)


def _inverse_root(A: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """A^-1/2 of a symmetric matrix, without the directions that it hardly has."""
    size, direction = np.linalg.eigh(A)
    kept = size > HARDLY * size[-1]
    return (direction[:, kept] / np.sqrt(size[kept])) @ direction[:, kept].T
