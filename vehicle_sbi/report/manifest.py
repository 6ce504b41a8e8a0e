"""The manifest of a run: what was asked, what it runs on, how far it is, and every file it made, bound by SHA-256.

It is JSON and carries the SHA-256 of its own contents. A run goes on only from files that are as it left them, made
from the same configuration and inputs by the same code.
"""

import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import sha256, write_text

Manifest = dict[str, Any]

SCHEMA = 2
FILE = "manifest.json"
PACKAGE = Path(__file__).resolve().parents[1]
PACKAGES = ("sbi", "torch", "numpy", "numba", "scipy")
MADE_BY = ("code", "packages", "python")  # what else than configuration and inputs a result may depend on
KEPT = ("status", "started", "files", "seconds", "peak_memory_mb", "facts")  # of an earlier start
BOOKKEEPING = {FILE, "log.txt", ".lock", ".holder", ".hydra"}  # all that is no result
WORK = ("rounds", "stages")  # folders of checkpoints


def described(
    *,
    config: Mapping[str, Any],
    overrides: Sequence[str],
    inputs: Mapping[str, str],
    choices: Mapping[str, str],
) -> Manifest:
    """The manifest of a run that starts."""
    keys = {key: digest(value) for key, value in config.items()}
    return {
        "schema": SCHEMA,
        "status": "running",
        "version": _version("vehicle-sbi"),
        "code": code(),
        "commit": _commit(),
        "packages": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "starts": 1,
        "seed": config.get("seed"),
        "overrides": list(overrides),
        "choices": dict(choices),
        "inputs": dict(inputs),
        "config": {"sha256": digest(dict(config)), "keys": keys},
        "files": {},
        "seconds": {},
        "peak_memory_mb": 0,
        "facts": {},
    }


def begun(path: Path, now: Manifest) -> tuple[Manifest, tuple[str, ...]]:
    """The manifest of this start in a folder, and what is not used of the starts before.

    Raises InputError where the folder holds a run of another configuration or of inputs that have changed, or
    checkpoints of no run that is known.
    """
    if (path / FILE).exists():
        return _resumed(path, read(path), now)
    foreign = [name for name in WORK if (path / name).exists()]
    if foreign:
        raise InputError(f"{path} holds {foreign[0]}/ but no {FILE}: whose they are is not known; remove the folder")
    return now, ()


def _resumed(path: Path, earlier: Manifest, now: Manifest) -> tuple[Manifest, tuple[str, ...]]:
    _refuse_another(path, earlier, now)
    now = {**now, "starts": earlier["starts"] + 1}
    going_on = {**now, **{name: earlier[name] for name in KEPT}}
    changed = ", ".join(name for name in MADE_BY if earlier[name] != now[name])
    if earlier["status"] != "complete":
        return (now, (f"{path}: begun by another version ({changed}); done anew",)) if changed else (going_on, ())
    damaged = [name for name, sealed in earlier["files"].items() if not intact(path / name, sealed)]
    if not damaged:
        left = {name: earlier[name] for name in MADE_BY}
        other = f"{path}: made by another version ({changed}); remove the folder to do it anew"
        return {**going_on, **left}, (other,) if changed else ()
    lost = f"{path}: {damaged[0]} is damaged or missing; what rests on it is made anew"
    return now if changed else {**going_on, "status": "running"}, (lost,)


def _refuse_another(path: Path, earlier: Manifest, now: Manifest) -> None:
    for what, before, asked in (
        ("another configuration", earlier["config"]["keys"], now["config"]["keys"]),
        ("other input files, or of files that have changed since", earlier["inputs"], now["inputs"]),
    ):
        differ = sorted(key for key in {*before, *asked} if before.get(key) != asked.get(key))
        if differ:
            raise InputError(
                f"{path} holds a run of {what} (differs in {', '.join(differ)}); choose another hydra.run.dir"
            )


def read(path: Path) -> Manifest:
    """The manifest of a run folder; raises InputError where there is none, or one that is not as it was written."""
    file = path / FILE
    try:
        manifest = json.loads(file.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path} is not a run folder: it has no {FILE}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{file} is not a run's manifest: not JSON; choose another hydra.run.dir") from None
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{file}: schema {schema}, this version reads {SCHEMA}; choose another hydra.run.dir")
    if manifest.pop("seal", None) != digest(manifest):
        raise InputError(f"{file} is damaged; remove the folder or choose another hydra.run.dir")
    return manifest


def write(path: Path, manifest: Manifest) -> None:
    """Write the manifest of a run folder, whole or not at all."""
    plain = json.loads(json.dumps(manifest, default=str))
    write_text(path / FILE, json.dumps({**plain, "seal": digest(plain)}, indent=2) + "\n")


def results(path: Path) -> list[str]:
    """Names of all files of a run but those that it keeps account with."""
    files = (file.relative_to(path) for file in sorted(path.rglob("*")) if file.is_file())
    return [file.as_posix() for file in files if file.parts[0] not in BOOKKEEPING]


def intact(file: Path, sealed: str) -> bool:
    """Whether a file or folder is there with the SHA-256 that it was left with."""
    return file.exists() and sha256(file) == sealed


def digest(value: object) -> str:
    """The SHA-256 of plain data, whatever the order of its keys."""
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def peak_memory() -> int:
    """The largest resident size of this process so far [MB]."""
    if sys.platform == "win32":
        return round(psutil.Process().memory_info().peak_wset / 2**20)
    import resource  # Windows has none

    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10))


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def code() -> str:
    """The SHA-256 of the package's source files."""
    digested = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        digested.update(file.relative_to(PACKAGE).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digested.hexdigest()


def _commit() -> str | None:
    """The commit this code was checked out at, with "-dirty" where files have changed; None for an installed copy."""
    root = PACKAGE.parent
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}  # may name programs
    try:
        return subprocess.run(command, env=plain, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
