"""Simulations per second of the paper's study, and how long the first call compiles.

make bench-simulator
"""

import resource
import time

import numpy as np

from vehicle_sbi.physics.effects import nominal_record
from vehicle_sbi.physics.simulation import simulate_batch
from vehicle_sbi.physics.vehicle import read

SIMULATIONS, SAMPLES, RATE, REPEATS = 5000, 1000, 200.0, 7


def inputs() -> np.ndarray:
    """The paper's manoeuvre: a sine on the steering, a square wave of torque; shape (1, time, 7)."""
    t = np.arange(SAMPLES) / RATE
    driving = (t % 5.0) < 2.5
    u = np.zeros((1, SAMPLES, 7))
    u[0, :, 0] = 0.06 * np.sin(2 * np.pi * t / 4.0)
    u[0, :, 1] = np.where(driving, 600.0, -540.0)
    u[0, :, 2] = np.where(driving, 0.0, -360.0)
    return u


def records(rng: np.random.Generator) -> np.ndarray:
    """The paper's car with its six parameters drawn from the prior of Table II."""
    nominal = nominal_record(read("conf/vehicle/paper.yaml"))
    p = np.full(SIMULATIONS, nominal, dtype=nominal.dtype)
    p["l_f"], p["h_cog"] = rng.uniform(1.0, 1.5, SIMULATIONS), rng.uniform(0.2, 0.6, SIMULATIONS)
    for name, low, high in (("C_kappa", -2e4, 5e4), ("C_alpha", -3e4, 3e4)):
        for axle in "fr":
            p[f"{name}_{axle}"] += rng.uniform(low, high, SIMULATIONS)
    return p


def main() -> None:
    rng = np.random.default_rng(0)
    initial = np.zeros((SIMULATIONS, 1, 3))
    initial[:, 0, 0] = rng.uniform(10.0, 11.0, SIMULATIONS)
    y = np.empty((SIMULATIONS, 5, SAMPLES), np.float32)
    outcomes = np.zeros(SIMULATIONS, np.int64)
    noise = np.zeros((SIMULATIONS, 1, 4)), np.zeros((SIMULATIONS, 1, 2))
    fixed = (RATE, 1, initial, np.arange(5), np.array([0, 0, 0, 2, 2]), y, outcomes)
    seconds = []
    for _ in range(REPEATS + 1):
        p, start = records(rng), time.perf_counter()
        simulate_batch(p, 0, inputs(), *noise, *fixed)
        seconds.append(time.perf_counter() - start)
    median = float(np.median(seconds[1:]))
    print(f"first call: {seconds[0]:.2f} s (compiles, or loads the compiled code from disk)")
    spread = f"{min(seconds[1:]):.2f} to {max(seconds[1:]):.2f} s"
    print(f"{SIMULATIONS} simulations of {SAMPLES} samples: median {median:.2f} s, {spread}")
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    print(f"simulations_per_second: {SIMULATIONS / median:.0f}")


if __name__ == "__main__":
    main()
