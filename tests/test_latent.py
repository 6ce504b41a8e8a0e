"""What it would take comes out as what it was: a push on the body, or a sensor that drifts."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded

from vehicle_sbi.mismatch.candidates import responses
from vehicle_sbi.mismatch.latent import DURATION, FORCES, START, latents, what_it_takes
from vehicle_sbi.mismatch.locate import bump, clock, stretches


def test_the_bumps_of_all_stretches_add_up_to_one() -> None:
    sim = lateral()
    t, spans = clock(sim), stretches(sim)
    total = np.sum([bump(t, *span) for span in spans], axis=0)
    inner = (t >= spans[0][1] / 2) & (t <= spans[-1][0])
    np.testing.assert_allclose(total[inner], 1.0)


def test_a_push_on_the_body_is_found_where_and_as_large_as_it_was() -> None:
    # 1500 N to the left for the length of a stretch: what it takes in that stretch is that, to four standard errors,
    # which the noise of a_y (0.15 m/s^2) over 1.5 s at 50 Hz makes 0.15 m / sqrt(75) each.
    sim = lateral()
    start, stop = stretches(sim)[6]
    push = {FORCES["force along y"]: 1500.0, START: start, DURATION: stop - start}
    clean, pushed = responses(sim, TRUTH, [{}, push])
    observation = recorded(sim, seed=3)
    fit = fitted(replace(observation, observed=observation.observed + pushed - clean))
    found = latents(fit)[0]
    assert found.quantity == "force along y"
    assert found.from_s[found.largest] == pytest.approx(start)
    assert found.size[6] == pytest.approx(1500.0, abs=4 * 0.15 / np.sqrt(75) * float(sim.nominal["m"]) * 2)


def test_a_sensor_that_drifts_is_told_from_a_force() -> None:
    observation = recorded(lateral(), seed=3)
    drift = np.zeros((3, 500))
    drift[1] = 0.6 * bump(clock(observation.simulator), 4.0, 6.0)
    found = what_it_takes(fitted(replace(observation, observed=observation.observed + drift)))
    assert found is not None
    assert found.quantity == "drift of the sensor of a_y"
    assert found.from_s[found.largest] < 5.0 < found.to_s[found.largest]


def test_nothing_is_said_of_noise() -> None:
    assert what_it_takes(fitted(recorded(lateral(), seed=3))) is None
