"""Which column of theta is what, and what may be said about a theta by name."""

import numpy as np
import pytest
from cars import PAPER

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.record import RECORD, nominal_record

SPACE = parameter_space(
    {"delta_C_kappa": [-0.2, 0.5], "l_f": [1.0, 1.5], "aero_drag": {"area": [0.0, 1.5]}},
    vehicle=PAPER,
    model="single_track",
)


def test_columns_follow_the_order_in_which_parameters_are_stated() -> None:
    assert SPACE.names == ("delta_C_kappa", "l_f", "aero_drag.area")
    assert [SPACE.column(name) for name in SPACE.names] == [0, 1, 2] == list(range(len(SPACE)))
    with pytest.raises(KeyError):
        SPACE.column("h_cog")


def test_a_record_is_the_nominal_one_but_for_the_free_fields() -> None:
    theta = np.array([[0.3, 1.2, 0.7], [-0.1, 1.4, 0.0]])
    nominal = nominal_record(PAPER)
    records = SPACE.records(theta, nominal)
    # An offset counts in 1e5 N from nominal and sets both axles; other parameters replace their field.
    np.testing.assert_array_equal(records["C_kappa_f"], 1e5 + 1e5 * theta[:, 0])
    np.testing.assert_array_equal(records["C_kappa_r"], records["C_kappa_f"])
    np.testing.assert_array_equal(records["l_f"], theta[:, 1])
    np.testing.assert_array_equal(records["aero_drag_area"], theta[:, 2])
    touched = {"C_kappa_f", "C_kappa_r", "l_f", "aero_drag_area"}
    for name in set(RECORD.names or ()) - touched:
        np.testing.assert_array_equal(records[name], np.full(2, nominal[name]))


def test_the_nominal_record_is_not_written_to() -> None:
    nominal = nominal_record(PAPER)
    SPACE.records(np.array([[0.5, 1.1, 1.0]]), nominal)
    assert nominal["C_kappa_f"] == PAPER.C_kappa_f


def test_prior_std_is_that_of_a_uniform() -> None:
    # The variance of a uniform on (a, b) is (b - a)^2 / 12; that of n draws' variance is 0.8 var^2 / n for a uniform.
    draws = np.random.default_rng(0).uniform(SPACE.low, SPACE.high, (100_000, 3))
    np.testing.assert_allclose(draws.var(axis=0), SPACE.prior_std**2, rtol=5 * np.sqrt(0.8 / 100_000))


def test_values_are_taken_by_name_in_any_order() -> None:
    theta = SPACE.values({"aero_drag.area": 0.5, "l_f": 1.5, "delta_C_kappa": -0.2}, "truth")
    np.testing.assert_array_equal(theta, [-0.2, 1.5, 0.5])


TRUTH = {"delta_C_kappa": 0.0, "l_f": 1.3, "aero_drag.area": 0.5}
WRONG = {
    "missing": ({"l_f": 1.3}, r"truth: no value for delta_C_kappa, aero_drag\.area"),
    "outside": (TRUTH | {"l_f": 1.6}, r"truth: l_f = 1\.6 m lies outside its prior \[1, 1\.5\]"),
    "not a number": (TRUTH | {"l_f": float("nan")}, "truth: l_f = nan m lies outside its prior"),
    "no number": (TRUTH | {"l_f": "long"}, "truth: l_f = 'long'; it must be a number"),
    "null": (TRUTH | {"l_f": None}, "truth: l_f = None; it must be a number"),
    "unknown": (TRUTH | {"h_cog": 0.5}, "truth: unknown parameter 'h_cog'; known: .*l_f"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_value_is_one_clear_line(case: str) -> None:
    given, message = WRONG[case]
    with pytest.raises(InputError, match=message) as error:
        SPACE.values(given, "truth")
    assert "\n" not in str(error.value)


def test_no_field_is_set_twice() -> None:
    def parameter(name: str, *fields: str) -> Parameter:
        return Parameter(name=name, unit="N", low=0.0, high=1.0, fields=fields)

    with pytest.raises(InputError, match="more than one parameter sets C_kappa_f; keep one of them"):
        ParameterSpace((parameter("both", "C_kappa_f", "C_kappa_r"), parameter("front", "C_kappa_f")))
