"""What it would take: the force on the body, or the drift of a sensor, that explains what no known effect does.

A force along x or y or a moment about z that changes from one stretch of time to the next, and a drift of one channel's
sensor that does, are fitted side by side with as many numbers each. Which of them makes the recording likeliest says
whether it is the motion or a sensor that is off.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.recording import CHANNELS
from vehicle_sbi.mismatch.candidates import responses
from vehicle_sbi.mismatch.detect import Linearised, profile
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.locate import bump, clock, stretches
from vehicle_sbi.parameters import Parameter

PUSH = 100.0  # N or N m, for differences
LEAST_GAIN = 3.0  # log likelihood a number below which nothing is said


def _latent(name: str, unit: str) -> Parameter:
    return Parameter(name=f"latent.{name}", unit=unit, low=-np.inf, high=np.inf, fields=(f"latent_{name}",), null=0.0)


FORCES = {
    "force along x": _latent("x", "N"),
    "force along y": _latent("y", "N"),
    "moment about z": _latent("z", "N m"),
}
START, DURATION = _latent("start", "s"), _latent("duration", "s")


@dataclass(frozen=True)
class Latent:
    """A force or a drift over time: its size in each stretch (from_s, to_s), and the log likelihood that it gains."""

    quantity: str
    unit: str
    from_s: list[float]
    to_s: list[float]
    size: list[float]
    gain: float

    @property
    def largest(self) -> int:
        return int(np.argmax(np.abs(self.size)))

    @property
    def sentence(self) -> str:
        """What it would take, in words."""
        k = self.largest
        return (
            f"What is left over would take a {self.quantity} of up to {self.size[k]:.3g} {self.unit} "
            f"from {self.from_s[k]:.1f} to {self.to_s[k]:.1f} s."
        )


def latents(fit: Fit) -> list[Latent]:
    """Each force and each sensor's drift as it would have to be, the likeliest first."""
    simulator, spans = fit.simulator, stretches(fit.simulator)
    points = [{force: PUSH, START: start, DURATION: stop - start} for force in FORCES.values() for start, stop in spans]
    y = responses(simulator, fit.theta, [{}, *points])
    pushed = ((y[1:] - y[0]) / PUSH).reshape(len(FORCES), len(spans), *y.shape[1:])
    shapes = {(name, p.unit): rows for (name, p), rows in zip(FORCES.items(), pushed, strict=True)}
    t = clock(simulator)
    for c, channel in enumerate(simulator.windows.channels):
        drift = np.zeros((len(spans), *y.shape[1:]))
        drift[:, c] = [bump(t, start, stop) for start, stop in spans]
        shapes[f"drift of the sensor of {channel}", CHANNELS[channel].unit] = drift
    return sorted((_fitted(fit, *key, rows, spans) for key, rows in shapes.items()), key=lambda one: -one.gain)


def _fitted(
    fit: Fit, name: str, unit: str, rows: Float[np.ndarray, "q channels time"], spans: list[tuple[float, float]]
) -> Latent:
    about, free = Linearised.of(fit), np.full((1, len(rows)), np.inf)
    none = profile(about, rows[None][:, :0], free[:, :0], free[:, :0]).log_likelihood[0]
    best = profile(about, rows[None], -free, free)
    starts, stops = zip(*spans, strict=True)
    return Latent(name, unit, [*starts], [*stops], best.size[0].tolist(), float(best.log_likelihood[0] - none))


def what_it_takes(fit: Fit) -> Latent | None:
    """The likeliest force or drift, where it gains enough to be spoken of."""
    best = latents(fit)[0]
    return best if best.gain > LEAST_GAIN * len(best.size) else None
