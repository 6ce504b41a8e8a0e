"""What a vehicle does: plain scalar Python compiled by numba.

numba's on-disk cache does not notice a change in a function that a cached one calls, so the cache lives in a folder
named after the sources: an edited equation is a new folder.
"""

import hashlib
import os
import tempfile
from pathlib import Path

import numba


def _cache_folder() -> Path:
    """A per-user cache folder that names the physics sources, numba's version and the catalogue by their hash."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    root = os.environ.get("XDG_CACHE_HOME") or (Path.home() / ".cache")
    folder = Path(root) / "vehicle_sbi" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / folder.name
    return folder


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.core.config.CACHE_DIR = str(_cache_folder())  # pyright: ignore[reportAttributeAccessIssue]
