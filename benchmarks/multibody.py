"""The full vehicle model beside CommonRoad's multi-body car: residual per channel, and how much of it is tyre shape.

    .venv/bin/python benchmarks/multibody.py            half a minute; results/multibody.md

The multi-body car (commonroad-vehicle-models, after a model of the US DOT) has 29 states: a sprung and two unsprung
masses, compliant joints, camber, Pacejka tyres. It is driven by the same steering and wheel torques on its own
parameter sets 1 to 3 (Ford Escort, BMW 320i, VW Vanagon), once on its own tyres and once on Dugoff's, which the full
vehicle model has: what remains in the second case is the body's, what it adds in the first the tyre's. The largest
part of the former: the multi-body car takes the tyres' slip angles from the velocity of its swaying sprung mass, the
full vehicle model from that of the axles. Its axes are SAE
(y right, z down); angles and rates about x and y change their sign on the way to ISO 8855.
"""

import math
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from vehiclemodels import vehicle_dynamics_mb
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.parameters_vehicle3 import parameters_vehicle3

from vehicle_sbi.physics.record import RECORD, nominal_record
from vehicle_sbi.physics.sensors import GROUPS, MEASUREMENTS, tilted
from vehicle_sbi.physics.simulation import FINISHED, Motions, batch_simulator, substeps_for
from vehicle_sbi.physics.single_track import DRIVES, INPUTS
from vehicle_sbi.physics.tyre import dugoff
from vehicle_sbi.physics.vehicle import GRAVITY, Vehicle
from vehicle_sbi.report.tables.text import markdown

RESULT = Path(__file__).resolve().parent / "results" / "multibody.md"
SETS: dict[int, Callable[[], Any]] = {1: parameters_vehicle1, 2: parameters_vehicle2, 3: parameters_vehicle3}
CHANNELS = ("a_x", "a_y", "yaw_rate", "roll_rate", "pitch_rate", "v_x", "v_y")
RATE, STEPS = 200.0, 5  # Hz, and Runge-Kutta steps of 1 ms in between
SPEED, SECONDS = 15.0, 5.0
STEERING, PERIOD, BRAKE_FROM, DECELERATION = 0.03, 2.0, 2.5, 2.0


def in_series(spring: float, tyre: float) -> float:
    """Stiffness of a suspension spring that stands on a tyre."""
    return spring * tyre / (spring + tyre)


def vehicle_of(p: Any, name: str) -> Vehicle:
    """Our constants of a CommonRoad parameter set; tyres linearised about straight driving at their static loads."""
    L, weight = p.a + p.b, p.m * 9.81
    loads = {"f": weight * p.b / L, "r": weight * p.a / L}
    roll_f = in_series(p.K_sf * p.T_f**2 / 2 - p.K_tsf, p.K_zt * p.T_f**2 / 2)
    roll_r = in_series(p.K_sr * p.T_r**2 / 2 - p.K_tsr, p.K_zt * p.T_r**2 / 2)
    return Vehicle(
        name=name,
        m=p.m,
        L=L,
        l_f=p.a,
        h_cog=p.h_cg,
        C_kappa_f=p.tire.p_kx1 * loads["f"],
        C_kappa_r=p.tire.p_kx1 * loads["r"],
        C_alpha_f=-p.tire.p_ky1 * loads["f"],
        C_alpha_r=-p.tire.p_ky1 * loads["r"],
        mu=p.tire.p_dy1,
        R_f=p.R_w,
        I_wf=2 * p.I_y_w,
        I_wr=2 * p.I_y_w,
        I_z=p.I_z,
        track_f=p.T_f,
        track_r=p.T_r,
        m_s=p.m_s,
        I_x=p.I_Phi_s,
        I_y=p.I_y_s,
        h_roll=(p.h_raf * p.b + p.h_rar * p.a) / L,
        h_pitch=0.0,
        K_roll=roll_f + roll_r,
        D_roll=(p.K_sdf * p.T_f**2 + p.K_sdr * p.T_r**2) / 2,
        roll_front=roll_f / (roll_f + roll_r),
        K_pitch=2 * (in_series(p.K_sf, p.K_zt) * p.a**2 + in_series(p.K_sr, p.K_zt) * p.b**2),
        D_pitch=2 * (p.K_sdf * p.a**2 + p.K_sdr * p.b**2),
    )


def commands() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], road-wheel angle [rad] and deceleration asked for [m/s^2, negative] at each sample."""
    t = np.arange(round(SECONDS * RATE) + 1) / RATE
    delta = STEERING * np.sin(2 * math.pi * t / PERIOD)
    ramp = np.clip((t - BRAKE_FROM) / 0.2, 0.0, 1.0)
    return t, delta, -DECELERATION * ramp


@contextmanager
def dugoff_tyres(p: Any) -> Iterator[None]:
    """The multi-body car on Dugoff's tyres, as stiff per newton of load as its own, without camber.

    Its formulas for pure slip, which know the load, hand it to those for combined slip, which here are Dugoff's.
    """
    tyres: Any = vehicle_dynamics_mb.tireModel
    names = ("formula_longitudinal", "formula_lateral", "formula_longitudinal_comb", "formula_lateral_comb")
    kept = {name: getattr(tyres, name) for name in names}
    C_kappa, C_alpha = p.tire.p_kx1, -p.tire.p_ky1  # per newton of load

    def force(slip: float, alpha: float, F_z: float) -> tuple[float, float]:
        return dugoff(C_kappa * F_z, C_alpha * F_z, p.tire.p_dy1, F_z, max(-slip, -1.0), math.tan(alpha))

    tyres.formula_longitudinal = lambda slip, gamma, F_z, tyre: F_z
    tyres.formula_lateral = lambda alpha, gamma, F_z, tyre: [F_z, 1.0]
    tyres.formula_longitudinal_comb = lambda slip, alpha, F_z, tyre: force(slip, -alpha, F_z)[0]
    tyres.formula_lateral_comb = lambda slip, alpha, gamma, mu, F_z, F0, tyre: force(slip, -alpha, F_z)[1]
    try:
        yield
    finally:
        for name, formula in kept.items():
            setattr(tyres, name, formula)


def multibody(p: Any) -> dict[str, np.ndarray]:
    """CHANNELS of the multi-body car in ISO axes, v_y as its tyres see it; road-wheel angle and the body's sway [m/s].

    Integrated by classical Runge-Kutta steps.
    """
    t, delta, braking = commands()
    slope, dt = np.gradient(delta, t), 1.0 / RATE / STEPS
    # The car asks for an acceleration and makes of it torques m R a, split between the axles by itself.
    x = np.array(init_mb([0.0, 0.0, delta[0], SPEED, 0.0, 0.0, 0.0], p))
    rows = []

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        u = [np.interp(time, t, slope), np.interp(time, t, braking)]
        return np.array(vehicle_dynamics_mb.vehicle_dynamics_mb(list(state), u, p))

    for k in range(len(t)):
        f = rate(t[k], x)
        roll, pitch = -x[6], -x[8]
        a_x, a_y, _ = tilted(f[3] - x[5] * x[10], f[10] + x[5] * x[3], GRAVITY, roll, pitch)
        w_x, w_y, w_z = tilted(0.0, 0.0, x[5], roll, pitch)  # of its gyro, which leans with the body
        sway = p.h_s * x[7]  # of the sprung mass over the axles, to the left, in ISO axes
        rows.append((a_x, a_y, w_z, w_x - x[7], w_y - x[9], x[3], x[10], x[2], sway))
        if k + 1 < len(t):
            for step in range(STEPS):
                now = t[k] + step * dt
                k1 = rate(now, x)
                k2 = rate(now + dt / 2, x + dt / 2 * k1)
                k3 = rate(now + dt / 2, x + dt / 2 * k2)
                k4 = rate(now + dt, x + dt * k3)
                x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return dict(zip((*CHANNELS, "delta", "sway"), np.array(rows).T, strict=True))


def full_vehicle(p: Any, delta: np.ndarray, **effects: float) -> dict[str, np.ndarray]:
    """CHANNELS of the full vehicle model under the same road-wheel angle and torques, with effects as given."""
    t, _, braking = commands()
    car = vehicle_of(p, "car")
    record = np.full(1, nominal_record(car), dtype=RECORD)
    for name, value in effects.items():
        record[name] = value
    u = np.zeros((1, len(t), len(INPUTS)))
    u[0, :, INPUTS.index("steering")], u[0, :, INPUTS.index("time")] = delta, t
    u[0, :, INPUTS.index("torque_front")] = p.T_sb * p.m * p.R_w * braking
    u[0, :, INPUTS.index("torque_rear")] = (1 - p.T_sb) * p.m * p.R_w * braking
    y, outcome = np.empty((1, len(MEASUREMENTS), len(t))), np.zeros(1, np.int64)
    substeps = np.array([substeps_for(record, "torque", 3.0, RATE, model="full_vehicle")])
    none, start = (np.zeros((1, 1, 4)), np.zeros((1, 1, 2))), np.array([[[SPEED, 0.0, 0.0]]])
    rows, groups = np.arange(len(MEASUREMENTS)), np.full(len(MEASUREMENTS), GROUPS.index("imu"))
    driven = Motions.each(1), DRIVES["torque"], GROUPS.index("can"), u[:, :0, :3], u
    batch_simulator("full_vehicle")(record, *driven, *none, RATE, substeps, start, rows, groups, y, outcome)
    assert outcome[0] == FINISHED
    return {name: y[0, MEASUREMENTS.index(name)] for name in CHANNELS}


def nrmse(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> dict[str, float]:
    """Root mean square of the residual of each channel over the channel's standard deviation."""
    return {c: float(np.sqrt(np.mean((ours[c] - theirs[c]) ** 2)) / theirs[c].std()) for c in CHANNELS}


def compare(number: int) -> pd.DataFrame:
    """One parameter set: residual on its own tyres, on Dugoff's, and with our tyres made more like its own."""
    p = SETS[number]()
    own = multibody(p)
    with dugoff_tyres(p):
        same = multibody(p)
    shaped = {"load_sensitivity_coefficient": 1.0}
    rows = {
        "its own tyres": nrmse(full_vehicle(p, own["delta"]), own),
        "its own tyres, ours load-sensitive": nrmse(full_vehicle(p, own["delta"], **shaped), own),
        "its own, ours load-sensitive and peaked": nrmse(
            full_vehicle(p, own["delta"], **shaped, tyre_curve_peak=1.0), own
        ),
        "Dugoff's tyres on both": nrmse(full_vehicle(p, same["delta"], **shaped), same),
    }
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("multi-body car on").reset_index()
    table.insert(0, "set", number)
    return table


def main() -> None:
    table = pd.concat([compare(number) for number in SETS])
    text = markdown(table.map(lambda v: f"{v:.3f}" if isinstance(v, float) else str(v)))
    where = f"{date.today()}, {platform.platform()}"
    RESULT.write_text(
        "Residual of the full vehicle model against the multi-body car, root mean square over the channel's standard\n"
        f"deviation; sine steering with braking from {BRAKE_FROM} s on.\n\n{text}\n{where}.\n"
    )
    print(text)


if __name__ == "__main__":
    main()
