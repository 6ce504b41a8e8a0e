"""Where simulation and recording differ: in which channel, when, and in which regime of the drive.

A block is a smooth bump on one channel over a stretch of time, or on the samples of one channel in one regime: what a
sensor there would have to read differently. Bumps overlap by half, so that something local has one that fits. Blocks
are tested like effects are, after what the fitted parameters and initial states can absorb.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Shaped

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised, Products, Quadratic
from vehicle_sbi.mismatch.hypotheses.hypothesis import Block, Hypothesis, changes_of
from vehicle_sbi.physics.single_track import INPUTS

BLOCKS = 12  # stretches of time that overlap by half
LEAST_S = 0.5  # [s], the shortest of them
BUSY = 0.3  # share of samples that a regime takes up: the most extreme of a quantity
UNITS = {"|steering|": "rad", "steering rate": "rad/s", "|a_y|": "m/s^2", "speed": "m/s", "torque": "N m"}


@dataclass(frozen=True)
class Stretch:
    """A stretch of one recording; times [s] are those of its file."""

    recording: str
    from_s: float
    to_s: float


def clock(simulator: Simulator) -> Float[np.ndarray, " time"]:
    """Time of each sample [s], of recordings one after another."""
    return simulator.windows.u[..., INPUTS.index("time")].reshape(-1)


def own_time(simulator: Simulator, from_s: float, to_s: float) -> list[Stretch]:
    """A stretch of that time as stretches of the recordings that it reaches into, in their own time."""
    windows, found = simulator.windows, dict[str, Stretch]()
    time = clock(simulator).reshape(windows.t.shape)
    padded = np.diff(time, axis=1, prepend=-np.inf) <= 0.0
    inside = (time >= from_s) & (time <= to_s) & ~padded
    names = windows.recordings or ("the recording",) * len(time)
    for k in np.flatnonzero(inside.any(axis=1)):
        name, t = names[k], windows.t[k, inside[k]]
        begun = found[name].from_s if name in found else float(t[0])
        found[name] = Stretch(name, begun, float(t[-1]))
    return [*found.values()]


def lies_in(simulator: Simulator, block: Block) -> list[Stretch]:
    """The recordings that a block lies in, without one that it reaches into with its fading end alone."""
    (start, stop), *_ = stretches(simulator)
    within = own_time(simulator, block.from_s, block.to_s)
    return [one for one in within if one.to_s - one.from_s >= (stop - start) / 2] or within


def spoken(within: Sequence[Stretch]) -> str:
    """Stretches of recordings in words."""
    return " and ".join(f"from {one.from_s:.1f} to {one.to_s:.1f} s of {one.recording}" for one in within)


def stretches(simulator: Simulator) -> list[tuple[float, float]]:
    """Stretches of time of equal length that overlap by half."""
    t = clock(simulator)
    seconds = float(t.max() - t.min())
    length = max(2.0 * seconds / (BLOCKS + 1), LEAST_S)
    starts = np.arange(t.min(), t.max() - 0.5 * length, 0.5 * length)
    return [(float(start), float(start + length)) for start in starts]


def throughout(simulator: Simulator, from_s: float, to_s: float) -> bool:
    """Whether a stretch of time is all that is used of the recordings."""
    t = clock(simulator)
    return from_s <= t.min() and to_s >= t.max()


def bump(t: Float[np.ndarray, " time"], start: float, stop: float) -> Float[np.ndarray, " time"]:
    """0 outside the stretch, 1 in its middle; those of stretches that overlap by half add up to 1."""
    return np.sin(np.pi * np.clip((t - start) / (stop - start), 0.0, 1.0)) ** 2


def regimes(
    simulator: Simulator, theta: Float[np.ndarray, " d"], y: Float[np.ndarray, "channels time"]
) -> dict[str, Float[np.ndarray, " time"]]:
    """Signals of the drive whose extremes make a regime, by name, a value per sample; the speed is the model's."""
    windows = simulator.windows
    steering, front, rear = (windows.u[..., INPUTS.index(name)] for name in ("steering", "torque_front", "torque_rear"))
    turning = np.abs(np.gradient(steering, axis=1) * windows.rate)
    signals = {"|steering|": np.abs(steering).reshape(-1), "steering rate": turning.reshape(-1)}
    if "a_y" in windows.channels:
        signals["|a_y|"] = np.abs(y[windows.channels.index("a_y")])
    watched = replace(simulator, windows=replace(windows, channels=("v_x",), groups=("imu",)))
    changing = {"speed": watched.noise_free(theta[None])[0, 0], "torque": (front + rear).reshape(-1)}
    return signals | {name: signal for name, signal in changing.items() if np.ptp(signal) > 0}


def tested(fit: Fit) -> list[Hypothesis]:
    """Every block: a bump or a step of height one, or a change of the channel's gain in proportion to a signal of the
    drive."""
    simulator, y = fit.simulator, fit.at.y
    t, channels = clock(simulator), simulator.windows.channels
    found = [
        _tested(fit, Block(channel, start, stop), bump(t, start, stop))
        for start, stop in stretches(simulator)
        for channel in channels
    ]
    for name, signal in regimes(simulator, fit.theta, y).items():
        limit = np.quantile(signal, 1.0 - BUSY)
        for i, channel in enumerate(channels):
            for regime, shape in (
                (f"{name} above {limit:.2g} {UNITS[name]}", signal > limit),
                (f"in proportion to {name}", y[i] * (signal - signal.mean())),
            ):
                found.append(_tested(fit, Block(channel, float(t.min()), float(t.max()), regime), shape))
    return found


def _tested(fit: Fit, block: Block, shape: Shaped[np.ndarray, " time"]) -> Hypothesis:
    """A block of any size, of a shape over time."""
    change = np.zeros_like(fit.at.y)
    change[fit.simulator.windows.channels.index(block.channel)] = shape
    where = block.regime or f"from {block.from_s:.6g} to {block.to_s:.6g} s"
    return Hypothesis(f"{block.channel} {where}", -np.inf, np.inf, change, block)


def touching(found: Sequence[Block]) -> list[list[int]]:
    """Numbers of the blocks that touch in one channel, in the order of time; a regime is alone."""
    groups: list[list[int]] = []
    for k in sorted(range(len(found)), key=lambda k: (found[k].regime, found[k].channel, found[k].from_s)):
        if groups and _touch(found[groups[-1][-1]], found[k]):
            groups[-1].append(k)
        else:
            groups.append([k])
    return groups


def _touch(a: Block, b: Block) -> bool:
    return a.channel == b.channel and a.regime == b.regime == "" and b.from_s <= a.to_s


@dataclass(frozen=True)
class Stretches:
    """What a fit leaves of the q stretches of a channel, to test all of them at once, with their products."""

    about: Linearised
    left: Float[np.ndarray, "q channels time"]
    products: Products

    @classmethod
    def of(cls, about: Linearised, changes: Float[np.ndarray, "q channels time"]) -> "Stretches":
        left = about.absorbed(np.nan_to_num(changes))
        return cls(about, left, about.products(left, left))

    def gains(self, e: Float[np.ndarray, "n channels time"]) -> Float[np.ndarray, " n"]:
        """Log likelihood that all of them gain in each absorbed series, at any size, under noise of its own."""
        n, q = len(e), len(self.left)
        H = np.broadcast_to(self.products[:, :, None], (*self.products.shape[:2], n, q, q))
        over = Quadratic(
            H, self.about.products(e, self.left), self.about.squares(e), self.about.count, self.about.largest_rho
        )
        free = np.full((1, q), np.inf)
        x = over.solved(np.zeros((q, q)), -free, free)
        return np.maximum(over.log_likelihood(x) - over.log_likelihood(np.zeros_like(x)), 0.0)


def together(about: Linearised, alone: Sequence[Hypothesis]) -> list[Stretches]:
    """The stretches of each channel."""
    of: dict[str, list[Hypothesis]] = {}
    for one in alone:
        if one.block and not one.block.regime:
            of.setdefault(one.block.channel, []).append(one)
    return [Stretches.of(about, changes_of(same, about.fit.at.y.shape)) for same in of.values()]
