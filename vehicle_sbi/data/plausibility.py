"""What a recording contradicts, a sentence each: limits, axes, signs, units, offsets, gravity, shifts, broken samples.

The checks lie in `vehicle_sbi.data.checks`, one kind a file. Each says the channel, the evidence and the likely cause
as a question, and nothing where the drive is too gentle to tell. Nothing is mended.
"""

from collections.abc import Iterable, Iterator

from vehicle_sbi.data.checks import offsets, samples, shifts, signs, units
from vehicle_sbi.data.checks.drive import Drive, Finding, drive_of
from vehicle_sbi.data.checks.limits import LIMITS, absurd, beyond_limits, spoken_runs
from vehicle_sbi.data.recording import Recording

__all__ = ["LIMITS", "WRONG", "Finding", "absurd", "examine", "spoken_runs"]

WRONG = frozenset({"unit", "sign", "axes", "gravity", "shift"})
"""Faults by which a channel is another than its name says; the others (offsets, broken samples) leave it what it is."""


def examine(recording: Recording) -> tuple[Finding, ...]:
    """What the drive contradicts, each with its channel and kind of fault; one fault of a channel is said once.

    Nothing of a plausible recording, or of one too gentle to tell.
    """
    drive = drive_of(recording)
    compared = _once([*_between_channels(drive), *beyond_limits(recording)])
    broken = [*samples.clipped(drive), *samples.frozen(drive), *samples.coarse(drive)]
    return (*compared, *offsets.at_rest(recording), *broken)


def _between_channels(drive: Drive) -> Iterator[Finding]:
    """What channels say of each other; swapped axes leave nothing to compare, and a wrong unit is not said twice."""
    axes = list(signs.swapped(drive))
    yield from axes
    if axes:
        return
    yield from signs.flipped(drive)
    yield from shifts.shifted(drive)
    if not drive.scaled:
        return
    scales = [*units.lateral(drive), *units.longitudinal(drive)]
    yield from scales
    blamed = {one.channel for one in scales}
    yield from (one for one in units.wheels(drive) if "v_x" not in blamed)
    if not blamed & {"v_x", "yaw_rate"}:
        yield from units.steering(drive)
        yield from (one for one in offsets.gravity(drive) if one.channel not in blamed)


def _once(found: Iterable[Finding]) -> list[Finding]:
    """The first finding of each channel and fault; wheels have one unit."""
    first: dict[tuple[str, str], Finding] = {}
    for one in found:
        channel = "wheel_speed" if one.channel.startswith("wheel_speed") else one.channel
        first.setdefault((channel, one.fault), one)
    return list(first.values())
