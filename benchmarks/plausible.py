"""Do intervals hold although physics is missing: base parameters with and without `effects=plausible`.

    .venv/bin/python benchmarks/plausible.py [DRIVES]       ten minutes on one core for six drives

Each drive is the paper's mild manoeuvre of the paper's car with stated sensor noise, its truth drawn from the prior and
its effects from `conf/effect_prior/passenger_car.yaml`. All ways of inferring it see the same series. How they differ:

    base parameters alone       as if nothing were missing
    plausible effects           free in every simulation
    the same, hardened alone    with as many features as base parameters (features.nuisances=false)
"""

import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import torch
from campaign import processor
from estimators import ROOT, conf
from jaxtyping import Float
from measures import Measure, mean, median, rms, shown

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.data.manoeuvre import Manoeuvre, Synthetic
from vehicle_sbi.data.noise import ConstantNoise, ProcessNoise
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.estimator import NeuralSplineFlow
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.information import bound_std, fisher
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.rounds import Problem, Truncated, infer
from vehicle_sbi.inference.study import Prepared, Study
from vehicle_sbi.inference.training import Training
from vehicle_sbi.physics.vehicle import read
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.rng import Stream, seed_torch
from vehicle_sbi.threads import use_cores

DRIVES, FIRST_SEED, SAMPLES = 6, 7000, 4000
ROUNDS = Truncated(rounds=2, simulations=2000, last=3)
ALONE, FREE, HARDENED = "base parameters alone", "plausible effects", "the same, hardened alone"


@dataclass(frozen=True, kw_only=True)
class Inferred:
    """One drive inferred in one way; each array has an entry per base parameter."""

    true: Float[np.ndarray, " d"]
    mean: Float[np.ndarray, " d"]
    std: Float[np.ndarray, " d"]
    low: Float[np.ndarray, " d"]  # of the 90 % interval
    high: Float[np.ndarray, " d"]
    prior_std: Float[np.ndarray, " d"]
    bound: Float[np.ndarray, " d"]  # of the simulator that was used, at the truth
    alone: Float[np.ndarray, " d"]  # of the base parameters alone
    width: Float[np.ndarray, " d"]  # of the interval, over that of the base parameters alone
    seconds: float


MEASURES: Sequence[Measure[Inferred]] = (
    Measure("90 % intervals that hold the truth", lambda x: (x.low <= x.true) & (x.true <= x.high), mean, "0.90"),
    Measure("truth off the mean, in posterior std, rms", lambda x: (x.mean - x.true) / x.std, rms, "1"),
    Measure("truth off the mean, in prior std, rms", lambda x: (x.mean - x.true) / x.prior_std, rms, "small"),
    Measure("posterior std over prior std, median", lambda x: x.std / x.prior_std, median, "small"),
    Measure("posterior std over bound, median", lambda x: x.std / x.bound, median, "1"),
    Measure("bound over bound without effects, median", lambda x: x.bound / x.alone, median),
    Measure("width over that of base parameters alone, median", lambda x: x.width, median),
    Measure("seconds, median", lambda x: np.array([x.seconds]), median, "small"),
)


def prepared(seed: int) -> Prepared:
    """A drive whose car has effects drawn from the stated prior."""
    driven, effects = conf("manoeuvre/paper_mild"), conf("effect_prior/passenger_car")
    return Study(
        vehicle=read(str(ROOT / "conf" / "vehicle" / "paper.yaml")),
        model="single_track",
        drive="torque",
        prior=conf("prior/default"),
        effects="plausible",
        effect_prior=EffectPrior(table=effects["table"]),
        recording=Synthetic(manoeuvre=Manoeuvre(**{**driven, "rate": 100.0, "channels": tuple(driven["channels"])})),
        window_s=5.0,
        warmup_s=0.5,
        noise=ConstantNoise(std=conf("noise/constant")["std"], process=ProcessNoise(stiffness=0.0)),
        features=Score(),
        estimator=NeuralSplineFlow(),
        training=Training(**conf("training/default")),
        truth=None,
        seed=seed,
    ).prepare()


def inferred(problem: Problem, true: Float[np.ndarray, " d"], than: "Inferred | None") -> Inferred:
    """A drive's base parameters and how long they took; widths over those of `than`."""
    simulator, begin = problem.simulator, time.perf_counter()
    with TemporaryDirectory() as folder:
        posterior = infer(problem, ROUNDS, Checkpoints(Path(folder)), quiet=True).posterior
    seconds = time.perf_counter() - begin
    seed_torch(seed=simulator.seed, stream=Stream.POSTERIOR)
    samples, spread = draw(posterior, simulator.space, SAMPLES), simulator.space.prior_std
    low, high = np.quantile(samples, (0.05, 0.95), axis=0)
    return Inferred(
        true=true,
        mean=samples.mean(axis=0),
        std=samples.std(axis=0),
        low=low,
        high=high,
        prior_std=spread,
        bound=bound_std(fisher(simulator, true), spread),
        alone=bound_std(fisher(simulator.alone, true), spread),
        width=(high - low) / (high - low if than is None else than.high - than.low),
        seconds=seconds,
    )


def ways(drive: Prepared) -> dict[str, Inferred]:
    """A drive inferred in every way."""
    problem, true = drive.problem, drive.truth
    assert true is not None
    alone = inferred(replace(problem, simulator=problem.simulator.alone), true, None)
    hardened = replace(problem, features=Score(nuisances=False))
    return {ALONE: alone, FREE: inferred(problem, true, alone), HARDENED: inferred(hardened, true, alone)}


def main(drives: int) -> None:
    torch.set_num_threads(1)
    use_cores(1)
    found: list[dict[str, Inferred]] = []
    cars = [prepared(FIRST_SEED + i) for i in range(drives)]
    free = cars[0].problem.simulator.plausible
    for i, drive in enumerate(cars):
        found.append(ways(drive))
        held = {way: int(((x.low <= x.true) & (x.true <= x.high)).sum()) for way, x in found[-1].items()}
        print(f"drive {i}: intervals that hold the truth {held}", flush=True)
    rows = [
        {"": row.label, **{way: shown(row, [one[way] for one in found]) for way in found[0]}, "good": row.good}
        for row in MEASURES
    ]
    text = (
        f"{drives} drives from seed {FIRST_SEED}, each with effects drawn from the prior of {len(free)} parameters of "
        f"{len(free.effects)} effects; {ROUNDS.rounds} rounds of {ROUNDS.simulations} simulations, {ROUNDS.last} times "
        "as many in the last. In brackets a 90 % interval by a bootstrap over drives, and the number of values.\n\n"
        f"{markdown(pd.DataFrame(rows))}\n"
        f"{date.today()}, {processor()}, one core of {os.cpu_count()}, {platform.platform()}.\n"
    )
    (ROOT / "benchmarks" / "results" / "plausible.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else DRIVES)
