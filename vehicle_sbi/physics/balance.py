"""The loop between loads and forces, the same for every model.

Forces of the tyres accelerate the car, accelerations move load between the wheels, and load changes the forces; the
front axle's side force turns compliant wheels back, which changes it too. Where the speed is given, it also holds the
car back, and tyres drive against it with grip that they lack across. What solves all of it is a fixed point in
(a_x, a_y, twist): plain iteration, whose factor is below mu h / L, mixed with its step before (Anderson's mixing of
depth one, in one unknown the secant method, by which the side force is found beside them).
"""

import math
from typing import NamedTuple

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.effects import body_load, downforce, friction_step, road_grade, roll_steer, steering_compliance

TORQUE, WHEEL_SPEED, SPEED = 0, 1, 2  # drive modes: what is given
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
    """Where the front wheels point, angle [rad], sine and cosine, and their side force [N] as far as it is known."""

    delta: float
    sine: float
    cosine: float
    side: float


@compiled
def outside(p, delta: float, v_x: float, r: float, t: float, course: float) -> Outside:
    """What acts on the car at time t [s] and a steering command delta [rad]; `course` is that of a latent load."""
    push_x, push_y, moment_z = body_load(p, v_x, t, course)
    press_f, press_r = downforce(p, v_x)
    mu, g_x = friction_step(p, p.grip, t), road_grade(p, t)
    return Outside(mu, push_x, push_y, moment_z, press_f, press_r, g_x, v_x * r, delta + roll_steer(p, v_x * r))


@compiled
def pointing(delta: float, side: float) -> Front:
    return Front(delta, math.sin(delta), math.cos(delta), side)


@compiled
def pulls(p, out: Outside, front: Front, a_x: float) -> tuple[float, float]:
    """Longitudinal tyre forces (front, rear) [N] that an acceleration a_x [m/s^2] implies, shared as the car drives or
    brakes: m a_x without what else acts along the car, and with what the front wheels' side force holds back."""
    total = p.mass * a_x - out.push_x + front.side * front.sine
    share = p.drive_front if total > 0.0 else min(max(p.brake_front + p.brake_balance_shift, 0.0), 1.0)
    total /= share * front.cosine + 1.0 - share
    return share * total, (1.0 - share) * total


@compiled
def secant_step(off: float, before: float, went: float) -> float:
    """A step of a secant iteration whose residual is `off` now and was `before`, a step `went` ago, no more than twice
    as far as the residual."""
    share = went / (before - off) if before != off else 1.0
    return off * (share if 0.0 < share < 2.0 else 1.0)


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
def settled(forces, p, car, a_x: float, a_y: float, r_dot: float):
    """What `forces(p, car, front, a_x, a_y)` finds at the accelerations [m/s^2] and the side force of the front wheels
    that it causes, where these point then, and the accelerations.

    `forces` returns accelerations a_x, a_y, whether they are `final`, so that it would find the same forces under them,
    whether what it solves for itself is found (`even`), and the front axle's side force F_yf; a_x, a_y and the yaw
    acceleration r_dot [rad/s^2] on entry are the guess from which the loop starts. Compliant wheels are solved for with
    the tyre's slope at the origin. NaN if the loop does not end.
    """
    slope = 1.0 + (1.0 - car.share_f) * steering_compliance(p, p.stiff_f * p.C_alpha_f)
    front, twist, iteration = pointing(car.outside.delta, (p.mass * p.l_rear * a_y + p.I_z * r_dot) / p.L), 0.0, 0
    before_x = before_y = before_turn = before_side = went_side = led_x = led_y = led_twist = 0.0
    while True:
        p.search = HASTY if iteration < UNTIL[0] else WHOLE if iteration < UNTIL[1] else KEPT
        found = forces(p, car, front, a_x, a_y)
        missing = steering_compliance(p, found.F_yf) - twist
        off_x, off_y, turn = found.a_x - a_x, found.a_y - a_y, missing / slope
        off_side = found.F_yf - front.side if car.drive == SPEED else 0.0
        if abs(missing) < TWIST_TOLERANCE and abs(off_side * front.sine) < LOAD_TOLERANCE * p.mass:
            if found.final:
                return found, front, found.a_x, found.a_y
            if found.even and max(abs(off_x), abs(off_y)) < LOAD_TOLERANCE:
                return found, front, a_x, a_y
        if iteration == LOAD_ITERATIONS:
            return found, front, math.nan, a_y
        back = extrapolated(iteration, off_x, off_y, turn, before_x, before_y, before_turn)
        part = 1.0 if iteration < SECANTS else 0.5
        went_side, before_side = secant_step(off_side, before_side, went_side), off_side
        side = front.side + went_side
        before_x, before_y, before_turn = off_x, off_y, turn
        a_x, led_x = a_x + part * off_x - back * (a_x + off_x - led_x), a_x + off_x
        a_y, led_y = a_y + part * off_y - back * (a_y + off_y - led_y), a_y + off_y
        twist, led_twist = twist + part * turn - back * (twist + turn - led_twist), twist + turn
        if car.drive == SPEED or p.steering_compliance_coefficient != 0.0:
            front = pointing(car.outside.delta - twist, side)
        iteration += 1
