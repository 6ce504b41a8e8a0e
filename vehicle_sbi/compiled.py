"""How code is compiled: once, kept on disk, with IEEE 754 division, formulas in place where they are used.

A division by zero is infinite or not a number, which a simulation counts as such. A call that may raise, and any that
stays a call might, keeps numba from dropping the atomic reference counts of arrays, which took a third of a
simulation's time; so equations of motion are one piece of code, and what runs once a sample or less is a call.

numba's cache on disk does not notice a change in a function that a cached one calls, so the cache lives in a folder
named after the sources: an edited equation is a new folder. LLVM optimises at level 1: higher levels make code a few
percent faster, if that, and take half as long again to compile what a first diagnosis needs.
"""

import hashlib
import os
import re
import tempfile
from pathlib import Path

import numba
from numba import njit
from numba.core import config

LEVEL = 1  # of LLVM's optimisation


def _cache_folder() -> Path:
    """A per-user cache folder that names numba's version, this file, the physics and whatever else is compiled by their
    hash."""
    digest = hashlib.sha256(numba.__version__.encode() + Path(__file__).read_bytes())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        text = source.read_bytes()
        if source.parent.name == "physics" or re.search(rb"^from vehicle_sbi\.compiled import", text, re.MULTILINE):
            digest.update(text)
    root = os.environ.get("XDG_CACHE_HOME") or (Path.home() / ".cache")
    folder = Path(root) / "vehicle_sbi" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / folder.name
    return folder


os.environ.setdefault("NUMBA_OPT", str(LEVEL))
config.reload_config()
if "NUMBA_CACHE_DIR" not in os.environ:
    config.CACHE_DIR = str(_cache_folder())  # pyright: ignore[reportAttributeAccessIssue]

compiled = njit(cache=True, error_model="numpy", forceinline=True)
compiled_apart = njit(cache=True, error_model="numpy")
compiled_beside = njit(cache=True, error_model="numpy", nogil=True)  # runs while other threads of Python do
