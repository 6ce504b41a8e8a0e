"""Rounds: each a pure function of those before it, continued after an interruption as if there had been none."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from studies import PRIOR, constant_noise, simulator

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.doubts import disagreements
from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Embedding, Features, Handcrafted, Score
from vehicle_sbi.inference.information import best_fit, bound_std, fisher
from vehicle_sbi.inference.proposal import Support, draw
from vehicle_sbi.inference.reweighting import draws_about_the_fit
from vehicle_sbi.inference.rounds import (
    FIDUCIAL_DRAWS,
    Amortised,
    Corrected,
    Inference,
    Problem,
    Round,
    Scheme,
    Truncated,
    infer,
    one_round,
    posterior_of,
    without_failures,
)
from vehicle_sbi.inference.training import Training
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.report.results import FIRST_DRAWS, first_answer
from vehicle_sbi.rng import Stream

SMALL = NeuralSplineFlow(hidden_features=10, num_transforms=2, num_bins=4)
QUICK = Training(batch_size=50, max_epochs=2)
SCHEMES: dict[str, Scheme] = {
    "truncated": Truncated(rounds=2, simulations=60),
    "corrected": Corrected(rounds=2, simulations=60),
    "amortised": Amortised(simulations=60),
}


def problem(features: Features | None = None, training: Training = QUICK, **driven: Any) -> Problem:
    sim = simulator(known_start=False, **driven)
    truth = np.array([[1.2, 0.1, -0.1]])
    observed = sim.simulate(truth, np.array([0]), stream=Stream.TRUTH)[0][0].astype(float)
    return Problem(sim, observed, features or Score(), SMALL, training)


def samples_of(inference: Inference) -> np.ndarray:
    torch.manual_seed(0)
    return draw(inference.posterior, simulator().space, 50)  # sbi's own sampling may never end for a leaking density


def same(a: Round, b: Round) -> bool:
    weights = zip(a.states, b.states, strict=True)
    return torch.equal(a.theta, b.theta) and all(torch.equal(x[key], y[key]) for x, y in weights for key in x)


@pytest.mark.parametrize("name", SCHEMES)
def test_an_interrupted_study_ends_where_an_uninterrupted_one_does(tmp_path: Path, name: str) -> None:
    study, scheme = problem(), SCHEMES[name]
    whole = infer(study, scheme, Checkpoints(tmp_path / "whole"), quiet=True)
    first = one_round(study, scheme, Inference((), ()), quiet=True)
    parts = Checkpoints(tmp_path / "parts")
    first.save(parts, "rounds/round_0.pt")
    torch.rand(1234)  # the interruption leaves torch's generator anywhere
    resumed = infer(problem(), scheme, parts, quiet=True)
    assert len(whole.rounds) == scheme.rounds
    assert all(same(a, b) for a, b in zip(whole.rounds, resumed.rounds, strict=True))
    np.testing.assert_array_equal(samples_of(whole), samples_of(resumed))
    for k in range(scheme.rounds):
        files = [tmp_path / of / "rounds" / f"round_{k}.pt" for of in ("whole", "parts")]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_finished_rounds_are_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study, kept = problem(), Checkpoints(tmp_path)
    first = infer(study, Truncated(rounds=1, simulations=60), kept, quiet=True)
    monkeypatch.setattr("vehicle_sbi.inference.rounds.one_round", lambda *_, **__: pytest.fail("ran again"))
    again = infer(study, Truncated(rounds=1, simulations=60), kept, quiet=True)
    np.testing.assert_array_equal(samples_of(first), samples_of(again))


def test_a_broken_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "rounds").mkdir()
    (tmp_path / "rounds/round_0.pt").write_bytes(b"half a checkp")
    with pytest.raises(InputError, match=r"round_0\.pt: no checkpoint of a round .*; delete it to redo it"):
        infer(problem(), SCHEMES["truncated"], Checkpoints.as_found(tmp_path), quiet=True)


def test_a_round_that_is_not_as_it_was_left_is_run_again_and_those_after_it(tmp_path: Path) -> None:
    kept = Checkpoints(tmp_path)
    first = infer(problem(), SCHEMES["truncated"], kept, quiet=True)
    before, files = {**kept.sealed}, [tmp_path / f"rounds/round_{k}.pt" for k in range(2)]
    files[0].write_bytes(files[0].read_bytes()[:-1] + b"?")
    changed = files[1].stat().st_mtime_ns
    again = infer(problem(), SCHEMES["truncated"], kept, quiet=True)
    assert all(same(a, b) for a, b in zip(first.rounds, again.rounds, strict=True))
    assert kept.sealed == before
    assert files[1].stat().st_mtime_ns > changed


@pytest.mark.parametrize(
    "features", [Handcrafted(), Embedding(decimate=2, outputs=5)], ids=["handcrafted", "embedding"]
)
@pytest.mark.parametrize("name", ["truncated", "corrected"])
def test_every_kind_of_features_goes_with_every_scheme(tmp_path: Path, features: Features, name: str) -> None:
    found = infer(problem(features), SCHEMES[name], Checkpoints(tmp_path), quiet=True)
    assert np.isfinite(samples_of(found)).all()
    assert [len(r.theta) for r in found.rounds] == [60, 60]


def test_a_posterior_is_rebuilt_from_its_checkpoint(tmp_path: Path) -> None:
    study = problem()
    finished = one_round(study, SCHEMES["truncated"], Inference((), ()), quiet=True)
    path = finished.save(Checkpoints(tmp_path), "round.pt")
    theta = torch.tensor([[1.2, 0.1, -0.1], [1.4, 0.0, 0.2]])
    rounds = (finished, Round.load(path))
    densities = [posterior_of(study, r).log_prob(theta, norm_posterior=False) for r in rounds]  # pyright: ignore[reportAttributeAccessIssue]  # sbi's base class
    torch.testing.assert_close(densities[0], densities[1])


def test_the_first_round_comes_from_the_prior_and_the_second_from_where_the_first_has_mass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = problem(Handcrafted(), training=Training(batch_size=50, max_epochs=30, learning_rate=5e-3))
    used, estimated = [], Support.of
    monkeypatch.setattr(Support, "of", lambda *of: used.append(estimated(*of)) or used[-1])
    found = infer(study, Truncated(rounds=2, simulations=200), Checkpoints(tmp_path), quiet=True)
    space = study.simulator.space
    first, second = (r.theta.numpy() for r in found.rounds)
    # The standard deviation of n uniform draws scatters by sqrt((kurtosis - 1) / 4n), of kurtosis 1.8; five of these.
    np.testing.assert_allclose(first.std(axis=0, ddof=1), space.prior_std, rtol=5 * np.sqrt(0.2 / len(first)))
    # Another estimate of the threshold would move the edge, by an amount that depends on the density's tails. Of the
    # very support that the round proposed from, the law has no sampling error at all.
    (support,) = used
    assert support.contains(second).all()
    assert [r.failed for r in found.rounds] == [0, 0]
    assert found.rounds[1].trained_on == len(second) + support.contains(first).sum()
    np.testing.assert_allclose(found.rounds[0].fiducial, (space.low + space.high) / 2)
    torch.manual_seed(0)
    samples = draw(found.posteriors[0], space, FIDUCIAL_DRAWS)
    standard_error = samples.std(axis=0) * np.sqrt(2 / FIDUCIAL_DRAWS)  # of the difference of two such means
    off = np.abs(found.rounds[1].fiducial.numpy() - samples.mean(axis=0))
    assert (off < 5 * standard_error).all()


def proportional(study: Problem) -> Problem:
    """The same under noise that is a share of the signal, which a fit explains efficiently."""
    noise = replace(study.simulator.noise, share=np.full(len(study.simulator.noise.floor), 0.05))
    sim = study.simulator.with_noise(noise)
    return replace(study, simulator=sim, observed=sim.noise_free(np.array([[1.2, 0.1, -0.1]]))[0])


def test_rounds_begin_where_a_fit_leaves_the_parameters_unless_they_are_amortised() -> None:
    study = proportional(problem())
    (around,) = study.neighbourhood
    none = Inference((), ())
    truncated, amortised = (SCHEMES[name].plan(study, none).theta for name in ("truncated", "amortised"))
    assert around.contains(truncated).all()
    assert around.contains(np.array([[1.2, 0.1, -0.1]])).all()
    assert not around.contains(amortised).all()


@pytest.mark.parametrize("features", [Handcrafted(), Embedding()], ids=["handcrafted", "embedding"])
def test_features_that_lose_information_do_not_begin_there(features: Features) -> None:
    assert proportional(problem(features)).neighbourhood == ()


def test_the_last_round_is_the_largest_and_the_longest(tmp_path: Path) -> None:
    study = problem(training=Training(batch_size=20, steps=60, stop_after_epochs=100))
    found = infer(study, Truncated(rounds=2, simulations=60, last=3, early=0.5), Checkpoints(tmp_path), quiet=True)
    assert [len(r.theta) for r in found.rounds] == [60, 180]
    assert [len(r.states) for r in found.rounds] == [1, 1]
    steps = [len(r.validation_loss[0]) * (int(0.9 * r.trained_on) // 20) for r in found.rounds]
    assert 30 <= steps[0] < 30 + 2  # whole epochs
    assert 60 <= steps[1] < 60 + 11


def test_only_the_last_round_trains_an_ensemble(tmp_path: Path) -> None:
    study = problem(training=replace(QUICK, members=2))
    found = infer(study, Truncated(rounds=2, simulations=60), Checkpoints(tmp_path), quiet=True)
    assert [len(r.states) for r in found.rounds] == [1, 2]


def test_members_of_an_ensemble_differ_and_are_mixed(tmp_path: Path) -> None:
    study = problem(training=replace(QUICK, members=2))
    found = infer(study, Truncated(rounds=1, simulations=60), Checkpoints(tmp_path), quiet=True)
    states = found.rounds[0].states
    assert len(states) == len(found.rounds[0].validation_loss) == 2
    assert any(not torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_failures_are_left_out_of_the_likelihood_but_not_of_the_corrected_loss() -> None:
    theta, x = np.arange(8.0).reshape(4, 2), np.arange(12.0, dtype=np.float32).reshape(4, 3)
    good = np.array([True, False, True, True])
    x[1] = np.nan
    left = without_failures(theta, x, good, drop=True)
    assert left.theta.tolist() == theta[good].tolist()
    assert left.x.tolist() == x[good].tolist()
    kept = without_failures(theta, x, good, drop=False)
    assert kept.theta.tolist() == theta.tolist()
    assert (kept.x[1] > kept.x[[0, 2, 3]].max(dim=0).values).all()  # features that no success has
    assert kept.x[good].tolist() == x[good].tolist()
    none = without_failures(theta, np.full_like(x, np.nan), np.zeros(4, dtype=bool), drop=False)
    assert torch.isfinite(none.x).all()


def test_failures_are_counted(tmp_path: Path) -> None:
    prior = {"l_f": [1.0, 1.5], "C_alpha_r": [1e4, 6e4]}
    sim = simulator(prior, known_start=False, steering_amplitude=0.15)
    truth = np.array([[1.05, 5.9e4]])
    observed = sim.simulate(truth, np.array([0]), stream=Stream.TRUTH)[0][0].astype(float)
    study = Problem(sim, observed, Handcrafted(), SMALL, QUICK)
    found = infer(study, Amortised(simulations=300), Checkpoints(tmp_path), quiet=True).rounds[0]
    assert 0 < found.failed < 300
    assert found.trained_on == 300 - found.failed


def test_a_prior_where_everything_spins_out_is_refused(tmp_path: Path) -> None:
    sim = simulator({"l_f": [1.4, 1.5], "C_alpha_r": [1e4, 1.1e4]}, steering_amplitude=0.3)
    study = Problem(sim, np.zeros(sim.shape), Handcrafted(), SMALL, QUICK)
    with pytest.raises(InputError, match="simulation fails; the prior lies where the vehicle spins out"):
        infer(study, SCHEMES["truncated"], Checkpoints(tmp_path), quiet=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scheme", [Truncated, Corrected, Amortised])
@pytest.mark.parametrize("given", [{"rounds": 0}, {"simulations": 49}])
def test_bad_counts_are_refused(scheme: type, given: dict) -> None:
    with pytest.raises(InputError, match="at least 1 of 50 are needed"):
        scheme(**given)


def test_an_amortised_posterior_has_one_round() -> None:
    with pytest.raises(InputError, match=r"rounds=amortised: rounds\.rounds = 2; an amortised posterior has one round"):
        Amortised(rounds=2)


@pytest.mark.slow
def test_truncated_rounds_reach_the_bound(tmp_path: Path) -> None:
    """A nearly linear problem in Gaussian noise: the posterior is a Gaussian of the bound's spread at the best fit."""
    sim = simulator(PRIOR)
    sim = sim.with_noise(constant_noise(sim.windows))
    truth = np.array([1.2, 0.1, -0.1])
    observed = sim.simulate(truth[None], np.array([0]), stream=Stream.TRUTH)[0][0].astype(float)
    training = Training(batch_size=200, learning_rate=2e-3, max_epochs=100)
    study = Problem(sim, observed, Score(), NeuralSplineFlow(hidden_features=30, num_transforms=2), training)
    found = infer(study, Truncated(rounds=5, simulations=1500), Checkpoints(tmp_path), quiet=True)
    torch.manual_seed(0)
    samples = draw(found.posterior, sim.space, 4000)
    fit, _ = best_fit(sim, observed, truth[None])
    bound = bound_std(fisher(sim, fit), sim.space.prior_std)
    # Networks of a few thousand simulations are wide by up to a third and off by up to half a standard deviation.
    assert (samples.std(axis=0) / bound < 1.35).all()
    assert (samples.std(axis=0) / bound > 0.8).all()
    assert (np.abs(samples.mean(axis=0) - fit) / bound < 0.5).all()


def test_a_recording_unlike_all_simulations_is_told_once_and_while_rounds_go_on(tmp_path: Path) -> None:
    study, said = problem(Handcrafted()), list[str]()
    unlike = replace(study, observed=20.0 * study.observed)
    infer(unlike, Truncated(rounds=2, simulations=60), Checkpoints(tmp_path / "a"), quiet=True, warn=said.extend)
    assert len(said) == 1
    assert said[0].startswith("round 1 of 2: the recording lies outside what was simulated")
    infer(study, Truncated(rounds=2, simulations=60), Checkpoints(tmp_path / "b"), quiet=True, warn=said.extend)
    assert len(said) == 1


@pytest.mark.parametrize(("moved", "told"), [(0.5, []), (5.0, ["l_f"])])
def test_rounds_whose_means_lie_far_apart_are_said_to_disagree(
    monkeypatch: pytest.MonkeyPatch, moved: float, told: list[str]
) -> None:
    rng, space = np.random.default_rng(0), simulator().space
    means = iter([np.zeros(len(space)), np.array([moved, 0.0, 0.0])])
    monkeypatch.setattr("vehicle_sbi.inference.doubts.draw", lambda *_: next(means) + rng.standard_normal((2000, 3)))
    both: Any = ("before", "last")
    found = disagreements(both, space)
    assert [name for name, _ in found] == told
    assert all(abs(far - moved) < 0.2 for _, far in found)  # 0.03 each from the mean and the deviation of 2000 draws


def means_and_stds(answer: str, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of a first answer, a line for each parameter."""
    rows = [row.split() for row in answer.rstrip().splitlines()[1:]]
    assert [row[0] for row in rows] == list(names)
    return np.array([float(row[1]) for row in rows]), np.array([float(row[3]) for row in rows])


def test_the_first_answer_is_of_draws_that_the_likelihood_weights() -> None:
    study = problem()
    drawn = draws_about_the_fit(study, FIRST_DRAWS)
    assert drawn is not None
    answer = first_answer(study)
    assert answer.startswith("First answer, by the likelihood")
    mean, std = means_and_stds(answer, study.simulator.space.names)
    assert (np.abs(mean - drawn.theta.mean(axis=0)) <= 0.05 * std).all()  # said to two digits of the spread
    np.testing.assert_allclose(std, drawn.theta.std(axis=0, ddof=1), rtol=0.05)


def test_where_the_likelihood_is_not_known_the_first_answer_is_the_fit_and_the_spread_about_it() -> None:
    independent = problem()
    simulator = independent.simulator
    correlated = replace(independent, simulator=simulator.with_noise(constant_noise(simulator.windows, rho=0.3)))
    assert correlated.laplace is not None
    assert draws_about_the_fit(correlated, FIRST_DRAWS) is None
    fit, covariance = correlated.laplace.marginal
    answer = first_answer(correlated)
    assert answer.startswith("First answer, rough")
    mean, std = means_and_stds(answer, simulator.space.names)
    assert (np.abs(mean - fit) <= 0.05 * std).all()
    np.testing.assert_allclose(std, np.sqrt(np.diag(covariance)), rtol=0.05)


def test_a_first_answer_says_which_parameters_lie_on_the_edge_of_their_priors() -> None:
    study = problem()
    assert study.laplace is not None
    first, *others = study.simulator.space.parameters
    narrow = ParameterSpace((replace(first, low=float(study.laplace.marginal[0][0])), *others))
    lines = first_answer(replace(study, simulator=replace(study.simulator, space=narrow))).splitlines()
    assert f"{first.name}" in lines[1]
    assert "on the edge of its prior" in lines[1]
    assert not any("edge" in line for line in lines[2:])


def test_where_no_fit_explains_the_recording_there_is_no_first_answer() -> None:
    study = problem()
    wave = 3.0 * study.simulator.noise.floor[:, None] * np.sin(np.arange(study.observed.shape[1]) / 3.0)
    unlike = replace(study, observed=study.observed + wave)
    assert first_answer(unlike).endswith("`diagnose` says what the model lacks.")
    said = first_answer(unlike, ["gyro_bias"])
    assert said.startswith("No first answer")
    assert "diagnose" not in said
