"""The model in numpy, all simulations at once: each operation runs over an array of them."""

import numpy as np
from numpy.typing import NDArray

from vehicle_sbi.physics.vehicle import GRAVITY

Array = NDArray[np.float64]
TOLERANCE, ITERATIONS = 1e-9, 100  # [m/s^2] and rounds of the loop between load transfer and longitudinal force
STEEPEST = 1.5  # [rad]
V_X, V_Y, R, OMEGA_F, OMEGA_R, KAPPA_F, KAPPA_R, ALPHA_F, ALPHA_R = range(9)


def regular(v: Array) -> Array:
    v = np.abs(v)
    return np.where(v >= 1.0, v, 0.5 * (1.0 + v * v))


def slip(rolling: Array, v: Array) -> Array:
    return np.maximum((rolling - v) / regular(np.maximum(rolling, v)), -1.0)


def wheel_torque(torque: float, omega: Array) -> Array:
    if torque >= 0.0:
        return np.full_like(omega, torque)
    return torque * np.where(np.abs(omega) >= 1.0, np.sign(omega), omega * (2.0 - np.abs(omega)))


def dugoff(
    C_kappa: Array, C_alpha: Array, mu: Array, F_z: Array, kappa: Array, tan_alpha: Array
) -> tuple[Array, Array]:
    x, y = C_kappa * kappa, C_alpha * tan_alpha
    demand, grip = np.maximum(np.hypot(x, y), 1e-12), mu * np.maximum(F_z, 0.0)
    beyond = 0.5 * grip / demand * (2.0 - 0.5 * grip * (1.0 + kappa) / demand)
    factor = np.where(grip * (1.0 + kappa) >= 2.0 * demand, 1.0 / (1.0 + kappa), beyond)
    return x * factor, y * factor


class InNumpy:
    """`records` (n,) with initial speeds (n,) [m/s]."""

    def __init__(self, records: np.ndarray, v_0: Array) -> None:
        self.p = {name: np.asarray(records[name], dtype=float) for name in records.dtype.names or ()}
        self.v_0, p = v_0, self.p
        self.l_r = p["L"] - p["l_f"]
        self.load_f, self.load_r = (p["m"] * GRAVITY * length / p["L"] for length in (self.l_r, p["l_f"]))
        self.lever = p["m"] * p["h_cog"] / p["L"]

    def radius(self, F_z: Array) -> Array:
        return self.p["R_f"] - 0.5 * F_z / (3.0 * self.p["C_vert"])

    def forces(self, x: Array, c: float, s: float, tan_f: Array, tan_r: Array, a_x: Array) -> tuple[Array, ...]:
        p, shift = self.p, self.lever * a_x
        F_xf, F_yf = dugoff(p["C_kappa_f"], p["C_alpha_f"], p["mu"], self.load_f - shift, x[KAPPA_F], tan_f)
        F_xr, F_yr = dugoff(p["C_kappa_r"], p["C_alpha_r"], p["mu"], self.load_r + shift, x[KAPPA_R], tan_r)
        return F_xf, F_xf * s + F_yf * c, F_xr, F_yr, (F_xf * c - F_yf * s + F_xr) / p["m"]

    def derivatives(self, u: Array, x: Array, guess: Array) -> Array:
        """Rates (9, n) at inputs u (3,) and states (9, n); `guess` (n,) [m/s^2] starts the loop over a_x."""
        p, (delta, torque_f, torque_r) = self.p, (float(value) for value in u)
        v_x, v_y, r = x[V_X], x[V_Y], x[R]
        speed, v_yf = regular(v_x), v_y + p["l_f"] * r
        c, s = np.cos(delta), np.sin(delta)
        tan_f, tan_r = (np.tan(np.clip(x[i], -STEEPEST, STEEPEST)) for i in (ALPHA_F, ALPHA_R))
        a_x, found = guess, self.forces(x, c, s, tan_f, tan_r, guess)
        for _ in range(ITERATIONS):
            off, a_x = found[-1] - a_x, found[-1]
            if np.abs(off).max() < TOLERANCE:
                break
            found = self.forces(x, c, s, tan_f, tan_r, a_x)
        F_xf, F_lateral, F_xr, F_yr, _ = found
        R_f, R_r = self.radius(self.load_f - self.lever * a_x), self.radius(self.load_r + self.lever * a_x)
        fade_f, fade_r = speed * p["K"] / p["C_alpha_f"], speed * p["K"] / p["C_alpha_r"]
        return np.stack([
            a_x + v_y * r,
            (F_lateral + F_yr) / p["m"] - v_x * r,
            (p["l_f"] * F_lateral - self.l_r * F_yr) / (p["m"] * p["l_f"] * self.l_r),
            (wheel_torque(torque_f, x[OMEGA_F]) - F_xf * R_f) / p["I_wf"],
            (wheel_torque(torque_r, x[OMEGA_R]) - F_xr * R_r) / p["I_wr"],
            fade_f * (slip(R_f * x[OMEGA_F], v_x * c + v_yf * s) - x[KAPPA_F]),
            fade_r * (slip(R_r * x[OMEGA_R], v_x) - x[KAPPA_R]),
            fade_f * (delta - np.arctan(v_yf / speed) - x[ALPHA_F]),
            fade_r * (-np.arctan((v_y - self.l_r * r) / speed) - x[ALPHA_R]),
        ])  # fmt: skip

    def simulated(self, u: Array, rate: float) -> Array:
        """Series (n, 5, time) driven by u (time, 3), a Runge-Kutta step a sample."""
        h, x, k1 = 1.0 / rate, self._started(float(u[0, 0])), np.zeros((9, len(self.v_0)))
        y = np.empty((len(self.v_0), 5, len(u)))
        for k in range(len(u)):
            k1 = self.derivatives(u[k], x, k1[V_X] - x[V_Y] * x[R])
            y[:, :, k] = np.stack([k1[V_X] - x[V_Y] * x[R], k1[V_Y] + x[V_X] * x[R], x[R], x[OMEGA_F], x[OMEGA_R]], 1)
            if k + 1 == len(u):
                break
            middle, guess = 0.5 * (u[k] + u[k + 1]), k1[V_X] - x[V_Y] * x[R]
            k2 = self.derivatives(middle, x + 0.5 * h * k1, guess)
            k3 = self.derivatives(middle, x + 0.5 * h * k2, guess)
            k4 = self.derivatives(u[k + 1], x + h * k3, guess)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return y

    def _started(self, delta: float) -> Array:
        x = np.zeros((9, len(self.v_0)))
        x[V_X], x[ALPHA_F] = self.v_0, delta
        x[OMEGA_F] = self.v_0 * np.cos(delta) / self.radius(self.load_f)
        x[OMEGA_R] = self.v_0 / self.radius(self.load_r)
        return x
