"""Simulations per second of both models, what the catalogue costs at its null, and how long the first call compiles.

    make bench-simulator

Each contender compiles in a process of its own with an empty cache; then they take turns, so that a busy machine slows
all of them alike. `bare` is the single-track model with every effect replaced by what is left of it at its null.
"""

import multiprocessing
import os
import platform
import resource
import sys
import tempfile
import time
from datetime import date
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

SIMULATIONS, SAMPLES, RATE, REPEATS = 5000, 1000, 200.0, 7
CONTENDERS = {"single_track": "single_track", "bare": "single_track", "full_vehicle": "full_vehicle"}
RESULT = Path(__file__).resolve().parent / "results" / "simulator.md"


def strip() -> None:
    """Take the effects out of the equations of motion, actuators and sensors, before anything is compiled."""
    from vehicle_sbi.compiled import compiled as njit
    from vehicle_sbi.physics import balance, sensors, simulation, single_track
    from vehicle_sbi.physics.axle import AxleForce, mixed
    from vehicle_sbi.physics.tyre import dugoff

    balance.body_load = njit(lambda p, v_x, t, course: (0.0, 0.0, 0.0))
    balance.downforce = njit(lambda p, v_x: (0.0, 0.0))
    balance.friction_step = njit(lambda p, mu, t: mu)
    balance.road_grade = njit(lambda p, t: 0.0)
    balance.roll_steer = njit(lambda p, a_y: 0.0)
    balance.steering_compliance = njit(lambda p, F_yf: 0.0)

    @njit
    def axle_force(p, axle, slips, a_y):
        kappa = mixed(slips.share, slips.lagged, slips.kappa)
        F_x, F_y = dugoff(axle.C_kappa, axle.C_alpha, axle.mu, axle.F_z, kappa, slips.tan_right)
        return AxleForce(F_x, F_y, 0.0, 0.0, 0.0, 0.0, 0.0, True)

    @njit
    def steer(p, command, rate, out):
        for k in range(len(command)):
            out[k] = command[k]

    @njit
    def torques(p, front, rear, k, rate):
        return front[k], rear[k]

    @njit
    def measure(p, motion, t, rate, y):
        for k in range(motion.shape[0]):
            y[0, k], y[1, k], y[2, k] = motion[k, 3], motion[k, 4], motion[k, 2]
            y[3, k], y[4, k], y[5, k], y[6, k] = motion[k, 6], motion[k, 7], motion[k, 0], motion[k, 1]
            y[7, k], y[8, k], y[9, k] = sensors.GRAVITY, motion[k, 10], motion[k, 11]

    @njit
    def report(p, signal, group, row, rate, out):
        for k in range(len(signal)):
            out[k] = signal[k]

    single_track.axle_force = axle_force
    simulation.steer, simulation.torques, simulation.measure, simulation.report = steer, torques, measure, report


def inputs() -> np.ndarray:
    """The paper's manoeuvre: a sine on the steering, a square wave of torque; shape (1, time, 9)."""
    from vehicle_sbi.physics.single_track import INPUTS

    t = np.arange(SAMPLES) / RATE
    driving = (t % 5.0) < 2.5
    u = np.zeros((1, SAMPLES, len(INPUTS)))
    u[0, :, 0] = 0.06 * np.sin(2 * np.pi * t / 4.0)
    u[0, :, 1] = np.where(driving, 600.0, -540.0)
    u[0, :, 2] = np.where(driving, 0.0, -360.0)
    u[0, :, 7] = t
    return u


def records(rng: np.random.Generator) -> np.ndarray:
    """The paper's car with its six parameters drawn from the prior of Table II."""
    from vehicle_sbi.physics.record import nominal_record
    from vehicle_sbi.physics.vehicle import read

    nominal = nominal_record(read("conf/vehicle/paper.yaml"))
    p = np.full(SIMULATIONS, nominal, dtype=nominal.dtype)
    p["l_f"], p["h_cog"] = rng.uniform(1.0, 1.5, SIMULATIONS), rng.uniform(0.2, 0.6, SIMULATIONS)
    for name, low, high in (("C_kappa", -2e4, 5e4), ("C_alpha", -3e4, 3e4)):
        for axle in "fr":
            p[f"{name}_{axle}"] += rng.uniform(low, high, SIMULATIONS)
    return p


def contend(name: str, turns: Connection) -> None:
    """Simulate once per message and answer with the seconds; at the end, with the peak memory [MB]."""
    with tempfile.TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"] = cache
        if name == "bare":
            strip()
        from vehicle_sbi.physics.sensors import GROUPS
        from vehicle_sbi.physics.simulation import Motions, batch_simulator
        from vehicle_sbi.physics.single_track import DRIVES

        rng = np.random.default_rng(0)
        initial = np.zeros((SIMULATIONS, 1, 3))
        initial[:, 0, 0] = rng.uniform(10.0, 11.0, SIMULATIONS)
        y, outcomes = np.empty((SIMULATIONS, 5, SAMPLES), np.float32), np.zeros(SIMULATIONS, np.int64)
        noise = np.zeros((SIMULATIONS, 1, 4)), np.zeros((SIMULATIONS, 1, 2))
        fixed = (RATE, np.ones(1, np.int64), initial, np.arange(5), np.array([0, 0, 0, 2, 2]), y, outcomes)
        while turns.recv():
            p, start = records(rng), time.perf_counter()
            u = inputs()
            driven = Motions.each(SIMULATIONS), DRIVES["torque"], GROUPS.index("can"), u[:, :0, :3], u
            batch_simulator(CONTENDERS[name])(p, *driven, *noise, *fixed)
            turns.send(time.perf_counter() - start)
            assert not outcomes.any()  # every simulation is finished
        turns.send(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    spawn = multiprocessing.get_context("spawn")
    ends, seconds = {}, {name: [] for name in CONTENDERS}
    for name in CONTENDERS:
        ends[name], other = spawn.Pipe()
        spawn.Process(target=contend, args=(name, other), daemon=True).start()
    for _ in range(REPEATS + 1):
        for name, end in ends.items():
            end.send(True)
            seconds[name].append(end.recv())
    lines = [
        f"{SIMULATIONS} simulations of {SAMPLES} samples, {os.cpu_count()} cores, {date.today()}, {platform.platform()}"
    ]
    for name, end in ends.items():
        end.send(False)
        first, rest = seconds[name][0], seconds[name][1:]
        lines.append(
            f"{name}: median {np.median(rest):.2f} s, {min(rest):.2f} to {max(rest):.2f} s; "
            f"first call {first:.1f} s with an empty cache; peak memory {end.recv():.0f} MB"
        )
    pairs = np.divide(seconds["single_track"][1:], seconds["bare"][1:])
    lines.append(
        f"the catalogue at its null costs {np.median(pairs):.2f} times the bare model (median of {REPEATS} pairs)"
    )
    lines.append(f"simulations_per_second: {SIMULATIONS / np.median(seconds['single_track'][1:]):.0f}")
    print("\n".join(lines))
    if "--record" in sys.argv:
        RESULT.write_text("\n".join(f"- {line}" for line in lines) + "\n")


if __name__ == "__main__":
    main()
