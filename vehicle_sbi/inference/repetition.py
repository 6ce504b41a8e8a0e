"""A synthetic study over and over, each time with another truth from its prior: what its calibration is counted on.

One network of an amortised study answers for every recording. The posterior of other schemes is good for one recording
alone, so they are repeated from the first simulation to the re-weighted draws, in processes of one thread each. Truths
with which the vehicle spins out have no recording; they are left out, as failed simulations are of the training.
"""

import json
import logging
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.data.manoeuvre import Synthetic
from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.calibration import REPEATED, Calibration, by_sbi, ranks
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.reweighting import posterior_draws
from vehicle_sbi.inference.rounds import (
    Amortised,
    Problem,
    Round,
    Scheme,
    fit_features,
    infer,
    posterior_of,
    simulate_features,
)
from vehicle_sbi.inference.study import Prepared, Study
from vehicle_sbi.rng import Stream, generator, seed_torch
from vehicle_sbi.threads import use_cores

MANY, SEVERAL = 200, 100  # recordings of an amortised study, and of one that is repeated whole
FEWEST = 20  # recordings from which sbi's tests can be made
MOST_TRUTHS = 20  # that are drawn for one recording, until the vehicle does not spin out
CALIBRATION = 1  # the round of an amortised study whose simulations no network has seen


@dataclass(frozen=True, kw_only=True)
class Repetitions:
    """How often a study is repeated (None: as often as its scheme affords), with how many draws of each posterior.

    `reweight` is the study's own; `workers` processes repeat whole studies side by side.
    """

    repetitions: int | None = None
    samples: int = 5000
    reweight: bool = True
    workers: int = 1

    def __post_init__(self) -> None:
        for name in ("repetitions", "samples", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"{name} = {value}; it must be at least 1")

    def of(self, scheme: Scheme) -> int:
        """How many recordings of a scheme; raises InputError for too few."""
        amortised = isinstance(scheme, Amortised)
        n = self.repetitions or (MANY if amortised else SEVERAL)
        if amortised and n < FEWEST:
            raise InputError(f"repetitions = {n}; the tests of an amortised posterior need at least {FEWEST}")
        return n


@dataclass(frozen=True, kw_only=True)
class Repetition:
    """One whole study: its truth, where the truth ranks among the draws, and how it went; each list has a number for
    each parameter."""

    seed: int
    truth: list[float]
    rank: list[int]
    mean: list[float]
    std: list[float]
    reweighted: str | None
    failed: str | None
    seconds: float


def checked(study: Study, scheme: Scheme) -> Prepared:
    """The study as it is observed, or as it is first repeated; raises InputError where no truth can be drawn."""
    if not isinstance(study.recording, Synthetic):
        raise InputError("recording: a recording has no truth to repeat; calibrate a synthetic study (its manoeuvre)")
    if isinstance(scheme, Amortised):
        return study.prepare()
    if study.truth is not None:
        raise InputError("truth: each repetition draws its own from the prior; leave truth=null")
    return repeated(study, 0)


def calibrated(
    study: Study, scheme: Scheme, prepared: Prepared, asked: Repetitions, checkpoints: Checkpoints
) -> Calibration:
    """Repeat a study as its scheme allows, from where an earlier start has come to."""
    if isinstance(scheme, Amortised):
        return by_one_network(prepared.problem, scheme, asked, checkpoints)
    return by_whole_studies(study, scheme, prepared.problem.simulator.space.names, asked, checkpoints)


def by_one_network(problem: Problem, scheme: Amortised, asked: Repetitions, checkpoints: Checkpoints) -> Calibration:
    """An amortised network at recordings that it has not seen."""
    inference = infer(problem, scheme, checkpoints)
    last, space = inference.rounds[-1], problem.simulator.space
    n = asked.of(scheme)
    theta, x = unseen(problem, last, n)
    seed_torch(seed=problem.simulator.seed, stream=Stream.POSTERIOR)
    each = tqdm(x.split(1), desc="posteriors", unit="recording", disable=None, leave=False)
    draws = [draw(posterior_of(problem, replace(last, x_o=one)), space, asked.samples) for one in each]
    own = draw(inference.posterior, space, asked.samples)
    found = by_sbi(
        space.names,
        theta,
        x,
        torch.as_tensor(np.stack(draws, axis=1), dtype=torch.float32),
        local=(last.x_o, torch.as_tensor(own, dtype=torch.float32)),
        seed=problem.simulator.seed,
    )
    notes = [f"{n - len(theta)} of {n} truths made the vehicle spin out and are left out."] * (len(theta) < n)
    notes += ["Draws are the network's; `run` re-weights them where it can."] * asked.reweight
    return replace(found, notes=tuple(notes))


def unseen(problem: Problem, trained: Round, n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """n truths from the prior (n, d) and the features of a recording of each (n, …), those that fail left out."""
    simulator, space = problem.simulator, problem.simulator.space
    theta = generator(seed=simulator.seed, stream=Stream.TRUTH, round=CALIBRATION).uniform(
        space.low, space.high, (n, len(space))
    )
    summary = fit_features(problem, [trained.theta.numpy()], 0, trained.fiducial.numpy())  # as it was in training
    with tqdm(total=n, desc="recordings", disable=None, leave=False) as bar:
        x, good = simulate_features(simulator, theta, np.arange(n), round=CALIBRATION, summary=summary, bar=bar)
    if good.sum() < FEWEST:
        raise InputError(f"{n - good.sum()} of {n} truths make the vehicle spin out; narrow the prior")
    return torch.as_tensor(theta[good], dtype=torch.float32), torch.as_tensor(x[good])


def by_whole_studies(
    study: Study, scheme: Scheme, names: tuple[str, ...], asked: Repetitions, checkpoints: Checkpoints
) -> Calibration:
    """Every repetition that is not on disk yet is made; one that is damaged is made anew."""
    n, files = asked.of(scheme), checkpoints.folder / REPEATED
    missing = [i for i in range(n) if not checkpoints.kept(file_of(i))]
    work = partial(repeat, study, scheme, samples=asked.samples, reweight=asked.reweight, folder=files)
    with tqdm(total=n, initial=n - len(missing), desc="studies", unit="study", disable=None) as bar:
        for i, done in _each(work, missing, asked.workers):
            write_text(checkpoints.folder / file_of(i), json.dumps(asdict(done), indent=1) + "\n")
            checkpoints.seal(
                file_of(i)
            )  # not `write`, which forgets later files: repetitions do not rest on each other
            bar.update()
    return gathered(names, [load(checkpoints.folder / file_of(i)) for i in range(n)], asked.samples)


def file_of(i: int) -> str:
    """Where repetition i is kept in a run's folder."""
    return f"{REPEATED}/{i:04d}.json"


def load(path: Path) -> Repetition:
    return Repetition(**json.loads(path.read_bytes()))


def gathered(names: tuple[str, ...], done: list[Repetition], samples: int) -> Calibration:
    """Repetitions as one calibration; raises InputError where all have failed."""
    good = [one for one in done if one.failed is None]
    if not good:
        raise InputError(f"every repetition fails, the first by: {done[0].failed}")
    seconds = np.array([one.seconds for one in good])
    notes = [f"Seconds for each study: median {np.median(seconds):.0f}, longest {seconds.max():.0f}."]
    ways = Counter(one.reweighted.partition(":")[0] for one in good if one.reweighted)
    notes += [f"{count} of {len(good)} studies: {way}." for way, count in ways.most_common()]
    if len(good) < len(done):
        reason = next(one.failed for one in done if one.failed)
        notes.append(f"{len(done) - len(good)} of {len(done)} studies have no posterior and do not count: {reason}")
    return Calibration(names=names, ranks=np.array([one.rank for one in good]), samples=samples, notes=tuple(notes))


def repeat(study: Study, scheme: Scheme, index: int, *, samples: int, reweight: bool, folder: Path) -> Repetition:
    """A whole study with a truth and a seed of its own: a pure function of the study's seed and the index.

    Its rounds lie below `folder` until it is done.
    """
    begin, rounds = time.perf_counter(), folder / f"{index:04d}"
    prepared = repeated(study, index)
    problem, truth, failed = prepared.problem, prepared.point, None
    drawn, said = np.zeros((0, len(truth))), None
    shutil.rmtree(rounds, ignore_errors=True)  # of a start that was interrupted
    try:
        drawn, said = _draws(problem, scheme, Checkpoints(rounds), samples, reweight)
    except InputError as error:  # the rounds say that they can find no posterior
        failed = str(error)
    finally:
        shutil.rmtree(rounds, ignore_errors=True)
    some = failed is None
    return Repetition(
        seed=problem.simulator.seed,
        truth=truth.tolist(),
        rank=ranks(truth, drawn).tolist() if some else [],
        mean=drawn.mean(axis=0).tolist() if some else [],
        std=drawn.std(axis=0, ddof=1).tolist() if some else [],
        reweighted=said,
        failed=failed,
        seconds=round(time.perf_counter() - begin, 1),
    )


def _draws(
    problem: Problem, scheme: Scheme, checkpoints: Checkpoints, samples: int, reweight: bool
) -> tuple[np.ndarray, str | None]:
    """Draws (samples, d) as a run reports them, and a sentence on how they were re-weighted."""
    posterior = infer(problem, scheme, checkpoints, quiet=True).posterior
    seed_torch(seed=problem.simulator.seed, stream=Stream.POSTERIOR)
    if reweight:
        return posterior_draws(problem, posterior, samples)
    return draw(posterior, problem.simulator.space, samples), None


def repeated(study: Study, index: int) -> Prepared:
    """The study with a seed of its own, the first whose truth can be driven."""
    address = {"seed": study.seed, "stream": Stream.STUDY, "round": 1 + index}
    *seeds, last = (int(generator(**address, index=attempt).integers(2**31)) for attempt in range(MOST_TRUTHS))
    for seed in seeds:
        with suppress(InputError):
            return replace(study, seed=seed).prepare()
    return replace(study, seed=last).prepare()


def _each(work: Any, indices: list[int], workers: int) -> Iterator[tuple[int, Repetition]]:
    """Indices with their results, in the order in which these are done."""
    if workers == 1 or len(indices) < 2:
        use_cores(1)
        yield from ((i, work(i)) for i in indices)
        return
    with _processes(min(workers, len(indices))) as pool:
        jobs = {pool.submit(work, i): i for i in indices}
        yield from ((jobs[job], job.result()) for job in as_completed(jobs))


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread each, which end at once when this one is interrupted."""
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_alone)
    try:
        yield pool
    except BaseException:
        for process in active_children():
            process.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _alone() -> None:
    """In a worker: one thread, no warnings of libraries on the screen; interruptions are for who has started it."""
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, signal.SIG_IGN)
    logging.captureWarnings(True)
    torch.set_num_threads(1)
    use_cores(1)
