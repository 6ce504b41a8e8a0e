"""What a diagnosis exports of several parameters has the uncertainty of its joint draws."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from exports import comments, diagnosis_of, line_of, numbers, shown, texts

from vehicle_sbi.errors import InputError
from vehicle_sbi.mismatch.estimation.estimate import drawn
from vehicle_sbi.report.export.reading import FEWEST, INDEPENDENT, read
from vehicle_sbi.report.netcdf import FILE
from vehicle_sbi.rounding import rounded

N = 400
ARM = "imu_lever_arm.x"


def draws() -> pd.DataFrame:
    """A place of the IMU that hangs together with l_f."""
    g = np.random.default_rng(0)
    common = g.normal(size=N)
    arm = -0.3 + 0.05 * (0.8 * common + 0.6 * g.normal(size=N))
    stiffness = {name: 1.2e5 + 6e3 * g.normal(size=N) for name in ("C_alpha_f", "C_alpha_r")}
    return pd.DataFrame({"l_f": 1.3 + 0.02 * common, **stiffness, ARM: arm})


def write(folder: Path, theta: pd.DataFrame, included: np.ndarray, effect: str = ARM) -> None:
    """The file of a diagnosis, in as much of its form as is read."""
    posterior = {name: (("chain", "draw"), column.to_numpy()[None]) for name, column in theta.items()}
    there = {"included": (("chain", "draw", "effect_parameter"), included[None, :, None])}
    tree = {
        "/posterior": xr.Dataset(posterior),
        "/sample_stats": xr.Dataset(there, coords={"effect_parameter": [effect]}),
    }
    xr.DataTree.from_dict(tree).to_netcdf(folder / FILE, engine="h5netcdf")


def diagnosis(folder: Path, theta: pd.DataFrame, included: np.ndarray, *, keep: bool = True) -> None:
    """A diagnosis that names the lever arm, its estimates those of its draws."""
    estimates = {name: drawn(theta[name].to_numpy(), "m") for name in theta}
    plain = {name: asdict(e) for name, e in estimates.items()}
    named = {"effects": ["imu_lever_arm"], "probability": 0.96, "parameters": {ARM: plain.pop(ARM)}}
    base = {name: {"before": {}, "after": one, "unit": one["unit"]} for name, one in plain.items()}
    diagnosis_of(folder, explanations=[named], effects={"imu_lever_arm": 0.96}, base_parameters=base)
    if keep:
        write(folder, theta, included)


def test_a_value_of_several_parameters_has_the_spread_of_its_draws(tmp_path: Path) -> None:
    """x = L - l_f + arm is linear, so its standard deviation is that of the draws to rounding."""
    theta = draws()
    diagnosis(tmp_path, theta, np.ones(N, dtype=bool))
    text = texts(tmp_path, "autoware")["sensors_calibration.yaml"]
    pose = yaml.safe_load(text)["base_link"]["tamagawa/imu_link"]
    std = float((theta[ARM] - theta["l_f"]).to_numpy().std())
    assert pose["x"] == shown(2.7 - theta["l_f"].mean() + theta[ARM].mean(), std)
    assert f"std {rounded(std, std)};" in line_of(text, "x:")
    assert INDEPENDENT not in comments(text)


def test_without_draws_parameters_count_as_independent_and_the_files_say_so(tmp_path: Path) -> None:
    theta = draws()
    diagnosis(tmp_path, theta, np.ones(N, dtype=bool), keep=False)
    text = texts(tmp_path, "autoware")["sensors_calibration.yaml"]
    std = float(np.hypot(theta[ARM].to_numpy().std(), theta["l_f"].to_numpy().std()))
    assert f"std {rounded(std, std)};" in line_of(text, "x:")
    assert INDEPENDENT in comments(text)


def test_an_effect_hangs_together_with_others_as_where_it_is_missing(tmp_path: Path) -> None:
    """Draws without the effect, however far off, change its correlations by nothing, and those of the rest fully."""
    theta, included = draws(), np.arange(N) < N // 2
    theta.loc[~included, "l_f"] += 0.2
    theta.loc[~included, ARM] = 5.0
    diagnosis(tmp_path, theta, included)
    found = read(tmp_path).correlation
    assert found is not None
    assert found.loc["l_f", ARM] == pytest.approx(theta[included].corr().loc["l_f", ARM], abs=1e-12)
    assert found.loc["l_f", "C_alpha_f"] == pytest.approx(theta.corr().loc["l_f", "C_alpha_f"], abs=1e-12)


def test_an_effect_that_is_hardly_drawn_counts_as_independent(tmp_path: Path) -> None:
    theta = draws()
    diagnosis(tmp_path, theta, np.arange(N) < FEWEST - 1)
    found = read(tmp_path).correlation
    assert found is not None
    assert found.loc["l_f", ARM] == pytest.approx(0.0, abs=1e-12)


def test_no_value_gets_a_negative_variance_from_pairs_of_different_draws(tmp_path: Path) -> None:
    """Three that hang together by -0.99 in turn cannot all do so: such a matrix has a negative eigenvalue."""
    theta, included = draws(), np.arange(N) < N // 2
    g = np.random.default_rng(1)
    x, noise = g.normal(size=N), 0.01 * g.normal(size=(3, N))
    theta["l_f"], theta["C_alpha_f"] = 1.3 + 0.02 * (x + noise[0]), 1e5 * (1.0 + 0.05 * (noise[1] - x))
    theta.loc[included, "C_alpha_f"] = 1e5 * (1.0 + 0.05 * (x + noise[1])[included])
    theta.loc[~included, ["l_f", "C_alpha_f"]] *= [1.5, 0.5]
    theta[ARM] = -0.3 + 0.05 * (noise[2] - x)
    assert np.linalg.eigvalsh(theta.assign(**{ARM: theta[ARM].where(included)}).corr().to_numpy()).min() < -0.1
    diagnosis(tmp_path, theta, included)
    found = read(tmp_path).correlation
    assert found is not None
    assert np.linalg.eigvalsh(found.to_numpy()).min() > -1e-12
    np.testing.assert_allclose(np.diag(found), 1.0)


@pytest.mark.parametrize("keep", [True, False])
def test_what_multiplies_a_constant_is_averaged_over_whether_it_is_there(tmp_path: Path, keep: bool) -> None:
    """C_alpha_f falls as the factor on it rises, so the axle's stiffness is known though the effect is not certain."""
    g, name, there = np.random.default_rng(2), "stiffness_level.factor", np.arange(N) < 0.7 * N
    factor = np.where(there, 0.8 + 0.02 * g.normal(size=N), 1.0)
    theta = draws().drop(columns=ARM).assign(C_alpha_f=(1.0e5 + 2e3 * g.normal(size=N)) / factor)
    conditional = asdict(drawn(factor[there], "1"))
    named = {"effects": ["stiffness_level"], "probability": 0.7, "parameters": {name: conditional}}
    after = {key: asdict(drawn(column.to_numpy(), "N/rad")) for key, column in theta.items()}
    base = {key: {"before": {}, "after": one, "unit": one["unit"]} for key, one in after.items()}
    diagnosis_of(tmp_path, explanations=[named], effects={"stiffness_level": 0.7}, base_parameters=base)
    if keep:
        write(tmp_path, theta.assign(**{name: factor}), there, name)
    text = texts(tmp_path, "autoware")["mpc.param.yaml"]
    if not keep:
        assert "cf left out: stiffness_level.factor: compatible with no effect" in text
        return
    line, product = line_of(text, "cf:"), theta["C_alpha_f"] * factor
    assert "averaged over whether stiffness_level is missing (0.70)" in line
    axle = yaml.safe_load(text)["/**"]["ros__parameters"]["vehicle"]["cf"]
    covariance = np.cov(theta["C_alpha_f"], factor, ddof=0)
    slopes = np.array([factor.mean(), theta["C_alpha_f"].mean()])
    std = float(np.sqrt(slopes @ covariance @ slopes))  # to first order, as `exported` has it
    assert f"std {rounded(std, std)};" in line
    assert axle == pytest.approx(product.mean(), abs=2.0 * abs(covariance[0, 1]))  # the second order's share


def test_a_damaged_file_of_draws_is_one_line(tmp_path: Path) -> None:
    diagnosis(tmp_path, draws(), np.ones(N, dtype=bool))
    (tmp_path / FILE).write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not a NetCDF-4 file") as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


def test_draws_without_a_parameter_of_the_verdict_are_not_used(tmp_path: Path) -> None:
    theta = draws()
    diagnosis(tmp_path, theta, np.ones(N, dtype=bool), keep=False)
    write(tmp_path, theta.drop(columns="l_f"), np.ones(N, dtype=bool))
    assert read(tmp_path).correlation is None
    everything = json.loads(texts(tmp_path, "json")["parameters.json"])
    assert INDEPENDENT in str(everything)
    assert numbers(1.0, 1.0, "m").keys() <= everything["parameters"]["l_f"].keys()
