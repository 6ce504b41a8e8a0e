"""A short study that the tests of inference share: the paper's car in its own manoeuvre, with noise of a known law."""

from dataclasses import replace
from typing import Any

import numpy as np
from cars import PAPER

from vehicle_sbi.data.manoeuvre import Manoeuvre
from vehicle_sbi.data.noise import DrawnProcessNoise, MeasurementNoise, Mixture, ProcessNoise
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.rng import Stream, generator

QUIET = DrawnProcessNoise(Mixture(np.zeros(0), np.zeros(0)), Mixture(np.zeros(0), np.zeros(0)), False)
PRIOR = {"l_f": [1.0, 1.5], "delta_C_alpha_f": [-0.3, 0.3], "delta_C_alpha_r": [-0.3, 0.3]}
STD = {"a_x": 0.15, "a_y": 0.15, "yaw_rate": 0.005, "wheel_speed_front": 0.1, "wheel_speed_rear": 0.1}


def manoeuvre(**changes: Any) -> Manoeuvre:
    """The paper's mild manoeuvre at a quarter of its rate, which is enough for an integrator of four substeps."""
    settings: dict[str, Any] = {"name": "mild", "steering_amplitude": 0.06, "rate": 50.0}
    settings.update({"drive_torque": 600.0, "brake_torque": -900.0} | changes)
    return Manoeuvre(**settings)


def constant_noise(windows: Windows, *, rho: float = 0.0, factor: float = 1.0) -> MeasurementNoise:
    """A standard deviation that does not depend on the signal, correlated as rho^lag."""
    floor = factor * np.array([STD[name] for name in windows.channels])
    return MeasurementNoise(np.zeros(len(floor)), floor, np.full(len(floor), rho), windows.t.shape[1])


def paper_process(**settings: Any) -> DrawnProcessNoise:
    return ProcessNoise(**settings).draw(generator(seed=0, stream=Stream.STUDY))


def simulator(
    prior: dict | None = None,
    *,
    process: DrawnProcessNoise = QUIET,
    noise: MeasurementNoise | None = None,
    known_start: bool = True,
    **driven: Any,
) -> Simulator:
    """The paper's car with constant noise; without process noise and from a known speed unless asked otherwise."""
    windows = manoeuvre(**driven).windows(PAPER)
    if known_start:
        windows = replace(windows, x0_std=np.zeros(3))
    return Simulator(
        nominal=nominal_record(PAPER),
        space=parameter_space(prior or PRIOR, vehicle=PAPER, model="single_track"),
        model="single_track",
        drive="torque",
        windows=windows,
        process=process,
        noise=noise or constant_noise(windows),
        uniform_start=True,
        substeps=4,
        seed=3,
    )


def repeated(windows: Windows, times: int) -> Windows:
    """The same window several times over, as independent repetitions of a drive."""
    return replace(
        windows,
        u=np.repeat(windows.u, times, axis=0),
        before=np.repeat(windows.before, times, axis=0),
        y=np.tile(windows.y, times),
        valid=np.tile(windows.valid, times),
        x0=np.repeat(windows.x0, times, axis=0),
        t=np.repeat(windows.t, times, axis=0),
    )
