"""What is foretold of other recordings: an exact density, calibrated surprise, and names told apart by it."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from scipy.stats import kstest

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.explanation import DOUBTED, Explanation, doubted
from vehicle_sbi.mismatch.foretell import foretold
from vehicle_sbi.mismatch.loose import courses
from vehicle_sbi.mismatch.problem.case import halves
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.detection import Model
from vehicle_sbi.physics.single_track import INPUTS


def faster(sim: Simulator, factor: float) -> Simulator:
    """The same steering at another speed."""
    windows, v_x = sim.windows, INPUTS.index("v_x")
    u, x0 = windows.u.copy(), windows.x0.copy()
    u[..., v_x] *= factor
    x0[:, 0] *= factor
    return replace(sim, windows=replace(windows, u=u, x0=x0))


def short(observation: Observation, samples: int = 40) -> Observation:
    """The last so many samples of each channel, few enough for a dense covariance."""
    time = observation.simulator.windows.valid.shape[1]
    return observation.masked(np.arange(time) >= time - samples)


@pytest.mark.parametrize(("rho", "wanders"), [(0.0, False), (0.6, False), (0.6, True)])
def test_the_density_is_that_of_a_normal_with_noise_and_parameters_in_its_covariance(rho: float, wanders: bool) -> None:
    # Initial states are known here, so that there is nothing else; without the constant of the standard normal.
    sim = lateral(rho=rho)
    fit = fitted(replace(recorded(sim), estimated=False))
    held = short(recorded(sim, seed=4))
    there = Fit(held, fit.theta, fit.at)
    valid = held.simulator.windows.valid
    lag = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    noise = [std**2 * r**lag for std, r in zip(fit.simulator.noise.floor, fit.simulator.noise.rho, strict=True)]
    J = fit.at.J[:, valid] / fit.simulator.space.prior_std[:, None]
    C = np.zeros((120, 120))
    for c, block in enumerate(noise):
        C[40 * c : 40 * c + 40, 40 * c : 40 * c + 40] = block
    C += J.T @ fit.covariance @ J
    gyro = next(one for one in courses(Linearised.of(fit)) if one.target.name == "error of the sensor of yaw_rate")
    if wanders:
        rows = gyro.rows(there)[:, valid]
        assert np.abs(rows).max() > 0.01 * fit.simulator.noise.floor[2]
        C += rows.T @ rows
    r = there.residual[valid]
    expected = -0.5 * r @ np.linalg.solve(C, r) - 0.5 * np.linalg.slogdet(C)[1]
    found = foretold(Model((), fit, 0.0, outside=gyro if wanders else None), held)
    assert found is not None
    assert found.log_likelihood == pytest.approx(expected, rel=1e-6)


def test_parameters_that_stay_are_no_surprise_and_those_that_change_are() -> None:
    # The statistic is divided by LENIENT, so p is stochastically larger than uniform: its distribution function must
    # not exceed that of the uniform by more than Kolmogorov's one-sided bound at 0.1 %.
    sim = lateral()
    found = []
    for seed in range(20):
        fit = fitted(replace(recorded(sim, seed=seed), estimated=False))
        one = foretold(Model((), fit, 0.0), recorded(sim, seed=100 + seed))
        assert one is not None
        found.append(one.p_value)
    assert kstest(found, "uniform", alternative="greater").pvalue > 1e-3
    changed = recorded(sim, seed=50, steering_ratio__gain=1.1)
    fit = fitted(replace(recorded(sim), estimated=False))
    one = foretold(Model((), fit, 0.0), changed)
    assert one is not None
    assert one.p_value < 1e-3


def test_a_simulation_that_fails_foretells_nothing() -> None:
    fit = fitted(recorded(lateral()))
    stalled = faster(lateral(), np.nan)
    assert foretold(Model((), fit, 0.0), Observation(stalled, np.zeros_like(fit.residual), True)) is None


@pytest.fixture(scope="module")
def alike() -> Explanation:
    """A constant yaw moment, which at one speed is an offset of the steering; both tell little else."""
    observation = recorded(lateral(), yaw_moment__moment=300.0)
    base = fitted(observation)
    tried = ("yaw_moment", "steering_offset")
    known = [d for d in left_out(base.simulator, base.theta) if d.effect in tried]
    return explain(base, known, rng=np.random.default_rng(0))


def probability(found: Explanation, effect: str) -> float:
    return dict(zip([m.effects for m in found.models], found.probability, strict=True))[(effect,)]


def test_a_drive_at_another_speed_tells_apart_what_fits_alike(alike: Explanation) -> None:
    further = recorded(faster(lateral(), 2.0), seed=7, yaw_moment__moment=300.0)
    told = alike.foretelling(further)
    assert abs(np.log(probability(alike, "yaw_moment") / probability(alike, "steering_offset"))) < np.log(20)
    assert probability(told, "yaw_moment") > 20 * probability(told, "steering_offset")
    assert told.models[0].effects == ("yaw_moment",)
    assert next(iter(told.single)) == "yaw_moment"
    assert told.single["yaw_moment"] >= probability(told, "yaw_moment")
    assert sum(told.probability) + told.p_none + told.p_unknown == pytest.approx(1.0)


def test_what_harms_elsewhere_is_doubted_and_makes_something_unknown_likelier(alike: Explanation) -> None:
    calm = recorded(faster(lateral(), 2.0), seed=7)  # nothing is missing there
    told = alike.foretelling(calm)
    assert all(doubted(model) for model in told.models)
    assert told.models[0].told < DOUBTED
    assert told.p_unknown + told.p_none > alike.p_unknown + alike.p_none


def test_what_even_the_best_leaves_over_elsewhere_counts_as_noise(alike: Explanation) -> None:
    # A wave on the accelerometer that no model has, of three times the noise's standard deviation: likelihoods are
    # taken under noise as large as that, so they differ by less, as the mean square of what is left over grows.
    further = recorded(faster(lateral(), 2.0), seed=7, yaw_moment__moment=300.0)
    std = further.simulator.noise.floor[0]
    time = further.observed.shape[1]
    wave = np.zeros_like(further.observed)
    wave[0] = 3.0 * np.sqrt(2.0) * std * np.sin(2.0 * np.pi * np.arange(time) / 10.0)
    loud = replace(further, observed=further.observed + np.where(further.simulator.windows.valid, wave, 0.0))
    calm, spoilt = ({m.effects: m.told for m in alike.foretelling(one).models} for one in (further, loud))
    # Three channels of mean square 1 + 9, 1 and 1 have 4 together.
    for effects, told in calm.items():
        assert spoilt[effects] == pytest.approx(told / 4.0, rel=0.25)


def test_what_the_catalogue_does_not_have_is_in_the_order_that_is_foretold(alike: Explanation) -> None:
    model = alike.models[0]
    told = replace(alike, unnamed=[replace(model, told=gain) for gain in (-5.0, 5.0, 0.0)]).in_order()
    assert [model.told for model, _ in told.laws] == [5.0, 0.0, -5.0]


def test_where_something_unknown_is_likelier_than_known_sets_the_one_leads_that_it_stands_beside(
    alike: Explanation,
) -> None:
    one = alike.models[0]
    pair = replace(one, effects=("gust", "payload"), told=40.0)  # makes up for the reluctance against pairs
    for gain, leading in ((0.0, pair), (200.0, one)):
        found = replace(alike, models=[one, pair], unnamed=[replace(one, told=gain)]).in_order()
        assert found.known_leads is (leading is pair)
        assert found.probability[found.models.index(pair)] > found.probability[found.models.index(one)]
        assert found.models[0] is leading


def test_halves_share_no_sample_and_lose_none() -> None:
    held = recorded(lateral())
    whole = held.simulator.windows.valid
    for windows in (1, 2, 5):
        length = whole.shape[1] // windows
        t, u = (
            np.reshape(x, (windows, length, *x.shape[2:])) for x in (held.simulator.windows.t, held.simulator.windows.u)
        )
        x0 = np.repeat(held.simulator.windows.x0, windows, axis=0)
        cut = replace(held.simulator, windows=replace(held.simulator.windows, t=t, u=u, x0=x0))
        naming, proving = (half.simulator.windows.valid for half in halves(replace(held, simulator=cut)))
        assert np.array_equal(naming ^ proving, whole)
        assert naming.sum() >= proving.sum() > 0
