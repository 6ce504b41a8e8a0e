"""A benchmark as a run: build cases, have each diagnosed in a process of its own, score, and write the results.

What stands on disk is not done again, so the same command continues after an interruption. A diagnosis is handed files
and words of a command line, nothing else.
"""

import json
import os
import platform
import runpy
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import date
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml
from mixes import BENCHMARKS
from score_files import SUFFIX, called, lines_of
from tqdm import tqdm

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import write_text

ROOT = Path(__file__).resolve().parents[1]
PRELOADED = ["hydra", "vehicle_sbi.report.diagnosis"]  # by the process from which those of diagnoses are forked
ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True, kw_only=True)
class Diagnoser:
    """Who is asked: a script of this checkout or of another one (`tree`), and what its answers are called."""

    name: str
    script: Path
    tree: Path
    timeout_s: float

    @property
    def own(self) -> bool:
        return self.tree == ROOT


def diagnose(case: Path, by: Diagnoser) -> None:
    """CASE/NAME/verdict.json, unless it stands already; CASE/NAME.json says how long it took and how it ended."""
    if (case / by.name / "verdict.json").exists() or not (by.tree / by.script).exists():
        return
    words = yaml.safe_load((case / "case.yaml").read_text())["overrides"]
    arguments = [*words, "figures=false", f"hydra.run.dir={case / by.name}"]
    begun = time.monotonic()
    status = (_forked if by.own else _started)(by, arguments, case / f"{by.name}.log")
    write_text(case / f"{by.name}.json", json.dumps({"seconds": time.monotonic() - begun, "status": status}))


def _forked(by: Diagnoser, arguments: Sequence[str], log: Path) -> int | None:
    """Exit status of this checkout's script in a process that has imported everything."""
    server = get_context("forkserver")
    server.set_forkserver_preload(PRELOADED)
    process = server.Process(target=run_script, args=(by.tree / by.script, arguments, log))
    process.start()
    process.join(by.timeout_s)
    if process.is_alive():
        process.kill()
        process.join()
        _stopped(log, by.timeout_s)
    return process.exitcode


def _started(by: Diagnoser, arguments: Sequence[str], log: Path) -> int | None:
    """Exit status of another checkout's script, which imports its own modules; that takes some seconds more."""
    environment = os.environ | {"PYTHONPATH": str(by.tree)}
    command = [sys.executable, str(by.script), *arguments]
    with log.open("w") as file:
        try:
            done = subprocess.run(
                command, cwd=by.tree, env=environment, stdout=file, stderr=file, timeout=by.timeout_s, check=False
            )
        except subprocess.TimeoutExpired:
            _stopped(log, by.timeout_s)
            return None
    return done.returncode


def _stopped(log: Path, after_s: float) -> None:
    with log.open("a") as file:
        file.write(f"stopped after {after_s:g} s\n")


def run_script(script: Path, arguments: Sequence[str], log: Path) -> None:
    """A script as its command line runs it, what it prints into a log; called in a process that has imported it all."""
    with log.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    os.chdir(ROOT)
    sys.argv, sys.path[0] = [str(script), *arguments], str(script.parent)
    runpy.run_path(str(script), run_name="__main__")


def work(folder: Path, seed: int, mix: str, index: int, stages: Mapping[str, bool], by: Diagnoser) -> str:
    """One case through the stages that are asked for; what went wrong, or nothing."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed" / f"{index:04d}.json"
    try:
        BENCHMARKS[mix].build(seed, index, folder)
        BENCHMARKS[mix].prepare(case, sealed, baselines=stages["baselines"])
    except (InputError, RuntimeError, np.linalg.LinAlgError) as error:
        return f"case {index}: {error}"
    for one in BENCHMARKS[mix].asked(case) if stages["diagnose"] else ():
        diagnose(one, by)
        if not (one / by.name / "verdict.json").exists():
            return f"case {index}: no verdict; {one / by.name}.log says why"
    return ""


def processor() -> str:
    """What the processor is called, where the system says so; else of which kind it is."""
    facts = Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), platform.processor() or platform.machine())


def machine(workers: int) -> str:
    where = f"{date.today()}, {processor()}, {os.cpu_count()} cores"
    at_once = f"{workers} diagnos{'i' if workers == 1 else 'e'}s at a time"
    return f"{where}, {at_once}, one thread each; the start of Python not counted."


def _spoken(drawn: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in drawn.items())


def prove(
    *, folder: Path, results: Path, n: int, seed: int, mix: str, workers: int, stages: Mapping[str, bool],
    by: Diagnoser, beside: Sequence[str] = (),
) -> str:  # fmt: skip
    """Run what is missing, write RESULTS/MIX.csv and .md (with a verdict at least), and return the page.

    Cases whose scores stand in RESULTS/MIX_SEED_NAME.jsonl are done. `beside` names diagnoses of the same cases that
    stand already, or such files, to be shown beside this one.
    """
    if mix not in BENCHMARKS:
        raise unknown("mix", mix, list(BENCHMARKS), "prove")
    os.environ |= ONE_THREAD  # read by the workers as they start
    folder = folder.resolve()
    seal = folder / "benchmark.json"
    drawn = {"seed": seed, "mix": mix}
    if seal.exists() and (there := json.loads(seal.read_text())) != drawn:
        raise InputError(f"{folder} holds cases of {_spoken(there)}, not of {_spoken(drawn)}; name another folder")
    write_text(seal, json.dumps(drawn))
    scores = {one: results / f"{mix}_{seed}_{one}{SUFFIX}" for one in (by.name, *BENCHMARKS[mix].simpler)}
    done = {one: {i: line for i, line in lines_of(path).items() if i < n} for one, path in scores.items()}
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        left = [i for i in range(n) if i not in done[by.name]]
        jobs = [pool.submit(work, folder, seed, mix, i, dict(stages), by) for i in left]
        with tqdm(total=len(left), desc="cases", disable=None) as bar:
            for job in as_completed(jobs):
                if problem := job.result():
                    bar.write(problem)
                bar.update()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    asked = {i: BENCHMARKS[mix].asked(folder / "cases" / f"{i:04d}") for i in range(n)}
    built = [i for i, folders in asked.items() if all((one / "case.yaml").exists() for one in folders)]
    if not (built or done[by.name]):
        raise InputError(f"no case could be built in {folder}")
    for one, lines in done.items():
        if lines := lines | dict(BENCHMARKS[mix].kept(folder, built, one)):
            write_text(scores[one], "".join(f"{lines[i]}\n" for i in sorted(lines)))
    own, *simpler = (str(path) if path.exists() else one for one, path in scores.items())
    known, command = sorted({*built, *done[by.name]}), f"python scripts/prove.py cases={n} seed={seed} mix={mix}"
    table, page = BENCHMARKS[mix].judged(folder, known, (own, *beside, *simpler), command, machine(workers))
    judged = scores[by.name].exists() or any((one / by.name).exists() for i in built for one in asked[i])
    where = results if judged else folder
    written = mix if by.own and not beside else "_".join([mix, by.name, *map(called, beside)])
    write_text(where / f"{written}.csv", table.to_csv(index=False, float_format="%.6g"))
    write_text(where / f"{written}.md", page)
    return page
