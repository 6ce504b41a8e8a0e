"""posterior.nc: draws, what was observed and where they come from, as the NetCDF-4 file that ArviZ reads.

Groups and dimensions are those of ArviZ's InferenceData schema. All draws count as one chain; those of a diagnosis are
pooled from several. To read a file runs no code, whoever wrote it.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_atomically
from vehicle_sbi.inference.predictive import QUANTILES, Predictive
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.vehicle import MEANINGS
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.rng import Stream, generator

if TYPE_CHECKING:  # they take long to import, and a run needs no diagnosis
    import xarray as xr

    from vehicle_sbi.inference.study import Prepared
    from vehicle_sbi.mismatch.problem.case import Case
    from vehicle_sbi.mismatch.selection.pruned import Pruned

FILE = "posterior.nc"
ENGINE = "h5netcdf"
DIMENSIONS = ("chain", "draw")


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What draws come from: the study's name, its seed, the package's version and the SHA-256 of the configuration."""

    study: str
    seed: int | None
    version: str | None
    config_sha256: str | None = None

    @classmethod
    def of_folder(cls, folder: RunFolder, study: str) -> "Origin":
        """As a run's manifest has it."""
        known = folder.manifest
        return cls(study=study, seed=known["seed"], version=known["version"], config_sha256=known["config"]["sha256"])

    @classmethod
    def here(cls, study: str, seed: int) -> "Origin":
        """Of what was found without a run folder."""
        try:
            return cls(study=study, seed=seed, version=version("vehicle-sbi"))
        except PackageNotFoundError:
            return cls(study=study, seed=seed, version=None)

    def attributes(self, library: str) -> dict[str, Any]:
        return _attributes(
            created_at=datetime.now(UTC).isoformat(timespec="seconds"),
            creation_library="vehicle_sbi",
            creation_library_version=self.version,
            inference_library=library,
            study=self.study,
            seed=self.seed,
            config_sha256=self.config_sha256,
        )


def of_run(prepared: "Prepared", samples: np.ndarray, predicted: Predictive, origin: Origin) -> "xr.DataTree":
    """A run: as many draws of the prior as of the posterior, and the bands of predicted channels."""
    import xarray as xr

    simulator, observed = prepared.problem.simulator, prepared.problem.observed
    space, windows, root = simulator.space, simulator.windows, origin.attributes("sbi")
    true = [None] * len(space) if prepared.truth is None else prepared.truth.tolist()
    said = [{**_described(p), "true_value": x} for p, x in zip(space.parameters, true, strict=True)]
    rng = generator(seed=simulator.seed, stream=Stream.POSTERIOR, index=1)
    prior = rng.uniform(space.low, space.high, samples.shape)
    groups = {
        "/": xr.Dataset(attrs=root),
        "/posterior": _draws(space.names, samples, said).assign_attrs(root),
        "/prior": _draws(space.names, prior, [_described(p) for p in space.parameters]),
        "/observed_data": _observed(windows, observed),
        "/posterior_predictive": _bands(windows, predicted),
    }
    return xr.DataTree.from_dict(groups)


def of_diagnosis(case: "Case", pruned: "Pruned", origin: Origin) -> "xr.DataTree":
    """A diagnosis: draws of base parameters and effects, whatever else is missing.

    `sample_stats.included` says in which draws each effect's parameter is away from its null; where it is not, the
    draw has a negligible size. `sample_stats.unexplained` says in which there is a discrepancy besides.
    """
    import xarray as xr

    root = origin.attributes("vehicle_sbi")
    space, base = pruned.fit.simulator.space, {p.name for p in pruned.expansion.base}
    said = [
        {**_described(p), **({"role": "base"} if p.name in base else _of_effect(pruned, p))} for p in space.parameters
    ]
    groups = {
        "/": xr.Dataset(attrs=root),
        "/posterior": _draws(space.names, pruned.theta, said).assign_attrs(root),
        "/sample_stats": _present(pruned),
        "/observed_data": _observed(case.observation.simulator.windows, case.observation.observed),
    }
    return xr.DataTree.from_dict(groups)


def write(path: Path, tree: "xr.DataTree") -> None:
    """Write a tree of groups, whole or not at all."""
    content = BytesIO()
    tree.to_netcdf(content, engine=ENGINE)
    write_atomically(path, lambda file: file.write(content.getbuffer()))


def draws(tree: "xr.DataTree") -> pd.DataFrame:
    """Draws of the posterior, a column a parameter; NaN where a parameter's effect is at its null."""
    posterior = tree["posterior"].to_dataset()
    frame = pd.DataFrame({one.attrs.get("parameter", name): one.values[0] for name, one in posterior.data_vars.items()})
    if "sample_stats" in tree.children:
        included = tree["sample_stats"].to_dataset()["included"]
        for name, there in zip(included["effect_parameter"].values, included.values[0].T, strict=True):
            frame[name] = frame[name].where(there)
    return frame


def read(path: Path) -> pd.DataFrame:
    """The `draws` in a file. Raises InputError for any other file."""
    import xarray as xr

    try:
        with xr.open_datatree(path, engine=ENGINE) as tree:
            return draws(tree)
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a NetCDF-4 file of posterior draws ({type(error).__name__})") from None


def variables(names: Iterable[str]) -> dict[str, str]:
    """What each parameter is called in the file: its name, but for what NetCDF does not allow in one."""
    taken, called = set[str](DIMENSIONS), dict[str, str]()
    for name in names:
        variable = re.sub(r"[^\w.]|^\.+$", "_", name) or "_"
        while variable in taken:
            variable += "_"
        taken.add(variable)
        called[name] = variable
    return called


def _draws(names: Sequence[str], theta: np.ndarray, said: Sequence[Mapping[str, Any]]) -> "xr.Dataset":
    """A variable a parameter, over one chain."""
    import xarray as xr

    called = variables(names)
    content = {
        called[name]: (DIMENSIONS, column[None], _attributes(parameter=name, **attributes))
        for name, column, attributes in zip(names, theta.T, said, strict=True)
    }
    return xr.Dataset(content, coords=_places(len(theta)))


def _places(n: int) -> dict[str, np.ndarray]:
    return {"chain": np.zeros(1, dtype=np.int64), "draw": np.arange(n)}


def _described(p: Parameter) -> dict[str, Any]:
    return {"units": p.unit, "long_name": long_name(p), "prior_low": p.low, "prior_high": p.high, "null_value": p.null}


def long_name(p: Parameter) -> str:
    """A parameter in words."""
    effect, _, key = p.name.partition(".")
    if effect in CATALOGUE:
        return f"{effect.replace('_', ' ')}, {key.replace('_', ' ')}: {CATALOGUE[effect].meaning}"
    if p.relative:
        return " and ".join(MEANINGS[field] for field in p.fields) + ", offset from nominal"
    return MEANINGS.get(p.name, p.name)


def _of_effect(pruned: "Pruned", p: Parameter) -> dict[str, Any]:
    """How probable it is that an effect's parameter is away from its null, and that its effect is missing."""
    return {
        "role": "size" if p in pruned.expansion.sizes else "shape",
        "inclusion_probability": float(_included(pruned, p).mean()),
        "effect_probability": float(_there(pruned, p).mean()),
    }


def _included(pruned: "Pruned", p: Parameter) -> np.ndarray:
    """In which draws a size is away from its null; of what only shapes an effect, in which that is missing."""
    sizes = [size.name for size in pruned.expansion.sizes]
    return pruned.included[:, sizes.index(p.name)] if p.name in sizes else _there(pruned, p)


def _there(pruned: "Pruned", p: Parameter) -> np.ndarray:
    """In which draws the effect of a parameter is missing, by sizes that show if it has any."""
    effect = p.name.split(".")[0]
    return pruned.missing[effect] if effect in pruned.missing else pruned.away(effect)


def _present(pruned: "Pruned") -> "xr.Dataset":
    """In which draws there is what: each effect's parameters, and a discrepancy that no effect stands for."""
    import xarray as xr

    effects = (*pruned.expansion.sizes, *pruned.expansion.shapes)
    included = np.zeros((1, len(pruned.theta), len(effects)), dtype=bool)
    for k, p in enumerate(effects):
        included[0, :, k] = _included(pruned, p)
    away, beside = "whether the effect's parameter is away from its null", "whether there is an unknown discrepancy"
    content = {
        "included": ((*DIMENSIONS, "effect_parameter"), included, {"long_name": away}),
        "unexplained": (DIMENSIONS, pruned.unexplained[None], {"long_name": beside}),
    }
    names = np.array([_text(p.name) for p in effects], dtype=np.str_)
    of = np.array([_text(p.name.split(".")[0]) for p in effects], dtype=np.str_)
    places = {**_places(len(pruned.theta)), "effect_parameter": names, "effect": ("effect_parameter", of)}
    return xr.Dataset(content, coords=places)


def _observed(windows: Windows, observed: np.ndarray) -> "xr.Dataset":
    """What is fitted of each channel, NaN elsewhere."""
    import xarray as xr

    measured = np.where(windows.valid, observed, np.nan)
    content = {
        name: ("time", series, {"units": CHANNELS[name].unit})
        for name, series in zip(windows.channels, measured, strict=True)
    }
    return xr.Dataset(content, coords=_clock(windows))


def _bands(windows: Windows, predicted: Predictive) -> "xr.Dataset":
    """Quantiles of the posterior predictive, noise included."""
    import xarray as xr

    content = {
        name: (("quantile", "time"), predicted.quantiles[:, i], {"units": CHANNELS[name].unit})
        for i, name in enumerate(windows.channels)
    }
    return xr.Dataset(content, coords={"quantile": np.array(QUANTILES), **_clock(windows)})


def _clock(windows: Windows) -> dict[str, Any]:
    """The recording's own time of each sample, and which window it is in; of several recordings, also which."""
    length = windows.t.shape[1]
    clock: dict[str, Any] = {
        "time": ("time", windows.t.ravel(), {"units": "s", "long_name": "time of the recording"}),
        "window": ("time", np.repeat(np.arange(len(windows.t)), length)),
    }
    if len({*windows.recordings}) > 1:
        clock["recording"] = ("time", np.repeat([_text(name) for name in windows.recordings], length))
    return clock


def _attributes(**given: Any) -> dict[str, Any]:
    """What is known, in a form that NetCDF takes."""
    return {name: _text(x) if isinstance(x, str) else x for name, x in given.items() if x is not None}


def _text(text: str) -> str:
    """Text without what HDF5 cannot hold: a NUL, half a character."""
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}").encode("utf-8", "replace").decode()
