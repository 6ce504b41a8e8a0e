"""Forces on the body, whatever its tyres do, and its masses: with the effects that enter there."""

import math

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.effects import KNOTS
from vehicle_sbi.physics.signals import pulse
from vehicle_sbi.physics.vehicle import AIR_DENSITY, GRAVITY


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
