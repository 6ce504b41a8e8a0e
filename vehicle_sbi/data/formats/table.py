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
from jaxtyping import Bool, Float

from vehicle_sbi.data.formats.dates import seconds
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
        column = self._column(name)
        if column.dtype.kind == "M":
            raise InputError(f"{self.path}: column '{self.spelled(name)}' holds dates; it must hold numbers")
        values = pd.to_numeric(column, errors="coerce")
        self._check_all(name, column, values.notna().to_numpy(), "number")
        numbers = values.to_numpy(dtype=float, na_value=np.nan)
        return np.where(np.isfinite(numbers), numbers, np.nan)

    def dates(self, name: str) -> Float[np.ndarray, " rows"] | None:
        """A column of dates in seconds since the epoch [s], NaN where empty; None for a column of anything else."""
        column = self._column(name)
        found = seconds(column)
        if found is not None:
            self._check_all(name, column, np.isfinite(found), "date")
        return found

    def _column(self, name: str) -> pd.Series:
        """A column as it stands in the file; InputError if there is none of this name."""
        found = self.spelled(name)
        if found is None:
            raise unknown("column", name, [str(column) for column in self.columns], str(self.path))
        return pd.Series(self.columns[found])

    def _check_all(self, name: str, column: pd.Series, good: Bool[np.ndarray, " rows"], kind: str) -> None:
        """Raise InputError for the first row that is neither good nor empty."""
        wrong = np.flatnonzero(~good & column.notna().to_numpy())
        if len(wrong):
            where = f"{self.path}: row {wrong[0] + self.first_row}, column '{self.spelled(name)}'"
            raise InputError(f"{where}: '{column.iloc[wrong[0]]}' is no {kind}")


def no_times(table: Table) -> InputError:
    """What to say where no column is known to hold the times."""
    listed = ", ".join(list(map(str, table.columns))[:12])
    return InputError(
        f"{table.path}: no column of times is recognised among {listed}; name it with recording.time=COLUMN"
    )


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
