"""A simulated drive of any length: bends, straights, changes of speed and stops, as sensors of a car record them."""

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from vehicle_sbi.command import CONF
from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.noise import ConstantNoise
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.directions import responses
from vehicle_sbi.inference.setup import Setup
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.single_track import COMMANDS, INPUTS
from vehicle_sbi.physics.vehicle import read

NOISE = {"a_x": 0.05, "a_y": 0.05, "yaw_rate": 0.003, "wheel_speed_rear": 0.1, "v_x": 0.02, "steering": 2e-4}
SLOWEST, CRAWL = 1.0, 4.0  # [m/s] what the model is driven at in a stop, and below which nobody steers
HARDEST, TIGHTEST = 4.5, 0.08  # [m/s²] of lateral acceleration and [1/m] of curvature that the driver goes up to
MISSING = {"body_roll.gradient": 0.006}  # physics that the base model lacks


def long_drive(seconds: float, *, rate: float, vehicle: str, seed: int = 0) -> pd.DataFrame:
    """Steering, speed, accelerations, yaw rate and wheel speed in native columns; a car with some body roll."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate)
    car = read(str(CONF / "vehicle" / f"{vehicle}.yaml"))
    v_x = _speed(n, rate, rng)
    driven = np.maximum(v_x, SLOWEST)
    steering = _steering(driven, rate, float(nominal_record(car)["L"]), rng)
    channels = ("a_x", "a_y", "yaw_rate", "wheel_speed_rear")
    windows = _window(driven, steering, rate, channels)
    setup = Setup(
        vehicle=car, model="single_track", drive="speed", prior={"l_f": [1.1, 1.3]}, effects=[], window_s=seconds,
        warmup_s=0.0, noise=ConstantNoise(std=NOISE), seed=seed,
    )  # fmt: skip
    simulator = setup.simulator(setup.space(windows), windows, uniform_start=False)
    point = {EFFECT_PARAMETERS[name]: value for name, value in MISSING.items()}
    y = responses(simulator, np.array([car.l_f]), [point])[0]
    clean = {"steering": steering, "v_x": v_x, **dict(zip(channels, y, strict=True))}
    noisy = {CHANNELS[name].column: x + NOISE[name] * rng.standard_normal(n) for name, x in clean.items()}
    return pd.DataFrame({"time_s": np.arange(n) / rate, **noisy})


def _slow(n: int, rate: float, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance and a correlation time, twice filtered, so that its derivative is smooth."""
    a = np.exp(-1.0 / (rate * seconds))
    once = lfilter([1.0 - a], [1.0, -a], rng.standard_normal(n + round(20 * rate)))
    twice = lfilter([1.0 - a], [1.0, -a], once)[-n:]
    return twice / np.sqrt((1.0 - a) / 4.0)


def _speed(n: int, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Speed [m/s] between standstill and 35 m/s, changing over a quarter of a minute."""
    return np.clip(14.0 + 9.0 * _slow(n, rate, 12.0, rng), 0.0, 35.0)


def _steering(v_x: np.ndarray, rate: float, L: float, rng: np.random.Generator) -> np.ndarray:
    """Angle [rad] of the front wheels: bends between straights, and a driver who corrects."""
    bends = _slow(len(v_x), rate, 1.5, rng) * np.clip(_slow(len(v_x), rate, 30.0, rng), 0.0, None)
    curvature = np.clip(HARDEST * np.tanh(0.4 * bends) / v_x**2, -TIGHTEST, TIGHTEST)
    corrections = 0.002 * _slow(len(v_x), rate, 0.3, rng)
    return (L * curvature + corrections) * np.clip((v_x - SLOWEST) / CRAWL, 0.0, 1.0)


def _window(v_x: np.ndarray, steering: np.ndarray, rate: float, channels: tuple[str, ...]) -> Windows:
    """The whole drive as one window, from straight ahead."""
    n, t = len(v_x), np.arange(len(v_x)) / rate
    u = np.zeros((1, n, len(INPUTS)))
    for name, values in {"steering": steering, "v_x": v_x, "v_x_dot": np.gradient(v_x, 1.0 / rate), "time": t}.items():
        u[0, :, INPUTS.index(name)] = values
    return Windows(
        rate=rate,
        u=u,
        before=u[:, :0, : len(COMMANDS)],
        y=np.full((len(channels), n), np.nan),
        valid=np.ones((len(channels), n), dtype=bool),
        x0=np.array([[v_x[0], 0.0, 0.0]]),
        x0_std=np.zeros(3),
        channels=channels,
        groups=tuple(CHANNELS[name].group for name in channels),
        t=t[None],
    )
