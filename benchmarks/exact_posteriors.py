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
from collections.abc import Callable
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
from vehicle_sbi.inference.information import bound_std, fisher
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.reweighting import posterior_draws
from vehicle_sbi.inference.rounds import Problem, infer
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.rng import Stream, seed_torch
from vehicle_sbi.threads import use_cores

SEEDS = {"paper_mild": range(530, 535), "paper_strong": range(535, 540)}
DRAWS = 5000
FOLDER = ROOT / "outputs" / "exact_posteriors"
RESULTS = ROOT / "benchmarks" / "results" / "exact_posteriors"


def reference(base: Problem, truth: np.ndarray, seed: int, folder: Path) -> list[np.ndarray]:
    """Draws (steps, walkers, d) of two ensembles."""
    chains = []
    for k in range(2):
        file = folder / f"exact_{k}.npy"
        if not file.exists():
            folder.mkdir(parents=True, exist_ok=True)
            np.save(file, exact(base.simulator, base.observed, truth, seed + 1000 * (k + 1)))
        chains.append(np.load(file))
    return chains


def together(chains: list[np.ndarray]) -> np.ndarray:
    """All draws (n, d) of all ensembles."""
    return np.concatenate([chain.reshape(-1, chain.shape[-1]) for chain in chains])


def convergence(chains: list[np.ndarray]) -> tuple[float, float]:
    """The largest R-hat of a parameter, and the smallest effective sample size of both ensembles together."""
    flat = [chain.reshape(-1, chain.shape[-1]) for chain in chains]
    within = np.mean([one.var(axis=0, ddof=1) for one in flat], axis=0)
    between = np.var([one.mean(axis=0) for one in flat], axis=0, ddof=1)
    effective = [
        len(one) / emcee.autocorr.integrated_time(chain, quiet=True) for one, chain in zip(flat, chains, strict=True)
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
        found = distance(theta, together(chains))
        about = {"manoeuvre": manoeuvre, "seed": seed, "R-hat": rhat, "effective": effective, "draws": name}
        rows.append({**about, **found, "seconds": seconds + time.perf_counter() - begin, "said": said})
    return rows


def over_bound(manoeuvre: str, seed: int) -> dict:
    """Exact standard deviations over the Cramer-Rao bound at the truth; NaN where that is wider than the prior's."""
    base, truth = problem(manoeuvre, seed)
    space = base.simulator.space
    bound = bound_std(fisher(base.simulator, truth), space.prior_std)
    exact_std = together(reference(base, truth, seed, FOLDER / f"{manoeuvre}_{seed}")).std(axis=0)
    ratio = np.where(bound < space.prior_std, exact_std / bound, np.nan)
    return {"manoeuvre": manoeuvre, "seed": seed, **dict(zip(space.names, ratio.tolist(), strict=True))}


def page(table: pd.DataFrame, bounds: pd.DataFrame) -> str:
    """Every problem, how many reach each goal, and exact widths beside the bound."""
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
    beside = "Exact standard deviations over the Cramér-Rao bound at the truth, where that is below the prior's:"
    ratios = markdown(bounds.round(2).astype(object).fillna(""))
    parts = [markdown(median.round(3).reset_index()), markdown(shown), beside, ratios]
    return "\n\n".join([about, markdown(counts), "Medians:", *parts])


def main() -> None:
    torch.set_num_threads(1)
    use_cores(1)
    rows, bounds = list[dict](), list[dict]()
    for manoeuvre, seeds in SEEDS.items():
        for seed in seeds:
            folder = FOLDER / f"{manoeuvre}_{seed}"
            rows += stored(folder / "rows.csv", lambda m=manoeuvre, s=seed: row(m, s))
            bounds += stored(folder / "bounds.csv", lambda m=manoeuvre, s=seed: [over_bound(m, s)])
            table = pd.DataFrame(rows)
            write_text(RESULTS.with_suffix(".csv"), table.to_csv(index=False))
            write_text(RESULTS.with_suffix(".md"), page(table, pd.DataFrame(bounds)) + "\n")
            print(rows[-2:], flush=True)


def stored(file: Path, make: Callable[[], list[dict]]) -> list[dict]:
    """Rows of a file, which is made if it is not there."""
    if not file.exists():
        write_text(file, pd.DataFrame(make()).to_csv(index=False))
    return pd.read_csv(file).replace({"said": {np.nan: ""}}).to_dict("records")


if __name__ == "__main__":
    sys.exit(main())
