"""What an IMU and wheel-speed sensors make of the motion.

An accelerometer measures specific force at its own place and attitude: acceleration minus gravity, so a climbing road,
a raised left side and a leaning body each leave g times the sine of their angle in it.
"""

import math

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.body_forces import road_bank, road_grade
from vehicle_sbi.physics.signals import interpolate, lagged, swaying
from vehicle_sbi.physics.vehicle import GRAVITY

# Columns of the motion that the integrator records at each sample: that of the body's centre of gravity, its attitude
# against the road, and the axles' mean wheel speeds.
MOTION = (
    "v_x", "v_y", "r", "a_x", "a_y", "r_dot", "omega_f", "omega_r",
    "roll", "pitch", "roll_rate", "pitch_rate", "roll_acceleration", "pitch_acceleration",
)  # fmt: skip
V_X, V_Y, R, A_X, A_Y, R_DOT, OMEGA_F, OMEGA_R, ROLL, PITCH, P, Q, P_DOT, Q_DOT = range(len(MOTION))

# What can be measured, in the order of the rows that `measure` fills.
MEASUREMENTS = (
    "a_x", "a_y", "yaw_rate", "wheel_speed_front", "wheel_speed_rear", "v_x", "v_y", "a_z", "roll_rate", "pitch_rate",
)  # fmt: skip
ROW_FRONT, ROW_REAR, ROW_SPEED = (MEASUREMENTS.index(name) for name in ("wheel_speed_front", "wheel_speed_rear", "v_x"))
BODY_MEASUREMENTS = ("a_z", "roll_rate", "pitch_rate")  # which a model without roll and pitch does not predict
GROUPS = ("imu", "can", "wheel_speed")
AXES = {
    **{f"accelerometer_{kind}.{axis}": f"a_{axis}" for kind in ("scale", "bias") for axis in "xyz"},
    **{
        f"gyro_{kind}.{axis}": rate
        for kind in ("scale", "bias")
        for axis, rate in (("x", "roll_rate"), ("y", "pitch_rate"), ("z", "yaw_rate"))
    },
}
"""What each gain and offset of an axis acts on, by the name of its parameter."""


@compiled
def lever_arm(p, a_x: float, a_y: float, w_x: float, w_y: float, r: float, dw_x: float, dw_y: float, r_dot: float):
    """Acceleration [m/s^2] at the IMU: a + dw/dt x p + w x (w x p) with a_z = 0 at the centre of gravity."""
    x, y, z = p.arm_x, p.arm_y, p.arm_z
    along = w_x * x + w_y * y + r * z
    square = w_x * w_x + w_y * w_y + r * r
    return (
        a_x + dw_y * z - r_dot * y + w_x * along - square * x,
        a_y + r_dot * x - dw_x * z + w_y * along - square * y,
        dw_x * y - dw_y * x + r * along - square * z,
    )


@compiled
def tilted(f_x: float, f_y: float, f_z: float, roll: float, pitch: float) -> tuple[float, float, float]:
    """A vector (road axes) in the axes of a body at `roll` and `pitch` [rad]: R_x(roll)' R_y(pitch)' f."""
    if pitch != 0.0:
        sine, cosine = math.sin(pitch), math.cos(pitch)
        f_x, f_z = cosine * f_x - sine * f_z, sine * f_x + cosine * f_z
    if roll != 0.0:
        sine, cosine = math.sin(roll), math.cos(roll)
        f_y, f_z = cosine * f_y + sine * f_z, cosine * f_z - sine * f_y
    return f_x, f_y, f_z


@compiled
def imu_misalignment(p, f_x: float, f_y: float, f_z: float) -> tuple[float, float, float]:
    """A vector (body axes) in the axes of an IMU that is turned by yaw, then pitch, then roll."""
    yaw = p.imu_misalignment_yaw
    if yaw != 0.0:
        sine, cosine = math.sin(yaw), math.cos(yaw)
        f_x, f_y = cosine * f_x + sine * f_y, cosine * f_y - sine * f_x
    return tilted(f_x, f_y, f_z, p.imu_misalignment_roll, p.imu_misalignment_pitch)


@compiled
def body_roll(p, roll: float, velocity: float, before: float, a_y: float, rate: float) -> tuple[float, float, float]:
    """Roll angle [rad], its rate and acceleration a sample after (`roll`, `velocity`), towards gradient * a_y.

    a_y [m/s^2], which was `before`, is what the body feels, gravity along a banked road included."""
    gradient = p.body_roll_gradient
    return swaying(roll, velocity, gradient * before, gradient * a_y, p.body_roll_lag, p.body_roll_period, rate)


@compiled
def body_pitch(p, pitch: float, velocity: float, before: float, a_x: float, rate: float) -> tuple[float, float, float]:
    """Pitch angle [rad], nose down, its rate and acceleration a sample after (`pitch`, `velocity`), towards
    -gradient * a_x; a_x was `before`."""
    gradient = -p.body_pitch_gradient
    return swaying(pitch, velocity, gradient * before, gradient * a_x, p.body_pitch_lag, p.body_pitch_period, rate)


@compiled
def accelerometer_scale(p, a_x: float, a_y: float, a_z: float) -> tuple[float, float, float]:
    """Readings [m/s^2] of an accelerometer with a gain on each axis."""
    return p.accelerometer_scale_x * a_x, p.accelerometer_scale_y * a_y, p.accelerometer_scale_z * a_z


@compiled
def accelerometer_bias(p, a_x: float, a_y: float) -> tuple[float, float]:
    """Readings [m/s^2] of an accelerometer with a constant offset on each axis."""
    return a_x + p.accelerometer_bias_x, a_y + p.accelerometer_bias_y


@compiled
def gyro_scale(p, w_x: float, w_y: float, w_z: float) -> tuple[float, float, float]:
    """Readings [rad/s] of a gyro with a gain on each axis."""
    return p.gyro_scale_x * w_x, p.gyro_scale_y * w_y, p.gyro_scale_z * w_z


@compiled
def gyro_bias(p, w_x: float, w_y: float, w_z: float) -> tuple[float, float, float]:
    """Readings [rad/s] of a gyro with a constant offset on each axis."""
    return w_x + p.gyro_bias_x, w_y + p.gyro_bias_y, w_z + p.gyro_bias_z


@compiled
def speed_scale(p, v_x: float) -> float:
    """Reading [m/s] of a speed sensor with a gain."""
    return p.speed_scale_gain * v_x


@compiled_apart
def measure(p, motion, t, rate: float, y) -> None:
    """Fill y (10, time) with MEASUREMENTS from motion (time, 14) at times t [s], before any lag, delay or noise."""
    g_y = road_bank(p)
    felt_x, felt_y = motion[0, A_X] + road_grade(p, t[0]), motion[0, A_Y] + g_y  # what leans the body
    lean, lean_rate = p.body_roll_gradient * felt_y, 0.0
    dive, dive_rate = -p.body_pitch_gradient * felt_x, 0.0
    for k in range(motion.shape[0]):
        a_x, a_y, r, g_x = motion[k, A_X], motion[k, A_Y], motion[k, R], road_grade(p, t[k])
        lean, lean_rate, lean_acceleration = body_roll(p, lean, lean_rate, felt_y, a_y + g_y, rate)
        dive, dive_rate, dive_acceleration = body_pitch(p, dive, dive_rate, felt_x, a_x + g_x, rate)
        felt_x, felt_y = a_x + g_x, a_y + g_y
        roll, pitch = motion[k, ROLL] + lean, motion[k, PITCH] + dive
        roll_rate, pitch_rate = motion[k, P] + lean_rate, motion[k, Q] + dive_rate
        dw_x, dw_y = motion[k, P_DOT] + lean_acceleration, motion[k, Q_DOT] + dive_acceleration
        f_x, f_y, f_z = lever_arm(p, a_x, a_y, roll_rate, pitch_rate, r, dw_x, dw_y, motion[k, R_DOT])
        f_x, f_y, f_z = f_x + g_x, f_y + g_y, f_z + math.sqrt(GRAVITY * GRAVITY - g_x * g_x - g_y * g_y)
        f_x, f_y, f_z = tilted(f_x, f_y, f_z, roll, pitch)
        f_x, f_y, f_z = imu_misalignment(p, f_x, f_y, f_z)
        w_x, w_y, w_z = tilted(0.0, 0.0, r, motion[k, ROLL], motion[k, PITCH])  # 1 - cos(lean) of r is left out
        w_x, w_y, w_z = imu_misalignment(p, w_x + roll_rate, w_y + pitch_rate, w_z)
        f_x, f_y, f_z = accelerometer_scale(p, f_x, f_y, f_z)
        y[0, k], y[1, k] = accelerometer_bias(p, f_x, f_y)
        w_x, w_y, w_z = gyro_scale(p, w_x, w_y, w_z)
        w_x, w_y, w_z = gyro_bias(p, w_x, w_y, w_z)
        y[2, k] = w_z
        y[3, k] = motion[k, OMEGA_F]
        y[4, k] = motion[k, OMEGA_R]
        y[5, k] = speed_scale(p, motion[k, V_X])
        y[6, k] = motion[k, V_Y]
        y[7, k], y[8, k], y[9, k] = f_z, w_x, w_y


@compiled
def channel_delay(p, row: int) -> float:
    """Delay [s] of one channel, a row of MEASUREMENTS, beyond its group's."""
    if row == 0:
        return p.sensor_delay_a_x
    if row == 1:
        return p.sensor_delay_a_y
    if row == 2:
        return p.sensor_delay_yaw_rate
    if row == 3:
        return p.sensor_delay_wheel_speed_front
    if row == 4:
        return p.sensor_delay_wheel_speed_rear
    if row == 5:
        return p.sensor_delay_v_x
    if row == 6:
        return p.sensor_delay_v_y
    if row == 7:
        return p.sensor_delay_a_z
    if row == 8:
        return p.sensor_delay_roll_rate
    return p.sensor_delay_pitch_rate


@compiled
def sensor_delay(p, group: int, row: int) -> float:
    """Delay [s] of a channel, a row of MEASUREMENTS, that a group of sensors reports, an index into GROUPS."""
    own = channel_delay(p, row)
    if group == 0:
        return p.sensor_delay_imu + own
    if group == 1:
        return p.sensor_delay_can + own
    return p.sensor_delay_wheel_speed + own


@compiled
def channel_lag(p, row: int) -> float:
    """First-order lag [s] of one channel, a row of MEASUREMENTS, beyond its group's."""
    if row == 0:
        return p.sensor_lag_a_x
    if row == 1:
        return p.sensor_lag_a_y
    if row == 2:
        return p.sensor_lag_yaw_rate
    if row == 3:
        return p.sensor_lag_wheel_speed_front
    if row == 4:
        return p.sensor_lag_wheel_speed_rear
    if row == 5:
        return p.sensor_lag_v_x
    if row == 6:
        return p.sensor_lag_v_y
    if row == 7:
        return p.sensor_lag_a_z
    if row == 8:
        return p.sensor_lag_roll_rate
    return p.sensor_lag_pitch_rate


@compiled
def sensor_lag(p, group: int, row: int) -> float:
    """First-order lag [s] of a channel, a row of MEASUREMENTS, that a group reports, an index into GROUPS."""
    own = channel_lag(p, row)
    if group == 0:
        return p.sensor_lag_imu + own
    if group == 1:
        return p.sensor_lag_can + own
    return p.sensor_lag_wheel_speed + own


@compiled_apart
def report(p, signal, group: int, row: int, rate: float, out) -> None:
    """Write one channel (time,), a row of MEASUREMENTS, to `out` as its sensor reports it: through its lag, then later.

    The lag is settled at the first sample.
    """
    lag, shift = sensor_lag(p, group, row), sensor_delay(p, group, row) * rate
    if lag > 0.0:
        before = value = signal[0]
        for k in range(len(signal)):
            value = lagged(value, before, signal[k], lag, rate)
            before, signal[k] = signal[k], value
    for k in range(len(signal)):
        out[k] = signal[k] if shift == 0.0 else interpolate(signal, k - shift)


@compiled_apart
def unreported(p, signal, group: int, row: int, rate: float, out) -> None:
    """Write to `out` what a smooth channel (time,) was before its sensor reported it: earlier, and ahead of its lag.
    Beyond its end it goes on as its reflection there."""
    lag, shift = sensor_lag(p, group, row), sensor_delay(p, group, row) * rate
    if lag == 0.0 and shift == 0.0:
        return
    for k in range(len(signal)):
        change = 0.5 * (onwards(signal, k + shift + 1.0) - onwards(signal, k + shift - 1.0))
        out[k] = onwards(signal, k + shift) + lag * rate * change


@compiled
def onwards(signal, position: float) -> float:
    """The signal at a fractional sample, reflected about its last one beyond that."""
    last = len(signal) - 1
    if position <= last:
        return interpolate(signal, position)
    return 2.0 * signal[last] - interpolate(signal, 2.0 * last - position)
