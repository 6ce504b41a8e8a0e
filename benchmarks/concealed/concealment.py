"""How strongly an effect is concealed: its strength for a signal-to-noise ratio past what the base model absorbs."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from concealed import outside
from concealed.responses import candidates, directions, slopes
from concealed.setups import Setup, recording
from concealed.strength import Projection, fit, remove, residual, snr
from concealed.worlds import Effects, OwnModel, Series
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.effects import CATALOGUE, Effect

MOST_TRIALS = 14  # of a strength
FAR = 0.25  # prior standard deviations that a fit moves, from which it is done rather than extrapolated
CLOSE = 0.06  # of the signal-to-noise ratio, where the search for an amplitude stops
SHORT = 0.09  # of it, that may be missing
NOT_ALONE = ("lateral_load_transfer.track",)  # next to nothing with even loads, and four-wheel worlds have it anyway


@dataclass(frozen=True, kw_only=True)
class Draft:
    """An effect whose strength is still open: what scales from null to extreme with it, and what shapes it."""

    name: str
    scaled: Mapping[str, tuple[float, float]]
    shape: Mapping[str, float]

    def at(self, strength: float) -> dict[str, float]:
        moved = {name: null + strength * (extreme - null) for name, (null, extreme) in self.scaled.items()}
        if self.name not in CATALOGUE:
            return dict(self.shape) | moved
        null = {p.name.split(".")[1]: p.null or 0.0 for p in CATALOGUE[self.name].parameters}
        return null | dict(self.shape) | moved

    def span(self, seconds: float) -> tuple[float, float] | None:
        """From when to when [s] it acts, for an effect that does not act all the time."""
        if "start" not in self.shape:
            return None
        return self.shape["start"], min(self.shape["start"] + self.shape.get("duration", np.inf), seconds)


def draft(rng: np.random.Generator, name: str, simulator: Simulator, theta: np.ndarray, seconds: float) -> Draft | None:
    """An effect of the catalogue, along parameters that act in this drive; None where none does."""
    effect: Effect = CATALOGUE[name]
    found = [d for d in directions(simulator, theta, effect) if d.parameter.name not in NOT_ALONE]
    if not found:
        return None
    chosen = {int(rng.integers(len(found)))} | {i for i in range(len(found)) if rng.uniform() < 0.4}
    scaled, shape = {}, {}
    for i, direction in enumerate(found):
        p = direction.parameter
        extreme = p.high if rng.uniform(p.low - (p.null or 0.0), p.high - (p.null or 0.0)) > 0 else p.low
        if i in chosen:
            share = rng.uniform(0.4, 1.0) if len(chosen) > 1 else 1.0
            scaled[p.name.split(".")[1]] = (p.null or 0.0, (p.null or 0.0) + share * (extreme - (p.null or 0.0)))
    for p in effect.parameters:
        key, width = p.name.split(".")[1], p.high - p.low
        if p.name not in NOT_ALONE and p not in [d.parameter for d in found]:
            shape[key] = float(rng.uniform(p.low + 0.1 * width, p.high - 0.1 * width))
    if "start" in shape:
        shape["duration"] = float(rng.uniform(1.5, 5.0))
        shape["start"] = float(rng.uniform(1.0, seconds - shape["duration"] - 1.0))
    return Draft(name=name, scaled={k: (float(a), float(b)) for k, (a, b) in scaled.items()}, shape=shape)


def draft_outside(rng: np.random.Generator, name: str, seconds: float) -> Draft:
    one = outside.OUTSIDE[name]
    sign = rng.choice([-1.0, 1.0]) if one.signed else 1.0
    shape = {key: float(rng.uniform(*bounds)) for key, bounds in one.shape.items()}
    if one.starts:
        shape["start"] = float(rng.uniform(0.2, 0.6) * seconds)
    return Draft(name=name, scaled={one.strength: (0.0, float(sign * one.largest))}, shape=shape)


@dataclass(frozen=True, kw_only=True)
class Built:
    """A setup with the strength of what is concealed in it settled, and what that leaves after fitting."""

    setup: Setup
    simulator: Simulator  # the base model on the noise-free recordings with the effects in them
    theta: np.ndarray  # where the projection is taken
    nothing: float  # what the truth without effects differs from the base model, projected
    effects: Effects = field(default_factory=dict)
    drafts: tuple[Draft, ...] = ()
    reached: tuple[float, ...] = ()
    total: float = 0.0
    beyond: tuple[float, ...] = ()  # of each effect, past what the others and, outside, the catalogue can explain


def settle(reach: Callable[[float], float | None], target: float) -> tuple[float, float]:
    """(strength, signal-to-noise ratio) close to the target, or at the largest strength that can be driven.

    `reach` is the ratio at a strength from 0 to 1, None where the car cannot be driven so.
    """
    top, reached = 1.0, reach(1.0)
    while reached is None and top > 0.1:
        top *= 0.6
        reached = reach(top)
    if reached is None or reached < target:
        return top, reached or 0.0
    low, high, strength, value = 0.0, top, top, reached
    for _ in range(MOST_TRIALS):
        if abs(value / target - 1.0) < CLOSE:
            break
        guess = strength * target / max(value, 1e-9)
        inside = low + 0.05 * (high - low) < guess < high - 0.05 * (high - low)
        strength = guess if inside else 0.5 * (low + high)
        value = reach(strength) or math.inf
        low, high = (strength, high) if value < target else (low, strength)
    return strength, float(value)


class Concealment:
    """A setup whose truth without effects is the base model's, as far as the noise lets one tell."""

    def __init__(self, setup: Setup, nothing: float) -> None:
        self.ok, self.last = False, setup.theta
        for _ in range(6):
            self.setup = setup
            quiet = self.series({})
            if quiet is None:
                setup = setup.scaled(0.75)
                continue
            self.quiet = self.simulator(quiet)
            self.theta = setup.theta
            if not isinstance(setup.world, OwnModel):
                self.theta = fit(self.quiet, self.quiet.windows.y, setup.theta)
            self.rest = residual(self.quiet, self.theta, self.quiet.windows.y)
            self.projection = Projection(self.quiet, self.theta)
            self.nothing = snr(self.projection.left(self.rest[None]))
            self.ok = bool(self.nothing < nothing)
            if self.ok:
                return
            setup = setup.scaled(0.75) if _ % 2 == 0 else replace(setup, noise=setup.noise.louder(1.6))

    def series(self, effects: Effects) -> list[Series] | None:
        out = [outside.drive(self.setup.world, plan, effects) for plan in self.setup.train]
        return [one for one in out if one is not None] if all(one is not None for one in out) else None

    def simulator(self, series: Sequence[Series]) -> Simulator:
        pairs = zip(self.setup.train, series, strict=True)
        recordings = [recording("a", plan, one, self.setup.given, {}) for plan, one in pairs]
        return self.setup.given.simulator(recordings, self.setup.noise)

    def recorded(self, effects: Effects) -> Simulator | None:
        """The base model over what is recorded with effects; None where that has other windows, or none."""
        series = self.series(effects)
        if series is None:
            return None
        simulator = self.simulator(series)
        return simulator if simulator.windows.y.shape == self.quiet.windows.y.shape else None

    def change(self, effects: Effects) -> np.ndarray | None:
        """What effects change of the residual of the base model (channels, time)."""
        simulator = self.recorded(effects)
        if simulator is None:
            return None
        changed = residual(simulator, self.theta, simulator.windows.y) - self.rest
        return changed if np.isfinite(changed).all() else None

    def reach(self, one: Draft, strength: float) -> float | None:
        """The ratio of one effect at a strength, at first order about the base model's fit without it."""
        changed = self.change({one.name: one.at(strength)})
        return None if changed is None else snr(self.projection.left(changed[None]))

    def reach_fitted(self, one: Draft, strength: float) -> float | None:
        """The same once the base model is fitted to what the effect does, however far its parameters move."""
        simulator = self.recorded({one.name: one.at(strength)})
        if simulator is None:
            return None
        fitted, left = self.fitted(simulator, self.last)
        self.last = fitted.theta
        return snr(fitted.left(left[None]))

    def fitted(self, simulator: Simulator, start: np.ndarray) -> tuple[Projection, np.ndarray]:
        """About the base model's fit to what a simulator has recorded, and what it leaves beyond what nothing does."""
        changed = residual(simulator, self.theta, simulator.windows.y) - self.rest
        if not self.moves(changed):
            return Projection(simulator, self.theta), changed
        theta = fit(simulator, simulator.windows.y, start)
        return Projection(simulator, theta), residual(simulator, theta, simulator.windows.y) - self.rest

    def moves(self, changed: np.ndarray) -> bool:
        """Whether fitting a change moves a parameter so far that it is no matter of first order."""
        return bool(np.abs(self.projection.shift(changed)).max(initial=0.0) > FAR)

    def strength(self, one: Draft, target: float) -> tuple[float, float]:
        """(strength, ratio) close to a target: at first order, or fitted at each strength where parameters move far."""
        strength, reached = settle(partial(self.reach, one), target)
        changed = self.change({one.name: one.at(strength)})
        if changed is None or not self.moves(changed):
            return strength, reached
        self.last = self.theta
        return settle(partial(self.reach_fitted, one), target)

    def finish(self, drafts: Sequence[Draft], strengths: Sequence[float]) -> Built | None:
        """All effects together: sealed ratios are taken about the recordings that the tool gets."""
        effects = {one.name: one.at(s) for one, s in zip(drafts, strengths, strict=True)}
        series = self.series(effects)
        if series is None:
            return None
        simulator = self.simulator(series)
        changes = [self.change({name: values}) for name, values in effects.items()]
        if any(c is None for c in changes):
            return None
        projection, together = self.fitted(simulator, self.theta)
        left = projection.left(np.array([*changes, together]))
        alone = [snr(row) for row in left[:-1]]
        beyond = [
            snr(remove(left[i : i + 1], np.delete(left[:-1], i, axis=0), entirely=True)) for i in range(len(drafts))
        ]
        if len(drafts) == 1 and drafts[0].name not in CATALOGUE:
            beyond = [unexplained(simulator, projection, left[-1])]
        return Built(
            setup=self.setup,
            simulator=simulator,
            theta=self.theta,
            nothing=self.nothing,
            effects=effects,
            drafts=tuple(drafts),
            reached=tuple(alone),
            total=snr(left[-1]),
            beyond=tuple(beyond),
        )


def unexplained(simulator: Simulator, projection: Projection, left: np.ndarray) -> float:
    """What the best effect of the catalogue leaves of a change, its parameters free and without a prior.

    What starts and ends is tried at several moments, about a quarter of a window apart at most.
    """
    found = candidates(simulator, projection.theta)
    last = float(simulator.windows.t.max())
    timed = [
        replace(d, held=dict(d.held) | {p: value for p in d.held for k, value in moments.items() if p.name.endswith(k)})
        for d in found
        if any(p.name.endswith(".start") for p in d.held)
        for start in np.linspace(0.0, last, 8)[:-1]
        for length in (1.5, 5.0)
        for moments in [{".start": float(start), ".duration": length}]
    ]
    g = projection.left(slopes(simulator, projection.theta, [*found, *timed]))
    names = [d.parameter.name.split(".")[0] for d in found]
    groups = [[i for i, name in enumerate(names) if name == one] for one in dict.fromkeys(names)]
    groups += [[len(found) + i] for i in range(len(timed))]
    return min(snr(remove(left[None], g[group], entirely=True)) for group in groups)
