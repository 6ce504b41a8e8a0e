"""MATLAB files up to version 7, through scipy: structs of vectors, each with its own vector of time.

A table is what one struct (or the workspace) holds of vectors as long as its time: `time`, `t`, `Time` …. Fields of
structs are joined by dots. Simulink's "structure with time" is read too. Objects (timeseries, functions) are left out:
nothing of a file is evaluated.
"""

import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from vehicle_sbi.data.formats.limits import Budget, Zlib
from vehicle_sbi.data.formats.table import Table, foreign, one_line
from vehicle_sbi.errors import InputError

TIMES = ("time_s", "time", "t", "timestamp", "timestamps", "tout")
"""Names of a vector of time, whatever their case."""

DEEPEST = 8
HEADER, COMPRESSED = 128, 15


def read(path: Path) -> tuple[Table, ...]:
    """A table a vector of time; InputError if the file is of version 7.3, damaged, or holds no time."""
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty")
    if b"MATLAB 7.3" in path.open("rb").read(128):
        raise InputError(f"{path}: is a MATLAB 7.3 file (HDF5), which is not read: save it with save(…, '-v7')")
    with foreign(path, "a MATLAB file"):
        _check_unpacked(path)
        content = loadmat(path, simplify_cells=True, chars_as_strings=True)
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    tables = tuple(_tables(path, "", variables, 0))
    if not tables:
        raise InputError(
            f"{path}: no vectors with a time of their length; a vector of time is called {', '.join(TIMES)}; "
            f"the file holds {one_line(', '.join(variables)) or 'nothing'}"
        )
    return tables


def _check_unpacked(path: Path) -> None:
    """Raise InputError if the compressed variables (MAT-File Format, version 5: elements of type 15) hold too much."""
    budget = Budget(path)
    with path.open("rb") as file:
        head = file.read(HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(head[-2:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                file.seek(size, os.SEEK_CUR)
                continue
            budget.count(file.read(size), Zlib)


def _tables(path: Path, name: str, fields: Mapping[str, Any], depth: int) -> Iterator[Table]:
    """The table of this struct's own time, then those of the structs in it."""
    vectors = {_joined(name, key): vector for key, value in fields.items() if (vector := _vector(value)) is not None}
    vectors |= dict(_signals(name, fields.get("signals")))
    time = next((key for wanted in TIMES for key in vectors if key.rpartition(".")[2].lower() == wanted), None)
    if time is not None:
        same = {key: vector for key, vector in vectors.items() if len(vector) == len(vectors[time])}
        if len(same) > 1:
            yield Table(path=path, columns=same, time=time, clock=name)
    if depth < DEEPEST:
        for key, value in fields.items():
            if isinstance(value, Mapping):
                yield from _tables(path, _joined(name, key), value, depth + 1)


def _signals(name: str, signals: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Columns of Simulink's `signals`, by their labels."""
    listed = [signals] if isinstance(signals, Mapping) else signals
    for i, signal in enumerate(listed if isinstance(listed, list | np.ndarray) else []):
        if not isinstance(signal, Mapping):
            continue
        values = signal.get("values")
        label = str(signal.get("label") or f"signals{i + 1}")
        if isinstance(values, np.ndarray) and values.dtype.kind in "biuf" and values.ndim == 2:
            yield from ((_joined(name, f"{label}.{k}"), column) for k, column in enumerate(values.T))
        elif (vector := _vector(values)) is not None:
            yield _joined(name, label), vector


def _vector(value: Any) -> np.ndarray | None:
    """A vector of real numbers, None if it is anything else."""
    if isinstance(value, MatlabOpaque | MatlabFunction) or not isinstance(value, np.ndarray):
        return None
    flat = value.ravel() if value.size == max(value.shape, default=0) else None
    return flat if flat is not None and flat.dtype.kind in "biuf" and len(flat) > 1 else None


def _joined(name: str, key: str) -> str:
    return f"{name}.{one_line(key)}" if name else one_line(key)
