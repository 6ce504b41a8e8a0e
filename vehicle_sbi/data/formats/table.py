"""A table: the columns that a file holds on one clock, as they stand there. What a column means is for `readers`."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.errors import InputError, unknown

NO_UNITS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns on one clock, by the names that the file's makers gave them.

    `clock` names the source (a ROS topic, an MDF group, a CAN message; "" where the file has a single one), `units`
    holds the file's own unit of a column where it states one, `time` names the usual time column and `first_row` is
    the number of the first data row for messages. `notes` says what was done to the clock, or what was left out.
    """

    path: Path
    columns: Mapping[str, Any]
    time: str
    first_row: int = 1
    clock: str = ""
    units: Mapping[str, str] = field(default_factory=lambda: NO_UNITS)
    notes: tuple[str, ...] = ()

    def has(self, name: str) -> bool:
        return self.spelled(name) is not None

    def spelled(self, name: str) -> str | None:
        """The column's name as the file spells it, None if there is none; a clock's name may stand before it."""
        spelled = {plain(column): column for column in self.columns}
        return spelled.get(plain(name)) or spelled.get(plain(name.removeprefix(f"{self.clock}/")))

    def unit(self, name: str) -> str:
        """The unit that the file states of a column, "" if it states none."""
        unit = one_line(self.units.get(self.spelled(name) or name, "")).strip()
        return "" if unit in ("-", "--", "#", "none", "None", "n/a") else unit

    def numbers(self, name: str) -> Float[np.ndarray, " rows"]:
        """A column as floats, NaN where empty; trailing blanks and dots of names do not count."""
        found = self.spelled(name)
        if found is None:
            raise unknown("column", name, [str(column) for column in self.columns], str(self.path))
        column = pd.Series(self.columns[found])
        if column.dtype.kind == "M":
            raise InputError(f"{self.path}: column '{found}' holds dates; it must hold numbers")
        values = pd.to_numeric(column, errors="coerce")
        wrong = np.flatnonzero(values.isna() & column.notna())
        if len(wrong):
            row = wrong[0]
            raise InputError(
                f"{self.path}: row {row + self.first_row}, column '{found}': '{column.iloc[row]}' is no number"
            )
        numbers = values.to_numpy(dtype=float, na_value=np.nan)
        return np.where(np.isfinite(numbers), numbers, np.nan)


def plain(name: object) -> str:
    """A column's name without what writers of a format add at its end."""
    return str(name).strip().rstrip(". ")


def one_line(name: object) -> str:
    """A name that a file gives, without what would break a line or a terminal."""
    return "".join(one if one.isprintable() else "�" for one in str(name))


@contextmanager
def foreign(path: Path, kind: str) -> Iterator[None]:
    """What a foreign library makes of a damaged or hostile file, as an InputError in one line.

    Such libraries raise whatever their parsing stumbles over (struct.error, KeyError, AssertionError, zlib.error, …),
    so every Exception is meant here, and only here; what they would log is said in the line already.
    """
    disabled = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read as {kind}: it asks for more memory than there is") from error
    except Exception as error:
        said = (str(error).strip().splitlines() or [""])[0][:200]
        why = one_line(f"{type(error).__name__}{': ' if said else ''}{said}")
        raise InputError(f"{path}: cannot be read as {kind}: {why} (is the file truncated?)") from error
    finally:
        logging.disable(disabled)
