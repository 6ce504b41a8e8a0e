"""From the folder of a run or a diagnosis to what it knows."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vehicle_sbi import plain_yaml
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.plausible import PLAUSIBLE
from vehicle_sbi.inference.prior import KNOWN, flatten
from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.mismatch.estimation.estimate import Estimate, drawn, quantity, told
from vehicle_sbi.physics.vehicle import Vehicle
from vehicle_sbi.physics.vehicle import read as read_vehicle
from vehicle_sbi.report import manifest, netcdf
from vehicle_sbi.report.export.car import FACTORS
from vehicle_sbi.report.export.exported import Exported, Inferred
from vehicle_sbi.report.run_folder import FinishedRun
from vehicle_sbi.report.run_folder import read as read_run
from vehicle_sbi.report.tables.posterior import (
    NOT_LEARNED,
    maybe_none,
    on_edge,
    read_table,
    unidentified,
)
from vehicle_sbi.words import enumerated

UNCHECKED = (
    "This run did not look for physics that its model lacks. Its uncertainties hold if nothing is missing. "
    "A diagnosis looks."
)
GIVEN = "This run took {} for all that is missing. Its uncertainties hold if nothing else is."
ALLOWED_FOR = (
    "This run drew whatever physics may be missing from the effect prior, and its uncertainties allow for that. It did "
    "not look for what is missing; a diagnosis looks."
)
FEWEST = 30  # draws in which two parameters are there, from which they tell how those hang together
THERE = 0.95  # probability of an effect, below which the 90 % interval of its size in all draws reaches its null
STRONG = 0.9  # correlation above which a run's parameters are to be used together or not at all
INDEPENDENT = "A value made of several parameters takes them as independent: no samples of them together are stored."


def read(folder: Path) -> Exported:
    """What a finished run or diagnosis knows.

    Raises InputError for anything else, and where nothing was identified.
    """
    run = read_run(folder)
    found = _diagnosis(run) if (folder / "verdict.json").exists() else _run(run)
    if not found.identified:
        free = ", ".join(found.inferred) or "none"
        raise InputError(f"{folder}: none of its parameters was identified ({free}), so there is nothing to export")
    return found


def _run(run: FinishedRun) -> Exported:
    """What the table and the samples of a run tell."""
    inferred = dict(_rows(_table(run.file("table.csv"))))
    correlation = _correlation(run.file("samples.parquet"), [*inferred])
    facts = run.manifest.get("facts", {})
    assumed = _assumed(run.config.get("effects"))
    known = [name for name, one in inferred.items() if one.identified]
    pairs = _correlated(known, correlation, facts.get("confusable", ()))
    caveats = [*facts.get("warnings", ()), *pairs, assumed, *([INDEPENDENT] if correlation is None else [])]
    return _exported(run, "run", inferred, correlation, {}, caveats)


def _correlated(
    known: Sequence[str], correlation: pd.DataFrame | None, confusable: Iterable[tuple[str, str, float]]
) -> Iterator[str]:
    """Which of the known parameters the run hardly tells apart, by its samples or by its bound."""
    found = dict[tuple[str, str], float]()
    if correlation is not None:
        numbers = correlation.loc[[*known], [*known]].to_numpy()[np.triu_indices(len(known), 1)]
        found |= {pair: r for pair, r in zip(combinations(known, 2), numbers, strict=True) if abs(r) > STRONG}
    found |= {(a, b): r for a, b, r in confusable if a in known and b in known}
    pairs = sorted(found.items(), key=lambda one: -abs(one[1]))
    if pairs:
        yield f"Hardly told apart, with correlations: {', '.join(f'{a} and {b} ({r:.2f})' for (a, b), r in pairs)}."


def _assumed(effects: str | list[str] | None) -> str:
    """What a run took to be missing."""
    if effects == PLAUSIBLE:
        return ALLOWED_FOR
    return GIVEN.format(enumerated([str(one) for one in effects])) if effects else UNCHECKED


def _table(file: Path) -> pd.DataFrame:
    if not file.exists():
        raise InputError(f"{file.parent}: neither a run (table.csv) nor a diagnosis (verdict.json)")
    return read_table(file)


def _rows(table: pd.DataFrame) -> Iterator[tuple[str, Inferred]]:
    """Each parameter of a run's table."""
    for row, why_not in zip(table.to_dict("records"), unidentified(table), strict=True):
        name = str(row["parameter"])
        estimate = _estimate(row, str(row["unit"]), f"table.csv: {name}")
        identified = str(row["identified"]).strip().lower() == "true"
        box = (float(row["prior_low"]), float(row["prior_high"]))
        found = _inferred(name, estimate, box, identified=identified and _finite(estimate))
        yield name, replace(found, why_not=NOT_LEARNED) if why_not == NOT_LEARNED else found


def _correlation(file: Path, names: list[str]) -> pd.DataFrame | None:
    """Correlations of a run's samples; None where the file does not hold them."""
    if not file.exists():
        return None
    try:
        samples = pd.read_parquet(file)
    except ValueError:  # pyarrow's errors are kinds of it
        raise InputError(f"{file}: not a Parquet file") from None
    if not set(names) <= set(samples) or len(samples) < 2:
        return None
    correlation = samples[names].corr().fillna(0.0)
    for name in names:
        correlation.loc[name, name] = 1.0
    return correlation


def _diagnosis(run: FinishedRun) -> Exported:
    """What a verdict tells: base parameters with what is missing averaged over, and sizes of the effects it names."""
    file = run.file("verdict.json")
    boxes = _boxes(run)
    try:
        verdict = json.loads(file.read_bytes())
        inferred = {**dict(_base(verdict, boxes)), **dict(_effects(verdict, boxes))}
        doubted = {name: float(p) for name, p in verdict["effects"].items() if p <= NAMED}
        caveats = list(_caveats(verdict))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file}: not the verdict of a diagnosis of this version ({error!r})") from None
    draws = _draws(run.file(netcdf.FILE), [*inferred])
    inferred |= _averaged(inferred, boxes, draws) if draws is not None else {}
    correlation = None if draws is None else _together(_at_null(draws, inferred))
    caveats += [INDEPENDENT] if correlation is None else []
    return _exported(run, "diagnosis", inferred, correlation, doubted, caveats)


def _draws(file: Path, names: list[str]) -> pd.DataFrame | None:
    """A diagnosis's joint draws of some parameters, NaN where an effect is not there; None where it has none."""
    draws = netcdf.read(file) if file.exists() else pd.DataFrame()
    return draws[names] if set(names) <= set(draws) and len(draws) else None


def _averaged(
    inferred: Mapping[str, Inferred], boxes: Mapping[str, tuple[float, float]], draws: pd.DataFrame
) -> dict[str, Inferred]:
    """What multiplies a constant, over all draws: a constant as driven then needs no certainty of the effect."""
    found = dict[str, Inferred]()
    for name in {*chain(*FACTORS.values())} & {*inferred}:
        one, null = inferred[name], KNOWN[name].null
        if one.probability is None or one.probability >= THERE or null is None:
            continue
        estimate = drawn(draws[name].fillna(null).to_numpy(), one.estimate.unit)
        if _told(estimate, boxes.get(name)):
            found[name] = replace(one, estimate=estimate, identified=True, averaged=True)
    return found


def _at_null(draws: pd.DataFrame, inferred: Mapping[str, Inferred]) -> pd.DataFrame:
    """Draws with averaged parameters at their null where their effect is not there."""
    return draws.fillna({name: KNOWN[name].null for name, one in inferred.items() if one.averaged})


def _together(draws: pd.DataFrame) -> pd.DataFrame:
    """Correlations of draws, each pair's from those in which both are there; one that is rarely there together counts
    as independent."""
    return _proper(draws.corr(min_periods=FEWEST).fillna(0.0))


def _proper(correlation: pd.DataFrame) -> pd.DataFrame:
    """The matrix with ones on its diagonal and no negative eigenvalues, which pairs of different draws may give it."""
    matrix = correlation.to_numpy(copy=True)
    np.fill_diagonal(matrix, 1.0)
    values, vectors = np.linalg.eigh(matrix)
    fixed = vectors * np.clip(values, 0.0, None) @ vectors.T
    std = np.sqrt(np.diag(fixed))
    return pd.DataFrame(fixed / np.outer(std, std), correlation.index, correlation.columns)


def _boxes(run: FinishedRun) -> Mapping[str, tuple[float, float]]:
    """The bounds of every parameter's prior: those of the extended model, else the configured, else the catalogue's."""
    file = run.file("extended.yaml")
    try:
        extended = plain_yaml.load(file) if file.exists() else {}
    except plain_yaml.UnreadableYaml as error:
        raise InputError(f"{file}: {error}") from None
    stated = {**flatten(run.config.get("prior") or {}), **flatten(extended.get("prior") or {})}
    boxes = {name: (p.low, p.high) for name, p in KNOWN.items()}
    return boxes | {name: (float(low), float(high)) for name, (low, high) in stated.items()}


def _base(verdict: Mapping[str, Any], boxes: Mapping[str, tuple[float, float]]) -> Iterator[tuple[str, Inferred]]:
    for name, one in verdict["base_parameters"].items():
        estimate = _estimate(one["after"], one["unit"], f"verdict.json: {name}")
        box = boxes.get(name)
        yield name, _inferred(name, estimate, box, identified=_told(estimate, box))


def _effects(verdict: Mapping[str, Any], boxes: Mapping[str, tuple[float, float]]) -> Iterator[tuple[str, Inferred]]:
    """Parameters of each effect that is named, from the likeliest set that has it."""
    likeliest = {name: e for one in reversed(verdict["explanations"]) for name, e in one["parameters"].items()}
    for name, e in likeliest.items():
        probability = verdict["effects"].get(name.split(".")[0], 0.0)
        if probability > NAMED:
            estimate = _estimate(e, e["unit"], f"verdict.json: {name}")
            box = boxes.get(name)
            yield name, _inferred(name, estimate, box, identified=_told(estimate, box), probability=probability)


def _inferred(
    name: str,
    estimate: Estimate,
    box: tuple[float, float] | None,
    *,
    identified: bool,
    probability: float | None = None,
) -> Inferred:
    """A parameter, which is not identified either where it may as well be that of no effect."""
    null = KNOWN[name].null if name in KNOWN else None
    found = Inferred(
        estimate=estimate,
        identified=identified,
        on_edge=box is not None and on_edge(estimate.mean, *box, null),
        probability=probability,
    )
    nothing = box is not None and maybe_none(estimate.mean, estimate.std, *box, null)
    if identified and (nothing or (probability is not None and probability < THERE)):
        return replace(found, identified=False, why_not=_compatible(name, estimate, probability))
    return found


def _compatible(name: str, e: Estimate, probability: float | None) -> str:
    """That a size may as well be that of no effect, and what it would be."""
    missing = "" if probability is None else f" if {name.split('.')[0]} is missing ({probability:.2f})"
    return f"compatible with no effect; it would be {quantity('', e).removeprefix(' = ')}{missing}"


def _told(estimate: Estimate, box: tuple[float, float] | None) -> bool:
    """Whether recordings told a parameter of a diagnosis, as far as its prior's box is known."""
    return _finite(estimate) and (box is None or told(estimate.std, *box))


def _caveats(verdict: Mapping[str, Any]) -> Iterator[str]:
    """What the diagnosis says of its own numbers."""
    yield f"Diagnosis: {verdict['headline']}"
    for law in (verdict["unknown"] or {}).get("laws", ())[:1]:
        size = law["size"]
        yield f"No known effect explains: {law['target']} of {size['mean']:.2g} {size['unit']} (root mean square)."
    fit = verdict["fit"]
    if "accepted" in fit:
        said = "accepted" if fit["accepted"] else "NOT accepted"
        yield f"On held-out data the extended model is {said}: {fit['accepted_because']}."
    for group in verdict["indistinguishable"]:
        yield f"These recordings hardly tell apart {enumerated(group)}."
    for stuck in (verdict["unknown"] or {}).get("beyond_prior", ()):
        yield f"At the bounds of its prior: {', '.join(stuck['parameters'])}."
    yield from verdict["warnings"]


def _estimate(numbers: Mapping[Any, Any], unit: str, where: str) -> Estimate:
    try:
        mean, std, q05, q95 = (float(numbers[key]) for key in ("mean", "std", "q05", "q95"))
    except (TypeError, ValueError):
        raise InputError(f"{where}: mean, std, q05 and q95 must be numbers") from None
    return Estimate(mean=mean, std=std, q05=q05, q95=q95, unit=unit)


def _finite(estimate: Estimate) -> bool:
    return all(math.isfinite(number) for number in (estimate.mean, estimate.std, estimate.q05, estimate.q95))


def _exported(
    run: FinishedRun,
    kind: str,
    inferred: Mapping[str, Inferred],
    correlation: pd.DataFrame | None,
    doubted: Mapping[str, float],
    caveats: list[str],
) -> Exported:
    vehicle, unread = _vehicle(run.config.get("vehicle") or {}, run.manifest["inputs"])
    constants = {} if vehicle is None else {k: float(v) for k, v in vehicle.constants().items() if math.isfinite(v)}
    freed = {field for name in inferred if name in KNOWN for field in KNOWN[name].fields}
    return Exported(
        folder=run.path,
        kind=kind,
        vehicle="unknown" if vehicle is None else str(vehicle.name),
        version=str(run.manifest.get("version")),
        inferred=inferred,
        stated={name: value for name, value in constants.items() if name not in freed},
        nominal=constants,
        correlation=correlation,
        doubted=doubted,
        caveats=(*caveats, *unread),
    )


def _vehicle(config: Mapping[str, Any], inputs: Mapping[str, str]) -> tuple[Vehicle | None, tuple[str, ...]]:
    """The vehicle of a configuration, and why its constants are not known where its file has gone.

    Raises InputError where the file is not the one of the `inputs`, SHA-256 by path, that the run had.
    """
    if "path" in config:
        path = str(config["path"])
        if path in inputs and Path(path).is_file() and not manifest.intact(Path(path), inputs[path]):
            raise InputError(
                f"{path} has changed since this run, so the constants that the run had are not known; repeat the run"
            )
        try:
            return read_vehicle(path), ()
        except InputError as error:
            return None, (f"Constants of the vehicle are not known: {error}.",)
    known = {field.name for field in fields(Vehicle)}
    try:
        return Vehicle(**{name: value for name, value in config.items() if name in known}), ()
    except (TypeError, InputError) as error:
        return None, (f"Constants of the vehicle are not known: {error}.",)
