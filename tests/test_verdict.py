"""What a verdict says: which effects stand for each other, and estimates of a fit or of an inferred posterior."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.inference.directions import directions, left_out
from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.rounds import Truncated
from vehicle_sbi.inference.training import Training
from vehicle_sbi.mismatch.answer.verdict import _unsupported, estimates, exchangeable
from vehicle_sbi.mismatch.answer.wording import sentence
from vehicle_sbi.mismatch.design.identifiability import card
from vehicle_sbi.mismatch.explain import explain, extended
from vehicle_sbi.mismatch.selection.detection import Model, versions
from vehicle_sbi.mismatch.selection.reinfer import Reinference
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.report import diagnosis

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


def test_single_effects_that_fit_equally_well_are_one_group() -> None:
    assert exchangeable([("steering_lag",), ("sensor_lag",), ("steering_delay",)]) == [
        ["sensor_lag", "steering_delay", "steering_lag"]
    ]


def test_in_sets_what_is_exchanged_makes_the_groups() -> None:
    found = exchangeable(
        [("roll", "delay"), ("roll", "lag"), ("scale", "delay"), ("scale", "lag")]  # two choices of two
    )
    assert sorted(found) == [["delay", "lag"], ["roll", "scale"]]


def test_one_answer_and_unlike_answers_make_no_group() -> None:
    assert exchangeable([("roll",)]) == []
    assert exchangeable([("drag",), ("roll", "lag")]) == []


def test_half_the_power_of_a_likelihood_widens_estimates_by_no_more_than_the_root_of_two() -> None:
    # With l the information in units of the prior's, variances grow by (1 + l) / (1 + l / 2), in the direction that the
    # recording says least of the least.
    model = Model((), fitted(recorded(lateral())), 0.0)
    least = float(np.linalg.eigvalsh(model.fit.information)[0])
    for before, after in zip(estimates(model).values(), estimates(model, 0.5).values(), strict=True):
        assert (1.0 + least) / (1.0 + least / 2.0) <= (after.std / before.std) ** 2 * (1.0 + 1e-9)
        assert after.std <= np.sqrt(2.0) * before.std


def test_estimates_are_those_of_the_posterior_where_a_model_was_inferred() -> None:
    fit = fitted(recorded(lateral()))
    names, normal = fit.simulator.space.names, estimates(Model((), fit, 0.0))
    draws = np.random.default_rng(0).exponential(size=(2000, len(names)))
    inferred = estimates(Model((), fit, 0.0, posterior=draws))
    assert inferred.keys() == normal.keys()
    for k, name in enumerate(names):
        e = inferred[name]
        assert (e.mean, e.std) == (pytest.approx(draws[:, k].mean()), pytest.approx(draws[:, k].std()))
        assert np.mean(draws[:, k] < e.q05) == pytest.approx(0.05, abs=1e-3)
        assert np.mean(draws[:, k] < e.q95) == pytest.approx(0.95, abs=1e-3)
        assert e.unit == normal[name].unit


@pytest.mark.slow
def test_where_a_fit_is_normal_the_inferred_posterior_is_that_of_the_fit(tmp_path: Path) -> None:
    # Two rounds of 2000 simulations: means within a third of a standard deviation, spreads within a quarter of it,
    # which is what the estimators of run.py reach beside exact posteriors.
    observation = recorded(lateral(), body_roll__gradient=0.012)
    base = fitted(observation)
    known = [d for d in left_out(base.simulator, base.theta) if d.effect == "body_roll"]
    found = explain(base, known, rng=np.random.default_rng(0))
    inferred = AGAIN.of(found, tmp_path)
    assert inferred.models[0].effects == found.models[0].effects == ("body_roll",)
    after, before = estimates(inferred.models[0]), estimates(found.models[0])
    gradient = "body_roll.gradient"
    assert after[gradient].mean == pytest.approx(before[gradient].mean, abs=before[gradient].std / 3)
    assert after[gradient].std == pytest.approx(before[gradient].std, rel=0.25)


def test_nothing_is_inferred_where_nothing_is_missing(tmp_path: Path) -> None:
    base = fitted(recorded(lateral()))
    found = explain(base, [], rng=np.random.default_rng(0))
    assert not found.detected
    assert AGAIN.of(found, tmp_path) is found
    assert not any(tmp_path.iterdir())


def test_held_out_data_that_is_unlike_what_is_fitted_is_spoken_of_where_nothing_is_found() -> None:
    base = fitted(recorded(lateral()))
    known = [d for d in left_out(base.simulator, base.theta) if d.effect == "body_roll"]
    found = explain(base, known, rng=np.random.default_rng(0))
    assert not found.detected
    seen = card(base.simulator, base.theta, known)
    usual, strange = (sentence(found, [], [], [], [], None, None, seen, covered) for covered in (0.9, 0.57))
    assert strange.startswith(usual)
    assert "57% of it" in strange.removeprefix(usual)


def test_where_nothing_is_missing_it_is_said_which_effects_would_have_shown() -> None:
    base = fitted(recorded(lateral()))
    known = left_out(base.simulator, base.theta)
    found = explain(base, known[:1], rng=np.random.default_rng(0))
    assert not found.detected
    seen = card(base.simulator, base.theta, known)
    said = sentence(found, [], [], [], [], None, None, seen, 0.9)
    assert f"{len(seen.could_show())} of the {len(CATALOGUE)} known effects" in said
    first = next(iter(seen.could_show().values()))
    assert f"{first.parameter.name} from {first.least} {first.parameter.unit}" in said
    scale = replace(seen, candidates=tuple(c for c in seen.candidates if c.effect == "gyro_scale"))
    assert "gyro_scale.z from 0.0" in (said := sentence(found, [], [], [], [], None, None, scale, 0.9))
    assert said.endswith(" off 1.")


def test_a_false_alarm_says_that_nothing_missing_is_likelier() -> None:
    # Of noise alone, the twentieth seed is one of the twenty in which it scores as high.
    base = fitted(recorded(lateral(), seed=20))
    known = [d for name in ("gyro_bias", "body_roll") for d in directions(base.simulator, base.theta, CATALOGUE[name])]
    found = explain(base, known, rng=np.random.default_rng(0))
    assert found.detected
    assert found.p_none > max(found.p_unknown, *found.probability, 0.0)
    said = sentence(found, [], [], [], [], None, None, card(base.simulator, base.theta, known), 0.9)
    assert f"Still the likeliest is that nothing is missing ({found.p_none:.2f})." in said


def test_a_page_without_any_set_of_effects_says_how_probable_nothing_and_unknown_are() -> None:
    answer: Any = SimpleNamespace(explanations=[], p_none=0.32, p_unknown=0.68)
    table = diagnosis._explanations(answer)
    assert table.to_dict("list") == {"explanation": ["none", "unknown"], "probability": ["0.320", "0.680"]}


def test_a_set_whose_size_may_be_nothing_is_set_aside_and_spoken_of() -> None:
    # A bias of half of its standard deviation: the fit holds it, its interval holds none.
    base = fitted(recorded(lateral()))
    known = directions(base.simulator, base.theta, CATALOGUE["gyro_bias"])
    found = explain(base, known, rng=np.random.default_rng(0))
    none, examined = found.base.model, found.base
    version = versions(examined)[0]
    extended_model = extended(none, version)
    assert extended_model is not None
    doubtful = replace(found, models=[extended_model], doubtful=[]).supported()
    assert (doubtful.models, doubtful.doubtful) == ([], [extended_model])
    over = replace(doubtful, best=replace(examined, model=extended_model))  # what it leaves over says nothing for it
    assert over.p_unknown > 0.0
    assert "gyro_bias" not in over.single
    aside = _unsupported(extended_model, doubtful.temper)
    assert [*aside.parameters] == ["gyro_bias.z"]
    assert aside.sentence.startswith("gyro_bias would do best, but may as well be nothing (gyro_bias.z = ")
