"""What can be recorded: the channels with their units and sensors, and those that each drive mode needs.

Axes are ISO 8855 (x forward, y left, z up; yaw and steering positive to the left).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, kw_only=True)
class Channel:
    """What a channel's name means: unit, suffix of its column in a native file, and the sensors it comes with."""

    name: str
    suffix: str
    unit: str
    group: str

    @property
    def column(self) -> str:
        return f"{self.name}_{self.suffix}"


def _table(*rows: tuple[str, str, str, str]) -> Mapping[str, Channel]:
    return MappingProxyType({n: Channel(name=n, suffix=s, unit=u, group=g) for n, s, u, g in rows})


CHANNELS = _table(
    ("steering", "rad", "rad", "can"),
    ("steering_wheel", "rad", "rad", "can"),
    ("torque_front", "nm", "N m", "can"),
    ("torque_rear", "nm", "N m", "can"),
    ("brake", "flag", "1", "can"),
    ("v_x", "mps", "m/s", "can"),
    ("v_y", "mps", "m/s", "imu"),
    ("a_x", "mps2", "m/s²", "imu"),
    ("a_y", "mps2", "m/s²", "imu"),
    ("a_z", "mps2", "m/s²", "imu"),
    ("yaw_rate", "radps", "rad/s", "imu"),
    ("roll_rate", "radps", "rad/s", "imu"),
    ("pitch_rate", "radps", "rad/s", "imu"),
    ("roll", "rad", "rad", "imu"),
    ("wheel_speed_front", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rear", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_fl", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_fr", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rl", "radps", "rad/s", "wheel_speed"),
    ("wheel_speed_rr", "radps", "rad/s", "wheel_speed"),
)

NEEDED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"torque": ("torque_front",), "wheel_speed": ("wheel_speed_front", "wheel_speed_rear"), "speed": ("v_x",)}
)
"""What each drive mode needs besides the steering; the rear torque is 0 where it is not recorded."""

DRIVEN_BY: Mapping[str, tuple[str, ...]] = MappingProxyType({**NEEDED, "torque": ()})
"""The measured speeds that drive the model, by drive mode."""

AXLE_MEANS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "wheel_speed_front": ("wheel_speed_fl", "wheel_speed_fr"),
        "wheel_speed_rear": ("wheel_speed_rl", "wheel_speed_rr"),
    }
)
"""The wheels, left and right, whose mean is the speed of an axle."""
