"""Base parameters averaged over models, and effects that a fit does not support."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded
from scipy.stats import truncnorm

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.estimation.fit import Fit, descend, log_volume
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.full_model import free_at_once, full_model
from vehicle_sbi.mismatch.model_average import averaged
from vehicle_sbi.mismatch.selection.detection import Model
from vehicle_sbi.mismatch.support import unsupported
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS


@pytest.fixture(scope="module")
def found() -> Explanation:
    base = fitted(recorded(lateral(), gyro_bias__z=-0.02))
    known = [d for d in left_out(base.simulator, base.theta) if d.effect in ("gyro_bias", "accelerometer_bias")]
    return explain(base, known, rng=np.random.default_rng(0))


def test_an_average_over_one_model_is_its_own_truncated_normal(found: Explanation) -> None:
    fit, space = found.base.model.fit, found.base.model.fit.simulator.space
    alone = replace(found, models=[], unnamed=[], best=found.base)
    std = np.sqrt(np.diag(fit.tempered(alone.temper)))
    for p, estimate, mean, s in zip(space.parameters, averaged(alone).values(), fit.theta, std, strict=True):
        exact = truncnorm((p.low - mean) / s, (p.high - mean) / s, loc=mean, scale=s)
        # 200 quantiles: the mean of a normal is exact to a hundredth of its standard deviation, quantiles too.
        assert estimate.mean == pytest.approx(exact.mean(), abs=0.01 * s)
        assert estimate.std == pytest.approx(exact.std(), rel=0.02)
        assert [estimate.q05, estimate.q95] == pytest.approx(exact.ppf([0.05, 0.95]), abs=0.02 * s)


def test_the_variance_of_an_average_is_that_within_models_and_between_them(found: Explanation) -> None:
    counted = [(model, share) for model, share in found.shares if share > 1e-3]
    weight = np.array([share for _, share in counted])
    weight = weight / weight.sum()
    name = found.base.model.fit.simulator.space.names[0]
    each = []
    for model, _ in counted:
        k = model.fit.simulator.space.column(name)
        each.append((model.fit.theta[k], model.fit.tempered(found.temper)[k, k]))
    means, variances = np.array(each).T
    mean = float(weight @ means)
    between = float(weight @ (means - mean) ** 2)
    assert averaged(found)[name].mean == pytest.approx(mean, abs=0.05 * np.sqrt(variances.max()))
    assert averaged(found)[name].std ** 2 == pytest.approx(float(weight @ variances) + between, rel=0.05)


def sized(value: float) -> Model:
    """A fit whose gyro bias lies so many of its standard deviations from nothing."""
    sim = lateral()
    observation = recorded(sim, gyro_bias__z=-0.02).freeing([*sim.space.parameters, EFFECT_PARAMETERS["gyro_bias.z"]])
    fit = descend(observation, np.array([*TRUTH, -0.02]))
    assert fit is not None
    std = float(np.sqrt(fit.tempered(0.5)[-1, -1]))
    moved = replace(fit, theta=np.array([*fit.theta[:-1], value * std]))
    return Model(("gyro_bias",), moved, 0.0)


@pytest.mark.parametrize(("value", "named"), [(1.6, False), (-1.6, False), (1.7, True), (-1.7, True)])
def test_an_effect_is_supported_where_its_interval_leaves_out_nothing(value: float, named: bool) -> None:
    # The 90 % interval of a normal reaches 1.645 standard deviations; the information moves by less than 3 %.
    assert (unsupported(sized(value), {"gyro_bias.z"}, 0.5) == []) is named


def test_draws_on_both_sides_of_nothing_support_no_effect() -> None:
    model = sized(10.0)
    draws = np.repeat(model.fit.theta[None], 100, axis=0)
    draws[::2, -1] *= -1.0
    assert unsupported(replace(model, posterior=draws), {"gyro_bias.z"}, 0.5) == ["gyro_bias"]


def test_what_a_prior_says_counts_in_full_however_evidence_is_tempered(found: Explanation) -> None:
    """Odds of two sets change by as much as those of their priors do."""
    one, other = found.models[0], found.base.model
    belief = replace(found.belief, effects=(0.1, 0.8, 0.1))
    before, after = ([model.weight(b, found.temper) for model in (one, other)] for b in (found.belief, belief))
    assert (after[0] - after[1]) - (before[0] - before[1]) == pytest.approx(np.log(0.8 / 0.18) - np.log(0.1 / 0.03))


def test_a_parameter_that_is_not_seen_costs_no_evidence() -> None:
    seen = np.array([[4e4, 1e3], [1e3, 9e4]])
    unseen = np.zeros((3, 3))
    unseen[:2, :2] = seen
    assert log_volume(unseen) == pytest.approx(log_volume(seen))
    # One that is seen well fills sqrt(2 pi) of its standard deviations of sqrt(12) of the prior's.
    assert log_volume(np.array([[1e8]])) == pytest.approx(np.log(np.sqrt(2 * np.pi) * 1e-4 / np.sqrt(12.0)), abs=1e-6)


def test_the_full_model_finds_base_parameters_that_the_base_model_has_bent() -> None:
    # An accelerometer's gain and a gyro's bias: the base model bends its stiffnesses, the full one does not.
    base = fitted(recorded(lateral(seconds=20.0), accelerometer_scale__y=1.15, gyro_scale__z=0.9))
    full = full_model(base, left_out(base.simulator, base.theta))
    assert full is not None

    def off(fit: Fit) -> float:
        space = base.simulator.space
        return float(np.linalg.norm((fit.theta[: len(TRUTH)] - TRUTH) / space.prior_std))

    assert off(full) < off(base)
    assert full.log_likelihood > base.log_likelihood


def test_what_is_tied_to_the_clock_is_not_free_at_once() -> None:
    sim = lateral()
    names = {p.name.split(".")[0] for p in free_at_once(left_out(sim, TRUTH))}
    assert "body_roll" in names
    assert not names & {"gust", "friction_step", "road_grade_profile"}
