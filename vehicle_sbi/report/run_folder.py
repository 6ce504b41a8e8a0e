"""A run on disk: its manifest, its log, and a lock that keeps a second process out.

The manifest is rewritten whole after every change, so a run that is killed at any moment leaves a folder that the same
command continues and that another configuration cannot silently overwrite.
"""

import errno
import logging
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from filelock import FileLock, Timeout

from vehicle_sbi import plain_yaml
from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.errors import InputError
from vehicle_sbi.files import remove_parts, sha256, write_text
from vehicle_sbi.report import manifest as manifests
from vehicle_sbi.report.manifest import Manifest

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
    manifest: Manifest
    notices: tuple[str, ...]  # what was not used of an earlier start, and why
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
        where it holds a run of another configuration, of files that have changed since, or checkpoints of no run that
        is known; OSError on a full disk.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputError(f"{path} is a file; choose another hydra.run.dir") from None
        lock = _locked(path)
        try:
            remove_parts(path)
            asked = manifests.described(config=config, overrides=overrides, inputs=inputs, choices=choices or {})
            manifest, notices = manifests.begun(path, asked)
            write_text(path / ".hydra" / "config.yaml", yaml.safe_dump(dict(config), sort_keys=False))
            write_text(path / ".hydra" / "overrides.yaml", yaml.safe_dump(list(overrides)))
            handler = _log_file(path / "log.txt")
            folder = cls(path=path, manifest=manifest, notices=notices, _lock=lock, _handler=handler)
        except BaseException:
            lock.release()
            raise
        try:
            folder._save()
            _log.info("run %s, start %d, in %s", manifest["config"]["sha256"][:12], manifest["starts"], path)
            for notice in notices:
                _log.warning("%s", notice)
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

    @property
    def checkpoints(self) -> Checkpoints:
        """Files of this run that another start of it goes on from."""
        return Checkpoints(self.path, self.manifest["files"], self._save)

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
        """Mark the run as finished: everything it promises is on disk, and bound to it."""
        self.manifest["files"] |= {name: sha256(self.path / name) for name in manifests.results(self.path)}
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
        self.manifest["peak_memory_mb"] = max(self.manifest["peak_memory_mb"], manifests.peak_memory())
        manifests.write(self.path, self.manifest)


@dataclass(frozen=True, kw_only=True)
class FinishedRun:
    """A finished run as others read it."""

    path: Path
    manifest: Manifest
    config: Mapping[str, Any]
    overrides: tuple[str, ...]

    @property
    def seed(self) -> int | None:
        return self.manifest["seed"]

    @property
    def study(self) -> str:
        """What the configuration is apart from its seed, as a hash: runs of one study are repetitions of each other."""
        return manifests.digest({key: value for key, value in self.manifest["config"]["keys"].items() if key != "seed"})

    def file(self, name: str) -> Path:
        """A result; raises InputError if it is not as the run left it."""
        path, sealed = self.path / name, self.manifest["files"].get(name)
        if sealed is not None and not manifests.intact(path, sealed):
            raise InputError(f"{path} is damaged or missing; start the same command again to make it anew")
        return path

    def choice(self, group: str) -> str:
        """The name chosen for a configuration group; else the class it builds, or "" where there is no such group."""
        chosen = self.manifest["choices"].get(group, self.config.get(group, ""))
        if isinstance(chosen, Mapping):
            return str(chosen.get("_target_", "")).rpartition(".")[2]
        return str(chosen)


def read(path: Path) -> FinishedRun:
    """Read a finished run; raises InputError if `path` is no run folder or its run has not finished."""
    manifest = manifests.read(path)
    if manifest["status"] != "complete":
        raise InputError(f"{path}: the run has not finished; its command goes on, or says again why it failed")
    file = path / ".hydra" / "config.yaml"
    config = _yaml(file)
    if manifests.digest(config) != manifest["config"]["sha256"]:
        raise InputError(f"{file} is not the configuration that the run had; start the same command again")
    return FinishedRun(path=path, manifest=manifest, config=config, overrides=tuple(manifest["overrides"]))


def is_finished(path: Path) -> bool:
    """Whether the run folder `path` holds a run that came to its end."""
    return manifests.read(path)["status"] == "complete"


def _yaml(file: Path) -> Any:
    try:
        return plain_yaml.load(file)
    except FileNotFoundError:
        raise InputError(f"{file}: missing, so what this run did is not known") from None
    except plain_yaml.UnreadableYaml as error:
        raise InputError(f"{file}: {error}") from None


def _locked(path: Path) -> FileLock:
    """The folder's lock; the operating system lets go of it when the process dies, however it dies."""
    lock, holder = FileLock(path / ".lock"), path / ".holder"
    try:
        lock.acquire(timeout=0)
    except Timeout:
        process = holder.read_text(encoding="utf-8") if holder.exists() else "unknown"
        raise InputError(
            f"{path} is in use by process {process}; wait for it or choose another hydra.run.dir"
        ) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
        _log.warning("%s: no lock on this file system (%s); run one process at a time here", path, error)
    holder.write_text(str(os.getpid()))
    return lock


def _log_file(path: Path) -> logging.Handler:
    handler = _LogFile(path, mode="a", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.setLevel(logging.INFO)
    logging.getLogger().addHandler(handler)
    logging.captureWarnings(True)  # libraries' warnings belong in the log, not between a user's progress bars
    logging.getLogger("vehicle_sbi").setLevel(logging.INFO)
    return handler
