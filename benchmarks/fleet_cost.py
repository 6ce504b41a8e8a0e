"""What a fleet costs: 20 vehicles diagnosed at once on this machine, and from there a thousand on many cores.

    .venv/bin/python benchmarks/fleet_cost.py        (resumes; ten minutes on two cores)

The vehicles are simulated whole cars of a development seed. Writes results/fleet_cost.md.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from campaign import processor
from whole_car import cases

from vehicle_sbi.files import write_text
from vehicle_sbi.report.tables.text import markdown

ROOT = Path(__file__).resolve().parent.parent
FOLDER, RESULT = ROOT / "outputs" / "fleet_cost", ROOT / "benchmarks" / "results" / "fleet_cost.md"
SEED, VEHICLES, WORKERS = 101, 20, 2
CORES = (2, 16, 128)
MANY = 1000
OF_THE_CASE = ("recordings=", "heldout=", "vehicle=")


def recordings() -> Path:
    """The fleet's folder: for each vehicle its recordings, its file and its options."""
    fleet = FOLDER / "recordings"
    for i in range(VEHICLES):
        cases.build(SEED, i, FOLDER / "built")
        case, own = FOLDER / "built" / "cases" / f"{i:04d}", fleet / f"car_{i:02d}"
        (own / "heldout").mkdir(parents=True, exist_ok=True)
        for file in case.glob("*.csv"):
            shutil.copy(file, own / "heldout" if file.name.startswith("heldout") else own)
        shutil.copy(case / "vehicle.yaml", own)
        words = yaml.safe_load((case / "case.yaml").read_text())["overrides"]
        options = [word for word in words if not word.startswith(OF_THE_CASE)]
        write_text(own / "options.yaml", yaml.safe_dump(options))
    return fleet


def main() -> None:
    fleet, out = recordings(), FOLDER / "out"
    took = out / "seconds.txt"
    if not took.exists():
        begun = time.perf_counter()
        asked = [f"folder={fleet}", f"workers={WORKERS}", "figures=false", f"hydra.run.dir={out}"]
        subprocess.run([sys.executable, "scripts/fleet.py", *asked], cwd=ROOT, check=True)
        took.write_text(f"{time.perf_counter() - begun:.0f}")
    table, seconds = pd.read_csv(out / "fleet.csv"), float(took.read_text())
    peaks = [json.loads((out / name / "manifest.json").read_text())["peak_memory_mb"] for name in table["vehicle"]]
    megabytes = sum(file.stat().st_size for file in out.rglob("*") if file.is_file()) / 1e6
    each = WORKERS * seconds / VEHICLES  # of a core
    projected = [
        {"cores": n, "hours": f"{MANY * each / n / 3600.0:.1f}", "memory [GB]": f"{n * max(peaks) / 1000.0:.0f}"}
        for n in CORES
    ]
    lines = [
        "# What a fleet costs",
        f"{date.today()}, {processor()}, {os.cpu_count()} cores; {VEHICLES} simulated cars, {WORKERS} at a time.",
        f"- All of them: {seconds:.0f} s, so {each:.0f} s of a core each, Python's start included.",
        f"- One: median {table['seconds'].median():.0f} s, longest {table['seconds'].max():.0f} s; peak memory median "
        f"{np.median(peaks):.0f} MB, largest {max(peaks)} MB; {megabytes / VEHICLES:.1f} MB on disk.",
        f"{MANY} vehicles, as each is a job of its own, with one core a job and the largest memory for all:",
        markdown(pd.DataFrame(projected)),
    ]
    write_text(RESULT, "\n\n".join(lines) + "\n")
    print(RESULT.read_text())


if __name__ == "__main__":
    main()
