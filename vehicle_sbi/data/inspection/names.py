"""Names of channels in common use: CAN databases, data loggers, ROS messages, papers, in English and German.

Patterns are sought in names of small letters joined by underscores, without their unit (`guess.plain`).
"""

from collections.abc import Mapping
from types import MappingProxyType

from vehicle_sbi.data.channels import CHANNELS

A = r"a(cc|ccel|cceleration)?"
LONG = r"(lng|long|lgt|longitudinal)"
SPEED = r"(vel|velocity|speed|spd)"
TURN = r"(w|omega|gyr|gyro|gyroscope|rate|ang_?rate)"


def _acceleration(axis: str, word: str, sides: str, german: str) -> tuple[str, ...]:
    """Names of an acceleration along an axis, by its letter, by a word for it, and by the side that it points to."""
    return (
        rf"(^|_){A}_?{axis}(_|$)|(^|_){axis}_?acc(el|eleration)?(_|\d|$)|linear_acceleration_{axis}"
        rf"|(^|_){german}_?beschl(eunigung)?(_|$)",
        rf"(^|_){word}_?{A}\d*$|(^|_){A}_?{word}\d*$",
        rf"(^|_)g_?(force_?)?({word}|{axis})\d*$|(^|_)a(cc\w*)?_({sides})$",
    )


def _turn(axis: str, word: str, sides: str, german: str) -> tuple[str, ...]:
    """Names of a rate of turn about an axis, likewise."""
    return (
        rf"{word}_?(rate|{SPEED})|(^|_){german}_?(winkel_?)?(rate|geschwindigkeit)(_|$)",
        rf"gyr(o|oscope)?_?{axis}|angular_velocity_{axis}",
        rf"(^|_){TURN}_?{axis}(_|$)",
        rf"(^|_){TURN}_({sides})$",
    )


NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "steering_wheel": (
            r"steer(ing)?_?wh(ee)?l(_?(angle|ang|pos|position))?|lenkrad_?(winkel)?$",
            r"(^|_)(swa|lwi|sas_?angle)",
            r"hand_?wheel|(^|_)lw_?winkel",
        ),
        "steering": (
            r"road_?wheel_?(angle|ang|steer)|steer\w*_?ti?yre_?angle|steering_tire_angle",
            r"(^|_)delta(_f)?$|(^|_)(rad_?)?lenk_?winkel$",
        ),
        "v_x": (
            r"veh(icle)?_?(spd|speed|v)|(^|_)v_?x$|(^|_)(fahr|fahrzeug_?)?geschwindigkeit$",
            rf"{LONG}_?{SPEED}|linear(_velocity)?_x$",
            rf"^(velocity|speed|gps_?speed|spd|ground_?speed)\d*$|{SPEED}_encoder",
            r"(^|_)(velocity|speed)$|geschwindigkeit_gps$|gps_geschwindigkeit$",
        ),
        "v_y": (r"(^|_)v_?y$", rf"lat(eral)?_?{SPEED}|linear(_velocity)?_y$"),
        "a_x": _acceleration("x", LONG, "forward", "laengs"),
        "a_y": _acceleration("y", "lat(eral)?", "left|right", "quer"),
        "a_z": _acceleration("z", "vert(ical)?", "up|down", "vertikal"),
        "yaw_rate": (
            *_turn("z", "yaw", "up|down", "gier"),
            r"psi_?(dot|p)(_|$)|heading_rate",
            r"^w(_imu)?$|^yaw_?r$",
        ),
        "roll_rate": _turn("x", "roll", "forward", "(wank|roll)"),
        "pitch_rate": _turn("y", "pitch", "left|right", "nick"),
        "roll": (r"(^|_)roll(_?(angle|ang|imu))?\d*$",),
        "torque_front": (r"(tq|torque)_?front$|front_?(axle_?)?(tq|torque)",),
        "torque_rear": (r"(tq|torque)_?rear$|rear_?(axle_?)?(tq|torque)",),
        "brake": (r"(brk|brake)_?(pedl?|pedal)?_?(psd|press(ed)?|switch|flag|active|on|light)?\d*$",),
    }
)
"""Channel -> patterns, the surest first."""

EXCLUDED: Mapping[str, str] = MappingProxyType(
    {
        "v_x": r"wh(ee)?l|yaw|roll|pitch|ang|eng|motor|lat_|vert|fan|(?<!gesch)wind|steer|quer|lenk",
        **dict.fromkeys(("steering", "steering_wheel"), r"rate|speed|spd|vel|torque|tq|geschw|moment"),
        "roll": r"acc|vel",
    }
)
"""Channel -> words in whose company its own words mean something else."""

OPPOSITE = r"(^|_)(right|down)$"  # of ISO 8855, at the end of an axis' name
EITHER_STEERING = r"(^|_)(steer|steering|steered)(_?(angle|ang|pos|position))?\d*$"
WHEEL = r"wh(ee)?l|(^|_)ws(_|$)|raddreh"
NOT_SPEED = r"angle|ang$|slip|tq|torque|steer|temp|pos|press"
TORQUE, NOT_TORQUE = r"tq|torque|moment", r"steer|eps|engine|eng_|driver|motor|brk|brake"
COMMANDS = r"target|desired|cmd|command|request|setpoint"  # in the name of a message too
NEVER = r"rms|cov|std_?dev|variance|quality|status|valid|temp|jerk|counter"
LESS = r"raw|backup|_2$"  # what is preferred the least
FILTERED = r"localization|ekf|kalman|filtered|fused|estimat"  # in the name of a message too: late, and likewise

CORNERS: Mapping[str, str] = MappingProxyType(
    {
        corner: rf"(^|_)({written})(_|\d|$|wh)"
        for corner, written in {
            "fl": "fl|lf|vl|front_?left|left_?front",
            "fr": "fr|rf|vr|front_?right|right_?front",
            "rl": "rl|lr|hl|rear_?left|left_?rear",
            "rr": "rr|hr|rear_?right|right_?rear",
        }.items()
    }
)
"""Wheels, front or rear, left or right; in German too (vorn, hinten)."""

NATIVE: Mapping[str, str] = MappingProxyType({one.column: name for name, one in CHANNELS.items()})
"""Column of a native file -> channel."""
