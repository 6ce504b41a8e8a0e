"""Where the truth of a case comes from: a world drives a plan with effects and returns what ideal sensors would read.

`OwnModel` is the project's simulator (level L0). The twin and the multi-body car (L1) are in files of their own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from concealed.drives import Plan
from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.noise import DrawnProcessNoise, MeasurementNoise, Mixture
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.simulation import substeps_for
from vehicle_sbi.physics.single_track import COMMANDS, INPUTS
from vehicle_sbi.physics.vehicle import Vehicle

NONE = Mixture(np.zeros(0), np.zeros(0))
Effects = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value
Series = dict[str, np.ndarray]


class World(Protocol):
    """Drives a plan; None where the car leaves what its equations hold for."""

    def drive(self, plan: Plan, effects: Effects) -> Series | None: ...


def torques(car: Vehicle, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Axle torques [N m] for the plan's acceleration, m R a, split as the car splits drive and brake torque."""
    total = (car.m or 0.0) * (car.R_f or 0.0) * plan.acceleration
    front = np.where(total > 0.0, car.drive_front, car.brake_front) * total
    return front, total - front


def _whole(plan: Plan, u: np.ndarray) -> Windows:
    """The plan as one window from straight driving, with everything measured."""
    y = np.full((len(MEASUREMENTS), len(plan.t)), np.nan)
    return Windows(
        rate=plan.rate,
        u=u,
        before=u[:, :0, : len(COMMANDS)],
        y=y,
        valid=np.ones_like(y, dtype=bool),
        x0=np.array([[plan.v_0, 0.0, 0.0]]),
        x0_std=np.zeros(3),
        channels=MEASUREMENTS,
        groups=tuple(CHANNELS[name].group for name in MEASUREMENTS),
        t=plan.t[None],
    )


@dataclass(frozen=True, kw_only=True)
class OwnModel:
    """The project's simulator, driven over the whole recording from straight driving, in one go.

    In the drive mode `speed` the plan's speed is exact; in the others torques drive the truth, whatever the tool uses.
    """

    car: Vehicle
    model: str
    drive_mode: str
    gain: float  # of the steering, a base parameter

    def drive(self, plan: Plan, effects: Effects) -> Series | None:
        mode = "speed" if self.drive_mode == "speed" else "torque"
        u = np.zeros((1, len(plan.t), len(INPUTS)))
        front, rear = torques(self.car, plan)
        for name, values in (
            ("steering", plan.steering), ("torque_front", front), ("torque_rear", rear),
            ("v_x", plan.v_x), ("v_x_dot", plan.acceleration), ("time", plan.t),
        ):  # fmt: skip
            u[0, :, INPUTS.index(name)] = values
        zero = np.zeros(len(MEASUREMENTS))
        record = nominal_record(self.car, duration=float(plan.t[-1]))
        record["steering_ratio_gain"] = self.gain
        for effect, parameters in effects.items():
            for parameter, value in parameters.items():
                record[f"{effect}_{parameter}"] = value
        slowest = max(2.0, 0.7 * float(plan.v_x.min()))
        simulator = Simulator(
            nominal=record,
            space=ParameterSpace(()),
            model=self.model,
            drive=mode,
            windows=_whole(plan, u),
            process=DrawnProcessNoise(NONE, NONE, False),
            noise=MeasurementNoise(zero, zero, zero, len(plan.t)),
            uniform_start=False,
            substeps=substeps_for(np.array([record]), mode, slowest, plan.rate, model=self.model),
            seed=0,
        )
        y = simulator.noise_free(np.empty((1, 0)))
        if not np.isfinite(y).all() or y[0, MEASUREMENTS.index("v_x")].min() < 0.6 * plan.v_x.min():
            return None
        return dict(zip((*COMMANDS, *MEASUREMENTS), (plan.steering, front, rear, *y[0]), strict=True))
