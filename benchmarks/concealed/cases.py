"""Cases: what is concealed in which drive, how strongly, and the files that the tool gets; a function of (seed, index).

Every block of 40 cases has the benchmark's mix of kinds and levels in a shuffled order, and effects are dealt from
shuffled decks, so that any number of cases is balanced. An attempt draws a car, its drives and its sensors; attempts go
on until one of them lets the effect reach the signal-to-noise ratio that was drawn, or the best of them is taken.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from concealed import drives, outside
from concealed.multibody_car import OFFERED, SETS, MultiBody, vehicle_of
from concealed.responses import candidates, directions, slopes
from concealed.strength import WARMUP_S, WINDOW_S, Given, Noise, Projection, fit, remove, residual, snr
from concealed.twin import Twin
from concealed.worlds import Effects, OwnModel, Series, World
from vehicle_sbi.data.recording import CHANNELS, NEEDED, Recording
from vehicle_sbi.files import write_atomically, write_text
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.effects import CATALOGUE, Effect
from vehicle_sbi.physics.vehicle import Vehicle

MIX: Mapping[tuple[str, str], int] = {
    ("none", "L0"): 7, ("single", "L0"): 7, ("outside", "L0"): 2, ("pair", "L0"): 4,
    ("none", "L1"): 3, ("single", "L1"): 5, ("outside", "L1"): 4, ("pair", "L1"): 2,
    ("none", "L2"): 2, ("single", "L2"): 4,
}  # fmt: skip
"""Cases of each kind and level in a block."""

SNRS = (4.0, 8.0, 16.0, 32.0)
DETECTABLE = 4.0
NOTHING = {"L0": 1.5, "L1": 2.0}  # what the truth without effects may differ from the fitted base model, projected
MOST_TRIALS = 14  # of a strength
ATTEMPTS, MOST_ATTEMPTS = 8, 40  # that may fall short, and of any kind
MULTIBODY = 0.2  # share of attempts at level L1 with the multi-body car, where it has the effects
FAR = 0.25  # prior standard deviations that a fit moves, from which it is done rather than extrapolated
CLOSE = 0.03  # of the signal-to-noise ratio, where the search for an amplitude stops
ONCE = ("start", "duration", "angle_0")  # an effect with one of these parameters happens in one recording only


@dataclass(frozen=True)
class Slot:
    """What a case is to be, before anything of it is drawn."""

    index: int
    kind: str
    level: str
    effects: tuple[str, ...]
    snr: float


def _dealt(deck: Sequence[str], n: int, seed: int, stream: int) -> str:
    """The n-th card of a deck that is shuffled anew each time it is through."""
    order = np.random.default_rng((seed, stream, n // len(deck))).permutation(len(deck))
    return deck[int(order[n % len(deck)])]


def slot(seed: int, index: int, injectable: Sequence[str]) -> Slot:
    """What case `index` is to be; `injectable` are the effects that real recordings can be given."""
    block, place = divmod(index, sum(MIX.values()))
    cells = [cell for cell, n in MIX.items() for _ in range(n)]
    order = np.random.default_rng((seed, 1, block)).permutation(len(cells))
    kind, level = cells[order[place]]
    before = sum(cells[k][0] == kind and (cells[k][1] == "L2") == (level == "L2") for k in order[:place])
    each = sum(n for (k, at), n in MIX.items() if k == kind and (at == "L2") == (level == "L2"))
    n, inside = block * each + before, list(CATALOGUE)
    strength = _dealt([str(v) for v in (SNRS if kind in ("single", "pair") else SNRS[1:])], n, seed, 2)
    if kind == "none":
        return Slot(index, kind, level, (), 0.0)
    if kind == "outside":
        deck = [k for k, one in outside.OUTSIDE.items() if level == "L1" or one.kind != "twin"]
        return Slot(index, kind, level, (_dealt(deck, n, seed, 3 if level == "L1" else 4),), float(strength))
    if kind == "pair":
        first, second = (_dealt(inside, 2 * n + i, seed, 5) for i in (0, 1))
        if first == second:
            second = inside[(inside.index(second) + 1) % len(inside)]
        return Slot(index, kind, level, (first, second), float(strength))
    if level == "L2":
        return Slot(index, kind, level, (_dealt(injectable, n, seed, 6),), float(strength))
    return Slot(index, kind, level, (_dealt(inside, n, seed, 7),), float(strength))


# --- an attempt: a car, its drives, its sensors ---------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A car that drives, and what the tool is told of it."""

    world: World
    given: Given
    theta: np.ndarray  # true base parameters
    train: tuple[drives.Plan, ...]
    heldout: tuple[drives.Plan, ...]
    noise: Noise
    regime: str
    truth: Vehicle
    world_name: str

    def scaled(self, factor: float) -> "Setup":
        return replace(self, train=tuple(p.scaled(factor) for p in self.train))


def recording(name: str, plan: drives.Plan, series: Series, given: Given, added: Mapping[str, np.ndarray]) -> Recording:
    """A recording in memory: commands, what drives the model, what is measured, with noise `added`."""
    names = dict.fromkeys(("steering", *NEEDED[given.drive], "v_x", *given.channels))
    if given.drive == "torque":
        names["torque_rear"] = None
    channels = {n: series[n] + added.get(n, 0.0) for n in names}
    return Recording(
        name=name,
        rate=plan.rate,
        t=plan.t,
        channels=channels,
        valid={n: np.ones(len(plan.t), dtype=bool) for n in channels},
        groups={},
        source=name,
        sha256="",
    )


def _given(
    rng: np.random.Generator, truth: Vehicle, model: str, effects: Sequence[str], vague: bool
) -> tuple[Given, np.ndarray]:
    """What the tool is told of a car, and the truth of what it fits; fitted constants are off by up to their prior.

    `vague`: of a car whose own constants mean something slightly else; boxes are wide and the steering is fitted.
    """
    drive = str(rng.choice(["speed", "wheel_speed", "torque"], p=[0.4, 0.2, 0.4]))
    channels = ["a_y", "yaw_rate"]
    if drive != "speed" or rng.uniform() < 0.4:
        channels = ["a_x", *channels]
    if drive == "torque":
        channels += ["wheel_speed_front", "wheel_speed_rear"] + ["v_x"] * (rng.uniform() < 0.5)
    if model == "full_vehicle" and rng.uniform() < 0.6:
        channels += ["roll_rate"]
    fitted = ["C_alpha_f", "C_alpha_r", "l_f"] + (["C_kappa_f", "C_kappa_r"] if drive != "speed" else [])
    stated, prior, true = {}, {}, {}
    for name in fitted:
        true[name] = getattr(truth, name)
        if name == "l_f":
            stated[name] = true[name] + rng.uniform(-0.12, 0.12)
            reach = 0.4 if vague else 0.2
            prior[name] = stated[name] - reach, stated[name] + reach
        else:
            stated[name] = true[name] * rng.uniform(0.75, 1.3)
            prior[name] = (0.4 if vague else 0.6) * stated[name], (2.5 if vague else 1.6) * stated[name]
    if "steering_ratio" not in effects and (vague or rng.uniform() < 0.6):
        true["steering_ratio.gain"] = rng.uniform(0.93, 1.07)
        prior["steering_ratio.gain"] = 0.85, 1.18
    prior = {name: (float(f"{low:.5g}"), float(f"{high:.5g}")) for name, (low, high) in prior.items()}
    vehicle = replace(truth, name="car", **{name: float(f"{value:.5g}") for name, value in stated.items()})
    given = Given(vehicle=vehicle, model=model, drive=drive, channels=tuple(channels), prior=prior)
    return given, np.array([true[name] for name in prior])


def _noise(rng: np.random.Generator, given: Given) -> Noise:
    """White, autocorrelated or heavy-tailed; what drives the model is measured well, and its noise is white."""
    std = {
        "a_x": rng.uniform(0.05, 0.15), "a_y": rng.uniform(0.05, 0.15), "yaw_rate": rng.uniform(0.002, 0.006),
        "roll_rate": rng.uniform(0.003, 0.008), "v_x": rng.uniform(0.02, 0.05),
        "wheel_speed_front": rng.uniform(0.03, 0.1), "wheel_speed_rear": rng.uniform(0.03, 0.1),
    }  # fmt: skip
    std |= dict.fromkeys(NEEDED[given.drive], 0.003 if given.drive == "speed" else 0.005)
    kind = str(rng.choice(["white", "ar1", "student"]))
    rho = {n: float(rng.uniform(0.5, 0.95)) if kind == "ar1" and n in given.channels else 0.0 for n in std}
    return Noise(std={n: float(s) for n, s in std.items()}, rho=rho, tail="student" if kind == "student" else "normal")


def attempt(rng: np.random.Generator, level: str, effects: Sequence[str]) -> Setup:
    """A car with its drives and sensors, drawn without a look at what they would show."""
    model = "full_vehicle" if level == "L0" and rng.uniform() < 0.25 else "single_track"
    offered = all(
        name in OFFERED or (name in outside.OUTSIDE and outside.OUTSIDE[name].kind != "twin") for name in effects
    )
    number = int(rng.choice(list(SETS))) if level == "L1" and offered and rng.uniform() < MULTIBODY else None
    relaxed = "relaxation" in effects or rng.uniform() < 0.5
    car = drives.car(rng, relaxed=relaxed, body=model == "full_vehicle") if number is None else vehicle_of(number)
    given, theta = _given(rng, car, model, effects, number is not None)
    gain = float(dict(zip(given.prior, theta, strict=True)).get("steering_ratio.gain", 1.0))
    gentle = level == "L1" and (number is not None or rng.uniform() < 0.7)
    regime = "gentle" if gentle else str(rng.choice(["gentle", "normal", "limit"][: 2 if level == "L1" else 3]))
    rate, once = float(rng.choice([50.0, 100.0])), any(_happens_once(name) for name in effects)
    n = 1 if once or number is not None else int(rng.choice([1, 2, 5], p=[0.5, 0.33, 0.17]))
    settings: dict[str, Any] = {
        "rate": rate, "smooth": 0.4 if given.drive == "speed" else 0.15, "asks": 0.5 if given.drive == "speed" else 0.9
    }  # fmt: skip
    longest = 26 if n < 5 and number is None else 16
    plans = [
        drives.plan(car, regime, rng, seconds=float(rng.integers(12, longest)), **settings)
        for _ in range(n + int(rng.integers(1, 3)))
    ]
    world: World = OwnModel(car=car, model=model, drive_mode=given.drive, gain=gain)
    if number is not None:
        world = MultiBody(number=number, gain=gain)
        plans = [world.slower(plan) for plan in plans]
    elif level == "L1":
        C = float(rng.uniform(1.2, 1.5))
        world = Twin(car=car, gain=gain, C=C, E=-(1.0 + C**2 / 2) * rng.uniform(0.7, 1.0))
    own = f"the project's {model}" if level == "L0" else "twin"
    noise = _noise(rng, given)
    return Setup(
        world=world,
        given=given,
        theta=theta,
        train=tuple(plans[:n]),
        heldout=tuple(plans[n:]),
        noise=noise if number is None else noise.louder(2.0),
        regime=regime,
        truth=car,
        world_name=own if number is None else f"multi-body car, set {number}",
    )


# --- what is concealed ----------------------------------------------------------------------------------------------


def _happens_once(name: str) -> bool:
    parameters = [p.name.split(".")[1] for p in CATALOGUE[name].parameters] if name in CATALOGUE else ()
    return any(p in ONCE for p in parameters)


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
    found = directions(simulator, theta, effect)
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
        if p not in [d.parameter for d in found]:
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
        self.ok = False
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
        fitted, left = self.fitted(simulator)
        return snr(fitted.left(left[None]))

    def fitted(self, simulator: Simulator) -> tuple[Projection, np.ndarray]:
        """About the base model's fit to what a simulator has recorded, and what it leaves beyond what nothing does."""
        changed = residual(simulator, self.theta, simulator.windows.y) - self.rest
        if not self.moves(changed):
            return Projection(simulator, self.theta), changed
        theta = fit(simulator, simulator.windows.y, self.theta)
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
        projection, together = self.fitted(simulator)
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


def conceal(seed: int, wanted: Slot) -> Built:
    """The first attempt in which what is wanted reaches the ratio that was drawn, or the one that comes closest.

    An attempt that falls short is only remembered; if all do, the best of them is taken at a ratio that it reaches.
    """
    short: list[tuple[float, int]] = []
    for k in range(MOST_ATTEMPTS):
        if len(short) >= ATTEMPTS and max(short)[0] > 0.0:
            break
        built, worth = _conceal(seed, wanted, k, wanted.snr)
        if built is not None and worth >= 1.0:
            return built
        short.append((worth, -k))
    worth, k = max(short)
    for target in [value for value in SNRS[::-1] if value < wanted.snr and value <= worth * wanted.snr] or [wanted.snr]:
        built, _ = _conceal(seed, wanted, -k, target, anyway=True)
        if built is not None:
            return built
    raise RuntimeError(f"case {wanted.index}: no attempt lets {wanted} be driven")


def _conceal(seed: int, wanted: Slot, k: int, target: float, *, anyway: bool = False) -> tuple[Built | None, float]:
    """Attempt k: what it built, None where it falls short (unless `anyway`), and its worth, 1 where it does not."""
    rng = np.random.default_rng((seed, 10, wanted.index, k))
    hidden = Concealment(attempt(rng, wanted.level, wanted.effects), NOTHING[wanted.level])
    if not hidden.ok:
        return None, 0.0
    seconds = min(float(plan.t[-1]) for plan in hidden.setup.train)
    drafts, strengths, worth = [], [], 1.0
    for name in wanted.effects:
        inside = name in CATALOGUE
        one = draft(rng, name, hidden.quiet, hidden.theta, seconds) if inside else draft_outside(rng, name, seconds)
        if one is None:
            return None, 0.0
        strength, reached = hidden.strength(one, target)
        worth = min(worth, reached / target / (1.0 - CLOSE))
        if worth < 1.0 and not anyway:
            return None, worth
        drafts.append(one)
        strengths.append(strength)
    built = hidden.finish(drafts, strengths)
    if built is None:
        return None, 0.0
    return built, min([worth, *(beyond / DETECTABLE / (1.0 - 3 * CLOSE) for beyond in built.beyond)])


# --- files ----------------------------------------------------------------------------------------------------------


def overrides(case: Path, given: Given, recordings: Sequence[str], heldout: Sequence[str]) -> list[str]:
    """The words that `scripts/diagnose.py` is called with: the one place that knows its grammar."""
    prior = {name: f"[{low:.6g},{high:.6g}]" for name, (low, high) in given.prior.items()}
    prior.setdefault("steering_ratio.gain", "null")  # in the default prior; null takes it out
    return [
        f"recordings=[{','.join(str(case / name) for name in recordings)}]",
        f"heldout=[{','.join(str(case / name) for name in heldout)}]",
        f"vehicle={case / 'vehicle.yaml'}",
        f"model={given.model}",
        f"window_s={WINDOW_S:g}",
        f"warmup_s={WARMUP_S:g}",
        f"recording.drive={given.drive}",
        f"recording.v_min={given.v_min:g}",
        f"recording.channels=[{','.join(given.channels)}]",
        *(f"++prior.{name}={value}" for name, value in prior.items()),
    ]


def write_case(
    case: Path, given: Given, recordings: Mapping[str, Mapping[str, np.ndarray]], heldout: Sequence[str]
) -> None:
    """The files that the tool gets: recordings, car, and how it is called; `case.yaml` comes last."""
    for name, columns in recordings.items():
        table = pd.DataFrame({CHANNELS[c].column if c != "time" else "time_s": v for c, v in columns.items()})
        text = table.to_csv(index=False, float_format="%.9g")
        write_text(case / name, text)
    known = {k: v for k, v in asdict(given.vehicle).items() if v is not None}
    write_text(case / "vehicle.yaml", yaml.safe_dump(known, sort_keys=False))
    train = [name for name in recordings if name not in heldout]
    content = {
        "overrides": overrides(case.resolve(), given, train, heldout),
        "recordings": train,
        "heldout": list(heldout),
        "model": given.model,
        "drive": given.drive,
        "channels": list(given.channels),
        "prior": {name: list(box) for name, box in given.prior.items()},
        "v_min": given.v_min,
    }
    write_text(case / "case.yaml", yaml.safe_dump(content, sort_keys=False, width=1000))


def write_sealed(sealed: Path, index: int, truth: Mapping[str, Any], series: Mapping[str, np.ndarray]) -> None:
    arrays: dict[str, Any] = dict(series)
    write_atomically(sealed / f"{index:04d}.npz", lambda file: np.savez_compressed(file, **arrays))
    write_text(sealed / f"{index:04d}.json", json.dumps(truth, indent=1, allow_nan=False))


def build(seed: int, index: int, folder: Path, injected: Callable[..., None], injectable: Sequence[str]) -> None:
    """Build case `index` under folder/cases, its truth under folder/sealed; nothing to do where it stands already."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed"
    if (case / "case.yaml").exists() and (sealed / f"{index:04d}.json").exists():
        return
    wanted = slot(seed, index, injectable)
    if wanted.level == "L2":
        injected(seed, wanted, case, sealed)
        return
    built = conceal(seed, wanted)
    setup, rng = built.setup, np.random.default_rng((seed, 11, index))
    once = {name for name in built.effects if _happens_once(name)}
    files, oracle = {}, {}
    names = [f"{'abcde'[i]}.csv" for i in range(len(setup.train))]
    held = [f"heldout_{i}.csv" for i in range(len(setup.heldout))]
    for name, plan in zip([*names, *held], [*setup.train, *setup.heldout], strict=True):
        lasting = {k: v for k, v in built.effects.items() if name in names or k not in once}
        series = outside.drive(setup.world, plan, lasting)
        for _ in range(6):
            if series is not None:
                break
            plan = plan.scaled(0.75)  # a held-out drive that the car cannot take
            series = outside.drive(setup.world, plan, lasting)
        if series is None:
            raise RuntimeError(f"case {index}: {name} cannot be driven")
        added = {n: setup.noise.draw(n, len(plan.t), rng) for n in setup.noise.std}
        files[name] = {"time": plan.t} | dict(recording(name, plan, series, setup.given, added).channels)
        oracle |= {f"{name}:{channel}": series[channel] for channel in setup.given.channels}
    write_sealed(sealed, index, _truth(wanted, built, once, held), oracle)
    write_case(case, setup.given, files, held)


def _truth(wanted: Slot, built: Built, once: set[str], held: Sequence[str]) -> dict[str, Any]:
    setup = built.setup
    seconds = float(setup.train[0].t[-1])
    weakest = min(built.reached, default=0.0)
    return {
        "index": wanted.index,
        "level": wanted.level,
        "kind": wanted.kind,
        "world": setup.world_name,
        "regime": setup.regime,
        "manoeuvres": [p.manoeuvre for p in (*setup.train, *setup.heldout)],
        "effects": {
            one.name: {
                "parameters": built.effects[one.name],
                "active": sorted(one.scaled) + sorted(one.shape),
                "inside": one.name in CATALOGUE,
                "snr": reached,
                "snr_beyond": beyond,
                "span": one.span(seconds),
                "once": one.name in once,
            }
            for one, reached, beyond in zip(built.drafts, built.reached, built.beyond, strict=True)
        },
        "snr_drawn": wanted.snr,
        "snr": built.total,
        "detectable": bool(not built.effects or weakest >= (1 - 3 * CLOSE) * DETECTABLE),
        "snr_of_nothing": built.nothing,
        "noise": asdict(setup.noise),
        "base_parameters": dict(zip(built.simulator.space.names, map(float, setup.theta), strict=True)),
        "base_fit": dict(zip(built.simulator.space.names, map(float, built.theta), strict=True)),
        "heldout_floor": {name: setup.noise.std[name] for name in setup.given.channels},
        "heldout": list(held),
        "heldout_comparable": not once,
        "vehicle": {k: v for k, v in asdict(setup.truth).items() if v is not None and v != math.inf},
    }
