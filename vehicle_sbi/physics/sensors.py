"""What an IMU and wheel-speed sensors make of the motion.

An accelerometer measures specific force at its own place and attitude: acceleration minus gravity, so a climbing road,
a raised left side and a leaning body each leave g times the sine of their angle in it.
"""

import math

from numba import njit

from vehicle_sbi.physics.effects import interpolate
from vehicle_sbi.physics.vehicle import GRAVITY

# Columns of the motion that the integrator records at each sample.
MOTION = ("v_x", "v_y", "r", "a_x", "a_y", "r_dot", "omega_f", "omega_r")
V_X, V_Y, R, A_X, A_Y, R_DOT, OMEGA_F, OMEGA_R = range(len(MOTION))

# What can be measured, in the order of the rows that `measure` fills.
MEASUREMENTS = ("a_x", "a_y", "yaw_rate", "wheel_speed_front", "wheel_speed_rear", "v_x", "v_y")
GROUPS = ("imu", "can", "wheel_speed")


@njit(cache=True)
def lever_arm(p, a_x: float, a_y: float, r: float, r_dot: float) -> tuple[float, float]:
    """Accelerations [m/s^2] at (x, y) from the centre of gravity: a + dw/dt x p + w x (w x p) with w = (0, 0, r)."""
    x, y = p.imu_lever_arm_x, p.imu_lever_arm_y
    return a_x - r * r * x - r_dot * y, a_y + r_dot * x - r * r * y


@njit(cache=True)
def leaned(a_y: float, roll: float) -> float:
    """Lateral specific force [m/s^2] that a sensor rolled outwards by `roll` [rad] reads."""
    return a_y * math.cos(roll) + GRAVITY * math.sin(roll)


@njit(cache=True)
def measure(p, motion, rate: float, y) -> None:
    """Fill y (7, time) with MEASUREMENTS from motion (time, 8), before any delay or noise.

    Roll is gradient * a_y behind a first-order lag, discretised exactly for a_y held over a sample.
    """
    follow = 1.0 if p.body_roll_lag <= 0.0 else 1.0 - math.exp(-1.0 / (rate * p.body_roll_lag))
    roll = p.body_roll_gradient * motion[0, A_Y]
    for k in range(motion.shape[0]):
        roll += follow * (p.body_roll_gradient * motion[k, A_Y] - roll)
        a_x, a_y = lever_arm(p, motion[k, A_X], motion[k, A_Y], motion[k, R], motion[k, R_DOT])
        y[0, k] = a_x + p.grade_gravity + p.accelerometer_bias_x
        y[1, k] = leaned(a_y + p.bank_gravity, roll) + p.accelerometer_bias_y
        y[2, k] = motion[k, R] + p.gyro_bias_z
        y[3, k] = motion[k, OMEGA_F]
        y[4, k] = motion[k, OMEGA_R]
        y[5, k] = motion[k, V_X]
        y[6, k] = motion[k, V_Y]


@njit(cache=True)
def sensor_delay(p, group: int) -> float:
    """Delay [s] of a group of sensors, an index into GROUPS."""
    if group == 0:
        return p.sensor_delay_imu
    if group == 1:
        return p.sensor_delay_can
    return p.sensor_delay_wheel_speed


@njit(cache=True)
def report(p, signal, group: int, rate: float, out) -> None:
    """Write one channel to `out` as its group of sensors reports it: `sensor_delay` seconds old."""
    shift = sensor_delay(p, group) * rate
    for k in range(len(signal)):
        out[k] = signal[k] if shift == 0.0 else interpolate(signal, k - shift)
