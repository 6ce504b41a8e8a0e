"""The catalogue of optional physics: what a simple model leaves out, one small function per effect.

Every effect is always compiled in. Each of its parameters has a null value at which the effect vanishes exactly, so a
model is nothing but the choice of which parameters are free, and models are nested. To add an effect: write its
function, call it from the stage it enters at (`steer`, `torques`, `body_load`, `tyre_force`, `sensors.measure`, ...),
and enter it in `CATALOGUE`; every law that the tests state for effects then holds for it too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.magic_formula import bent_early, peaked_and_full
from vehicle_sbi.physics.signals import SHORTEST, interpolate, lagged, pulse
from vehicle_sbi.physics.tyre import dugoff, dugoff_share, dugoff_side
from vehicle_sbi.physics.vehicle import AIR_DENSITY, CONSTANTS, GRAVITY, Vehicle

KNOTS = 12  # of a profile over the recording, equally spaced
LEAST_LOAD = 1e-3  # of the static one, that loads are divided by
LEAST_STIFFNESS = 0.05  # share of a stiffness that no load and no acceleration takes away
LEAST_LAG = 0.5  # of the way that a wheel rolls in a step of the integrator, the least length that lags as it is
MOST_GRIP = 0.99  # share of the grip that a given longitudinal force takes, at most
ROLL_DAMPING = 0.3  # damping ratio with which a passenger car's body leans, where none is found
PITCH_PERIOD, PITCH_DAMPING = 0.7, 0.3  # [s] and ratio with which it pitches, alike
SPRINGS_BEAR = 0.75  # of what a turn moves across, with their dampers, as in the paper's car; roll centres the rest
LEAST_SWING = 4.0  # steps of the integrator, the least natural period that swings as it is
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
    """An optional effect: where it enters, what it means, its equation and where that comes from, its parameters."""

    name: str
    enters_at: str
    meaning: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]

    @property
    def timed(self) -> bool:
        """Whether it is tied to the clock of one recording: it begins at a moment, or follows a profile over it."""
        return any(p.name.endswith((".start", ".angle_0")) for p in self.parameters)


def _effect(
    name: str, enters_at: str, meaning: str, equation: str, source: str, **parameters: tuple[str, float, float, float]
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
                "mu_axle = factor factor_axle mu_vehicle", "Dugoff's mu",
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
                f"{PACEJKA}, ch. 1; {RAJAMANI}, sec. 15.2",
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
                f"{PACEJKA}, sec. 4.3.2", weight=("1", 0.0, 1.0, 1.0)),
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
                "a = a_COG + dw/dt x p + w x (w x p)", "rigid-body kinematics",
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

# What belongs to the road and the air rather than to the car and has a side or a direction: fields of the record, each
# with the one whose value it takes, with the other sign, for a car that comes the other way along the same road.
ONCOMING: Mapping[str, str] = {
    **{name: name for name in ("road_grade_angle", "road_bank_angle", "crosswind_force", "gust_force")},
    **{f"road_grade_profile_angle_{i}": f"road_grade_profile_angle_{KNOTS - 1 - i}" for i in range(KNOTS)},
}
_EFFECT_FIELDS = tuple(name for p in EFFECT_PARAMETERS.values() for name in p.fields)

# What follows from the others and stays constant over a simulation; `derive` fills it.
_DERIVED = (
    "mass", "l_front", "l_rear", "I_z", "grip", "F_zf_static", "F_zr_static", "load_transfer",
    "sigma_f", "sigma_r", "stiff_f", "stiff_r", "slide_f", "slide_r", "moved_f", "moved_r", "I_wheels",
    "R_front", "R_rear", "grade_gravity", "bank_gravity", "profiled",
    "roll_lever", "pitch_lever", "roll_J", "pitch_J", "arm_x", "arm_y", "arm_z",
)  # fmt: skip

# What the integrator keeps from one step to the next: its step [s], how the search of each axle for its wheels' slips
# goes on, and where the loop between loads and forces does: the front axle's side force [N], and by how much
# `balance.Inverse` is beyond plain iteration.
OWN = (
    "step", "split_f", "split_r", "slope_f", "slope_r", "search", "side_f",
    *(f"inverse_{row}{column}" for row in "xys" for column in "xys"),
)  # fmt: skip

# What no effect stands for, following the input `latent` over time: a load on the body [N, N, N m], an error of the
# road wheels' angle [rad], and one of a sensor, that of a row of MEASUREMENTS [its unit].
LATENT = ("latent_x", "latent_y", "latent_z", "latent_steering", "latent_sensor", "latent_row")

_FIELDS = (*CONSTANTS, "I_z_stated", "duration", *_EFFECT_FIELDS, *LATENT, *_DERIVED, *OWN)
RECORD = np.dtype([(name, np.float64) for name in _FIELDS])


def nominal_record(vehicle: Vehicle, duration: float = 0.0) -> np.void:
    """The physical record of a vehicle with every effect at its null; NaN where a constant is not known.

    `duration` [s] is the recording's, over which a profile's knots are spread.
    """
    record = np.full(1, np.nan, dtype=RECORD)
    for name in CONSTANTS:
        value = getattr(vehicle, name)
        record[name] = np.nan if value is None else value
    record["I_z_stated"] = vehicle.I_z or 0.0
    record["duration"] = duration
    for name in (*LATENT, *OWN):
        record[name] = 0.0
    for parameter in EFFECT_PARAMETERS.values():
        for name in parameter.fields:
            record[name] = parameter.null
    return record[0]


@compiled_apart
def derive(p) -> None:
    """Fill the derived fields of the record.

    Mass, its place and I_z = factor m l_f l_r (unless the vehicle file states it) with the payload; static loads m g
    l_r/L and m g l_f/L across a graded or banked road, and how much of what a turn moves each axle bears over its share
    of them; what wheels that stand apart add to I_z, the outer ones turning faster; load transfer m h/L [N per m/s^2];
    relaxation lengths sigma = C_alpha / K and what is added to it [m] (the paper's sec. II and equation 11); levers m_s
    h_s [kg m] of the sprung mass, payload included, about the roll and pitch axes, wheels and axles taken to lie at the
    height of the wheels' centres, with its moments of inertia about those axes [kg m^2]; the IMU's place. No more than
    all of m is sprung.
    """
    p.mass, p.l_front, carried = payload(p)
    p.l_rear = p.L - p.l_front
    p.I_z = carried + yaw_inertia(p, p.I_z_stated if p.I_z_stated > 0.0 else p.m * p.l_f * (p.L - p.l_f))
    p.grip = friction_level(p, p.mu)
    weight = p.mass * GRAVITY * math.cos(p.road_grade_angle) * math.cos(p.road_bank_angle)
    p.stiff_f, p.stiff_r = stiffness_level(p)
    p.sigma_f, p.sigma_r = relaxation(p, p.stiff_f * p.C_alpha_f / p.K, p.stiff_r * p.C_alpha_r / p.K)
    p.slide_f, p.slide_r = p.friction_level_front, p.friction_level_rear
    p.R_front, p.R_rear = wheel_radius(p)
    p.moved_f = max(1.0 + p.lateral_load_transfer_front * p.L / p.l_rear, 0.0)
    p.moved_r = max(1.0 - p.lateral_load_transfer_front * p.L / p.l_front, 0.0)
    wheels = (p.I_wf if p.I_wf > 0.0 else 0.0) + (p.I_wr if p.I_wr > 0.0 else 0.0)
    p.I_wheels = wheels * (0.5 * p.lateral_load_transfer_track / p.R_f) ** 2
    p.grade_gravity = GRAVITY * math.sin(p.road_grade_angle)
    p.bank_gravity = GRAVITY * math.sin(p.road_bank_angle)
    p.profiled = 0.0
    for angle in profile_knots(p):
        p.profiled += abs(angle)
    p.load_transfer = p.mass * p.h_cog / p.L
    p.F_zf_static = weight * p.l_rear / p.L
    p.F_zr_static = weight * p.l_front / p.L
    sprung = min(p.m_s, p.m) + p.payload_mass if p.m_s > 0.0 else 0.0
    h_s = (p.mass * p.h_cog - (p.mass - sprung) * p.R_f) / sprung if sprung > 0.0 else p.h_cog
    p.roll_lever, p.pitch_lever = sprung * (h_s - p.h_roll), sprung * (h_s - p.h_pitch)
    p.roll_J = p.I_x + p.roll_lever * (h_s - p.h_roll)
    p.pitch_J = p.I_y + p.pitch_lever * (h_s - p.h_pitch)
    p.arm_x, p.arm_y, p.arm_z = imu_lever_arm(p)


@compiled
def imu_lever_arm(p) -> tuple[float, float, float]:
    """Where the IMU sits from the centre of gravity [m]: where the vehicle file has it, plus the lever arm.

    A vehicle file states the place from the middle of the rear axle on the ground, as Autoware's base_link does.
    """
    x = p.imu_x - p.l_rear if math.isfinite(p.imu_x) else 0.0
    y = p.imu_y if math.isfinite(p.imu_y) else 0.0
    z = p.imu_z - p.h_cog if math.isfinite(p.imu_z) else 0.0
    return x + p.imu_lever_arm_x, y + p.imu_lever_arm_y, z + p.imu_lever_arm_z


# --- command to wheels ----------------------------------------------------------------------------------------------


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


# --- forces on the body ---------------------------------------------------------------------------------------------


@compiled
def aero_drag(p, v_x: float) -> float:
    """Drag force [N] along x, -1/2 rho C_d A v|v| (Rajamani, sec. 4.2); vanishes at area 0."""
    return -0.5 * AIR_DENSITY * p.aero_drag_area * v_x * abs(v_x)


@compiled
def downforce(p, v_x: float) -> tuple[float, float]:
    """What the air adds to the loads (front, rear) [N], 1/2 rho C_l A v^2 in all."""
    pressed = 0.5 * AIR_DENSITY * p.downforce_area * v_x * v_x
    return p.downforce_front_share * pressed, (1.0 - p.downforce_front_share) * pressed


@compiled
def rolling_resistance(p, v_x: float) -> float:
    """Rolling resistance [N] along x, -c_rr F_z (Rajamani, sec. 4.2), fading linearly below 1 m/s to zero at rest."""
    press_f, press_r = downforce(p, v_x)
    F_z = p.F_zf_static + p.F_zr_static + press_f + press_r
    return -p.rolling_resistance_coefficient * F_z * min(1.0, max(-1.0, v_x))


@compiled
def profile_knots(p):
    """Grades [rad] at the knots of the profile."""
    return (
        p.road_grade_profile_angle_0,
        p.road_grade_profile_angle_1,
        p.road_grade_profile_angle_2,
        p.road_grade_profile_angle_3,
        p.road_grade_profile_angle_4,
        p.road_grade_profile_angle_5,
        p.road_grade_profile_angle_6,
        p.road_grade_profile_angle_7,
        p.road_grade_profile_angle_8,
        p.road_grade_profile_angle_9,
        p.road_grade_profile_angle_10,
        p.road_grade_profile_angle_11,
    )


@compiled
def road_grade_profile(p, t: float) -> float:
    """Grade [rad] at time t [s] of the recording, linear between knots spread over its duration."""
    position = min(max(t / p.duration, 0.0), 1.0) * (KNOTS - 1) if p.duration > 0.0 else 0.0
    grade = 0.0
    for i, angle in enumerate(profile_knots(p)):
        grade += max(1.0 - abs(position - i), 0.0) * angle
    return grade


@compiled
def road_grade(p, t: float) -> float:
    """Gravity along x [m/s^2], g sin(grade), which slows the car uphill; vanishes at angle 0."""
    if p.profiled == 0.0:
        return p.grade_gravity
    return GRAVITY * math.sin(p.road_grade_angle + road_grade_profile(p, t))


@compiled
def road_bank(p) -> float:
    """Gravity along y [m/s^2], g sin(bank): the raised left side pulls to the right."""
    return p.bank_gravity


@compiled
def crosswind(p) -> tuple[float, float]:
    """Side force [N] and yaw moment [N m] of a steady wind."""
    return p.crosswind_force, p.crosswind_arm * p.crosswind_force


@compiled
def gust(p, t: float) -> tuple[float, float]:
    """Side force [N] and yaw moment [N m] of a wind that blows from `start` on for `duration`."""
    force = p.gust_force * pulse(t, p.gust_start, p.gust_duration)
    return force, p.gust_arm * force


@compiled
def payload(p) -> tuple[float, float, float]:
    """Mass [kg], front axle to centre of gravity [m] and added yaw inertia [kg m^2] with a load at x from the empty
    car's centre of gravity (parallel-axis theorem)."""
    mass = p.m + p.payload_mass
    share = p.payload_mass / mass
    return mass, p.l_f - share * p.payload_x, share * p.m * p.payload_x**2


@compiled
def yaw_inertia(p, I_z: float) -> float:
    """Yaw inertia [kg m^2] where m l_f l_r is off by a factor."""
    return p.yaw_inertia_factor * I_z


@compiled
def yaw_moment(p) -> float:
    """Constant moment [N m] about the vertical axis."""
    return p.yaw_moment_moment


@compiled
def lateral_cog(p, F_x: float) -> float:
    """Moment [N m] about a centre of gravity left of the middle by tyres that pull with F_x [N] along the car."""
    return p.lateral_cog_y * F_x


@compiled
def latent_load(p, course: float) -> tuple[float, float, float]:
    """A load of unknown origin, (F_x, F_y [N], M_z [N m]), that takes a `course` over time."""
    return p.latent_x * course, p.latent_y * course, p.latent_z * course


@compiled
def latent_steering(p, course: float) -> float:
    """An error of unknown origin in the road wheels' angle [rad]."""
    return p.latent_steering * course


@compiled
def latent_sensor(p, row: int, course: float) -> float:
    """An error of unknown origin in one of MEASUREMENTS, in its unit."""
    return p.latent_sensor * course if row == int(p.latent_row) else 0.0


@compiled
def body_load(p, v_x: float, t: float, course: float) -> tuple[float, float, float]:
    """Sum of the optional forces (x, y) [N] and moments about z [N m] on the body at time t [s]."""
    wind, wind_moment = crosswind(p)
    blow, blow_moment = gust(p, t)
    rest_x, rest_y, rest_z = latent_load(p, course)
    along = aero_drag(p, v_x) + rolling_resistance(p, v_x) - p.mass * road_grade(p, t) + rest_x
    across = wind + blow - p.mass * road_bank(p) + rest_y
    return along, across, wind_moment + blow_moment + yaw_moment(p) + rest_z


# --- tyres ----------------------------------------------------------------------------------------------------------


@compiled
def friction_level(p, mu: float) -> float:
    """Friction coefficient where the road's differs from the vehicle file's by a factor."""
    return p.friction_level_factor * mu


@compiled
def friction_step(p, mu: float, t: float) -> float:
    """Friction coefficient at time t [s], off by a factor from `start` on for `duration`."""
    return mu * (1.0 + (p.friction_step_factor - 1.0) * pulse(t, p.friction_step_start, p.friction_step_duration))


@compiled
def load_sensitivity(p, load: float) -> float:
    """Factor on the stiffnesses at a vertical load in units of the static one."""
    if p.load_sensitivity_coefficient == 0.0:
        return 1.0
    return max(1.0 + p.load_sensitivity_coefficient * (load - 1.0), LEAST_STIFFNESS)


@compiled
def lateral_load_transfer(p, a_y: float) -> float:
    """Factor on the cornering stiffness of an axle whose load has moved across as an acceleration [m/s^2] asks."""
    return max(1.0 - p.lateral_load_transfer_coefficient * a_y * a_y, LEAST_STIFFNESS)


@compiled
def lean_period(p) -> float:
    """Natural period [s] over 2 pi of the lean that moves load across, LEAST_SWING steps of the integrator at least."""
    return max(p.lateral_load_transfer_period, LEAST_SWING * p.step) / (2.0 * math.pi)


@compiled
def pitch_period(p) -> float:
    """The same of the pitch that moves load between the axles."""
    return max(p.load_sensitivity_period, LEAST_SWING * p.step) / (2.0 * math.pi)


@compiled
def pitches(p) -> bool:
    """Whether load moves between the axles as the body pitches."""
    return p.load_sensitivity_sprung != 0.0


@compiled
def lean_share(p) -> float:
    """Share of what a turn moves across that comes as the body leans, the rest coming at once.

    A shorter period than LEAST_SWING steps is that long, by the share that has the same second-order response,
    1 - (s T)^2.
    """
    if not leans(p):
        return 0.0
    shorter = min(p.lateral_load_transfer_period / (LEAST_SWING * p.step), 1.0)
    return SPRINGS_BEAR * shorter * shorter


@compiled
def uneven(p, load: float, a_y: float) -> float:
    """By which share the load of an axle's right wheel is above, and that of its left one below, the mean of both,
    which is `load` times the static one."""
    return min(max(math.sqrt(p.lateral_load_transfer_uneven) * a_y / max(load, LEAST_LOAD), -1.0), 1.0)


@compiled
def tyre_curve(p, z: float, share: float) -> tuple[float, float]:
    """Forces (x, y) over demands at demand over grip z, where Dugoff's are `share` of them: blends towards magic
    formulas, one of which peaks, one bends late and one early (Pacejka, sec. 4.3)."""
    if z == 0.0:
        return share, share
    peaked, full = peaked_and_full(z)
    peaked, full, early = peaked / z - share, full / z - share, bent_early(z) / z - share
    both = share + p.tyre_curve_fullness * full + p.tyre_curve_early * early
    return both + p.tyre_curve_longitudinal * peaked, both + p.tyre_curve_peak * peaked


@compiled
def curved(p) -> bool:
    """Whether the tyre curve is another one than Dugoff's."""
    peaked = p.tyre_curve_peak != 0.0 or p.tyre_curve_longitudinal != 0.0
    return peaked or p.tyre_curve_fullness != 0.0 or p.tyre_curve_early != 0.0


@compiled
def relaxation(p, sigma_f: float, sigma_r: float) -> tuple[float, float]:
    """Relaxation lengths [m] of the front and rear tyres, longer than C_alpha / K of each by a length."""
    return sigma_f + p.relaxation_front, sigma_r + p.relaxation_rear


@compiled
def lag_share(p, sigma: float, speed: float) -> float:
    """Share of the slip behind a force that lags by the relaxation length, the rest following at once.

    The integrator of step h is stable for a lag of rate v/sigma up to 2.78/h. A shorter one than LEAST_LAG v h lags as
    that does, by the share that has the same first-order response: 1 - s sigma/v.
    """
    return min(sigma / (LEAST_LAG * speed * p.step), 1.0) if sigma > 0.0 else 0.0


@compiled
def lag_rate(p, sigma: float, speed: float) -> float:
    """Rate [1/s] at which a lagged slip follows; none without relaxation."""
    return speed / max(sigma, LEAST_LAG * speed * p.step) if sigma > 0.0 else 0.0


@compiled
def stiffness_level(p) -> tuple[float, float]:
    """Factors on the cornering and longitudinal stiffness of the front and rear tyres."""
    both = p.stiffness_level_factor
    return both * p.stiffness_level_front, both * p.stiffness_level_rear


@compiled
def wheel_radius(p) -> tuple[float, float]:
    """Free radii [m] of the front and rear tyres, off by a factor each."""
    return p.wheel_radius_front * p.R_f, p.wheel_radius_rear * p.R_f


@compiled
def ignores_load(p) -> bool:
    """Whether the force that `axle_force` gives below the knee is the same under any load."""
    stiff = p.load_sensitivity_coefficient == 0.0 and p.lateral_load_transfer_coefficient == 0.0
    return stiff and not wheels_differ(p) and not curved(p)


@compiled
def moves_load_across(p) -> bool:
    """Whether a turn moves load from an axle's inner wheel to its outer one, and the model counts with it."""
    return p.lateral_load_transfer_uneven != 0.0 or p.lateral_load_transfer_coefficient != 0.0


@compiled
def leans(p) -> bool:
    """Whether load moves across as the body leans."""
    return p.lateral_load_transfer_period > SHORTEST and moves_load_across(p)


@compiled
def wheels_differ(p) -> bool:
    """Whether the wheels of an axle are two to the model, in their loads or in where they stand."""
    return p.lateral_load_transfer_uneven != 0.0 or p.lateral_load_transfer_track != 0.0


@compiled
def tyre_force(
    p, C_kappa: float, C_alpha: float, mu: float, F_z: float, load: float, kappa: float, tan_alpha: float, a_y: float
) -> tuple[float, float]:
    """Forces (F_x, F_y) [N] of a tyre or an axle under F_z [N], `load` times its static one, with the tyre effects."""
    stiffness = load_sensitivity(p, load)
    C_kappa, C_alpha = stiffness * C_kappa, stiffness * lateral_load_transfer(p, a_y) * C_alpha
    if not curved(p) and not weighed(p):
        return dugoff(C_kappa, C_alpha, mu, F_z, kappa, tan_alpha)
    demand_x, demand_y, grip = C_kappa * kappa, C_alpha * tan_alpha, mu * max(F_z, 0.0)
    along, across = shares(p, math.hypot(demand_x, demand_y), grip, kappa)
    if weighed(p):
        _, across = shares(p, combined_slip(p, demand_x, demand_y), grip, kappa)
    return along * demand_x, across * demand_y


@compiled
def shares(p, demand: float, grip: float, kappa: float) -> tuple[float, float]:
    """Forces (x, y) over their demands [N], of size `demand`."""
    if demand == 0.0:
        return 0.0, 0.0
    share = dugoff_share(demand, grip, kappa)
    return tyre_curve(p, demand / max(grip, 1e-9), share) if curved(p) else (share, share)


@compiled
def weighed(p) -> bool:
    """Whether the longitudinal demand counts less in the side force than in the friction circle."""
    return p.combined_slip_weight != 1.0


@compiled
def combined_slip(p, demand_x: float, demand_y: float) -> float:
    """Combined demand S_y [N] that the side force follows from."""
    return math.hypot(p.combined_slip_weight * demand_x, demand_y)


@compiled
def side_force(p, C_alpha: float, mu: float, F_z: float, load: float, F_x: float, tan_alpha: float, a_y: float):
    """Forces (F_x, F_y) [N] of a tyre or an axle whose longitudinal force is given, as far as its grip goes."""
    demand_y = load_sensitivity(p, load) * lateral_load_transfer(p, a_y) * C_alpha * tan_alpha
    grip = mu * max(F_z, 0.0)
    F_x = min(max(F_x, -MOST_GRIP * grip), MOST_GRIP * grip)
    F_y, demand = dugoff_side(F_x, demand_y, grip)
    if demand_y == 0.0 or (not curved(p) and not weighed(p)):
        return F_x, F_y
    if weighed(p):
        demand = combined_slip(p, math.sqrt(max(demand * demand - demand_y * demand_y, 0.0)), demand_y)
    _, across = shares(p, demand, grip, 0.0)
    return F_x, across * demand_y
