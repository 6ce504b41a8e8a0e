"""Effects that the catalogue does not have: what the right answer to is `unknown`.

Each has a strength that is scaled to reach a signal-to-noise ratio, up to `largest`, and a shape that is drawn. Kinds
`command` and `sensor` stand before and behind any world; those of the kind `twin` are in the twin's equations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from concealed.drives import Plan
from concealed.worlds import Effects, Series, World
from vehicle_sbi.physics.effects import CATALOGUE


@dataclass(frozen=True, kw_only=True)
class Outside:
    """An effect outside the catalogue: `strength` names the parameter that is scaled, `shape` bounds the others."""

    meaning: str
    kind: str
    strength: str
    largest: float
    shape: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    signed: bool = False
    starts: bool = False  # at a moment, its parameter `start`, until the end


OUTSIDE: Mapping[str, Outside] = {
    "stick_slip_steering": Outside(
        meaning="the wheels stick, then jump to the command", kind="command", strength="threshold", largest=0.05
    ),
    "speed_dependent_ratio": Outside(
        meaning="the steering's gain changes with speed", kind="command", strength="slope", largest=0.08, signed=True
    ),
    "rate_limited_steering": Outside(
        meaning="the wheels turn no faster than a share of what is commanded at most", kind="command",
        strength="clipped", largest=0.95,
    ),
    "one_sided_steering": Outside(
        meaning="the steering's gain is another one to the left", kind="command", strength="gain", largest=0.6,
        signed=True,
    ),
    "holding_accelerometer": Outside(
        meaning="the accelerometer repeats its last reading at random", kind="sensor", strength="share", largest=0.95,
        shape={"draw": (0.0, 1e6)},
    ),
    "saturating_gyro": Outside(
        meaning="the yaw-rate sensor clips", kind="sensor", strength="clipped", largest=0.8
    ),
    "quantised_gyro": Outside(
        meaning="the yaw-rate sensor has coarse steps", kind="sensor", strength="step", largest=0.3
    ),
    "cubic_accelerometer": Outside(
        meaning="a_y compresses with its cube", kind="sensor", strength="cubic", largest=0.1, signed=True
    ),
    "drifting_gyro": Outside(
        meaning="the yaw-rate sensor's zero walks at random, anew in each recording", kind="sensor",
        strength="rate", largest=0.1, shape={"draw": (0.0, 1e6)},
    ),
    "cross_talk": Outside(
        meaning="yaw acceleration leaks into the yaw-rate channel's neighbour a_y, one sign only", kind="sensor",
        strength="leak", largest=3.0,
    ),
    "dragging_rear_wheel": Outside(
        meaning="the left rear wheel drags from a moment on", kind="twin", strength="torque", largest=900.0, starts=True
    ),
    "warming_tyres": Outside(
        meaning="cornering and longitudinal stiffness drift as tyres warm up", kind="twin", strength="gain",
        largest=0.6, signed=True, shape={"time": (4.0, 12.0)},
    ),
    "torque_vectoring": Outside(
        meaning="a yaw moment proportional to the steering", kind="twin", strength="moment", largest=60e3, signed=True
    ),
    "rear_compliance_steer": Outside(
        meaning="the rear axle's side force steers the rear wheels", kind="twin", strength="coefficient",
        largest=5e-6, signed=True,
    ),
    "growing_side_pull": Outside(
        meaning="a side force that grows with the square of the speed", kind="twin", strength="force", largest=6.0,
        signed=True,
    ),
}  # fmt: skip


def drive(world: World, plan: Plan, effects: Effects) -> Series | None:
    """A world's series with catalogue effects and those outside it; recorded commands stay the plan's."""
    inside = {name: values for name, values in effects.items() if name in CATALOGUE or OUTSIDE[name].kind == "twin"}
    series = world.drive(replace(plan, steering=_commanded(plan, effects)), inside)
    return None if series is None else _sensed(series | {"steering": plan.steering}, plan, effects)


def _commanded(plan: Plan, effects: Effects) -> np.ndarray:
    delta = plan.steering.copy()
    if "stick_slip_steering" in effects:
        threshold = effects["stick_slip_steering"]["threshold"]
        for k in range(1, len(delta)):
            delta[k] = delta[k] if abs(delta[k] - delta[k - 1]) > threshold else delta[k - 1]
    if "rate_limited_steering" in effects:
        most = (1.0 - effects["rate_limited_steering"]["clipped"]) * abs(np.diff(delta)).max()
        for k in range(1, len(delta)):
            delta[k] = np.clip(delta[k], delta[k - 1] - most, delta[k - 1] + most)
    if "one_sided_steering" in effects:
        delta += effects["one_sided_steering"]["gain"] * np.maximum(delta, 0.0)
    if "speed_dependent_ratio" in effects:
        v = plan.v_x
        delta *= 1.0 + effects["speed_dependent_ratio"]["slope"] * (v - v.mean())
    return delta


def _sensed(series: Series, plan: Plan, effects: Effects) -> Series:
    out = dict(series)
    if "saturating_gyro" in effects:
        limit = (1.0 - effects["saturating_gyro"]["clipped"]) * abs(out["yaw_rate"]).max()
        out["yaw_rate"] = np.clip(out["yaw_rate"], -limit, limit)
    if "holding_accelerometer" in effects:
        held = effects["holding_accelerometer"]
        fresh = _draws(plan, int(held["draw"])).uniform(size=len(plan.t)) >= held["share"]
        last = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
        out |= {name: out[name][last] for name in ("a_x", "a_y")}
    if "quantised_gyro" in effects:
        step = effects["quantised_gyro"]["step"]
        out["yaw_rate"] = step * np.floor(out["yaw_rate"] / step + 0.5)
    if "cubic_accelerometer" in effects:
        out["a_y"] = out["a_y"] - effects["cubic_accelerometer"]["cubic"] * out["a_y"] ** 3
    if "drifting_gyro" in effects:
        drift = effects["drifting_gyro"]
        out["yaw_rate"] = out["yaw_rate"] + drift["rate"] * _walk(plan, int(drift["draw"]))
    if "cross_talk" in effects:
        out["a_y"] = out["a_y"] + effects["cross_talk"]["leak"] * np.abs(out["yaw_rate"])
    return out


def _walk(plan: Plan, draw: int) -> np.ndarray:
    """A random walk of variance t, another one in each recording of a draw."""
    return _draws(plan, draw).standard_normal(len(plan.t)).cumsum() / np.sqrt(plan.rate)


def _draws(plan: Plan, draw: int) -> np.random.Generator:
    """Random numbers, others in each recording of a draw."""
    return np.random.default_rng((draw, crc32(f"{plan.manoeuvre} {plan.v_0} {len(plan.t)}".encode())))
