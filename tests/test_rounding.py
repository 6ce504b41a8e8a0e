"""Numbers for people: as many digits as their uncertainty supports."""

import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vehicle_sbi.rounding import NONE, mean_and_std, rounded


@given(st.floats(-1e7, 1e7), st.floats(1e-9, 1e7))
def test_rounding_supports_the_uncertainty(value: float, std: float) -> None:
    """What is dropped is at most half the second digit of std, so under a twentieth of std (plus float error)."""
    assume(std > NONE * abs(value))
    shown = rounded(value, std)
    assert abs(float(shown) - value) <= 0.0501 * std + 1e-15 * abs(value)
    digits = rounded(std, std).replace(".", "").strip("0")
    assert len(digits) <= 2
    assert not re.fullmatch(r"-0\.?0*", shown)


@pytest.mark.parametrize(
    ("mean", "std", "shown"),
    [
        (1.48912, 0.00768, "1.4891 ± 0.0077"),
        (161234.0, 5123.0, "161200 ± 5100"),
        (0.5, 0.0996, "0.50 ± 0.10"),
        (-0.001, 0.12, "0.00 ± 0.12"),
        (7.0, 0.0, "7 ± 0"),
        (0.005, 8.7e-19, "0.005 ± 0"),
    ],
)
def test_mean_and_std_as_shown(mean: float, std: float, shown: str) -> None:
    assert mean_and_std(mean, std) == shown
