"""S = (H + L)^-1 and m = S b, as groups of neighbouring columns get other precisions L one after another.

Sums are loops, not numpy's expressions: those take numba many times as long to compile, and are no faster here.
"""

import numpy as np

from vehicle_sbi.compiled import compiled_apart

LEAST = 1e-9  # part of its precision that a direction keeps, against rounding
ROUNDED = 1e-8  # part of a product's terms, by which it is off where rounding has grown


@compiled_apart
def with_precision(H, precision):
    """H + L."""
    A = H.copy()
    for j in range(len(precision)):
        A[j, j] += precision[j]
    return A


@compiled_apart
def factorise(H, b, precision, S, m) -> None:
    """Fill S = (H + L)^-1 and m = S b."""
    inverse = np.linalg.inv(with_precision(H, precision))
    for i in range(len(b)):
        for j in range(i + 1):
            S[i, j] = S[j, i] = 0.5 * (inverse[i, j] + inverse[j, i])
    for i in range(len(b)):
        m[i] = 0.0
        for j in range(len(b)):
            m[i] += S[i, j] * b[j]


@compiled_apart
def along(first, last, S, m):
    """Along the eigenvectors V (q, q) of a group's block of S: its eigenvalues (q,), V' S (q, n) and V' m (q,)."""
    q, n = last - first, len(m)
    e, V = np.ones(1), np.ones((1, 1))
    if q == 1:
        e[0] = S[first, first]
    else:
        e, V = np.linalg.eigh(S[first:last, first:last].copy())
    W, u = np.zeros((q, n)), np.zeros(q)
    for i in range(q):
        for j in range(q):
            u[i] += V[j, i] * m[first + j]
            for k in range(n):
                W[i, k] += V[j, i] * S[first + j, k]
    return e, V, W, u


@compiled_apart
def set_precision(first, last, to, precision, S, m) -> None:
    """Give a group another precision; S, m and `precision` change in place.

    Its own rows are scaled rather than subtracted from: where a precision grows by 1e7, seven digits would be lost.
    """
    d = to - precision[first]
    if d == 0.0:
        return
    e, V, W, u = along(first, last, S, m)
    for i in range(last - first):
        grown = max(1.0 + d * max(e[i], 0.0), LEAST)
        for j in range(len(m)):
            share = d / grown * W[i, j]
            m[j] -= share * u[i]
            for k in range(len(m)):
                S[j, k] -= share * W[i, k]
        u[i] /= grown
        for k in range(len(m)):
            W[i, k] /= grown
    for j in range(first, last):
        precision[j], m[j] = to, 0.0
        for i in range(last - first):
            m[j] += V[j - first, i] * u[i]
        for k in range(len(m)):
            S[j, k] = 0.0
            for i in range(last - first):
                S[j, k] += V[j - first, i] * W[i, k]
    for j in range(first, last):
        for k in range(len(m)):
            S[k, j] = S[j, k]


@compiled_apart
def rounded(j, H, precision, S):
    """Whether S is no longer the inverse of H + L, by the product of a row of the one and a column of the other."""
    total, size = precision[j] * S[j, j], 0.0
    for k in range(len(precision)):
        term = H[j, k] * S[j, k]
        total += term
        size += abs(term + precision[j] * S[j, j]) if k == j else abs(term)
    return not abs(total - 1.0) <= ROUNDED * size
