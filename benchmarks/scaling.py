"""Seconds and memory of run.py, observability.py and diagnose.py against the length of a recording.

    .venv/bin/python benchmarks/scaling.py                 an hour of two cores; started again, it goes on
    .venv/bin/python benchmarks/scaling.py run,diagnose    some of the scripts alone

Drives of 36 s to an hour at 200 Hz are simulated, written as Parquet and given to each script with its defaults, a
process each. Peak memory is the largest resident set of that process. Writes results/scaling.md and scaling.csv.
"""

import json
import multiprocessing
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import IO, Any

from gathering import RESULTS, ROOT

FOLDER = ROOT / "outputs" / "scaling"
MINUTES = (0.6, 6.0, 30.0, 60.0)
RATE = 200.0  # [Hz]
VEHICLE = "bmw320i"
SCRIPTS = ("run", "observability", "diagnose")
SIMULATIONS = (1250, 2500, 5000, 10000)  # a round
SIMULATED_MINUTES = 6.0  # of the drive on which their number is changed
TIMEOUT_S = 900.0
KILLED, FAILED = "timeout", "failed"


@dataclass(frozen=True, kw_only=True)
class Run:
    """One script on one drive: what it took, and how it ended."""

    script: str
    minutes: float
    simulations: int | None
    seconds: float
    cpu_seconds: float
    megabytes: float
    ended: str

    @property
    def key(self) -> str:
        return key(self.script, self.minutes, self.simulations)


def key(script: str, minutes: float, simulations: int | None) -> str:
    return f"{script}_{minutes:g}" + ("" if simulations is None else f"_{simulations}")


def drive(minutes: float) -> Path:
    """A drive of so many minutes as a file, made in a process of its own, whose memory no later process inherits."""
    path = FOLDER / f"drive_{minutes:g}.parquet"
    if not path.exists():
        maker = multiprocessing.get_context("spawn").Process(target=written, args=(minutes, path))
        maker.start()
        maker.join()
    return path


def written(minutes: float, path: Path) -> None:
    """Simulate a long, varied drive and write it: bends, gears of speed, straights and stops, sensors with noise."""
    from long_drive import long_drive

    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    long_drive(60.0 * minutes, rate=RATE, vehicle=VEHICLE).to_parquet(unfinished)
    unfinished.rename(path)


def measured(script: str, minutes: float, simulations: int | None = None) -> Run:
    """One script on one drive, from its file where it is known."""
    record = FOLDER / "records" / f"{key(script, minutes, simulations)}.json"
    if record.exists():
        return Run(**json.loads(record.read_text()))
    record.parent.mkdir(parents=True, exist_ok=True)
    folder = FOLDER / "runs" / f"{record.stem}_{time.time_ns()}"  # new each time: a finished run is not redone
    asked = [f"recording={drive(minutes)}", f"vehicle={VEHICLE}", f"hydra.run.dir={folder}"]
    asked += [] if simulations is None else [f"rounds.simulations={simulations}"]
    with (record.with_suffix(".log")).open("w") as log:
        took = timed([sys.executable, f"scripts/{script}.py", *asked], log)
    found = Run(script=script, minutes=minutes, simulations=simulations, **took)
    record.write_text(json.dumps(asdict(found)))
    return found


def timed(command: list[str], log: IO[str]) -> dict[str, Any]:
    """Seconds, those of all cores, peak resident set [MB] and how it ended, of a process that is killed in the end."""
    began, ended = time.perf_counter(), ""
    process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, start_new_session=True)
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            break
        if not ended and time.perf_counter() - began > TIMEOUT_S:
            os.killpg(process.pid, signal.SIGKILL)
            ended = KILLED
        time.sleep(0.05)
    process.returncode = os.waitstatus_to_exitcode(status)
    return {
        "seconds": time.perf_counter() - began,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "megabytes": usage.ru_maxrss / 1024.0,
        "ended": ended or ("" if process.returncode == 0 else FAILED),
    }


def exponent(x: list[float], y: list[float]) -> float:
    """The slope of log y over log x, by least squares."""
    import numpy as np

    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def table(runs: list[Run], by: str) -> list[str]:
    """Rows of markdown, and the exponents of each script's finished runs."""
    lines = [f"| script | {by} | seconds | of a core | peak MB | |", "| --- | --- | --- | --- | --- | --- |"]
    for run in runs:
        amount = f"{run.minutes:g} min" if by == "recording" else f"{run.simulations}"
        took = f"{run.seconds:.0f} | {run.cpu_seconds:.0f} | {run.megabytes:.0f}"
        lines.append(f"| {run.script} | {amount} | {took} | {run.ended} |")
    lines += ["", f"| script | seconds of a core grow as {by} to the power of | memory |", "| --- | --- | --- |"]
    for script in dict.fromkeys(run.script for run in runs):
        done = [run for run in runs if run.script == script and not run.ended]
        if len(done) > 1:
            x = [run.minutes if by == "recording" else float(run.simulations or 0) for run in done]
            powers = (exponent(x, [getattr(run, name) for run in done]) for name in ("cpu_seconds", "megabytes"))
            lines.append("| " + " | ".join([script, *(f"{power:.2f}" for power in powers)]) + " |")
    return lines


def write(by_length: list[Run], by_simulations: list[Run]) -> None:
    """The page and the numbers behind it."""
    import pandas as pd

    cores = len(os.sched_getaffinity(0))
    machine = f"{date.today()}, {platform.platform()}, {cores} cores, load {os.getloadavg()[0]:.1f} when written"
    text = [
        "# Seconds and memory against the length of a recording",
        "",
        f"{RATE:g} Hz, six channels, defaults of each script. {machine}.",
        f"A run is ended after {TIMEOUT_S:.0f} s. An exponent of 1 is linear.",
        "",
        *table(by_length, "recording"),
    ]
    if by_simulations:
        text += ["", f"`run.py` on {SIMULATED_MINUTES:g} minutes by simulations a round:", ""]
        text += table(by_simulations, "simulations")
    (RESULTS / "scaling.md").write_text("\n".join(text) + "\n")
    pd.DataFrame([asdict(run) for run in (*by_length, *by_simulations)]).to_csv(RESULTS / "scaling.csv", index=False)


def main() -> None:
    scripts = sys.argv[1].split(",") if len(sys.argv) > 1 else [*SCRIPTS, "simulations"]
    by_length, by_simulations = list[Run](), list[Run]()
    for script in scripts:
        todo = [("run", SIMULATED_MINUTES, n) for n in SIMULATIONS]
        todo = todo if script == "simulations" else [(script, minutes, None) for minutes in MINUTES]
        for one in todo:
            run = measured(*one)
            (by_simulations if script == "simulations" else by_length).append(run)
            print(f"{run.key}: {run.seconds:.0f} s, {run.megabytes:.0f} MB {run.ended}", flush=True)
            write(by_length, by_simulations)


if __name__ == "__main__":
    main()
