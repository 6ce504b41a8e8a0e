"""The full model's evidence for an effect is that of a linear model with it against one without."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import expit, logit

from vehicle_sbi.mismatch.estimation.fit import Shrinkage
from vehicle_sbi.mismatch.needed import RATE, needed
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.vehicle import GENERIC_PRIORS

NAMES = ("imu_lever_arm.x", "imu_lever_arm.y", "gyro_bias.z", "aero_drag.area")
PRECISION = np.array([1.0, 11.0, 11.0, 11.0, 11.0])


def linear(J: np.ndarray, r: np.ndarray) -> Any:
    """The full model of a linear problem: r = J x + e with unit noise, x normal with PRECISION about the nulls."""
    space = ParameterSpace((GENERIC_PRIORS["mu"], *(EFFECT_PARAMETERS[name] for name in NAMES)))
    centre = np.array([0.8, 0.0, 0.0, 0.0, 0.0])
    x = np.linalg.solve(J.T @ J + np.diag(PRECISION), J.T @ r)
    return SimpleNamespace(
        simulator=SimpleNamespace(space=space),
        shrinkage=Shrinkage(centre, PRECISION),
        information=J.T @ J,
        theta=centre + x * space.prior_std,
    )


def problem(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(30, 5))
    return J, J @ np.array([0.3, 0.2, -0.1, 0.5, 0.0]) + rng.normal(size=30)


@pytest.mark.parametrize("seed", range(5))
def test_the_ratio_of_densities_is_the_ratio_of_evidences(seed: int) -> None:
    J, r = problem(seed)

    def log_evidence(kept: list[int]) -> float:
        covariance = np.eye(len(r)) + J[:, kept] @ np.diag(1.0 / PRECISION[kept]) @ J[:, kept].T
        return float(-0.5 * (r @ np.linalg.solve(covariance, r) + np.linalg.slogdet(covariance)[1]))

    found = needed(linear(J, r), ("mu",), 1.0)
    groups = {"imu_lever_arm": [0, 3, 4], "gyro_bias": [0, 1, 2, 4], "aero_drag": [0, 1, 2, 3]}
    for effect, without in groups.items():
        gain = log_evidence([0, 1, 2, 3, 4]) - log_evidence(without)
        assert found[effect] == pytest.approx(expit(gain + logit(RATE)), rel=1e-9)


def test_of_two_that_cannot_be_told_apart_each_is_as_needed_as_both() -> None:
    J, r = problem()
    r = r + 4.0 * J[:, 3]
    J[:, 4] = J[:, 3] + 0.01 * J[:, 4]  # drag does what the gyro's bias does
    found = needed(linear(J, r), ("mu",), 1.0)
    assert found["gyro_bias"] > 0.99
    assert found["aero_drag"] > 0.99


def test_what_the_data_do_not_see_is_as_probable_as_before() -> None:
    J, r = problem()
    J[:, 4] = 0.0
    assert needed(linear(J, r), ("mu",), 1.0)["aero_drag"] == pytest.approx(RATE)
