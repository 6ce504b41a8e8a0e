"""Named parameters and their order: the only code that knows which column of theta is what."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from vehicle_sbi.errors import InputError, unknown


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A quantity that may be inferred: its unit, its box prior and the fields of the physical record it sets.

    A `relative` parameter is an offset in units of `scale` from the field's nominal value (the paper's Delta C in
    1e5 N); any other replaces the field. `null` is where an optional effect vanishes; None for a vehicle constant.
    """

    name: str
    unit: str
    low: float
    high: float
    fields: tuple[str, ...]
    scale: float = 1.0
    relative: bool = False
    null: float | None = None


@dataclass(frozen=True)
class ParameterSpace:
    """The free parameters of a model, in the order of theta's columns."""

    parameters: tuple[Parameter, ...]
    _column: Mapping[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        written = [name for parameter in self.parameters for name in parameter.fields]
        twice = sorted({name for name in written if written.count(name) > 1})
        if twice:
            raise InputError(f"prior: more than one parameter sets {', '.join(twice)}; keep one of them")
        object.__setattr__(self, "_column", {p.name: i for i, p in enumerate(self.parameters)})

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def low(self) -> Float[np.ndarray, " d"]:
        return np.array([p.low for p in self.parameters])

    @property
    def high(self) -> Float[np.ndarray, " d"]:
        return np.array([p.high for p in self.parameters])

    @property
    def prior_std(self) -> Float[np.ndarray, " d"]:
        """Standard deviation of the uniform prior, its width over sqrt(12)."""
        return (self.high - self.low) / np.sqrt(12.0)

    def column(self, name: str) -> int:
        """The column of theta that holds `name`; KeyError if it is not free."""
        return self._column[name]

    def records(self, theta: Float[np.ndarray, "n d"], nominal: np.void) -> np.ndarray:
        """One physical record per row of theta: `nominal` with the free fields set, shape (n,)."""
        records = np.full(len(theta), nominal, dtype=nominal.dtype)
        for parameter, values in zip(self.parameters, np.asarray(theta, dtype=float).T, strict=True):
            for name in parameter.fields:
                offset = nominal[name] if parameter.relative else 0.0
                records[name] = offset + parameter.scale * values
        return records

    def values(self, mapping: Mapping[str, float], where: str) -> Float[np.ndarray, " d"]:
        """theta from a mapping of names; raises InputError for a name that is missing, unknown or outside the prior."""
        for name, value in mapping.items():
            if name not in self._column:
                raise unknown("parameter", name, self.names, where)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{where}: {name} = {value!r}; it must be a number")
        missing = [name for name in self.names if name not in mapping]
        if missing:
            raise InputError(f"{where}: no value for {', '.join(missing)}")
        theta = np.array([float(mapping[name]) for name in self.names])
        for p, value in zip(self.parameters, theta, strict=True):
            if not p.low <= value <= p.high:
                raise InputError(
                    f"{where}: {p.name} = {value:g} {p.unit} lies outside its prior [{p.low:g}, {p.high:g}]"
                )
        return theta
