"""Base parameters of a diagnosis: by the base model, and whatever is missing."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from vehicle_sbi.report.tables.text import aligned
from vehicle_sbi.rounding import mean_and_std, rounded

NOT_TOLD = "not identified by these recordings"


def base_for_people(said: Mapping[str, Any]) -> pd.DataFrame:
    """A verdict's `base_parameters` as text: mean ± standard deviation by the base model, and with all that may be
    missing averaged over."""
    return pd.DataFrame([_row(name, values) for name, values in said.items()])


def _row(name: str, values: Mapping[str, Any]) -> dict[str, str]:
    before, after = values["before"], values["after"]
    return {
        "parameter": name,
        "unit": values["unit"],
        "base model": mean_and_std(before["mean"], before["std"]),
        "whatever is missing": mean_and_std(after["mean"], after["std"]),
        "90 %": f"{rounded(after['q05'], after['std'])} to {rounded(after['q95'], after['std'])}",
        "identified": "yes" if values["identified"] else NOT_TOLD,
    }


def terminal(said: Mapping[str, Any]) -> str:
    """The same for a terminal."""
    return "\n".join(aligned(base_for_people(said)))
