"""What this project is compared with solves the same equations."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import simulator as bench
from peers.in_c import InC
from peers.in_numpy import InNumpy

from vehicle_sbi.physics.sensors import GROUPS
from vehicle_sbi.physics.simulation import Motions, batch_simulator
from vehicle_sbi.physics.single_track import DRIVES

N, TIME, RATE = 6, 3200, 1600.0
SINGLE = 1e-5  # series are stored in single precision, of wheel speeds below 64 rad/s: 2^-18


@pytest.fixture(scope="module")
def drives() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cars, initial speeds, commands, and this project's series; the last cars slide.

    Ports take wheels by the classical method, at RATE, where both methods have converged below a float32.
    """
    rng = np.random.default_rng(0)
    cars, v_0, u = bench.records(rng)[:N], rng.uniform(10.0, 11.0, N), bench.inputs()
    cars["mu"][N // 2 :] = 0.35
    t = np.arange(TIME) / RATE
    u = np.stack([np.interp(t, np.arange(u.shape[1]) / bench.RATE, column) for column in u[0].T], axis=1)[None]
    initial, y = np.zeros((N, 1, 3)), np.empty((N, 5, TIME), np.float32)
    initial[:, 0, 0] = v_0
    batch_simulator("single_track")(
        cars.copy(), Motions.each(N), DRIVES["torque"], GROUPS.index("can"), u[:, :0, :3], u,
        np.zeros((N, 1, 4)), np.zeros((N, 1, 2)), RATE,
        np.ones(1, np.int64), initial, np.arange(5), np.array([0, 0, 0, 2, 2]), y, np.zeros(N, np.int64),
    )  # fmt: skip
    return cars, v_0, np.ascontiguousarray(u[0][:, :3]), y


def test_the_model_in_numpy(drives: tuple[np.ndarray, ...]) -> None:
    cars, v_0, u, y = drives
    np.testing.assert_allclose(InNumpy(cars, v_0).simulated(u, RATE), y, rtol=0.0, atol=SINGLE)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_model_in_c(drives: tuple[np.ndarray, ...], tmp_path: Path) -> None:
    cars, v_0, u, y = drives
    np.testing.assert_allclose(InC(tmp_path)(cars, v_0, u, RATE, 1), y, rtol=0.0, atol=SINGLE)


def test_the_model_in_jax(drives: tuple[np.ndarray, ...]) -> None:
    pytest.importorskip("jax")
    from peers.in_c import CONSTANTS
    from peers.in_jax import simulated

    cars, v_0, u, y = drives
    for i in (0, N - 1):
        series = simulated({name: float(cars[name][i]) for name in CONSTANTS}, v_0[i], u, RATE)
        np.testing.assert_allclose(np.asarray(series), y[i], rtol=0.0, atol=SINGLE)
