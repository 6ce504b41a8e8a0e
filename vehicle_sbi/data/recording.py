"""A recording: named channels in SI units on one uniform time grid.

A sample may be in one of three states: measured (finite and valid), filled (finite but not valid: it may drive the
model, it is never fitted), or absent (NaN and not valid).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from html import escape

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from vehicle_sbi.data.channels import AXLE_MEANS, CHANNELS
from vehicle_sbi.errors import InputError, unknown


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording:
    """Channels on a uniform grid `t` [s] at `rate` [Hz]; `notes` lists what was filled, left out, resampled, flagged.

    `warnings` says what the drive contradicts: signs, units, axes, offsets; `wrong` has those of them by which a
    channel is another than its name says.
    `unmasked` is the recording before parts of it were made absent, None if none were.
    `source` names the files it was read from; `files` has the SHA-256 of each, `mappings` those of the files that say
    what columns mean. Raises InputError for a channel that is not in `CHANNELS`.
    """

    name: str
    rate: float
    t: Float[np.ndarray, " time"]
    channels: Mapping[str, Float[np.ndarray, " time"]]
    valid: Mapping[str, Bool[np.ndarray, " time"]]
    groups: Mapping[str, str]
    source: str
    files: Mapping[str, str] = field(default_factory=dict)
    mappings: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    wrong: tuple[str, ...] = ()
    unmasked: "Recording | None" = None

    def __post_init__(self) -> None:
        for name in self.channels:
            if name not in CHANNELS:
                raise unknown("channel", name, CHANNELS, self.source)

    @property
    def inputs(self) -> dict[str, str]:
        """SHA-256 of every file that it depends on."""
        return {**self.files, **self.mappings}

    def series(self, name: str) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]] | None:
        """Values and validity of a channel, None if it is not recorded; an axle's speed is the mean of its wheels'."""
        if name in self.channels:
            return self.channels[name], self.valid[name]
        wheels = AXLE_MEANS.get(name, ())
        if wheels and all(wheel in self.channels for wheel in wheels):
            left, right = wheels
            return 0.5 * (self.channels[left] + self.channels[right]), self.valid[left] & self.valid[right]
        return None

    def required(self, name: str, why: str) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
        """Values and validity of a channel; raises InputError if it is not recorded, with `why` as what needs it."""
        series = self.series(name)
        if series is None:
            raise InputError(
                f"{self.source}: {why} needs channel '{name}' (column {CHANNELS[name].column}), which the recording "
                f"does not have; it has {', '.join(self.channels)}"
            )
        return series

    def group(self, name: str) -> str:
        """The sensor group of a channel ("imu", "can" or "wheel_speed")."""
        return self.groups.get(name) or self.groups.get(AXLE_MEANS.get(name, (name,))[0]) or CHANNELS[name].group

    def masked(self, keep: Bool[np.ndarray, " time"], note: str) -> "Recording":
        """The recording with every sample outside `keep` made absent, on the same grid."""
        return replace(
            self,
            channels={name: np.where(keep, values, np.nan) for name, values in self.channels.items()},
            valid={name: valid & keep for name, valid in self.valid.items()},
            notes=(*self.notes, note),
            unmasked=self.unmasked or self,
        )

    @property
    def present(self) -> Bool[np.ndarray, " time"]:
        """Where anything was recorded, and not left out."""
        return np.any([*self.valid.values()], axis=0)

    @property
    def present_s(self) -> float:
        """How long anything was recorded [s]."""
        return float(self.present.sum() / self.rate)

    @property
    def table(self) -> pd.DataFrame:
        """A row each channel: its unit and sensor group, which share of it was measured, and the range of that."""
        rows = []
        for name, values in self.channels.items():
            measured = pd.Series(values[self.valid[name]])
            share, unit = float(self.valid[name].mean()), CHANNELS[name].unit
            rows.append((name, unit, self.group(name), share, measured.min(), measured.max()))
        return pd.DataFrame(rows, columns=["channel", "unit", "group", "measured", "least", "most"])

    @property
    def _heading(self) -> str:
        return f"{self.name}: {len(self.t) / self.rate:.4g} s at {self.rate:g} Hz"

    def __repr__(self) -> str:
        table = self.table.to_string(index=False, float_format="{:.4g}".format)
        return "\n".join([self._heading, table, *self.warnings, *self.notes])

    def _repr_html_(self) -> str:
        table = self.table.to_html(index=False, float_format="{:.4g}".format, border=0)
        lines = "".join(f"<p>{escape(line)}</p>" for line in (*self.warnings, *self.notes))
        return f"<h4>{escape(self._heading)}</h4>{table}{lines}"
