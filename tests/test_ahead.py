"""The sampler compiled ahead: the very function that diagnoses run, by a process that starts only where it helps."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from test_inclusion import SHARED, problem

from vehicle_sbi import threads
from vehicle_sbi.mismatch.selection import ahead
from vehicle_sbi.mismatch.selection.gibbs import run_chain
from vehicle_sbi.mismatch.selection.inclusion import Chain, sample


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """Calls of the processes that begin, which do nothing; every test begins anew, on two cores."""
    calls: list[list[str]] = []
    Process = subprocess.Popen

    def popen(call: list[str], **settings: object) -> subprocess.Popen:
        calls.append(call)
        return Process([sys.executable, "-c", ""])

    monkeypatch.setattr(subprocess, "Popen", popen)
    monkeypatch.setattr(threads, "_used", 2)
    ahead.begin.cache_clear()
    yield calls
    ahead.begin.cache_clear()


def test_what_is_compiled_ahead_is_what_a_diagnosis_runs() -> None:
    ahead.compile_sampler()
    assert ahead.is_compiled()
    compiled = list(run_chain.signatures)
    H, b, groups = problem(bounded=True)
    sample(H, b, groups, SHARED, Chain(chains=1, sweeps=4, forgotten=1, every=1), np.random.default_rng(0))
    assert run_chain.signatures == compiled


def test_one_process_begins_where_nothing_is_compiled(
    started: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead, "is_compiled", lambda: False)
    for _ in range(2):
        ahead.begin()
        ahead.wait()
    (call,) = started
    assert call[0] == sys.executable
    assert ahead.compile_sampler.__name__ in call[-1]
    compile(call[-1], "call", "exec")


def test_the_process_ends_with_the_one_that_began_it(tmp_path: Path) -> None:
    # A command that ends with an error after a second leaves nothing that goes on for half a minute.
    begun = "from vehicle_sbi.mismatch.selection import ahead; print(ahead.begin().pid)"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_NUM_THREADS": "2"}
    environment.pop("NUMBA_CACHE_DIR", None)
    printed = subprocess.run([sys.executable, "-c", begun], env=environment, capture_output=True, check=True, text=True)
    _, alive = psutil.wait_procs([one for one in [_process(int(printed.stdout))] if one is not None], timeout=5.0)
    assert all(one.status() == psutil.STATUS_ZOMBIE for one in alive)  # ended, where nothing collects it


def _process(pid: int) -> psutil.Process | None:
    try:
        return psutil.Process(pid)
    except psutil.NoSuchProcess:
        return None


@pytest.mark.parametrize(("cores", "compiled"), [(1, False), (2, True)])
def test_no_process_begins_where_it_would_not_help(
    cores: int, compiled: bool, started: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threads, "_used", cores)
    monkeypatch.setattr(ahead, "is_compiled", lambda: compiled)
    ahead.wait()
    assert started == []
