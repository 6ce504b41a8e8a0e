"""Dates and times of day as seconds since the epoch, 1970-01-01 00:00 UTC; those without a time zone count as UTC."""

import re

import numpy as np
import pandas as pd
from jaxtyping import Float

ISO_8601 = re.compile(r"\d{4}-?\d{2}-?\d{2}[T ]\d{2}.*")
"""How a date with a time of day begins, as ISO 8601 writes it."""


def seconds(column: pd.Series) -> Float[np.ndarray, " rows"] | None:
    """The seconds [s] that dates or durations stand for, NaN where there is none; None for a column of neither.

    A column of texts holds dates if its first text is one.
    """
    if column.dtype.kind == "m":
        return column.to_numpy() / np.timedelta64(1, "s")
    dates = column if column.dtype.kind == "M" else _read(column)
    if dates is None:
        return None
    in_utc = dates if dates.dt.tz is None else dates.dt.tz_convert("UTC").dt.tz_localize(None)
    return (in_utc.to_numpy() - np.datetime64(0, "s")) / np.timedelta64(1, "s")


def _read(column: pd.Series) -> pd.Series | None:
    """Texts as dates in UTC, None unless the first is a date."""
    filled = column.dropna()
    if not len(filled) or not ISO_8601.fullmatch(str(filled.iloc[0]).strip()):
        return None
    texts = column.astype("string").str.strip().str.replace(",", ".")  # the decimal mark of seconds may be a comma
    return pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
