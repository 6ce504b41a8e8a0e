"""A recording that the tests of diagnosis share: a car with some physics added, measured with noise of a known law."""

from dataclasses import replace

import numpy as np
from studies import constant_noise, simulator

from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.directions import responses
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.multistart import best
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.single_track import INPUTS

TRUTH = np.array([1.25, 0.05, -0.05])


def lateral(*, rho: float = 0.0, seconds: float = 10.0, known_start: bool = True) -> Simulator:
    """A sine on the steering at 12 m/s, driven by the measured speed; stiffnesses and l_f free."""
    sim = simulator(known_start=known_start, duration=seconds)
    u = sim.windows.u.copy()
    u[..., INPUTS.index("v_x")] = 12.0
    channels = ("a_x", "a_y", "yaw_rate")
    windows: Windows = replace(
        sim.windows, u=u, y=sim.windows.y[:3], valid=sim.windows.valid[:3], channels=channels, groups=("imu",) * 3
    )
    if not known_start:
        windows = replace(windows, x0_std=np.array([0.0, 0.05, 0.01]))
    return replace(sim, drive="speed", windows=windows).with_noise(constant_noise(windows, rho=rho))


def recorded(sim: Simulator, *, seed: int = 0, **effects: float) -> Observation:
    """What the car with effects (`effect__parameter=value`) would have recorded, and the simulator without them."""
    point = {EFFECT_PARAMETERS[name.replace("__", ".")]: value for name, value in effects.items()}
    clean = responses(sim, TRUTH, [point])[0]
    rng = np.random.default_rng(seed)
    return Observation(sim, clean + sim.noise.std(clean) * sim.noise.sample(clean.shape, rng), True)


def fitted(observation: Observation) -> Fit:
    space = observation.simulator.space
    return best(observation, (space.low + space.high)[None] / 2)
