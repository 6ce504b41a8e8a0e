"""Many runs in one table: a row for each, and what the seeds of each study have in common."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.report.run_folder import FinishedRun, is_finished, read
from vehicle_sbi.report.tables.posterior import read_table
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.rounding import mean_and_std, rounded


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """Many runs in one: `runs` has one row per run and parameter, `seeds` one per study and parameter.

    A study is all runs whose configuration differs in nothing but the seed; `left_out` lists runs not finished.
    """

    runs: pd.DataFrame
    seeds: pd.DataFrame
    left_out: tuple[Path, ...]

    def markdown(self) -> str:
        """Both tables for people, as the paper's Table II: a row per run and a column per parameter."""
        heading = ["run", "study", "estimator", "features", "seed"]
        rows = []
        for _, table in self.runs.groupby("run", sort=False):
            names = [f"{p} [{unit}]" for p, unit in zip(table["parameter"], table["unit"], strict=True)]
            rows.append({**table.iloc[0][heading].to_dict(), **dict(zip(names, _cells(table), strict=True))})
        parts = [
            "# Runs: posterior mean ± std (bound)\n", markdown(pd.DataFrame(rows).fillna("")),
            "# Over seeds\n", markdown(_seeds_for_people(self.seeds)),
        ]  # fmt: skip
        if self.left_out:
            parts += ["Not finished, left out:\n", *(f"- {path}" for path in self.left_out), ""]
        return "\n".join(parts)

    def write(self, folder: Path) -> None:
        """Write runs.csv, seeds.csv (full precision) and runs.md."""
        write_text(folder / "runs.csv", self.runs.to_csv(index=False))
        write_text(folder / "seeds.csv", self.seeds.to_csv(index=False))
        write_text(folder / "runs.md", self.markdown())


def _cells(table: pd.DataFrame) -> Iterator[str]:
    for mean, std, bound, identified in table[["mean", "std", "bound_std", "identified"]].to_numpy():
        yield f"{mean_and_std(mean, std)} ({rounded(bound, bound)}){'' if identified else ', not identified'}"


def _seeds_for_people(seeds: pd.DataFrame) -> pd.DataFrame:
    covered = [
        f"{row.covered} of {row.known}" if row.known else "truth not known" for row in seeds.itertuples(index=False)
    ]
    return pd.DataFrame(
        {
            "study": seeds["study"],
            "parameter": [f"{p} [{unit}]" for p, unit in zip(seeds["parameter"], seeds["unit"], strict=True)],
            "runs": seeds["runs"],
            "mean std": [rounded(std, std) for std in seeds["mean_std"]],
            "mean bound": [rounded(bound, bound) for bound in seeds["mean_bound"]],
            "std / bound": ["" if np.isnan(ratio) else f"{ratio:.2f}" for ratio in seeds["std_over_bound"]],
            "90 % interval holds the truth": covered,
            "identified": [f"{row.identified} of {row.runs}" for row in seeds.itertuples(index=False)],
        }
    )


def gather(paths: Iterable[Path]) -> Gathered:
    """One table of all run folders at or below `paths`; raises InputError if there is no finished run among them."""
    folders = list(dict.fromkeys(folder for path in paths for folder in _run_folders(path)))
    finished = {folder: is_finished(folder) for folder in folders}
    runs = [read(folder) for folder in folders if finished[folder]]
    if not runs:
        raise InputError(f"none of these runs has finished: {', '.join(map(str, folders))}")
    base = Path(os.path.commonpath([run.path for run in runs]))
    table = pd.concat([_run_table(run, base if len(runs) > 1 else run.path.parent) for run in runs], ignore_index=True)
    table = table.sort_values(["study", "seed", "run"], kind="stable", ignore_index=True)
    left_out = tuple(folder for folder in folders if not finished[folder])
    return Gathered(runs=table, seeds=_over_seeds(table), left_out=left_out)


def _run_folders(path: Path) -> list[Path]:
    """`path` if it is a run folder, else all run folders below it (a Hydra sweep's, say)."""
    if not path.exists():
        raise InputError(f"{path}: no such folder")
    found = sorted(file.parent.resolve() for file in path.rglob("manifest.json"))
    if not found:
        raise InputError(f"{path}: no run folder here or below (none has a manifest.json)")
    return found


def _run_table(run: FinishedRun, base: Path) -> pd.DataFrame:
    table = read_table(run.file("table.csv"))
    # The seed and the folder say which run of a study it is, not which study.
    study = " ".join(sorted(o for o in run.overrides if not o.lstrip("+~").startswith(("seed=", "hydra."))))
    about = {
        "run": str(run.path.relative_to(base)),
        "study": study or "defaults",
        "estimator": run.choice("estimator"),
        "features": run.choice("features"),
        "seed": run.seed,
        "study_sha256": run.study,
    }
    for column, (name, value) in enumerate(about.items()):
        table.insert(column, name, value)
    return table


def _over_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Per study and parameter: number of runs, mean std, its ratio to the mean bound, runs that hold the truth."""
    known = runs["true"].notna()
    runs = runs.assign(known=known, covered=known & runs["true"].between(runs["q05"], runs["q95"]))
    seeds = (
        runs.groupby(["study_sha256", "study", "parameter", "unit"], sort=False)
        .agg(
            runs=("run", "size"),
            mean_std=("std", "mean"),
            mean_bound=("bound_std", "mean"),
            known=("known", "sum"),
            covered=("covered", "sum"),
            identified=("identified", "sum"),
        )
        .reset_index()
        .drop(columns="study_sha256")
    )
    seeds["std_over_bound"] = (seeds["mean_std"] / seeds["mean_bound"]).where(np.isfinite(seeds["mean_bound"]))
    seeds["coverage90"] = (seeds["covered"] / seeds["known"]).where(seeds["known"] > 0)
    return seeds
