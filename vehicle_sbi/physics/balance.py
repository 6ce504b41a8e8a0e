"""The loop between loads and forces, the same for every model.

Forces of the tyres accelerate the car, accelerations move load between the wheels, and load changes the forces; the
front axle's side force turns compliant wheels back, which changes it too. What solves all of it is a fixed point in
(a_x, a_y, twist): plain iteration, whose factor is below mu h / L, mixed with its step before (Anderson's mixing of
depth one, in one unknown the secant method).
"""

import math
from typing import NamedTuple

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.effects import body_load, downforce, friction_step, road_grade, roll_steer, steering_compliance

LOAD_TOLERANCE = 1e-9  # [m/s^2], where the loop between load transfer and longitudinal force stops
TWIST_TOLERANCE = 1e-12  # [rad], where that between side force and steering compliance does
TWIST_WEIGHT = 1e3  # [m/s^2 per rad], what makes the two comparable
LOAD_ITERATIONS = 100
HASTY, WHOLE, KEPT = 0, 1, 2  # how `forces` solves for what is its own: by and by, at once, or no more
UNTIL = (6, 20)  # iterations from which on it is at once, and no more
SECANTS = 30  # of which the first so many extrapolate, the others go half the way


class Outside(NamedTuple):
    """What acts on a car at one moment, whatever its tyres do."""

    mu: float
    push_x: float  # forces on the body [N]
    push_y: float
    moment_z: float  # [N m]
    press_f: float  # loads that the air adds to the axles [N]
    press_r: float
    g_x: float  # gravity along the car [m/s^2]
    steady: float  # lateral acceleration of a steady turn, v_x r [m/s^2]
    delta: float  # angle of the front wheels before their side force turns them back [rad]


class Front(NamedTuple):
    """Where the front wheels point: angle [rad], its sine and cosine."""

    delta: float
    sine: float
    cosine: float


@compiled
def outside(p, delta: float, v_x: float, r: float, t: float, course: float) -> Outside:
    """What acts on the car at time t [s] and a steering command delta [rad]; `course` is that of a latent load."""
    push_x, push_y, moment_z = body_load(p, v_x, t, course)
    press_f, press_r = downforce(p, v_x)
    mu, g_x = friction_step(p, p.grip, t), road_grade(p, t)
    return Outside(mu, push_x, push_y, moment_z, press_f, press_r, g_x, v_x * r, delta + roll_steer(p, v_x * r))


@compiled
def pointing(delta: float) -> Front:
    return Front(delta, math.sin(delta), math.cos(delta))


@compiled
def extrapolated(iteration: int, off_x: float, off_y: float, turn: float, x: float, y: float, z: float) -> float:
    """Share of the step before in the next one of a fixed-point iteration, whose residuals are (off_x, off_y [m/s^2],
    turn [rad]) now and were (x, y, z) then.

    It ends where plain iteration creeps (a tall car on one axle that slips) or runs away (a very compliant steering).
    """
    if iteration == 0 or iteration >= SECANTS:
        return 0.0
    turn, z = TWIST_WEIGHT * turn, TWIST_WEIGHT * z
    size = (off_x - x) ** 2 + (off_y - y) ** 2 + (turn - z) ** 2
    share = ((off_x - x) * off_x + (off_y - y) * off_y + (turn - z) * turn) / size if size > 0.0 else 0.0
    return min(max(share, -9.0), 0.9)


@compiled
def settled(forces, p, car, a_x: float, a_y: float):
    """What `forces(p, car, front, a_x, a_y)` finds at the accelerations [m/s^2] that it causes, where the front wheels
    point then, and these accelerations.

    `forces` returns accelerations a_x, a_y, whether they are `final`, so that it would find the same forces under them,
    whether what it solves for itself is found (`even`), and the front axle's side force F_yf; a_x and a_y on entry are
    the guess from which the loop starts. Compliant wheels are solved for with the tyre's slope at the origin. NaN if
    the loop does not end.
    """
    slope = 1.0 + (1.0 - car.share_f) * steering_compliance(p, p.stiff_f * p.C_alpha_f)
    front, twist, iteration = pointing(car.outside.delta), 0.0, 0
    before_x = before_y = before_turn = led_x = led_y = led_twist = 0.0
    while True:
        p.search = HASTY if iteration < UNTIL[0] else WHOLE if iteration < UNTIL[1] else KEPT
        found = forces(p, car, front, a_x, a_y)
        missing = steering_compliance(p, found.F_yf) - twist
        off_x, off_y, turn = found.a_x - a_x, found.a_y - a_y, missing / slope
        if abs(missing) < TWIST_TOLERANCE:
            if found.final:
                return found, front, found.a_x, found.a_y
            if found.even and max(abs(off_x), abs(off_y)) < LOAD_TOLERANCE:
                return found, front, a_x, a_y
        if iteration == LOAD_ITERATIONS:
            return found, front, math.nan, a_y
        back = extrapolated(iteration, off_x, off_y, turn, before_x, before_y, before_turn)
        part = 1.0 if iteration < SECANTS else 0.5
        before_x, before_y, before_turn = off_x, off_y, turn
        a_x, led_x = a_x + part * off_x - back * (a_x + off_x - led_x), a_x + off_x
        a_y, led_y = a_y + part * off_y - back * (a_y + off_y - led_y), a_y + off_y
        twist, led_twist = twist + part * turn - back * (twist + turn - led_twist), twist + turn
        if p.steering_compliance_coefficient != 0.0:
            front = pointing(car.outside.delta - twist)
        iteration += 1
