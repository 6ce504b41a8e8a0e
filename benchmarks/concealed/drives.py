"""What the concealed cars do: steering and longitudinal manoeuvres, and the cars that are drawn to do them.

A plan states the road-wheel angle that is commanded, the acceleration that is asked for and the speed at its start.
Steering amplitudes follow from the lateral acceleration that a regime asks for, delta = a_y (L + K v^2) / v^2
(Rajamani, Vehicle Dynamics and Control, sec. 3.3).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from vehicle_sbi.physics.vehicle import GRAVITY, Vehicle

REGIMES: Mapping[str, tuple[float, float]] = {"gentle": (0.08, 0.2), "normal": (0.25, 0.45), "limit": (0.6, 0.9)}
"""Peak lateral acceleration over mu g."""

V_LOW, V_HIGH = 4.5, 36.0  # [m/s], which no plan leaves
MOST_STEERING = 0.3  # [rad]
Rng = np.random.Generator


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One recording's commands: road-wheel angle [rad] and acceleration [m/s^2] on a grid t [s], from v_0 [m/s]."""

    t: np.ndarray
    steering: np.ndarray
    acceleration: np.ndarray
    v_0: float
    manoeuvre: str

    @property
    def rate(self) -> float:
        return float(1.0 / (self.t[1] - self.t[0]))

    @property
    def v_x(self) -> np.ndarray:
        """The speed [m/s] that the asked acceleration alone would give, by the trapezoidal rule."""
        steps = 0.5 * (self.acceleration[1:] + self.acceleration[:-1]) / self.rate
        return self.v_0 + np.concatenate([[0.0], np.cumsum(steps)])

    def scaled(self, factor: float) -> "Plan":
        """The same with `factor` of the steering and of the acceleration."""
        return replace(self, steering=factor * self.steering, acceleration=factor * self.acceleration)


def understeer(car: Vehicle) -> float:
    """K of delta = L/R + K a_y [rad/(m/s^2)], m/L (l_r/C_f - l_f/C_r)."""
    known: Any = car
    return known.m / known.L * ((known.L - known.l_f) / known.C_alpha_f - known.l_f / known.C_alpha_r)


# --- steering, each of unit amplitude -------------------------------------------------------------------------------


def _sine(t: np.ndarray, rng: Rng) -> np.ndarray:
    return np.sin(2 * np.pi * rng.uniform(0.2, 0.8) * t)


def _multisine(t: np.ndarray, rng: Rng) -> np.ndarray:
    tones = rng.uniform(0.1, 1.6, 5)
    series = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / (1 + f) for f in tones)
    return np.asarray(series) / np.abs(series).max()


def _sine_with_dwell(t: np.ndarray, rng: Rng) -> np.ndarray:
    f, pause = rng.uniform(0.4, 0.8), rng.uniform(2.0, 4.0)
    period = 1 / f + 0.5 + pause
    local, turn = t % period, (t // period).astype(int)
    hold = 0.75 / f  # the third quarter's peak is held for half a second
    phase = np.where(local < hold, local, np.where(local < hold + 0.5, hold, local - 0.5))
    wave = np.where(local < 1 / f + 0.5, np.sin(2 * np.pi * f * phase), 0.0)
    return wave * np.where(turn % 2 == 0, 1.0, -1.0)


def _steps(t: np.ndarray, rng: Rng) -> np.ndarray:
    levels = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], 64)
    return levels[(t / rng.uniform(1.5, 3.0)).astype(int)]


def _slalom(t: np.ndarray, rng: Rng) -> np.ndarray:
    return np.tanh(2.0 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * t)) * (0.5 + 0.5 * t / t[-1])


def _sweep(t: np.ndarray, rng: Rng) -> np.ndarray:
    low, high = rng.uniform(0.1, 0.3), rng.uniform(1.2, 2.2)
    return np.sin(2 * np.pi * (low * t + 0.5 * (high - low) * t**2 / t[-1]))


def _lane_changes(t: np.ndarray, rng: Rng) -> np.ndarray:
    f, pause = rng.uniform(0.3, 0.6), rng.uniform(0.5, 2.0)
    local, turn = t % (1 / f + pause), (t // (1 / f + pause)).astype(int)
    return np.where(local < 1 / f, np.sin(2 * np.pi * f * local), 0.0) * np.where(turn % 2 == 0, 1.0, -1.0)


def _circle(t: np.ndarray, rng: Rng) -> np.ndarray:
    return np.clip(t / rng.uniform(2.0, 6.0), 0.0, 1.0) + 0.2 * np.sin(2 * np.pi * rng.uniform(0.3, 0.9) * t)


STEERING: Mapping[str, Callable[[np.ndarray, Rng], np.ndarray]] = {
    "sine": _sine,
    "multisine": _multisine,
    "sine with dwell": _sine_with_dwell,
    "steps": _steps,
    "slalom": _slalom,
    "sweep": _sweep,
    "double lane changes": _lane_changes,
    "circle": _circle,
}


# --- acceleration ---------------------------------------------------------------------------------------------------


def _constant(t: np.ndarray, rng: Rng) -> np.ndarray:
    return np.zeros_like(t)


def _square(t: np.ndarray, rng: Rng) -> np.ndarray:
    period, brake = rng.uniform(3.0, 6.0), rng.uniform(0.5, 2.5)
    return np.where(t % period < 0.6 * period, brake * 2 / 3, -brake)


def _waves(t: np.ndarray, rng: Rng) -> np.ndarray:
    return rng.uniform(0.4, 1.5) * np.sin(2 * np.pi * rng.uniform(0.1, 0.35) * t)


ACCELERATION = {"constant speed": _constant, "drive and brake": _square, "speed waves": _waves}


def plan(
    car: Vehicle, share: tuple[float, float], rng: Rng, *, rate: float, seconds: float, smooth: float, asks: float
) -> Plan:
    """A fresh manoeuvre: `share` bounds its peak lateral acceleration over mu g, `asks` is the share of plans that
    change speed, `smooth` [s] rounds the corners of commands.

    The first and last half second are straight driving at constant speed; speeds stay in V_LOW to V_HIGH.
    """
    known: Any = car
    t = np.arange(round(seconds * rate) + 1) / rate
    kind = str(rng.choice(list(STEERING)))
    along = "constant speed" if rng.uniform() > asks else str(rng.choice(list(ACCELERATION)[1:]))
    ends = np.minimum(1.0, np.minimum(t / 0.5 - 1.0, (t[-1] - t) / 0.5)).clip(0.0)
    acceleration = gaussian_filter1d(ends * ACCELERATION[along](t, rng), max(smooth * rate, 0.5))
    v_0 = float(rng.uniform(6.0, 30.0))
    drift = np.cumsum(acceleration) / rate
    low, high = max(V_LOW - drift.min(), v_0), V_HIGH - drift.max()
    v_0 = low if v_0 + drift.max() < V_HIGH else high
    v_0 = float(np.clip(v_0, V_LOW, V_HIGH))
    v = np.clip(v_0 + drift, V_LOW, V_HIGH)
    wanted = rng.uniform(*share) * known.mu * GRAVITY * (known.L + understeer(car) * v**2) / v**2
    angle = np.minimum(wanted, MOST_STEERING) * ends * STEERING[kind](np.maximum(t - 0.5, 0.0), rng)
    delta = gaussian_filter1d(angle, max(0.06 * rate, 1.0)) * rng.choice([-1.0, 1.0])
    return Plan(t=t, steering=delta, acceleration=acceleration, v_0=v_0, manoeuvre=f"{kind}, {along}")


# --- cars -----------------------------------------------------------------------------------------------------------


def car(rng: Rng, *, relaxed: bool, body: bool) -> Vehicle:
    """A car of plausible proportions that understeers; `relaxed` tyres, and `body`: with what the full model needs."""
    m = float(rng.uniform(900.0, 2500.0))
    L = float(2.3 + 0.6 * (m - 900.0) / 1600.0 + rng.uniform(-0.1, 0.2))
    l_f = float(L * rng.uniform(0.41, 0.53))
    loads = m * GRAVITY * (L - l_f) / L, m * GRAVITY * l_f / L
    front = rng.uniform(8.0, 13.0)
    C_f, C_r = loads[0] * front, loads[1] * front * rng.uniform(1.08, 1.5)
    C_kappa = rng.uniform(10.0, 18.0, 2) * loads
    track = float(rng.uniform(1.45, 1.65))
    frame: dict[str, float] = {}
    if body:
        frame = {
            "track_f": track, "track_r": track, "m_s": 0.88 * m, "I_x": 0.37 * m, "I_y": 1.4 * m, "h_roll": 0.1,
            "h_pitch": 0.15, "K_roll": 48.0 * m * rng.uniform(0.8, 1.3), "D_roll": 4.2 * m,
            "roll_front": float(rng.uniform(0.5, 0.62)), "K_pitch": 75.0 * m, "D_pitch": 6.2 * m,
        }  # fmt: skip
    return Vehicle(
        name="truth",
        m=m,
        L=L,
        l_f=l_f,
        h_cog=float(rng.uniform(0.45, 0.7)),
        C_kappa_f=float(C_kappa[0]),
        C_kappa_r=float(C_kappa[1]),
        C_alpha_f=float(C_f),
        C_alpha_r=float(C_r),
        mu=float(rng.uniform(0.8, 1.05)),
        R_f=float(rng.uniform(0.29, 0.38)),
        C_vert=math.inf if rng.uniform() < 0.5 else 2e5,
        I_wf=float(rng.uniform(2.0, 4.5)),
        I_wr=float(rng.uniform(2.0, 4.5)),
        K=float(0.5 * (C_f + C_r) / rng.uniform(0.2, 0.7)) if relaxed else math.inf,
        I_z=float(m * l_f * (L - l_f) * rng.uniform(0.94, 1.1)) if rng.uniform() < 0.5 else None,
        drive_front=float(rng.choice([0.0, 1.0])),
        brake_front=float(rng.uniform(0.55, 0.7)),
        **{name: float(value) for name, value in frame.items()},
    )
