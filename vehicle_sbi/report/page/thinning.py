"""Curves for a screen: of each stretch of time the least and the largest, in the order in which they come.

A screen has some thousand columns. Where several samples fall into one of them, all that is seen is from where to where
they reach, which two points per stretch keep: no spike is lost, whatever the length of the recording.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

FEWEST = 500  # points that a curve keeps in any case
GAP = 1.5  # times the usual step from which no line joins two samples


@dataclass(frozen=True)
class Thinned:
    """Curves at common times `t` [s], each point of `every` samples' least and largest; NaN between pieces of time."""

    t: Float[np.ndarray, " n"]
    curves: Mapping[str, Float[np.ndarray, " n"]]
    every: int


def thinned(
    t: Float[np.ndarray, " n"],
    curves: Mapping[str, Float[np.ndarray, " n"]],
    *,
    values: int,
    edges: Mapping[str, bool] | None = None,
) -> Thinned:
    """The curves by at most about so many `values` in all, times included; unchanged where that suffices.

    `edges` names curves that are the lower (False) or the upper (True) edge of a band, of which one extreme is kept.
    """
    points = max(values // (len(curves) + 1), FEWEST)
    every = 1 if len(t) <= points else -(-2 * len(t) // points)
    pieces = _pieces(t)
    rows = [_stretches(piece, every) for piece in pieces]
    times = _joined([_times(t, index) for index in rows])
    kept = {name: _joined([_extremes(y, i, (edges or {}).get(name)) for i in rows]) for name, y in curves.items()}
    return Thinned(times, kept, every)


def _pieces(t: Float[np.ndarray, " n"]) -> list[Int[np.ndarray, " _"]]:
    """Samples without a gap between them, in the order of their time."""
    order = np.argsort(t, kind="stable")
    steps = np.diff(t[order])
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    return np.split(order, np.flatnonzero(steps > GAP * usual) + 1)


def _stretches(piece: Int[np.ndarray, " k"], every: int) -> Int[np.ndarray, "stretches every"]:
    """A piece in stretches of so many samples, the last one filled up with its last sample."""
    count = -(-len(piece) // every)
    return np.pad(piece, (0, count * every - len(piece)), mode="edge").reshape(count, every)


def _times(t: Float[np.ndarray, " n"], index: Int[np.ndarray, "stretches every"]) -> Float[np.ndarray, " m"]:
    every = index.shape[1]
    return t[index[:, 0]] if every == 1 else t[index[:, [0, every // 2]]].reshape(-1)


def _extremes(
    y: Float[np.ndarray, " n"], index: Int[np.ndarray, "stretches every"], upper: bool | None
) -> Float[np.ndarray, " m"]:
    """The least and the largest of each stretch as they come, or one of them twice."""
    if index.shape[1] == 1:
        return y[index[:, 0]]
    within = y[index]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a stretch in which nothing was measured
        low, high = np.nanmin(within, axis=1), np.nanmax(within, axis=1)
    if upper is not None:
        return np.repeat(high if upper else low, 2)
    known = np.isfinite(within)
    rising = np.where(known, within, np.inf).argmin(axis=1) <= np.where(known, within, -np.inf).argmax(axis=1)
    return np.where(rising, (low, high), (high, low)).T.reshape(-1)


def _joined(pieces: list[Float[np.ndarray, " _"]]) -> Float[np.ndarray, " n"]:
    """Pieces one after another with a NaN between them."""
    return np.concatenate([part for piece in pieces for part in (piece, [np.nan])][:-1])
