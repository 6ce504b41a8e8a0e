"""The sampler of effects compiled ahead, by a process of its own, while this one compiles and runs simulations.

Numba compiles one function at a time in a process, and keeps what it has compiled on disk, where this process finds it.
"""

import atexit
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np

from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief
from vehicle_sbi.mismatch.selection.gibbs import run_chain
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Shared, sample
from vehicle_sbi.threads import cores

COLUMNS = 3  # one that is always there, and two groups of one each


@cache
def begin() -> subprocess.Popen | None:
    """The process that compiles, no longer than this one lives; none where this machine has one core, or has compiled
    the sampler before."""
    if cores() == 1 or is_compiled():
        return None
    call = [sys.executable, "-c", f"from {__name__} import compile_sampler; compile_sampler()"]
    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(call, stdin=nowhere, stdout=nowhere, stderr=nowhere)
    atexit.register(process.terminate)
    return process


def wait() -> None:
    """Until that process has ended, well or not: what is not compiled by then, this process compiles."""
    process = begin()
    if process is not None:
        process.wait()


def is_compiled() -> bool:
    """Whether numba's cache has the sampler, or there is no cache that could."""
    folder = run_chain.stats.cache_path
    return folder is None or any(Path(folder).glob(f"*.{run_chain.py_func.__name__}-*.nbc"))


def compile_sampler() -> None:
    """Sample a problem of three columns."""
    one = np.ones(1)
    belief = Belief(named=True, rate=0.5, nothing=0.01, amplitude=one, share=one, low=-one, high=one)
    groups = Groups.of([belief, belief], np.zeros((0, 2), dtype=bool), low=-one, high=one, outside=0.1)
    chain = Chain(chains=1, sweeps=2, forgotten=0, every=1)
    sample(np.eye(COLUMNS), np.ones(COLUMNS), groups, Shared(), chain, np.random.default_rng(0))
