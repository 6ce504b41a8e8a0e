"""Which effects are needed where all others may act too: what the full model says of names that the search finds.

A search adds one effect after another, and each takes over what it can of all that is still missing. In the full model
every effect is free at once, and one that others can stand in for may as well be nothing. With the precision P of the
shrinkage and the information F (to a power, as evidence is) about the full model's optimum, the ratio of the densities
at the null (Savage and Dickey; Verdinelli and Wasserman 1995) is the evidence for a group of parameters x,

    log B = 1/2 x' S^-1 x + 1/2 log det S - 1/2 log det P^-1,   S the part of (F + P)^-1 that belongs to the group

What cannot be told from an effect (a coherence above INSEPARABLE after the base parameters have taken what they can)
is in its group: that one of them is needed is all that can be asked. The prior odds are those of a rate.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logit

from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.separability import INSEPARABLE
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

RATE = 0.15  # of the catalogue's effects that a real car has beside what its model has: about six of forty


def needed(full: Fit, base: tuple[str, ...], power: float) -> dict[str, float]:
    """How probable it is that each effect of the full model, or what cannot be told from it, is not nothing."""
    if full.shrinkage is None:
        raise ValueError("a full model is one whose effects are shrunk to their nulls")
    space, precision = full.simulator.space, full.shrinkage.precision
    added = np.array([name not in base for name in space.names])
    covariance = np.linalg.inv(power * full.information + np.diag(precision))
    off = np.array([x - (p.null or 0.0) for p, x in zip(space.parameters, full.theta, strict=True)]) / space.prior_std
    alike = _coherence(full.information, added) > INSEPARABLE
    effects = np.array([name.split(".")[0] if name in EFFECT_PARAMETERS else "" for name in space.names])
    found = {}
    for effect in dict.fromkeys(effects[added]):
        group = np.flatnonzero(added & alike[added & (effects == effect)].any(axis=0))
        S, x = covariance[np.ix_(group, group)], off[group]
        volume = np.linalg.slogdet(S)[1] + np.log(precision[group]).sum()
        found[str(effect)] = float(expit(0.5 * (x @ np.linalg.solve(S, x) + volume) + logit(RATE)))
    return found


def _coherence(information: Float[np.ndarray, "d d"], added: np.ndarray) -> Float[np.ndarray, "d d"]:
    """Of the added parameters beyond what the others take; 1 of each with itself, 0 where one changes nothing."""
    ours, theirs = np.flatnonzero(added), np.flatnonzero(~added)
    cross = information[np.ix_(ours, theirs)]
    own = information[np.ix_(theirs, theirs)] + np.eye(len(theirs))
    left = information[np.ix_(ours, ours)] - cross @ np.linalg.solve(own, cross.T)
    size = np.sqrt(np.maximum(np.diag(left), 1e-12))
    coherence = np.eye(len(information))
    coherence[np.ix_(ours, ours)] = np.abs(left) / np.outer(size, size)
    np.fill_diagonal(coherence, 1.0)
    return coherence
