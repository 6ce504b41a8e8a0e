"""This project beside what an engineer would write instead: the simulator, and the paper's whole study.

    .venv/bin/pip install '.[peers]'
    .venv/bin/python benchmarks/compare_peers.py simulator     (a minute)
    .venv/bin/python benchmarks/compare_peers.py study         (resumes; an hour and a half on one core)

The simulator, on one core: this project's, the same equations in C (-O3 -march=native) and in numpy over all
simulations, and CommonRoad's single-track model by scipy's integrator. The study, one problem of each manoeuvre: this
project's default run, a plain sbi script (SNPE-C with the paper's statistics, as many simulations), numpyro's NUTS on
the model in JAX, and scipy's least_squares with its covariance. Each is compared with long Markov chains
(`exact_posteriors.reference`) as it goes on: after each round, or so many draws. Writes results/peers.md, peers.csv and
the figure peers.png.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np
import pandas as pd
import simulator as bench
import torch
from campaign import processor
from estimators import SUMS, TRUNCATED, distance, problem
from exact_posteriors import DRAWS, reference, together
from peers.in_c import InC
from peers.in_numpy import InNumpy
from scipy.optimize import least_squares

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.features import Handcrafted
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.reweighting import posterior_draws
from vehicle_sbi.inference.rounds import Problem, infer
from vehicle_sbi.inference.simulator import Simulator, succeeded
from vehicle_sbi.report.tables.text import markdown
from vehicle_sbi.rng import Stream, seed_torch
from vehicle_sbi.threads import use_cores

ROOT = Path(__file__).resolve().parent.parent
FOLDER, RESULTS = ROOT / "outputs" / "peers", ROOT / "benchmarks" / "results"
SIMULATED, REPEATS, BY_COMMONROAD = 1000, 7, 2
STUDIES = {"paper_mild": 520, "paper_strong": 525}  # both are development seeds
ROUNDS, A_ROUND = 5, 5000  # of the plain script, the paper's
WARM_UP, KEPT, LOOKS = 300, 250, 4  # of NUTS: draws until it is looked at, and how often that is


# --- the simulator --------------------------------------------------------------------------------------------------


def contenders() -> dict[str, tuple[int, Callable[[], object]]]:
    """How many simulations each makes in a turn, and how; all but CommonRoad's solve the same equations.

    `tests/test_peers.py` checks that to single precision, at steps where both ways to integrate wheels have converged.
    """
    from vehicle_sbi.physics.sensors import GROUPS
    from vehicle_sbi.physics.simulation import Motions, batch_simulator
    from vehicle_sbi.physics.single_track import DRIVES

    rng = np.random.default_rng(0)
    cars, v_0 = bench.records(rng)[:SIMULATED], rng.uniform(10.0, 11.0, SIMULATED)
    initial, y = np.zeros((SIMULATED, 1, 3)), np.empty((SIMULATED, 5, bench.SAMPLES), np.float32)
    initial[:, 0, 0] = v_0
    noise = np.zeros((SIMULATED, 1, 4)), np.zeros((SIMULATED, 1, 2))
    last = (bench.RATE, np.ones(1, np.int64), initial, np.arange(5), np.array([0, 0, 0, 2, 2]), y)
    inputs, in_c, in_numpy = bench.inputs(), InC(FOLDER), InNumpy(cars, v_0)
    u = np.ascontiguousarray(inputs[0][:, :3])

    def ours() -> np.ndarray:
        outcomes = np.zeros(SIMULATED, np.int64)
        batch_simulator("single_track")(
            cars.copy(), Motions.each(SIMULATED), DRIVES["torque"], GROUPS.index("can"), inputs[:, :0, :3], inputs,
            *noise, *last, outcomes,
        )  # fmt: skip
        return y

    found = {
        "this project": (SIMULATED, ours),
        "C, -O3 -march=native": (SIMULATED, lambda: in_c(cars, v_0, u, bench.RATE, 1)),
        "numpy over simulations": (SIMULATED, lambda: in_numpy.simulated(u, bench.RATE)),
    }
    return {**found, "CommonRoad's single-track model": (BY_COMMONROAD, lambda: by_commonroad(v_0[:BY_COMMONROAD], u))}


def by_commonroad(v_0: np.ndarray, u: np.ndarray) -> None:
    """The model of CommonRoad's vehicle 2 by scipy's integrator, as its examples do, with commands held in a sample."""
    from scipy.integrate import odeint
    from vehiclemodels.init_st import init_st
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
    from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

    p, dt = parameters_vehicle2(), 1.0 / bench.RATE
    slopes = np.gradient(u[:, 0], dt)
    for v in v_0:
        x = init_st([0.0, 0.0, u[0, 0], v, 0.0, 0.0, 0.0])
        for k in range(len(u) - 1):
            command = [slopes[k], (u[k, 1] + u[k, 2]) / (p.m * p.R_w)]
            x = odeint(lambda x, t, c: vehicle_dynamics_st(x, c, p), x, [0.0, dt], args=(command,))[-1]


def simulator_page() -> str:
    """Microseconds a simulation, medians over turns in which every contender has its own."""
    runs = contenders()
    took: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(REPEATS):
        for name, (n, run) in runs.items():
            begun = time.perf_counter()
            run()
            took[name].append(1e6 * (time.perf_counter() - begun) / n)
    ours = np.array(took["this project"])
    rows = [
        {
            "simulator": name,
            "microseconds": f"{np.median(one):.0f}",
            "over this project's": f"{np.median(np.array(one) / ours):.2f}",
            "range": f"{min(one):.0f} to {max(one):.0f}",
        }
        for name, one in took.items()
    ]
    about = f"{bench.SAMPLES} samples at {bench.RATE:g} Hz, one core, medians of {REPEATS} turns; {_where()}."
    return f"## One simulation\n\n{about}\n\n{markdown(pd.DataFrame(rows))}\n"


# --- the whole study ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """Draws (n, 6) of a posterior, and the processor's time until then [s], compilation included."""

    after: str
    draws: np.ndarray
    seconds: float


def by_default_run(base: Problem, seed: int, folder: Path) -> Iterator[Answer]:
    """As `run` does it: a fit, rounds, then draws that are re-weighted. Looking takes no time of its own."""
    begun, space = time.process_time(), base.simulator.space
    fit = base.laplace
    done = {0: time.process_time()}  # by the number of rounds
    checkpoints = Checkpoints(folder, changed=lambda: done.setdefault(len(checkpoints.sealed), time.process_time()))
    inference = infer(base, TRUNCATED, checkpoints, quiet=True)
    seed_torch(seed=seed, stream=Stream.POSTERIOR)
    theta, _ = posterior_draws(base, inference.posterior, DRAWS)
    seconds = time.process_time() - begun
    if fit is not None:
        yield Answer("fit", np.random.default_rng(seed).multivariate_normal(*fit.marginal, DRAWS), done[0] - begun)
    for k, posterior in enumerate(inference.posteriors, start=1):
        yield Answer(f"round {k}", draw(posterior, space, DRAWS), done[k] - begun)
    yield Answer("re-weighted", theta, seconds)


def by_plain_sbi(base: Problem, seed: int, folder: Path) -> Iterator[Answer]:
    """SNPE-C of sbi as its tutorial has it, on the paper's statistics of the series."""
    from sbi.inference import NPE_C
    from sbi.utils import BoxUniform

    torch.manual_seed(seed)
    simulator, space = base.simulator, base.simulator.space
    prior = BoxUniform(torch.as_tensor(space.low).float(), torch.as_tensor(space.high).float())

    def statistics(y: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(Handcrafted().statistics(y, simulator.windows.rate)).float()

    begun = time.process_time()
    inference, x_o = NPE_C(prior, density_estimator="nsf"), statistics(base.observed[None])
    proposal: Any = prior
    for k in range(ROUNDS):
        theta = proposal.sample((A_ROUND,))
        y, outcomes = simulator.simulate(theta.double().numpy(), np.arange(A_ROUND), stream=Stream.SIMULATION, round=k)
        good = torch.as_tensor(succeeded(outcomes))
        inference.append_simulations(theta[good], statistics(y)[good], proposal=proposal).train()
        proposal = inference.build_posterior().set_default_x(x_o)
        seconds, looked = time.process_time() - begun, time.process_time()
        yield Answer(f"round {k + 1}", proposal.sample((DRAWS,)).numpy().astype(float), seconds)
        begun += time.process_time() - looked


def by_nuts(base: Problem, seed: int, folder: Path) -> Iterator[Answer]:
    """numpyro's NUTS in the sums of parameters and process noise, parameters then drawn given their sums."""
    from peers.in_jax import Study

    begun, chain = time.process_time(), []
    for found in Study(base.simulator, base.observed).sampled(WARM_UP, KEPT, LOOKS, seed):
        chain.append(_without_process_noise(base.simulator, found["place"], found["sums"], seed + len(chain)))
        seconds, looked = time.process_time() - begun, time.process_time()
        yield Answer(f"{KEPT * len(chain)} draws", np.concatenate(chain), seconds)
        begun += time.process_time() - looked


def _without_process_noise(simulator: Simulator, place: np.ndarray, sums: np.ndarray, seed: int) -> np.ndarray:
    """Parameters (n, 6) given the sums: process noise drawn until each lies in its box."""
    rng, space, mixture = np.random.default_rng(seed), simulator.space, simulator.process.stiffness
    theta = np.empty((len(place), len(space)))
    theta[:, [space.column(name) for name in ("l_f", "h_cog")]] = place
    for name, values in zip(SUMS, sums.T, strict=True):
        i, c = space.column(name), 1e-5 * float(simulator.nominal[name.removeprefix("delta_")])
        left = np.arange(len(values))
        while len(left):
            theta[left, i] = values[left] - c * mixture.sample((len(left),), rng)
            left = left[(theta[left, i] < space.low[i]) | (theta[left, i] > space.high[i])]
    return theta


def by_least_squares(base: Problem, seed: int, folder: Path) -> Iterator[Answer]:
    """The best fit with the initial speed free, and a normal with the covariance of its Jacobian, in the box."""
    simulator, space = base.simulator, base.simulator.space
    start = [name for name in simulator.nuisances if name.startswith("v_x")]
    columns = [simulator.nuisances.index(name) for name in start]

    def residual(q: np.ndarray) -> np.ndarray:
        eta = np.zeros((1, len(simulator.nuisances)))
        eta[0, columns] = q[len(space) :]
        y = simulator.noise_free(q[None, : len(space)], eta)[0]
        return ((base.observed - y) / simulator.noise.std(base.observed)).ravel()

    begun, reach = time.process_time(), np.full(len(start), np.sqrt(3.0))
    bounds = np.concatenate([space.low, -reach]), np.concatenate([space.high, reach])
    middle = np.concatenate([0.5 * (space.low + space.high), np.zeros(len(start))])
    fit = least_squares(residual, middle, bounds=bounds, x_scale=bounds[1] - bounds[0])
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    drawn = np.random.default_rng(seed).multivariate_normal(fit.x, covariance, DRAWS)[:, : len(space)]
    yield Answer("fit", drawn, time.process_time() - begun)


METHODS: dict[str, Callable[[Problem, int, Path], Iterator[Answer]]] = {
    "this project, default run": by_default_run,
    "plain sbi, SNPE-C": by_plain_sbi,
    "numpyro, NUTS on JAX": by_nuts,
    "scipy, least_squares": by_least_squares,
}


def study_rows() -> pd.DataFrame:
    """Every method on every problem, from its file where it has been made."""
    rows = []
    for manoeuvre, seed in STUDIES.items():
        base, truth = problem(manoeuvre, seed)
        exact = together(reference(base, truth, seed, ROOT / "outputs" / "exact_posteriors" / f"{manoeuvre}_{seed}"))
        for name, method in METHODS.items():
            run = f"{manoeuvre}_{name.partition(',')[0].replace(' ', '_')}"
            file = RESULTS / "peers" / f"{run}.json"
            if not file.exists():
                answers = [
                    {"after": answer.after, "seconds": answer.seconds, **distance(answer.draws, exact)}
                    for answer in method(base, seed, FOLDER / run)
                ]
                write_text(file, json.dumps(answers))
            rows += [{"manoeuvre": manoeuvre, "method": name, **answer} for answer in json.loads(file.read_text())]
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def study_page(table: pd.DataFrame) -> str:
    shown = table.map(lambda value: f"{value:.3g}" if isinstance(value, float) else value)
    about = f"Seconds of one core, compilation included; c2st 0.5 is perfect; {_where()}."
    return f"## The paper's study\n\n{about}\n\n{markdown(shown)}\n\n![Distance over time](peers.png)\n"


def figure(table: pd.DataFrame, path: Path) -> None:
    """Distance from the exact posterior over the time of one core, a line for each method."""
    import matplotlib as mpl
    import seaborn as sns

    mpl.use("Agg")
    sns.set_theme(style="whitegrid")
    look = {"hue": "method", "style": "method", "markers": True, "dashes": False, "sort": False, "height": 4}
    grid = sns.relplot(table, x="seconds", y="c2st", col="manoeuvre", kind="line", **look)
    grid.set(xscale="log", ylim=(0.45, 1.02), xlabel="time of one core [s]", ylabel="c2st to the exact posterior")
    grid.refline(y=0.5, linestyle=":")
    grid.savefig(path, dpi=100)


def _where() -> str:
    return f"{date.today()}, {processor()}, {os.cpu_count()} cores"


def main(part: str) -> None:
    torch.set_num_threads(1)
    use_cores(1)
    FOLDER.mkdir(parents=True, exist_ok=True)
    if part == "simulator":
        page = simulator_page()
    else:
        table = study_rows()
        write_text(RESULTS / "peers.csv", table.to_csv(index=False, float_format="%.4g"))
        figure(table, RESULTS / "peers.png")
        page = study_page(table)
    write_text(FOLDER / f"{part}.md", page)
    parts = [FOLDER / f"{name}.md" for name in ("simulator", "study")]
    text = "\n".join(file.read_text() for file in parts if file.exists())
    write_text(RESULTS / "peers.md", f"# Beside what an engineer would write instead\n\n{text}")
    print(page)


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["simulator"]))
