"""The single-track model a second time, by another route: an oracle for the compiled one.

Plain Python from the paper's equations 1 to 11, a free-body diagram and the catalogue's equations of the effects, no
code shared with the package. What differs on purpose: Dugoff's lambda is formed as printed, the loops between load
transfer and longitudinal force and between side force and steering compliance are roots that brentq brackets, and
scipy's adaptive DOP853 integrates from sample to sample.

    pitch balance about the centre of gravity:  F_zf l_f - F_zr l_r + h (F_xf cos d - F_yf sin d + F_xr) = 0
    weight across the road:                     F_zf + F_zr = m g cos(grade) cos(bank)

with downforce on top of both. Holds for v_x > 1 m/s and omega > 1 rad/s, where nothing is regularised, and for wheels
that do not lock.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, newton

G = 9.81
RHO = 1.225

Car = Mapping[str, float]


class Moment(NamedTuple):
    """What of the surroundings changes with time."""

    g_x: float  # gravity along the body [m/s^2]
    mu: float
    gust: float  # [N]
    course: float = 0.0  # of the load that no effect stands for


class Forces(NamedTuple):
    """Tyre forces [N] of the axles in the wheels' own axes, the yaw moment [N m] of right less left, and how far the
    mean slip of each axle's wheels is beyond that of their mean speed."""

    x_f: float
    y_f: float
    x_r: float
    y_r: float
    turn: float
    beyond: tuple[float, float]


def car_of(record: np.void) -> dict[str, float]:
    """The constants and effect parameters of a record as floats; what the package derives from them is left out."""
    names = record.dtype.names
    assert names is not None
    return {name: float(record[name]) for name in names[: names.index("mass")]}


def root(function, low: float, high: float) -> float:
    """The root between two bounds, to 1e-13."""
    return float(brentq(function, low, high, xtol=1e-13, rtol=1e-15))  # pyright: ignore[reportArgumentType]


# --- the car and what acts on it ------------------------------------------------------------------------------------


def mass(c: Car) -> float:
    """Car and payload [kg]."""
    return c["m"] + c["payload_mass"]


def axles(c: Car) -> tuple[float, float]:
    """Distances [m] of the common centre of gravity from the front and the rear axle: moments of mass about them."""
    behind_front = c["m"] * c["l_f"] + c["payload_mass"] * (c["l_f"] - c["payload_x"])
    l_f = behind_front / mass(c)
    return l_f, c["L"] - l_f


def yaw_inertia(c: Car) -> float:
    """m l_f l_r of the empty car times a factor, and both masses moved to the common centre of gravity [kg m^2]."""
    own = c["yaw_inertia_factor"] * c["m"] * c["l_f"] * (c["L"] - c["l_f"])
    ahead = c["l_f"] - axles(c)[0]  # of the empty car's centre of gravity
    return own + c["m"] * ahead**2 + c["payload_mass"] * (c["payload_x"] - ahead) ** 2


def blows(c: Car, effect: str, t: float) -> float:
    """Share of an effect that lasts from start on for duration: cubics 3 s^2 - 2 s^3 of 0.1 s begin and end it."""
    if c[f"{effect}_duration"] == 0.0:
        return 0.0
    since = np.array([t - c[f"{effect}_start"], t - c[f"{effect}_start"] - c[f"{effect}_duration"]])
    s = np.clip(since / 0.1, 0.0, 1.0)
    begun, ended = 3.0 * s**2 - 2.0 * s**3
    return float(begun - ended)


def gravity_along(c: Car, t: float) -> float:
    """g sin(grade) [m/s^2], the profile's grade on top of the constant one."""
    knots = [c[f"road_grade_profile_angle_{i}"] for i in range(12)]
    profile = np.interp(t, np.linspace(0.0, c["duration"], 12), knots)
    return G * math.sin(c["road_grade_angle"] + float(profile))


def at(c: Car, t: float, course: float = 0.0) -> Moment:
    """The surroundings at time t [s], where a latent load's course has this value."""
    mu = c["mu"] * c["friction_level_factor"]
    mu += mu * (c["friction_step_factor"] - 1.0) * blows(c, "friction_step", t)
    return Moment(gravity_along(c, t), mu, c["gust_force"] * blows(c, "gust", t), course)


def weight(c: Car) -> float:
    """What presses the car on a road with a constant grade and bank [N]."""
    return mass(c) * G * math.cos(c["road_grade_angle"]) * math.cos(c["road_bank_angle"])


def downforce(c: Car, v_x: float) -> float:
    """Half rho A v^2 [N]."""
    return RHO / 2.0 * c["downforce_area"] * v_x**2


def axle_loads(c: Car, now: Moment, a_x: float, state: np.ndarray) -> tuple[float, float]:
    """F_zf, F_zr [N] from the two balances above; every force but gravity and downforce acts at the ground. What goes
    through springs and dampers between the axles is theirs at the time."""
    N, pressed = weight(c), downforce(c, state[0])
    stiffness, damping = pitching_body(c)
    borne = state[13] + damping / stiffness * state[14]
    felt = (1.0 - c["load_sensitivity_sprung"]) * (a_x + now.g_x) + c["load_sensitivity_sprung"] * borne
    tipping = c["h_cog"] * mass(c) * felt
    F_zf = (N * axles(c)[1] - tipping) / c["L"]
    return F_zf + c["downforce_front_share"] * pressed, N - F_zf + (1.0 - c["downforce_front_share"]) * pressed


def outer_forces(c: Car, now: Moment, v_x: float) -> tuple[float, float, float]:
    """Drag, rolling resistance, gravity along the body and wind [N], and moments of wind and whatever else [N m]."""
    x = -0.5 * RHO * c["aero_drag_area"] * v_x**2
    x -= c["rolling_resistance_coefficient"] * (weight(c) + downforce(c, v_x))
    x += c["latent_x"] * now.course - mass(c) * now.g_x
    y = c["crosswind_force"] + now.gust - mass(c) * downhill(c)
    turn = c["crosswind_force"] * c["crosswind_arm"] + now.gust * c["gust_arm"] + c["yaw_moment_moment"]
    return x, y + c["latent_y"] * now.course, turn + c["latent_z"] * now.course


# --- tyres ----------------------------------------------------------------------------------------------------------


def dugoff(C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, alpha: float) -> tuple[float, float]:
    """Equations 8 to 10 as printed, for kappa > -1."""
    S = math.hypot(C_kappa * kappa, C_alpha * math.tan(alpha))
    lam = math.inf if S == 0.0 else mu * max(F_z, 0.0) * (1.0 + kappa) / (2.0 * S)
    f = lam * (2.0 - lam) if lam < 1.0 else 1.0
    return C_kappa * kappa / (1.0 + kappa) * f, C_alpha * math.tan(alpha) / (1.0 + kappa) * f


def tyre(
    c: Car, C: tuple[float, float], mu: float, F_z: float, static: float, slips: tuple[float, float], a_y: float
) -> tuple[float, float]:
    """F_x, F_y [N] of a tyre or axle of stiffnesses C (kappa, alpha) with the tyre effects; slips (kappa, alpha)."""
    stiffer = max(1.0 + c["load_sensitivity_coefficient"] * (F_z - static) / static, 0.05)
    C_kappa = C[0] * stiffer
    C_alpha = C[1] * stiffer * max(1.0 - c["lateral_load_transfer_coefficient"] * a_y**2, 0.05)
    F_x, _ = bent(c, C_kappa, C_alpha, mu, F_z, *slips)
    _, F_y = bent(c, c["combined_slip_weight"] * C_kappa, C_alpha, mu, F_z, *slips)
    return F_x, F_y


def bent(
    c: Car, C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, alpha: float
) -> tuple[float, float]:
    """F_x, F_y [N] of Dugoff's tyre with another curve."""
    forces, grip = dugoff(C_kappa, C_alpha, mu, F_z, kappa, alpha), mu * max(F_z, 0.0)
    demands, peaks = (C_kappa * kappa, C_alpha * math.tan(alpha)), (c["tyre_curve_longitudinal"], c["tyre_curve_peak"])
    size = math.hypot(*demands)
    if size == 0.0 or grip == 0.0:
        return forces
    z, full, early = size / grip, c["tyre_curve_fullness"], c["tyre_curve_early"]
    peaked, filled = math.sin(1.5 * math.atan(z / 1.5)) * grip / size, full_curve(z) * grip / size
    hyperbola = math.sin(math.atan(z)) * grip / size
    F_x, F_y = (
        F + peak * (peaked * demand - F) + full * (filled * demand - F) + early * (hyperbola * demand - F)
        for F, demand, peak in zip(forces, demands, peaks, strict=True)
    )
    return F_x, F_y


def full_curve(z: float) -> float:
    """Force over grip of the magic formula with C = 3/2 and E = -17/8."""
    w = z / 1.5
    return math.sin(1.5 * math.atan(w + 2.125 * (w - math.atan(w))))


def pulled_tyre(
    c: Car, C_alpha: float, mu: float, F_z: float, static: float, F_x: float, alpha: float, a_y: float
) -> tuple[float, float]:
    """F_x, F_y [N] where the longitudinal force is given: the demand X with X f(X, D) = F_x, small slip."""
    stiffer = max(1.0 + c["load_sensitivity_coefficient"] * (F_z - static) / static, 0.05)
    D = C_alpha * stiffer * max(1.0 - c["lateral_load_transfer_coefficient"] * a_y**2, 0.05) * math.tan(alpha)
    grip = mu * max(F_z, 0.0)
    F_x = float(np.clip(F_x, -0.99 * grip, 0.99 * grip))

    def share(X: float) -> float:
        S = math.hypot(X, D)
        return 1.0 if grip / 2.0 >= S else grip / S - (grip / S) ** 2 / 4.0

    X = abs(F_x)
    if X > 0.0 and share(X) < 1.0:
        X = root(lambda x: x * share(x) - abs(F_x), 0.0, 1e3 * (grip + abs(D)))
    X *= c["combined_slip_weight"]
    F_y, S = D * share(X), math.hypot(X, D)
    if S > 0.0 and grip > 0.0:
        across, z = grip / S * D, S / grip
        peaked, full = math.sin(1.5 * math.atan(z / 1.5)) * across - F_y, full_curve(z) * across - F_y
        early = math.sin(math.atan(z)) * across - F_y
        F_y += c["tyre_curve_peak"] * peaked + c["tyre_curve_fullness"] * full + c["tyre_curve_early"] * early
    return F_x, F_y


def implied_pulls(
    c: Car, now: Moment, v_x: float, delta: float, a_x: float, side: Callable[[float], float]
) -> tuple[float, float]:
    """Longitudinal forces of the axles [N] in their wheels' directions that an acceleration implies, with the front
    one's side force [N], a function of its longitudinal one."""

    def implied(front: float) -> tuple[float, float]:
        total = mass(c) * a_x + side(front) * math.sin(delta) - outer_forces(c, now, v_x)[0]
        share = c["drive_front"] if total > 0.0 else np.clip(c["brake_front"] + c["brake_balance_shift"], 0.0, 1.0)
        total /= share * math.cos(delta) + 1.0 - share
        return float(share * total), float((1.0 - share) * total)

    most = 1e3 * G * mass(c)
    return implied(root(lambda front: implied(front)[0] - front, -most, most))


def effective_radius(c: Car, F_z: float, axle: str) -> float:
    """Equation 6 with R_l = R_f - F_z,tyre / C_vert; axle is front or rear."""
    free = c[f"wheel_radius_{axle}"] * c["R_f"]
    return 2.0 / 3.0 * free + (free - F_z / 2.0 / c["C_vert"]) / 3.0


def relaxation_lengths(c: Car) -> tuple[float, float]:
    """Equation 11's sigma [m] of both axles, and what is added to it."""
    stiff_f, stiff_r = levels(c, "stiffness_level")
    sigma_f, sigma_r = stiff_f * c["C_alpha_f"] / c["K"], stiff_r * c["C_alpha_r"] / c["K"]
    return sigma_f + c["relaxation_front"], sigma_r + c["relaxation_rear"]


def levels(c: Car, effect: str) -> tuple[float, float]:
    """Factors of an effect on both axles."""
    return c[f"{effect}_factor"] * c[f"{effect}_front"], c[f"{effect}_factor"] * c[f"{effect}_rear"]


# --- equations of motion --------------------------------------------------------------------------------------------


def slip_angles(c: Car, state: np.ndarray, delta: float) -> list[tuple[float, float]]:
    """Equations 3 and 5 [rad] for the right and the left wheel of each axle, which move at v_x +- r track/2."""
    (v_x, v_y, r), half = state[:3], c["lateral_load_transfer_track"] / 2.0
    places = (delta, axles(c)[0]), (0.0, -axles(c)[1])
    right, left = ([turned - math.atan2(v_y + x * r, v_x + r * y) for turned, x in places] for y in (half, -half))
    return [*zip(right, left, strict=True)]


def wheel_plane_speed(c: Car, state: np.ndarray, delta: float) -> float:
    """Speed [m/s] of the front contact point in the wheel's own plane."""
    return state[0] * math.cos(delta) + (state[1] + axles(c)[0] * state[2]) * math.sin(delta)


def slips(c: Car, state: np.ndarray, delta: float, loads: tuple[float, float]) -> tuple[float, float]:
    """Equation 4 for both axles."""
    V_f, V_r = wheel_plane_speed(c, state, delta), state[0]
    rolling_f = effective_radius(c, loads[0], "front") * state[3]
    rolling_r = effective_radius(c, loads[1], "rear") * state[4]
    return (rolling_f - V_f) / max(rolling_f, V_f), (rolling_r - V_r) / max(rolling_r, V_r)


def tyre_forces(c: Car, now: Moment, drive: str, state: np.ndarray, delta: float, a: tuple[float, float]) -> Forces:
    """The forces if the front wheels stand at delta and the car accelerates with a (x, y)."""
    a_x, a_y = a
    loads = axle_loads(c, now, a_x, state)
    kappas = (0.0, 0.0) if drive == "speed" else slips(c, state, delta, loads)
    lagging = [sigma > 0.0 for sigma in relaxation_lengths(c)]
    lagged, alphas = np.reshape(state[7:11], (2, 2)).T, slip_angles(c, state, delta)
    alphas = [lagged[i].tolist() if lags else alphas[i] for i, lags in enumerate(lagging)]
    (l_f, l_r), N = axles(c), weight(c)
    statics, stiff, slide = (N * l_r / c["L"], N * l_f / c["L"]), levels(c, "stiffness_level"), friction(c)
    shifted = N * c["lateral_load_transfer_front"]
    borne = max(statics[0] + shifted, 0.0), max(statics[1] - shifted, 0.0)
    found, turn, beyond = [], 0.0, [0.0, 0.0]
    moving = moved_by(c, state, a_y + downhill(c))

    def pulled_pair(i: int, pull: float) -> list[tuple[float, float]]:
        C_alpha, wheels = stiff[i] * c[f"C_alpha_{'fr'[i]}"], wheel_loads(c, loads[i], borne[i], moving)
        return [
            pulled_tyre(c, C_alpha / 2.0, now.mu * slide[i], load, statics[i] / 2.0, pull / 2.0, alpha, moving)
            for load, alpha in zip(wheels, alphas[i], strict=True)
        ]

    def side(pull: float) -> float:
        return sum(F_y for _, F_y in pulled_pair(0, pull))

    pulls = implied_pulls(c, now, state[0], delta, a_x, side) if drive == "speed" else (0.0, 0.0)
    for i, axle in enumerate("fr"):
        C, mu = (stiff[i] * c[f"C_kappa_{axle}"], stiff[i] * c[f"C_alpha_{axle}"]), now.mu * slide[i]
        wheels, half, static = wheel_loads(c, loads[i], borne[i], moving), (C[0] / 2.0, C[1] / 2.0), statics[i] / 2.0
        if drive == "speed":
            pair = pulled_pair(i, pulls[i])
        else:
            nu = c["lateral_load_transfer_track"] / 2.0 * state[2] / state[0]
            rho = (wheels[0] - wheels[1]) / 2.0 / (3.0 * c["C_vert"] * c["R_f"])
            lags = float(state[5 + i]) if lagging[i] else None
            slipping = kappas[i], lags, alphas[i][0], alphas[i][1]
            pair, unequal = driven_pair(c, half, mu, wheels, static, slipping, (nu, rho), moving)
            beyond[i] = (nu + rho) * (unequal - rho)
        found += np.sum(pair, axis=0).tolist()
        turned = delta if axle == "f" else 0.0
        along = [x * math.cos(turned) - y * math.sin(turned) for x, y in pair]
        turn += c["lateral_load_transfer_track"] / 2.0 * (along[0] - along[1])
    return Forces(*found, turn=turn, beyond=(beyond[0], beyond[1]))


def downhill(c: Car) -> float:
    """Gravity along a banked road [m/s^2], which the body feels as it does a turn."""
    return G * math.sin(c["road_bank_angle"])


def leaning_body(c: Car) -> tuple[float, float]:
    """Of y'' + 2 damping w y' + w^2 y = w^2 (a_y + g_y) stiffness w^2 and damping, 0 where load moves at once."""
    moves = c["lateral_load_transfer_uneven"] != 0.0 or c["lateral_load_transfer_coefficient"] != 0.0
    if c["lateral_load_transfer_period"] == 0.0 or not moves:
        return 0.0, 0.0
    w = 2.0 * math.pi / c["lateral_load_transfer_period"]
    return w**2, 2.0 * c["lateral_load_transfer_damping"] * w


def pitching_body(c: Car) -> tuple[float, float]:
    """The same of y'' + 2 damping w y' + w^2 y = w^2 (a_x + g_x)."""
    w = 2.0 * math.pi / c["load_sensitivity_period"]
    return w**2, 2.0 * c["load_sensitivity_damping"] * w


def moved_by(c: Car, state: np.ndarray, a_y: float) -> float:
    """The lateral acceleration [m/s^2] that load has followed: three quarters of it go through springs and dampers."""
    stiffness, damping = leaning_body(c)
    if stiffness == 0.0:
        return a_y
    return 0.25 * a_y + 0.75 * float(state[11] + damping / stiffness * state[12])


def wheel_loads(c: Car, F_z: float, borne: float, a_y: float) -> tuple[float, float]:
    """Loads [N] of an axle's right and left wheel: a turn moves a share of what the axle bears of the car's weight
    from the inner one to the outer one, and no more than all that the inner one has."""
    moved = min((c["lateral_load_transfer_uneven"] * a_y**2) ** 0.5 * borne, max(F_z, 0.0)) * np.sign(a_y)
    return (F_z + moved) / 2.0, (F_z - moved) / 2.0


def driven_pair(
    c: Car, C: tuple[float, float], mu: float, wheels: tuple[float, float], static: float,
    slips: tuple[float, float | None, float, float], differ: tuple[float, float], moving: float,
) -> tuple[list[tuple[float, float]], float]:  # fmt: skip
    """Forces of both wheels of an axle with the same torque, and k d, at slips k (1 - d) and k (1 + d), d as small as
    may be, or as near as one wheel's slip can bring them; k is the lagged slip, or that of `mean_slip` where none lags,
    and slips are kappa, the lagged one, alpha_right, alpha_left."""
    kappa, lagged, *alphas = slips

    def mean(d: float) -> float:
        return mean_slip(kappa, *differ, d) if lagged is None else lagged

    def pair(d: float) -> list[tuple[float, float]]:
        each, k = zip(wheels, (1.0 - d, 1.0 + d), alphas, strict=True), mean(d)
        return [tyre(c, C, mu, load, static, (part * k, alpha), moving) for load, part, alpha in each]

    def apart(d: float) -> float:
        right, left = pair(d)
        return (right[0] * (1.0 - differ[1]) - left[0] * (1.0 + differ[1])) * np.sign(mean(0.0))

    def split() -> float:
        if mean(0.0) == 0.0 or (wheels[0] == wheels[1] and alphas[0] == alphas[1]):
            return 0.0
        sign, near = np.sign(apart(0.0)), 0.0
        for far in (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 0.98):
            if sign * apart(sign * far) <= 0.0:
                return root(apart, sign * near, sign * far)
            near = far
        return sign * 0.98

    d = split()
    return pair(d), d * mean(d)


def mean_slip(kappa: float, nu: float, rho: float, d: float) -> float:
    """Mean slip k of wheels that slip by k (1 -+ d), move at (1 +- nu) of their axle's speed and roll on (1 -+ rho) of
    its radius, where the mean of their speeds says kappa; to second order in nu, rho and k d."""
    return (kappa - (nu + rho) * rho) / (1.0 - (nu + rho) * d)


def turning_wheels(c: Car) -> float:
    """I_w (track / 2 R)^2 [kg m^2] of both axles: a wheel's speed grows by r_dot track / (2 R), half of I_w is its."""
    return (c["I_wf"] + c["I_wr"]) * (c["lateral_load_transfer_track"] / (2.0 * c["R_f"])) ** 2


def friction(c: Car) -> tuple[float, float]:
    """What each axle's friction is off by, beyond what both are."""
    return c["friction_level_front"], c["friction_level_rear"]


def steered(c: Car, now: Moment, drive: str, state: np.ndarray, command: float, a: tuple[float, float]) -> float:
    """Where the front wheels stand [rad]: delta = command + roll steer - coefficient F_yf(delta)."""
    straight = command + c["roll_steer_coefficient"] * state[0] * state[2]
    coefficient = c["steering_compliance_coefficient"]
    if coefficient == 0.0:
        return straight
    most = coefficient * 3.0 * (abs(axle_loads(c, now, a[0], state)[0]) + 1.0)  # no friction coefficient reaches 3

    def excess(delta: float) -> float:
        return delta - straight + coefficient * tyre_forces(c, now, drive, state, delta, a).y_f

    return root(excess, straight - most, straight + most)


def longitudinal_acceleration(c: Car, now: Moment, drive: str, state: np.ndarray, u: np.ndarray, a_y: float) -> float:
    """v_x' - v_y r [m/s^2]: the root of Newton's second law along x, in which it also stands on the right."""
    if drive == "speed":
        return u[4] - state[1] * state[2]
    x = outer_forces(c, now, state[0])[0]

    def excess(a_x: float) -> float:
        delta = steered(c, now, drive, state, u[0], (a_x, a_y))
        F = tyre_forces(c, now, drive, state, delta, (a_x, a_y))
        return (F.x_f * math.cos(delta) - F.y_f * math.sin(delta) + F.x_r + x) / mass(c) - a_x

    return root(excess, -100.0, 100.0)


def rates(c: Car, drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """d(state)/dt for states v_x, v_y, r, omega_f, omega_r, kappa_f, kappa_r, alpha of the front right, rear right,
    front left and rear left wheel, lean and its rate, both as accelerations; u in INPUTS' order."""
    (v_x, v_y, r), now = state[:3], at(c, u[7], u[8])
    _, y, turn = outer_forces(c, now, v_x)

    def under(a_y: float) -> tuple[float, float, Forces, float]:
        """a_x, the front wheels' angle, forces and the front axle's across the car, loads being those of a_y."""
        a_x = longitudinal_acceleration(c, now, drive, state, u, a_y)
        delta = steered(c, now, drive, state, u[0], (a_x, a_y))
        F = tyre_forces(c, now, drive, state, delta, (a_x, a_y))
        return a_x, delta, F, F.x_f * math.sin(delta) + F.y_f * math.cos(delta)

    def excess(a_y: float) -> float:
        _, _, F, across = under(a_y)
        return (across + F.y_r + y) / mass(c) - a_y

    a_y = v_x * r
    if c["lateral_load_transfer_uneven"] != 0.0 or c["lateral_load_transfer_coefficient"] != 0.0:
        a_y = float(newton(excess, a_y, tol=1e-12))
    (a_x, delta, F, sideways_f), (l_f, l_r) = under(a_y), axles(c)
    loads, a_y = axle_loads(c, now, a_x, state), (sideways_f + F.y_r + y) / mass(c)
    out = np.zeros(15)
    turn += F.turn + c["lateral_cog_y"] * (F.x_f * math.cos(delta) - F.y_f * math.sin(delta) + F.x_r)
    out[:3] = (
        a_x + v_y * r,
        a_y - v_x * r,
        (l_f * sideways_f - l_r * F.y_r + turn) / (yaw_inertia(c) + turning_wheels(c)),
    )
    if drive == "torque":
        R_f, R_r = effective_radius(c, loads[0], "front"), effective_radius(c, loads[1], "rear")
        out[3:5] = (u[1] - F.x_f * R_f) / c["I_wf"], (u[2] - F.x_r * R_r) / c["I_wr"]
    kappa = (0.0, 0.0) if drive == "speed" else slips(c, state, delta, loads)
    lengths = np.array(relaxation_lengths(c))[[0, 1, 0, 1, 0, 1]]
    lag = np.where(lengths > 0.0, v_x / np.maximum(lengths, 1e-12), 0.0)
    without_lag = np.array([*np.add(kappa, F.beyond), *np.transpose(slip_angles(c, state, delta)).flat])
    out[5:11] = lag * (without_lag - state[5:11])
    stiffness, damping = leaning_body(c)
    if stiffness > 0.0:
        out[11:13] = state[12], stiffness * (a_y + downhill(c) - state[11]) - damping * state[12]
    stiffness, damping = pitching_body(c)
    out[13:] = state[14], stiffness * (a_x + now.g_x - state[13]) - damping * state[14]
    return out


# --- in time --------------------------------------------------------------------------------------------------------


def impose(drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The state with what the drive mode takes from the recording."""
    given = state.copy()
    if drive == "wheel_speed":
        given[3:5] = u[5:7]
    elif drive == "speed":
        given[0] = u[3]
    return given


def start(c: Car, drive: str, u: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """Wheels rolling freely on their static load (or as recorded), lagged slips equal to the slips, the body leaning as
    in a steady turn and pitching as it is pushed."""
    state, (l_f, l_r) = np.zeros(15), axles(c)
    state[:3] = initial
    static = weight(c) * l_r / c["L"], weight(c) * l_f / c["L"]
    R_f, R_r = effective_radius(c, static[0], "front"), effective_radius(c, static[1], "rear")
    state[3:5] = wheel_plane_speed(c, state, u[0]) / R_f, state[0] / R_r
    state = impose(drive, state, u)
    kappa = (0.0, 0.0) if drive == "speed" else slips(c, state, u[0], static)
    state[5:11] = *kappa, *np.transpose(slip_angles(c, state, u[0])).flat
    state[11] = initial[0] * initial[2] + downhill(c)
    pushed = u[4] - initial[1] * initial[2] if drive == "speed" else (u[1] + u[2]) / (c["R_f"] * mass(c))
    state[13] = pushed + gravity_along(c, u[7])
    return state


def integrate(
    c: Car, drive: str, u: np.ndarray, rate: float, initial: np.ndarray, rtol: float = 1e-10, method: str = "DOP853"
) -> np.ndarray:
    """v_x, v_y, r, a_x, a_y, r', omega_f, omega_r at each sample, (time, 8); inputs (time, 9) linear in between."""
    state, motion = start(c, drive, u[0], initial), []
    for k in range(len(u)):
        state = impose(drive, state, u[k])
        d = rates(c, drive, state, u[k])
        v_x, v_y, r = state[:3]
        motion.append((v_x, v_y, r, d[0] - v_y * r, d[1] + v_x * r, d[2], state[3], state[4]))
        if k + 1 < len(u):
            state = _next_sample(c, drive, u[k], u[k + 1], rate, state, rtol, method)
    return np.array(motion)


def _next_sample(
    c: Car, drive: str, u0: np.ndarray, u1: np.ndarray, rate: float, state: np.ndarray, rtol: float, method: str
) -> np.ndarray:
    def slope(share: float, x: np.ndarray) -> np.ndarray:
        u = u0 + share * (u1 - u0)
        return rates(c, drive, impose(drive, x, u), u) / rate

    solution = solve_ivp(slope, (0.0, 1.0), state, method=method, rtol=rtol, atol=1e-12, first_step=0.25)
    assert solution.success, solution.message
    return solution.y[:, -1]
