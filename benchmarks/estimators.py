"""Estimators, features and schemes of rounds by their distance to a known posterior, that of the paper's study.

    .venv/bin/python benchmarks/estimators.py paper_strong        (resumes; three quarters of an hour on one core)

The exact posterior comes from the simulator's own likelihood by MCMC. Process noise on a stiffness adds to its
parameter, so the likelihood needs only their sum: walkers move in (l_f, h_cog, four sums, initial speed), whose prior
is the box smeared by the mixture, and each parameter is then drawn given its sum. Distances: c2st (0.5 is perfect), the
ratio of standard deviations per parameter, and the largest shift of a mean in exact standard deviations.
"""

import os
import platform
import sys
import time
from dataclasses import replace
from datetime import date
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import emcee
import numpy as np
import pandas as pd
import torch
import yaml
from sbi.utils.metrics import c2st
from scipy.stats import norm

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.data.manoeuvre import Manoeuvre, Synthetic
from vehicle_sbi.data.noise import ProcessNoise, ProportionalNoise
from vehicle_sbi.inference.estimator import (
    DensityEstimator,
    MaskedAutoregressiveFlow,
    MixtureDensityNetwork,
    NeuralSplineFlow,
)
from vehicle_sbi.inference.features import Embedding, Features, Handcrafted, Score
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.rounds import Amortised, Corrected, Problem, Scheme, Truncated, infer
from vehicle_sbi.inference.simulator import Draws, Simulator
from vehicle_sbi.inference.study import Study
from vehicle_sbi.inference.training import Training
from vehicle_sbi.physics.vehicle import read
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.threads import use_cores

ROOT = Path(__file__).resolve().parent.parent
SUMS = ("delta_C_kappa_f", "delta_C_kappa_r", "delta_C_alpha_f", "delta_C_alpha_r")
WALKERS, STEPS, WARM_UP, THIN = 64, 2000, 1000, 5
# DESnookerMove of emcee 3.1.6 is left out: its draws are 7 % too narrow (github.com/dfm/emcee/pull/531).
MOVES = [(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)]
STUCK = 50.0  # of log density below the median walker's, of which seven dimensions take a few
COMPARED = 2000
SEED = 100  # of the drawn truth; the scored benchmark has others


def conf(path: str) -> dict:
    """A configuration file's keys, without what Hydra builds from them."""
    content = yaml.safe_load((ROOT / "conf" / f"{path}.yaml").read_text())
    return {key: value for key, value in content.items() if key != "_target_"}


TRUNCATED = Truncated(**conf("rounds/truncated"))
CASES: dict[str, tuple[DensityEstimator, Features, Scheme]] = {
    "nsf, score, truncated": (NeuralSplineFlow(), Score(), TRUNCATED),
    "mdn, score, truncated": (MixtureDensityNetwork(), Score(), TRUNCATED),
    "zuko_maf, score, truncated": (MaskedAutoregressiveFlow(model="zuko_maf"), Score(), TRUNCATED),
    "nsf, handcrafted, truncated": (NeuralSplineFlow(), Handcrafted(), TRUNCATED),
    "nsf, score, amortised": (NeuralSplineFlow(), Score(), Amortised()),
    "mdn, embedding, truncated": (MixtureDensityNetwork(), Embedding(), TRUNCATED),
    "nsf, score, corrected": (NeuralSplineFlow(), Score(), Corrected()),
}


def problem(manoeuvre: str, seed: int = SEED) -> tuple[Problem, np.ndarray]:
    """The paper's study with a truth drawn from its prior, and that truth."""
    noise = conf("noise/paper")
    process = {key: value for key, value in noise.pop("process").items() if key != "_target_"}
    driven = conf(f"manoeuvre/{manoeuvre}")
    prepared = Study(
        vehicle=read(str(ROOT / "conf" / "vehicle" / "paper.yaml")),
        model="single_track",
        drive="torque",
        prior=conf("prior/default"),
        effects=(),
        recording=Synthetic(manoeuvre=Manoeuvre(**{**driven, "channels": tuple(driven["channels"])})),
        window_s=5.0,
        warmup_s=0.5,
        noise=ProportionalNoise(**noise, process=ProcessNoise(**process)),
        features=Score(),
        estimator=NeuralSplineFlow(),
        training=Training(),
        truth=None,
        seed=seed,
    ).prepare()
    assert prepared.truth is not None
    return prepared.problem, prepared.truth


def exact(simulator: Simulator, observed: np.ndarray, truth: np.ndarray, seed: int = SEED) -> np.ndarray:
    """Draws (steps, walkers, 6) of the exact posterior, by an ensemble of walkers.

    One that the warm-up leaves where the posterior has nothing stays there: it counts for no draw (Hou et al.,
    Astrophys. J. 745, 198, 2012).
    """
    space, mixture = simulator.space, simulator.process.stiffness
    columns = [space.column(name) for name in SUMS]
    nominal = np.array([simulator.nominal[name.removeprefix("delta_")] for name in SUMS]) / 1e5
    middle, half = simulator.windows.x0[0, 0], simulator.windows.x0_std[0] * np.sqrt(3.0)

    def log_prior(q: np.ndarray) -> np.ndarray:
        free = [i for i in range(len(space)) if i not in columns]
        allowed = ((q[:, free] >= space.low[free]) & (q[:, free] <= space.high[free])).all(axis=1)
        allowed &= np.abs(q[:, -1] - middle) <= half
        smeared = np.zeros(len(q))
        for i, c in zip(columns, nominal, strict=True):
            mean, std = c * mixture.means, c * mixture.stds
            above, below = (q[:, [i]] - edge - mean for edge in (space.low[i], space.high[i]))
            smeared += np.log(np.maximum((norm.cdf(above / std) - norm.cdf(below / std)).mean(axis=1), 1e-300))
        return np.where(allowed, smeared, -np.inf)

    def log_posterior(q: np.ndarray) -> np.ndarray:
        density = log_prior(q)
        rows = np.flatnonzero(density > -200.0)
        n = len(rows)
        initial = np.zeros((n, 1, 3))
        initial[:, 0, 0] = q[rows, -1]
        y, _ = simulator.run(q[rows, :-1], Draws(np.zeros((n, 1, 4)), np.zeros((n, 1, 2)), initial, np.zeros((n, 0))))
        std = simulator.noise.std(y)
        likelihood = (-0.5 * ((observed - y) / std) ** 2 - np.log(std)).sum(axis=(1, 2))
        density[rows] += np.where(np.isfinite(likelihood), likelihood, -np.inf)
        return density

    rng = np.random.default_rng(seed)
    about = np.append(truth, middle)
    start = about + 0.02 * np.append(space.high - space.low, half) * rng.standard_normal((WALKERS, len(about)))
    start[:, :-1] = np.clip(start[:, :-1], space.low + 1e-3, space.high - 1e-3)
    sampler = emcee.EnsembleSampler(WALKERS, len(about), log_posterior, vectorize=True, moves=MOVES)
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(start, STEPS)
    density = np.median(np.asarray(sampler.get_log_prob(discard=WARM_UP, thin=THIN)), axis=0)
    chain = np.asarray(sampler.get_chain(discard=WARM_UP, thin=THIN))[:, density > np.median(density) - STUCK]
    q = chain.reshape(-1, chain.shape[-1])
    theta = q[:, :-1].copy()
    for i, c in zip(columns, nominal, strict=True):
        missing = np.arange(len(q))
        while len(missing):
            theta[missing, i] = q[missing, i] - c * mixture.sample((len(missing),), rng)
            missing = missing[(theta[missing, i] < space.low[i]) | (theta[missing, i] > space.high[i])]
    return theta.reshape(*chain.shape[:2], -1)


def distance(samples: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """c2st on standardised draws, as many of each, and means and standard deviations against the reference's."""
    mean, std, n = reference.mean(axis=0), reference.std(axis=0), min(COMPARED, len(samples))
    rows = np.random.default_rng(0).permutation(len(reference))[:n]
    ours, theirs = (torch.as_tensor((x - mean) / std, dtype=torch.float32) for x in (samples[:n], reference[rows]))
    ratio = samples.std(axis=0) / std
    return {
        "c2st": float(c2st(ours, theirs)),
        "std ratio, geometric mean": float(np.exp(np.log(ratio).mean())),
        "widest": float(ratio.max()),
        "narrowest": float(ratio.min()),
        "largest shift": float(np.abs((samples.mean(axis=0) - mean) / std).max()),
    }


def main(manoeuvre: str) -> None:
    torch.set_num_threads(1)
    use_cores(1)
    base, truth = problem(manoeuvre)
    folder = ROOT / "outputs" / "estimators" / manoeuvre
    folder.mkdir(parents=True, exist_ok=True)
    stored = folder / "exact.npy"
    if not stored.exists():
        np.save(stored, exact(base.simulator, base.observed, truth))
    reference, rows = np.load(stored).reshape(-1, len(truth)), []
    for name, (estimator, features, scheme) in CASES.items():
        case = folder / name.replace(", ", "+")
        begin = time.perf_counter()
        inference = infer(
            replace(base, estimator=estimator, features=features), scheme, Checkpoints.as_found(case), quiet=True
        )
        seconds = time.perf_counter() - begin
        timed = case / "seconds.txt"
        if not timed.exists():
            timed.write_text(f"{seconds:.0f}")
        torch.manual_seed(SEED)
        samples = draw(inference.posterior, base.simulator.space, 5000)
        rows.append({"case": name, **distance(samples, reference), "seconds": float(timed.read_text())})
        table = pd.DataFrame(rows)
        table.to_csv(ROOT / "benchmarks" / "results" / f"estimators_{manoeuvre}.csv", index=False)
        shown = markdown(table.map(lambda v: f"{v:.3g}" if isinstance(v, float) else v))
        where = f"{manoeuvre}; {date.today()}, {platform.platform()}, one core of {os.cpu_count()}"
        (ROOT / "benchmarks" / "results" / f"estimators_{manoeuvre}.md").write_text(f"{shown}\n\n{where}.\n")
        print(rows[-1], flush=True)


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["paper_strong"]))
