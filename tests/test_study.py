"""From what a user configures to a problem: synthetic or recorded, reproducible from the seed, refused where wrong."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cars import PAPER
from studies import PRIOR, STD, manoeuvre, simulator

from vehicle_sbi.data.manoeuvre import Synthetic
from vehicle_sbi.data.noise import ConstantNoise, EstimatedNoise, ProcessNoise
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.information import fisher
from vehicle_sbi.inference.setup import _slowest_believed, slowest
from vehicle_sbi.inference.study import Study
from vehicle_sbi.inference.training import Training
from vehicle_sbi.physics.simulation import fastest_rate
from vehicle_sbi.physics.single_track import INPUTS

TRUTH = {"l_f": 1.2, "delta_C_alpha_f": 0.1, "delta_C_alpha_r": -0.1}
BASE: dict[str, Any] = {
    "vehicle": PAPER,
    "model": "single_track",
    "drive": "torque",
    "prior": PRIOR,
    "effects": [],
    "recording": Synthetic(manoeuvre=manoeuvre()),
    "window_s": 5.0,
    "warmup_s": 0.5,
    "noise": ConstantNoise(std=STD),
    "features": Score(),
    "estimator": NeuralSplineFlow(),
    "training": Training(),
    "truth": TRUTH,
    "seed": 3,
}


def study(**changes: Any) -> Study:
    return Study(**BASE | changes)


def test_a_synthetic_study_observes_a_simulation_of_its_truth() -> None:
    prepared = study(noise=ConstantNoise(std=STD, process=ProcessNoise(stiffness=0.0))).prepare()
    sim = prepared.problem.simulator
    assert prepared.truth is not None
    np.testing.assert_array_equal(prepared.truth, list(TRUTH.values()))
    # Between the initial speed's ends the lateral signals hardly change: the noise-free ones at its middle are near.
    clean = sim.noise_free(prepared.truth[None])[0]
    residual = prepared.problem.observed - clean
    assert residual[1].std() < 2 * STD["a_y"]
    assert prepared.inputs == {}
    assert prepared.recordings == ()


def test_a_study_is_a_pure_function_of_its_configuration() -> None:
    first, again, other = (study(seed=seed).prepare() for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.problem.observed, again.problem.observed)
    assert (first.problem.observed != other.problem.observed).any()
    means = [p.problem.simulator.process.stiffness.means for p in (first, again, other)]
    np.testing.assert_array_equal(means[0], means[1])
    assert (means[0] != means[2]).all()


def test_a_truth_that_is_not_stated_is_drawn_from_the_prior_by_the_seed() -> None:
    truths = [study(truth=None, seed=seed).prepare().truth for seed in (0, 0, 1)]
    assert all(truth is not None for truth in truths)
    np.testing.assert_array_equal(truths[0], truths[1])
    assert (truths[0] != truths[2]).all()
    space = study().prepare().problem.simulator.space
    assert all(((space.low <= truth) & (truth <= space.high)).all() for truth in truths)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_the_integrators_steps_are_fine_enough(rate: float) -> None:
    """Halving them changes all signals together by less than half a standard deviation of their noise."""
    sim = study(recording=Synthetic(manoeuvre=manoeuvre(rate=rate))).prepare().problem.simulator
    theta = np.stack([sim.space.low, (sim.space.low + sim.space.high) / 2, sim.space.high])
    coarse, fine = (s.noise_free(theta) for s in (sim, replace(sim, substeps=2 * sim.substeps)))
    assert np.sqrt(np.sum(((coarse - fine) / sim.noise.floor[:, None]) ** 2, axis=(1, 2))).max() < 0.5


def drive(folder: Path, *, std: float = 0.0, rho: float = 0.0) -> RecordingFile:
    """A made-up recording of the paper's car with known parameters, in native columns."""
    sim = simulator(rate=100.0, duration=40.0)
    y = sim.noise_free(np.array([list(TRUTH.values())]))[0]
    speed = replace(sim, windows=replace(sim.windows, channels=("v_x",), groups=("can",)))
    v_x = speed.noise_free(np.array([list(TRUTH.values())]))[0, 0]
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, len(v_x)))
    for k in range(1, len(v_x)):
        noise[:, k] = rho * noise[:, k - 1] + np.sqrt(1 - rho**2) * noise[:, k]
    frame = pd.DataFrame(
        {
            "time_s": np.arange(len(v_x)) / 100.0,
            "steering_rad": sim.windows.u[0, :, 0],
            "v_x_mps": v_x,
            "a_y_mps2": y[1] + std * noise[0],
            "yaw_rate_radps": y[2] + 0.1 * std * noise[1],
        }
    )
    frame.to_csv(folder / "drive.csv", index=False)
    return RecordingFile(path=folder / "drive.csv", drive="speed", channels=("a_y", "yaw_rate"))


def test_the_clock_of_a_recording_begins_with_the_first_sample_that_is_used(tmp_path: Path) -> None:
    file = replace(drive(tmp_path), start_s=2.0)
    problem = study(recording=file, drive="speed", truth=None, noise=EstimatedNoise()).prepare().problem
    windows = problem.simulator.windows
    assert windows.t[0, 0] == pytest.approx(2.0, abs=0.02)
    assert windows.u[0, 0, INPUTS.index("time")] == 0.0


def both(folder: Path, **changes: Any) -> Study:
    """A study of two stretches of a recording, given as two files."""
    file = drive(folder, std=0.1)
    other = folder / "other.csv"
    other.write_bytes(Path(file.path).read_bytes())
    parts = [replace(file, stop_s=15.0), replace(file, path=other, start_s=15.0)]
    noise = ConstantNoise(std=STD, process=ProcessNoise(stiffness=0.0))  # which a whole study would share
    return study(recording=file, recordings=parts, drive="speed", truth=None, noise=noise, **changes)


def test_what_recordings_tell_together_is_what_each_tells(tmp_path: Path) -> None:
    """Information adds up over windows, each with a start of its own; the second clock goes on where the first ends."""
    prepared = both(tmp_path).prepare()
    sim = prepared.problem.simulator
    theta = (sim.space.low + sim.space.high) / 2
    each = [np.flatnonzero(np.array(sim.windows.recordings) == name) for name in ("drive", "other")]
    parts = [fisher(sim.only(which), theta) for which in each]
    np.testing.assert_allclose(fisher(sim, theta), parts[0] + parts[1], rtol=1e-6)
    alone = [replace(both(tmp_path), recordings=[one]).prepare() for one in both(tmp_path).recordings]
    np.testing.assert_array_equal(
        np.concatenate([one.problem.observed for one in alone], axis=1), prepared.problem.observed
    )
    assert (np.diff(sim.windows.clock[:, 0]) > 0).all()
    assert sorted(Path(path).name for path in prepared.inputs) == ["drive.csv", "other.csv"]
    assert prepared.name.endswith(" from drive, other")


def test_of_several_recordings_the_windows_that_tell_most_keep_their_names(tmp_path: Path) -> None:
    windows = both(tmp_path, most_readings=3000).prepare().problem.simulator.windows
    assert 1 < len(windows.t) < 8
    assert len(windows.recordings) == len(windows.t)
    assert {*windows.recordings} <= {"drive", "other"}
    assert windows.u[..., INPUTS.index("time")].min() == 0.0


def test_a_recording_that_is_given_twice_would_count_twice(tmp_path: Path) -> None:
    file = drive(tmp_path)
    with pytest.raises(InputError, match=r"recordings: .*drive\.csv would count twice: it is the same data"):
        study(recording=file, recordings=[file, str(file.path)], drive="speed", truth=None).prepare()


def test_a_synthetic_study_has_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="recordings: a synthetic study has none"):
        study(recordings=[drive(tmp_path)])


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_is_estimated_under_the_model_that_made_the_recording(tmp_path: Path, rho: float) -> None:
    file = drive(tmp_path, std=0.2, rho=rho)
    found = study(recording=file, drive="speed", truth=None, noise=EstimatedNoise()).prepare()
    sim = found.problem.simulator
    n = sim.windows.valid[0].sum()
    worth = n * (1 - rho**2) / (1 + rho**2)
    # Five standard errors, and a tenth for what the fit and the initial states of the windows take up.
    np.testing.assert_allclose(sim.noise.floor, [0.2, 0.02], rtol=5 * np.sqrt(0.5 / worth) + 0.1)
    np.testing.assert_allclose(sim.noise.rho, rho, atol=5 * np.sqrt((1 - rho**2) / n) + 0.05)
    assert found.truth is None
    assert list(found.inputs) == [str(file.path)]
    assert (found.problem.observed[~sim.windows.valid] == 0).all()


@pytest.mark.parametrize("missing", ["a_y_mps2", "v_x_mps", "steering_rad"])
def test_a_recording_without_what_is_needed_is_refused(tmp_path: Path, missing: str) -> None:
    file = drive(tmp_path)
    path = Path(file.path)
    pd.read_csv(path).drop(columns=missing).to_csv(path, index=False)
    with pytest.raises(InputError, match=missing.rpartition("_")[0]):
        study(recording=file, drive="speed", truth=None, noise=EstimatedNoise()).prepare()


WRONG: Mapping[str, tuple[dict, str]] = {
    "drive": ({"drive": "pedals"}, "drive: unknown drive mode 'pedals'; known: "),
    "drive of a manoeuvre": ({"drive": "speed"}, "drive=speed: a synthetic manoeuvre states torques; it needs"),
    "seed": ({"seed": -1}, "seed = -1; it must be a whole number that is not negative"),
    "fraction of a seed": ({"seed": 0.5}, "seed = 0.5; it must be a whole number"),
    "truth": ({"truth": {"l_f": 1.2}}, "truth: no value for delta_C_alpha_f"),
    "estimated": ({"noise": EstimatedNoise()}, "noise=estimated: there is no recording to estimate it from"),
    "spins out": (
        {
            "recording": Synthetic(manoeuvre=manoeuvre(steering_amplitude=0.3)),
            "prior": {"l_f": [1.0, 1.5], "C_alpha_r": [1e4, 6e4]},
            "truth": {"l_f": 1.5, "C_alpha_r": 1e4},
        },
        "the vehicle spins out with the true parameters",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_study_is_one_clear_line(case: str) -> None:
    given, message = WRONG[case]
    with pytest.raises(InputError, match=message) as error:
        study(**given).prepare()
    assert "\n" not in str(error.value)


def test_a_recording_has_no_stated_truth(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="truth: a recording has no stated truth"):
        study(recording=RecordingFile(path=tmp_path / "drive.csv"), drive="speed")


BAD_MANOEUVRES: Mapping[str, tuple[dict, str]] = {
    "no time": ({"duration": 0.0}, "manoeuvre 'mild': 0 s at 50 Hz hold no two samples"),
    "no number": ({"duration": float("nan")}, "manoeuvre 'mild': nan s at 50 Hz hold no two samples"),
    "no period": ({"torque_period": 0.0}, "manoeuvre 'mild': steering_period 4 s and torque_period 0 s must"),
    "speeds": ({"v_x_low": 12.0}, "manoeuvre 'mild': initial speed 12 to 11 m/s; low must not exceed high"),
    "too slow": ({"v_x_low": 0.5}, "the model holds above 1 m/s"),
    "channel": ({"channels": ("a_x", "a_q")}, "manoeuvre 'mild': unknown channel 'a_q'; known: a_"),
    "an input": ({"channels": ("steering",)}, "manoeuvre 'mild': unknown channel 'steering'; known: "),
    "no channel": ({"channels": ()}, "manoeuvre 'mild': no channel is measured"),
}


@pytest.mark.parametrize("case", BAD_MANOEUVRES)
def test_a_wrong_manoeuvre_is_one_clear_line(case: str) -> None:
    given, message = BAD_MANOEUVRES[case]
    with pytest.raises(InputError, match=message):
        manoeuvre(**given)


def test_steps_are_short_enough_for_every_corner_of_the_prior() -> None:
    # All 32 corners of a box whose fastest car, light front wheels on stiff tyres, is neither its low nor its high end.
    prior = {"l_f": [1.0, 1.5], "I_wf": [0.5, 5.0], "C_kappa_f": [5e4, 4e5], "C_alpha_f": [4e4, 1.2e5], "m": [800, 2e3]}
    sim = study(prior=prior, truth=None).prepare().problem.simulator
    records = sim.space.records(np.array(list(product(*zip(sim.space.low, sim.space.high, strict=True)))), sim.nominal)
    middle = (sim.space.low + sim.space.high)[None] / 2
    fastest = [fastest_rate(record, sim.drive, float(slowest(sim, middle).min()), sim.model) for record in records]
    assert max(fastest) <= sim.windows.rate * sim.substeps
    assert max(fastest) > 1.1 * max(fastest[0], fastest[-1])


def test_where_the_prior_s_centre_spins_out_the_speed_is_that_of_cars_that_do_not() -> None:
    # In the middle of both boxes the car turns faster than its rear tyres hold; most draws drive on at 8 m/s.
    prior, car = {"l_f": [0.3, 2.4], "C_alpha_r": [1e4, 2.2e4]}, {"l_f": 1.1, "C_alpha_r": 2.1e4}
    sim = study(prior=prior, truth=car).prepare().problem.simulator
    assert np.isnan(slowest(sim, (sim.space.low + sim.space.high)[None] / 2)).all()
    assert _slowest_believed(sim) == pytest.approx(slowest(sim, np.array([[*car.values()]]))[0], rel=0.1)
