"""How lively a drive is: what it can tell of a car at most, before anything is fitted."""

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.vehicle import GRAVITY

LIVELY = 0.4  # g of lateral acceleration, about half of the grip of a dry road, from which tyres show their limits
TAIL = 0.1  # per cent of samples at either end that do not count
ONE_SIDED = 0.8  # share of the turning in one direction, from which the drive counts as one-sided
STEADY = 0.2  # relative spread of the speed, below which it is one speed


def excitation(recording: Recording) -> tuple[str, ...]:
    """The range of lateral acceleration and speed, and what the drive is too gentle or too uniform for."""
    v_x, a_y = _known(recording, "v_x"), _lateral(recording)
    if v_x is None or a_y is None:
        return ()
    low, high = np.percentile(a_y, [TAIL, 100.0 - TAIL]) / GRAVITY
    slow, fast = np.round(np.percentile(v_x, [TAIL, 100.0 - TAIL]), 1) + 0.0
    said = [f"lateral acceleration from {low:.2f} to {high:.2f} g, speed from {slow:.1f} to {fast:.1f} m/s"]
    peak = max(-low, high)
    if peak < LIVELY:
        said.append(
            f"gentle, up to {peak:.2f} g: friction and the bend of the tyre curve hardly show, stiffnesses come out "
            f"wide; drive up to {LIVELY:g} g"
        )
    left = float(np.sum(np.maximum(a_y, 0.0)) / max(np.sum(np.abs(a_y)), 1e-12))
    if max(left, 1.0 - left) > ONE_SIDED:
        share, side = max((left, "left"), (1.0 - left, "right"))
        said.append(f"{share:.0%} of the turning is to the {side}: offsets and biases hide in it; steer to both sides")
    moving = v_x[v_x > 1.0]
    if len(moving) and np.std(moving) < STEADY * np.mean(moving):
        said.append("nearly one speed: a lag and a relaxation length, or a delay, look alike; drive at several speeds")
    return tuple(said)


def _lateral(recording: Recording) -> Float[np.ndarray, " n"] | None:
    """Lateral acceleration [m/s²], as recorded or as the yaw rate has it."""
    v_x, yaw_rate = (recording.channels.get(name) for name in ("v_x", "yaw_rate"))
    recorded = _known(recording, "a_y")
    if recorded is not None or v_x is None or yaw_rate is None:
        return recorded
    turning = v_x * yaw_rate
    return turning[np.isfinite(turning)] if np.isfinite(turning).any() else None


def _known(recording: Recording, name: str) -> Float[np.ndarray, " n"] | None:
    """The samples of a channel that were recorded, if any were."""
    values = recording.channels.get(name)
    if values is None or not np.isfinite(values).any():
        return None
    return values[np.isfinite(values)]
