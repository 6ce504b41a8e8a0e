"""Failures: a job that meets a wrong value says so in one line, and the other jobs of its sweep run on."""

import os
import sys
from dataclasses import dataclass

reported: list[str] = []
"""The lines that this process has printed; the script's status depends on whether there are any."""


def report(line: str) -> None:
    """Print one line about a wrong value, and remember it."""
    reported.append(line)
    print(f"error: {line}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Failure:
    """What a job that met a wrong value returns, rather than raising.

    Constructed in the process of the script, `script_pid`, it reports its line. A worker's one does so when it is
    unpickled there, which constructs it again: Hydra hands no results back to the script.
    """

    line: str
    script_pid: int

    def __post_init__(self) -> None:
        if os.getpid() == self.script_pid:
            report(self.line)

    def __reduce__(self) -> tuple[type["Failure"], tuple[str, int]]:
        return Failure, (self.line, self.script_pid)
