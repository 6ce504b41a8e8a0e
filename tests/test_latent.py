"""What it would take comes out as what it was: a push on the body, or a sensor that drifts."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.mismatch.estimation.linearised import Linearised, profile
from vehicle_sbi.mismatch.hypotheses.block import bump, clock, stretches
from vehicle_sbi.mismatch.hypotheses.regressor import Law, law_slopes, targets, under
from vehicle_sbi.mismatch.latent import latents, what_it_takes


def test_the_bumps_of_all_stretches_add_up_to_one() -> None:
    sim = lateral()
    t, spans = clock(sim), stretches(sim)
    total = np.sum([bump(t, *span) for span in spans], axis=0)
    inner = (t >= spans[0][1] / 2) & (t <= spans[-1][0])
    np.testing.assert_allclose(total[inner], 1.0)


def test_a_push_on_the_body_is_found_where_and_as_large_as_it_was() -> None:
    # 1500 N to the left for the length of a stretch come out as that, to four of the standard errors that follow
    # from the information about all stretches together.
    sim = lateral()
    course = bump(clock(sim), *stretches(sim)[6])
    push = next(target for target in targets(sim, np.zeros(sim.shape)) if target.name == "force along y")
    law = Law(push, "a stretch", course.reshape(sim.windows.t.shape))
    pushed = under(sim, law).noise_free(np.array([[*TRUTH, 0.0], [*TRUTH, 1500.0]]))
    observation = recorded(sim, seed=3)
    fit = fitted(replace(observation, observed=observation.observed + pushed[1] - pushed[0]))
    found = latents(fit)[0]
    assert found.quantity == "force along y"
    assert found.largest == 6
    courses = [bump(clock(sim), *span).reshape(sim.windows.t.shape) for span in stretches(sim)]
    slopes = law_slopes(sim, fit.theta, fit.at.y, [Law(push, f"{k}", c) for k, c in enumerate(courses)])
    free = np.full((1, len(courses)), np.inf)
    information = profile(Linearised.of(fit), slopes[None], -free, free).information[0]
    assert found.size[6] == pytest.approx(1500.0, abs=4.0 * np.sqrt(np.linalg.inv(information)[6, 6]))


def test_a_sensor_that_drifts_is_told_from_a_force() -> None:
    observation = recorded(lateral(), seed=3)
    drift = np.zeros((3, 500))
    drift[1] = 0.6 * bump(clock(observation.simulator), 4.0, 6.0)
    found = what_it_takes(fitted(replace(observation, observed=observation.observed + drift)))
    assert found is not None
    assert found.quantity == "error of the sensor of a_y"
    assert found.from_s[found.largest] < 5.0 < found.to_s[found.largest]


def test_nothing_is_said_of_noise() -> None:
    assert what_it_takes(fitted(recorded(lateral(), seed=3))) is None
