"""The page of pairs: what an injected effect changes, for each diagnosis side by side."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from measures import Measure, listed, mean, median, rms, shown, without_answer

from injected.scores import NAMED, Difference
from vehicle_sbi.report.tables.text import markdown

MEASURES: tuple[Measure[Difference], ...] = (
    Measure(f"what was injected, or what cannot be told from it: inclusion above {NAMED}",
            lambda one: listed(float(one.found)), mean),
    Measure("by how much its probability rises", lambda one: listed(one.after - one.before), mean),
    Measure(f"names above {NAMED} that come with it and are not it, a pair", lambda one: listed(len(one.new)), mean),
    Measure(f"names above {NAMED} that go with it, a pair", lambda one: listed(len(one.gone)), mean),
    Measure(f"names above {NAMED} without it, a recording", lambda one: listed(one.names), mean),
    Measure("its size: 90 % intervals of the difference hold", lambda one: one.sizes, mean),
    Measure("base parameters' difference in standard deviations, rms, base model", lambda one: one.moved_base, rms),
    Measure("the same after diagnosis", lambda one: one.moved, rms),
    Measure("seconds a pair, median", lambda one: listed(one.seconds), median),
)  # fmt: skip


def compared(columns: Mapping[str, Sequence[Difference]]) -> pd.DataFrame:
    """A row per measure, a column per diagnosis."""
    return pd.DataFrame(
        [{"measure": m.label, **{name: shown(m, pairs) for name, pairs in columns.items()}} for m in MEASURES]
    )


def report(
    columns: Mapping[str, Sequence[Difference]], unanswered: Mapping[str, Sequence[int]], command: str, where: str
) -> str:
    """The page, by which command it was made, and where; pairs that a diagnosis gave no answer to are none of it."""
    first = next(iter(columns.values()))
    sources = pd.Series([one.source for one in first]).value_counts()
    return "\n\n".join(
        [
            "# Injected into real recordings",
            f"`{command}`",
            f"{len(first)} stretches of real recordings ({', '.join(f'{n} {name}' for name, n in sources.items())}), "
            "each diagnosed as it is and with an effect put into its channels. What the car itself lacks in the model "
            "is not known; scored is the difference. Value (90 % interval by a bootstrap over pairs; number of "
            "values).",
            without_answer(unanswered),
            markdown(compared(columns)),
            where,
        ]
    )


def table(pairs: Sequence[Difference]) -> pd.DataFrame:
    """A row per pair."""
    return pd.DataFrame(
        {
            "case": one.case,
            "source": one.source,
            "effect": one.effect,
            "snr": one.snr,
            "without": one.before,
            "with": one.after,
            "new": " + ".join(one.new),
            "gone": " + ".join(one.gone),
            "sizes hold": float(np.mean(one.sizes)) if len(one.sizes) else None,
            "seconds": one.seconds,
        }
        for one in pairs
    )
