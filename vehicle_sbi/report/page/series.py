"""Windows of recordings as series over one time: what was recorded, what models make of it."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.report.page.charts import Series

Signals = Float[np.ndarray, "channels time"]


def series(
    windows: Windows,
    curves: Mapping[str, Signals],
    *,
    band: tuple[Signals, Signals] | None = None,
    places: Mapping[str, list[tuple[float, float]]] | None = None,
) -> Series:
    """Curves where something was measured, over the time of the recording, or of several one after another."""
    kept, (t, starts) = windows.valid.any(axis=0), _time(windows)

    def shown(signals: Signals) -> Signals:
        return np.where(windows.valid, signals, np.nan)[:, kept]

    return Series(
        t=t[kept],
        channels=windows.channels,
        units=[CHANNELS[name].unit for name in windows.channels],
        curves={name: shown(curve) for name, curve in curves.items()},
        band=None if band is None else (shown(band[0]), shown(band[1])),
        places=places or {},
        starts=[(max(at, float(t[kept].min())), name) for at, name in starts],  # after the warm-up
    )


def _time(windows: Windows) -> tuple[Float[np.ndarray, " time"], list[tuple[float, str]]]:
    """Time of each sample [s], and when which of several recordings begins."""
    clock = windows.clock
    named = [] if windows.alone else zip(windows.recordings[::-1], clock[::-1, 0], strict=True)
    starts = {name: float(first) for name, first in named}
    return clock.reshape(-1), [(at, name) for name, at in reversed(starts.items())]
