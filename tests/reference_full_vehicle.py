"""The four-wheel model a second time, by another route: an oracle for the compiled one.

Plain numpy from free-body diagrams, no code shared with the package. Unknown are the accelerations of the car and of
its leaning body, and the angle that steering compliance takes off the front wheels; scipy's `root` finds those at
which every body's balance holds, where the package has solved the balances for them by hand and iterates. Bodies:

    the unsprung one, m_u at the height R_f, which the tyres push and which does not lean,
    the sprung one, m_s at the height h_s, held to the other by a force at each axis (h_roll across, h_pitch along), a
    spring and a damper,

with the moments of both about the ground, whose balance gives the vertical loads. Small angles.
"""

import math

import numpy as np
from reference_single_track import (
    Car,
    G,
    Moment,
    at,
    axles,
    downforce,
    friction,
    implied_pulls,
    levels,
    mass,
    outer_forces,
    pulled_tyre,
    relaxation_lengths,
    tyre,
    weight,
    yaw_inertia,
)
from scipy.optimize import root

V_X, V_Y, R, ROLL, ROLL_RATE, PITCH, PITCH_RATE = range(7)
LEFT_RIGHT = (1.0, -1.0, 1.0, -1.0)


def sprung_mass(c: Car) -> float:
    """What leans [kg], the payload in it."""
    return min(c["m_s"], c["m"]) + c["payload_mass"]


def sprung_height(c: Car) -> float:
    """Height of the sprung mass's centre of gravity [m]: both bodies' moments of mass make that of the car."""
    m_s = sprung_mass(c)
    return (mass(c) * c["h_cog"] - (mass(c) - m_s) * c["R_f"]) / m_s


def places(c: Car) -> np.ndarray:
    """(x, y) [m] of the wheels front left, front right, rear left, rear right from the centre of gravity."""
    l_f, l_r = axles(c)
    t_f, t_r = c["track_f"] / 2.0, c["track_r"] / 2.0
    return np.array([(l_f, t_f), (l_f, -t_f), (-l_r, t_r), (-l_r, -t_r)])


def loads(c: Car, g: np.ndarray, state: np.ndarray, a: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """Vertical loads [N] at accelerations a (x, y) and angular ones of the body, lean (roll, pitch)."""
    m_s, h_s, N, pressed = sprung_mass(c), sprung_height(c), weight(c), downforce(c, state[V_X])
    m_u, (l_f, l_r), L = mass(c) - m_s, axles(c), c["L"]
    # Along: the balance of moments about the ground below the centre of gravity. The sprung mass has moved ahead by
    # (h_s - h_pitch) pitch, where its weight turns the car over the front axle, and accelerates with the second
    # derivative of that.
    ahead = h_s - c["h_pitch"]
    inertia = m_u * c["R_f"] * (a[0] + g[0]) + m_s * h_s * (a[0] + ahead * lean[1] + g[0]) + c["I_y"] * lean[1]
    behind = inertia - m_s * G * ahead * state[PITCH]
    front, rear = (N * l_r - behind) / L, (N * l_f + behind) / L
    front += c["downforce_front_share"] * pressed
    rear += (1.0 - c["downforce_front_share"]) * pressed
    # Across: springs and dampers by their share, forces through the roll centres by the axles' share of the mass.
    springs = c["K_roll"] * state[ROLL] + c["D_roll"] * state[ROLL_RATE]
    above = h_s - c["h_roll"]
    through = m_u * c["R_f"] * (a[1] + g[1]) + m_s * c["h_roll"] * (a[1] - above * lean[0] + g[1])
    right_f = c["roll_front"] * springs + through * l_r / L
    right_r = (1.0 - c["roll_front"]) * springs + through * l_f / L
    out = []
    for axle, moment, track in ((front, right_f, c["track_f"]), (rear, right_r, c["track_r"])):
        half = axle / 2.0
        moved = np.clip(moment / track, -max(half, 0.0), max(half, 0.0))
        out += [half - moved, half + moved]
    return np.array(out)


def contact_speeds(c: Car, state: np.ndarray, delta: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every wheel: speeds ahead and to the left [m/s], and ahead in its own plane."""
    x, y = places(c).T
    ahead, across = state[V_X] - state[R] * y, state[V_Y] + state[R] * x
    turned = np.array([delta, delta, 0.0, 0.0])
    return ahead, across, ahead * np.cos(turned) + across * np.sin(turned)


def effective_radii(c: Car, F_z: np.ndarray) -> np.ndarray:
    """Equation 6 of the paper with each tyre's own load."""
    free = c["R_f"] * np.repeat([c["wheel_radius_front"], c["wheel_radius_rear"]], 2)
    return free - F_z / c["C_vert"] / 3.0


def wheel_slips(c: Car, drive: str, state: np.ndarray, delta: float, F_z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """kappa and alpha of every wheel; where wheel speeds are given, both wheels of an axle slip by the same share."""
    ahead, across, along = contact_speeds(c, state, delta)
    R_e = effective_radii(c, F_z)
    rolling = R_e * state[7:11]
    if drive == "wheel_speed":
        freely = np.repeat((along / R_e).reshape(2, 2).mean(axis=1), 2)
        rolling = along * state[7:11] / freely
    kappa = np.zeros(4) if drive == "speed" else (rolling - along) / np.maximum(rolling, along)
    return kappa, np.array([delta, delta, 0.0, 0.0]) - np.arctan2(across, ahead)


def tyre_forces(
    c: Car, now: Moment, drive: str, state: np.ndarray, delta: float, F_z: np.ndarray, a_x: float, a_y: float
) -> tuple[np.ndarray, np.ndarray]:
    """F_x, F_y [N] of every wheel in its own axes; a_x [m/s^2] is where the speed is given, a_y what the body feels."""
    kappa, alpha = wheel_slips(c, drive, state, delta, F_z)
    lagging = np.repeat(relaxation_lengths(c), 2) > 0.0
    kappa, alpha = np.where(lagging, state[11:15], kappa), np.where(lagging, state[15:19], alpha)
    stiff, slide = np.repeat(levels(c, "stiffness_level"), 2), np.repeat(friction(c), 2)
    (l_f, l_r), N = axles(c), weight(c)

    def wheel(i: int, pull: float) -> tuple[float, float]:
        axle = "ffrr"[i]
        C = stiff[i] * c[f"C_kappa_{axle}"] / 2.0, stiff[i] * c[f"C_alpha_{axle}"] / 2.0
        static, mu = N * (l_r if axle == "f" else l_f) / c["L"] / 2.0, now.mu * slide[i]
        if drive == "speed":
            return pulled_tyre(c, C[1], mu, float(F_z[i]), static, pull / 2.0, float(alpha[i]), a_y)
        return tyre(c, C, mu, float(F_z[i]), static, (float(kappa[i]), float(alpha[i])), a_y)

    def side(pull: float) -> float:
        return wheel(0, pull)[1] + wheel(1, pull)[1]

    pulls = implied_pulls(c, now, state[V_X], delta, a_x, side) if drive == "speed" else (0.0, 0.0)
    F = [wheel(i, pulls[i // 2]) for i in range(4)]
    x, y = np.array(F).T
    return x, y


def rates(c: Car, drive: str, state: np.ndarray, u: np.ndarray) -> np.ndarray:
    """d(state)/dt for v_x, v_y, r, roll, roll rate, pitch, pitch rate, four omega, kappa and alpha; u like INPUTS."""
    now, (v_x, v_y, r) = at(c, u[7], u[8]), state[:3]
    m_s, h_s, J = sprung_mass(c), sprung_height(c), (c["I_x"], c["I_y"])
    above, ahead, m_u = h_s - c["h_roll"], h_s - c["h_pitch"], mass(c) - m_s
    g = np.array([now.g_x, G * math.sin(c["road_bank_angle"])])
    push_x, push_y, moment = outer_forces(c, now, v_x)
    straight = u[0] + c["roll_steer_coefficient"] * v_x * r

    def tyres_at(a: np.ndarray, lean: np.ndarray, delta: float) -> tuple[np.ndarray, ...]:
        F_z = loads(c, g, state, a, lean)
        F_x, F_y = tyre_forces(c, now, drive, state, delta, F_z, u[4] - v_y * r, float(a[1] + g[1]))
        turned = np.array([delta, delta, 0.0, 0.0])
        along = F_x * np.cos(turned) - F_y * np.sin(turned)
        return along, F_x * np.sin(turned) + F_y * np.cos(turned), F_x, F_y

    def unbalanced(unknown: np.ndarray) -> np.ndarray:
        a, lean, twist = unknown[:2], unknown[2:4], unknown[4] / 1e3
        along, across, _, F_y = tyres_at(a, lean, straight - twist)
        # The force at the axes that drags the body along, less gravity, and what that leaves for the unsprung body.
        drag_x = m_s * (a[0] + ahead * lean[1])
        drag_y = m_s * (a[1] - above * lean[0])
        held_roll = c["K_roll"] * state[ROLL] + c["D_roll"] * state[ROLL_RATE]
        held_pitch = c["K_pitch"] * state[PITCH] + c["D_pitch"] * state[PITCH_RATE]
        roll = above * (drag_y + m_s * g[1]) + m_s * G * above * state[ROLL] - held_roll
        pitch = -ahead * (drag_x + m_s * g[0]) + m_s * G * ahead * state[PITCH] - held_pitch
        given = u[4] - v_y * r
        return np.array([
            a[0] - given if drive == "speed" else (along.sum() + push_x - drag_x) / m_u - a[0],
            (across.sum() + push_y - drag_y) / m_u - a[1],
            roll / J[0] - lean[0],
            pitch / J[1] - lean[1],
            1e3 * c["steering_compliance_coefficient"] * (F_y[0] + F_y[1]) - unknown[4],
        ])  # fmt: skip

    solution = root(unbalanced, np.zeros(5), tol=1e-14)
    assert np.abs(unbalanced(solution.x)).max() < 1e-7, solution.message
    a, lean, delta = solution.x[:2], solution.x[2:4], straight - solution.x[4] / 1e3
    along, across, F_x, _ = tyres_at(a, lean, delta)
    F_z, (x, y) = loads(c, g, state, a, lean), places(c).T
    out = np.zeros(19)
    out[:3] = a[0] + v_y * r, a[1] - v_x * r, (x @ across - (y - c["lateral_cog_y"]) @ along + moment) / yaw_inertia(c)
    out[3:7] = state[ROLL_RATE], lean[0], state[PITCH_RATE], lean[1]
    if drive == "torque":
        inertia, torque = np.repeat([c["I_wf"], c["I_wr"]], 2) / 2.0, np.repeat(u[1:3], 2) / 2.0
        out[7:11] = (torque - F_x * effective_radii(c, F_z)) / inertia
    kappa, alpha = wheel_slips(c, drive, state, delta, F_z)
    lengths = np.repeat(relaxation_lengths(c), 2)
    fade = np.where(lengths > 0.0, (v_x - r * y) / np.maximum(lengths, 1e-12), 0.0)
    out[11:15], out[15:19] = fade * (kappa - state[11:15]), fade * (alpha - state[15:19])
    return out
