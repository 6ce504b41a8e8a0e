"""A sensor that reads in steps is found by them, however deep in the noise, and noise alone looks like none."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.stats import kstest

from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses.quantisation import (
    COARSEST,
    FINEST,
    PHASE,
    Staircase,
    Staircases,
    _steps,
    rounding,
    together,
)
from vehicle_sbi.mismatch.problem.observation import Observation

YAW = 2  # channel


def read_in_steps(step: float, *, seed: int = 0, rho: float = 0.0) -> Observation:
    """A recording whose yaw rate is rounded before the noise comes."""
    sim = lateral(rho=rho)
    quiet, noisy = recorded(sim.with_noise(replace(sim.noise, floor=1e-9 * sim.noise.floor))), recorded(sim, seed=seed)
    y = noisy.observed.copy()
    y[YAW] += rounding(quiet.observed[YAW], step)
    return replace(noisy, observed=y)


@pytest.mark.parametrize(("times", "rho"), [(1.5, 0.0), (3.0, 0.0), (3.0, 0.6)])
def test_steps_as_large_as_the_noise_are_found(times: float, rho: float) -> None:
    # The step to within three points of the grid: one by which it misses the step, and one each by which noise moves
    # the likeliest up or down. No other step gains as much.
    sim = lateral(rho=rho)
    step = times * float(sim.noise.floor[YAW])
    about = Linearised.of(fitted(read_in_steps(step, rho=rho)))
    one = next(one for one in Staircase.of_each(about) if one.channel == YAW)
    near = np.abs(1.0 / one.steps - 1.0 / step) * np.abs(one.said).max() < 3.0 * PHASE
    left = about.absorbed(about.residual)
    best, others = (float(replace(one, steps=one.steps[which]).gains(left)[0]) for which in (near, ~near))
    assert best == pytest.approx(one.gains(left)[0], rel=1e-5)  # in single precision
    assert best > others
    assert np.sqrt(2.0 * best) > 5.0


def test_noise_alone_is_scored_as_noise_is() -> None:
    # The rank of a recording's largest gain among those of drawn noise is uniform under the model; 1/200 is the
    # resolution of the ranks, and Kolmogorov's bound is at 0.1 %.
    ranks = []
    for seed in range(25):
        about = Linearised.of(fitted(recorded(lateral(), seed=seed)))
        (tested,) = together(about)
        here = tested.gains(about.absorbed(about.residual))[0]
        drawn = tested.gains(about.absorbed(about.drawn(199, np.random.default_rng(seed))))
        ranks.append((1 + np.sum(drawn >= here)) / 200)
    assert kstest(ranks, "uniform").pvalue > 1e-3


def test_one_of_the_steps_stays_in_phase_with_any() -> None:
    said, std = np.linspace(12.0, 19.0, 300), 0.2
    steps = _steps(said, std)
    assert steps[0] == pytest.approx(COARSEST * 7.0)
    assert steps[-1] >= FINEST * std
    for true in np.geomspace(1.01 * steps[-1], 0.99 * steps[0], 50):
        assert np.abs(said.max() * (1.0 / steps - 1.0 / true)).min() <= PHASE * (1.0 + 1e-9)


def test_a_channel_with_a_range_of_no_more_than_noise_has_no_steps() -> None:
    assert _steps(np.linspace(-1.0, 1.0, 100), 1.0).size == 0
    assert np.array_equal(Staircases([]).gains(np.zeros((3, 1, 5))), np.zeros(3))
