"""Synthetic inputs: what a driver does when there is no recording.

The paper drives a square wave of drive and brake torque with a period of five seconds, and a sine on the steering with
a period of four (its section IV).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import COMMANDS, INPUTS
from vehicle_sbi.physics.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """A sine on the steering and a square wave of torque from a nearly known speed, sampled at `rate`."""

    name: str
    steering_amplitude: float  # road wheels [rad]
    steering_period: float = 4.0  # [s]
    drive_torque: float  # both axles together [N m]
    brake_torque: float  # both axles together, negative [N m]
    torque_period: float = 5.0  # [s]
    duration: float = 5.0  # [s]
    rate: float = 200.0  # [Hz]
    v_x_low: float = 10.0  # [m/s], the initial speed is uniform between these
    v_x_high: float = 11.0  # [m/s]
    channels: tuple[str, ...] = ("a_x", "a_y", "yaw_rate", "wheel_speed_front", "wheel_speed_rear")

    def __post_init__(self) -> None:
        for name in self.channels:
            if name not in MEASUREMENTS:
                raise unknown("channel", name, MEASUREMENTS, f"manoeuvre '{self.name}'")
        if not self.channels:
            raise InputError(f"manoeuvre '{self.name}': no channel is measured")
        if not (self.steering_period > 0 and self.torque_period > 0):
            raise InputError(
                f"manoeuvre '{self.name}': steering_period {self.steering_period:g} s and torque_period "
                f"{self.torque_period:g} s must be positive"
            )
        if not (self.duration > 0 and self.rate > 0 and 2 <= self.duration * self.rate < np.inf):
            raise InputError(f"manoeuvre '{self.name}': {self.duration:g} s at {self.rate:g} Hz hold no two samples")
        if not 1.0 <= self.v_x_low <= self.v_x_high:
            raise InputError(
                f"manoeuvre '{self.name}': initial speed {self.v_x_low:g} to {self.v_x_high:g} m/s; "
                "low must not exceed high, and the model holds above 1 m/s"
            )

    def inputs(self, vehicle: Vehicle) -> Float[np.ndarray, "time 9"]:
        """The inputs in the order of INPUTS, torques split between the axles as the vehicle does."""
        t = np.arange(round(self.duration * self.rate)) / self.rate
        driving = (t % self.torque_period) < self.torque_period / 2
        u = np.zeros((len(t), len(INPUTS)))
        u[:, INPUTS.index("time")] = t
        u[:, INPUTS.index("steering")] = self.steering_amplitude * np.sin(2 * np.pi * t / self.steering_period)
        for axle, drive, brake in (
            ("torque_front", vehicle.drive_front, vehicle.brake_front),
            ("torque_rear", 1 - vehicle.drive_front, 1 - vehicle.brake_front),
        ):
            u[:, INPUTS.index(axle)] = np.where(driving, drive * self.drive_torque, brake * self.brake_torque)
        return u

    def windows(self, vehicle: Vehicle) -> Windows:
        """The manoeuvre as one window without measurements; the initial speed's spread is that of a uniform."""
        u = self.inputs(vehicle)[None]
        time = u.shape[1]
        middle, half = (self.v_x_low + self.v_x_high) / 2, (self.v_x_high - self.v_x_low) / 2
        return Windows(
            rate=self.rate,
            u=u,
            before=u[:, :0, : len(COMMANDS)],
            y=np.full((len(self.channels), time), np.nan),
            valid=np.ones((len(self.channels), time), dtype=bool),
            x0=np.array([[middle, 0.0, 0.0]]),
            x0_std=np.array([half / np.sqrt(3.0), 0.0, 0.0]),
            channels=self.channels,
            groups=tuple(CHANNELS[name].group for name in self.channels),
            t=np.arange(time)[None] / self.rate,
        )


@dataclass(frozen=True, kw_only=True)
class Synthetic:
    """In place of a recording file: a manoeuvre that the simulator drives itself."""

    manoeuvre: Manoeuvre
    drive: str = "torque"
