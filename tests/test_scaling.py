"""Memory and time grow no faster than a recording: parts add up to the whole, and of a long drive a part is used."""

import os
import subprocess
import sys
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cars import RIGID
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from made_up import RATE, in_windows, recording
from recorded import lateral
from studies import constant_noise, paper_process, repeated, simulator
from test_study import drive, study
from tqdm import tqdm

from vehicle_sbi.data.noise import EstimatedNoise, MeasurementNoise
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference import features, rounds
from vehicle_sbi.inference.information import STEP, fisher, sensitivity
from vehicle_sbi.inference.informative import (
    MOST_DERIVATIVES,
    Chosen,
    affordable,
    chosen,
    informations,
    most_informative,
)
from vehicle_sbi.inference.setup import substeps
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.inference.study import MOST_READINGS
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.single_track import INPUTS

MIDDLE = np.array([1.25, 0.05, -0.1])
GIGABYTE = 2**30
MOST_MEMORY = 4 * GIGABYTE  # of a run on an hour


def in_parts(count: int, *, steered: Sequence[float] = ()) -> Simulator:
    """The same ten seconds over and over with uncertain starts, the steering as many times as large as `steered`."""
    sim = lateral(known_start=False)
    windows = repeated(sim.windows, count)
    u = windows.u.copy()
    u[..., INPUTS.index("steering")] *= np.array(steered or [1.0] * count)[:, None]
    windows = replace(windows, u=u)
    return replace(sim, windows=windows).with_noise(constant_noise(windows))


def test_windows_of_their_own_hold_what_they_held_among_others() -> None:
    windows = in_windows(recording(20.0))
    some = windows.only(np.array([2, 0]))
    length = windows.t.shape[1]
    whole = np.arange(windows.y.shape[1]).reshape(-1, length)[[2, 0]].reshape(-1)
    for name in ("y", "valid"):
        np.testing.assert_array_equal(getattr(some, name), getattr(windows, name)[:, whole])
    for name in ("u", "x0", "t"):
        np.testing.assert_array_equal(getattr(some, name), getattr(windows, name)[[2, 0]])
    assert some.recordings == windows.recordings[:2]
    fitted = some.valid[0, :length]
    np.testing.assert_allclose(some.y[0, :length][fitted] / RATE, some.t[0][fitted], rtol=1e-14)


@pytest.mark.parametrize("process", [{}, {"inputs": 0.03}])
def test_initial_states_of_all_windows_are_moved_at_once_and_no_number_changes(process: dict) -> None:
    sim = simulator(known_start=False, process=paper_process(**process))
    windows = replace(repeated(sim.windows, 4), x0_std=np.array([0.3, 0.0, 0.02]))
    sim = replace(sim, windows=windows).with_noise(constant_noise(windows))
    eta = np.random.default_rng(0).standard_normal(len(sim.nuisances))
    jacobian = sensitivity(sim, MIDDLE, eta).jacobian
    for k in range(len(eta)):
        up, down = eta.copy(), eta.copy()
        up[k], down[k] = eta[k] + STEP, eta[k] - STEP
        y = sim.noise_free(np.tile(MIDDLE, (2, 1)), np.stack([up, down]))
        np.testing.assert_array_equal(jacobian[len(MIDDLE) + k], (y[0] - y[1]) / (up[k] - down[k]))


def test_the_number_of_simulations_behind_a_derivative_does_not_grow_with_the_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted = list[int]()
    run = Simulator.run

    def counting(self: Simulator, theta: np.ndarray, *rest, **named):
        counted.append(len(theta))
        return run(self, theta, *rest, **named)

    monkeypatch.setattr(Simulator, "run", counting)
    for count in (1, 7):
        sensitivity(in_parts(count), MIDDLE)
    assert counted[0] == counted[1]


def test_noise_that_is_a_share_of_pilots_is_the_same_a_stretch_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = simulator()
    floor = np.full(len(sim.windows.channels), 0.1)
    sim = sim.with_noise(MeasurementNoise(0.1 * floor, floor, 0.0 * floor, sim.windows.t.shape[1]))
    pilot = np.random.default_rng(0).standard_normal((60, *sim.shape)).astype(np.float32)
    whole = features.usual_noise(sim, pilot)
    monkeypatch.setattr(features, "AT_ONCE", pilot.size // 7)
    np.testing.assert_array_equal(features.usual_noise(sim, pilot), whole)


def test_features_do_not_depend_on_how_many_series_are_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = simulator(process=paper_process())
    theta, rows = np.tile(MIDDLE, (20, 1)), np.arange(20)

    def found() -> tuple[np.ndarray, np.ndarray]:
        with tqdm(disable=True) as bar:
            return rounds.simulate_features(sim, theta, rows, round=0, summary=lambda y: y.mean(axis=-1), bar=bar)

    at_once = found()
    monkeypatch.setattr(rounds, "MOST_NUMBERS", 3 * int(np.prod(sim.shape)))
    for one, whole in zip(found(), at_once, strict=True):
        np.testing.assert_array_equal(one, whole)


def test_information_of_windows_adds_up_to_that_of_the_recording() -> None:
    sim = in_parts(5, steered=[0.2, 0.5, 1.0, 0.7, 0.1])
    whole = fisher(sim, MIDDLE)
    # Both solve for initial states, whose information differs by what differences of STEP round to.
    np.testing.assert_allclose(informations(sim, MIDDLE).sum(axis=0), whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


def test_a_window_in_which_the_simulation_fails_tells_nothing_and_spoils_no_other() -> None:
    sim = in_parts(3)
    u = sim.windows.u.copy()
    u[1, :, INPUTS.index("v_x")] = np.nan
    broken = replace(sim, windows=replace(sim.windows, u=u))
    each = informations(broken, MIDDLE)
    assert not each[1].any()
    np.testing.assert_array_equal(each[[0, 2]], informations(sim, MIDDLE)[[0, 2]])


def test_the_liveliest_windows_are_chosen_in_the_order_of_time() -> None:
    steered = [0.02, 1.0, 0.02, 0.02, 0.9, 0.02, 0.8, 0.02]
    sim = in_parts(len(steered), steered=steered)
    found = chosen(sim, 3)
    assert found.which.tolist() == [1, 4, 6]
    np.testing.assert_array_equal(chosen(sim, 3).which, found.which)
    assert (found.wider >= 1.0).all()
    # Five idle windows with a fiftieth of the steering hold about 5 / 2500 of the information, so little is lost.
    assert (found.wider < 1.05).all()


def test_each_window_is_integrated_in_the_steps_that_its_own_lowest_speed_needs() -> None:
    sim = in_parts(4)
    u = sim.windows.u.copy()
    u[1, :, INPUTS.index("v_x")] = 1.2  # a tenth of the others' speed, at which rigid tyres are ten times as quick
    x0 = sim.windows.x0.copy()
    x0[1, 0] = 1.2
    crawling = replace(sim, nominal=nominal_record(RIGID), windows=replace(sim.windows, u=u, x0=x0))
    crawling = replace(crawling, substeps=substeps(crawling))
    steps = crawling.substeps
    assert isinstance(steps, np.ndarray)
    assert steps[1] > 5 * steps[0]
    assert (np.delete(steps, 1) == steps[0]).all()
    y, fine = (one.noise_free(MIDDLE[None])[0] for one in (crawling, replace(crawling, substeps=10 * steps)))
    np.testing.assert_allclose(y, fine, atol=1e-3 * np.abs(fine).max())
    alone = [crawling.only(np.array([w])).noise_free(MIDDLE[None])[0] for w in range(4)]
    np.testing.assert_array_equal(np.concatenate(alone, axis=1), y)


@given(seed=st.integers(0, 2**32 - 1), windows=st.integers(2, 7), count=st.integers(1, 5))
def test_what_is_chosen_tells_at_least_1_less_1_over_e_of_the_most_that_as_many_can(
    seed: int, windows: int, count: int
) -> None:
    count = min(count, windows)
    root = np.random.default_rng(seed).standard_normal((windows, 3, 2))
    each = root @ root.transpose(0, 2, 1)

    def told(which: Sequence[int]) -> float:
        return float(np.linalg.slogdet(np.eye(3) + each[list(which)].sum(axis=0))[1])

    which = most_informative(each, count)
    assert len(set(which.tolist())) == count
    assert which.tolist() == sorted(which.tolist())
    best = max(told(some) for some in combinations(range(windows), count))
    assert told(which.tolist()) >= (1.0 - 1.0 / np.e) * best - 1e-12


def test_of_windows_that_tell_as_much_the_earlier_ones_are_chosen() -> None:
    assert most_informative(np.tile(np.eye(2), (5, 1, 1)), 2).tolist() == [0, 1]


@given(
    count=st.integers(1, 500),
    readings=st.integers(20, 6000),
    states=st.integers(0, 3),
    d=st.integers(1, 12),
    most=st.integers(1, 200_000),
)
def test_as_many_windows_are_affordable_as_the_budget_holds_and_one_at_least(
    count: int, readings: int, states: int, d: int, most: int
) -> None:
    k = affordable(count, most, readings=readings, states=states, d=d)

    def holds(k: int) -> bool:
        return k * readings <= most and k * readings * (d + states * k) <= MOST_DERIVATIVES

    assert 1 <= k <= count
    assert k == 1 or holds(k)
    assert k == count or not holds(k + 1)


def test_memory_of_choosing_does_not_grow_with_the_recording() -> None:
    """Beyond the recording itself: what a window holds while it is looked at is given back before the next one."""
    peaks, sim = [], in_parts(1)
    for count in (2, 12):
        sim = in_parts(count)
        informations(sim, MIDDLE)
        tracemalloc.start()
        informations(sim, MIDDLE)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Small matrices are all that ten further windows add: less than what one of them is driven by.
    assert peaks[1] - peaks[0] < sim.windows.u[0].nbytes


def test_of_a_recording_beyond_its_budget_the_windows_that_tell_most_are_used(tmp_path: Path) -> None:
    settings = {"recording": drive(tmp_path, std=0.1), "drive": "speed", "truth": None}
    settings |= {"noise": EstimatedNoise(model_residual=False)}
    whole, some = (study(**settings, most_readings=most).prepare() for most in (MOST_READINGS, 3500))
    all_windows, windows = whole.problem.simulator.windows, some.problem.simulator.windows
    assert len(all_windows.t) == 8
    assert windows.y.size == 3000  # windows of 1000 readings
    assert np.isin(windows.t[:, 0], all_windows.t[:, 0]).all()
    assert (np.diff(windows.t[:, 0]) > 0).all()
    assert windows.u[0, 0, INPUTS.index("time")] == 0.0
    np.testing.assert_array_equal(some.problem.observed, np.where(windows.valid, windows.y, 0.0))
    assert [note for note in some.notes if "3 of 8 windows" in note and "most_readings = 3500" in note]
    assert not [note for note in whole.notes if "windows" in note]


def test_a_budget_is_a_number_of_readings() -> None:
    for wrong in (0, -5, 0.5, True):
        with pytest.raises(InputError, match="most_readings"):
            study(most_readings=wrong)
    assert study(most_readings=None).most_readings is None


def test_what_the_others_would_bring_is_said() -> None:
    windows = in_windows(recording(20.0))
    said = Chosen(np.array([0, 2]), np.array([1.5, 1.5, 9.0])).sentence(windows, 1000)
    assert said.startswith("2 of 4 windows (10 s) were used")
    assert "1.5 times smaller" in said
    assert "most_readings = 1000" in said


def test_where_initial_states_fill_memory_a_longer_window_is_asked_for_and_not_a_larger_budget() -> None:
    windows = in_windows(recording(20.0))
    said = Chosen(np.array([0, 2]), np.ones(3)).sentence(windows, 100_000)
    assert "window_s" in said
    assert "most_readings" not in said


@pytest.fixture(scope="module")
def hour(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An hour at 200 Hz, made in a process of its own: a child's peak memory begins with that of its parent."""
    path = tmp_path_factory.mktemp("hour") / "drive.parquet"
    drive = "long_drive(3600.0, rate=200.0, vehicle='bmw320i')"
    make = f"import sys; from long_drive import long_drive; {drive}.to_parquet(sys.argv[1])"
    paths = os.pathsep.join([str(ROOT), str(ROOT / "benchmarks")])
    subprocess.run([sys.executable, "-c", make, str(path)], env=os.environ | {"PYTHONPATH": paths}, check=True)
    assert len(pd.read_parquet(path)) == 720_000
    return path


def peak(script: str, *arguments: str) -> tuple[float, str]:
    """Peak resident set [byte] of a script that ends well, and what it printed."""
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True); "
        "print('peak', 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [sys.executable, "-c", code, sys.executable, f"scripts/{script}.py", *arguments]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return float(run.stdout.rsplit("peak", 1)[1]), run.stdout


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_run_takes_an_hour_at_200_hz_in_less_than_4_gigabytes(hour: Path, tmp_path: Path) -> None:
    # Fewer simulations than the default, but all pilots, which are in memory at once.
    few = [
        f"rounds.simulations={rounds.PILOT}",
        "rounds.rounds=1",
        "rounds.last=1",
        "training.max_epochs=3",
        "samples=200",
    ]
    folder = tmp_path / "run"
    memory, said = peak("run", f"recording={hour}", "vehicle=bmw320i", f"hydra.run.dir={folder}", *few)
    assert memory < MOST_MEMORY
    assert "windows" in said
    assert f"most_readings = {MOST_READINGS}" in (folder / "table.md").read_text()


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_observability_takes_an_hour_at_200_hz_in_less_than_4_gigabytes(hour: Path) -> None:
    memory, said = peak("observability", f"recording={hour}", "vehicle=bmw320i")
    assert memory < MOST_MEMORY
    assert f"most_readings = {MOST_READINGS}" in said
