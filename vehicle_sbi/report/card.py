"""What a recording could show of the effects that are not fitted, as a table and in words."""

from collections.abc import Collection

import pandas as pd

from vehicle_sbi.inference.information import POWER
from vehicle_sbi.mismatch.design.identifiability import TAKING, Candidate, Card

LEGEND = (
    f"smallest size seen: how far off its null an effect is detected with a power of {POWER:.0%}; not absorbed: the "
    f"share of what it does that the fitted parameters leave; absorbed by: those that take {TAKING:.0%} of it or more. "
    "Beside others: seen only where other effects are there too, or the base parameters are elsewhere."
)


def could_show(seen: Card, beside: Collection[str] = ()) -> pd.DataFrame:
    """A row of text for each parameter that an effect acts by: whether and from which size it would show alone, or
    only beside others, and what absorbs it until then."""

    def visible(one: Candidate) -> str:
        return "yes" if one.visible else "beside others" if one.effect in beside else "no"

    return pd.DataFrame(
        {
            "effect": [c.parameter.name for c in seen.candidates],
            "unit": [c.parameter.unit for c in seen.candidates],
            "visible": [visible(c) for c in seen.candidates],
            "smallest size seen": [c.least if c.visible else "" for c in seen.candidates],
            "not absorbed": [f"{c.retained:.0%}" for c in seen.candidates],
            "absorbed by": [", ".join(c.absorbers) for c in seen.candidates],
        }
    )


def hidden(seen: Card) -> list[str]:
    """What the table does not say: effects that hang together, and those that cannot act here."""
    said = [f"Not told apart: {', '.join(group)}." for group in seen.groups()]
    why: dict[str, list[str]] = {}
    for name, reason in seen.cannot_act.items():
        why.setdefault(reason, []).append(name)
    return [*said, *(f"Cannot act here: {', '.join(names)} ({reason})." for reason, names in why.items())]
