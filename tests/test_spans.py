"""What comes and goes is found when it acts, and is tied to the clock of the recordings that it was found in."""

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from test_effect_prior import stated

from vehicle_sbi.inference.directions import directions, shapes, tile
from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.fit import descend
from vehicle_sbi.mismatch.hypotheses.spans import likeliest_spans
from vehicle_sbi.physics.effects import CATALOGUE


def test_the_likeliest_span_weighs_what_all_spans_weigh_together() -> None:
    # About a fit to noise alone hardly any span is likelier than others; one in which it blew is, by far.
    shares = []
    for force in (0.0, 600.0):
        sim = lateral(seconds=20.0)
        fit = fitted(recorded(sim, gust__force=force, gust__arm=0.3, gust__start=8.0, gust__duration=4.0))
        known = directions(fit.simulator, fit.theta, CATALOGUE["gust"])
        (found,) = likeliest_spans(fit, known)
        expansion = Expansion.of(fit.simulator.space, known, stated(), [found])
        names = [p.name for p in expansion.sizes]
        assert expansion.rates[names.index("gust.force")] == stated().rate_of(found.parameter) * found.share
        tried = len(shapes(fit.simulator, known[0]))
        assert 1.0 / tried <= found.share < 1.0
        shares.append(found.share * tried)
    assert shares[1] < 3.0 < shares[0]


@pytest.mark.parametrize(("start", "duration"), [(3.0, 2.0), (8.0, 4.0)])
def test_a_gust_is_found_within_a_tile_of_when_it_blew(start: float, duration: float) -> None:
    observation = recorded(
        lateral(seconds=20.0), gust__force=600.0, gust__arm=0.3, gust__start=start, gust__duration=duration
    )
    fit = fitted(observation)
    (found,) = likeliest_spans(fit, directions(fit.simulator, fit.theta, CATALOGUE["gust"]))
    said = {p.name: (p.low, x, p.high) for p, x in found.held.items()}
    reach = tile(fit.simulator)
    for name, true in (("gust.start", start), ("gust.duration", duration)):
        low, _, high = said[name]
        assert high - low <= 2.0 * reach * (1.0 + 1e-9)
        assert low - reach <= true <= high + reach  # the shape that is tried begins at a half tile


def test_what_is_tied_to_the_clock_does_not_come_again_in_other_recordings() -> None:
    fit = fitted(recorded(lateral(seconds=20.0)))
    known = directions(fit.simulator, fit.theta, CATALOGUE["gust"])
    expansion = Expansion.of(fit.simulator.space, known, stated(), likeliest_spans(fit, known))
    assert {"gust.start", "gust.duration"} <= {p.name for p in expansion.shapes}
    theta = np.array([*fit.theta, *(0.5 * (p.low + p.high) for p in (*expansion.sizes, *expansion.shapes))])
    theta[expansion.space.column("gust.force")] = 500.0
    blown = descend(fit.observation.freeing(expansion.space.parameters), theta, steps=0)
    assert blown is not None
    there = elsewhere(blown, fit.observation, apart=True)
    timed = [k for k, p in enumerate(expansion.space.parameters) if p.name.startswith("gust.")]
    assert not there.at.J[timed].any()
    np.testing.assert_allclose(there.at.y, fit.at.y)
    assert np.abs(elsewhere(blown, fit.observation, apart=False).at.y - fit.at.y).max() > 0.0
