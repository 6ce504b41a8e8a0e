"""What no effect stands for: the load or error behind a discrepancy comes back from its coefficients."""

import numpy as np
import pytest
from recorded import fitted, lateral, recorded

from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy, remainders, responses
from vehicle_sbi.mismatch.hypotheses.regressor import signals


@pytest.fixture(scope="module")
def here() -> tuple[object, list[Discrepancy]]:
    fit = fitted(recorded(lateral(seconds=20.0)))
    return fit, [one.about(fit) for one in responses(fit)]


def test_columns_of_a_group_are_orthogonal_in_units_of_the_noise(here) -> None:
    for one in here[1]:
        products = one.whitened @ one.whitened.T
        assert products == pytest.approx(np.diag(np.diag(products)), abs=1e-8 * products.max())
        assert np.all(np.diff(np.diag(products)) <= 1e-9 * products.max())


def test_what_does_not_change_is_no_discrepancy(here) -> None:
    # A constant force is a bank or a side wind, a constant error an offset or a bias.
    _, found = here
    for one in found:
        size = np.sqrt(np.mean(one.course**2, axis=1))
        assert one.course.mean(axis=1) / size == pytest.approx(np.zeros(len(size)), abs=1e-9)


def test_a_sensor_s_course_is_what_its_series_are(here) -> None:
    fit, found = here
    for one in (one for one in found if one.target.row is not None):
        channel = one.target.name.removeprefix("error of the sensor of ")
        row = fit.simulator.windows.channels.index(channel)
        assert one.series[:, row] == pytest.approx(one.course, abs=1e-9 * np.abs(one.course).max())


def test_a_law_that_is_drawn_is_said_with_its_target_its_signal_and_its_size(here) -> None:
    # Coefficients that stand for a moment along the yaw rate cubed: the others are drawn as nothing.
    fit, found = here
    course = signals(fit.simulator, fit.theta)["yaw rate cubed"].reshape(-1)
    k = next(k for k, one in enumerate(found) if one.target.name == "moment about z" and "signals" in one.kind)
    c, *_ = np.linalg.lstsq(found[k].course.T, 100.0 * course, rcond=None)
    coefficient = np.zeros((5, sum(len(one.series) for one in found)))
    first = sum(len(one.series) for one in found[:k])
    coefficient[:, first : first + len(c)] = c
    there = np.zeros((5, len(found)), dtype=bool)
    there[:, k] = True
    best, *others = remainders(fit, found, coefficient, there)
    assert (best.target.name, best.signal) == ("moment about z", "yaw rate cubed")
    assert best.probability == 1.0
    said = c @ found[k].course
    assert best.rms == pytest.approx(np.full(5, np.sqrt(np.mean(said**2))))
    assert best.shown == pytest.approx(float(np.linalg.norm(c @ found[k].whitened)))
    assert all(one.shown == 0.0 and one.probability == 0.0 for one in others)
