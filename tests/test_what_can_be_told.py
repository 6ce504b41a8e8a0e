"""The linear model's own recordings: their truth is what is stated, their products what the model says."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import selectors_compared as selectors
import what_can_be_told as told

from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.linear_gaussian import LinearGaussian
from vehicle_sbi.parameters import Parameter

STD = np.sqrt(1.0 / 12.0)  # of a box of width 1


def box(name: str, low: float, high: float, null: float | None = None) -> Parameter:
    return Parameter(name=name, unit="1", low=low, high=high, fields=(), null=null)


@pytest.fixture
def problem() -> selectors.Problem:
    """A base parameter, sizes of three effects and a shape, whose column comes before those of the sizes."""
    expansion = Expansion(
        base=(box("l_f", 1.0, 2.0),),
        sizes=(
            box("aero_drag.area", 0.0, 2.0, 0.0),
            box("gyro_scale.z", 0.8, 1.25, 1.0),
            box("body_roll.gradient", 0.0, 0.1, 0.0),
        ),
        shapes=(box("body_roll.lag", 0.0, 0.1, 0.0),),
        typical=np.array([0.5, 0.01, 0.01]),
        rates=np.full(3, 0.1),
    )
    drawn, fitted = np.array([[1.4, 0.3, 1.004, 0.006, 0.07]] * 2), np.array([1.4, 0.3, 1.0, 0.006, 0.05 - 0.05 * STD])
    pruned: Any = SimpleNamespace(expansion=expansion, theta=drawn, fit=SimpleNamespace(theta=fitted))
    root = np.random.default_rng(0).standard_normal((7, 7))  # two columns of a discrepancy come last
    linear = LinearGaussian(root @ root.T, np.zeros(7), np.array([7]))
    return selectors.Problem(cast(Any, pruned), [], linear, EffectPrior())


def test_truth_is_what_is_stated_and_else_what_was_found_of_what_is_there(problem: selectors.Problem) -> None:
    truth = {
        "base_parameters": {"l_f": 1.6},
        "effects": {"aero_drag": {"inside": True, "parameters": {"area": 0.7}}},
        "inherent": ["body_roll"],
    }
    # the drag and l_f are stated, the gyro has its scale, roll and the shape are as they were found
    np.testing.assert_array_equal(told.truth_of(problem, truth), [1.6, 0.7, 1.0, 0.006, 0.07])
    # of a body that does not roll the shape is held where it is fitted
    still = told.truth_of(problem, truth | {"inherent": []})
    np.testing.assert_array_equal(still, [1.6, 0.7, 1.0, 0.0, problem.pruned.fit.theta[-1]])


def test_recordings_have_the_truth_and_the_noise_of_the_model(problem: selectors.Problem) -> None:
    rng, H = np.random.default_rng(1), problem.linear.H
    # logarithms of what is positive, in shares of the box's middle; the shape from the fit on, half a deviation below
    theta = np.array([1.5 * np.exp(0.5 * STD / 1.5), 1.0, np.exp(-0.03), 0.01, 0.05 + 0.1 * STD])
    coefficient = np.array([0.5, 1.5, 2.0, -3.0, 1.0, 0.0, 0.0])  # base, shape, sizes; no discrepancy
    n = 4000
    b = np.array([told.exact(problem, theta, rng).linear.b for _ in range(n)])
    off = np.linalg.solve(np.linalg.cholesky(H), (b - H @ coefficient).T)  # standard normal, independent
    # means have a standard deviation of n^-1/2, products one of that as well, squares of 2^1/2 times that
    assert np.abs(off.mean(axis=1)).max() < 4.0 / np.sqrt(n)
    assert np.abs(off @ off.T / n - np.eye(7)).max() < 4.0 * np.sqrt(2.0 / n)
