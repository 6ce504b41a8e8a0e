"""The paper's Table II on ten seeds and both amplitudes, each posterior beside its Cramer-Rao bound.

    make bench            about three quarters of an hour on two busy cores; started again, it goes on where it was

Runs `experiment=paper_table` as a user would, then gathers the run folders into results/paper_table.csv (a row per
run and parameter) and results/paper_table.md (means over seeds, with how often the 90 % interval held the truth).
"""

import os
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path

import pandas as pd

from vehicle_sbi.files import write_text
from vehicle_sbi.report.run_folder import is_finished, read
from vehicle_sbi.report.tables import markdown

ROOT = Path(__file__).resolve().parent.parent
RUNS = ROOT / "outputs" / "paper_table"
RESULTS = ROOT / "benchmarks" / "results"
KEPT = ["parameter", "true", "mean", "std", "q05", "q95", "bound_std", "identified"]


def rows(run: Path) -> pd.DataFrame:
    """One run's table with what tells the runs apart."""
    manifest = read(run).manifest
    table = pd.read_csv(run / "table.csv")[KEPT]
    table.insert(0, "seed", manifest["seed"])
    table.insert(0, "manoeuvre", manifest["choices"]["manoeuvre"])
    table.insert(0, "experiment", "paper_table")
    return table


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Means over seeds, per manoeuvre and parameter."""
    table = table.assign(
        ratio=table["std"] / table["bound_std"],
        held=(table["q05"] <= table["true"]) & (table["true"] <= table["q95"]),
    )
    by = table.groupby(["manoeuvre", "parameter"], sort=False)
    return by.agg(
        true=("true", "first"),
        mean=("mean", "mean"),
        std=("std", "mean"),
        bound=("bound_std", "mean"),
        std_over_bound=("ratio", "mean"),
        held_in_90=("held", "sum"),
        identified=("identified", "sum"),
        seeds=("held", "size"),
    ).reset_index()


def gather() -> str:
    """Write results/paper_table.csv and .md from the runs that are finished, and return what the latter says."""
    finished = [run for run in sorted(RUNS.glob("paper_*")) if is_finished(run)]
    manifests = [read(run).manifest for run in finished]
    table = pd.concat([rows(run) for run in finished]).sort_values(["manoeuvre", "seed"], kind="stable")
    seconds = pd.Series([sum(manifest["seconds"].values()) for manifest in manifests])
    memory = max(manifest["peak_memory_mb"] for manifest in manifests)
    text = markdown(summary(table).map(lambda v: f"{v:.3g}" if isinstance(v, float) else str(v)))
    where = f"{date.today()}, {platform.platform()}, {os.cpu_count()} cores, two runs at a time"
    times = f"seconds a run: median {seconds.median():.0f}, longest {seconds.max():.0f}; peak memory {memory} MB"
    RESULTS.mkdir(exist_ok=True)
    write_text(RESULTS / "paper_table.csv", table.to_csv(index=False))
    write_text(RESULTS / "paper_table.md", f"{text}\n{where}; {times}.\n")
    return f"{text}\n{times}"


def main() -> None:
    command = [sys.executable, str(ROOT / "scripts" / "run.py"), "experiment=paper_table", *sys.argv[1:]]
    subprocess.run(command, cwd=ROOT, check=True)
    print(gather())


if __name__ == "__main__":
    main()
