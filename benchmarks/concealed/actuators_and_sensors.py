"""What lies before and behind the twin's equations: command effects and sensor effects, coded apart from the tool's.

Names and meanings of effects and parameters are the catalogue's, so that a verdict can be held against them.
"""

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.physics.vehicle import GRAVITY

FINE = 20  # steps of a lag a sample
Parameters = Mapping[str, float]
Effects = Mapping[str, Parameters]
Series = dict[str, np.ndarray]

COMMAND_EFFECTS = (
    "steering_delay", "steering_lag", "steering_dead_band", "steering_ratio", "steering_offset",
    "drive_gain", "brake_gain", "brake_balance", "drive_delay",
)  # fmt: skip
SENSOR_EFFECTS = (
    "body_roll", "body_pitch", "imu_lever_arm", "imu_misalignment", "accelerometer_scale", "accelerometer_bias",
    "gyro_scale", "gyro_bias", "speed_scale", "sensor_lag", "sensor_delay",
)  # fmt: skip


def later(x: np.ndarray, t: np.ndarray, delay: float) -> np.ndarray:
    """A dead time [s], the signal being smooth between samples."""
    return CubicSpline(t, x)(np.maximum(t - delay, t[0])) if delay > 0.0 else x


def lagged(x: np.ndarray, t: np.ndarray, tau: float) -> np.ndarray:
    """A first-order lag [s] in continuous time, settled at the first sample: trapezoids of FINE steps a sample, between
    which the signal is smooth. A filter that held its input over each sample would be half a sample early."""
    if tau <= 0.0:
        return x
    fine = np.linspace(t[0], t[-1], FINE * (len(t) - 1) + 1)
    step = fine[1] - fine[0]
    half = step / (2.0 * tau + step)
    return x[0] + np.asarray(lfilter([half, half], [1.0, 2.0 * half - 1.0], CubicSpline(t, x)(fine) - x[0]))[::FINE]


def with_play(x: np.ndarray, width: float) -> np.ndarray:
    y = x.copy()
    for k in range(1, len(x)):
        y[k] = np.clip(y[k - 1], x[k] - width / 2, x[k] + width / 2)
    return y


def steered(delta: np.ndarray, t: np.ndarray, effects: Effects, gain: float = 1.0) -> np.ndarray:
    """The road-wheel angle [rad] that a commanded one leads to; `gain` is the steering's own."""
    delta = later(delta, t, effects.get("steering_delay", {}).get("time", 0.0))
    delta = lagged(delta, t, effects.get("steering_lag", {}).get("time", 0.0))
    delta = with_play(delta, effects.get("steering_dead_band", {}).get("width", 0.0))
    delta = gain * delta * effects.get("steering_ratio", {}).get("gain", 1.0)
    return delta + effects.get("steering_offset", {}).get("angle", 0.0)


def driven(front: np.ndarray, rear: np.ndarray, t: np.ndarray, effects: Effects) -> tuple[np.ndarray, np.ndarray]:
    """The axle torques [N m] that commanded ones lead to."""
    delay = effects.get("drive_delay", {}).get("time", 0.0)
    front, rear = later(front, t, delay), later(rear, t, delay)
    braking = (front <= 0.0) & (rear <= 0.0)
    moved = effects.get("brake_balance", {}).get("shift", 0.0) * np.where(braking, front + rear, 0.0)
    drive, brake = effects.get("drive_gain", {}).get("gain", 1.0), effects.get("brake_gain", {}).get("gain", 1.0)
    front, rear = front + moved, rear - moved
    return np.where(front > 0, drive, brake) * front, np.where(rear > 0, drive, brake) * rear


def sensed(motion: Series, t: np.ndarray, effects: Effects) -> Series:
    """What sensors report of motion (a_x, a_y, yaw_rate, r_dot, g_x, g_y, wheel speeds, v_x, v_y) on a level platform,
    or on a body that takes them along where its `roll` [rad] and `pitch` [rad], nose up, are among them.

    Specific force is acceleration minus gravity; g_x and g_y are what a climbing or banked road adds to it.
    """
    r, r_dot = motion["yaw_rate"], motion["r_dot"]
    roll, pitch = effects.get("body_roll", {}), effects.get("body_pitch", {})
    phi, theta = motion.get("roll"), motion.get("pitch")
    if phi is None:
        phi = lagged(roll.get("gradient", 0.0) * motion["a_y"], t, roll.get("lag", 0.0))
    if theta is None:
        theta = lagged(pitch.get("gradient", 0.0) * motion["a_x"], t, pitch.get("lag", 0.0))
    w = np.stack([np.gradient(phi, t), -np.gradient(theta, t), r], axis=1)
    dw = np.stack([np.gradient(w[:, 0], t), np.gradient(w[:, 1], t), r_dot], axis=1)
    arm = [effects.get("imu_lever_arm", {}).get(axis, 0.0) for axis in "xyz"]
    swung = np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
    f = np.stack(
        [
            motion["a_x"] + swung[:, 0] + motion["g_x"] + GRAVITY * np.sin(theta),
            motion["a_y"] + swung[:, 1] + motion["g_y"] + GRAVITY * np.sin(phi),
            np.full(len(t), GRAVITY),
        ]
    )
    turned = effects.get("imu_misalignment", {})
    if turned:
        angles = [turned.get(axis, 0.0) for axis in ("yaw", "pitch", "roll")]
        into = Rotation.from_euler("ZYX", angles).inv()
        f, r = into.apply(f.T).T, into.apply(np.outer(r, [0.0, 0.0, 1.0])).T[2]
    reported = {name: motion[name] for name in ("v_x", "v_y", "wheel_speed_front", "wheel_speed_rear")}
    reported |= {"a_x": f[0], "a_y": f[1], "yaw_rate": r}
    return changed(reported, t, effects)


def changed(reported: Series, t: np.ndarray, effects: Effects) -> Series:
    """Readings behind scales, biases, lags and delays of their sensors."""
    out = dict(reported)
    for axis in "xyz":
        if f"a_{axis}" in out:
            scale, bias = (effects.get(f"accelerometer_{kind}", {}).get(axis) for kind in ("scale", "bias"))
            out[f"a_{axis}"] = (1.0 if scale is None else scale) * out[f"a_{axis}"] + (bias or 0.0)
    for axis, rate in (("x", "roll_rate"), ("y", "pitch_rate"), ("z", "yaw_rate")):
        if rate in out:
            scale = effects.get("gyro_scale", {}).get(axis, 1.0)
            out[rate] = scale * out[rate] + effects.get("gyro_bias", {}).get(axis, 0.0)
    if "v_x" in out:
        out["v_x"] = effects.get("speed_scale", {}).get("gain", 1.0) * out["v_x"]
    for name in out:
        group = CHANNELS[name].group
        lag, delay = (
            effects.get(effect, {}).get(group, 0.0) + effects.get(effect, {}).get(name, 0.0)
            for effect in ("sensor_lag", "sensor_delay")
        )
        out[name] = later(lagged(out[name], t, lag), t, delay)
    return out
