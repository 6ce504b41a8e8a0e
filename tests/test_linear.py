"""What fits best at first order within bounds, and parameters that come back from the rim of their box."""

from dataclasses import replace

import numpy as np
from recorded import TRUTH, fitted, lateral, recorded
from scipy.optimize import lsq_linear

from vehicle_sbi.inference.directions import directions, slopes
from vehicle_sbi.mismatch.estimation.linearised import Linearised, Profiled, _bounded, profile
from vehicle_sbi.mismatch.estimation.multistart import best
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE


def test_one_bounded_size_is_that_of_bounded_least_squares() -> None:
    # Against scipy's solver, in units that differ by nine orders of magnitude.
    rng = np.random.default_rng(0)
    J = rng.normal(size=(20, 30, 4)) * np.array([1.0, 1e3, 1e-3, 1e6])
    r = rng.normal(size=(20, 30))
    A, g = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
    low, high = np.full((20, 1), -1e-8), np.full((20, 1), 5e-8)
    found = _bounded(A, g, low, high, 3)
    assert np.any(found[:, 3] == high[:, 0])
    assert np.any((found[:, 3] > low[:, 0]) & (found[:, 3] < high[:, 0]))
    for x, matrix, target in zip(found, J, r, strict=True):
        bounds = np.array([[-np.inf] * 3 + [-1e-8], [np.inf] * 3 + [5e-8]])
        exact = np.asarray(lsq_linear(matrix, target, bounds=bounds, method="bvls", tol=1e-14).x)
        np.testing.assert_allclose(
            x * np.array([1.0, 1e3, 1e-3, 1e6]), exact * np.array([1.0, 1e3, 1e-3, 1e6]), atol=1e-6
        )


def test_many_bounded_sizes_are_those_of_bounded_least_squares() -> None:
    # Columns that are alike: what is held first is often not what is held in the end. Against scipy's active sets.
    rng, q = np.random.default_rng(2), 16
    J = rng.normal(size=(60, 40, 1)) * rng.normal(size=(60, 1, 2 + q)) + 0.3 * rng.normal(size=(60, 40, 2 + q))
    r = 3.0 * rng.normal(size=(60, 40))
    A, g = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
    found = _bounded(A, g, np.zeros((60, q)), np.full((60, q), 0.5), 2)
    bounds = np.array([[-np.inf] * 2 + [0.0] * q, [np.inf] * 2 + [0.5] * q])
    exact = np.array([lsq_linear(M, t, bounds=bounds, method="bvls", tol=1e-14).x for M, t in zip(J, r, strict=True)])
    np.testing.assert_allclose(found, exact, atol=1e-6)  # what steadies a solution moves it by about 1e-9 of itself


def test_several_bounded_sizes_lie_within_their_bounds_and_leave_the_others_at_their_best() -> None:
    rng = np.random.default_rng(1)
    J, r = rng.normal(size=(50, 12, 5)), 3.0 * rng.normal(size=(50, 12))
    A, g = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ r[..., None])[..., 0]
    low, high = np.full((50, 3), -0.2), np.full((50, 3), 0.3)
    x = _bounded(A, g, low, high, 2)
    assert np.all((x[:, 2:] >= low - 1e-12) & (x[:, 2:] <= high + 1e-12))
    inside = np.ones(x.shape, dtype=bool)
    inside[:, 2:] = (x[:, 2:] > low + 1e-12) & (x[:, 2:] < high - 1e-12)
    slope = np.einsum("kij,kj->ki", A, x) - g
    assert np.abs(slope[inside]).max() < 1e-6
    assert inside[:, 2:].any()
    assert not inside[:, 2:].all()


def sized(about: Linearised, change: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[Profiled, float]:
    """A direction's profile, and its size's standard deviation: the size over the score that it gains."""
    found = profile(about, change, low, high)
    return found, float(abs(found.size[0, 0]) / np.sqrt(2.0 * (found.log_likelihood[0] - about.alone)))


def test_a_parameter_that_an_effect_has_pushed_to_its_rim_comes_back_beside_it() -> None:
    # The box of the parameter that a steering ratio moves most ends shortly before where that would move it.
    observation = recorded(lateral(), steering_ratio__gain=1.18)
    free = fitted(observation)
    space = free.simulator.space
    k = int(np.argmax(np.abs(free.theta - TRUTH) / space.prior_std))
    edge = TRUTH[k] + 0.9 * (free.theta[k] - TRUTH[k])
    low, high = (TRUTH[k] - 0.5, edge) if free.theta[k] > TRUTH[k] else (edge, TRUTH[k] + 0.5)
    narrow = ParameterSpace(
        (*space.parameters[:k], replace(space.parameters[k], low=low, high=high), *space.parameters[k + 1 :])
    )
    sim = observation.simulator
    held = best(observation.extended(replace(sim, space=narrow)), (narrow.low + narrow.high)[None] / 2)
    assert not held.inside[k]
    (ratio,) = directions(sim, held.theta, CATALOGUE["steering_ratio"])
    change = slopes(held.simulator, held.theta, [ratio])[:, None]
    low, high = np.array([[ratio.low]]), np.array([[ratio.high]])
    about = Linearised.of(held)
    held_there = replace(about, back=about.back[:0])
    (stuck, stuck_std), (back, back_std) = (sized(one, change, low, high) for one in (held_there, about))
    assert back.log_likelihood[0] > stuck.log_likelihood[0] + 5.0
    assert abs(back.size[0, 0] - 0.18) < 3.0 * back_std
    assert abs(stuck.size[0, 0] - 0.18) > 3.0 * stuck_std
