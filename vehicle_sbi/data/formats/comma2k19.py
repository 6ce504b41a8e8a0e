"""comma2k19 (Schafer et al. 2018): the folder `processed_log` of a segment, whose logs are pairs of numpy arrays.

`CAN/speed/t` and `CAN/speed/value` are files in numpy's format; objects (pickles) in them are not read. Rows of several
values become `IMU/gyro.0`, `.1`, `.2`: forward, right, down; wheel speeds front left, front right, rear left, right.
"""

from pathlib import Path

import numpy as np

from vehicle_sbi.data.formats.table import Table, foreign
from vehicle_sbi.errors import InputError

UNITS = {
    "CAN/speed": "m/s", "CAN/car_speed": "m/s", "CAN/steering_angle": "deg",
    "CAN/wheel_speed": "m/s", "CAN/wheel_speeds": "m/s",
    "IMU/accelerometer": "m/s²", "IMU/acceleration": "m/s²", "IMU/gyro": "rad/s", "IMU/gyro_uncalibrated": "rad/s",
}  # fmt: skip
"""What the data set's README states."""

MOST_VALUES = 16
"""Values a row at most; raw CAN and satellite measurements have other shapes and are left out."""


def read(path: Path) -> tuple[Table, ...]:
    """A table a log; InputError if an array is damaged or none of them is a log of numbers."""
    tables = [table for folder in sorted(path.glob("*/*")) if (table := _log(path, folder)) is not None]
    if not tables:
        raise InputError(f"{path}: no log of comma2k19 is in it, which is a folder with the files `t` and `value`")
    return tuple(tables)


def _log(path: Path, folder: Path) -> Table | None:
    """The table of one log, None if it is no log of numbers."""
    if not (folder / "t").is_file() or not (folder / "value").is_file():
        return None
    name = folder.relative_to(path).as_posix()
    t, values = (_array(folder / file) for file in ("t", "value"))
    if values.ndim > 2 or values.dtype.kind not in "biuf" or t.dtype.kind not in "iuf":
        return None
    if t.ndim != 1 or len(t) != len(values):
        raise InputError(f"{folder}: {len(t)} times for {len(values)} values (is the file truncated?)")
    values = values.reshape(len(values), -1)
    if values.shape[1] > MOST_VALUES:
        return None
    names = [name] if values.shape[1] == 1 else [f"{name}.{i}" for i in range(values.shape[1])]
    columns = dict(zip(names, values.T, strict=True))
    units = dict.fromkeys(names, UNITS[name]) if name in UNITS else {}
    return Table(path=path, columns={"t": t, **columns}, time="t", clock=name, units={"t": "s", **units})


def _array(path: Path) -> np.ndarray:
    with foreign(path, "a numpy array"):
        return np.array(np.load(path, mmap_mode="r", allow_pickle=False))  # mapped: a file shorter than it says is seen
