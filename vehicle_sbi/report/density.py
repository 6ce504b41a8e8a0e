"""Kernel density of samples in a box, and the level that holds a share of it: what contours of a posterior are made of.

f(x) = 1/n sum_i sum_m K(m(x) - x_i) for x in the box, K a Gaussian of Scott's width and m(x) the images of x mirrored
at the box's faces, so that f keeps its mass inside (Silverman, Density Estimation, 1986, sec. 2.10).
"""

from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.stats import gaussian_kde


def density_in_box(
    samples: Float[np.ndarray, "n k"],
    points: Float[np.ndarray, "m k"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " m"]:
    """The density at points of the box; samples on a line or a point are widened invisibly.

    Without the mirror images a flat posterior would seem to fall off towards the bounds of its prior. Faces that no
    sample comes within four kernel widths of need none.
    """
    try:
        kde = gaussian_kde(samples.T)
    except np.linalg.LinAlgError:
        spread = 1e-4 * (high - low) * np.random.default_rng(0).standard_normal(samples.shape)
        kde = gaussian_kde((samples + spread).T)
    reach = 4.0 * np.sqrt(np.diag(np.atleast_2d(kde.covariance)))
    faces = [
        [None, *([a] if x.min() < a + r else []), *([b] if x.max() > b - r else [])]
        for x, a, b, r in zip(samples.T, low, high, reach, strict=True)
    ]
    images = [
        np.column_stack([x if face is None else 2.0 * face - x for x, face in zip(points.T, at, strict=True)])
        for at in product(*faces)
    ]
    return np.sum([kde(image.T) for image in images], axis=0)


def level_of(density: np.ndarray, mass: float) -> float:
    """The density above which `mass` of the distribution lies, from its values on a uniform grid."""
    falling = np.sort(density, axis=None)[::-1]
    share = np.cumsum(falling) / falling.sum()
    return float(falling[min(int(np.searchsorted(share, mass)), falling.size - 1)])
