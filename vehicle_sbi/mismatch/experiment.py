"""The experiment that separates: which further drive would tell apart two explanations that fit equally well.

Both fitted models are simulated over a menu of drives made from the one that was recorded. What they differ by there,
after what the parameters may still absorb given what is known of them from the recordings, is the separation in
standard deviations. All of it follows from simulation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.recording import Windows
from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.fit import Fit, linearise
from vehicle_sbi.physics.single_track import INPUTS

WORTH = 3.0  # standard deviations from which an experiment is worth naming
STEERING, SPEED, ACCELERATION = (INPUTS.index(name) for name in ("steering", "v_x", "v_x_dot"))
PACED = [INPUTS.index(name) for name in ("v_x", "v_x_dot", "wheel_speed_front", "wheel_speed_rear")]


@dataclass(frozen=True)
class Experiment:
    """A drive and by how many standard deviations it would tell two models apart."""

    drive: str
    separation: float


def _mirrored(w: Windows) -> Windows:
    u = w.u.copy()
    u[..., STEERING] *= -1.0
    return replace(w, u=u, x0=w.x0 * [1.0, -1.0, -1.0])


def _straight(w: Windows) -> Windows:
    u = w.u.copy()
    u[..., STEERING] = 0.0
    return replace(w, u=u, x0=w.x0 * [1.0, 0.0, 0.0])


def _circle(w: Windows) -> Windows:
    u = w.u.copy()
    u[..., STEERING] = 0.7 * np.abs(w.u[..., STEERING]).max()
    return replace(w, u=u)


def _paced(factor: float) -> Callable[[Windows], Windows]:
    def change(w: Windows) -> Windows:
        u = w.u.copy()
        u[..., PACED] *= factor
        return replace(w, u=u, x0=w.x0 * [factor, 1.0, 1.0])

    return change


def _quicker(w: Windows) -> Windows:
    """The steering of the first half of each window over and over, twice as fast."""
    u, half = w.u.copy(), (w.u.shape[1] + 1) // 2
    fast = w.u[:, ::2, STEERING]
    u[:, :half, STEERING], u[:, half:, STEERING] = fast, fast[:, : u.shape[1] - half]
    return replace(w, u=u)


MENU: Mapping[str, Callable[[Windows], Windows]] = {
    "the same drive with the steering mirrored": _mirrored,
    "the same speeds straight ahead": _straight,
    "a steady circle at the same speeds": _circle,
    "the same steering at 0.7 times the speed": _paced(0.7),
    "the same steering at 1.3 times the speed": _paced(1.3),
    "the same drive with steering twice as fast": _quicker,
}


def separations(a: Model, b: Model) -> list[Experiment]:
    """How well each drive of the menu would tell the models apart, the best first."""
    found = []
    for drive, change in MENU.items():
        separation = _separation(a.fit, b.fit, change)
        if np.isfinite(separation):
            found.append(Experiment(drive, separation))
    return sorted(found, key=lambda one: -one.separation)


def _separation(a: Fit, b: Fit, change: Callable[[Windows], Windows]) -> float:
    """Standard deviations between the models over a changed drive; NaN where one of them cannot be simulated there."""
    windows = change(a.simulator.windows)
    there = [replace(fit.simulator, windows=windows) for fit in (a, b)]
    at = linearise(there[0], a.theta)
    other = there[1].noise_free(b.theta[None])[0]
    if not (np.isfinite(at.J).all() and np.isfinite(other).all()):
        return float("nan")
    metric = Fit(a.observation.extended(there[0]), a.theta, at).metric
    d = metric(other - at.y).reshape(-1)
    J: Float[np.ndarray, "d samples"] = metric(at.J).reshape(len(a.theta), -1)
    known = a.information + np.eye(len(a.theta)) + J @ J.T
    score = J @ d
    return float(np.sqrt(max(d @ d - score @ np.linalg.solve(known, score), 0.0)))


def advice(a: Model, b: Model) -> str:
    """Which drive would separate them, in a sentence; empty where none on the menu would."""
    ranked = separations(a, b)
    if not ranked or ranked[0].separation < WORTH:
        return ""
    best = ranked[0]
    return (
        f"To tell {' with '.join(a.effects)} from {' with '.join(b.effects)}, record {best.drive}: "
        f"they would differ by {best.separation:.0f} standard deviations."
    )
