"""Apache Parquet, through pyarrow; row numbers count from 1."""

from pathlib import Path

import pandas as pd

from vehicle_sbi.data.formats.table import Table
from vehicle_sbi.errors import InputError


def read(path: Path) -> tuple[Table, ...]:
    """The file's columns; InputError if it is not Parquet."""
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {(str(error).splitlines() or [''])[0]}") from error
    return (Table(path=path, columns={str(name): frame[name] for name in frame}, time="time_s"),)
