"""How wheels follow the road, the fastest that a car does, as a step of the integrator takes it: exactly.

How far a wheel turns faster than it rolls, w = omega - v/R, and the lagged slip kappa^ of its tyre settle within
milliseconds, far sooner than a car turns:

    d/dt (w, kappa^) = A (w, kappa^) + what is left,    A = [[-(1 - s) d - b, -s d v/R], [c R/v, -c]]
    d = R^2 C_kappa / (I_w v),   c the rate of the lag,   s the share of the slip that lags,
    b = 2 |T| (1 - |omega|) / I_w where a brake's torque fades (omega below 1 rad/s), else 0

The exponential Runge-Kutta method of Cox and Matthews (Journal of Computational Physics 176, 2002, eqs. 26 to 29)
solves the linear part by functions phi_k of h A, and the rest as the classical method does, which it is for A = 0. It
is of fourth order whatever A is; where A is near the truth, or stiffer, a step is stable however fast the wheel. So a
tyre that slides may be taken for one that does not, and A is renewed only as the speed changes.

phi_0 = exp, phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z. Of a 2 x 2 matrix Z each is a + b Z (Cayley and Hamilton), found
from its series near 0, and from there by doubling Z.
"""

import math
from typing import NamedTuple

import numpy as np

from vehicle_sbi.compiled import compiled, compiled_apart
from vehicle_sbi.physics.single_track import T_F, T_R, V_X, regular, rolling_radii, torque_slope
from vehicle_sbi.physics.tyre_effects import lag_rate, lag_share

AXLES = 2
HALF, BACK, FIRST, MIDDLE, LAST = range(5)  # weights of rates within a step, and in its sum
NEAR = 0.5  # size of Z up to which series are taken
OTHER_SPEED = 0.05  # share by which the speed may change before A is taken anew
MOST_DOUBLINGS = 60
TERMS = 10  # of that of phi_3, which leave 0.5^10 3!/13! = 1e-12 of it


class Linear(NamedTuple):
    """A function a + b Z of a 2 x 2 matrix Z."""

    a: float
    b: float


class Phi(NamedTuple):
    """phi_0 to phi_3 of Z."""

    exp: Linear
    one: Linear
    two: Linear
    three: Linear


@compiled
def plus(x: Linear, factor: float, y: Linear) -> Linear:
    """x + factor y."""
    return Linear(x.a + factor * y.a, x.b + factor * y.b)


@compiled
def times(x: Linear, y: Linear, trace: float, det: float) -> Linear:
    """x y, where Z^2 = trace Z - det."""
    return Linear(x.a * y.a - x.b * y.b * det, x.a * y.b + x.b * y.a + x.b * y.b * trace)


@compiled
def near_zero(trace: float, det: float) -> Phi:
    """Of a small Z, from the series of phi_3."""
    unity, Z = Linear(1.0, 0.0), Linear(0.0, 1.0)
    coefficient = 1.0 / math.gamma(TERMS + 3.0)
    three = Linear(coefficient, 0.0)
    for j in range(TERMS - 2, -1, -1):
        coefficient *= j + 4.0
        three = plus(times(three, Z, trace, det), coefficient, unity)
    two = plus(times(three, Z, trace, det), 0.5, unity)
    one = plus(times(two, Z, trace, det), 1.0, unity)
    return Phi(plus(times(one, Z, trace, det), 1.0, unity), one, two, three)


@compiled
def twice(x: Linear, factor: float) -> Linear:
    """factor x, as a function of 2 Z."""
    return Linear(factor * x.a, 0.5 * factor * x.b)


@compiled
def doubled(phi: Phi, trace: float, det: float) -> Phi:
    """Of 2 Z, from phi of Z: 4 phi_2(2 z) = phi_1^2 + 2 phi_2 and 8 phi_3(2 z) = (phi_1 + 1) phi_2 + 2 phi_3."""
    exp = times(phi.exp, phi.exp, trace, det)
    one = plus(times(phi.exp, phi.one, trace, det), 1.0, phi.one)
    two = plus(times(phi.one, phi.one, trace, det), 2.0, phi.two)
    three = plus(plus(times(phi.one, phi.two, trace, det), 1.0, phi.two), 2.0, phi.three)
    return Phi(twice(exp, 1.0), twice(one, 0.5), twice(two, 0.25), twice(three, 0.125))


@compiled
def weigh(f: Linear, h: float, A, out) -> None:
    """Fill out (2, 2) with h f(h A)."""
    slope = h * h * f.b
    out[0, 0], out[0, 1] = h * f.a + slope * A[0, 0], slope * A[0, 1]
    out[1, 0], out[1, 1] = slope * A[1, 0], h * f.a + slope * A[1, 1]


@compiled
def combined(phi: Phi, one: float, two: float, three: float) -> Linear:
    """one phi_1 + two phi_2 + three phi_3."""
    return plus(plus(Linear(one * phi.one.a, one * phi.one.b), two, phi.two), three, phi.three)


@compiled
def fill_weights(A, h: float, weights) -> None:
    """Fill weights (5, 2, 2) [s, of states in A's units] of a step of h [s] with the linear part A (2, 2)."""
    trace, det = h * (A[0, 0] + A[1, 1]), h * h * (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
    doublings = min(max(math.frexp((abs(trace) + math.sqrt(abs(det))) / NEAR)[1], 1), MOST_DOUBLINGS)
    trace, det = math.ldexp(trace, -doublings), math.ldexp(det, -2 * doublings)
    half = near_zero(trace, det)
    for _ in range(doublings - 1):
        half, trace, det = doubled(half, trace, det), 2.0 * trace, 4.0 * det
    whole = doubled(half, trace, det)
    back = plus(times(half.exp, half.one, trace, det), -1.0, half.one)
    weigh(twice(half.one, 0.5), h, A, weights[HALF])
    weigh(twice(back, 0.5), h, A, weights[BACK])
    weigh(combined(whole, 1.0, -3.0, 4.0), h, A, weights[FIRST])
    weigh(combined(whole, 0.0, 2.0, -4.0), h, A, weights[MIDDLE])
    weigh(combined(whole, 0.0, -1.0, 4.0), h, A, weights[LAST])


class Slipping(NamedTuple):
    """The wheels of a car in a step: front axle, then rear axle; pairs of w [rad/s] and kappa^."""

    taken_at: np.ndarray  # speed [m/s] of which A is, and the slopes b [1/s] in it, (3,)
    R: np.ndarray  # effective radii [m], (axles,)
    A: np.ndarray  # (axles, 2, 2)
    weights: np.ndarray  # (axles, 5, 2, 2)
    begun: np.ndarray  # what is left at the step's first stage, (wheels, 2)
    moved: np.ndarray  # from the step's beginning to its next stage, (wheels, 2)
    arrived: np.ndarray  # and to its end, (wheels, 2)


@compiled
def slipping_wheels(wheels: int) -> Slipping:
    """Of a car with so many wheels, before its first step."""
    return Slipping(
        np.zeros(1 + AXLES), np.ones(AXLES), np.zeros((AXLES, 2, 2)), np.zeros((AXLES, 5, 2, 2)),
        np.zeros((wheels, 2)), np.zeros((wheels, 2)), np.zeros((wheels, 2)),
    )  # fmt: skip


@compiled_apart
def linear_part(p, front: bool, R: float, v: float, b: float, A) -> None:
    """Fill A (2, 2) [1/s, rad/s, 1/s] of an axle whose wheels roll on a radius R [m] at v [m/s]."""
    if front:
        C_kappa, inertia, sigma = p.stiff_f * p.C_kappa_f, p.I_wf, p.sigma_f
    else:
        C_kappa, inertia, sigma = p.stiff_r * p.C_kappa_r, p.I_wr, p.sigma_r
    d, c, s = R * R * C_kappa / (inertia * v), lag_rate(p, sigma, v), lag_share(p, sigma, v)
    A[0, 0], A[0, 1] = -(1.0 - s) * d - b, -s * d * v / R
    A[1, 0], A[1, 1] = c * R / v, -c


@compiled
def held(model, axle: int, torque: float, state) -> float:
    """Slope [N m s] of an axle's torque [N m] over the speed of its slowest wheel."""
    first, beyond = model.OMEGA + axle * model.WHEELS // AXLES, model.OMEGA + (axle + 1) * model.WHEELS // AXLES
    slowest = state[first]
    for w in range(first + 1, beyond):
        slowest = min(slowest, state[w])
    return torque_slope(torque, slowest)


@compiled
def linearise_wheels(model, p, u, state, h: float, wheels: Slipping) -> None:
    """Take the linear part at a state for steps of h [s], unless that of before is near enough."""
    v, taken_at = regular(state[V_X]), wheels.taken_at
    b_f, b_r = held(model, 0, u[T_F], state) / p.I_wf, held(model, 1, u[T_R], state) / p.I_wr
    if abs(v - taken_at[0]) > OTHER_SPEED * taken_at[0] or b_f != taken_at[1] or b_r != taken_at[2]:
        taken_at[0], taken_at[1], taken_at[2] = v, b_f, b_r
        take(p, h, wheels)


@compiled_apart
def take(p, h: float, wheels: Slipping) -> None:
    """Fill radii, linear part and weights at the speed and slopes that stand in `wheels`."""
    wheels.R[0], wheels.R[1] = rolling_radii(p)
    for axle in range(AXLES):
        linear_part(p, axle == 0, wheels.R[axle], wheels.taken_at[0], wheels.taken_at[1 + axle], wheels.A[axle])
        fill_weights(wheels.A[axle], h, wheels.weights[axle])


@compiled
def set_wheels(model, p, wheels: Slipping, moved, state, out) -> None:
    """Fill the wheels of the state `out`, whose car stands already, so far from those of `state`."""
    for w in range(model.WHEELS):
        spin, slip = model.OMEGA + w, model.KAPPA + w
        faster = (model.ground(p, out, w) - model.ground(p, state, w)) / wheels.R[AXLES * w // model.WHEELS]
        out[spin], out[slip] = state[spin] + moved[w, 0] + faster, state[slip] + moved[w, 1]


@compiled
def weighted(weights, axle: int, which: int, x: float, y: float) -> tuple[float, float]:
    """One of an axle's weights times (x, y)."""
    return (
        weights[axle, which, 0, 0] * x + weights[axle, which, 0, 1] * y,
        weights[axle, which, 1, 0] * x + weights[axle, which, 1, 1] * y,
    )


@compiled
def roll_wheels(model, p, wheels: Slipping, stage: int, rate) -> None:
    """Go on from a stage of the step, whose d(state)/dt is `rate`."""
    A, weights, begun, moved, arrived = wheels.A, wheels.weights, wheels.begun, wheels.moved, wheels.arrived
    for w in range(model.WHEELS):
        axle = AXLES * w // model.WHEELS
        x, y = rate[model.OMEGA + w] - model.ground(p, rate, w) / wheels.R[axle], rate[model.KAPPA + w]
        if stage == 0:
            arrived[w, 0] = arrived[w, 1] = 0.0
            begun[w, 0], begun[w, 1] = x, y
        else:
            x -= A[axle, 0, 0] * moved[w, 0] + A[axle, 0, 1] * moved[w, 1]
            y -= A[axle, 1, 0] * moved[w, 0] + A[axle, 1, 1] * moved[w, 1]
        spun, slipped = weighted(weights, axle, HALF, x, y)
        if stage == 2:
            back = weighted(weights, axle, BACK, begun[w, 0], begun[w, 1])
            spun, slipped = 2.0 * spun + back[0], 2.0 * slipped + back[1]
        moved[w, 0], moved[w, 1] = spun, slipped
        spun, slipped = weighted(weights, axle, FIRST if stage == 0 else LAST if stage == 3 else MIDDLE, x, y)
        arrived[w, 0] += spun
        arrived[w, 1] += slipped
