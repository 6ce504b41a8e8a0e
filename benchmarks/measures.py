"""Measures of a benchmark's page: what each case adds to a statistic, and its interval by a bootstrap over cases."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Case = TypeVar("Case")
DRAWS, LEVEL = 1000, 0.9  # of the bootstrap over cases, and its intervals'


@dataclass(frozen=True)
class Measure(Generic[Case]):
    """A row: what each case adds to a statistic over all cases; what would be good, and the aim."""

    label: str
    of: Callable[[Case], np.ndarray]
    statistic: Callable[[np.ndarray], float]
    good: str = ""
    aim: str = ""


def mean(x: np.ndarray) -> float:
    return float(np.mean(x))


def median(x: np.ndarray) -> float:
    return float(np.median(x))


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def listed(*values: float | None) -> np.ndarray:
    return np.array([v for v in values if v is not None], dtype=float)


def shown(measure: Measure[Case], cases: Sequence[Case]) -> str:
    """Value, 90 % interval by a bootstrap over cases, and the number of values, as `0.86 (0.79 to 0.91; 52)`."""
    parts = [part for one in cases if len(part := np.asarray(measure.of(one), dtype=float))]
    if not parts:
        return ""
    rng, drawn = np.random.default_rng(0), []
    for _ in range(DRAWS):
        drawn.append(measure.statistic(np.concatenate([parts[i] for i in rng.integers(0, len(parts), len(parts))])))
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    whole = np.concatenate(parts)
    value, digits = measure.statistic(whole), 3 if abs(high) < 0.2 else 2 if abs(high) < 10 else 1
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f}; {len(whole)})"


def by_all(found: Mapping[str, Mapping[int, Case]], cases: Sequence[int]) -> tuple[list[int], dict[str, list[int]]]:
    """The cases that every diagnosis has answered, and those that each has not."""
    unanswered = {name: [i for i in cases if i not in one] for name, one in found.items()}
    return [i for i in cases if all(i in one for one in found.values())], unanswered


def without_answer(cases: Mapping[str, Sequence[int]]) -> str:
    """A sentence on the cases that each diagnosis has not answered, which are in no row."""
    told = [f"{name} {len(which)} ({', '.join(map(str, which))})" for name, which in cases.items() if which]
    return f"Without an answer, and so in no row: {'; '.join(told)}." if told else "Every case was answered."
