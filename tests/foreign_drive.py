"""One drive, known at every time, for files in foreign units, signs and clocks, and what reading may cost it."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError

DRIVE: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "steering": lambda t: 0.05 * np.sin(1.5 * t),
    "v_x": lambda t: 20.0 + 2.0 * np.sin(0.5 * t),
    "yaw_rate": lambda t: 0.3 * np.sin(1.5 * t - 0.1),
    "a_y": lambda t: 6.0 * np.sin(1.5 * t - 0.05),
    "a_x": lambda t: np.cos(0.5 * t),
}
CURVATURE = {"steering": 0.05 * 1.5**2, "v_x": 2.0 * 0.5**2, "yaw_rate": 0.3 * 1.5**2, "a_y": 6.0 * 1.5**2, "a_x": 0.25}
"""The largest second derivatives, in 1/s^2 of each channel's unit."""


def assert_is_the_drive(recording: Recording, steps: Mapping[str, float], rounding: float = 1e-6) -> None:
    """Linear interpolation between samples h apart errs by at most h^2/8 max|f''|; `rounding` is the file's own."""
    assert set(recording.channels) == set(steps)
    for name, step in steps.items():
        values, valid = recording.channels[name], recording.valid[name]
        assert valid.mean() > 0.95, name
        most = 1.05 * step**2 / 8.0 * CURVATURE[name] + rounding
        np.testing.assert_allclose(values[valid], DRIVE[name](recording.t)[valid], rtol=0.0, atol=most, err_msg=name)


def refused(path: Path, match: str | None = None, **settings: object) -> None:
    """Reading ends in one line that names the file."""
    with pytest.raises(InputError, match=match) as error:
        RecordingFile(path=path, **settings).load()  # pyright: ignore[reportArgumentType]
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 2000


def read_or_refused(path: Path, **settings: object) -> Recording | None:
    """The recording, or None where reading ends in one line: either is right."""
    try:
        return RecordingFile(path=path, **settings).load()  # pyright: ignore[reportArgumentType]
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    return None


def cut_at(path: Path, shares: Sequence[float]) -> list[Path]:
    """Copies of a file that end early."""
    data = path.read_bytes()
    copies = []
    for share in shares:
        copy = path.with_name(f"cut_{int(1000 * share)}{path.suffix}")
        copy.write_bytes(data[: int(share * len(data))])
        copies.append(copy)
    return copies


def damaged(path: Path, copies: int = 12, bytes_each: int = 30, **settings: object) -> None:
    """Reading copies with wrong bytes in them gives a recording or one line, within 5 s each."""
    data, rng = path.read_bytes(), np.random.default_rng(0)
    for k in range(copies):
        broken = bytearray(data)
        for place in rng.integers(0 if k % 4 == 0 else 64, len(data), bytes_each):
            broken[place] = rng.integers(256)
        copy = path.with_name(f"damaged_{k}{path.suffix}")
        copy.write_bytes(broken)
        began = time.perf_counter()
        read_or_refused(copy, **settings)
        assert time.perf_counter() - began < 5.0


PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(256)) * 8
