"""posterior.nc: draws, observations and their units come back from the file as they went in."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from recorded import fitted, lateral, recorded
from studies import simulator

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.predictive import QUANTILES, Predictive, predictive
from vehicle_sbi.inference.prior import KNOWN
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.selection.pruned import Pruned
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.vehicle import MEANINGS
from vehicle_sbi.report import netcdf
from vehicle_sbi.report.netcdf import DIMENSIONS, Origin

ORIGIN = Origin(study="a car in a drive", seed=3, version="1.2.3", config_sha256="ab" * 32)
HOSTILE = "../a/b\0\n\ud800 {x}"
N = 40


def open_tree(path: Path) -> xr.DataTree:
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree.load()


def prepared_of(sim: Simulator, observed: np.ndarray) -> Any:
    """As much of a prepared study as a file is made of."""
    middle = (sim.space.low + sim.space.high) / 2
    return SimpleNamespace(truth=middle, problem=SimpleNamespace(simulator=sim, observed=observed))


def uniform(space: ParameterSpace, n: int = N) -> np.ndarray:
    return np.random.default_rng(0).uniform(space.low, space.high, (n, len(space)))


Run = tuple[Simulator, np.ndarray, np.ndarray, Predictive]


@pytest.fixture(scope="module")
def run() -> Run:
    """A simulator whose first channel is masked for the first tenth of the drive, what it saw, samples, bands."""
    sim = simulator(rate=20.0)
    valid = sim.windows.valid.copy()
    valid[0, : valid.shape[1] // 10] = False
    sim = replace(sim, windows=replace(sim.windows, valid=valid))
    observed = np.where(valid, sim.noise_free(uniform(sim.space, 1))[0], 0.0)
    samples = uniform(sim.space)
    return sim, observed, samples, predictive(sim, observed, samples)


@pytest.fixture(scope="module")
def run_file(
    run: tuple[Simulator, np.ndarray, np.ndarray, Predictive], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    sim, observed, samples, predicted = run
    path = tmp_path_factory.mktemp("run") / netcdf.FILE
    netcdf.write(path, netcdf.of_run(prepared_of(sim, observed), samples, predicted, ORIGIN))
    return path


@pytest.fixture(scope="module")
def pruned() -> Pruned:
    """Draws of a base model beside a delay, a wind with its arm that does not show, and what no effect stands for, each
    in some of them."""
    base = fitted(recorded(lateral()))
    sizes = tuple(EFFECT_PARAMETERS[name] for name in ("steering_delay.time", "crosswind.force"))
    shapes = (EFFECT_PARAMETERS["crosswind.arm"],)
    expansion = Expansion(base.simulator.space.parameters, sizes, shapes, np.ones(2), np.full(2, 0.1))
    sim = replace(base.simulator, space=expansion.space)
    fit = replace(base, observation=replace(base.observation, simulator=sim))
    rng, inside = np.random.default_rng(1), np.zeros((2, len(expansion.space)))
    included, unexplained = rng.random((N, 2)) < 0.5, rng.random(N) < 0.2
    return Pruned(expansion, uniform(expansion.space), included, unexplained, inside, np.array([True, False]), fit, [])


@pytest.fixture(scope="module")
def diagnosis_file(pruned: Pruned, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("diagnosis") / netcdf.FILE
    case = cast(Any, SimpleNamespace(observation=pruned.fit.observation))
    netcdf.write(path, netcdf.of_diagnosis(case, pruned, ORIGIN))
    return path


def test_a_run_s_samples_come_back_bit_by_bit_with_units_and_prior_bounds(run: Run, run_file: Path) -> None:
    sim, _, samples, _ = run
    tree = open_tree(run_file)
    assert tree["posterior"].sizes == {"chain": 1, "draw": N}
    for p, column in zip(sim.space.parameters, samples.T, strict=True):
        variable = tree["posterior"].to_dataset()[p.name]
        assert variable.dims == DIMENSIONS
        np.testing.assert_array_equal(variable.values[0], column)
        assert (variable.attrs["units"], variable.attrs["prior_low"], variable.attrs["prior_high"]) == (
            p.unit, p.low, p.high,
        )  # fmt: skip
        assert variable.attrs["true_value"] == (p.low + p.high) / 2
        prior = tree["prior"][p.name]
        assert ((prior >= p.low) & (prior <= p.high)).all()
    pd.testing.assert_frame_equal(netcdf.read(run_file), pd.DataFrame(samples, columns=[*sim.space.names]))


def test_what_is_masked_is_nan_and_the_rest_is_what_was_observed(run: Run, run_file: Path) -> None:
    sim, observed, _, predicted = run
    tree, valid = open_tree(run_file), sim.windows.valid
    assert not valid.all()
    np.testing.assert_array_equal(tree["observed_data"]["time"], sim.windows.t.ravel())
    np.testing.assert_array_equal(tree["posterior_predictive"]["quantile"], QUANTILES)
    for i, name in enumerate(sim.windows.channels):
        series, bands = tree["observed_data"][name], tree["posterior_predictive"][name]
        np.testing.assert_array_equal(series, np.where(valid[i], observed[i], np.nan))
        np.testing.assert_array_equal(bands, predicted.quantiles[:, i])
        assert series.attrs["units"] == bands.attrs["units"] == CHANNELS[name].unit


def test_the_file_says_where_it_comes_from(run_file: Path, diagnosis_file: Path) -> None:
    for path in (run_file, diagnosis_file):
        said = open_tree(path).attrs
        assert said["study"] == ORIGIN.study
        assert (said["seed"], said["config_sha256"]) == (3, ORIGIN.config_sha256)
        assert (said["creation_library"], said["creation_library_version"]) == ("vehicle_sbi", "1.2.3")
        assert pd.Timestamp(said["created_at"]).tzinfo is not None


def test_but_for_the_date_the_same_run_gives_the_same_bytes(run: Run, tmp_path: Path) -> None:
    sim, observed, samples, predicted = run
    for name in ("a.nc", "b.nc"):
        tree = netcdf.of_run(prepared_of(sim, observed), samples, predicted, ORIGIN)
        for node in tree.subtree:
            node.attrs.pop("created_at", None)
        netcdf.write(tmp_path / name, tree)
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_draws_of_a_diagnosis_stay_joint(pruned: Pruned, diagnosis_file: Path) -> None:
    """All draws are in the file; read, a parameter of an effect is NaN exactly where that is not missing."""
    tree, space = open_tree(diagnosis_file), pruned.fit.simulator.space
    frame = netcdf.read(diagnosis_file)
    assert [*frame] == [*space.names]
    for k, p in enumerate(space.parameters):
        variable = tree["posterior"].to_dataset()[p.name]
        np.testing.assert_array_equal(variable.values[0], pruned.theta[:, k])
        assert variable.attrs["units"] == p.unit
        there = np.ones(N, dtype=bool) if p in pruned.expansion.base else pruned.away(p.name.split(".")[0])
        np.testing.assert_array_equal(frame[p.name], np.where(there, pruned.theta[:, k], np.nan))


def test_inclusion_probabilities_are_shares_of_draws(pruned: Pruned, diagnosis_file: Path) -> None:
    tree = open_tree(diagnosis_file)
    stats = tree["sample_stats"].to_dataset()
    np.testing.assert_array_equal(stats["unexplained"].values[0], pruned.unexplained)
    by_effect = stats["included"].groupby("effect").any().mean(("chain", "draw"))
    assert [*pruned.effects] == ["steering_delay"]
    for effect, probability in (pruned.effects | {"crosswind": float(pruned.away("crosswind").mean())}).items():
        assert float(by_effect.sel(effect=effect)) == probability
        for p in CATALOGUE[effect].parameters:
            if p.name in tree["posterior"].data_vars:
                assert tree["posterior"][p.name].attrs["effect_probability"] == probability
    roles = {name: variable.attrs["role"] for name, variable in tree["posterior"].data_vars.items()}
    assert roles.pop("crosswind.arm") == "shape"
    assert {name for name, role in roles.items() if role == "size"} == {"steering_delay.time", "crosswind.force"}


def test_a_diagnosis_to_which_no_effect_is_known_has_draws_too(pruned: Pruned, tmp_path: Path) -> None:
    base = pruned.expansion.base
    expansion = Expansion(base, (), (), np.zeros(0), np.zeros(0))
    sim = replace(pruned.fit.simulator, space=expansion.space)
    fit = replace(pruned.fit, observation=replace(pruned.fit.observation, simulator=sim))
    bare = Pruned(
        expansion,
        pruned.theta[:, : len(base)],
        np.zeros((N, 0), dtype=bool),
        pruned.unexplained,
        np.zeros((2, len(base))),
        np.zeros(0, dtype=bool),
        fit,
        [],
    )
    case = cast(Any, SimpleNamespace(observation=fit.observation))
    netcdf.write(tmp_path / "x.nc", netcdf.of_diagnosis(case, bare, ORIGIN))
    pd.testing.assert_frame_equal(
        netcdf.read(tmp_path / "x.nc"), pd.DataFrame(bare.theta, columns=[p.name for p in base])
    )


def test_names_that_netcdf_does_not_allow_are_kept_as_an_attribute(run: Run, tmp_path: Path) -> None:
    sim, observed, samples, predicted = run
    names = ("chain", "a/b", "a_b")
    space = ParameterSpace(tuple(replace(p, name=n) for p, n in zip(sim.space.parameters, names, strict=True)))
    hostile = replace(ORIGIN, study=HOSTILE)
    netcdf.write(
        tmp_path / "x.nc",
        netcdf.of_run(prepared_of(replace(sim, space=space), observed), samples, predicted, hostile),
    )
    tree = open_tree(tmp_path / "x.nc")
    assert {*tree.children} == {"posterior", "prior", "observed_data", "posterior_predictive"}
    assert tree.attrs["study"] == HOSTILE.replace("\0", "\ufffd").replace("\ud800", "?")
    pd.testing.assert_frame_equal(netcdf.read(tmp_path / "x.nc"), pd.DataFrame(samples, columns=[*names]))


@given(st.lists(st.text(max_size=6), unique=True, max_size=6))
def test_every_name_becomes_a_variable_of_its_own(names: list[str]) -> None:
    called = netcdf.variables(names)
    assert [*called] == names
    assert len({*called.values(), *DIMENSIONS}) == len(names) + len(DIMENSIONS)
    assert all(name.encode() and not {*"/\0"} & {*name} and name.strip(".") for name in called.values())


def test_names_of_the_catalogue_stay_as_they_are_and_have_words() -> None:
    assert netcdf.variables(KNOWN) == {name: name for name in KNOWN}
    for p in KNOWN.values():
        assert netcdf.long_name(p) != p.name
        assert p.name.split(".")[0] in CATALOGUE or all(field in MEANINGS for field in p.fields)


def test_a_parameter_without_words_is_called_by_its_name() -> None:
    assert netcdf.long_name(Parameter(name="x", unit="m", low=0.0, high=1.0, fields=("x",))) == "x"


@pytest.mark.parametrize("content", [b"", b"nonsense", b"\x89HDF\r\n\x1a\n" + bytes(200)])
def test_any_other_file_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.nc"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a NetCDF-4 file") as caught:
        netcdf.read(path)
    assert "\n" not in str(caught.value)


def test_a_file_cut_short_or_without_draws_is_one_line(run_file: Path, tmp_path: Path) -> None:
    whole = run_file.read_bytes()
    (tmp_path / "short.nc").write_bytes(whole[: len(whole) // 2])
    xr.Dataset({"posterior": ("time", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    for name in ("short.nc", "other.nc"):
        with pytest.raises(InputError, match="not a NetCDF-4 file"):
            netcdf.read(tmp_path / name)


def test_arviz_reads_both_files(run_file: Path, diagnosis_file: Path) -> None:
    """As InferenceData up to ArviZ 0.x, as a DataTree later."""
    az = pytest.importorskip("arviz")
    for path in (run_file, diagnosis_file):
        found = az.from_netcdf(str(path))
        assert {"posterior", "observed_data"} <= {str(name).strip("/") for name in _groups(found)}
        mean = az.summary(found, kind="stats", round_to="none")["mean"].astype(float)
        np.testing.assert_allclose(mean, open_tree(path)["posterior"].to_dataset().mean().to_array(), rtol=1e-9)


def _groups(found: Any) -> Any:
    return found.children if isinstance(found, xr.DataTree) else found.groups()
