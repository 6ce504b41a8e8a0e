"""A motion that several simulations share is integrated once, which changes no bit of what each of them reads."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cars import PAPER, RATE, REPORTED_BY, V, exciting, record_of

from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.sensors import GROUPS, MEASUREMENTS
from vehicle_sbi.physics.simulation import FINISHED, SENSOR_FIELDS, Motions, batch_simulator
from vehicle_sbi.physics.single_track import DRIVES, INPUTS

N = 12
MOVING = {"steering_ratio_gain": 1.1, "aero_drag_area": 0.5, "l_f": 1.2}


def differing(rng: np.random.Generator) -> np.ndarray:
    """Records of few motions, each read by sensors of several kinds."""
    records = np.repeat(record_of(PAPER), N)
    for row in range(N):
        moved = list(MOVING)[row % 4 : row % 4 + 1]
        for name in moved:
            records[name][row] = MOVING[name]
    for p in EFFECT_PARAMETERS.values():
        if p.fields[0] in SENSOR_FIELDS:
            some = rng.uniform(size=N) < 0.3
            records[p.fields[0]][some] = rng.uniform(p.low, p.high, N)[some]
    return records


def read(records: np.ndarray, motions: Motions, model: str, drive: str, initial: np.ndarray) -> np.ndarray:
    u = exciting(1.0)
    u[:, INPUTS.index("v_x")] = V + np.sin(np.arange(len(u)) / RATE)
    u[:, INPUTS.index("v_x_dot")] = np.cos(np.arange(len(u)) / RATE)
    u[:, INPUTS.index("wheel_speed_front")] = u[:, INPUTS.index("wheel_speed_rear")] = V / 0.31
    y, outcomes = np.empty((N, len(MEASUREMENTS), len(u))), np.full(N, -1)
    batch_simulator(model)(
        records.copy(), motions, DRIVES[drive], GROUPS.index("can"), u[None, :0, :3], u[None],
        np.zeros((N, 1, 4)), np.zeros((N, 1, 2)),
        RATE, np.array([2]), initial, np.arange(len(MEASUREMENTS)),
        np.array([GROUPS.index(group) for group in REPORTED_BY]), y, outcomes,
    )  # fmt: skip
    assert (outcomes == FINISHED).all()
    return y


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("model", ["single_track", "full_vehicle"])
def test_shared_motions_are_read_as_if_each_were_integrated(model: str, drive: str) -> None:
    records, initial = differing(np.random.default_rng(0)), np.zeros((N, 1, 3))
    initial[:, 0, 0] = V
    motions = Motions.shared(records, DRIVES[drive], initial)
    shared, alone = (read(records, one, model, drive, initial) for one in (motions, Motions.each(N)))
    np.testing.assert_array_equal(shared, alone)
    assert sorted(motions.order.tolist()) == list(range(N))
    if drive == "torque":
        assert len(motions.starts) - 1 == 4  # three that move differently, and the car as it is


@pytest.mark.parametrize("threads", [1, 3, 40])
def test_on_however_many_threads_and_from_however_many_at_once_all_is_the_same(
    threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    records, initial = differing(np.random.default_rng(1)), np.zeros((N, 1, 3))
    initial[:, 0, 0] = V

    def once(_: int) -> np.ndarray:
        return read(records, Motions.each(N), "single_track", "speed", initial)

    alone = once(0)
    monkeypatch.setattr("vehicle_sbi.threads._used", threads)
    with ThreadPoolExecutor(4) as callers:
        for found in callers.map(once, range(8)):
            np.testing.assert_array_equal(found, alone)


def test_what_is_drawn_keeps_motions_apart() -> None:
    records, initial = np.repeat(record_of(PAPER), 4), np.zeros((4, 1, 3))
    initial[:, 0, 0] = [V, V, V + 1.0, V]
    motions = Motions.shared(records, DRIVES["torque"], initial)
    assert [len(part) for part in np.split(motions.order, motions.starts[1:-1])] in ([3, 1], [1, 3])
