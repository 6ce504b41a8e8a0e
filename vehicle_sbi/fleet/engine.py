"""Where jobs run: processes of this machine, or workers of a Dask cluster that share its file system."""

import importlib.util
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, TypeVar

from vehicle_sbi.errors import InputError, unknown

ENGINES = ("local", "dask")
OWN_CLUSTER: dict[str, Any] = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
CONNECTED_S = 20.0  # [s] within which a scheduler has to answer
Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Engine:
    """`workers` jobs at a time on this machine (local), or by a Dask cluster of separate processes on it (dask); on the
    workers of a running cluster where the address of its `scheduler` is given.

    Jobs mostly wait for a process that they start; `computing` says that they compute themselves.
    """

    name: str = "local"
    workers: int = 2
    scheduler: str | None = None
    computing: bool = False

    def __post_init__(self) -> None:
        if self.name not in ENGINES:
            raise unknown("engine", self.name, ENGINES, "engine")
        if not isinstance(self.workers, int) or self.workers < 1:
            raise InputError(f"workers = {self.workers!r}; it must be a whole number above 0")
        if self.scheduler is not None and self.name != "dask":
            raise InputError(f"scheduler = {self.scheduler}: only engine=dask has one")

    @contextmanager
    def executor(self) -> Iterator[Executor]:
        """What takes jobs; those that have not begun are dropped when it is left early."""
        if self.name == "local":
            spawn = get_context("spawn")
            pool = ProcessPoolExecutor(self.workers, spawn) if self.computing else ThreadPoolExecutor(self.workers)
            try:
                yield pool
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
            return
        with _client(self) as client:
            yield client.get_executor(pure=False)


@dataclass(frozen=True)
class Function:
    """A function of a module that workers find in a folder, as they do not find that of a script beside it."""

    folder: str
    module: str
    name: str

    def __call__(self, *given: Any) -> Any:
        if self.folder not in sys.path:
            sys.path.append(self.folder)
        return getattr(importlib.import_module(self.module), self.name)(*given)


def each(engine: Engine, work: Callable[[Job], Result], jobs: Iterable[Job]) -> Iterator[tuple[Job, Result]]:
    """Jobs with their results, as they are done.

    A job whose Dask worker dies is done by another one. Raises InputError where the scheduler is lost.
    """
    with engine.executor() as pool:
        futures = {pool.submit(work, job): job for job in jobs}
        for future in as_completed(futures):
            try:
                done = future.result()
            except Exception as error:
                if engine.name == "dask" and _lost(error):
                    raise InputError(f"{_where(engine)} is lost; the same command goes on with what is left") from None
                raise
            yield futures[future], done


@contextmanager
def _client(engine: Engine) -> Iterator[Any]:
    """A client of the scheduler, or of a cluster of this machine's own."""
    if importlib.util.find_spec("distributed") is None:
        raise InputError("engine=dask needs distributed, which is not installed: pip install 'vehicle_sbi[dask]'")
    from distributed import Client, LocalCluster

    for name in [name for name in logging.root.manager.loggerDict if name.startswith(("distributed", "tornado"))]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what matters is said in one line
    if engine.scheduler is None:
        with LocalCluster(n_workers=engine.workers, **OWN_CLUSTER) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(engine.scheduler, timeout=CONNECTED_S)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler = {engine.scheduler}: nothing answers there ({_first_line(error)})") from None
    try:
        yield client
    finally:
        client.close(timeout=1.0)


def _lost(error: Exception) -> bool:
    """Whether Dask has failed, rather than the job."""
    return isinstance(error, CancelledError | OSError) or type(error).__module__.startswith(("distributed", "tornado"))


def _where(engine: Engine) -> str:
    return "the local cluster" if engine.scheduler is None else f"the scheduler {engine.scheduler}"


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
