"""The package in Python: what the command line does, as typed results."""

import subprocess
import sys

import numpy as np
import pytest

from vehicle_sbi import diagnose, identify, read, simulate
from vehicle_sbi.command import RECORDINGS
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.vehicle import GRAVITY

SHIPPED = RECORDINGS / "ferrari_250lm_excerpt.parquet"


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, vehicle_sbi; print(sorted({'torch', 'numba', 'pandas', 'numpy'} & {*sys.modules}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_the_shipped_recording_is_what_its_readme_says() -> None:
    recording = read(SHIPPED)
    assert recording.t[-1] - recording.t[0] == pytest.approx(80.0)
    assert recording.rate == pytest.approx(100.0)
    assert np.nanmax(np.abs(recording.channels["a_y"])) < 1.5 * GRAVITY
    assert SHIPPED.stat().st_size < 1_000_000
    assert "MIT License" in (SHIPPED.parent / "ferrari_250lm_LICENSE").read_text()


def test_a_force_that_brakes_slows_the_simulated_car() -> None:
    bare, dragged = simulate("paper"), simulate("paper", aero_drag__area=3.0)
    assert list(bare.columns) == list(dragged.columns)
    assert dragged["wheel_speed_rear_radps"].iloc[-1] < bare["wheel_speed_rear_radps"].iloc[-1]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: read("no.csv"), "no such file"),
        (lambda: simulate("no_car"), "no_car"),
        (lambda: diagnose(SHIPPED, "ferrari_250lm", prior="nowhere"), "known: "),
        (lambda: identify(SHIPPED, "ferrari_250lm", colour="red"), "unknown setting 'colour'"),
        (lambda: diagnose([], "ferrari_250lm"), "none is given"),
    ],
)
def test_wrong_values_get_one_line(call, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        call()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_recording_in_memory_is_diagnosed_and_identified() -> None:
    recording = read(SHIPPED, rate=20.0, stop_s=80.0)
    found = diagnose(recording, "ferrari_250lm")
    assert found.table["probability"].between(0.0, 1.0).all()
    assert str(found).startswith(found.verdict.headline)
    assert "<table" in found._repr_html_()
    result = identify(recording, "ferrari_250lm", rounds={"simulations": 300, "rounds": 2}, quiet=True)
    assert [*result.samples.columns] == [*result.table["parameter"]]
    assert found.plot().axes
    assert result.plot().axes
