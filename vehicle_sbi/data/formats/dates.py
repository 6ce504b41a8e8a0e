"""Dates and times of day as seconds: those of dates count since 1970-01-01 00:00 UTC, which is their zone if none is
stated; those of a time of day count since the first one's midnight."""

import re

import numpy as np
import pandas as pd
from jaxtyping import Float

ISO_8601 = re.compile(r"\d{4}-?\d{2}-?\d{2}[T ]\d{2}.*")
"""How a date with a time of day begins, as ISO 8601 writes it."""

DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[T ]+(\d{1,2})(:\d{2}.*)")
"""The same with dots, where the day comes first: 31.12.2026 9:05:07,25."""

TIME_OF_DAY = re.compile(r"\d{1,2}:\d{2}:\d{2}([.,]\d*)?")

DAY = 86400.0  # [s]


def seconds(column: pd.Series) -> Float[np.ndarray, " rows"] | None:
    """The seconds [s] that dates, times of day or durations stand for, NaN where there is none; None for anything else.

    A column of texts holds what its first text is.
    """
    if column.dtype.kind == "m":
        return column.to_numpy() / np.timedelta64(1, "s")
    if column.dtype.kind == "M":
        return _since_1970(column)
    filled = column.dropna()
    first = str(filled.iloc[0]).strip() if len(filled) else ""
    if ISO_8601.fullmatch(first):
        return _since_1970(_read(_texts(column)))
    if DAY_FIRST.fullmatch(first):
        return _since_1970(_read(_texts(column).str.replace(DAY_FIRST, _year_first, regex=True)))
    if TIME_OF_DAY.fullmatch(first):
        return _since_midnight(_texts(column))
    return None


def across_midnight(times: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    """Times of day [s] that go on counting where the clock of a day begins anew."""
    steps = np.diff(pd.Series(times).ffill().to_numpy(), prepend=np.nan)
    return times + DAY * np.cumsum(steps < -DAY / 2.0)


def _texts(column: pd.Series) -> pd.Series:
    """The texts without blanks around them; the decimal mark of seconds may be a comma."""
    return column.astype("string").str.strip().str.replace(",", ".")


def _read(texts: pd.Series) -> pd.Series:
    return pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")


def _year_first(found: re.Match[str]) -> str:
    day, month, year, hour, rest = found.groups()
    return f"{year}-{month:0>2}-{day:0>2} {hour:0>2}{rest}"


def _since_1970(dates: pd.Series) -> Float[np.ndarray, " rows"]:
    in_utc = dates if dates.dt.tz is None else dates.dt.tz_convert("UTC").dt.tz_localize(None)
    return (in_utc.to_numpy() - np.datetime64(0, "s")) / np.timedelta64(1, "s")


def _since_midnight(texts: pd.Series) -> Float[np.ndarray, " rows"]:
    times = pd.to_timedelta(texts.where(texts.str.fullmatch(TIME_OF_DAY.pattern).fillna(False)), errors="coerce")
    return across_midnight(times.to_numpy() / np.timedelta64(1, "s"))
