"""S = (H + L)^-1 and m = S b, as groups of neighbouring columns get other precisions L one after another."""

import numpy as np

from vehicle_sbi.compiled import compiled_apart

LEAST = 1e-9  # part of its precision that a direction keeps, against rounding
ROUNDED = 1e-8  # part of a product's terms, by which it is off where rounding has grown


@compiled_apart
def factorised(H, b, precision):
    """S = (H + L)^-1 and m = S b."""
    S = np.linalg.inv(H + np.diag(precision))
    S = 0.5 * (S + S.T)
    return S, S @ b


@compiled_apart
def set_precision(first, last, to, precision, S, m):
    """Give a group another precision; S, m and `precision` change in place.

    Its own rows are scaled rather than subtracted from: where a precision grows by 1e7, seven digits would be lost.
    """
    d = to - precision[first]
    if d == 0.0:
        return
    if last - first == 1:
        _set_alone(first, d, S, m)
    else:
        e, V = np.linalg.eigh(np.ascontiguousarray(S[first:last, first:last]))
        W, u = np.ascontiguousarray(S[:, first:last]) @ V, V.T @ m[first:last].copy()
        grown = np.maximum(1.0 + d * np.maximum(e, 0.0), LEAST)
        m -= W @ (d / grown * u)
        S -= (W * (d / grown)) @ W.T
        m[first:last] = V @ (u / grown)
        S[:, first:last] = (W / grown) @ V.T
        S[first:last] = S[:, first:last].T
    precision[first:last] = to


@compiled_apart
def _set_alone(j, d, S, m):
    """What `set_precision` does to a group of one column j, whose precision changes by d, without matrices beside S."""
    w = S[j].copy()
    grown, mean = max(1.0 + d * max(w[j], 0.0), LEAST), m[j]
    for i in range(len(m)):
        share = d / grown * w[i]
        m[i] -= share * mean
        for k in range(len(m)):
            S[i, k] -= share * w[k]
    m[j] = mean / grown
    for i in range(len(m)):
        S[i, j] = S[j, i] = w[i] / grown


@compiled_apart
def rounded(j, H, precision, S):
    """Whether S is no longer the inverse of H + L, by the product of a row of the one and a column of the other."""
    product = H[j] * S[j]
    product[j] += precision[j] * S[j, j]
    return not abs(product.sum() - 1.0) <= ROUNDED * np.abs(product).sum()
