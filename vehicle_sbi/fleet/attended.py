"""A script in a process of its own that ends with the one that has started it, however that one ends.

    python attended.py SCRIPT WORD …

Its standard input is a pipe from there: when nobody holds the other end any more, it is at an end. This file imports
nothing of the package, so that it also starts scripts of another checkout.
"""

import os
import runpy
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
ROOT = Path(__file__).resolve().parents[2]


def attended(
    script: Path, words: Sequence[str], log: Path, timeout_s: float, *, tree: Path | None = None
) -> int | None:
    """Exit status of a script, with one thread, what it prints in `log`; None where it took too long.

    It runs where this process does; one of another checkout, a `tree`, runs there with that one's modules.
    """
    environment = (
        os.environ | ONE_THREAD | {"PYTHONPATH": str(tree or ROOT), "HYDRA_FULL_ERROR": "0"}
    )  # a line, no traceback
    command = [sys.executable, __file__, str(script), *words]
    with log.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(command, cwd=tree, stdin=subprocess.PIPE, stdout=file, stderr=file, env=environment)
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            file.write(f"stopped after {timeout_s:g} s\n")
            return None
        finally:
            process.kill()
            process.wait()


def _leave_with_parent() -> None:
    os.read(0, 1)  # without a lock of Python's own, which would be missed at its end
    os._exit(1)


def main() -> None:
    script = Path(sys.argv[1])
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    sys.argv = sys.argv[1:]
    sys.path[0] = str(script.parent)
    runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
