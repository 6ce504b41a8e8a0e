"""How the base model's series would change with each parameter of the catalogue, from small steps off its null.

Written apart from the tool's own candidates: what seals a case should not move with what is to be judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, Effect

STEP = 0.05  # of the prior's width: enough for a delay to outlast a sample


@dataclass(frozen=True)
class Direction:
    """A parameter along which an effect can leave its null, and where its other parameters are held meanwhile."""

    parameter: Parameter
    held: Mapping[Parameter, float]

    @property
    def effect(self) -> str:
        return self.parameter.name.split(".")[0]


def null(p: Parameter) -> float:
    return p.null or 0.0


def far_end(p: Parameter) -> float:
    """The bound of the prior that lies farther from the null."""
    return p.high if p.high - null(p) >= null(p) - p.low else p.low


def off(p: Parameter) -> float:
    """A small step off the null."""
    return null(p) + STEP * (p.high - p.low) * (1.0 if far_end(p) > null(p) else -1.0)


def _series(simulator: Simulator, theta: np.ndarray, points: Sequence[Mapping[Parameter, float]]) -> np.ndarray:
    """Noise-free series (n, channels, time) at theta with effects as each point has them."""
    extra = tuple(dict.fromkeys(p for point in points for p in point))
    extended = replace(simulator, space=ParameterSpace((*simulator.space.parameters, *extra)))
    return extended.noise_free(np.array([[*theta, *(point.get(p, null(p)) for p in extra)] for point in points]))


def directions(simulator: Simulator, theta: np.ndarray, effect: Effect) -> list[Direction]:
    """Along which parameters an effect acts in this drive; the first that acts at all if none does by itself."""
    middle = {p: 0.5 * (null(p) + far_end(p)) for p in effect.parameters}
    y = _series(simulator, theta, [{}, *({p: end(p)} for end in (off, far_end) for p in effect.parameters)])
    moved = np.nanmax(abs(y[1:] - y[0]), axis=(1, 2), initial=0.0).reshape(2, -1).any(axis=0)
    acts = [p for p, moves in zip(effect.parameters, moved, strict=True) if moves]
    if acts:
        return [Direction(p, {q: middle[q] for q in effect.parameters if q not in acts}) for p in acts]
    for p in effect.parameters:
        shape = {q: value for q, value in middle.items() if q is not p}
        rested, *acting = _series(simulator, theta, [shape, shape | {p: off(p)}, shape | {p: far_end(p)}])
        if np.array_equal(rested, y[0]) and any(not np.array_equal(one, y[0], equal_nan=True) for one in acting):
            return [Direction(p, shape)]
    return []


def candidates(simulator: Simulator, theta: np.ndarray) -> list[Direction]:
    """Directions of every effect of the catalogue of which nothing is fitted."""
    fitted = {name.split(".")[0] for name in simulator.space.names}
    free = [effect for effect in CATALOGUE.values() if effect.name not in fitted]
    return [direction for effect in free for direction in directions(simulator, theta, effect)]


def slopes(
    simulator: Simulator, theta: np.ndarray, found: Sequence[Direction], ends: Sequence[float] | None = None
) -> np.ndarray:
    """Change of the series per unit of each direction's parameter (k, channels, time), from a small step off its null,
    or from one that goes to a value in `ends`."""
    steps = [off(d.parameter) for d in found] if ends is None else ends
    shapes = [dict(shape) for shape in dict.fromkeys(frozenset(d.held.items()) for d in found)]
    moved = _series(simulator, theta, [{**d.held, d.parameter: step} for d, step in zip(found, steps, strict=True)])
    rested = _series(simulator, theta, shapes)[[shapes.index(dict(d.held)) for d in found]]
    sizes = np.array([step - null(d.parameter) for d, step in zip(found, steps, strict=True)])
    return (moved - rested) / sizes[:, None, None]
