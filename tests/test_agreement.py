"""Sizes that are the same in each recording agree, others do not."""

from dataclasses import replace

import numpy as np
from recorded import fitted, lateral, recorded

from vehicle_sbi.data.windows import joined
from vehicle_sbi.inference.directions import directions
from vehicle_sbi.mismatch.agreement import disagreeing, p_same
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.explain import extended
from vehicle_sbi.mismatch.hypotheses.dictionary import Repertoire
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.detection import Model, glance, versions
from vehicle_sbi.physics.effects import CATALOGUE


def named(sizes: tuple[float, ...], *, seed: int = 0) -> Model:
    """A gyro that is off by so much in each of some recordings, fitted with a constant offset."""
    each = [recorded(lateral(), seed=seed + k, gyro_bias__z=size) for k, size in enumerate(sizes)]
    windows = joined([one.simulator.windows for one in each], [str(k) for k in range(len(each))])
    noise = replace(each[0].simulator.noise, window=windows.t.shape[1])
    simulator = replace(each[0].simulator, windows=windows).with_noise(noise)
    base = fitted(Observation(simulator, np.concatenate([one.observed for one in each], axis=1), True))
    known = directions(base.simulator, base.theta, CATALOGUE["gyro_bias"])
    seen = glance(Model((), base, 0.0), Repertoire.around(base, known), np.random.default_rng(0))
    model = extended(seen.model, versions(seen)[0])
    assert model is not None
    return model


def test_a_size_that_differs_between_recordings_is_doubted() -> None:
    assert disagreeing(named((0.02, 0.0, 0.01))) == ["gyro_bias"]


def test_one_that_is_the_same_is_not_and_of_a_single_recording_nothing_can_be_said() -> None:
    assert disagreeing(named((0.02, 0.02, 0.02))) == []
    alone = named((0.02,))
    assert p_same(Linearised.of(alone.fit), alone, "gyro_bias") == 1.0


def test_p_values_are_no_smaller_than_uniform_ones() -> None:
    # Of twelve, at most four below .1 but in 4 of 1000 (binomial), the variance being taken for half as large again.
    found = []
    for seed in range(12):
        model = named((0.02, 0.02), seed=10 * seed)
        found.append(p_same(Linearised.of(model.fit), model, "gyro_bias"))
    assert np.sum(np.array(found) < 0.1) <= 4
    assert max(found) > 0.1
