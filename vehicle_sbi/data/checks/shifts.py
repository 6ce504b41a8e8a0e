"""Shifts: two channels that are one motion, seconds apart.

c(lag) is the correlation of y(t + lag) with x(t). A shift is said where c at some lag is high, and low as recorded.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.checks.drive import ALIKE, LEAST, STEERINGS, Drive, Finding

LONGEST_S = 10.0  # [s] of the lags that are tried
STEP_S = 0.05  # [s] between them, a tenth of what the series are smoothed over
SENSORS_S = 0.3  # [s]: filters, buses and GPS delay by less
CAR_S = 0.5  # [s]: with a car's own response, yaw after steering and a_y after yaw by up to 0.2 s at 30 m/s
BETTER, LEFT = 0.2, 0.25  # of correlation that the shift must gain; or part of the unexplained variance that it leaves
EQUAL = 0.01  # of correlation, within which the shortest lag is taken (a periodic drive has many)
OVERLAP = 0.5  # share of the known samples that must still meet


@dataclass(frozen=True)
class Shift:
    """The lag [s] at which y follows x best, and the correlations there and as recorded."""

    lag: float
    correlation: float
    unshifted: float


def shifted(drive: Drive) -> Iterator[Finding]:
    """Channels that follow another with more delay than sensors and the car have, once for each pair of groups."""
    pairs = {
        "a_y": ("yaw_rate", "turning", "v_x times yaw_rate", LEAST["a"], CAR_S),
        "a_x": ("v_x", "gaining", "dv_x/dt", LEAST["a"], SENSORS_S),
        **dict.fromkeys(STEERINGS, ("yaw_rate", "turn", "yaw_rate over v_x", LEAST["steering"], CAR_S)),
    }
    each = {name: shift(drive[name], drive[pair[1]], drive.rate, pair[3]) for name, pair in pairs.items()}
    found = {name: one for name, one in each.items() if one is not None and abs(one.lag) > pairs[name][4]}
    said: set[frozenset[str]] = set()
    for name, one, other, of in _by_cause(found, {name: (pair[0], pair[2]) for name, pair in pairs.items()}):
        groups = drive.recording.group(name), drive.recording.group(other)
        if groups[0] == groups[1] or frozenset(groups) not in said:
            yield Finding(name, "shift", _sentence(name, of, one, groups))
        said.add(frozenset(groups))


def _by_cause(
    found: Mapping[str, Shift], pairs: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, Shift, str, str]]:
    """Channel, shift, and what it is shifted against; the yaw rate where a_y and the steering agree on its shift."""
    turned = [name for name in ("a_y", *STEERINGS) if name in found]
    lags = [found[name].lag for name in turned]
    if "a_y" in turned and len(turned) > 1 and max(lags) - min(lags) < CAR_S:
        mean = -sum(lags) / len(lags)
        yield "yaw_rate", replace(found["a_y"], lag=mean), turned[1], " and ".join(turned)
        found = {name: one for name, one in found.items() if name not in turned}
    for name, one in found.items():
        yield name, one, *pairs[name]


def shift(y: Float[np.ndarray, " time"], x: Float[np.ndarray, " time"], rate: float, least: float) -> Shift | None:
    """How y is shifted against x; None where it is not, or the drive does not tell."""
    every = max(round(STEP_S * rate), 1)
    y, x, step = y[::every], x[::every], every / rate
    known = int((np.isfinite(x) & np.isfinite(y)).sum())
    if known < 2 * LONGEST_S / step or np.nanstd(x) < least:
        return None
    most = round(LONGEST_S / step)
    correlations = np.array([_correlation(y, x, k, OVERLAP * known) for k in range(-most, most + 1)])
    best, now = float(correlations.max()), float(correlations[most])
    better = best - now > BETTER or (now > 0.0 and 1.0 - best**2 < LEFT * (1.0 - now**2))
    if best < ALIKE or now < -ALIKE or not better:  # the second is a sign
        return None
    lags = np.flatnonzero(correlations > best - EQUAL) - most
    nearest = int(lags[np.argmin(np.abs(lags))])
    peak = lags[np.abs(lags - nearest) <= round(1.0 / step)]
    at = int(peak[np.argmax(correlations[peak + most])])
    return Shift(at * step, float(correlations[at + most]), now)


def _correlation(y: np.ndarray, x: np.ndarray, k: int, least: float) -> float:
    """Of y k samples later with x; -1 where too few meet."""
    y, x = (y[k:], x[: len(x) - k]) if k >= 0 else (y[:k], x[-k:])
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < least:
        return -1.0
    x, y = x[both] - x[both].mean(), y[both] - y[both].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0.0 else -1.0


def _sentence(name: str, of: str, found: Shift, groups: tuple[str, str]) -> str:
    how = "after" if found.lag > 0.0 else "before"
    cause = f"do the clocks of {groups[0]} and {groups[1]} differ?" if groups[0] != groups[1] else "is one delayed?"
    return (
        f"{name} comes {abs(found.lag):.2g} s {how} {of} (correlation {found.correlation:.2f}, "
        f"{found.unshifted:.2f} as recorded): {cause}"
    )
