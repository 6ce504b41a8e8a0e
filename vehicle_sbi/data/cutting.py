"""Cutting a recording into windows: where the model may be run, what drives it there, and the state it begins in."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from vehicle_sbi.data.channels import CHANNELS, NEEDED
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.smoothing import denoised, slope, smoothed, unheld
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.physics.single_track import COMMANDS, INPUTS

V_Y_LEVER, SIDESLIP = 1.5, 0.1
"""Where v_y is not recorded it may be wrong by 1.5 m times the yaw rate (about the rear axle's distance), at most by
0.1 rad times v_x; both root mean squares over the recording."""

YAW_RATE_UNKNOWN = 0.2
"""Standard deviation [rad/s] of an initial yaw rate that nothing in the recording tells."""

REMEMBERED_S = 10.0
"""What a window knows of the commands before it [s]. An actuator's lag of 1 s, the longest, has forgotten all of more.
A play remembers until the steering has moved by its width again: in ten seconds of driving it mostly has."""

STRETCHES = 3
"""Usable stretches that are named where none is long enough, at most."""


def cut(
    recording: Recording,
    *,
    drive: str,
    channels: Sequence[str],
    length_s: float,
    warmup_s: float = 0.5,
    start_s: float | None = None,
    stop_s: float | None = None,
    steering_ratio: float | None,
    v_min: float = 1.0,
    wheel_radius: float | None = None,
) -> Windows:
    """Cut the recording from `start_s` to `stop_s` [s] into windows of `length_s` [s] for one drive mode.

    Windows never span absent inputs, speeds below `v_min` [m/s] or, where torque drives, braking (no brake
    torque is recorded). What is left of a stretch is padded to a window if it is at least half of one, else
    dropped. The first `warmup_s` [s] of each window, the transient of an initial state that is known only roughly,
    is not fitted. A window knows the commands of REMEMBERED_S before it, masked or not. The initial state is the
    smoothed measurement, its standard deviation the spread around it; v_x comes from the rear wheels and
    `wheel_radius` [m] where it is not recorded, and v_y is then 0.
    Raises InputError for a channel that is missing or an input itself, and where no window remains.
    """
    n, warmup = round(length_s * recording.rate), round(warmup_s * recording.rate)
    if not 0 <= warmup < n:
        raise InputError(
            f"{recording.source}: windows of {length_s:g} s need a warm-up shorter than that, not {warmup_s:g} s"
        )
    inputs, held = _inputs(recording, drive, steering_ratio)
    whole = inputs if recording.unmasked is None else _commands(recording.unmasked, drive, steering_ratio, [])
    y, measured = _measurements(recording, channels, drive)
    state, state_std = _initial_states(recording, wheel_radius)
    usable, notes = _usable(recording, inputs, drive, state[:, 0], v_min, start_s, stop_s)
    index, real = _grid(usable, n)
    to_fit = measured[:, index] & real & (np.arange(n) >= warmup)
    fitted = to_fit.any(axis=(0, 2)) if len(channels) else real.any(axis=1)
    if not fitted.any():
        said = "; ".join([_stretches(recording, usable, length_s), *notes])
        raise InputError(f"{recording.source}: no window of {length_s:g} s is left; {said}")
    index, real, to_fit = index[fitted], real[fitted], to_fit[:, fitted]
    left_over = int(usable.sum() - real.sum())
    notes = [*held, *notes]
    notes += [f"{left_over / recording.rate:.2f} s usable but in no window"] if left_over else []
    y = np.where(real & np.isfinite(y[:, index]), y[:, index], np.nan)
    return Windows(
        rate=recording.rate,
        u=_held_inputs(inputs, index, real),
        before=_before(whole, index[:, 0], round(REMEMBERED_S * recording.rate)),
        y=y.reshape(len(channels), -1),
        valid=(to_fit & np.isfinite(y)).reshape(len(channels), -1),
        x0=state[index[:, 0]],
        x0_std=state_std,
        channels=tuple(channels),
        groups=tuple(recording.group(name) for name in channels),
        speed_group=recording.group(NEEDED[drive][0]),
        t=recording.t[index[:, :1]] + np.arange(n) / recording.rate,
        recordings=(recording.name,) * len(index),
        notes=(*recording.notes, *notes),
    )


def _inputs(
    recording: Recording, drive: str, steering_ratio: float | None
) -> tuple[dict[str, Float[np.ndarray, " time"]], list[str]]:
    """What drives the model in this drive mode, at every sample (NaN where it is absent), and which of it was held."""
    if drive not in NEEDED:
        raise unknown("drive mode", drive, NEEDED, recording.source)
    inputs = {name: recording.required(name, f"drive mode '{drive}'")[0] for name in NEEDED[drive]}
    notes = list[str]()
    inputs |= _commands(recording, drive, steering_ratio, notes)
    for name in NEEDED[drive] if drive != "torque" else ():
        inputs[name] = _clean(name, inputs[name], notes)
        if name == "v_x":
            inputs["v_x_dot"] = slope(inputs[name], recording.rate, f"{recording.source}: {name}")
    inputs["time"] = np.arange(len(recording.t)) / recording.rate
    return inputs, notes


def _commands(
    recording: Recording, drive: str, steering_ratio: float | None, notes: list[str]
) -> dict[str, Float[np.ndarray, " time"]]:
    """The steering [rad] at every sample, and the torques [N m] where they drive; `notes` grows."""
    found = {"steering": _clean("steering", _steering(recording, drive, steering_ratio), notes)}
    if drive == "torque":
        none = np.zeros_like(recording.t)
        found |= {name: recording.channels.get(name, none) for name in ("torque_front", "torque_rear")}
    return found


def _clean(name: str, values: Float[np.ndarray, " time"], notes: list[str]) -> Float[np.ndarray, " time"]:
    """An input without the steps of slow updates and without noise; `notes` grows."""
    moved = unheld(values)
    if moved is not values:
        notes.append(f"{name}: updated more slowly than it is sampled; taken as linear between updates")
    return denoised(moved)


def _steering(recording: Recording, drive: str, steering_ratio: float | None) -> Float[np.ndarray, " time"]:
    """The angle [rad] of the front wheels, from the steering wheel's where that alone is recorded."""
    if "steering" in recording.channels or "steering_wheel" not in recording.channels:
        return recording.required("steering", f"drive mode '{drive}'")[0]
    if steering_ratio is None:
        raise InputError(
            f"{recording.source}: drive mode '{drive}' has only steering_wheel and needs the vehicle's steering_ratio: "
            "state it in a vehicle file, as in vehicle=car.yaml"
        )
    return recording.channels["steering_wheel"] / steering_ratio


def _measurements(
    recording: Recording, channels: Sequence[str], drive: str
) -> tuple[Float[np.ndarray, "channels time"], Bool[np.ndarray, "channels time"]]:
    """Values and validity of the channels that are to be fitted."""
    series, shape = [_measured(recording, name, drive) for name in channels], (len(channels), len(recording.t))
    values, valid = [values for values, _ in series], [valid for _, valid in series]
    return np.array(values).reshape(shape), np.array(valid, dtype=bool).reshape(shape)


def _measured(
    recording: Recording, name: str, drive: str
) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
    if name not in CHANNELS:
        raise unknown("channel", name, CHANNELS, recording.source)
    if name in NEEDED[drive]:
        raise InputError(f"{recording.source}: {name} drives the model in drive mode '{drive}' and cannot be fitted")
    return recording.required(name, "the fit")


def _initial_states(
    recording: Recording, wheel_radius: float | None
) -> tuple[Float[np.ndarray, "time 3"], Float[np.ndarray, " 3"]]:
    """(v_x [m/s], v_y [m/s], yaw rate [rad/s]) at every sample, and their standard deviations."""
    v_x, v_x_std = _estimate(recording, _speed(recording, wheel_radius))
    r, r_std = np.zeros_like(v_x), YAW_RATE_UNKNOWN
    if "yaw_rate" in recording.channels:
        r, r_std = _estimate(recording, recording.channels["yaw_rate"])
    v_y, v_y_std = np.zeros_like(v_x), min(V_Y_LEVER * max(_rms(r), r_std), SIDESLIP * _rms(v_x))
    if "v_y" in recording.channels:
        v_y, v_y_std = _estimate(recording, recording.channels["v_y"])
    return np.stack([v_x, v_y, r], axis=-1), np.array([v_x_std, v_y_std, r_std])


def _speed(recording: Recording, wheel_radius: float | None) -> Float[np.ndarray, " time"]:
    """v_x [m/s], from the rear wheels where it is not recorded itself."""
    rear = recording.series("wheel_speed_rear")
    if "v_x" not in recording.channels and rear is not None and wheel_radius is not None:
        return wheel_radius * rear[0]
    return recording.required("v_x", "the initial state, without wheel_speed_rear and a wheel_radius,")[0]


def _estimate(recording: Recording, values: Float[np.ndarray, " time"]) -> tuple[Float[np.ndarray, " time"], float]:
    """A smoothed signal, and the standard deviation of the measured one around it."""
    smooth = smoothed(values, recording.rate, recording.source)
    return smooth, float(np.nanstd(values - smooth))


def _rms(values: Float[np.ndarray, " time"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _usable(
    recording: Recording,
    inputs: Mapping[str, Float[np.ndarray, " time"]],
    drive: str,
    v_x: Float[np.ndarray, " time"],
    v_min: float,
    start_s: float | None,
    stop_s: float | None,
) -> tuple[Bool[np.ndarray, " time"], list[str]]:
    """Where the model may be run, and why not elsewhere, as far as anything is present there."""
    t = recording.t
    within = (t >= (t[0] if start_s is None else start_s)) & (t <= (t[-1] if stop_s is None else stop_s))
    reasons = {
        "outside the chosen stretch": ~within,
        "without an input": ~np.all([np.isfinite(values) for values in inputs.values()], axis=0),
        f"below {v_min:g} m/s": v_x < v_min,
    }
    if drive == "torque" and "brake" in recording.channels:
        reasons["braking"] = recording.channels["brake"] > 0.5
    seconds = {reason: (bad & recording.present).sum() / recording.rate for reason, bad in reasons.items()}
    notes = [f"{bad:.2f} s {reason}: not used" for reason, bad in seconds.items() if bad > 0.0]
    return ~np.any(list(reasons.values()), axis=0), notes


def _edges(usable: Bool[np.ndarray, " time"]) -> Int[np.ndarray, "stretches 2"]:
    """Where each usable stretch begins, and the sample after its last one."""
    return np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]]))).reshape(-1, 2)


def _grid(
    usable: Bool[np.ndarray, " time"], n: int
) -> tuple[Int[np.ndarray, "windows n"], Bool[np.ndarray, "windows n"]]:
    """The samples of each window inside usable stretches, and which of them are not padding."""
    rows = [
        (start, stop) for begin, stop in _edges(usable) for start in range(begin, stop, n) if 2 * (stop - start) >= n
    ]
    starts, stops = np.array(rows, dtype=int).reshape(-1, 2, 1).swapaxes(0, 1)
    index = starts + np.arange(n)
    return np.minimum(index, stops - 1), index < stops


def _held_inputs(
    inputs: Mapping[str, Float[np.ndarray, " time"]],
    index: Int[np.ndarray, "windows n"],
    real: Bool[np.ndarray, "windows n"],
) -> Float[np.ndarray, "windows n 9"]:
    """The inputs of each window in the order of `INPUTS`, constant over its padding; 0 for those that do not drive."""
    none = np.zeros_like(inputs["time"])
    u = np.stack([inputs.get(name, none) for name in INPUTS], axis=-1)[index]
    u[~real, INPUTS.index("v_x_dot")] = 0.0
    return u


def _before(
    inputs: Mapping[str, Float[np.ndarray, " time"]], starts: Int[np.ndarray, " windows"], earlier: int
) -> Float[np.ndarray, "windows earlier 3"]:
    """The commands of the samples before each window; where one is absent, as at a recording's start, the next one."""
    index = np.maximum(starts[:, None] - np.arange(earlier, -1, -1), 0)
    none = np.zeros_like(inputs["steering"])
    following = [pd.DataFrame(inputs.get(name, none)[index]).bfill(axis=1).to_numpy() for name in COMMANDS]
    return np.stack(following, axis=-1)[:, :-1]


def _stretches(recording: Recording, usable: Bool[np.ndarray, " time"], length_s: float) -> str:
    """Which stretches could be used, the longest first, and which window would fit the longest."""
    edges, t = _edges(usable), recording.t
    if not len(edges):
        return "no stretch can be used"
    longest = edges[np.argsort(-(edges[:, 1] - edges[:, 0]), kind="stable")]
    spoken = ", ".join(f"{t[start]:.2f} to {t[stop - 1]:.2f} s" for start, stop in longest[:STRETCHES])
    more = f" and {len(longest) - STRETCHES} shorter ones" if len(longest) > STRETCHES else ""
    seconds = float(longest[0, 1] - longest[0, 0]) / recording.rate
    fits = f"window_s={math.floor(10.0 * seconds) / 10.0:g} fits the longest"
    short = "nothing that is to be fitted is measured there" if 2.0 * seconds >= length_s else fits
    return f"stretches that can be used: {spoken}{more}; {short}"
