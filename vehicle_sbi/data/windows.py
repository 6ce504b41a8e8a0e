"""Windows: stretches of equal length that a simulator is run on, each from its own initial state.

Windows of several recordings are put together as those of one, on one clock, where the recordings are alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.channels import DRIVEN_BY
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.single_track import INPUTS


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Stretches of a recording of equal length, each simulated from its own initial state.

    u: inputs in the order of `INPUTS`, held over the padded end of a last window; before: the `COMMANDS` of the samples
    before each window, as many as are known, which actuators may still follow; x0: v_x [m/s], v_y [m/s] and
    yaw rate [rad/s] at each start, x0_std their standard deviations; y: measurements, window after window (NaN where
    there is none); valid: what is to be fitted; t: recording time [s]; groups: the sensors of each channel, speed_group
    those of the speeds that drive the model; recordings: which one each window is of.
    """

    rate: float
    u: Float[np.ndarray, "windows time 9"]
    before: Float[np.ndarray, "windows earlier 3"]
    y: Float[np.ndarray, "channels windows*time"]
    valid: Bool[np.ndarray, "channels windows*time"]
    x0: Float[np.ndarray, "windows 3"]
    x0_std: Float[np.ndarray, " 3"]
    channels: tuple[str, ...]
    groups: tuple[str, ...]
    t: Float[np.ndarray, "windows time"]
    notes: tuple[str, ...] = ()
    speed_group: str = "can"
    recordings: tuple[str, ...] = ()

    @property
    def clock(self) -> Float[np.ndarray, "windows time"]:
        """Time [s] that runs on from window to window: the recording's own, or one clock for several."""
        return self.t if self.alone else self.u[..., INPUTS.index("time")]

    @property
    def alone(self) -> bool:
        """Whether all windows are of one recording."""
        return len({*self.recordings}) <= 1

    def sensed(self, drive: str) -> dict[str, str]:
        """The group of sensors of each channel that is recorded, and of the speeds that drive the model."""
        driving = dict.fromkeys(DRIVEN_BY[drive], self.speed_group)
        return driving | dict(zip(self.channels, self.groups, strict=True))

    def only(self, which: Int[np.ndarray, " k"]) -> "Windows":
        """Some of the windows alone, in the order that is asked for."""
        length = self.t.shape[1]
        samples = (which[:, None] * length + np.arange(length)).reshape(-1)
        return replace(
            self,
            u=self.u[which],
            before=self.before[which],
            y=self.y[:, samples],
            valid=self.valid[:, samples],
            x0=self.x0[which],
            t=self.t[which],
            recordings=tuple(self.recordings[k] for k in which) if self.recordings else (),
        )


def one_after_another(recordings: Sequence[Sequence[Windows]]) -> list[float]:
    """What to add to the time of each recording [s], so that one clock runs through what is used of all, from 0 on.

    Of each recording all that is used of it: the windows that are fitted, those that are held out.
    """
    shifts, elapsed = list[float](), 0.0
    for parts in recordings:
        times = [part.u[..., INPUTS.index("time")] for part in parts]
        shifts.append(elapsed - min(float(time.min()) for time in times))
        elapsed = shifts[-1] + max(float(time.max()) for time in times) + 1.0 / parts[0].rate
    return shifts


def from_zero(windows: Windows) -> Windows:
    """Windows on a clock that begins with the first of them."""
    first = float(windows.u[..., INPUTS.index("time")].min())
    return replace(windows, u=_shifted(windows.u, -first))


def check_alike(parts: Sequence[Windows], names: Sequence[str]) -> None:
    """InputError for recordings of different rates, channels or sensor groups; `names` are what it calls them."""
    first = parts[0]
    for part, name in zip(parts, names, strict=True):
        for what in ("rate", "channels", "groups", "speed_group"):
            if getattr(part, what) != getattr(first, what):
                raise InputError(
                    f"recordings {names[0]} and {name} differ in their {what}: {getattr(first, what)} and "
                    f"{getattr(part, what)}; together they need the same (recording.rate resamples)"
                )


def joined(parts: Sequence[Windows], names: Sequence[str], shifts: Sequence[float] | None = None) -> Windows:
    """Windows of several recordings as those of one, the time of each shifted, by default one after another.

    The spread of initial states is the largest of each. Raises InputError for recordings that are not alike.
    """
    check_alike(parts, names)
    first = parts[0]
    shifts = shifts or one_after_another([[part] for part in parts])
    notes = tuple(f"{name}: {note}" for part, name in zip(parts, names, strict=True) for note in part.notes)
    return replace(
        first,
        u=np.concatenate([_shifted(part.u, shift) for part, shift in zip(parts, shifts, strict=True)]),
        before=np.concatenate([part.before for part in parts]),
        y=np.concatenate([part.y for part in parts], axis=1),
        valid=np.concatenate([part.valid for part in parts], axis=1),
        x0=np.concatenate([part.x0 for part in parts]),
        x0_std=np.max([part.x0_std for part in parts], axis=0),
        t=np.concatenate([part.t for part in parts]),
        recordings=tuple(name for part, name in zip(parts, names, strict=True) for _ in part.t),
        notes=notes if len(parts) > 1 else first.notes,
    )


def _shifted(u: Float[np.ndarray, "windows time 9"], shift: float) -> Float[np.ndarray, "windows time 9"]:
    """The inputs with `shift` [s] added to their time."""
    moved = u.copy()
    moved[..., INPUTS.index("time")] += shift
    return moved
