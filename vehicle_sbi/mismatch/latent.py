"""What it would take: the force on the body, or the error of a sensor, that explains what no known effect does.

A force along x or y, a moment about z, an error of the steering and one of each channel's sensor, which change from one
stretch of time to the next, are fitted side by side with as many numbers each. Which of them makes the recording
likeliest says whether it is the motion or a sensor that is off.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.laws import Target, targets
from vehicle_sbi.mismatch.linear import Linearised, gained, profile
from vehicle_sbi.mismatch.locate import Stretch, own_time, spoken, stretches
from vehicle_sbi.mismatch.loose import in_stretches

LEAST_GAIN = 3.0  # log likelihood a number below which nothing is said


@dataclass(frozen=True)
class Latent:
    """A force or an error over time: its size in each stretch (from_s, to_s), the log likelihood that it gains, and
    when it is largest."""

    quantity: str
    unit: str
    from_s: list[float]
    to_s: list[float]
    size: list[float]
    gain: float
    within: list[Stretch]

    @property
    def largest(self) -> int:
        return int(np.argmax(np.abs(self.size)))

    @property
    def sentence(self) -> str:
        """What it would take, in words."""
        k, article = self.largest, "an" if self.quantity[0] in "aeiou" else "a"
        return (
            f"What is left over would take {article} {self.quantity} of up to {self.size[k]:.3g} {self.unit} "
            f"{spoken(self.within)}."
        )


def latents(fit: Fit) -> list[Latent]:
    """Each force and each error as it would have to be, the likeliest first."""
    about, acting = Linearised.of(fit), targets(fit.simulator, fit.at.y)
    spans, slopes = stretches(fit.simulator), in_stretches(fit, acting)
    found = [_fitted(about, target, rows, spans) for target, rows in zip(acting, slopes, strict=True)]
    return sorted(found, key=lambda one: -one.gain)


def _fitted(
    about: Linearised, target: Target, rows: Float[np.ndarray, "q channels time"], spans: list[tuple[float, float]]
) -> Latent:
    free = np.full((1, len(rows)), np.inf)
    size = profile(about, rows[None], -free, free).size[0]
    starts, stops = zip(*spans, strict=True)
    within = own_time(about.fit.simulator, *spans[int(np.argmax(np.abs(size)))])
    return Latent(target.name, target.size.unit, [*starts], [*stops], size.tolist(), gained(about, rows), within)


def what_it_takes(fit: Fit) -> Latent | None:
    """The likeliest force or error, where it gains enough to be spoken of."""
    best = latents(fit)[0]
    return best if best.gain > LEAST_GAIN * len(best.size) else None
