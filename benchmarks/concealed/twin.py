"""A four-wheel car that the tool does not use: magic-formula tyres, load transfer, roll, relaxation; 1 kHz.

    m (dv_x/dt - v_y r) = sum F_x,   m (dv_y/dt + v_x r) = sum F_y,   I_z dr/dt = sum (x_i F_y,i - y_i F_x,i)
    J d2phi/dt2 = m_s h_s a_y - (K - m_s g h_s) phi - D dphi/dt        the body rolls and loads the wheels
    F = mu F_z sin(C atan(w - E (w - atan w))),  w = s / (C mu F_z),  s = |(C_kappa kappa, C_alpha tan alpha)|

(Pacejka, Tire and Vehicle Dynamics, sec. 4.3; combined slip by similarity, in which the longitudinal demand counts
`combined` times in the side force; Rajamani, ch. 15). The IMU stands on a
level platform, or rolls with the body. Effects are coded here and in `actuators_and_sensors`, independently of the
tool's.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from concealed.actuators_and_sensors import driven, sensed, steered
from concealed.drives import Plan
from concealed.worlds import Effects, Series, torques
from vehicle_sbi.physics.vehicle import AIR_DENSITY, GRAVITY, Vehicle

RATE = 1000.0  # Hz, of the integrator at least
FIELDS = (
    "m I_z l_f l_r h track C_kappa_f C_kappa_r C_alpha_f C_alpha_r mu R_f R_r softness I_wf I_wr sigma_f sigma_r C E "
    "K_phi D_phi J_phi lever front drag_area lift_area lift_front c_rr compliance rear_compliance roll_steer "
    "load_sensitivity load_transfer uneven curve combined vectoring pull cog_y uneven_front"
).split()
CAR = np.dtype([(name, np.float64) for name in FIELDS])
DELTA, T_F, T_R, F_X, F_Y, M_Z, GRIP, WARMTH, DRAG, G_X, G_Y = range(11)
INPUTS = 11
STATES = 17  # v_x, v_y, r, phi, dphi/dt, four wheel speeds, lagged kappa and alpha of each wheel
ROLL_GRADIENT = 0.006  # [rad/(m/s^2)] of the body, unless an effect states it
TRACK = 1.55  # [m] of both axles
EDGE = 0.1  # [s] over which what begins at a moment does so


@njit(cache=True)
def magic(p, demand: float, grip: float) -> float:
    """Force [N] at a linear demand [N] under a friction limit [N]; `curve` blends into a more peaked shape."""
    if grip <= 0.0:
        return 0.0
    z = demand / grip
    w = z / p.C
    force = math.sin(p.C * math.atan(w - p.E * (w - math.atan(w))))
    if p.curve != 0.0:
        force += p.curve * (math.sin(1.5 * math.atan(z / 1.5)) - force)
    return grip * force


@njit(cache=True)
def derivatives(p, u, x, last, rate) -> None:
    """Fill rate (17,) and last (a_x, a_y, F_yf, F_yr), whose values on entry set loads and compliances; gravity along a
    banked road loads the wheels and leans the body as a turn does."""
    v_x, v_y, r = x[0], x[1], x[2]
    L = p.l_f + p.l_r
    a_x, a_y = last[0], last[1] + u[G_Y]
    roll_spring = p.K_phi * x[3] + p.D_phi * x[4]
    rest = (p.m * p.h - p.lever) * a_y
    air = 0.5 * AIR_DENSITY * v_x * v_x
    shift = p.m * p.h * (a_x + u[G_X]) / L
    front = p.m * GRAVITY * p.l_r / L - shift + p.lift_front * p.lift_area * air
    rear = p.m * GRAVITY * p.l_f / L + shift + (1.0 - p.lift_front) * p.lift_area * air
    more = 0.5 * p.uneven * a_y
    weight = p.m * GRAVITY
    settled = (1.0 - GRAVITY * p.lever / p.K_phi) * roll_spring
    moved = ((p.m * p.h - p.lever) * a_y + settled) / (p.m * p.h)
    across_f = (p.front * roll_spring + rest * p.l_r / L) / p.track + more * (front + p.uneven_front * weight)
    across_r = ((1.0 - p.front) * roll_spring + rest * p.l_f / L) / p.track + more * (rear - p.uneven_front * weight)
    sum_x = u[F_X] - p.drag_area * air - p.c_rr * (front + rear)
    sum_y, turn = u[F_Y] + p.pull * v_x * v_x, u[M_Z] + p.vectoring * u[DELTA]
    delta_f = u[DELTA] - p.compliance * last[2] + p.roll_steer * v_x * r
    delta_r = -p.rear_compliance * last[3]
    F_yf = F_yr = 0.0
    for i in range(4):
        ahead, left = i < 2, i % 2 == 0
        X, Y = (p.l_f if ahead else -p.l_r), (0.5 if left else -0.5) * p.track
        load = 0.5 * (front if ahead else rear) + (-1.0 if left else 1.0) * (across_f if ahead else across_r)
        static = 0.5 * p.m * GRAVITY * (p.l_r if ahead else p.l_f) / L
        stiff = 0.5 * u[WARMTH] * max(1.0 + p.load_sensitivity * (load / static - 1.0), 0.05)
        side = max(1.0 - p.load_transfer * moved * moved, 0.05)
        C_k, C_a = (p.C_kappa_f, p.C_alpha_f) if ahead else (p.C_kappa_r, p.C_alpha_r)
        R = (p.R_f if ahead else p.R_r) - load * p.softness / 3.0
        delta = delta_f if ahead else delta_r
        c, s = math.cos(delta), math.sin(delta)
        V_x, V_y = v_x - r * Y, v_y + r * X
        along, across = V_x * c + V_y * s, -V_x * s + V_y * c
        rim = R * x[5 + i]
        kappa, alpha = (rim - along) / max(rim, along, 0.5), -math.atan2(across, max(along, 0.5))
        sigma = p.sigma_f if ahead else p.sigma_r
        used_k, used_a = kappa, alpha
        rate[9 + i] = rate[13 + i] = 0.0
        if sigma > 0.0:
            used_k, used_a = x[9 + i], x[13 + i]
            rate[9 + i], rate[13 + i] = v_x / sigma * (kappa - used_k), v_x / sigma * (alpha - used_a)
        d_x, d_y = stiff * C_k * used_k, stiff * side * C_a * math.tan(used_a)
        grip = u[GRIP] * p.mu * load
        demand, beside = math.hypot(d_x, d_y), math.hypot(p.combined * d_x, d_y)
        f_x = magic(p, demand, grip) / demand * d_x if demand > 0.0 else 0.0
        f_y = magic(p, beside, grip) / beside * d_y if beside > 0.0 else 0.0
        X_force, Y_force = f_x * c - f_y * s, f_x * s + f_y * c
        sum_x += X_force
        sum_y += Y_force
        turn += X * Y_force - (Y - p.cog_y) * X_force
        F_yf += f_y if ahead else 0.0
        F_yr += 0.0 if ahead else f_y
        torque = 0.5 * (u[T_F] if ahead else u[T_R]) - (u[DRAG] if i == 2 else 0.0)
        rate[5 + i] = (torque - f_x * R) / (0.5 * (p.I_wf if ahead else p.I_wr))
    last[0], last[1], last[2], last[3] = sum_x / p.m, sum_y / p.m, F_yf, F_yr
    rate[0], rate[1], rate[2] = last[0] + v_y * r, last[1] - v_x * r, turn / p.I_z
    rate[3] = x[4]
    rate[4] = (p.lever * (last[1] + u[G_Y]) - (p.K_phi - GRAVITY * p.lever) * x[3] - p.D_phi * x[4]) / p.J_phi


@njit(cache=True)
def integrate(p, u, v_0: float, dt: float, steps: int, motion) -> None:
    """Fill motion (time, 9) with v_x, v_y, r, a_x, a_y, dr/dt, the axles' mean wheel speeds and phi; u (time, 11)."""
    x, last = np.zeros(STATES), np.zeros(4)
    load_f, load_r = p.l_r / (p.l_f + p.l_r), p.l_f / (p.l_f + p.l_r)
    x[0] = v_0
    x[5] = x[6] = v_0 / (p.R_f - 0.5 * p.m * GRAVITY * load_f * p.softness / 3.0)
    x[7] = x[8] = v_0 / (p.R_r - 0.5 * p.m * GRAVITY * load_r * p.softness / 3.0)
    k1, k2, k3, k4 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    for k in range(len(u)):
        derivatives(p, u[k], x, last, k1)
        motion[k, :3], motion[k, 3], motion[k, 4], motion[k, 5] = x[:3], last[0], last[1], k1[2]
        motion[k, 6], motion[k, 7], motion[k, 8] = 0.5 * (x[5] + x[6]), 0.5 * (x[7] + x[8]), x[3]
        if k + 1 == len(u):
            break
        h, change = dt / steps, u[k + 1] - u[k]
        for i in range(steps):
            derivatives(p, u[k] + i / steps * change, x, last, k1)
            middle = u[k] + (i + 0.5) / steps * change
            derivatives(p, middle, x + 0.5 * h * k1, last, k2)
            derivatives(p, middle, x + 0.5 * h * k2, last, k3)
            derivatives(p, u[k] + (i + 1.0) / steps * change, x + h * k3, last, k4)
            x += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def between(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    """1 from `start` on for `duration` [s], with edges."""
    rising, falling = (np.clip((t - edge) / EDGE, 0.0, 1.0) for edge in (start, start + duration))
    return rising**2 * (3.0 - 2.0 * rising) - falling**2 * (3.0 - 2.0 * falling)


@dataclass(frozen=True, kw_only=True)
class Twin:
    """The car of a vehicle file with its own tyres: shape factor C and curvature E of the magic formula.

    What its tyres' side forces feel of longitudinal demands is `combined`. Its body rolls about an axis `roll_centre`
    [m] above the ground, with the damping ratio `roll_damping`.
    With its IMU `on_body` the effect `body_roll` is what the body itself does, at that gradient.
    """

    car: Vehicle
    gain: float  # of the steering, a base parameter
    C: float = 1.3
    E: float = -1.8
    on_body: bool = False
    roll_centre: float = 0.1
    roll_damping: float = 0.3
    combined: float = 1.0

    def drive(self, plan: Plan, effects: Effects) -> Series | None:
        p, t = self._constants(effects), plan.t
        u, g_y = self._inputs(plan, effects)
        motion = np.empty((len(t), 9))
        integrate(p, u, plan.v_0, 1.0 / plan.rate, math.ceil(RATE / plan.rate), motion)
        v_x, v_y = motion[:, 0], motion[:, 1]
        if not np.isfinite(motion).all() or v_x.min() < 0.6 * plan.v_x.min() or (abs(v_y) > 0.5 * v_x).any():
            return None
        names = ("v_x", "v_y", "yaw_rate", "a_x", "a_y", "r_dot", "wheel_speed_front", "wheel_speed_rear")
        series = dict(zip(names, motion.T[:8], strict=True)) | {"g_x": u[:, G_X], "g_y": np.full(len(t), g_y)}
        if self.on_body:
            series["roll"] = motion[:, 8]
        front, rear = torques(self.car, plan)
        commands = {"steering": plan.steering, "torque_front": front, "torque_rear": rear}
        return commands | sensed(series, t, effects)

    def _constants(self, effects: Effects) -> Any:
        """The car's record with what effects change of it."""
        car: Any = self.car

        def of(effect: str, parameter: str, null: float = 0.0) -> float:
            return effects.get(effect, {}).get(parameter, null)

        load, place = of("payload", "mass"), of("payload", "x")
        m = car.m + load
        l_f = car.l_f - load * place / m
        inertia = (car.I_z or car.m * car.l_f * (car.L - car.l_f)) * of("yaw_inertia", "factor", 1.0)
        lever = 0.85 * car.m * (car.h_cog - self.roll_centre)
        gradient = of("body_roll", "gradient", ROLL_GRADIENT) if self.on_body else ROLL_GRADIENT
        K_phi = lever * GRAVITY + lever / gradient
        J_phi = 0.35 * car.m + lever * (car.h_cog - self.roll_centre)
        p = np.zeros(1, CAR)
        for name in ("h_cog", "C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r", "I_wf", "I_wr"):
            p["h" if name == "h_cog" else name] = getattr(car, name)
        values = {
            "m": m, "l_f": l_f, "l_r": car.L - l_f, "I_z": inertia + car.m * load / m * place**2, "track": TRACK,
            "mu": car.mu, "R_f": car.R_f * of("wheel_radius", "front", 1.0),
            "R_r": car.R_f * of("wheel_radius", "rear", 1.0), "softness": 1.0 / car.C_vert,
            "sigma_f": car.C_alpha_f / car.K + of("relaxation", "front"),
            "sigma_r": car.C_alpha_r / car.K + of("relaxation", "rear"),
            "C": self.C, "E": self.E, "lever": lever, "K_phi": K_phi, "J_phi": J_phi,
            "D_phi": 2.0 * self.roll_damping * math.sqrt(K_phi * J_phi), "front": 0.55,
            "drag_area": of("aero_drag", "area"), "lift_area": of("downforce", "area"),
            "lift_front": of("downforce", "front_share", 0.5), "c_rr": of("rolling_resistance", "coefficient"),
            "compliance": of("steering_compliance", "coefficient"), "roll_steer": of("roll_steer", "coefficient"),
            "load_sensitivity": of("load_sensitivity", "coefficient"), "curve": of("tyre_curve", "peak"),
            "combined": of("combined_slip", "weight", self.combined),
            "load_transfer": of("lateral_load_transfer", "coefficient"),
            "uneven": math.sqrt(of("lateral_load_transfer", "uneven")),
            "uneven_front": of("lateral_load_transfer", "front"),
            "cog_y": of("lateral_cog", "y"),
            "rear_compliance": of("rear_compliance_steer", "coefficient"),
            "vectoring": of("torque_vectoring", "moment"), "pull": of("growing_side_pull", "force"),
        }  # fmt: skip
        for name, value in values.items():
            p[name] = value
        return p[0]

    def _inputs(self, plan: Plan, effects: Effects) -> tuple[np.ndarray, float]:
        """What acts on the car over time (time, 11), and gravity [m/s^2] across a banked road."""
        t, u = plan.t, np.zeros((len(plan.t), INPUTS))
        m = (self.car.m or 0.0) + effects.get("payload", {}).get("mass", 0.0)
        u[:, DELTA] = steered(plan.steering, t, effects, self.gain)
        u[:, T_F], u[:, T_R] = driven(*torques(self.car, plan), t, effects)
        knots = list(effects.get("road_grade_profile", {}).values()) or [0.0, 0.0]
        grade = np.interp(t, np.linspace(0.0, t[-1], len(knots)), knots)
        grade = grade + effects.get("road_grade", {}).get("angle", 0.0)
        bank = GRAVITY * math.sin(effects.get("road_bank", {}).get("angle", 0.0))
        u[:, G_X], u[:, G_Y] = GRAVITY * np.sin(grade), bank
        u[:, F_X], u[:, F_Y] = -m * u[:, G_X], -m * bank
        for wind, blows in (("crosswind", np.ones_like(t)), ("gust", None)):
            if effect := effects.get(wind):
                force = effect["force"] * (between(t, effect["start"], effect["duration"]) if blows is None else blows)
                u[:, F_Y] += force
                u[:, M_Z] += effect["arm"] * force
        u[:, M_Z] += effects.get("yaw_moment", {}).get("moment", 0.0)
        u[:, GRIP] = effects.get("friction_level", {}).get("factor", 1.0)
        if step := effects.get("friction_step"):
            u[:, GRIP] *= 1.0 + (step["factor"] - 1.0) * between(t, step["start"], step["duration"])
        warming = effects.get("warming_tyres", {})
        u[:, WARMTH] = 1.0 + warming.get("gain", 0.0) * (1.0 - np.exp(-t / warming.get("time", 1.0)))
        dragging = effects.get("dragging_rear_wheel", {})
        u[:, DRAG] = dragging.get("torque", 0.0) * between(t, dragging.get("start", 0.0), 1e3)
        return u, bank
