"""The package in Python: what the command line does, as typed results."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cars import PAPER
from studies import manoeuvre, simulator
from test_formats import logger_text
from threadpoolctl import threadpool_info, threadpool_limits

from vehicle_sbi import diagnose, identify, read, simulate
from vehicle_sbi.api import Diagnosed, Identified
from vehicle_sbi.command import RECORDINGS
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.report import netcdf

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


def test_a_simulated_drive_has_the_stated_tyres() -> None:
    """No stiffness is drawn: a percent of it is worth far more than integrators of other steps differ by."""
    driven = manoeuvre()
    table, sim = simulate(PAPER, driven, l_f=1.25), simulator({"l_f": [1.0, 1.5]})
    row = sim.windows.channels.index("yaw_rate")
    exact = sim.noise_free(np.array([[1.25]]))[0, row]
    softer = replace(sim, nominal=sim.nominal.copy())
    softer.nominal["C_alpha_f"] *= 0.99
    worth = np.abs(softer.noise_free(np.array([[1.25]]))[0, row] - exact).max()
    assert np.abs(table["yaw_rate_radps"] - exact).max() < 0.1 * worth


def test_a_simulated_drive_written_to_a_file_is_a_recording(tmp_path: Path) -> None:
    driven = replace(manoeuvre(), channels=("v_x", "a_y", "yaw_rate"))
    table = simulate("paper", driven)
    table.to_parquet(tmp_path / "drive.parquet")
    recording = read(tmp_path / "drive.parquet")
    assert {*recording.channels} == {"steering", "torque_front", "torque_rear", "v_x", "a_y", "yaw_rate"}
    np.testing.assert_array_equal(recording.channels["steering"], driven.inputs(PAPER)[:, 0])
    np.testing.assert_array_equal(recording.channels["yaw_rate"], table["yaw_rate_radps"])


def diagnosed(**found: Any) -> Diagnosed:
    """A diagnosis of one parameter that moves, and of an effect whose name needs escaping."""
    before, after = {"mean": 1.2, "std": 0.1}, {"mean": 1.4, "std": 0.2}
    verdict: Any = SimpleNamespace(
        headline="Missing: a < b (0.90).",
        lines=["One line."],
        warnings=["a_y < b_y."],
        effects={"a<b": 0.9, "other": 0.1},
        base_parameters={"l_f": {"before": before, "after": after, "unit": "m", "identified": True}},
    )
    case: Any = SimpleNamespace(name="a car in a drive")
    steps: Any = SimpleNamespace(**found)
    return Diagnosed(verdict, case, steps)


def test_parameters_of_a_diagnosis_are_a_table_before_and_after() -> None:
    row = {"parameter": "l_f", "unit": "m", "mean before": 1.2, "std before": 0.1, "mean after": 1.4, "std after": 0.2}
    row["identified"] = True
    pd.testing.assert_frame_equal(diagnosed().parameters, pd.DataFrame([row]))


def test_a_diagnosis_is_shown_as_text_and_as_escaped_tables() -> None:
    found = diagnosed()
    assert repr(found) == str(found) == "Missing: a < b (0.90).\nOne line.\na_y < b_y."
    shown = found._repr_html_()
    assert "a<b" not in shown
    assert "a&lt;b" in shown
    assert "<p>a_y &lt; b_y.</p>" in shown
    assert "1.20 ± 0.10" in shown
    assert "1.40 ± 0.20" in shown


def test_an_identification_shows_its_warnings() -> None:
    part: Any = None
    numbers = {"prior_low": 1.0, "prior_high": 1.5, "true": 1.2, "mean": 1.2, "std": 0.1, "q05": 1.0, "q50": 1.2}
    numbers |= {"q95": 1.4, "bound_std": 0.1, "contraction": 0.5}
    table = pd.DataFrame([{"parameter": "l_f", "unit": "m", **numbers, "identified": True}])
    found = Identified(table, table, part, part, part, ["The last two rounds disagree: a < b."])
    assert repr(found).splitlines()[-1] == "The last two rounds disagree: a < b."
    assert found._repr_html_().endswith("<p>The last two rounds disagree: a &lt; b.</p>")


def test_a_preset_is_named_as_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text(
        logger_text("motec").replace("Engine RPM", "Steered Angle").replace("rpm", "deg")
    )
    recording = read(tmp_path / "drive.csv", mapping="motec")
    assert {"v_x", "a_y", "yaw_rate"} < {*recording.channels}


def test_a_diagnosis_without_draws_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no draws"):
        diagnosed(pruned=None).to_netcdf(tmp_path / "posterior.nc")
    assert not [*tmp_path.iterdir()]


def identified(recording: Any, folder: Path) -> Identified:
    return identify(
        recording,
        "ferrari_250lm",
        rounds={"simulations": 300, "rounds": 2},
        training={"steps": 200},
        folder=folder,
        quiet=True,
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: read("no.csv"), "no such file"),
        (lambda: read(SHIPPED, colour=1), "read: unknown setting 'colour'"),
        (lambda: read(SHIPPED, mapping="no_logger"), "no_logger"),
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
def test_a_recording_in_memory_is_diagnosed() -> None:
    found = diagnose(read(SHIPPED, rate=20.0, stop_s=80.0), "ferrari_250lm")
    assert found.table["probability"].between(0.0, 1.0).all()
    assert str(found).startswith(found.verdict.headline)
    assert "<table" in found._repr_html_()
    assert found.plot().axes
    assert found.found.pruned is not None
    assert {*found.parameters["parameter"]} <= {*found.samples.columns}
    assert {*found.parameters["parameter"]} <= {*found.datatree["posterior"].data_vars}
    for row in found.parameters.to_dict("records"):
        draws = found.datatree["posterior"].to_dataset()[str(row["parameter"])]
        assert float(draws.mean()) == pytest.approx(row["mean after"], rel=1e-9)


def test_a_diagnosis_has_linear_algebra_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    class Reached(Exception):
        pass

    def steps(case: object, *, rng: object) -> None:
        raise Reached([pool["num_threads"] for pool in threadpool_info()])

    monkeypatch.setattr("vehicle_sbi.api.steps", steps)
    monkeypatch.setattr("vehicle_sbi.api.ahead.begin", lambda: None)
    with threadpool_limits(2), pytest.raises(Reached) as reached:
        diagnose(read(SHIPPED, rate=20.0, stop_s=80.0), "ferrari_250lm")
    assert set(reached.value.args[0]) == {1}


@pytest.mark.slow
def test_a_recording_in_memory_is_identified_and_its_rounds_are_kept(tmp_path: Path) -> None:
    """The same call again takes the rounds from the folder, and draws the same samples."""
    recording = read(SHIPPED, rate=20.0, stop_s=80.0)
    first = identified(recording, tmp_path / "kept")
    rounds = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.pt")}
    second = identified(recording, tmp_path / "kept")
    with pytest.raises(InputError, match="of another call"):
        identify(recording, "ferrari_250lm", seed=1, folder=tmp_path / "kept", quiet=True)
    assert len(rounds) == 2
    assert rounds == {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.pt")}
    pd.testing.assert_frame_equal(first.samples, second.samples)
    assert [*first.samples.columns] == [*first.table["parameter"]]
    assert first.plot().axes
    assert "l_f [m]" in repr(first)
    assert "<table" in first._repr_html_()
    first.to_netcdf(tmp_path / "posterior.nc")
    pd.testing.assert_frame_equal(netcdf.read(tmp_path / "posterior.nc"), first.samples)
