"""Scores are sizes over their standard deviations, and p-values are uniform under the null."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.stats import kstest

from vehicle_sbi.inference.directions import Direction, directions, slopes
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses import block, quantisation
from vehicle_sbi.mismatch.hypotheses.hypothesis import Hypothesis
from vehicle_sbi.mismatch.selection.score_test import Scores, score
from vehicle_sbi.physics.effects import CATALOGUE


def scores(b: float, information: float, low: float, high: float) -> Scores:
    """Of a direction whose log likelihood is b a - information a^2 / 2."""
    size = np.clip(b / information, low, high)
    gain = max(b * size - 0.5 * information * size**2, 0.0)
    nothing = np.zeros((1, 1))
    return Scores(np.array([gain]), np.array([size]), nothing, together=nothing[0], null_together=nothing)


def along(fit: Fit, found: list[Direction]) -> list[Hypothesis]:
    """Directions with what a unit of each does."""
    changes = slopes(fit.simulator, fit.theta, found)
    return [Hypothesis(d.parameter.name, d.low, d.high, change) for d, change in zip(found, changes, strict=True)]


def stretches_of(fit: Fit, *channels: str) -> list[Hypothesis]:
    """Every stretch of time of some channels."""
    return [one for one in block.tested(fit) if one.block and one.block.channel in channels and not one.block.regime]


def test_a_size_of_the_wrong_sign_explains_nothing() -> None:
    assert scores(-9.0, 4.0, 0.0, 2.0).z[0] == 0.0
    assert scores(-9.0, 4.0, -3.0, 2.0).z[0] == pytest.approx(-4.5)


def test_the_size_of_a_bias_comes_out_as_it_went_in() -> None:
    # Linear in the data: off by the noise alone, whose standard deviation is the size over its score; four of it.
    fit = fitted(recorded(lateral(), accelerometer_bias__x=0.2))
    found = directions(fit.simulator, fit.theta, CATALOGUE["accelerometer_bias"])
    about = Linearised.of(fit)
    s = score(about, along(fit, found), quantisation.together(about), rng=np.random.default_rng(0), draws=200)
    assert s.size[0] == pytest.approx(0.2, abs=4 * s.size[0] / s.z[0])
    assert s.p_value() <= 2 / 201  # of two statistics, each of which has a largest in drawn noise


@pytest.mark.parametrize("unit", [1e-7, 1e6])
def test_scores_do_not_depend_on_the_unit_of_a_size(unit: float) -> None:
    # Steering compliance is a millionth of a radian a newton, a load hundreds of kilogrammes; both stand beside the
    # fit's own parameters in one system of equations, which is solved in double precision.
    fit = fitted(recorded(lateral(), steering_compliance__coefficient=5e-7))
    found = directions(fit.simulator, fit.theta, CATALOGUE["steering_compliance"])
    in_units = [
        [replace(d, low=d.low / f, high=d.high / f, change=d.change * f) for d in along(fit, found)]
        for f in (1e-6, 1e-6 / unit)
    ]
    one, other = (score(Linearised.of(fit), d, [], rng=np.random.default_rng(0), draws=20) for d in in_units)
    np.testing.assert_allclose(other.z, one.z, rtol=1e-4)
    np.testing.assert_allclose(other.size, one.size * unit, rtol=1e-4)


@pytest.mark.parametrize(
    ("rho", "seconds", "recordings"), [(0.0, 5.0, 30), pytest.param(0.9, 10.0, 60, marks=pytest.mark.slow)]
)
def test_p_values_are_uniform_where_nothing_is_missing(rho: float, seconds: float, recordings: int) -> None:
    # Noise and parameters are fitted to each. A Kolmogorov-Smirnov test at 0.1 % keeps chance out, of
    # the largest score alone, and beside all stretches of each channel together.
    sim, found = lateral(rho=rho, seconds=seconds), []
    p, together = [], []
    for seed in range(recordings):
        fit = fitted(recorded(sim, seed=seed))
        found = found or [
            d for name in ("gyro_bias", "accelerometer_bias", "yaw_inertia", "steering_offset")
            for d in directions(fit.simulator, fit.theta, CATALOGUE[name])
        ]  # fmt: skip
        about = Linearised.of(fit)
        stairs, bumps = quantisation.together(about), stretches_of(fit, *sim.windows.channels)
        p.append(score(about, along(fit, found), stairs, rng=np.random.default_rng(seed), draws=150).p_value())
        at_once = [*block.together(about, bumps), *stairs]
        together.append(score(about, bumps, at_once, rng=np.random.default_rng(seed), draws=150).p_value())
    assert kstest(p, "uniform").pvalue > 1e-3
    assert kstest(together, "uniform").pvalue > 1e-3


def test_a_walk_is_no_noise_once_it_remembers_for_long() -> None:
    # A gyro whose zero walks 0.02 rad/s in a second; its steps alone are as white as any noise.
    observation = recorded(lateral(), seed=3)
    walk = 0.02 * np.sqrt(1 / 50) * np.cumsum(np.random.default_rng(1).standard_normal(500))
    off = observation.observed.copy()
    off[2] += walk
    fit = fitted(replace(observation, observed=off))
    about, bumps = Linearised.of(fit), stretches_of(fit, "yaw_rate")
    at_once = [*block.together(about, bumps), *quantisation.together(about)]
    s = score(about, bumps, at_once, rng=np.random.default_rng(0), draws=200)
    assert s.p_value() < 0.05
