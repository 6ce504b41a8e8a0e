"""What was put into a recording is what comes out: nothing, a known effect, or something unknown."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.answer.verdict import estimates, places
from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.estimation.fit import descend, settled
from vehicle_sbi.mismatch.explain import exchanged, explain, extended
from vehicle_sbi.mismatch.explanation import LAPSE, Explanation
from vehicle_sbi.mismatch.hypotheses.dictionary import Repertoire
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.detection import Model, examine, versions
from vehicle_sbi.physics.single_track import INPUTS


def explained(observation: Observation) -> Explanation:
    base = fitted(observation)
    return explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))


def test_nothing_is_said_where_nothing_is_missing() -> None:
    found = explained(recorded(lateral(), seed=5))
    assert not found.detected
    assert found.p_none > 0.5
    assert found.p_none + found.p_unknown + sum(found.probability) == pytest.approx(1.0)
    assert found.p_unknown >= LAPSE


def test_a_known_effect_is_named_with_its_size() -> None:
    found = explained(recorded(lateral(), body_roll__gradient=0.012))
    assert found.detected
    held = {effects for model in found.indistinguishable() for effects in [model]}
    assert any("body_roll" in effects for effects in held)
    (model,) = [m for m in found.models if m.effects == ("body_roll",)]
    gradient = estimates(model)["body_roll.gradient"]
    assert abs(gradient.mean - 0.012) < 4 * gradient.std
    assert sum(found.probability) + found.p_none + found.p_unknown == pytest.approx(1.0)


def test_a_set_is_tried_again_without_each_of_its_effects() -> None:
    """What was put in first may have stood for what came later: here it is one too many."""
    base = Model((), fitted(recorded(lateral(), gyro_bias__z=-0.02)), 0.0)
    known = [d for d in left_out(base.fit.simulator, base.fit.theta) if d.effect in ("body_roll", "gyro_bias")]
    repertoire, rng = Repertoire.around(base.fit, known), np.random.default_rng(0)
    first = {version.effect: version for version in versions(examine(base, repertoire, rng))}
    (one_too_many,) = [m for m in [extended(base, first["body_roll"])] if m is not None]
    (both,) = [m for m in [extended(one_too_many, first["gyro_bias"])] if m is not None]
    found = {model.effects: model for model in exchanged(both, repertoire, rng)}
    assert {("body_roll",), ("gyro_bias",)} <= found.keys()
    belief = Belief()
    assert found["gyro_bias",].weight(belief) > both.weight(belief) > found["body_roll",].weight(belief)


def test_what_no_effect_explains_is_unknown_and_is_located() -> None:
    # A burst of 8 standard deviations on one channel that no car makes: a wave at a quarter of the sampling rate would
    # be noise, so a bump that comes and goes twice.
    observation = recorded(lateral(), seed=1)
    t = np.arange(500) / 50.0
    burst = 1.2 * np.sin(2 * np.pi * (t - 6.0) / 2.0) * ((t > 6.0) & (t < 8.0))
    found = explained(replace(observation, observed=observation.observed + np.array([burst, 0 * t, 0 * t])))
    assert found.detected
    assert found.p_unknown > 0.5
    first = next(place for place in places(found) if not place.regime)
    assert first.channel == "a_x"
    assert first.from_s < 7.0 < first.to_s


def test_what_comes_and_goes_is_found_between_the_spans_that_were_tried() -> None:
    # From 2.3 to 6.2 s, beside a gyro's bias; the tried spans of this recording last 0.6, 1.2, 2.5 or 5 s.
    found = explained(
        recorded(lateral(), gust__force=-900.0, gust__arm=0.3, gust__start=2.3, gust__duration=3.9, gyro_bias__z=-0.02)
    )
    assert found.models[0].effects == ("gust", "gyro_bias")
    size = estimates(found.models[0])
    for name, value in (("start", 2.3), ("duration", 3.9)):
        assert size[f"gust.{name}"].mean == pytest.approx(value, abs=max(4 * size[f"gust.{name}"].std, 0.02))


def test_a_force_is_tried_at_each_place_at_its_best_time() -> None:
    # With its times still those of whole tiles, a lever arm of -1 m is likelier by 36 than one of +1 m; with its times
    # searched it falls short of the truth by more than 100.
    sim = lateral(seconds=20.0)
    observation = recorded(sim, seed=4, gust__force=1500.0, gust__arm=0.3, gust__start=9.0, gust__duration=3.0)
    base = Model((), fitted(observation), 0.0)
    known = [d for d in left_out(sim, base.fit.theta) if d.effect == "gust"]
    (version,) = versions(examine(base, Repertoire.around(base.fit, known), np.random.default_rng(0)))
    found = extended(base, version)
    assert found is not None
    truth = {"gust.force": 1500.0, "gust.arm": 0.3, "gust.start": 9.0, "gust.duration": 3.0}
    start = [*TRUTH, *(truth[name] for name in found.fit.simulator.space.names[len(TRUTH) :])]
    best = descend(found.fit.observation, np.array(start))
    assert best is not None
    assert found.fit.log_likelihood > best.log_likelihood - 1.0


@pytest.mark.parametrize(("steering", "factor"), [(1.0, 0.5), (1.3, 0.4)])
def test_grip_that_is_lost_for_a_while_is_fitted_as_well_as_from_the_truth(steering: float, factor: float) -> None:
    # What a small step does says nothing of it, and what a large one does is out of proportion: from the sizes that
    # follow from them the first is missed altogether, and the second falls short of the truth by more than 100.
    sim = lateral()
    u = sim.windows.u.copy()
    u[..., INPUTS.index("steering")] *= steering
    sim = replace(sim, windows=replace(sim.windows, u=u))
    truth = {"factor": factor, "start": 4.0, "duration": 3.0}
    observation = recorded(sim, seed=2, **{f"friction_step__{name}": value for name, value in truth.items()})
    base = Model((), fitted(observation), 0.0)
    known = [d for d in left_out(sim, base.fit.theta) if d.effect == "friction_step"]
    (version,) = versions(examine(base, Repertoire.around(base.fit, known), np.random.default_rng(0)))
    found = extended(base, version)
    assert found is not None
    wider = base.fit.observation.extended(replace(sim, space=found.fit.simulator.space, noise=base.fit.simulator.noise))
    names = wider.simulator.space.names[len(TRUTH) :]
    best = settled(descend(wider, np.array([*TRUTH, *(truth[name.split(".")[1]] for name in names)])))
    assert best is not None
    assert found.fit.log_likelihood > best.log_likelihood - 1.0
