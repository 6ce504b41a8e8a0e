"""Ctrl-C and SIGTERM at any moment, while libraries are imported too: one line, and the status that a shell expects.

Libraries can turn an interruption into an error of their own, or lose it. It is therefore noted as it comes, and comes
again with the next module that is imported.
"""

import _thread
import atexit
import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType, TracebackType
from typing import NoReturn

LINE = "interrupted; the same command continues from what is already on disk"
INTERRUPTED, TERMINATED = 128 + signal.SIGINT, 128 + signal.SIGTERM
AGAIN_S = 0.05  # [s] until an interruption that was lost comes again
PATIENCE_S = 1.0  # [s] for what has to be done as a process ends

_came: list[KeyboardInterrupt] = []


class Terminated(KeyboardInterrupt):
    """The process was asked to end; what is being written is finished or removed, as after Ctrl-C."""


class _Finder:
    """Finds no module, but is asked for each: an interruption that was lost is raised again."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if _came and threading.current_thread() is threading.main_thread():
            raise _came[-1]


def status(error: BaseException) -> int:
    """The exit status after an interruption."""
    return TERMINATED if isinstance(error, Terminated) else INTERRUPTED


def listen() -> None:
    """Take SIGTERM for an interruption, and keep tracebacks of interruptions from the screen."""
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # it is ignored in a job in the background
        signal.signal(signal.SIGINT, _interrupt)
    sys.meta_path.insert(0, _Finder())
    sys.excepthook = _hook
    sys.unraisablehook = _hook_of_the_ignored


def behind(error: BaseException) -> KeyboardInterrupt | None:
    """The interruption that has led to an error; None where there was none."""
    if isinstance(error, KeyboardInterrupt):
        return error
    return _came[-1] if _came else None


def leave(error: KeyboardInterrupt) -> NoReturn:
    """Print the line and end the process, once all that was open is closed.

    Python would wait for threads, which can compute for long. Processes that were started end with this one.
    """
    _came.clear()
    print(LINE, file=sys.stderr, flush=True)
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, signal.SIG_IGN)
    limit = threading.Timer(PATIENCE_S, os._exit, [status(error)])
    limit.daemon = True
    limit.start()
    try:
        with suppress(OSError, ValueError):  # nobody reads, or it is closed
            sys.stdout.flush()
        if "multiprocessing" in sys.modules:
            for process in sys.modules["multiprocessing"].active_children():
                process.kill()
        atexit._run_exitfuncs()
    finally:
        os._exit(status(error))


def _interrupt(signum: int, frame: FrameType | None) -> None:
    error = Terminated() if signum == signal.SIGTERM else KeyboardInterrupt()
    _came.append(error)
    raise error


def _hook(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
    interruption = behind(error)
    if interruption is None:
        sys.__excepthook__(kind, error, at)
        return
    leave(interruption)


def _hook_of_the_ignored(ignored: "sys.UnraisableHookArgs") -> None:
    """Have an interruption come again that was raised where Python ignores errors, as in callbacks."""
    if not isinstance(ignored.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(ignored)
        return
    signum = status(ignored.exc_value) - 128
    again = threading.Timer(AGAIN_S, _thread.interrupt_main, [signum])
    again.daemon = True
    again.start()
