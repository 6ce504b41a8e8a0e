"""Windows of several recordings are joined where the recordings are alike."""

from dataclasses import replace

import pytest
from recorded import lateral

from vehicle_sbi.data.windows import joined
from vehicle_sbi.errors import InputError


def test_recordings_of_different_rates_are_refused() -> None:
    a, b = lateral().windows, replace(lateral().windows, rate=100.0)
    with pytest.raises(InputError, match=r"recordings one and two differ in their rate: 50\.0 and 100\.0"):
        joined([a, b], ["one", "two"])
