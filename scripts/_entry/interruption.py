"""Ctrl-C and SIGTERM at any moment, while libraries are imported too: one line, and the status that a shell expects."""

import os
import signal
import sys
from types import TracebackType

LINE = "interrupted; the same command continues from what is already on disk"
INTERRUPTED, TERMINATED = 128 + signal.SIGINT, 128 + signal.SIGTERM


class Terminated(KeyboardInterrupt):
    """The process was asked to end; what is being written is finished or removed, as after Ctrl-C."""


def status(error: BaseException) -> int:
    """The exit status after an interruption."""
    return TERMINATED if isinstance(error, Terminated) else INTERRUPTED


def listen() -> None:
    """Take SIGTERM for an interruption, and keep tracebacks of interruptions from the screen."""
    signal.signal(signal.SIGTERM, _terminate)
    sys.excepthook = _hook


def _terminate(signum: int, frame: object) -> None:
    raise Terminated


def _hook(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, at)
        return
    print(LINE, file=sys.stderr, flush=True)
    os._exit(status(error))  # all that was open is closed by now
