"""Where the time of a diagnosis goes, step by step, on cases of a folder that `scripts/prove.py` has made.

python benchmarks/diagnosis_time.py FOLDER 9 47 51

Recordings are cut to 24 s in all.
`scripts/diagnose.py` runs as a user's does, one case after the other. Its run folder keeps each step's result in a
file, whose times of writing tell how long each took. Run it twice: what is compiled the first time is kept. Idle cores
are yours to see to. Writes `benchmarks/results/diagnosis_time.md`.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import date
from itertools import pairwise
from pathlib import Path

import pandas as pd
import yaml
from gathering import RESULTS

from vehicle_sbi.files import write_text
from vehicle_sbi.mismatch.pipeline import STEPS
from vehicle_sbi.report.tables.text import markdown

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 24.0  # of driving that are diagnosed


def cut(case: Path, told: dict, folder: Path) -> list[str]:
    """The words of a case's command line, with its recordings cut to the same length each and SECONDS together."""
    length, words = SECONDS / len(told["recordings"]), " ".join(told["overrides"])
    for name in told["recordings"]:
        table = pd.read_csv(case / name)
        t = table["time_s"] - table["time_s"].iloc[0]
        if t.iloc[-1] < length:
            raise SystemExit(f"{case / name} lasts {t.iloc[-1]:.1f} s; {length:g} s are asked for")
        table[t <= length].to_csv(folder / name, index=False)
        words = words.replace(str(case / name), str(folder / name))
    return words.split(" ")


def asked(case: Path) -> dict[str, float | str]:
    """What one case took, in seconds: from the start of Python to the fit's end, then each step, then the report."""
    told, run = yaml.safe_load((case / "case.yaml").read_text()), case / "timed"
    shutil.rmtree(run, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        words = cut(case, told, Path(folder))
        begun = time.time()
        command = [sys.executable, "scripts/diagnose.py", *words, "figures=false", f"hydra.run.dir={run}"]
        ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        ended = time.time()
    if ran.returncode:
        raise SystemExit(f"{case}: {ran.stderr.strip().splitlines()[-1]}")
    written = [begun, *((run / "stages" / f"{name}.npz").stat().st_mtime for name in STEPS), ended]
    seconds = [after - before for before, after in pairwise(written)]
    names = ["start of Python, and fitting the base model", *[*STEPS.values()][1:], "held-out data and the answer"]
    return {
        "case": f"case {int(case.name)}",
        "channels": len(told["channels"]),
        "recordings": len(told["recordings"]),
        **dict(zip(names, seconds, strict=True)),
        "all": ended - begun,
    }


def main(folder: Path, numbers: list[int]) -> None:
    """The page of some cases."""
    table = pd.DataFrame([asked(folder / "cases" / f"{number:04d}") for number in numbers]).set_index("case").T
    text = [
        f"# Where the time of a diagnosis of {SECONDS:g} s goes, in seconds",
        "",
        f"`python benchmarks/diagnosis_time.py FOLDER {' '.join(map(str, numbers))}`, {date.today()},",
        f"{platform.platform()}, {len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f} in the end;",
        f"folder: `{json.loads((folder / 'benchmark.json').read_text())}`.",
        "",
        markdown(table.map(lambda x: f"{x:.3g}").reset_index(names="")),
    ]
    write_text(RESULTS / "diagnosis_time.md", "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(word) for word in sys.argv[2:]])
