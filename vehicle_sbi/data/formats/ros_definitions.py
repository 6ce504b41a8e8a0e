"""Definitions of messages that neither older bags nor `rosbags` bring along, as their makers publish them.

autoware_vehicle_msgs and autoware_control_msgs (autowarefoundation/autoware_msgs), tier4_vehicle_msgs
(tier4/tier4_autoware_msgs), autoware_auto_vehicle_msgs (its predecessor), ackermann_msgs (ros-drivers).
"""

from collections.abc import Mapping
from types import MappingProxyType

VELOCITY = "std_msgs/Header header\nfloat32 longitudinal_velocity\nfloat32 lateral_velocity\nfloat32 heading_rate\n"
STEERING = "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle\n"
ACKERMANN = (
    "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n"
)
LATERAL = (
    "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\nfloat32 steering_tire_angle\n"
    "float32 steering_tire_rotation_rate\nbool is_defined_steering_tire_rotation_rate\n"
)
LONGITUDINAL = (
    "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\nfloat32 velocity\nfloat32 acceleration\n"
    "float32 jerk\nbool is_defined_acceleration\nbool is_defined_jerk\n"
)
CONTROL = (
    "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\n"
    "autoware_control_msgs/Lateral lateral\nautoware_control_msgs/Longitudinal longitudinal\n"
)

DEFINITIONS: Mapping[str, str] = MappingProxyType(
    {
        "autoware_vehicle_msgs/msg/VelocityReport": VELOCITY,
        "autoware_vehicle_msgs/msg/SteeringReport": STEERING,
        "autoware_auto_vehicle_msgs/msg/VelocityReport": VELOCITY,
        "autoware_auto_vehicle_msgs/msg/SteeringReport": STEERING,
        "autoware_control_msgs/msg/Lateral": LATERAL,
        "autoware_control_msgs/msg/Longitudinal": LONGITUDINAL,
        "autoware_control_msgs/msg/Control": CONTROL,
        "tier4_vehicle_msgs/msg/ActuationStatus": "float64 accel_status\nfloat64 brake_status\nfloat64 steer_status\n",
        "tier4_vehicle_msgs/msg/ActuationStatusStamped": (
            "std_msgs/Header header\ntier4_vehicle_msgs/ActuationStatus status\n"
        ),
        "tier4_vehicle_msgs/msg/ActuationCommand": "float64 accel_cmd\nfloat64 brake_cmd\nfloat64 steer_cmd\n",
        "tier4_vehicle_msgs/msg/ActuationCommandStamped": (
            "std_msgs/Header header\ntier4_vehicle_msgs/ActuationCommand actuation\n"
        ),
        "ackermann_msgs/msg/AckermannDrive": ACKERMANN,
        "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
    }
)
"""Type -> its .msg text."""
