"""A run on disk: its configuration, what it ran on, how far it is, and a lock that keeps a second process out.

The manifest is rewritten whole after every change, so a run that is killed at any moment leaves a folder that the same
command continues and that another configuration cannot silently overwrite.
"""

import errno
import hashlib
import json
import logging
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil
import yaml
from filelock import FileLock, Timeout

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text

SCHEMA = 1
PACKAGES = ("sbi", "torch", "numpy", "numba")
NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP}  # of file systems that have none

_log = logging.getLogger("vehicle_sbi.run")


class _LogFile(logging.FileHandler):
    """log.txt; a full disk stops the run as any other write does, instead of being printed and forgotten."""

    def handleError(self, record: logging.LogRecord) -> None:
        if isinstance(sys.exc_info()[1], OSError):
            raise
        super().handleError(record)


@dataclass(frozen=True, kw_only=True)
class RunFolder:
    """A run folder that this process writes; use as a context manager, or `close` it, to let others in again."""

    path: Path
    manifest: dict[str, Any]
    _lock: FileLock
    _handler: logging.Handler

    @classmethod
    def open(
        cls,
        path: Path,
        *,
        config: Mapping[str, Any],
        overrides: Sequence[str],
        inputs: Mapping[str, str],
        choices: Mapping[str, str] | None = None,
    ) -> "RunFolder":
        """Create the folder, or reopen it to resume a run of the same configuration and inputs.

        `config` is plain data (no interpolations), `inputs` maps each input file to its sha256, `choices` each
        configuration group to the name chosen for it. Raises InputError where another process holds the folder, or
        where it holds a run of another configuration or of files that have changed since; OSError on a full disk.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputError(f"{path} is a file; choose another hydra.run.dir") from None
        lock = _locked(path)
        try:
            earlier = _manifest(path) if (path / "manifest.json").exists() else None
            manifest = _described(config, inputs, choices or {})
            if earlier is not None:
                manifest = _resumed(path, earlier, manifest)
            write_text(path / ".hydra" / "config.yaml", yaml.safe_dump(dict(config), sort_keys=False))
            write_text(path / ".hydra" / "overrides.yaml", yaml.safe_dump(list(overrides)))
            folder = cls(path=path, manifest=manifest, _lock=lock, _handler=_log_file(path / "log.txt"))
        except BaseException:
            lock.release()
            raise
        try:
            folder._save()
            _log.info("run %s, start %d, in %s", manifest["config"]["sha256"][:12], manifest["starts"], path)
        except BaseException:
            folder.close()
            raise
        return folder

    @property
    def config(self) -> dict[str, Any]:
        """What the run was configured with."""
        return _yaml(self.path / ".hydra" / "config.yaml")

    @property
    def finished(self) -> bool:
        """Whether a run in this folder has come to its end."""
        return self.manifest["status"] == "complete"

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; the seconds of a stage that is resumed, or entered again, add up."""
        _log.info("%s: started", name)
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - start
            total = self.manifest["seconds"].get(name, 0.0) + seconds
            self.manifest["seconds"][name] = round(total, 3)
            self._save()
            _log.info("%s: %.1f s, peak memory %d MB", name, seconds, self.manifest["peak_memory_mb"])

    def record(self, **facts: object) -> None:
        """Keep plain facts of the run (simulations that failed, acceptance per round) in the manifest."""
        self.manifest["facts"].update(facts)
        self._save()

    def complete(self) -> None:
        """Mark the run as finished: everything it promises is on disk."""
        self.manifest["status"] = "complete"
        self._save()
        _log.info("complete, %.1f s in all", sum(self.manifest["seconds"].values()))

    def close(self) -> None:
        """Stop logging here and let other processes in."""
        logging.getLogger().removeHandler(self._handler)
        try:
            self._handler.close()
        finally:
            self._lock.release()

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _save(self) -> None:
        self.manifest["peak_memory_mb"] = max(self.manifest["peak_memory_mb"], _peak_memory())
        write_text(self.path / "manifest.json", json.dumps(self.manifest, indent=2, default=str) + "\n")


@dataclass(frozen=True, kw_only=True)
class FinishedRun:
    """A finished run as others read it."""

    path: Path
    manifest: Mapping[str, Any]
    config: Mapping[str, Any]
    overrides: tuple[str, ...]

    @property
    def seed(self) -> int | None:
        return self.manifest["seed"]

    @property
    def study(self) -> str:
        """What the configuration is apart from its seed, as a hash: runs of one study are repetitions of each other."""
        return _hash({key: value for key, value in self.manifest["config"]["keys"].items() if key != "seed"})

    def choice(self, group: str) -> str:
        """The name chosen for a configuration group; else the class it builds, or "" where there is no such group."""
        chosen = self.manifest["choices"].get(group, self.config.get(group, ""))
        if isinstance(chosen, Mapping):
            return str(chosen.get("_target_", "")).rpartition(".")[2]
        return str(chosen)


def read(path: Path) -> FinishedRun:
    """Read a finished run; raises InputError if `path` is no run folder or its run has not finished."""
    manifest = _manifest(path)
    if manifest["status"] != "complete":
        raise InputError(f"{path}: the run has not finished; start the same command again to continue it")
    config, overrides = (_yaml(path / ".hydra" / f"{name}.yaml") for name in ("config", "overrides"))
    return FinishedRun(path=path, manifest=manifest, config=config or {}, overrides=tuple(overrides or ()))


def is_finished(path: Path) -> bool:
    """Whether the run folder `path` holds a run that came to its end."""
    return _manifest(path)["status"] == "complete"


def _manifest(path: Path) -> dict[str, Any]:
    file = path / "manifest.json"
    try:
        manifest = json.loads(file.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path} is not a run folder: it has no manifest.json") from None
    except ValueError:
        raise InputError(f"{file} is not a run's manifest: not JSON; choose another hydra.run.dir") from None
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{file}: schema {schema}, this version reads {SCHEMA}; choose another hydra.run.dir")
    return manifest


def _yaml(file: Path) -> Any:
    try:
        return yaml.safe_load(file.read_text())
    except FileNotFoundError:
        raise InputError(f"{file}: missing, so what this run did is not known") from None
    except yaml.YAMLError as error:
        raise InputError(f"{file}: not YAML ({' '.join(str(error).split())})") from None


def _locked(path: Path) -> FileLock:
    """The folder's lock; the operating system lets go of it when the process dies, however it dies."""
    lock, holder = FileLock(path / ".lock"), path / ".holder"
    try:
        lock.acquire(timeout=0)
    except Timeout:
        process = holder.read_text() if holder.exists() else "unknown"
        raise InputError(
            f"{path} is in use by process {process}; wait for it or choose another hydra.run.dir"
        ) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        _log.warning("%s: no lock on this file system (%s); run one process at a time here", path, error)
    holder.write_text(str(os.getpid()))
    return lock


def _hash(value: object) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _described(config: Mapping[str, Any], inputs: Mapping[str, str], choices: Mapping[str, str]) -> dict[str, Any]:
    """The manifest of a run that starts."""
    keys = {key: _hash(value) for key, value in config.items()}
    return {
        "schema": SCHEMA,
        "status": "running",
        "version": _version("vehicle-sbi"),
        "commit": _commit(),
        "packages": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "starts": 1,
        "seed": config.get("seed"),
        "choices": dict(choices),
        "inputs": dict(inputs),
        "config": {"sha256": _hash(dict(config)), "keys": keys},
        "seconds": {},
        "peak_memory_mb": 0,
        "facts": {},
    }


def _resumed(path: Path, earlier: dict[str, Any], manifest: dict[str, Any]) -> dict[str, Any]:
    """The manifest of a run that goes on: what it has done so far, on what it runs now."""
    for what, before, now in (
        ("configuration", earlier["config"]["keys"], manifest["config"]["keys"]),
        ("input files", earlier["inputs"], manifest["inputs"]),
    ):
        differ = sorted(key for key in {*before, *now} if before.get(key) != now.get(key))
        if differ:
            raise InputError(
                f"{path} holds a run of another {what} (differs in {', '.join(differ)}); choose another hydra.run.dir"
            )
    for name in ("version", "packages"):
        if earlier[name] != manifest[name]:
            _log.warning("started with %s, goes on with %s: may give another result", earlier[name], manifest[name])
    kept = {name: earlier[name] for name in ("status", "started", "seconds", "peak_memory_mb", "facts")}
    return {**manifest, **kept, "starts": earlier["starts"] + 1}


def _log_file(path: Path) -> logging.Handler:
    handler = _LogFile(path, mode="a", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.setLevel(logging.INFO)
    logging.getLogger().addHandler(handler)
    logging.captureWarnings(True)  # libraries' warnings belong in the log, not between a user's progress bars
    logging.getLogger("vehicle_sbi").setLevel(logging.INFO)
    return handler


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    """The commit this code was checked out at, with "-dirty" where files have changed; None for an installed copy."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _peak_memory() -> int:
    """The largest resident size of this process so far [MB]."""
    if sys.platform == "win32":
        return round(psutil.Process().memory_info().peak_wset / 2**20)
    import resource  # Windows has none

    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10))
