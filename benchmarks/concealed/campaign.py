"""The benchmark as a run: build cases, have each diagnosed in a process of its own, score, and write the results.

What stands on disk is not done again, so the same command continues after an interruption. A diagnosis is handed files
and words of a command line, nothing else.
"""

import json
import os
import platform
import runpy
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from tqdm import tqdm

from concealed import baselines, cases, injected, observer, oracle, scores, summary
from concealed.mix import MIXES
from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import write_text
from vehicle_sbi.physics.effects import CATALOGUE

ROOT = Path(__file__).resolve().parents[2]
PRELOADED = ["hydra", "vehicle_sbi.report.diagnosis"]  # by the process from which those of diagnoses are forked
ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def diagnose(case: Path, script: Path, timeout_s: float) -> None:
    """CASE/diagnosis/verdict.json, unless it stands already; CASE/run.json says how long it took and how it ended."""
    verdict = case / "diagnosis" / "verdict.json"
    if verdict.exists() or not script.exists():
        return
    words = yaml.safe_load((case / "case.yaml").read_text())["overrides"]
    arguments = [*words, "figures=false", f"hydra.run.dir={case / 'diagnosis'}"]
    server = get_context("forkserver")
    server.set_forkserver_preload(PRELOADED)
    process = server.Process(target=run_script, args=(script, arguments, case / "diagnose.log"))
    begun = time.monotonic()
    process.start()
    process.join(timeout_s)
    if process.is_alive():
        process.kill()
        process.join()
        with (case / "diagnose.log").open("a") as log:
            log.write(f"stopped after {timeout_s:g} s\n")
    write_text(case / "run.json", json.dumps({"seconds": time.monotonic() - begun, "status": process.exitcode}))


def run_script(script: Path, arguments: Sequence[str], log: Path) -> None:
    """A script as its command line runs it, what it prints into a log; called in a process that has imported it all."""
    with log.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    os.chdir(ROOT)
    sys.argv, sys.path[0] = [str(script), *arguments], str(script.parent)
    runpy.run_path(str(script), run_name="__main__")


def work(
    folder: Path, seed: int, mix: str, index: int, stages: Mapping[str, bool], script: Path, timeout_s: float
) -> str:
    """One case through the stages that are asked for; what went wrong, or nothing."""
    case = folder / "cases" / f"{index:04d}"
    try:
        cases.build(seed, index, mix, folder, injected.build, list(injected.INJECTED))
        oracle.write(case, folder / "sealed" / f"{index:04d}.json")
        if stages["baselines"]:
            baselines.write(case)
            observer.write(case, folder / "sealed" / f"{index:04d}.json")
    except (InputError, RuntimeError, np.linalg.LinAlgError) as error:
        return f"case {index}: {error}"
    if stages["diagnose"]:
        diagnose(case, script, timeout_s)
        if not (case / "diagnosis" / "verdict.json").exists():
            return f"case {index}: no verdict; {case / 'diagnose.log'} says why"
    return ""


def gather(folder: Path, n: int) -> pd.DataFrame:
    """A row for each case that is built."""
    built = [i for i in range(n) if (folder / "cases" / f"{i:04d}" / "case.yaml").exists()]
    return pd.DataFrame([scores.row(folder, i) for i in built])


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
    script: Path, timeout_s: float,
) -> str:  # fmt: skip
    """Run what is missing, write RESULTS/MIX.csv and .md (with a verdict at least), and return the page."""
    if mix not in MIXES:
        raise unknown("mix", mix, list(MIXES), "prove")
    os.environ |= ONE_THREAD  # read by the workers as they start
    folder = folder.resolve()
    seal = folder / "benchmark.json"
    drawn = {"seed": seed, "mix": mix}
    if seal.exists() and (there := json.loads(seal.read_text())) != drawn:
        raise InputError(f"{folder} holds cases of {_spoken(there)}, not of {_spoken(drawn)}; name another folder")
    write_text(seal, json.dumps(drawn))
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        jobs = [pool.submit(work, folder, seed, mix, i, dict(stages), script, timeout_s) for i in range(n)]
        with tqdm(total=n, desc="cases", disable=None) as bar:
            for job in as_completed(jobs):
                if problem := job.result():
                    bar.write(problem)
                bar.update()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    table = gather(folder, n)
    if table.empty:
        raise InputError(f"no case could be built in {folder}")
    command = f"python scripts/prove.py cases={n} seed={seed} mix={mix}"
    page = summary.report(table, command, machine(workers), len(CATALOGUE))
    where = results if "detected" in table else folder
    write_text(where / f"{mix}.csv", table.to_csv(index=False, float_format="%.6g"))
    write_text(where / f"{mix}.md", page)
    return page
