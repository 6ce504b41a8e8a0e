"""The loop between loads and forces: Broyden's method by its laws, and answers that no start changes."""

import numpy as np
import pytest
from cars import PAPER, RATE, exciting, rate_of, record_of

from vehicle_sbi.physics.balance import LEAST_ANSWER, Unknowns, corrected, plain, plus, times
from vehicle_sbi.physics.record import OWN, derive
from vehicle_sbi.physics.simulation import MODELS
from vehicle_sbi.physics.single_track import DRIVES

MEMORY = [name for name in OWN if name.startswith("inverse_")]
EVERYTHING = {
    "lateral_load_transfer_uneven": 0.006,
    "lateral_load_transfer_track": 1.5,
    "tyre_curve_peak": 0.5,
    "tyre_curve_longitudinal": 0.4,
    "tyre_curve_early": 0.3,
    "load_sensitivity_coefficient": -0.1,
    "steering_compliance_coefficient": 2e-6,
}


def three(values: np.ndarray) -> Unknowns:
    return Unknowns(*map(float, values))


@pytest.mark.parametrize("seed", range(5))
def test_a_linear_loop_ends_after_twice_as_many_steps_as_it_has_unknowns(seed: int) -> None:
    # Gay (1979): Broyden's method solves n linear equations in 2 n steps.
    rng = np.random.default_rng(seed)
    A, b = np.eye(3) + 0.3 * rng.uniform(-1.0, 1.0, (3, 3)), rng.normal(size=3)
    at, inverse = np.zeros(3), plain()
    off = b
    for _ in range(6):
        step = times(inverse, three(off))
        at = at + np.array(step)
        before, off = off, b - A @ at
        inverse = corrected(inverse, step, three(before - off))
    assert np.abs(off).max() < 1e-10 * np.abs(b).max()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_learned_holds_for_the_step_and_changes_nothing_across_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step, fell = rng.normal(size=3), np.zeros(3)
    while step @ fell < LEAST_ANSWER * step @ step:
        fell = step + 0.5 * rng.normal(size=3)
    inverse = corrected(plain(), three(step), three(fell))
    np.testing.assert_allclose(times(inverse, three(fell)), step, rtol=1e-12)
    across = np.cross(step, rng.normal(size=3))  # the row that the plain inverse's change has is the step
    np.testing.assert_allclose(times(inverse, three(across)), across, rtol=0.0, atol=1e-12 * np.abs(across).max())


def test_residuals_that_do_not_fall_lengthen_steps_no_more_than_is_said() -> None:
    step = Unknowns(0.3, -0.1, 0.2)
    longer = times(corrected(plain(), step, Unknowns(0.0, 0.0, 0.0)), step)
    np.testing.assert_allclose(longer, np.array(step) / LEAST_ANSWER, rtol=1e-12)
    assert corrected(plain(), Unknowns(0.0, 0.0, 0.0), step) == plain()


def test_a_step_is_added_by_its_share() -> None:
    assert plus(Unknowns(1.0, 2.0, 3.0), -0.5, Unknowns(2.0, 2.0, 4.0)) == Unknowns(0.0, 1.0, 1.0)
    assert times(plain(), Unknowns(1.0, 2.0, 3.0)) == Unknowns(1.0, 2.0, 3.0)


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("model", MODELS)
def test_what_a_loop_has_kept_changes_no_answer(model: str, drive: str) -> None:
    # Residuals are below 1e-9 m/s^2 at the end, of which forces change by less than 10 masses: 1.5e-5 N, so wheels of
    # 1.5 kg m^2 and 0.31 m turn by less than 4e-6 rad/s^2 more.
    rng = np.random.default_rng(4)
    effects = EVERYTHING if model == "single_track" else {"steering_compliance_coefficient": 2e-6}
    fresh, u = record_of(PAPER, **effects), exciting(2.0)[int(0.9 * RATE)]
    state = np.zeros(MODELS[model].STATES)
    derive(fresh[0])
    MODELS[model].start(fresh[0], DRIVES["torque"], u, np.array([12.0, -0.1, 0.3]), state)
    expected = rate_of(fresh, drive, state, u, model=model)
    assert np.isfinite(expected).all()
    used, learned = record_of(PAPER, **effects), False
    for _ in range(10):
        elsewhere = state + 0.1 * rng.normal(size=len(state)) * np.abs(state)
        rate_of(used, drive, elsewhere, u * rng.uniform(0.5, 1.5), model=model)
        learned |= any(used[name][0] != 0.0 for name in MEMORY)
        np.testing.assert_allclose(rate_of(used, drive, state, u, model=model), expected, rtol=1e-8, atol=4e-6)
    assert learned
