"""The windows of a long recording that tell most of the parameters, as many as a budget allows.

Given the parameters theta, windows are independent: information adds up. With F_w that of window w about theta, its
initial state marginalised, in units of the prior, the windows in a set S are chosen one after another so that

    log det(I + sum of F_w over S)

grows most, the information of a Gaussian prior and posterior. It is submodular, so what is reached is at least 1 - 1/e
of the best (Nemhauser, Wolsey and Fisher, Mathematical Programming 14, 1978; Krause, Singh and Guestrin, JMLR 9, 2008).
F_w is taken at the prior's centre, from what drives the car, where each window starts, and the sensors' noise. How the
car answered has no part in it, so that choosing does not bias what is inferred.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.information import fisher
from vehicle_sbi.inference.simulator import Simulator

MOST_DERIVATIVES = 2**24  # readings times parameters and initial states, which a fit holds in memory several times


@dataclass(frozen=True)
class Chosen:
    """Windows in the order of time, and what they leave of the spread that all windows together would."""

    which: Int[np.ndarray, " k"]
    wider: Float[np.ndarray, " d"]

    def sentence(self, windows: Windows, most_readings: int) -> str:
        """How many windows were used of how many, and what the others would bring."""
        used, count = len(self.which), len(windows.t)
        seconds, another = used * windows.t.shape[1] / windows.rate, (used + 1) * (windows.y.size // count)
        room = "memory holds no more initial states: a longer window_s has fewer"
        limit = f"most_readings = {most_readings}" if another > most_readings else room
        return (
            f"{used} of {count} windows ({seconds:.0f} s) were used, those that tell most of the parameters ({limit}). "
            f"At the prior's centre all windows would make standard deviations {float(np.median(self.wider)):.1f} "
            "times smaller, as a median over parameters."
        )


def affordable(windows: int, most_readings: int, *, readings: int, states: int, d: int) -> int:
    """How many of so many windows, of so many readings and uncertain initial states each, hold at most `most_readings`,
    and no more derivatives by those and by d parameters than MOST_DERIVATIVES; at least one."""
    counts = np.arange(1, windows + 1)
    bearable = (counts * readings <= most_readings) & (counts * readings * (d + states * counts) <= MOST_DERIVATIVES)
    return max(1, int(bearable.sum()))


def chosen(simulator: Simulator, count: int) -> Chosen:
    """So many windows of those of a simulator."""
    spread = simulator.space.prior_std
    each = informations(simulator, (simulator.space.low + simulator.space.high) / 2) * np.outer(spread, spread)
    which = most_informative(each, count)
    std = [np.sqrt(np.diag(np.linalg.inv(np.eye(len(spread)) + F.sum(axis=0)))) for F in (each[which], each)]
    return Chosen(which, std[0] / std[1])


def informations(simulator: Simulator, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, "windows d d"]:
    """Of each window about theta, one after another; nothing in a window in which the simulation fails."""
    every = tqdm(range(len(simulator.windows.t)), desc="what windows tell", disable=None, leave=False)
    each = (simulator.only(np.array([w])) for w in every)
    found = np.array([fisher(one, theta) for one in each])
    return np.where(np.isfinite(found).all(axis=(1, 2), keepdims=True), found, 0.0)


def most_informative(each: Float[np.ndarray, "windows d d"], count: int) -> Int[np.ndarray, " k"]:
    """So many windows, in the order of time, by their information in units of the prior; of equals the earlier one."""
    total, left, taken = np.eye(each.shape[1]), np.arange(len(each)), list[int]()
    for _ in range(min(count, len(each))):
        best = int(np.argmax(np.linalg.slogdet(total + each[left])[1]))
        taken.append(int(left[best]))
        total, left = total + each[left[best]], np.delete(left, best)
    return np.sort(np.array(taken, dtype=int))
