"""A made-up drive that a test can see through, and its windows."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from vehicle_sbi.data.cutting import cut
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.data.windows import Windows

RATE = 100.0


def recording(seconds: float = 20.0, **channels: np.ndarray | float) -> Recording:
    """A made-up drive at 10 m/s whose a_y holds the sample number, so that a window shows what it was cut from."""
    t = np.arange(round(seconds * RATE)) / RATE
    given: Mapping[str, np.ndarray | float] = {
        "steering": 0.01 * np.sin(t),
        "v_x": 10.0,
        "yaw_rate": 0.1 * np.sin(t),
        "a_y": np.arange(len(t), dtype=float),
        **channels,
    }
    values = {name: np.broadcast_to(np.asarray(value, dtype=float), t.shape).copy() for name, value in given.items()}
    return Recording(
        name="made_up",
        rate=RATE,
        t=t,
        channels=values,
        valid={name: np.isfinite(value) for name, value in values.items()},
        groups={"a_y": "can"},
        source="made_up.csv",
    )


def in_windows(rec: Recording, **settings: Any) -> Windows:
    """The drive in windows of 5 s of a_y, driven by its speed, unless `settings` say otherwise."""
    return cut(rec, **{"drive": "speed", "channels": ["a_y"], "length_s": 5.0, "steering_ratio": None, **settings})
