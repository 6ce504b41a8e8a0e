"""Boxes that fit the car: those of the catalogue and of generic priors are for passenger cars, a smaller or larger one
has its own.

Lengths scale with the wheelbase L, masses with the mass m; forces with the weight, and so on by each unit. Time scales
with sqrt(L/g), as two bodies under the same gravity are alike (Froude). Within the range of passenger cars, that of
the generic priors for m and L, nothing scales; beyond it a car is compared with the nearest passenger car. A mass that
is told from the wheelbase may be wrong by a factor of 2 either way, and the boxes are so much wider.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.vehicle import GENERIC_PRIORS

ORDINARY = 1500.0, 2.7  # mass [kg] and wheelbase [m] of a car of which one is told from the other, m as L^3

UNSURE = 2.0  # factor by which a mass may be off that is told from the wheelbase

POWERS: Mapping[str, tuple[float, float]] = {
    "kg": (1.0, 0.0),
    "m": (0.0, 1.0),
    "m^2": (0.0, 2.0),
    "N": (1.0, 0.0),
    "N m": (1.0, 1.0),
    "N/rad": (1.0, 0.0),
    "rad/N": (-1.0, 0.0),
    "kg m^2": (1.0, 2.0),
    "N m/rad": (1.0, 1.0),
    "N m s/rad": (1.0, 1.5),
}
"""By which powers of mass and wheelbase what has a unit scales; anything else is the same for every car."""


@dataclass(frozen=True)
class Size:
    """Mass and wheelbase over those of the nearest passenger car, and by which factor the mass may be off."""

    mass: float = 1.0
    length: float = 1.0
    unsure: float = 1.0

    def fitted(self, p: Parameter) -> Parameter:
        """The parameter with its box scaled about its null, or about 0 where it has none."""
        mass, length = POWERS.get(p.unit, (0.0, 0.0))
        null, masses = p.null or 0.0, (self.mass / self.unsure, self.mass * self.unsure)
        factors = [m**mass * self.length**length for m in masses]
        if factors == [1.0, 1.0]:
            return p
        return replace(
            p,
            low=null + min(factor * (p.low - null) for factor in factors),
            high=null + max(factor * (p.high - null) for factor in factors),
        )


def size_of(m: float | None, L: float | None) -> Size:
    """Of a car with mass m [kg] and wheelbase L [m]; None (or NaN) for what is not known."""
    mass = m if m is not None and m > 0.0 else None
    length = L if L is not None and L > 0.0 else None
    if length is None:
        length = ORDINARY[1] * ((mass or ORDINARY[0]) / ORDINARY[0]) ** (1.0 / 3.0)
    told = ORDINARY[0] * (length / ORDINARY[1]) ** 3 if mass is None else mass
    factor = _beyond(told, GENERIC_PRIORS["m"])
    unsure = UNSURE if mass is None and factor != 1.0 else 1.0
    return Size(factor, _beyond(length, GENERIC_PRIORS["L"]), unsure)


def _beyond(value: float, passenger: Parameter) -> float:
    return value / min(max(value, passenger.low), passenger.high)
