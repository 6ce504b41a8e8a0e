"""What was put into a recording is what comes out: nothing, a known effect, or something unknown."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.mismatch.candidates import left_out
from vehicle_sbi.mismatch.explain import Explanation, explain
from vehicle_sbi.mismatch.fit import Observation
from vehicle_sbi.mismatch.verdict import estimates, places


def explained(observation: Observation) -> Explanation:
    base = fitted(observation)
    return explain(base, left_out(base.simulator, base.theta), rng=np.random.default_rng(0))


def test_nothing_is_said_where_nothing_is_missing() -> None:
    found = explained(recorded(lateral(), seed=5))
    assert not found.detected
    assert found.p_none > 0.5
    assert found.p_none + found.p_unknown + sum(found.probability) == pytest.approx(1.0)


def test_a_known_effect_is_named_with_its_size() -> None:
    found = explained(recorded(lateral(), body_roll__gradient=0.012))
    assert found.detected
    held = {effects for model in found.indistinguishable() for effects in [model]}
    assert any("body_roll" in effects for effects in held)
    (model,) = [m for m in found.models if m.effects == ("body_roll",)]
    gradient = estimates(model.fit)["body_roll.gradient"]
    assert abs(gradient.mean - 0.012) < 4 * gradient.std
    assert sum(found.probability) + found.p_none + found.p_unknown == pytest.approx(1.0)


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
