"""The catalogue of optional physics: what a simple model leaves out, one small function per effect.

Every effect is always compiled in. Each of its parameters has a null value at which the effect vanishes exactly, so a
model is nothing but the choice of which parameters are free, and models are nested. To add an effect: enter it in
`CATALOGUE`, write its function in the module of the stage that it enters at (`commands`, `body_forces`, `tyre_effects`,
`sensors`), and call it from there (`steer`, `torques`, `body_load`, `tyre_force`, `measure`, ...); every law that the
tests state for effects then holds for it too.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from vehicle_sbi.parameters import Parameter

KNOTS = 12  # of a profile over the recording, equally spaced
ROLL_DAMPING = 0.3  # damping ratio with which a passenger car's body leans, where none is found
PITCH_PERIOD, PITCH_DAMPING = 0.7, 0.3  # [s] and ratio with which it pitches, alike
SPRINGS_BEAR = 0.75  # of what a turn moves across, with their dampers, as in the paper's car; roll centres the rest
REPORTED = (
    "imu",
    "can",
    "wheel_speed",
    "a_x",
    "a_y",
    "yaw_rate",
    "wheel_speed_front",
    "wheel_speed_rear",
    "v_x",
    "v_y",
    "a_z",
    "roll_rate",
    "pitch_rate",
)  # of sensors: groups that share a clock and a filter, and channels
# Where tyres have C = c F_z (1 - k F_z / F_z0), an axle loses k / (1 - k) (2 h_cog a_y / (g track))^2 of its stiffness.
# h_cog / track is at most 0.4, and k 0.43: at 0.5 stiffness no longer grows with the load.
MOST_LOAD_TRANSFER = 0.005  # [1/(m/s^2)^2]
# A wheel's share moves by s = 2 h_cog a_y / (g track); h_cog / track is at most 0.6, where a car tips over at 0.83 g.
MOST_UNEVEN = 0.015  # [1/(m/s^2)^2], (2 h_cog / (g track))^2
# Springs and anti-roll bars set which axle bears how much of what a turn moves; no car leaves one of them almost none.
MOST_SHIFTED = 0.3  # of all of it, from one axle to the other
WIDEST = 1.9  # [m], track of a passenger car at most; the full vehicle's box ends at 1.8
DEAD_TIME = "pure dead time"
RAJAMANI, PACEJKA = "Rajamani, Vehicle Dynamics and Control", "Pacejka, Tire and Vehicle Dynamics"


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An optional effect: where it enters, what it means, its equation and where that comes from, its parameters, and
    effects beside which one of these acts that does not by itself."""

    name: str
    enters_at: str
    meaning: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    beside: tuple[str, ...] = ()

    @property
    def timed(self) -> bool:
        """Whether it is tied to the clock of one recording: it begins at a moment, or follows a profile over it."""
        return any(p.name.endswith((".start", ".angle_0")) for p in self.parameters)


def _effect(
    name: str,
    enters_at: str,
    meaning: str,
    equation: str,
    source: str,
    *beside: str,
    **parameters: tuple[str, float, float, float],
) -> Effect:
    """An effect with `parameters` as name=(unit, low, high, null); the record's fields are effect_parameter."""
    return Effect(
        name=name,
        enters_at=enters_at,
        meaning=meaning,
        equation=equation,
        source=source,
        parameters=tuple(
            Parameter(name=f"{name}.{key}", unit=unit, low=low, high=high, null=null, fields=(f"{name}_{key}",))
            for key, (unit, low, high, null) in parameters.items()
        ),
        beside=beside,
    )


def _swaying(angle: str, input_: str) -> str:
    """How a body on springs and dampers leans, as an equation."""
    law = f"T^2 d2({angle})/dt2 + (lag + 0.3 T) d({angle})/dt = {input_} - {angle}, T = period / (2 pi)"
    return f"{law}; z: the IMU above the centre of gravity"


CATALOGUE: Mapping[str, Effect] = {
    effect.name: effect
    for effect in (
        # command to wheels
        _effect("steering_delay", "command", "the wheels follow the steering command later",
                "delta(t) = command(t - time)", DEAD_TIME, time=("s", 0.0, 0.5, 0.0)),
        _effect("steering_lag", "command", "the wheels follow the steering command as a first-order lag",
                "time d(delta)/dt = command - delta", "first-order actuator", time=("s", 0.0, 1.0, 0.0)),
        _effect("steering_dead_band", "command", "play in the steering, full width",
                "delta stays until the command is width/2 away, then follows at that distance",
                "the play operator of backlash", width=("rad", 0.0, 0.03, 0.0)),
        _effect("steering_ratio", "command", "road-wheel angle per stated road-wheel angle",
                "delta = gain command", "steering geometry", gain=("1", 0.7, 1.4, 1.0)),
        _effect("steering_offset", "command", "the wheels are not straight at command zero",
                "delta = command + angle", "alignment", angle=("rad", -0.03, 0.03, 0.0)),
        _effect("steering_compliance", "command", "the front axle's side force turns the wheels back",
                "delta = command - coefficient F_yf", f"{PACEJKA}, ch. 1",
                coefficient=("rad/N", 0.0, 4e-6, 0.0)),
        _effect("roll_steer", "command", "the front wheels steer as the body rolls in a turn",
                "delta = command + coefficient v_x r", f"{PACEJKA}, ch. 1",
                coefficient=("rad/(m/s^2)", -0.003, 0.003, 0.0)),
        _effect("drive_gain", "command", "drive torque at the wheels per stated drive torque",
                "T = gain T_command where positive", "powertrain losses", gain=("1", 0.5, 1.5, 1.0)),
        _effect("brake_gain", "command", "brake torque at the wheels per stated brake torque",
                "T = gain T_command where negative", "friction of the brake pads", gain=("1", 0.5, 1.5, 1.0)),
        _effect("brake_balance", "command", "brake torque moved from the rear axle to the front",
                "T_f = T_f,command + shift (T_f + T_r)_command where both brake", "brake-force distribution",
                shift=("1", -0.3, 0.3, 0.0)),
        _effect("drive_delay", "command", "the torques follow their command later",
                "T(t) = T_command(t - time)", DEAD_TIME, time=("s", 0.0, 0.5, 0.0)),
        # forces on the body
        _effect("aero_drag", "force", "aerodynamic drag", "F_x = -rho/2 area v_x |v_x|",
                f"{RAJAMANI}, sec. 4.2", area=("m^2", 0.0, 1.5, 0.0)),
        _effect("downforce", "force", "the air presses the car down",
                "F_z = rho/2 area v_x^2, front_share of it on the front axle", "definition of a lift coefficient",
                "tyre_curve",
                area=("m^2", 0.0, 4.0, 0.0), front_share=("1", 0.2, 0.8, 0.5)),
        _effect("rolling_resistance", "force", "rolling resistance of the tyres", "F_x = -coefficient F_z",
                f"{RAJAMANI}, sec. 4.2", coefficient=("1", 0.0, 0.05, 0.0)),
        _effect("road_grade", "force", "the road climbs (positive uphill)", "F_x = -m g sin(angle)",
                f"{RAJAMANI}, sec. 4.2", angle=("rad", -0.15, 0.15, 0.0)),
        _effect("road_grade_profile", "force", "the road's grade changes over the recording",
                "grade(t) linear between knots equally spaced from its start to its end",
                f"{RAJAMANI}, sec. 4.2", **{f"angle_{i}": ("rad", -0.1, 0.1, 0.0) for i in range(KNOTS)}),
        _effect("road_bank", "force", "the road's left side is higher (positive)", "F_y = -m g sin(angle)",
                f"{RAJAMANI}, sec. 2.8", angle=("rad", -0.1, 0.1, 0.0)),
        _effect("crosswind", "force", "steady side wind, acting ahead of the centre of gravity",
                "F_y = force, M_z = arm force; it moves no load", "a force and its lever",
                force=("N", -1500.0, 1500.0, 0.0), arm=("m", -1.0, 1.0, 0.0)),
        _effect("gust", "force", "side wind for a while, acting ahead of the centre of gravity",
                "F_y = force, M_z = arm force from start on for duration; it moves no load", "a force and its lever",
                force=("N", -3000.0, 3000.0, 0.0), arm=("m", -1.0, 1.0, 0.0),
                start=("s", 0.0, 5.0, 0.0), duration=("s", 0.0, 5.0, 0.0)),
        _effect("payload", "force", "load ahead of the empty car's centre of gravity",
                "m, l_f and I_z of the two together", "parallel-axis theorem",
                mass=("kg", 0.0, 500.0, 0.0), x=("m", -1.5, 1.5, 0.0)),
        _effect("yaw_inertia", "force", "yaw inertia over the vehicle file's I_z, or m l_f l_r where it states none",
                "I_z = factor I_z,vehicle (m l_f l_r without one)", "the paper, sec. II-A",
                factor=("1", 0.7, 1.5, 1.0)),
        _effect("yaw_moment", "force", "constant moment about the vertical axis", "M_z = moment", "Newton and Euler",
                moment=("N m", -1500.0, 1500.0, 0.0)),
        _effect("lateral_cog", "force",
                "the centre of gravity lies left of the middle: driving and braking turn the car, as a pulling brake",
                "M_z = y F_x, F_x of all tyres along the car", "rigid-body mechanics", y=("m", -0.1, 0.1, 0.0)),
        # tyres
        _effect("friction_level", "tyre", "friction coefficient over the vehicle's, of both axles or of one",
                "mu_axle = factor factor_axle mu_vehicle", "Dugoff's mu", "tyre_curve",
                factor=("1", 0.3, 1.3, 1.0), front=("1", 0.6, 1.3, 1.0), rear=("1", 0.6, 1.3, 1.0)),
        _effect("stiffness_level", "tyre", "tyre stiffnesses over the vehicle's, of both axles or of one",
                "C_axle = factor factor_axle C_vehicle, cornering and longitudinal alike, and so C_alpha / K",
                f"{PACEJKA}, ch. 1: tread, pressure and temperature",
                factor=("1", 0.5, 1.6, 1.0), front=("1", 0.5, 1.6, 1.0), rear=("1", 0.5, 1.6, 1.0)),
        _effect("friction_step", "tyre", "another friction coefficient for a while",
                "mu = factor mu_vehicle from start on for duration", "Dugoff's mu",
                factor=("1", 0.3, 1.3, 1.0), start=("s", 0.0, 5.0, 0.0), duration=("s", 0.0, 5.0, 0.0)),
        _effect("load_sensitivity", "tyre",
                "stiffnesses grow with the vertical load, part of which moves between the axles as the body pitches",
                "C = C_static (1 + coefficient (F_z / F_z,static - 1)), of F_z a part (m h_cog / L) w follows a_x, "
                "w = (1 - sprung) a_x + sprung (y + 2 damping T dy/dt), T = period/(2 pi), T^2 d2y/dt2 + 2 damping T "
                "dy/dt = a_x - y (the full vehicle has its own springs)",
                f"{PACEJKA}, ch. 1; {RAJAMANI}, ch. 10", coefficient=("1", 0.0, 1.0, 0.0),
                sprung=("1", 0.0, 1.0, 0.0), period=("s", 0.4, 1.2, PITCH_PERIOD),
                damping=("1", 0.1, 0.8, PITCH_DAMPING)),
        _effect("lateral_load_transfer", "tyre",
                "an axle loses cornering stiffness, and its inner wheel slides first, as load moves to the outer one",
                "C_alpha = C_alpha,straight (1 - coefficient w^2), F_axle = F((F_z + S)/2) + F((F_z - S)/2) of "
                "two wheels of equal torque, at v_x +- r track/2, S = sqrt(uneven) w m g share, share_f = l_r/L + "
                f"front, share_r = l_f/L - front, w = {1.0 - SPRINGS_BEAR:g} a_y + {SPRINGS_BEAR:g} (y + "
                "2 damping T dy/dt), T = period/(2 pi), T^2 d2y/dt2 + 2 damping T dy/dt = a_y - y (the full vehicle "
                "has its own wheels)",
                f"{PACEJKA}, ch. 1; {RAJAMANI}, sec. 15.2", "tyre_curve",
                coefficient=("1/(m/s^2)^2", 0.0, MOST_LOAD_TRANSFER, 0.0),
                uneven=("1/(m/s^2)^2", 0.0, MOST_UNEVEN, 0.0), front=("1", -MOST_SHIFTED, MOST_SHIFTED, 0.0),
                track=("m", 0.0, WIDEST, 0.0), period=("s", 0.0, 1.2, 0.0),
                damping=("1", 0.1, 0.8, ROLL_DAMPING)),
        _effect("tyre_curve", "tyre", "tyre forces peak and fall, or bend late or early, instead of saturating",
                "F_y = F_Dugoff + peak (M(3/2, 0) - F_Dugoff) + fullness (M(3/2, -17/8) - F_Dugoff) + early (M(1, 0) - "
                "F_Dugoff), F_x with longitudinal in place of peak alone, M(C, E) = mu F_z sin(C atan(w - E (w - atan "
                "w))), w = z/C, z = |(C_kappa kappa, C_alpha tan(alpha))|/(mu F_z)",
                f"{PACEJKA}, sec. 4.3", peak=("1", 0.0, 1.0, 0.0), longitudinal=("1", 0.0, 1.0, 0.0),
                fullness=("1", 0.0, 1.0, 0.0), early=("1", 0.0, 1.0, 0.0)),
        _effect("combined_slip", "tyre", "driving and braking take less of the side force than a friction circle says",
                "S_y = |(weight C_kappa kappa, C_alpha tan(alpha))| in place of S in the law of F_y",
                f"{PACEJKA}, sec. 4.3.2", "tyre_curve", weight=("1", 0.0, 1.0, 1.0)),
        _effect("relaxation", "tyre", "slips build up over a rolled length, beyond the file's C_alpha / K",
                "sigma = C_alpha / K + length of each axle", f"{PACEJKA}, sec. 7.2; the paper's equation 11",
                front=("m", 0.0, 1.0, 0.0), rear=("m", 0.0, 1.0, 0.0)),
        _effect("wheel_radius", "tyre", "free tyre radii over the vehicle's", "R = factor R_f", "wear and pressure",
                front=("1", 0.9, 1.1, 1.0), rear=("1", 0.9, 1.1, 1.0)),
        # sensors
        _effect("body_roll", "sensor", "the body leans outwards and gravity leaks into a_y",
                f"a_y = (a_y - z d2(roll)/dt2) cos(roll) + g sin(roll), {_swaying('roll', 'gradient a_y')}",
                f"{RAJAMANI}, sec. 15.2",
                gradient=("rad/(m/s^2)", 0.0, 0.02, 0.0), lag=("s", 0.0, 0.3, 0.0), period=("s", 0.0, 1.0, 0.0)),
        _effect("body_pitch", "sensor", "the nose lifts under acceleration and gravity leaks into a_x",
                f"a_x = (a_x + z d2(pitch)/dt2) cos(pitch) - g sin(pitch), {_swaying('pitch', '-gradient a_x')}",
                f"{RAJAMANI}, sec. 15.2",
                gradient=("rad/(m/s^2)", 0.0, 0.02, 0.0), lag=("s", 0.0, 0.3, 0.0), period=("s", 0.0, 1.0, 0.0)),
        _effect("imu_lever_arm", "sensor", "the IMU sits away from the centre of gravity",
                "a = a_COG + dw/dt x p + w x (w x p)", "rigid-body kinematics", "body_roll", "body_pitch",
                x=("m", -1.5, 1.5, 0.0), y=("m", -0.8, 0.8, 0.0), z=("m", -0.5, 1.0, 0.0)),
        _effect("imu_misalignment", "sensor", "the IMU's axes are turned against the car's",
                "f_IMU = R_x(roll)' R_y(pitch)' R_z(yaw)' f", "rotation by Tait-Bryan angles",
                roll=("rad", -0.1, 0.1, 0.0), pitch=("rad", -0.1, 0.1, 0.0), yaw=("rad", -0.1, 0.1, 0.0)),
        _effect("accelerometer_scale", "sensor", "gain of the accelerometer", "a = gain a", "sensor model",
                x=("1", 0.8, 1.2, 1.0), y=("1", 0.8, 1.2, 1.0), z=("1", 0.8, 1.2, 1.0)),
        _effect("accelerometer_bias", "sensor", "constant offset of the accelerometer", "a = a + bias", "sensor model",
                x=("m/s^2", -0.6, 0.6, 0.0), y=("m/s^2", -0.6, 0.6, 0.0)),
        _effect("gyro_scale", "sensor", "gain of the gyro: roll, pitch and yaw rate", "w = gain w", "sensor model",
                x=("1", 0.8, 1.2, 1.0), y=("1", 0.8, 1.2, 1.0), z=("1", 0.8, 1.2, 1.0)),
        _effect("gyro_bias", "sensor", "constant offset of the gyro: roll, pitch and yaw rate", "w = w + bias",
                "sensor model",
                x=("rad/s", -0.03, 0.03, 0.0), y=("rad/s", -0.03, 0.03, 0.0), z=("rad/s", -0.03, 0.03, 0.0)),
        _effect("speed_scale", "sensor", "gain of the speed sensor, where the speed is predicted", "v_x = gain v_x",
                "sensor model", gain=("1", 0.8, 1.2, 1.0)),
        _effect("sensor_lag", "sensor", "a group of sensors, or one channel, reports through a first-order lag",
                "time dy/dt = signal - y, time = group + channel", "first-order filter",
                **dict.fromkeys(REPORTED, ("s", 0.0, 2.0, 0.0))),
        _effect("sensor_delay", "sensor", "a group of sensors, or one channel, reports later",
                "y(t) = signal(t - time), time = group + channel", DEAD_TIME,
                **dict.fromkeys(REPORTED, ("s", 0.0, 0.5, 0.0))),
    )
}  # fmt: skip

EFFECT_PARAMETERS: Mapping[str, Parameter] = {p.name: p for effect in CATALOGUE.values() for p in effect.parameters}
DEAD_TIMES = tuple(p.name for e in CATALOGUE.values() if e.source == DEAD_TIME for p in e.parameters)

# Curves that a tyre may have, of which the recording's is a mixture.
TYRE_CURVES = ("tyre_curve.peak", "tyre_curve.fullness", "tyre_curve.early")

# What belongs to the road and the air rather than to the car and has a side or a direction: fields of the record, each
# with the one whose value it takes, with the other sign, for a car that comes the other way along the same road.
ONCOMING: Mapping[str, str] = {
    **{name: name for name in ("road_grade_angle", "road_bank_angle", "crosswind_force", "gust_force")},
    **{f"road_grade_profile_angle_{i}": f"road_grade_profile_angle_{KNOTS - 1 - i}" for i in range(KNOTS)},
}
