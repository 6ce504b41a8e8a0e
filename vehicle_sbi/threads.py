"""The cores that this process may use, and the same work for several things beside each other on them.

Such work has to leave Python's lock for most of its time, as simulations and numpy's large arrays do. Linear algebra
and torch get one thread: more of them get in the way of simulations, and add up numbers in another order.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import TypeVar

from numba.core import config
from threadpoolctl import threadpool_limits

from vehicle_sbi.errors import InputError

Thing = TypeVar("Thing")
Result = TypeVar("Result")
AVAILABLE: int = config.NUMBA_NUM_THREADS  # pyright: ignore[reportAttributeAccessIssue]
_used = AVAILABLE


def cores() -> int:
    """How many cores this process may use."""
    return _used


def use_cores(wanted: int | None) -> None:
    """Let this process use so many cores; None: all. Raises InputError for a number this machine does not have."""
    global _used
    wanted = AVAILABLE if wanted is None else wanted
    if not isinstance(wanted, int) or not 1 <= wanted <= AVAILABLE:
        raise InputError(f"engine.cores = {wanted!r}; this machine has 1 to {AVAILABLE}")
    _used = wanted


def algebra_on_one_thread() -> AbstractContextManager[object]:
    """Within it, libraries of linear algebra and OpenMP that are loaded by now use one thread; afterwards as before."""
    return threadpool_limits(1)


def each(work: Callable[[Thing], Result], things: Iterable[Thing]) -> list[Result]:
    """work(thing) of each, in their order, on as many threads as there are cores; raises what any of them raises.

    An interruption does not wait for them: each computes its last thing, and the result is lost.
    What runs on a thread may use all cores as well, so that the last one leaves none idle.
    """
    things = list(things)
    threads = min(cores(), len(things))
    if threads < 2:
        return [work(thing) for thing in things]
    pool, wait = ThreadPoolExecutor(threads), True
    try:
        return list(pool.map(work, things))
    except KeyboardInterrupt:
        wait = False
        raise
    finally:
        pool.shutdown(wait=wait, cancel_futures=True)
