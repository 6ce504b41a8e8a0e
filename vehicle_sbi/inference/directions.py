"""What could be missing: each effect of the catalogue along every direction in which it leaves its null.

A direction is one parameter of an effect that acts, with the effect's other parameters, which only give it its shape
(when it begins, how long it lasts, where it acts), held at one of a few values. Small steps along it, simulated, say
what the recording would look like with a little of the effect.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from vehicle_sbi.inference.prior import reported
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, Effect
from vehicle_sbi.physics.sensors import GROUPS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.size import size_of

STEPS = (0.05, 0.3, 0.6)  # of a parameter's prior width, for differences from its null; the first one from which the
# change is about in proportion is taken: enough for a lag to outlast a sample, and for grip to be used up
STEEPER = 3.0  # times as steep as at a step the change may be at a longer one, for the step to be long enough
ROUNDING = 1e-7  # of a channel's largest value; loops and integrators are exact to about 1e-9
MOST = 0.9  # of the way to the prior's farther bound, at most
SHAPES = 3  # values at which a parameter of shape is held
SPAN = ("start", "duration")
SHARED = ("factor", *GROUPS)  # names of parameters of both axles, or of all sensors of a group
TILES = 16  # of the recordings' time, of which what comes and goes is made up
LASTING = 0.5  # of the longest recording, at most
LENGTHS = (1, 2, 4, 8)  # tiles that something may last, begun at every half of it


@dataclass(frozen=True)
class Direction:
    """A parameter along which an effect leaves its null, with the effect's other parameters held where it can act.

    `step` is the part of its prior's width that it takes for the change to be about in proportion; `share` the part of
    what is believed of the effect that is about this shape of it.
    """

    effect: str
    parameter: Parameter
    held: dict[Parameter, float]
    step: float = STEPS[0]
    share: float = 1.0

    @property
    def asleep(self) -> bool:
        """Whether it changes next to nothing near its null."""
        return self.step > STEPS[0]

    @property
    def away(self) -> float:
        """Where the parameter is once it has left its null by a step."""
        return away(self.parameter, self.step)

    @property
    def low(self) -> float:
        """How far the prior reaches below the null."""
        return self.parameter.low - null(self.parameter)

    @property
    def high(self) -> float:
        """How far it reaches above."""
        return self.parameter.high - null(self.parameter)

    @property
    def clocked(self) -> dict[str, Parameter]:
        """What says when it acts, `start` and `duration`; empty for what acts all the time."""
        timed = {_leaf(p): p for p in self.held}
        return {key: timed[key] for key in SPAN} if set(SPAN) <= timed.keys() else {}

    @property
    def key(self) -> tuple[str, tuple[float, ...]]:
        """What tells it from other shapes and steps of the same direction."""
        return self.parameter.name, (self.step, *self.held.values())

    def during(self, start: float, duration: float) -> "Direction":
        """The same from a start on for a duration [s]."""
        moved = dict(zip((self.clocked[key] for key in SPAN), (start, duration), strict=True))
        return replace(self, held={**self.held, **moved})


def null(p: Parameter) -> float:
    """Where the effect of a parameter of the catalogue vanishes."""
    if p.null is None:
        raise ValueError(f"{p.name} is a constant of the vehicle: it has no null")
    return p.null


def middle(p: Parameter) -> float:
    """Halfway from the null to the prior's farther bound."""
    return 0.5 * (null(p) + (p.high if p.high - null(p) >= null(p) - p.low else p.low))


def away(p: Parameter, step: float) -> float:
    """A step from the null into the prior, in units of its width."""
    up, down = p.high - null(p), null(p) - p.low
    width = min(step * (p.high - p.low), MOST * max(up, down))
    return null(p) + (width if up >= down else -width)


def extent(simulator: Simulator) -> float:
    """How long the recordings last together [s]."""
    return float(simulator.windows.u[..., INPUTS.index("time")].max())


def longest(simulator: Simulator) -> float:
    """How long the longest of the recordings lasts [s]."""
    windows = simulator.windows
    names = np.array(windows.recordings or ("",) * len(windows.t))
    return max(float(np.ptp(windows.t[names == name])) for name in set(names))


def within(simulator: Simulator, effect: Effect) -> Effect:
    """The effect as it can act here: without what belongs to sensors that are not recorded, with boxes for a car of
    this size, and for what begins and lasts as wide as the recordings allow.

    What comes and goes lasts half of a recording at most: longer, it is a difference between recordings.
    """
    reach = {"start": extent(simulator), "duration": LASTING * longest(simulator)}
    size = size_of(float(simulator.nominal["m"]), float(simulator.nominal["L"]))
    sensed = simulator.windows.sensed(simulator.drive)
    boxes = (size.fitted(p) for p in effect.parameters if reported(p, sensed))
    parameters = (replace(p, high=reach.get(_leaf(p), p.high)) for p in boxes)
    return replace(effect, parameters=tuple(parameters))


def shared(simulator: Simulator, p: str, among: Sequence[str]) -> bool:
    """Whether a parameter of an effect acts on several things at once of which others among them act on one each.

    That of a group of sensors acts on the channels of that group alone.
    """
    group_of, whole = simulator.windows.sensed(simulator.drive), _ends(p)
    single = [_ends(other) for other in among if _ends(other) not in SHARED]
    return whole in SHARED and any(group_of.get(one, whole) == whole for one in single)


def _ends(name: str) -> str:
    return name.split(".")[-1]


def responses(
    simulator: Simulator, theta: Float[np.ndarray, " d"], points: Sequence[dict[Parameter, float]]
) -> Float[np.ndarray, "n channels time"]:
    """Noise-free series at theta with effect parameters as each point has them, all others at their null."""
    extra = tuple({p: None for point in points for p in point})
    extended = replace(simulator, space=ParameterSpace((*simulator.space.parameters, *extra)))
    rows = [[*theta, *(point.get(p, null(p)) for p in extra)] for point in points]
    return extended.noise_free(np.array(rows))


def directions(simulator: Simulator, theta: Float[np.ndarray, " d"], effect: Effect) -> list[Direction]:
    """Along which parameters an effect can leave its null here, by as small a step as changes anything.

    A parameter that changes nothing by itself (the duration of a gust without force) gives the effect its shape: the
    others are tried with it held in the middle of its prior. If no parameter acts by itself, the first one that makes
    the effect vanish whatever the shape is the direction.
    """
    free = [p for p in within(simulator, effect).parameters if p.name not in simulator.space.names]
    alone = _alone(simulator, theta, free)
    held = {p: middle(p) for p in free if p not in alone}
    found = [Direction(effect.name, p, held, step) for p, step in alone.items()]
    found = found or _vanishing(simulator, theta, effect.name, held)
    return _in_proportion(simulator, theta, [_shaped(simulator, theta, d) for d in found]) if found else []


def _alone(simulator: Simulator, theta: Float[np.ndarray, " d"], free: Sequence[Parameter]) -> dict[Parameter, float]:
    """Parameters that change anything by themselves, in their order, and by which steps at least."""
    least, left = dict[Parameter, float](), list(free)
    for step in STEPS:
        quiet, *moved = responses(simulator, theta, [{}, *({p: away(p, step)} for p in left)])
        least |= {p: step for p, y in zip(left, moved, strict=True) if _differ(y, quiet)}
        left = [p for p in left if p not in least]
    return {p: least[p] for p in free if p in least}


def _vanishing(
    simulator: Simulator, theta: Float[np.ndarray, " d"], effect: str, shape: Mapping[Parameter, float]
) -> list[Direction]:
    """The first parameter that makes an effect vanish whatever its shape, by as small a step as changes anything."""
    for step, p in itertools.product(STEPS, (p for p in shape if _leaf(p) not in SPAN)):
        others = {other: value for other, value in shape.items() if other is not p}
        ever = others | _throughout(simulator, others)
        quiet, rested, moved = responses(simulator, theta, [{}, ever, ever | {p: away(p, step)}])
        if not _differ(rested, quiet) and _differ(moved, quiet):
            return [Direction(effect, p, others, step)]
    return []


def _in_proportion(simulator: Simulator, theta: Float[np.ndarray, " d"], found: Sequence[Direction]) -> list[Direction]:
    """Directions with steps beyond which the change grows little faster than the step."""
    longer = [replace(d, step=step) for d in found for step in STEPS]
    change = np.linalg.norm(np.nan_to_num(slopes(simulator, theta, longer)), axis=2)  # of each channel
    steepest = change.reshape(len(found), len(STEPS), -1)
    enough = np.all(STEEPER * steepest >= steepest.max(axis=1, keepdims=True), axis=2)
    return [replace(d, step=max(d.step, STEPS[int(np.argmax(row))])) for d, row in zip(found, enough, strict=True)]


def _leaf(p: Parameter) -> str:
    return _ends(p.name)


def _throughout(simulator: Simulator, shape: Mapping[Parameter, float]) -> dict[Parameter, float]:
    """The span, if there is one, as all of the recordings' time."""
    span = {"start": 0.0, "duration": extent(simulator)}
    return {p: span[_leaf(p)] for p in shape if _leaf(p) in span}


def _differ(y: Float[np.ndarray, "channels time"], from_y: Float[np.ndarray, "channels time"]) -> bool:
    """Whether two series differ by more than rounding does."""
    size = np.nanmax(np.abs(from_y), axis=1, initial=0.0)
    return bool(np.any(np.nanmax(np.abs(y - from_y), axis=1, initial=0.0) > ROUNDING * size))


def _shaped(simulator: Simulator, theta: Float[np.ndarray, " d"], direction: Direction) -> Direction:
    """The direction without those held parameters that make no difference to it."""
    if not direction.held:
        return direction
    ever = _throughout(simulator, direction.held)
    moved = {**direction.held, **ever, direction.parameter: direction.away}
    y = responses(simulator, theta, [moved, *({**moved, p: null(p)} for p in direction.held)])
    matters = {
        p: value
        for (p, value), other in zip(direction.held.items(), y[1:], strict=True)
        if p in ever or _differ(other, y[0])
    }
    return replace(direction, held=matters)


def left_out(simulator: Simulator, theta: Float[np.ndarray, " d"]) -> list[Direction]:
    """Directions of every effect of the catalogue along what of it is not fitted."""
    every = tqdm(CATALOGUE.values(), desc="effects", disable=None, leave=False)
    return [direction for effect in every for direction in directions(simulator, theta, effect)]


def beside(simulator: Simulator, theta: Float[np.ndarray, " d"], acting: Sequence[Direction]) -> list[Direction]:
    """Directions that are not among those that act by themselves, but do beside other effects: how high an IMU sits
    above the centre of gravity matters where the body leans, how much grip there is below the knee of Dugoff's tyre
    where its curve bends."""
    known = {d.parameter.name for d in acting}
    return [
        direction
        for effect in CATALOGUE.values()
        if effect.beside
        for direction in directions(*_halfway(simulator, theta, effect.beside), effect)
        if direction.parameter.name not in known
    ]


def _halfway(
    simulator: Simulator, theta: Float[np.ndarray, " d"], effects: Sequence[str]
) -> tuple[Simulator, Float[np.ndarray, " more"]]:
    """The simulator with these effects too, and theta with each of their parameters halfway into its prior."""
    parameters = [p for name in effects for p in within(simulator, CATALOGUE[name]).parameters]
    free = [p for p in parameters if p.name not in simulator.space.names]
    space = ParameterSpace((*simulator.space.parameters, *free))
    return replace(simulator, space=space), np.concatenate([theta, [middle(p) for p in free]])


def tile(simulator: Simulator) -> float:
    """How long a tile of the recordings' time is [s]."""
    return extent(simulator) / TILES


def shapes(simulator: Simulator, direction: Direction) -> list[Direction]:
    """The direction with its parameters of shape held at each of a few values: times at every half of what lasts."""
    others = [p for p in direction.held if p not in direction.clocked.values()]
    spread = [np.linspace(p.low, p.high, SHAPES).tolist() for p in others]
    found = [
        replace(direction, held={**direction.held, **dict(zip(others, values, strict=True))})
        for values in itertools.product(*spread)
    ]
    if not direction.clocked:
        return found
    seconds = tile(simulator)
    return [
        shape.during(first * seconds, length * seconds)
        for shape in found
        for length in LENGTHS
        if allowed(direction, length, seconds)
        for first in range(0, TILES - length + 1, max(length // 2, 1))
    ]


def allowed(direction: Direction, length: int, seconds: float) -> bool:
    """Whether a direction may last so many tiles; one it always may."""
    return length == 1 or length * seconds <= direction.clocked["duration"].high * (1.0 + 1e-9)


def tiles(simulator: Simulator, direction: Direction) -> list[Direction]:
    """The direction over each tile of its span, whose changes add up to its own; itself if it acts all the time."""
    if not direction.clocked:
        return [direction]
    seconds = tile(simulator)
    first, length = (round(direction.held[direction.clocked[key]] / seconds) for key in SPAN)
    return [direction.during(k * seconds, seconds) for k in range(first, first + length)]


def slopes(
    simulator: Simulator, theta: Float[np.ndarray, " d"], found: Sequence[Direction]
) -> Float[np.ndarray, "k channels time"]:
    """Change of the series per unit of each direction's parameter, from a step off the null."""
    y = responses(simulator, theta, [{}, *({**d.held, d.parameter: d.away} for d in found)])
    steps = np.array([d.away - null(d.parameter) for d in found])
    return (y[1:] - y[0]) / steps[:, None, None]
