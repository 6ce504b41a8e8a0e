"""Scripts as their command lines run them, each in a process of its own that is forked from one with the libraries."""

import os
import runpy
import sys
from collections.abc import Mapping
from multiprocessing import get_context
from multiprocessing.forkserver import ensure_running
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
INHERITED = {key: value for key, value in os.environ.items() if key != "HYDRA_FULL_ERROR"}
ENVIRONMENT = INHERITED | {"NUMBA_NUM_THREADS": "1"}
LIBRARIES = [
    "hydra", "vehicle_sbi.report.diagnosis", "vehicle_sbi.report.results", "vehicle_sbi.report.calibration",
    "vehicle_sbi.inference.rounds", "vehicle_sbi.inference.repetition",
]  # fmt: skip
PATIENCE = 290.0  # [s]


def run_script(script: str, *arguments: str) -> tuple[int, str, str]:
    """Exit status of scripts/SCRIPT.py, and what it prints into its output and its errors."""
    server = get_context("forkserver")
    server.set_forkserver_preload(LIBRARIES)
    _started_with(ENVIRONMENT)
    with TemporaryDirectory() as folder:
        streams = Path(folder) / "out", Path(folder) / "err"
        process = server.Process(target=_play, args=(ROOT / "scripts" / f"{script}.py", arguments, streams))
        process.start()
        process.join(PATIENCE)
        if process.exitcode is None:
            process.kill()
        out, err = (stream.read_text() if stream.exists() else "" for stream in streams)
        assert process.exitcode is not None, f"{script} {arguments} took more than {PATIENCE:g} s: {out}{err}"
        return process.exitcode, out, err


def _started_with(environment: Mapping[str, str]) -> None:
    """The process to fork from, unless it runs already."""
    before = dict(os.environ)
    os.environ.clear()
    os.environ.update(environment)
    try:
        ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)


def _play(script: Path, arguments: tuple[str, ...], streams: tuple[Path, Path]) -> None:
    for descriptor, stream in zip((1, 2), streams, strict=True):
        os.dup2(os.open(stream, os.O_WRONLY | os.O_CREAT), descriptor)
    os.chdir(ROOT)
    sys.argv, sys.path[0] = [str(script), *arguments], str(script.parent)
    runpy.run_path(str(script), run_name="__main__")
