"""What a verdict says of draws whose content is known: sets, groups that stand for each other, words within bounds."""

import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.stats import truncnorm
from test_effect_prior import stated

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.inference.directions import directions, left_out
from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.rounds import Truncated
from vehicle_sbi.inference.training import Training
from vehicle_sbi.mismatch.answer.verdict import TOO_FEW, Found, _cut, _parameters, _share_explained, _unknown
from vehicle_sbi.mismatch.answer.wording import NAMED, _limits, _sizes, headline
from vehicle_sbi.mismatch.design.identifiability import card
from vehicle_sbi.mismatch.estimation.estimate import Estimate, told
from vehicle_sbi.mismatch.estimation.fit import Fit, linearise
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.selection.detection import examine
from vehicle_sbi.mismatch.selection.expand_and_prune import Budget, expand_and_prune
from vehicle_sbi.mismatch.selection.extended import alternatives, extended, with_effects
from vehicle_sbi.mismatch.selection.inclusion import Chain
from vehicle_sbi.mismatch.selection.pruned import Pruned
from vehicle_sbi.mismatch.selection.reinfer import Reinference
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS

SHORT = Budget(rounds=1, pooled=1, last=Chain(chains=2, sweeps=160, forgotten=60, every=2))
EFFECTS = ("body_roll", "accelerometer_scale", "gyro_bias", "imu_lever_arm")
AGAIN = Reinference(
    features=Score(),
    estimator=NeuralSplineFlow(model="nsf", hidden_features=50, num_transforms=3, num_bins=8),
    rounds=Truncated(rounds=2, simulations=2000, last=2, early=0.4),
    training=Training(
        batch_size=200, learning_rate=3e-3, steps=800, stop_after_epochs=15, max_epochs=120,
        validation_fraction=0.1, clip_max_norm=5.0, atoms=10, discard_prior_samples=False, members=1,
    ),
    samples=4000,
)  # fmt: skip


@pytest.fixture(scope="module")
def base() -> Fit:
    """The base model's fit to a car whose body rolls."""
    return fitted(recorded(lateral(), body_roll__gradient=0.012))


@pytest.fixture(scope="module")
def pruned(base: Fit) -> Pruned:
    known = [d for d in left_out(base.simulator, base.theta) if d.effect in EFFECTS]
    found = expand_and_prune(base, known, None, prior=stated(), rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    return found


def drawn(pruned: Pruned, **there: list[int]) -> Pruned:
    """The same with draws in which effects are there or not as given, and no discrepancy."""
    n = len(next(iter(there.values())))
    names = [p.name.split(".")[0] for p in pruned.expansion.sizes]
    included = np.array([[bool(there.get(name, [0] * n)[k]) for name in names] for k in range(n)])
    theta = np.resize(pruned.theta, (n, pruned.theta.shape[1]))
    return replace(pruned, included=included, theta=theta, unexplained=np.zeros(n, dtype=bool))


def test_probabilities_are_shares_of_draws(pruned: Pruned) -> None:
    found = drawn(pruned, body_roll=[1, 1, 1, 0], gyro_bias=[0, 1, 1, 0])
    assert found.effects["body_roll"] == 0.75
    assert found.any_of(["body_roll", "gyro_bias"]) == 0.75
    assert {effects: rows.mean() for effects, rows in found.sets.items()} == {
        ("body_roll", "gyro_bias"): 0.5, ("body_roll",): 0.25, (): 0.25,
    }  # fmt: skip
    assert next(iter(found.sets)) == ("body_roll", "gyro_bias")


def test_effects_of_which_one_is_always_there_stand_for_each_other(pruned: Pruned) -> None:
    either = drawn(pruned, body_roll=[1, 0, 1, 0, 1, 0], accelerometer_scale=[0, 1, 0, 1, 0, 1])
    assert [sorted(group) for group in alternatives(either, [])] == [["accelerometer_scale", "body_roll"]]


def test_effects_that_are_there_together_or_hardly_ever_stand_for_nothing(pruned: Pruned) -> None:
    assert alternatives(drawn(pruned, body_roll=[1, 0, 1, 0], accelerometer_scale=[1, 0, 1, 0]), []) == []
    rare = drawn(pruned, body_roll=[1, *[0] * 9], accelerometer_scale=[0, 1, *[0] * 8])
    assert alternatives(rare, []) == []


def test_effects_that_do_the_same_are_a_group_though_both_may_be_there(pruned: Pruned) -> None:
    both = drawn(pruned, body_roll=[1, 1, 0, 0, 0], accelerometer_scale=[1, 0, 1, 0, 0])
    assert alternatives(both, []) == []
    assert alternatives(both, [("accelerometer_scale", "body_roll")]) == [["body_roll", "accelerometer_scale"]]


def test_the_extended_model_has_the_likeliest_set_and_the_other_one_an_exchange(base: Fit, pruned: Pruned) -> None:
    either = drawn(pruned, body_roll=[1, 0, 1, 0, 1], accelerometer_scale=[0, 1, 0, 1, 0])
    found = extended(base, either, [], detected=True)
    assert found.model.effects == ("body_roll",)
    assert found.other is not None
    assert found.other.effects == ("accelerometer_scale",)
    assert found.model.base == base.simulator.space.names
    assert found.model.fit.log_likelihood > base.log_likelihood + 10.0
    assert _share_explained(base, found.model.fit) > 0.8


def test_where_nothing_is_detected_the_model_is_the_base_model(base: Fit, pruned: Pruned) -> None:
    assert extended(base, pruned, [], detected=False).model.fit is base
    assert extended(base, None, [], detected=True).model.effects == ()


def test_sizes_are_those_of_draws_in_which_they_are_missing(pruned: Pruned) -> None:
    found = drawn(pruned, body_roll=[1] * 40 + [0] * 20)
    theta = found.theta.copy()
    column = found.fit.simulator.space.column("body_roll.gradient")
    theta[:40, column], theta[40:, column] = np.linspace(0.01, 0.012, 40), 0.0
    said = _parameters(replace(found, theta=theta), ["body_roll"], found.missing["body_roll"])
    assert said["body_roll.gradient"].mean == pytest.approx(0.011)
    assert said["body_roll.gradient"].q05 > 0.0099


@pytest.mark.parametrize("draws", [TOO_FEW - 1, TOO_FEW])
def test_a_size_that_hardly_was_drawn_is_not_said(pruned: Pruned, draws: int) -> None:
    found = drawn(pruned, body_roll=[1] * draws + [0] * 50)
    said = _parameters(found, ["body_roll"], found.missing["body_roll"])
    assert ("body_roll.gradient" in said) == (draws >= TOO_FEW)


def test_estimates_are_those_of_the_posterior_where_a_model_was_inferred(base: Fit) -> None:
    names, normal = base.simulator.space.names, Model((), base, ()).estimates
    draws = np.random.default_rng(0).exponential(size=(2000, len(names)))
    inferred = Model((), base, (), posterior=draws).estimates
    assert inferred.keys() == normal.keys()
    for k, name in enumerate(names):
        e = inferred[name]
        assert (e.mean, e.std) == (pytest.approx(draws[:, k].mean()), pytest.approx(draws[:, k].std()))
        assert np.mean(draws[:, k] < e.q05) == pytest.approx(0.05, abs=1e-3)
        assert np.mean(draws[:, k] < e.q95) == pytest.approx(0.95, abs=1e-3)
        assert e.unit == normal[name].unit


def test_base_parameters_that_would_leave_their_prior_are_spoken_of(pruned: Pruned) -> None:
    l_f = pruned.expansion.base[pruned.fit.simulator.space.column("l_f")]
    for side, bound in enumerate((l_f.low, l_f.high)):
        beyond = np.zeros_like(pruned.beyond)
        beyond[side, pruned.fit.simulator.space.column("l_f")] = 0.6
        said = _unknown(replace(pruned, beyond=beyond, remainders=[]))
        assert said is not None
        assert [*said.beyond_prior[0].parameters] == ["l_f"]
        assert said.beyond_prior[0].bound == {"l_f": bound}
        assert said.over_time is None


def test_where_nothing_is_missing_it_is_said_which_effects_would_have_shown() -> None:
    fit = fitted(recorded(lateral()))
    known = left_out(fit.simulator, fit.theta)
    seen = card(fit.simulator, fit.theta, known)
    said = _limits(seen)
    assert f"{len(seen.could_show())} of the {len(CATALOGUE)} known effects" in said
    first = next(iter(seen.could_show().values()))
    assert f"{first.parameter.name} from {first.least} {first.parameter.unit}" in said
    scale = replace(seen, candidates=tuple(c for c in seen.candidates if c.effect == "gyro_scale"))
    assert _limits(scale).endswith(" off 1.")


def test_a_headline_has_at_most_25_words_however_many_names_there_are() -> None:
    names = [*CATALOGUE]
    group = ["lateral_load_transfer", "road_grade_profile"]
    for n, p_unknown, wrong in itertools.product((0, 1, 4, 5, len(names)), (0.1, 0.97), ([], ["a: is a_y flipped?"])):
        effects = dict.fromkeys((name for name in names[:n] if name not in group), 0.97)
        answer: Any = SimpleNamespace(
            detected=True, p_value=0.004, effects=effects, p_unknown=p_unknown,
            indistinguishable=[group] * 3, p_indistinguishable=[0.97] * 3, wrong_recordings=wrong,
        )  # fmt: skip
        said = headline(answer, trusted=False)
        assert len(said.split()) <= 25
        begun = "The recordings look wrong (see the warnings)." if wrong else "The base fit is doubtful."
        assert said.startswith(f"{begun} Missing: ")
        assert said.endswith("something unknown (0.97).") == (p_unknown > NAMED)


@pytest.mark.parametrize("detected", [False, True])
def test_that_recordings_look_wrong_is_said_first_whatever_is_missing(detected: bool) -> None:
    answer: Any = SimpleNamespace(
        detected=detected, p_value=0.004, effects={}, p_unknown=0.9, indistinguishable=[], p_indistinguishable=[],
        wrong_recordings=["a: is a_y flipped?"],
    )  # fmt: skip
    said = headline(answer, trusted=True)
    assert said.startswith("The recordings look wrong (see the warnings). ")
    assert len(said.split()) <= 25
    answer.wrong_recordings = []
    assert headline(answer, trusted=True) in said


@pytest.mark.parametrize(
    ("mean", "std", "limit"),
    [(0.5, 0.1, ""), (0.15, 0.1, "l_f (0 m)"), (0.85, 0.1, "l_f (1 m)"), (0.4, 0.25, "")],
)
def test_a_limit_that_cuts_an_interval_is_said_of_what_is_told_at_all(mean: float, std: float, limit: str) -> None:
    p = Parameter(name="l_f", unit="m", low=0.0, high=1.0, fields=("l_f",))
    pruned: Any = SimpleNamespace(expansion=SimpleNamespace(base=(p,)))
    said = _cut(pruned, {"l_f": Estimate(mean, std, mean - std, mean + std, "m")})
    assert [limit in line for line in said] == [True] * bool(limit)
    late = EFFECT_PARAMETERS["sensor_delay.imu"]  # beyond whose lower limit there is nothing
    pruned.expansion.base = (late,)
    assert _cut(pruned, {late.name: Estimate(0.01, 0.01, 0.0, 0.03, "s")}) == []


def test_a_parameter_is_told_where_its_bound_is_below_its_priors_spread() -> None:
    """1/std² = 1/prior² + 1/bound² of what is normal; a normal prior within its own box is 0.81 times as wide."""
    low, high = 0.45, 0.65
    prior = (high - low) / 12.0**0.5
    for bound, is_told in ((0.99 * prior, True), (1.01 * prior, False)):
        assert told((prior**-2 + bound**-2) ** -0.5, low, high) is is_told
    untold = truncnorm.std(-(3.0**0.5), 3.0**0.5) * prior
    assert untold == pytest.approx(0.814 * prior, rel=1e-3)
    assert not told(untold, low, high)


def test_a_mismatch_that_stands_out_nowhere_is_said_to_be_one_as_a_whole(base: Fit) -> None:
    answer: Any = SimpleNamespace(
        mismatch=[], p_value=0.008, explanations=[], effects={}, headline="", indistinguishable=[],
        p_indistinguishable=[],
    )  # fmt: skip
    assert _sizes(answer, base.simulator).startswith("They differ (p = 0.008), but no single stretch")


def test_what_is_found_has_the_base_model_that_was_examined(base: Fit) -> None:
    known = directions(base.simulator, base.theta, CATALOGUE["body_roll"])
    examined = examine(base, known, np.random.default_rng(0))
    seen = card(base.simulator, base.theta, known)
    found = Found(FitCheck(0.1, 0.0), examined, None, extended(base, None, [], detected=True), {}, None, seen)
    assert found.base.fit is base
    assert examined.detected
    assert examined.places[0].p_value < 0.05


@pytest.mark.slow
def test_where_a_fit_is_normal_the_inferred_posterior_is_that_of_the_fit(tmp_path: Path, base: Fit) -> None:
    # Two rounds of 2000 simulations: means within a third of a standard deviation, spreads within a quarter of it,
    # which is what the estimators of run.py reach beside exact posteriors.
    known = directions(base.simulator, base.theta, CATALOGUE["body_roll"])
    found = expand_and_prune(base, known, None, prior=stated(), rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    model = with_effects(base, found, ["body_roll"])
    assert model is not None
    free = replace(model, fit=replace(model.fit, shrinkage=None, at=linearise(model.fit.simulator, model.fit.theta)))
    after, before = AGAIN.inferred(model, Checkpoints(tmp_path)).estimates, free.estimates
    gradient = "body_roll.gradient"
    assert after[gradient].mean == pytest.approx(before[gradient].mean, abs=before[gradient].std / 3)
    assert after[gradient].std == pytest.approx(before[gradient].std, rel=0.25)
