"""How much of what a diagnosis misses the recordings could tell: the same cars, in a world that is the linear model's.

python benchmarks/what_can_be_told.py FOLDER NAME

FOLDER is one of `scripts/prove.py mix=whole_car`, NAME that of its diagnoses. Of each diagnosis the expanded model,
made linear about its last fit, makes recordings anew: base parameters as they are, effects of the catalogue at their
true sizes, what the world has by itself as the diagnosis found it, nothing else, and noise as the diagnosis estimated
it. The selection that a diagnosis makes is then asked about these. What it misses there, it misses for want of
information or by its priors; what it misses of the recordings alone comes from tyres and bodies that are others than
the model's, from effects outside the catalogue, and from what is not linear.
"""

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gathering import RESULTS
from jaxtyping import Float
from measures import shown
from selectors_compared import Problem, chances, problem, selected
from whole_car.page import MEASURES
from whole_car.scores import Scored, by_selection, parameters, scored

from vehicle_sbi.files import write_text
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.linear_gaussian import order, origin
from vehicle_sbi.report.tables.text import markdown

SEED = 1  # of the noise
COLUMNS = ("the diagnosis", "its selection", "its selection, recordings of the linear model")


def truth_of(given: Problem, truth: Mapping[str, Any]) -> Float[np.ndarray, " d"]:
    """Every parameter of the expanded model: as it is, or as it was found where the truth states none."""
    expansion, found = given.pruned.expansion, given.pruned
    stated = dict(truth["base_parameters"])
    for name, one in truth["effects"].items():
        stated |= {f"{name}.{key}": value for key, value in one["parameters"].items()} if one["inside"] else {}
    here = {*truth["effects"], *truth["inherent"]}
    sizes = {p.name for p in expansion.sizes}
    rest = dict(zip(expansion.space.names, expansion.rest, strict=True))
    mean = dict(zip(expansion.space.names, found.theta.mean(axis=0), strict=True))
    fitted = dict(zip(expansion.space.names, found.fit.theta, strict=True))
    shapes = {p.name for p in expansion.shapes}

    def value(name: str) -> float:
        if name in stated:
            return float(stated[name])
        absent = name.split(".")[0] not in here
        return float((rest if absent and name in sizes else fitted if absent and name in shapes else mean)[name])

    return np.array([value(name) for name in expansion.space.names])


def exact(given: Problem, theta: Float[np.ndarray, " d"], rng: np.random.Generator) -> Problem:
    """The problem of recordings that the linear model makes of these parameters."""
    H, expansion = given.linear.H, given.pruned.expansion
    c = np.zeros(len(H))
    c[: len(theta)] = expansion.coefficients(theta)[order(expansion)] - origin(expansion, given.pruned.fit.theta)
    size, axes = np.linalg.eigh(H)
    noise = axes @ (np.sqrt(np.maximum(size, 0.0)) * rng.standard_normal(len(H)))
    return replace(given, linear=replace(given.linear, b=H @ c + noise))


def judged(case: Path, truth: Mapping[str, Any], given: Problem) -> Scored:
    """What the selection says of a problem, scored as a diagnosis is."""
    drawn = selected(given)
    expansion = given.pruned.expansion
    c = drawn.coefficient[:, np.argsort(order(expansion))]
    theta = expansion.theta(c)[:, : len(expansion.base)]
    said = {
        p.name: {"mean": x.mean(), "std": x.std(), "q05": np.quantile(x, 0.05), "q95": np.quantile(x, 0.95)}
        for p, x in zip(expansion.base, theta.T, strict=True)
    }
    return by_selection(truth, case, chances(given, drawn), parameters(truth["base_parameters"], said))


def main(folder: Path, name: str) -> None:
    prior, rng = EffectPrior(), np.random.default_rng(SEED)
    columns: dict[str, list[Scored]] = {column: [] for column in COLUMNS}
    for path in sorted(folder.glob(f"cases/*/{name}")):
        case = path.parent
        truth = json.loads((folder / "sealed" / f"{case.name}.json").read_text())
        whole = scored(folder, int(case.name), name)
        given = None if whole is None else problem(path, prior)
        if given is None or whole is None:
            continue
        made = exact(given, truth_of(given, truth), rng)
        for column, one in zip(COLUMNS, (whole, judged(case, truth, given), judged(case, truth, made)), strict=True):
            columns[column].append(one)
    text = report(columns, json.loads((folder / "benchmark.json").read_text())["seed"])
    write_text(RESULTS / "what_can_be_told.md", text)
    print(text)


def report(columns: Mapping[str, Sequence[Scored]], seed: int) -> str:
    """A row per measure that the selection alone has."""
    rows = [{"measure": m.label} | {c: shown(m, cases) for c, cases in columns.items()} for m in MEASURES]
    table = pd.DataFrame([row for row in rows if all(row[c] for c in COLUMNS)])
    drawn = f"{len(columns[COLUMNS[0]])} whole cars of seed {seed}"
    return f"{drawn}, {date.today()}, {platform.platform()}.\n\n{markdown(table)}"


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
