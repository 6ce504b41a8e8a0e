"""Selectors that are compared: on columns that are orthogonal each names what is there and nothing else."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import selectors_compared as selectors

from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.linear_gaussian import LinearGaussian


def orthogonal() -> selectors.Problem:
    """A base column, four sizes of three effects: the first and the last are there by ten and twelve deviations."""
    information = np.array([100.0, 100.0, 100.0, 100.0, 100.0])
    true = np.array([0.5, 1.0, 0.0, 0.0, -1.2])
    names = ("a.x", "b.x", "b.y", "c.x")
    expansion: Any = SimpleNamespace(
        unit=np.ones(5), sizes=[SimpleNamespace(name=name) for name in names], rates=np.full(4, 0.2)
    )
    pruned: Any = SimpleNamespace(
        expansion=expansion,
        fit=SimpleNamespace(simulator=SimpleNamespace(windows=SimpleNamespace(valid=np.ones((1, 500), dtype=bool)))),
    )
    linear = LinearGaussian(np.diag(information), information * true, np.zeros(0, dtype=np.int64))
    return selectors.Problem(cast(Any, pruned), [], linear, EffectPrior())


@pytest.mark.parametrize("method", [selectors.susie, selectors.bic])
def test_what_is_there_is_named_and_nothing_else(method) -> None:
    # An idle effect of SuSiE gives a size of z = 0 its weight 1/8 times 101^-1/2 against 1/2 for none: 0.023. In 16
    # tries (eight idle effects, two sizes) that is 0.31.
    found = method(orthogonal())
    assert found["a"] > 0.99
    assert found["c"] > 0.99
    assert found["b"] < 0.35


def test_an_effect_of_two_sizes_is_there_if_one_of_them_is() -> None:
    p = orthogonal().of_effects(np.array([0.0, 0.5, 0.5, 1.0]))
    assert p == {"a": 0.0, "b": 0.75, "c": 1.0}
