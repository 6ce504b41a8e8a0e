"""The loop between loads and forces, the same for every model.

Forces of the tyres accelerate the car, accelerations move load between the wheels, and load changes the forces; the
front axle's side force turns compliant wheels back, which changes it too. Where the speed is given, it also holds the
car back, and tyres drive against it with grip that they lack across. What solves all of it is a fixed point in a_x, a_y
and the front axle's side force, found by Broyden's method (1965): steps go by the inverse of how residuals answer,
which each step corrects. That changes little from one moment to the next, so the next loop begins with it.
"""

import math
from typing import NamedTuple

from vehicle_sbi.compiled import compiled
from vehicle_sbi.physics.body_forces import body_load, downforce, road_grade
from vehicle_sbi.physics.commands import roll_steer, steering_compliance
from vehicle_sbi.physics.tyre_effects import friction_step

TORQUE, WHEEL_SPEED, SPEED = 0, 1, 2  # drive modes: what is given
LOAD_TOLERANCE = 1e-9  # [m/s^2], where the loop between load transfer and longitudinal force stops
TWIST_TOLERANCE = 1e-12  # [rad], where that between side force and steering compliance does
LOAD_ITERATIONS = 100
HASTY, WHOLE, KEPT = 0, 1, 2  # how `forces` solves for what is its own: by and by, at once, or no more
UNTIL = (6, 20)  # iterations from which on it is at once, and no more
LEARNING = 30  # iterations that go by the inverse; later ones go half the way of plain iteration
LEAST_ANSWER = 0.1  # of a step, by which its residuals fall at least to what is learned of them


class Unknowns(NamedTuple):
    """The unknowns of the loop, or their residuals [m/s^2]: accelerations along and across the car, and the side force
    of the front axle over the mass."""

    x: float
    y: float
    side: float


class Inverse(NamedTuple):
    """How far each unknown goes on for each residual."""

    x: Unknowns
    y: Unknowns
    side: Unknowns


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
def dot(a: Unknowns, b: Unknowns) -> float:
    return a.x * b.x + a.y * b.y + a.side * b.side


@compiled
def plus(a: Unknowns, share: float, b: Unknowns) -> Unknowns:
    """a and a share of b."""
    return Unknowns(a.x + share * b.x, a.y + share * b.y, a.side + share * b.side)


@compiled
def times(inverse: Inverse, off: Unknowns) -> Unknowns:
    return Unknowns(dot(inverse.x, off), dot(inverse.y, off), dot(inverse.side, off))


@compiled
def corrected(inverse: Inverse, step: Unknowns, fell: Unknowns) -> Inverse:
    """The inverse that also holds for a step by which residuals `fell`, as far as they fell by LEAST_ANSWER of it.

    The least change that does so; what keeps it regular where they hardly fall is Powell's (1970).
    """
    said, size = times(inverse, fell), dot(step, step)
    if size == 0.0:
        return inverse
    along = dot(step, said) / size
    part = 1.0 if along >= LEAST_ANSWER else (1.0 - LEAST_ANSWER) / (1.0 - along)
    change = plus(step, -1.0, said)
    row = plus(plus(plus(Unknowns(0.0, 0.0, 0.0), step.x, inverse.x), step.y, inverse.y), step.side, inverse.side)
    share = part / (size * (1.0 - part * (1.0 - along)))
    return Inverse(
        plus(inverse.x, share * change.x, row),
        plus(inverse.y, share * change.y, row),
        plus(inverse.side, share * change.side, row),
    )


@compiled
def plain() -> Inverse:
    """Plain iteration: each unknown goes on by its residual."""
    return Inverse(Unknowns(1.0, 0.0, 0.0), Unknowns(0.0, 1.0, 0.0), Unknowns(0.0, 0.0, 1.0))


@compiled
def kept(p) -> Inverse:
    """What the last loop has learned, plain iteration where there was none."""
    return Inverse(
        Unknowns(1.0 + p.inverse_xx, p.inverse_xy, p.inverse_xs),
        Unknowns(p.inverse_yx, 1.0 + p.inverse_yy, p.inverse_ys),
        Unknowns(p.inverse_sx, p.inverse_sy, 1.0 + p.inverse_ss),
    )


@compiled
def keep(p, inverse: Inverse) -> None:
    """For the next loop."""
    p.inverse_xx, p.inverse_xy, p.inverse_xs = inverse.x.x - 1.0, inverse.x.y, inverse.x.side
    p.inverse_yx, p.inverse_yy, p.inverse_ys = inverse.y.x, inverse.y.y - 1.0, inverse.y.side
    p.inverse_sx, p.inverse_sy, p.inverse_ss = inverse.side.x, inverse.side.y, inverse.side.side - 1.0


@compiled
def forget(p) -> None:
    """What loops have kept, where a window begins."""
    p.split_f = p.split_r = p.slope_f = p.slope_r = p.side_f = 0.0
    keep(p, plain())


@compiled
def settled(forces, p, car, a_x: float, a_y: float):
    """What `forces(p, car, front, a_x, a_y)` finds at the accelerations [m/s^2] and the side force of the front wheels
    that it causes, where these point then, and the accelerations.

    `forces` returns accelerations a_x, a_y, whether they are `final`, so that it would find the same forces under them,
    whether what it solves for itself is found (`even`), and the front axle's side force F_yf; the loop starts from a_x,
    a_y and the side force that it found last. NaN if it does not end.
    """
    by_side = car.drive == SPEED or p.steering_compliance_coefficient != 0.0
    at, inverse = Unknowns(a_x, a_y, p.side_f / p.mass), plain()
    front = pointing(car.outside.delta, 0.0)
    step, before, iteration = Unknowns(0.0, 0.0, 0.0), Unknowns(0.0, 0.0, 0.0), 0
    while True:
        if by_side:
            side = p.mass * at.side
            front = pointing(car.outside.delta - steering_compliance(p, side), side)
        p.search = HASTY if iteration < UNTIL[0] else WHOLE if iteration < UNTIL[1] else KEPT
        found = forces(p, car, front, at.x, at.y)
        missing = found.F_yf - front.side if by_side else 0.0
        off = Unknowns(found.a_x - at.x, found.a_y - at.y, missing / p.mass)
        held = abs(off.side * front.sine) if car.drive == SPEED else 0.0
        if abs(steering_compliance(p, missing)) < TWIST_TOLERANCE and held < LOAD_TOLERANCE:
            p.side_f = front.side
            if found.final:
                return found, front, found.a_x, found.a_y
            if found.even and max(abs(off.x), abs(off.y)) < LOAD_TOLERANCE:
                if iteration > 0:
                    keep(p, inverse)
                return found, front, at.x, at.y
        if iteration == LOAD_ITERATIONS or not math.isfinite(off.x + off.y + off.side):
            return found, front, math.nan, at.y
        if iteration == 0:
            inverse = kept(p)
        elif iteration == UNTIL[0]:
            inverse = plain()
        else:
            inverse = corrected(inverse, step, plus(before, -1.0, off))
        step = times(inverse, off) if iteration < LEARNING else plus(Unknowns(0.0, 0.0, 0.0), 0.5, off)
        at, before = plus(at, 1.0, step), off
        iteration += 1
