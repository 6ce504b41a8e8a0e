"""A benchmark as a run: build cases, have each diagnosed in a process of its own, score, and write the results.

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
from dataclasses import asdict, dataclass
from datetime import date
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mixes import BENCHMARKS
from score_files import SUFFIX, called, lines_of
from tqdm import tqdm

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.files import write_text
from vehicle_sbi.fleet.attended import ONE_THREAD, attended
from vehicle_sbi.fleet.engine import Engine, Function, each

ROOT = Path(__file__).resolve().parents[1]
PRELOADED = ["hydra", "vehicle_sbi.report.diagnosis"]  # by the process from which those of diagnoses are forked


@dataclass(frozen=True, kw_only=True)
class Diagnoser:
    """Who is asked: a script of this checkout or of another one (`tree`), and what its answers are called."""

    name: str
    script: Path
    tree: Path
    timeout_s: float
    forks: bool = True  # whether its own script may start from a process that has imported everything

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
    log = case / f"{by.name}.log"
    if by.own and by.forks:
        status = _forked(by, arguments, log)
    else:
        status = attended(by.tree / by.script, arguments, log, by.timeout_s, tree=by.tree)
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
        with log.open("a") as file:
            file.write(f"stopped after {by.timeout_s:g} s\n")
    return process.exitcode


def run_script(script: Path, arguments: Sequence[str], log: Path) -> None:
    """A script as its command line runs it, what it prints into a log; called in a process that has imported it all."""
    with log.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    os.chdir(ROOT)
    sys.argv, sys.path[0] = [str(script), *arguments], str(script.parent)
    runpy.run_path(str(script), run_name="__main__")


@dataclass(frozen=True, kw_only=True)
class Task:
    """A case, and what is to be done with it."""

    folder: Path
    seed: int
    mix: str
    index: int
    diagnosed: bool
    baselines: bool
    by: Diagnoser


def work(plain: Mapping[str, Any]) -> str:
    """One case through the stages that are asked for, a `Task` in plain data; what went wrong, or nothing."""
    task = Task(**{**plain, "by": Diagnoser(**plain["by"])})
    folder, mix, index, by = task.folder, task.mix, task.index, task.by
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed" / f"{index:04d}.json"
    try:
        BENCHMARKS[mix].build(task.seed, index, folder)
        BENCHMARKS[mix].prepare(case, sealed, baselines=task.baselines)
    except (InputError, RuntimeError, np.linalg.LinAlgError) as error:
        return f"case {index}: {error}"
    for one in BENCHMARKS[mix].asked(case) if task.diagnosed else ():
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
    *, folder: Path, results: Path, n: int, seed: int, mix: str, engine: Engine, diagnosed: bool, baselines: bool,
    by: Diagnoser, beside: Sequence[str] = (), first: int = 0,
) -> str:  # fmt: skip
    """Run what is missing of cases `first` to `n` - 1, write RESULTS/MIX.csv and .md (with a verdict at least), and
    return the page.

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
    stand = {one: lines_of(path) for one, path in scores.items()}
    done = {one: {i: line for i, line in lines.items() if first <= i < n} for one, lines in stand.items()}
    todo = partial(Task, folder=folder, seed=seed, mix=mix, diagnosed=diagnosed, baselines=baselines, by=by)
    left = [asdict(todo(index=i)) for i in range(first, n) if i not in done[by.name]]
    run = Function(str(ROOT / "benchmarks"), "campaign", "work")
    with tqdm(total=len(left), desc="cases", disable=None) as bar:
        for _, problem in each(engine, run, left):
            if problem:
                bar.write(problem)
            bar.update()
    asked = {i: BENCHMARKS[mix].asked(folder / "cases" / f"{i:04d}") for i in range(first, n)}
    built = [i for i, folders in asked.items() if all((one / "case.yaml").exists() for one in folders)]
    if not (built or done[by.name]):
        raise InputError(f"no case could be built in {folder}")
    for one, lines in stand.items():
        if lines := lines | dict(BENCHMARKS[mix].kept(folder, built, one)):
            write_text(scores[one], "".join(f"{lines[i]}\n" for i in sorted(lines)))
    own, *simpler = (str(path) if path.exists() else one for one, path in scores.items())
    known, begun = sorted({*built, *done[by.name]}), f" first={first}" if first else ""
    command = f"python scripts/prove.py cases={n}{begun} seed={seed} mix={mix}"
    table, page = BENCHMARKS[mix].judged(folder, known, (own, *beside, *simpler), command, machine(engine.workers))
    judged = scores[by.name].exists() or any((one / by.name).exists() for i in built for one in asked[i])
    where = results if judged else folder
    written = mix if by.own and not beside else "_".join([mix, by.name, *map(called, beside)])
    write_text(where / f"{written}.csv", table.to_csv(index=False, float_format="%.6g"))
    write_text(where / f"{written}.md", page)
    return page
