"""From what is commanded to the wheels: steering and torques, with the effects that enter there."""

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.signals import interpolate, lagged


@compiled
def steering_delay(p, command, k: int, rate: float) -> float:
    """The command [rad] that the wheels follow at sample k, `time` seconds old."""
    return interpolate(command, k - p.steering_delay_time * rate)


@compiled
def steering_lag(p, delta: float, before: float, command: float, rate: float) -> float:
    """The angle [rad] a sample after `delta`, a first-order lag of `time` behind a command linear between samples."""
    return lagged(delta, before, command, p.steering_lag_time, rate)


@compiled
def steering_dead_band(p, delta: float, command: float) -> float:
    """The angle [rad] after `delta` behind a play of `width`: it moves only where the command pushes it."""
    half = 0.5 * p.steering_dead_band_width
    return min(max(delta, command - half), command + half)


@compiled
def steering_ratio(p, delta: float) -> float:
    """Road-wheel angle [rad] where the stated ratio is off by a gain."""
    return p.steering_ratio_gain * delta


@compiled
def steering_offset(p, delta: float) -> float:
    """Road-wheel angle [rad] with the zero of the steering sensor misplaced."""
    return delta + p.steering_offset_angle


@compiled_apart
def steer(p, command, rate: float, out) -> None:
    """Fill `out` (time,) with what the front wheels do [rad] on the last samples of a command (earlier + time,): the
    steering effects in their order. They begin at rest on its first sample."""
    earlier = len(command) - len(out)
    before = angle = played = steering_delay(p, command, 0, rate)
    for k in range(len(command)):
        delayed = steering_delay(p, command, k, rate)
        angle = steering_lag(p, angle, before, delayed, rate)
        before, played = delayed, steering_dead_band(p, played, angle)
        if k >= earlier:
            out[k - earlier] = steering_offset(p, steering_ratio(p, played))


@compiled
def steering_compliance(p, F_yf: float) -> float:
    """Angle [rad] by which the front axle's side force [N] turns the wheels back."""
    return p.steering_compliance_coefficient * F_yf


@compiled
def roll_steer(p, a_y: float) -> float:
    """Angle [rad] that the front wheels steer as the body rolls under a steady lateral acceleration [m/s^2]."""
    return p.roll_steer_coefficient * a_y


@compiled
def drive_gain(p, torque: float) -> float:
    """Axle torque [N m], drive torque being off by a gain."""
    return p.drive_gain_gain * torque if torque > 0.0 else torque


@compiled
def brake_gain(p, torque: float) -> float:
    """Axle torque [N m], brake torque being off by a gain."""
    return p.brake_gain_gain * torque if torque < 0.0 else torque


@compiled
def brake_balance(p, front: float, rear: float) -> tuple[float, float]:
    """Axle torques [N m] with a share of the sum moved to the front axle while neither drives; neither then does."""
    if front > 0.0 or rear > 0.0:
        return front, rear
    moved = min(max(p.brake_balance_shift * (front + rear), rear), -front)
    return front + moved, rear - moved


@compiled
def drive_delay(p, command, k: int, rate: float) -> float:
    """The torque command [N m] that acts at sample k, `time` seconds old."""
    return interpolate(command, k - p.drive_delay_time * rate)


@compiled
def torques(p, front, rear, k: int, rate: float) -> tuple[float, float]:
    """Axle torques [N m] that act at sample k of the commands `front` and `rear` (time,)."""
    T_f, T_r = drive_delay(p, front, k, rate), drive_delay(p, rear, k, rate)
    T_f, T_r = brake_balance(p, T_f, T_r)
    return brake_gain(p, drive_gain(p, T_f)), brake_gain(p, drive_gain(p, T_r))
