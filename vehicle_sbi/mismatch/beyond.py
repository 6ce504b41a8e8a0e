"""Base parameters beyond the box of their prior: it was too narrow, or something acts as if they lay there.

A rear axle that steers as it yields looks like softer rear tyres than the prior knows. While the box holds them, the
rest of the mismatch takes the name of whatever effect comes near.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.parameters import Parameter, ParameterSpace


@dataclass(frozen=True)
class Beyond:
    """Parameters that were let out of their boxes, with those (low, high)."""

    boxes: Mapping[str, tuple[float, float]]


def on_rim(fit: Fit, names: Collection[str]) -> list[str]:
    """Which of some parameters lie on the rim of their box."""
    held = zip(fit.simulator.space.names, fit.inside, strict=True)
    return [name for name, inside in held if name in names and not inside]


def let_out(fit: Fit, names: Collection[str]) -> Simulator:
    """The fit's simulator, with boxes that are as wide again beyond the rim that those parameters lie on."""
    space = fit.simulator.space
    wider = [
        _wider(p, up=value - p.low > p.high - value) if p.name in names else p
        for p, value in zip(space.parameters, fit.theta, strict=True)
    ]
    return replace(fit.simulator, space=ParameterSpace(tuple(wider)))


def _wider(p: Parameter, *, up: bool) -> Parameter:
    """As wide again, on a logarithmic scale where the parameter is positive."""
    width = p.high - p.low
    if up:
        return replace(p, high=p.high**2 / p.low if p.low > 0.0 else p.high + width)
    return replace(p, low=p.low**2 / p.high if p.low > 0.0 else p.low - width)
