"""The whole cars' page: every measure with its interval, for each diagnosis and method side by side."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from measures import Measure, listed, mean, median, rms, shown, without_answer

from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.report.tables.text import markdown
from whole_car.scores import STRONG, Parameters, Scored

BINS = 10  # of stated probabilities
SURE = 0.9  # probability of something unknown, from which names are looked at by themselves
OWN = "this project"


def _share(x: np.ndarray) -> float:
    """Sum of the first column over that of the second."""
    return float(x[:, 0].sum() / x[:, 1].sum())


def calibration(x: np.ndarray) -> float:
    """Mean distance between stated probability and how often it is so, over bins of the probability; (n, 2)."""
    which = np.minimum((x[:, 0] * BINS).astype(int), BINS - 1)
    gap = np.bincount(which, x[:, 0] - x[:, 1], BINS)
    return float(np.abs(gap).sum() / len(x))


def _base(when: str, what: str) -> Callable[[Scored], np.ndarray]:
    def of(one: Scored) -> np.ndarray:
        found: Parameters | None = getattr(one, when)
        return np.zeros(0) if found is None else np.asarray(getattr(found, what), dtype=float)

    return of


def _unknown(outside: bool) -> Callable[[Scored], np.ndarray]:
    return lambda one: listed(one.p_unknown) > NAMED if bool(one.outside) == outside else np.zeros(0)


def _wrong(outside: bool) -> Callable[[Scored], np.ndarray]:
    return lambda one: listed(len(one.wrong)) if bool(one.outside) == outside else np.zeros(0)


def _right(one: Scored) -> np.ndarray:
    """Of each name whether it is right."""
    return np.array([name not in one.wrong for name in one.names], dtype=float)


def _stated(one: Scored) -> np.ndarray:
    """Of each name its probability."""
    return np.array(list(one.names.values()), dtype=float)


def _beside(of: Callable[[Scored], np.ndarray], unknown: bool) -> Callable[[Scored], np.ndarray]:
    """The same of those cases alone that are sure, or not, of something that no effect stands for."""
    return lambda one: of(one) if one.p_unknown is not None and (one.p_unknown > SURE) == unknown else np.zeros(0)


def _doubt(one: Scored) -> float | None:
    """How many of its names a case expects to be wrong; none of those that are sure of all."""
    expected = sum(1.0 - p for p in one.names.values())
    return expected if expected > 0.0 or not one.names else None


BASE = (("before", "base model"), ("after", "after diagnosis"), ("oracle", "oracle"))
MEASURES: tuple[Measure[Scored], ...] = (
    *(
        Measure(f"base parameters: relative error, median, {said}", _base(when, "relative"), median, good, aim)
        for (when, said), good, aim in zip(BASE, ("", "half of before", ""), ("", "0.02", ""), strict=True)
    ),
    *(
        Measure(f"their 90 % intervals hold the truth, {said}", _base(when, "held"), mean, good, aim)
        for (when, said), good, aim in zip(BASE, ("", "0.85", ""), ("", "0.90 ± 0.03", ""), strict=True)
    ),
    *(
        Measure(f"their rms error in own standard deviations, {said}", _base(when, "in_std"), rms, good, aim)
        for (when, said), good, aim in zip(BASE, ("", "1.3", ""), ("", "1.1", ""), strict=True)
    ),
    Measure(
        f"effects with SNR {STRONG:g} beyond all others: inclusion above {NAMED}",
        lambda one: np.array(list(one.strong.values())) > NAMED, mean, "0.80", "0.95",
    ),
    Measure(
        "the same, or of what cannot be told from it",
        lambda one: np.array(list(one.alike.values())) > NAMED, mean,
    ),
    Measure(
        f"names above {NAMED} that are not there, a case", lambda one: listed(len(one.wrong)), mean, "0.3", "0.1"
    ),
    Measure("the same, something outside the catalogue", _wrong(True), mean),
    Measure("the same, nothing outside", _wrong(False), mean),
    Measure("as many as the stated probabilities lead to expect", lambda one: listed(_doubt(one)), mean),
    Measure(f"names above {NAMED}, a case", lambda one: listed(len(one.names)), mean),
    Measure(
        "calibration error of inclusion probabilities above 0", lambda one: one.inclusion[one.inclusion[:, 0] > 0.0],
        calibration, "0.05", "0.03",
    ),
    Measure("the same, of all effects of the catalogue", lambda one: one.inclusion, calibration),
    Measure(
        "sizes of named effects: 90 % intervals hold", lambda one: one.sizes, mean, "0.85", "0.90"),
    Measure(
        "share of the held-out misfit that the oracle removes",
        lambda one: np.array([[one.gained, one.reducible]]) if one.reducible else np.zeros((0, 2)),
        _share, "0.80", "0.95",
    ),
    Measure(
        "extended model accepted", lambda one: listed(None if one.accepted is None else float(one.accepted)), mean
    ),
    Measure(f"p_unknown above {NAMED}, something outside the catalogue", _unknown(True), mean),
    Measure(f"p_unknown above {NAMED}, nothing outside", _unknown(False), mean),
    Measure(f"names that are right, p_unknown above {SURE}", _beside(_right, True), mean),
    Measure("as many as their probabilities state", _beside(_stated, True), mean),
    Measure(f"names that are right, p_unknown up to {SURE}", _beside(_right, False), mean),
    Measure("as many as their probabilities state", _beside(_stated, False), mean),
    Measure("seconds a diagnosis, median", lambda one: listed(one.seconds), median, "45", "15"),
)  # fmt: skip


def compared(columns: Mapping[str, Sequence[Scored]]) -> pd.DataFrame:
    """A row per measure, a column per diagnosis or method."""
    rows = []
    for m in MEASURES:
        cells = {name: shown(m, cases) for name, cases in columns.items()}
        if any(cells.values()):
            rows.append({"measure": m.label, **cells, "good": m.good, "the aim": m.aim})
    return pd.DataFrame(rows)


def wrong_names(columns: Mapping[str, Sequence[Scored]]) -> pd.DataFrame:
    """Of each effect how many of its names are wrong, by whom, and how many their probabilities lead to expect."""
    named = pd.DataFrame(
        [
            (by, effect, effect in one.wrong, 1.0 - p)
            for by, cases in columns.items()
            for one in cases
            for effect, p in one.names.items()
        ],
        columns=["by", "effect", "wrong", "doubt"],
    )
    counts = named.groupby(["effect", "by"]).agg(
        wrong=("wrong", "sum"), named=("wrong", "size"), doubt=("doubt", "sum")
    )
    counts = counts[counts["wrong"] > 0].reset_index()
    counts["said"] = [f"{c.wrong} of {c.named}; {c.doubt:.1f} expected" for c in counts.itertuples()]
    order = (
        counts.groupby("effect")["wrong"].sum().reset_index().sort_values(["wrong", "effect"], ascending=[False, True])
    )
    cells = counts.pivot(index="effect", columns="by", values="said").reindex(order["effect"]).fillna("")
    return cells.reindex(columns=list(columns), fill_value="").rename_axis(columns=None).reset_index()


def missed(columns: Mapping[str, Sequence[Scored]]) -> pd.DataFrame:
    """Of each effect how many that should be named are, or what cannot be told from them."""
    rows: dict[str, dict[str, str]] = {}
    for name, cases in columns.items():
        strong = [(effect, p > NAMED) for one in cases for effect, p in one.alike.items()]
        for effect in sorted({effect for effect, _ in strong}):
            hits = [hit for other, hit in strong if other == effect]
            rows.setdefault(effect, {})[name] = f"{sum(hits)} of {len(hits)}"
    return pd.DataFrame([{"effect": effect, **cells} for effect, cells in rows.items()]).fillna("")


def report(
    columns: Mapping[str, Sequence[Scored]], unanswered: Mapping[str, Sequence[int]], command: str, where: str
) -> str:
    """The page, by which command it was made, and where; cases that a diagnosis gave no answer to are none of it."""
    first = next(iter(columns.values()))
    worlds = pd.Series([one.world for one in first]).value_counts()
    outside = sum(bool(one.outside) for one in first)
    return "\n\n".join(
        [
            "# Whole cars",
            f"`{command}`",
            f"{len(first)} cars ({', '.join(f'{n} {name}' for name, n in worlds.items())}), each with four to nine "
            f"effects at once, {outside} with one more from outside the catalogue; every column over the same cases. "
            "Value (90 % interval by a bootstrap over cases; number of values). What cannot be told from a true effect "
            "(coherence of 0.95 or more after the base parameters) counts as true, and so does what the world has by "
            "itself. The oracle is told which effects are there.",
            without_answer(unanswered),
            markdown(compared(columns)),
            f"## Named above {NAMED}, and not there\n\n{markdown(wrong_names(columns))}",
            f"## Named, or what cannot be told from it, where SNR is {STRONG:g} or more beyond all others\n\n"
            f"{markdown(missed(columns))}",
            where,
        ]
    )


def table(cases: Sequence[Scored]) -> pd.DataFrame:
    """A row per case."""

    def average(values: np.ndarray | None) -> float | None:
        return None if values is None or not len(values) else float(np.mean(values))

    return pd.DataFrame(
        {
            "case": one.case,
            "world": one.world,
            "drive": one.drive,
            "effects": " + ".join(one.truth),
            "outside": one.outside,
            "named": " + ".join(f"{name} {p:.2f}" for name, p in one.names.items()),
            "not there": " + ".join(one.wrong),
            "should be named": len(one.strong),
            "of those named": sum(p > NAMED for p in one.strong.values()),
            **{
                f"{what} {when}": average(None if found is None else getattr(found, key))
                for when in ("before", "after", "oracle")
                for found in (getattr(one, when),)
                for what, key in (("relative error", "relative"), ("interval holds", "held"))
            },
            "sizes hold": average(one.sizes),
            "misfit removed": one.gained / one.reducible if one.reducible else None,
            "accepted": one.accepted,
            "p_unknown": one.p_unknown,
            "seconds": one.seconds,
        }
        for one in cases
    )
