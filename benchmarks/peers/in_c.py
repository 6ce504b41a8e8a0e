"""The C version, compiled for this machine and called through ctypes."""

import ctypes
import subprocess
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).with_name("single_track.c")
FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-shared", "-fPIC")
CONSTANTS = (
    "m", "L", "l_f", "h_cog", "C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r", "mu", "R_f", "C_vert", "I_wf", "I_wr",
    "K",
)  # fmt: skip


class InC:
    """`simulate` of single_track.c."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        library = folder / "single_track.so"
        subprocess.run(["cc", *FLAGS, str(SOURCE), "-o", str(library), "-lm"], check=True)
        self._simulate = ctypes.CDLL(str(library)).simulate

    def __call__(self, records: np.ndarray, v_0: np.ndarray, u: np.ndarray, rate: float, substeps: int) -> np.ndarray:
        """Series (n, 5, time) of records (n,) with initial speeds (n,), driven by u (time, 3)."""
        vehicles = np.ascontiguousarray(np.stack([records[name] for name in CONSTANTS], axis=1), dtype=float)
        v_0, u = np.ascontiguousarray(v_0, dtype=float), np.ascontiguousarray(u, dtype=float)
        y = np.empty((len(records), 5, len(u)))
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (vehicles, v_0, u, y)]
        self._simulate(
            ctypes.c_int(len(records)), pointers[0], pointers[1], ctypes.c_int(len(u)), pointers[2],
            ctypes.c_double(1.0 / rate), ctypes.c_int(substeps), pointers[3],
        )  # fmt: skip
        return y
