"""What is believed of missing physics before a recording is seen: how often cars have each effect, and how large.

Each parameter along which an effect leaves its null has a rate, the probability that a car has it noticeably, and a
size, its typical distance from the null. Parameters are missing independently of each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS

Entry = Sequence[float]  # [rate, size in the parameter's unit]


@dataclass(frozen=True, kw_only=True)
class EffectPrior:
    """`table[effect][parameter]` is [rate, size]; a parameter that is not listed has `rate`, and as its size a `share`
    of how far its box reaches from the null. `equally` is a rate in the place of all others.

    An effect that is missing has a size of `slabs` typical ones, a standard deviation each with its share, else one of
    a `negligible` part. What no effect stands for, a discrepancy, may be in each load, the steering and each sensor
    with probability `discrepancy`, its amplitude log-uniform up to about a `scale` of the largest that is thought of.
    A base parameter's box, the prior of the study, is wrong with probability `outside`: what lies beyond it counts so.

    Raises InputError for an unknown name, a rate that is no probability above 0 and below 1, or a size not above 0.
    """

    table: Mapping[str, Mapping[str, Entry]] = field(default_factory=dict)
    rate: float = 0.03
    share: float = 0.1
    equally: float | None = None
    slabs: Sequence[Entry] = ((0.6, 0.85), (1.5, 0.15))
    negligible: float = 0.1
    discrepancy: float = 0.9
    scale: float = 0.3
    outside: float = 0.01

    def __post_init__(self) -> None:
        for effect, entries in self.table.items():
            if effect not in CATALOGUE:
                raise unknown("effect", effect, CATALOGUE, "effect_prior.table")
            known = [p.name.split(".")[1] for p in CATALOGUE[effect].parameters]
            for key, entry in entries.items():
                if key not in known:
                    raise unknown("parameter", key, known, f"effect_prior.table.{effect}")
                _check(entry, f"effect_prior.table.{effect}.{key}")
        _check((self.rate, self.share), "effect_prior: [rate, share]")
        _check((self.rate if self.equally is None else self.equally, self.share), "effect_prior: [equally, share]")
        _check((self.discrepancy, self.scale), "effect_prior: [discrepancy, scale]")
        if not 0 < self.outside < 1:
            raise InputError(f"effect_prior: outside = {self.outside}; it is a probability above 0 and below 1")
        if not (self.slabs and all(len(slab) == 2 and min(slab) > 0 for slab in self.slabs) and self.negligible > 0):
            raise InputError("effect_prior: slabs are pairs [size, share] above 0, as is negligible")

    def lists(self, p: Parameter) -> bool:
        """Whether the table has it."""
        return self._entry(p) is not None

    def rate_of(self, p: Parameter) -> float:
        """Probability that a car has it noticeably."""
        entry = self._entry(p)
        rate = self.rate if entry is None else float(entry[0])
        return rate if self.equally is None else self.equally

    def size_of(self, p: Parameter) -> float:
        """Its typical distance from the null [its unit]; `p` has the box of a car of this size, by which sizes of
        passenger cars scale."""
        entry = self._entry(p)
        if entry is None:
            return self.share * _reach(p)
        return float(entry[1]) * _reach(p) / _reach(EFFECT_PARAMETERS[p.name]) if _scales(p) else float(entry[1])

    def _entry(self, p: Parameter) -> Entry | None:
        effect, _, key = p.name.partition(".")
        return self.table.get(effect, {}).get(key)


def _reach(p: Parameter) -> float:
    """How far the box reaches from the null."""
    null = p.null or 0.0
    return max(p.high - null, null - p.low)


def _scales(p: Parameter) -> bool:
    """Whether the parameter has a unit that scales with the car; boxes in time are as wide as the recording."""
    return p.unit not in ("1", "s", "rad")


def _check(entry: object, where: str) -> None:
    """Raises InputError where an entry is no pair of a rate and a size."""
    if not isinstance(entry, Sequence) or isinstance(entry, str) or len(entry) != 2:
        raise InputError(f"{where} = {entry!r}; it must be [rate, size]")
    rate, size = entry
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in entry) or not (0 < rate < 1 and size > 0):
        raise InputError(f"{where} = {list(entry)}; a rate lies between 0 and 1, a size is above 0")
