"""CommonRoad's multi-body car (29 states, Pacejka tyres; parameter sets 1 to 3) as a world for concealed effects.

It is driven by steering and by an acceleration that it turns into torques m R a. Commands are changed before it,
external forces and moments enter its derivatives, sensors stand behind it (on a level platform, or on the body); what
would have to change inside it is not offered. Its planar states are those of ISO 8855 (Althoff, CommonRoad vehicle
models, 2020).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from vehiclemodels import vehicle_dynamics_mb
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.parameters_vehicle3 import parameters_vehicle3

from concealed.actuators_and_sensors import COMMAND_EFFECTS, SENSOR_EFFECTS, sensed, steered
from concealed.drives import Plan
from concealed.twin import between
from concealed.worlds import Effects, Series
from vehicle_sbi.physics.vehicle import AIR_DENSITY, GRAVITY, Vehicle

SETS: dict[int, Callable[[], Any]] = {1: parameters_vehicle1, 2: parameters_vehicle2, 3: parameters_vehicle3}
STEP = 2e-3  # [s], of the classical Runge-Kutta method; the wheels' slip modes are slower above 6 m/s
SWAY_S = 0.4  # [s], over which its steering is smoothed
SHIFTS = ("p_hx1", "p_vx1", "p_hy1", "p_hy3", "p_vy1", "p_vy3", "r_vy1", "r_vy3")
FORCES = ("aero_drag", "rolling_resistance", "road_grade", "road_bank", "crosswind", "gust", "yaw_moment")
TORQUES = ("drive_gain", "brake_gain", "brake_balance", "drive_delay")  # it splits torques itself
OFFERED = (*(name for name in COMMAND_EFFECTS if name not in TORQUES), *FORCES, *SENSOR_EFFECTS)
STEER, V_X, YAW_RATE, ROLL, PITCH, V_Y, V_Y_FRONT, V_Y_REAR, WHEELS = 2, 3, 5, 6, 8, 10, 15, 20, 23


def parameters(number: int) -> Any:
    """A parameter set without its tyres' shifts, which step by 4 % of the load as camber changes sign: no base model
    has those, so that a car with them is never one with nothing missing."""
    p = SETS[number]()
    for name in SHIFTS:
        setattr(p.tire, name, 0.0)
    return p


def vehicle_of(number: int) -> Vehicle:
    """What a user would know of a parameter set; tyres linearised about straight driving at their static loads."""
    p = parameters(number)
    L, weight = p.a + p.b, p.m * GRAVITY
    front, rear = weight * p.b / L, weight * p.a / L
    return Vehicle(
        name="truth",
        m=p.m,
        L=L,
        l_f=p.a,
        h_cog=p.h_cg,
        C_kappa_f=p.tire.p_kx1 * front,
        C_kappa_r=p.tire.p_kx1 * rear,
        C_alpha_f=-p.tire.p_ky1 * front,
        C_alpha_r=-p.tire.p_ky1 * rear,
        mu=p.tire.p_dy1,
        R_f=p.R_w,
        I_wf=2 * p.I_y_w,
        I_wr=2 * p.I_y_w,
        I_z=p.I_z,
        drive_front=p.T_se,
        brake_front=p.T_sb,
    )


@dataclass(frozen=True, kw_only=True)
class MultiBody:
    """The multi-body car with parameter set `number`."""

    number: int
    gain: float  # of the steering, a base parameter
    on_body: bool = False  # whether the IMU rolls and pitches with the body

    def drive(self, plan: Plan, effects: Effects) -> Series | None:
        p, t, steps = parameters(self.number), plan.t, math.ceil(1.0 / (plan.rate * STEP))
        delta = steered(plan.steering, t, effects, self.gain)
        push = _pushes(p, plan, effects)
        grade = GRAVITY * math.sin(effects.get("road_grade", {}).get("angle", 0.0))
        bank = GRAVITY * math.sin(effects.get("road_bank", {}).get("angle", 0.0))
        slope = np.gradient(delta, t)
        x = np.array(init_mb([0.0, 0.0, delta[0], plan.v_0, 0.0, 0.0, 0.0], p))
        rows, h = np.empty((len(t), 10)), 1.0 / plan.rate / steps

        def rate(state: np.ndarray, k: float) -> np.ndarray:
            i = min(int(k), len(t) - 2)
            share = k - i
            u = [slope[i] + share * (slope[i + 1] - slope[i]),
                 plan.acceleration[i] + share * (plan.acceleration[i + 1] - plan.acceleration[i])]  # fmt: skip
            f = np.array(vehicle_dynamics_mb.vehicle_dynamics_mb(list(state), u, p))
            along, across, turn = push[i]
            along -= 0.5 * AIR_DENSITY * effects.get("aero_drag", {}).get("area", 0.0) * state[V_X] ** 2
            f[V_X] += along / p.m - grade
            f[[V_Y, V_Y_FRONT, V_Y_REAR]] += across / p.m - bank
            f[YAW_RATE] += turn / p.I_z
            return f

        for k in range(len(t)):
            f = rate(x, float(k))
            rows[k] = (
                x[V_X], x[V_Y], x[YAW_RATE], f[V_X] - x[YAW_RATE] * x[V_Y], f[V_Y] + x[YAW_RATE] * x[V_X], f[YAW_RATE],
                0.5 * (x[WHEELS] + x[WHEELS + 1]), 0.5 * (x[WHEELS + 2] + x[WHEELS + 3]),
                -x[ROLL], x[PITCH],  # their signs are not those of ISO 8855: this body leans outwards, its nose lifts
            )  # fmt: skip
            if k + 1 == len(t):
                break
            for step in range(steps):
                now, half, after = (k + (step + part) / steps for part in (0.0, 0.5, 1.0))
                k1 = rate(x, now)
                k2 = rate(x + h / 2 * k1, half)
                k3 = rate(x + h / 2 * k2, half)
                k4 = rate(x + h * k3, after)
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            x[STEER] = delta[k + 1]
            if not np.isfinite(x).all() or x[V_X] < 3.0:
                return None
        names = ("v_x", "v_y", "yaw_rate", "a_x", "a_y", "r_dot", "wheel_speed_front", "wheel_speed_rear")
        motion = dict(zip(names, rows.T[:8], strict=True))
        if self.on_body:
            motion |= {"roll": rows[:, 8], "pitch": rows[:, 9]}
        motion |= {"g_x": np.full(len(t), grade), "g_y": np.full(len(t), bank)}
        return self._commands(p, plan) | sensed(motion, t, effects)

    def _commands(self, p: Any, plan: Plan) -> Series:
        total = p.m * p.R_w * plan.acceleration
        front = np.where(total > 0.0, p.T_se, p.T_sb) * total
        return {"steering": plan.steering, "torque_front": front, "torque_rear": total - front}

    def slower(self, plan: Plan) -> Plan:
        """The plan without what sways the body on its springs, and above the speed that its step needs.

        Its actuators turn the wheels at 0.4 rad/s at most, which smooth steering does not reach.
        """
        v_0 = plan.v_0 + max(0.0, 6.0 - float(plan.v_x.min()))
        return replace(plan, steering=gaussian_filter1d(plan.steering, SWAY_S * plan.rate), v_0=v_0)


def _pushes(p: Any, plan: Plan, effects: Effects) -> np.ndarray:
    """External (F_x, F_y, M_z) [N, N, N m] at each sample, but for gravity and what depends on the speed."""
    push = np.zeros((len(plan.t), 3))
    push[:, 0] -= effects.get("rolling_resistance", {}).get("coefficient", 0.0) * p.m * GRAVITY
    for name in ("crosswind", "gust"):
        if wind := effects.get(name):
            blows = between(plan.t, wind["start"], wind["duration"]) if name == "gust" else np.ones(len(plan.t))
            push[:, 1] += wind["force"] * blows
            push[:, 2] += wind["arm"] * wind["force"] * blows
    push[:, 2] += effects.get("yaw_moment", {}).get("moment", 0.0)
    return push
