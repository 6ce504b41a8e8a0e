"""The single-track model a second time, by another route: an oracle for the compiled one.

Plain Python from the paper's equations 1 to 11 and a free-body diagram, no code shared with the package. What differs
on purpose: Dugoff's lambda is formed as printed, the loop between load transfer and longitudinal force is a root that
brentq brackets, and scipy's adaptive DOP853 integrates from sample to sample.

    pitch balance about the centre of gravity:  F_zf l_f - F_zr l_r + h (F_xf cos d - F_yf sin d + F_xr) = 0
    weight across the road:                     F_zf + F_zr = m g cos(grade) cos(bank)

Holds for v_x > 1 m/s and omega > 1 rad/s, where nothing is regularised, and for wheels that do not lock.
"""

import math
from collections.abc import Mapping

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

G = 9.81
RHO = 1.225

Car = Mapping[str, float]


def car_of(record: np.void) -> dict[str, float]:
    """The constants and effect parameters of a record as floats; what the package derives from them is left out."""
    assert record.dtype.names is not None
    derived = ("l_r", "I_z", "grip", "F_zf_static", "F_zr_static", "load_transfer", "sigma_f", "sigma_r")
    return {name: float(record[name]) for name in record.dtype.names if name not in derived}


def dugoff(C_kappa: float, C_alpha: float, mu: float, F_z: float, kappa: float, alpha: float) -> tuple[float, float]:
    """Equations 8 to 10 as printed, for kappa > -1."""
    S = math.hypot(C_kappa * kappa, C_alpha * math.tan(alpha))
    lam = math.inf if S == 0.0 else mu * max(F_z, 0.0) * (1.0 + kappa) / (2.0 * S)
    f = lam * (2.0 - lam) if lam < 1.0 else 1.0
    return C_kappa * kappa / (1.0 + kappa) * f, C_alpha * math.tan(alpha) / (1.0 + kappa) * f


def axle_loads(c: Car, a_x: float) -> tuple[float, float]:
    """F_zf, F_zr [N] from the two balances above; every force but gravity taken to act at the ground."""
    N = c["m"] * G * math.cos(c["road_grade_angle"]) * math.cos(c["road_bank_angle"])
    ground_force = c["m"] * (a_x + G * math.sin(c["road_grade_angle"]))
    F_zf = (N * (c["L"] - c["l_f"]) - c["h_cog"] * ground_force) / c["L"]
    return F_zf, N - F_zf


def effective_radius(c: Car, F_z: float) -> float:
    """Equation 6 with R_l = R_f - F_z,tyre / C_vert."""
    return 2.0 / 3.0 * c["R_f"] + (c["R_f"] - F_z / 2.0 / c["C_vert"]) / 3.0


def slip_angles(c: Car, state: np.ndarray, delta: float) -> tuple[float, float]:
    """Equations 3 and 5."""
    v_x, v_y, r = state[:3]
    return delta - math.atan2(v_y + c["l_f"] * r, v_x), -math.atan2(v_y - (c["L"] - c["l_f"]) * r, v_x)


def wheel_plane_speed(c: Car, state: np.ndarray, delta: float) -> float:
    """Speed [m/s] of the front contact point in the wheel's own plane."""
    return state[0] * math.cos(delta) + (state[1] + c["l_f"] * state[2]) * math.sin(delta)


def slips(c: Car, state: np.ndarray, delta: float, a_x: float) -> tuple[float, float]:
    """Equation 4 for both axles."""
    V_f, V_r = wheel_plane_speed(c, state, delta), state[0]
    F_zf, F_zr = axle_loads(c, a_x)
    rolling_f, rolling_r = effective_radius(c, F_zf) * state[3], effective_radius(c, F_zr) * state[4]
    return (rolling_f - V_f) / max(rolling_f, V_f), (rolling_r - V_r) / max(rolling_r, V_r)


def tyre_forces(c: Car, drive: str, state: np.ndarray, delta: float, a_x: float) -> tuple[float, float, float, float]:
    """F_xf, F_yf, F_xr, F_yr [N] if the car accelerates with a_x."""
    if math.isfinite(c["K"]):
        kappa_f, kappa_r, alpha_f, alpha_r = (float(x) for x in state[5:9])
    else:
        alpha_f, alpha_r = slip_angles(c, state, delta)
        kappa_f, kappa_r = (0.0, 0.0) if drive == "speed" else slips(c, state, delta, a_x)
    mu = c["mu"] * c["friction_level_factor"]
    F_zf, F_zr = axle_loads(c, a_x)
    F_xf, F_yf = dugoff(c["C_kappa_f"], c["C_alpha_f"], mu, F_zf, kappa_f, alpha_f)
    F_xr, F_yr = dugoff(c["C_kappa_r"], c["C_alpha_r"], mu, F_zr, kappa_r, alpha_r)
    return F_xf, F_yf, F_xr, F_yr


def outer_forces(c: Car, v_x: float) -> tuple[float, float]:
    """Drag, rolling resistance, and gravity along the body [N]."""
    N = c["m"] * G * math.cos(c["road_grade_angle"]) * math.cos(c["road_bank_angle"])
    x = -0.5 * RHO * c["aero_drag_area"] * v_x**2 - c["rolling_resistance_coefficient"] * N
    return x - c["m"] * G * math.sin(c["road_grade_angle"]), -c["m"] * G * math.sin(c["road_bank_angle"])


def longitudinal_acceleration(c: Car, drive: str, state: np.ndarray, u: np.ndarray) -> float:
    """v_x' - v_y r [m/s^2]: the root of Newton's second law along x, in which it also stands on the right."""
    if drive == "speed":
        return u[4] - state[1] * state[2]
    delta, x = u[0], outer_forces(c, state[0])[0]

    def excess(a_x: float) -> float:
        F_xf, F_yf, F_xr, _ = tyre_forces(c, drive, state, delta, a_x)
        return (F_xf * math.cos(delta) - F_yf * math.sin(delta) + F_xr + x) / c["m"] - a_x

    return float(brentq(excess, -100.0, 100.0, xtol=1e-13, rtol=1e-15))  # pyright: ignore[reportArgumentType]


def rates(c: Car, drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """d(state)/dt for states v_x, v_y, r, omega_f, omega_r, kappa_f, kappa_r, alpha_f, alpha_r; u in INPUTS' order."""
    v_x, v_y, r = state[:3]
    delta = u[0]
    a_x = longitudinal_acceleration(c, drive, state, u)
    F_xf, F_yf, F_xr, F_yr = tyre_forces(c, drive, state, delta, a_x)
    sideways_f = F_xf * math.sin(delta) + F_yf * math.cos(delta)
    l_r = c["L"] - c["l_f"]
    a_y = (sideways_f + F_yr + outer_forces(c, v_x)[1]) / c["m"]
    I_z = c["yaw_inertia_factor"] * c["m"] * c["l_f"] * l_r
    out = np.zeros(9)
    out[:3] = a_x + v_y * r, a_y - v_x * r, (c["l_f"] * sideways_f - l_r * F_yr) / I_z
    if drive == "torque":
        R_f, R_r = (effective_radius(c, F_z) for F_z in axle_loads(c, a_x))
        out[3:5] = (u[1] - F_xf * R_f) / c["I_wf"], (u[2] - F_xr * R_r) / c["I_wr"]
    if math.isfinite(c["K"]):
        kappa = (0.0, 0.0) if drive == "speed" else slips(c, state, delta, a_x)
        lag = np.array([v_x * c["K"] / c["C_alpha_f"], v_x * c["K"] / c["C_alpha_r"]] * 2)
        out[5:] = lag * (np.array([*kappa, *slip_angles(c, state, delta)]) - state[5:])
    return out


def impose(drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The state with what the drive mode takes from the recording."""
    given = state.copy()
    if drive == "wheel_speed":
        given[3:5] = u[5:7]
    elif drive == "speed":
        given[0] = u[3]
    return given


def start(c: Car, drive: str, u: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """Wheels rolling freely on their static load (or as recorded), lagged slips equal to the slips."""
    state = np.zeros(9)
    state[:3] = initial
    R_f, R_r = (effective_radius(c, F_z) for F_z in axle_loads(c, -G * math.sin(c["road_grade_angle"])))
    state[3:5] = wheel_plane_speed(c, state, u[0]) / R_f, state[0] / R_r
    state = impose(drive, state, u)
    kappa = (0.0, 0.0) if drive == "speed" else slips(c, state, u[0], -G * math.sin(c["road_grade_angle"]))
    state[5:] = *kappa, *slip_angles(c, state, u[0])
    return state


def integrate(
    c: Car, drive: str, u: np.ndarray, rate: float, initial: np.ndarray, rtol: float = 1e-10, method: str = "DOP853"
) -> np.ndarray:
    """v_x, v_y, r, a_x, a_y, r', omega_f, omega_r at each sample, (time, 8); inputs (time, 7) linear in between."""
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
