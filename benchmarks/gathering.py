"""What the benchmarks that repeat an experiment over seeds share: run it as a user would, gather its run folders."""

import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import pandas as pd

from vehicle_sbi.files import write_text
from vehicle_sbi.report.run_folder import is_finished, read
from vehicle_sbi.report.tables.text import markdown

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
KEPT = ["parameter", "true", "mean", "std", "q05", "q95", "bound_std", "identified"]


def run(*arguments: str) -> None:
    """scripts/run.py with the given arguments and those of this command line; finished runs are not redone."""
    subprocess.run([sys.executable, str(ROOT / "scripts" / "run.py"), *arguments, *sys.argv[1:]], cwd=ROOT, check=True)


def rows(run: Path, experiment: str, choice: str) -> pd.DataFrame:
    """One run's table with what tells the runs apart: its seed and what it chose for the group `choice`."""
    finished = read(run)
    manifest, table = finished.manifest, pd.read_csv(finished.file("table.csv"))[KEPT]
    table.insert(0, "seed", manifest["seed"])
    table.insert(0, choice, manifest["choices"][choice])
    table.insert(0, "experiment", experiment)
    return table


def summary(table: pd.DataFrame, choice: str) -> pd.DataFrame:
    """Means over seeds, per choice and parameter."""
    table = table.assign(
        ratio=table["std"] / table["bound_std"],
        held=(table["q05"] <= table["true"]) & (table["true"] <= table["q95"]),
        error=(table["mean"] - table["true"]).abs(),
    )
    by = table.groupby([choice, "parameter"], sort=False)
    return by.agg(
        true=("true", lambda true: true.iloc[0] if true.nunique() <= 1 else "drawn"),
        mean=("mean", "mean"),
        error=("error", "mean"),
        std=("std", "mean"),
        bound=("bound_std", "mean"),
        std_over_bound=("ratio", "mean"),
        held_in_90=("held", "sum"),
        identified=("identified", "sum"),
        seeds=("held", "size"),
    ).reset_index()


def gather(experiment: str, runs: Sequence[Path], choice: str) -> str:
    """Write results/EXPERIMENT.csv and .md from the runs that are finished, and return what the latter says."""
    finished = [run for run in sorted(runs) if is_finished(run)]
    manifests = [read(run).manifest for run in finished]
    table = pd.concat([rows(run, experiment, choice) for run in finished])
    table = table.sort_values([choice, "seed"], kind="stable")
    text = markdown(summary(table, choice).map(lambda v: f"{v:.3g}" if isinstance(v, float) else str(v)))
    seconds = pd.Series([sum(manifest["seconds"].values()) for manifest in manifests])
    memory = max(manifest["peak_memory_mb"] for manifest in manifests)
    where = f"{date.today()}, {platform.platform()}, {os.cpu_count()} cores, two runs at a time"
    times = f"seconds a run: median {seconds.median():.0f}, longest {seconds.max():.0f}; peak memory {memory} MB"
    RESULTS.mkdir(exist_ok=True)
    write_text(RESULTS / f"{experiment}.csv", table.to_csv(index=False))
    write_text(RESULTS / f"{experiment}.md", f"{text}\n{where}; {times}.\n")
    return f"{text}\n{times}"
