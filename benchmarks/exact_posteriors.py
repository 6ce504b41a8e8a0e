"""The default run against exact posteriors: ten problems of the paper's study, five of each manoeuvre.

    .venv/bin/python benchmarks/exact_posteriors.py        (resumes; two hours and a half on one core)

Each problem has a truth drawn from the prior, and a seed of its own that is listed in seeds.yaml. The reference is MCMC
with the simulator's own likelihood (`estimators.exact`) by two ensembles of walkers: R-hat compares them, the effective
sample size is by the autocorrelation of each parameter. The network's draws and those that are re-weighted come from
the same rounds. Goals: c2st below 0.60, means within 0.25 standard deviations, widths within 15 %.
"""

import os
import sys
import time
from datetime import date
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import emcee
import numpy as np
import pandas as pd
import torch
from campaign import processor
from estimators import ROOT, TRUNCATED, distance, exact, problem

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.reweighting import posterior_draws
from vehicle_sbi.inference.rounds import Problem, infer
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.rng import Stream, seed_torch
from vehicle_sbi.threads import use_cores

SEEDS = {"paper_mild": range(530, 535), "paper_strong": range(535, 540)}
WALKERS, DRAWS = 64, 5000
FOLDER = ROOT / "outputs" / "exact_posteriors"
RESULTS = ROOT / "benchmarks" / "results" / "exact_posteriors"


def reference(base: Problem, truth: np.ndarray, seed: int, folder: Path) -> list[np.ndarray]:
    """Draws of two ensembles."""
    chains = []
    for k in range(2):
        file = folder / f"exact_{k}.npy"
        if not file.exists():
            folder.mkdir(parents=True, exist_ok=True)
            np.save(file, exact(base.simulator, base.observed, truth, seed + 1000 * (k + 1)))
        chains.append(np.load(file))
    return chains


def convergence(chains: list[np.ndarray]) -> tuple[float, float]:
    """The largest R-hat of a parameter, and the smallest effective sample size of both ensembles together."""
    each = np.stack(chains)
    within, between = each.var(axis=1, ddof=1).mean(axis=0), each.mean(axis=1).var(axis=0, ddof=1)
    effective = [
        chain.shape[0] / emcee.autocorr.integrated_time(chain.reshape(-1, WALKERS, chain.shape[1]), quiet=True)
        for chain in chains
    ]
    return float(np.sqrt(1.0 + between / within).max()), float(np.sum(effective, axis=0).min())


def row(manoeuvre: str, seed: int) -> list[dict]:
    """What the network's draws and the re-weighted ones are away from the exact posterior."""
    base, truth = problem(manoeuvre, seed)
    folder = FOLDER / f"{manoeuvre}_{seed}"
    chains = reference(base, truth, seed, folder)
    rhat, effective = convergence(chains)
    begin = time.perf_counter()
    posterior = infer(base, TRUNCATED, Checkpoints.as_found(folder / "run"), quiet=True).posterior
    seconds = time.perf_counter() - begin
    rows = []
    for name in ("network", "re-weighted"):
        seed_torch(seed=seed, stream=Stream.POSTERIOR)
        begin = time.perf_counter()
        if name == "network":
            theta, said = draw(posterior, base.simulator.space, DRAWS), ""
        else:
            theta, said = posterior_draws(base, posterior, DRAWS)
        found = distance(theta, np.concatenate(chains))
        about = {"manoeuvre": manoeuvre, "seed": seed, "R-hat": rhat, "effective": effective, "draws": name}
        rows.append({**about, **found, "seconds": seconds + time.perf_counter() - begin, "said": said})
    return rows


def page(table: pd.DataFrame) -> str:
    """Every problem, and how many reach each goal."""
    goals = {
        "c2st below 0.60": table["c2st"] < 0.60,
        "means within 0.25": table["largest shift"] < 0.25,
        "widths within 15 %": (table["widest"] < 1.15) & (table["narrowest"] > 0.85),
    }
    counts = pd.DataFrame(goals).groupby(table["draws"], sort=False).sum().reset_index()
    median = table.groupby(["manoeuvre", "draws"], sort=False)[
        ["c2st", "largest shift", "widest", "narrowest"]
    ].median()
    shown = table.drop(columns="said").round(3)
    about = f"{date.today()}, {processor()}. Of {len(table) // 2} problems:"
    return "\n\n".join([about, markdown(counts), "Medians:", markdown(median.round(3).reset_index()), markdown(shown)])


def main() -> None:
    torch.set_num_threads(1)
    use_cores(1)
    rows: list[dict] = []
    for manoeuvre, seeds in SEEDS.items():
        for seed in seeds:
            stored = FOLDER / f"{manoeuvre}_{seed}" / "rows.csv"
            if not stored.exists():
                found = pd.DataFrame(row(manoeuvre, seed))
                write_text(stored, found.to_csv(index=False))
            rows += pd.read_csv(stored, keep_default_na=False).to_dict("records")
            table = pd.DataFrame(rows)
            write_text(RESULTS.with_suffix(".csv"), table.to_csv(index=False))
            write_text(RESULTS.with_suffix(".md"), page(table) + "\n")
            print(rows[-2:], flush=True)


if __name__ == "__main__":
    sys.exit(main())
