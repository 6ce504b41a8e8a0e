"""The package in Python: `from vehicle_sbi import read, identify, diagnose, simulate`.

What is not said is as the command line has it: defaults come from the same files in conf/, and the same numbers come
out.
"""

import json
import pkgutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.command import CONF
from vehicle_sbi.data.manoeuvre import Manoeuvre
from vehicle_sbi.data.mapping import built
from vehicle_sbi.data.noise import ConstantNoise, ProcessNoise
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.predictive import Predictive
from vehicle_sbi.inference.setup import Setup
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found, verdict
from vehicle_sbi.mismatch.pipeline import steps
from vehicle_sbi.mismatch.problem.case import Case, Diagnosis
from vehicle_sbi.mismatch.selection import ahead
from vehicle_sbi.physics.vehicle import Vehicle
from vehicle_sbi.physics.vehicle import read as read_vehicle
from vehicle_sbi.report import netcdf
from vehicle_sbi.report.manifest import code, digest
from vehicle_sbi.rng import Stream, generator
from vehicle_sbi.rounding import mean_and_std
from vehicle_sbi.threads import algebra_on_one_thread

if TYPE_CHECKING:  # they need torch, sbi or xarray, which take long to import
    from xarray import DataTree

    from vehicle_sbi.inference.rounds import Inference
    from vehicle_sbi.inference.study import Prepared

"""What drives a simulated manoeuvre."""

SHOWN = 10  # effects in the table of a notebook

Source = str | Path | RecordingFile | Recording
Box = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Held(RecordingFile):
    """A recording that is in memory already."""

    recording: Recording

    def load(self) -> Recording:
        return self.recording


@dataclass(frozen=True, repr=False)
class Identified:
    """Parameters of a vehicle: `table` (a row each), `samples` (a column each) of the posterior, sbi's own, and
    `warnings`: what to know before the table is relied on."""

    table: pd.DataFrame
    samples: pd.DataFrame
    prepared: "Prepared"
    inference: "Inference"
    predicted: Predictive
    warnings: Sequence[str] = ()

    @property
    def posterior(self) -> Any:
        """sbi's posterior at what was observed."""
        return self.inference.posterior

    def plot(self) -> Figure:
        """The posterior of each parameter, with its 90 % interval; the outermost 1 % of the samples is left out."""
        rows = self.table.set_index("parameter")
        figure = Figure(figsize=(2.4 * len(rows), 2.2), layout="constrained")
        panels = figure.subplots(1, len(rows), squeeze=False)[0]
        for axes, (name, row) in zip(panels, rows.iterrows(), strict=True):
            values = self.samples[str(name)]
            shown = (values.quantile(0.005), values.quantile(0.995))
            axes.hist(values, bins=40, range=shown, histtype="stepfilled", alpha=0.6)
            axes.axvspan(row["q05"], row["q95"], color="0.5", alpha=0.2)
            axes.locator_params(axis="x", nbins=3)
            axes.set(xlabel=f"{name} [{row['unit']}]", yticks=[])
        return figure

    @cached_property
    def datatree(self) -> "DataTree":
        """Draws of posterior and prior, observed channels and predicted bands, as xarray and ArviZ have them."""
        simulator = self.prepared.problem.simulator
        origin = netcdf.Origin.here(self.prepared.name, simulator.seed)
        return netcdf.of_run(self.prepared, self.samples.to_numpy(), self.predicted, origin)

    def to_netcdf(self, path: str | Path) -> None:
        """Write them to a NetCDF-4 file, which ArviZ reads."""
        netcdf.write(Path(path), self.datatree)

    def __repr__(self) -> str:
        from vehicle_sbi.report.tables.text import terminal

        return "\n".join([terminal(self.table), *self.warnings])

    def _repr_html_(self) -> str:
        from vehicle_sbi.report.tables.text import for_people, html

        return html(for_people(self.table)) + _paragraphs(self.warnings)


@dataclass(frozen=True, repr=False)
class Diagnosed:
    """What a simulation lacks: the `verdict`, and what each step found."""

    verdict: Verdict
    case: Case
    found: Found

    @cached_property
    def table(self) -> pd.DataFrame:
        """Each effect with the probability that it is missing, whatever else is; the likeliest first."""
        p = self.verdict.effects
        return pd.DataFrame({"effect": [*p], "probability": [*p.values()]})

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Each base parameter before, in the base model, and after, with what is missing averaged over, and whether the
        recordings identified it."""
        given: dict[str, Any] = self.verdict.base_parameters
        rows = [
            {"parameter": name, "unit": one["unit"]}
            | {f"{key} {when}": one[when][key] for when in ("before", "after") for key in ("mean", "std")}
            | {"identified": one["identified"]}
            for name, one in given.items()
        ]
        return pd.DataFrame(rows)

    @cached_property
    def samples(self) -> pd.DataFrame:
        """Joint draws of base parameters and effects, a column each; NaN where an effect is not missing.

        Raises InputError where there are none, as `datatree` does.
        """
        return netcdf.draws(self.datatree)

    @cached_property
    def datatree(self) -> "DataTree":
        """Joint draws of base parameters and effects with observed channels, as xarray and ArviZ have them.

        Raises InputError where there are none, since the model with every effect in cannot be simulated.
        """
        if self.found.pruned is None:
            raise InputError(f"{self.case.name}: no draws; the model with every effect in cannot be simulated")
        origin = netcdf.Origin.here(self.case.name, self.case.observation.simulator.seed)
        return netcdf.of_diagnosis(self.case, self.found.pruned, origin)

    def to_netcdf(self, path: str | Path) -> None:
        """Write them to a NetCDF-4 file, which ArviZ reads."""
        netcdf.write(Path(path), self.datatree)

    def plot(self) -> Figure:
        """Probabilities of the effects that are likelier than 5 %."""
        shown = self.table[self.table["probability"] > 0.05]
        figure = Figure(figsize=(6.0, 0.8 + 0.3 * len(shown)), layout="constrained")
        axes = figure.subplots()
        axes.barh(shown["effect"], shown["probability"])
        axes.invert_yaxis()
        axes.set(xlim=(0.0, 1.0), xlabel="probability that it is missing")
        return figure

    def __str__(self) -> str:
        return "\n".join([self.verdict.headline, *self.verdict.lines, *self.verdict.warnings])

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from vehicle_sbi.report.tables.text import html

        effects = self.table.head(SHOWN).assign(probability=lambda t: t["probability"].map("{:.2f}".format))
        given = self.parameters
        base = given[["parameter", "unit"]].copy()
        for when in ("before", "after"):
            base[when] = [*map(mean_and_std, given[f"mean {when}"], given[f"std {when}"])]
        base["identified"] = given["identified"].map({True: "yes", False: "no"})
        lines = _paragraphs([*self.verdict.lines, *self.verdict.warnings])
        return f"<h4>{escape(self.verdict.headline)}</h4>{lines}{html(effects)}{html(base)}"


def read(path: str | Path, mapping: str | Path | Box | None = None, **settings: Any) -> Recording:
    """A recording of any format that is read.

    `mapping` says which column holds which channel, or names a file that does, or one of conf/mapping ("motec").
    `settings` are those of `RecordingFile` (rate, start_s, dbc, …).
    """
    named = CONF / "mapping" / f"{mapping}.yaml" if isinstance(mapping, str) else None
    mapped = named if named is not None and named.is_file() else mapping
    return built(RecordingFile, {"path": path, "mapping": mapped, **settings}, "read").load()


def identify(
    recordings: Source | Sequence[Source],
    vehicle: str | Path | Vehicle,
    *,
    prior: str | Box = "lateral",
    rounds: str | Mapping[str, Any] = "truncated",
    samples: int = 5000,
    reweight: bool = True,
    folder: str | Path | None = None,
    quiet: bool = False,
    **settings: Any,
) -> Identified:
    """Parameters of a vehicle from a recording, or from several together, by rounds of neural posterior estimation.

    `prior` names a file of conf/prior or maps parameters to [low, high]. `rounds` names a scheme or changes numbers of
    the default one ({"simulations": 1000}), as do `training` and `noise`. Other `settings` are those of a study: drive,
    effects, window_s, seed, … In `folder` rounds are kept, and taken from there by the same call.
    """
    from vehicle_sbi.inference.rounds import infer
    from vehicle_sbi.inference.study import Study
    from vehicle_sbi.report.results import results, warnings_of

    parts = {"features": "score", "estimator": "nsf", "training": "default", "noise": "estimated"}
    built = {group: _chosen(group, name, settings.pop(group, name)) for group, name in parts.items()}
    files = _files(recordings)
    study = Study(**_common(files[0], vehicle, prior, settings, window_s=5.0), recordings=files, **built, truth=None)
    scheme = _chosen("rounds", "truncated", rounds)
    with tempfile.TemporaryDirectory() as nowhere, algebra_on_one_thread():
        prepared = study.prepare()
        asked = digest([repr(study), repr(scheme), prepared.inputs, code()])
        inference = infer(prepared.problem, scheme, _rounds(Path(folder or nowhere), asked), quiet=quiet)
        found = results(prepared, inference, samples=samples, reweight=reweight)
        warned = warnings_of(prepared, inference, found.table)
    names = list(prepared.problem.simulator.space.names)
    samples_by_name = pd.DataFrame(found.samples, columns=names)
    return Identified(found.table, samples_by_name, prepared, inference, found.predicted, warned)


def diagnose(
    recordings: Source | Sequence[Source],
    vehicle: str | Path | Vehicle,
    *,
    heldout: Source | Sequence[Source] = (),
    prior: str | Box = "lateral",
    effect_prior: str = "passenger_car",
    **settings: Any,
) -> Diagnosed:
    """What physics a simulation of these recordings lacks; `settings` are those of a diagnosis: drive, effects, …"""
    fitted, held = _files(recordings), [_file(one) for one in _listed(heldout)]
    ahead.begin()
    common = _common(fitted[0], vehicle, prior, settings, window_s=10.0)
    diagnosis = Diagnosis(
        **common,
        noise=_chosen("noise", "estimated", settings.pop("noise", "estimated")),
        recordings=fitted,
        heldout=held,
        effect_prior=_built("effect_prior", effect_prior),
    )
    with algebra_on_one_thread():
        case = diagnosis.prepare()
        found = steps(case, rng=generator(seed=diagnosis.seed, stream=Stream.STUDY, index=2))
        return Diagnosed(verdict(case, found), case, found)


def simulate(
    vehicle: str | Path | Vehicle,
    manoeuvre: str | Manoeuvre = "paper_mild",
    *,
    model: str = "single_track",
    **parameters: float,
) -> pd.DataFrame:
    """What drives a vehicle in a manoeuvre and what sensors would read of it, without noise: a column a channel, in
    native names, so that it is a recording once it is written to a file.

    `parameters` are constants of the vehicle, or of effects with "__" for the dot: `l_f=1.4, aero_drag__area=0.6`.
    """
    from vehicle_sbi.data.channels import CHANNELS
    from vehicle_sbi.physics.single_track import COMMANDS, INPUTS

    driven = manoeuvre if isinstance(manoeuvre, Manoeuvre) else _built("manoeuvre", manoeuvre)
    car, values = _vehicle(vehicle), {name.replace("__", "."): float(x) for name, x in parameters.items()}
    values = values or {"l_f": float(car.l_f or 0.0)}
    noise = ConstantNoise(std=dict.fromkeys(driven.channels, 1.0), process=ProcessNoise(stiffness=0.0))
    setup = Setup(
        vehicle=car, model=model, drive="torque", prior={name: _about(x) for name, x in values.items()},
        effects=[], window_s=driven.duration, warmup_s=0.0, noise=noise, seed=0,
    )  # fmt: skip
    windows = driven.windows(car)
    space = setup.space(windows)
    simulator = setup.simulator(space, windows, uniform_start=False)
    y = simulator.noise_free(np.array([[values[name] for name in space.names]]))[0]
    driven_by = {CHANNELS[name].column: windows.u[0, :, INPUTS.index(name)] for name in COMMANDS}
    table = {CHANNELS[name].column: series for name, series in zip(windows.channels, y, strict=True)}
    return pd.DataFrame({"time_s": windows.t.reshape(-1), **driven_by, **table})


def _paragraphs(lines: Sequence[str]) -> str:
    """Lines as HTML."""
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _rounds(folder: Path, asked: str) -> Checkpoints:
    """Rounds in a folder, those of an earlier call of the same if its file of hashes has them."""
    file = folder / "rounds.json"
    try:
        kept = json.loads(file.read_bytes()) if file.exists() else {"asked": asked, "files": {}}
        other, sealed = kept["asked"] != asked, dict(kept["files"])
    except (ValueError, TypeError, LookupError):
        raise InputError(f"{file}: not the hashes of rounds; remove the folder or choose another") from None
    if other:
        raise InputError(f"{folder} holds rounds of another call, input or version; remove it or choose another")
    return Checkpoints(folder, sealed, lambda: write_text(file, json.dumps({"asked": asked, "files": sealed})))


def _common(
    file: RecordingFile, vehicle: str | Path | Vehicle, prior: str | Box, settings: dict[str, Any], *, window_s: float
) -> dict[str, Any]:
    """What studies and diagnoses are made of alike; what is used is taken out of the settings of the first file."""
    chosen = {
        "model": "single_track",
        "drive": file.drive,
        "effects": [],
        "window_s": window_s,
        "warmup_s": 0.5,
        "seed": 0,
    }
    strange = [name for name in settings if name not in {*chosen, "noise"}]
    if strange:
        raise unknown("setting", strange[0], chosen, "settings")
    chosen |= {name: settings[name] for name in chosen if name in settings}
    boxes = yaml.safe_load(_option("prior", prior).read_text(encoding="utf-8")) if isinstance(prior, str) else prior
    return {**chosen, "vehicle": _vehicle(vehicle), "prior": boxes, "recording": file}


def _file(source: Source) -> RecordingFile:
    if isinstance(source, Recording):
        return Held(path=source.source, name=source.name, recording=source)
    return source if isinstance(source, RecordingFile) else RecordingFile(path=source)


def _files(recordings: Source | Sequence[Source]) -> list[RecordingFile]:
    """One or several; raises InputError for none."""
    found = [_file(one) for one in _listed(recordings)]
    if not found:
        raise InputError("recordings: none is given")
    return found


def _listed(given: Source | Sequence[Source]) -> Sequence[Source]:
    return [given] if isinstance(given, str | Path | RecordingFile | Recording) else given


def _vehicle(given: str | Path | Vehicle) -> Vehicle:
    """A vehicle itself, from a file, or by the name that conf/vehicle has."""
    if isinstance(given, Vehicle):
        return given
    named = CONF / "vehicle" / f"{given}.yaml"
    return read_vehicle(str(named if named.is_file() else given))


def _option(group: str, name: str) -> Path:
    path = CONF / group / f"{name}.yaml"
    if not path.is_file():
        raise unknown("option", name, [file.stem for file in (CONF / group).glob("*.yaml")], group)
    return path


def _chosen(group: str, usual: str, given: Any) -> Any:
    """What an option's name, changes of the usual option, or an object itself stand for."""
    return _built(group, usual, given) if isinstance(given, Mapping) else _built(group, given)


def _built(group: str, name: str | Any, changes: Mapping[str, Any] | None = None) -> Any:
    """What one of the project's own configuration files builds, with some of its settings changed."""
    if not isinstance(name, str):
        return name
    return _constructed({**yaml.safe_load(_option(group, name).read_text(encoding="utf-8")), **(changes or {})})


def _constructed(node: Mapping[str, Any]) -> Any:
    target = pkgutil.resolve_name(node["_target_"])
    return target(**{key: _value(x) for key, x in node.items() if not key.startswith("_")})


def _value(node: Any) -> Any:
    """What a setting's value is: lists of YAML are tuples here."""
    if isinstance(node, list):
        return tuple(map(_value, node))
    return _constructed(node) if isinstance(node, Mapping) and "_target_" in node else node


def _about(x: float) -> list[float]:
    """A box around a value, which only has to hold it."""
    reach = 1e-3 * (abs(x) or 1e-3)
    return [x - reach, x + reach]
