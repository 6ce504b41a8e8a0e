"""Apache Parquet, through pyarrow; row numbers count from 1.

A run of equal values takes a few bytes, so the sizes that count are those of the values: 8 bytes a number, and a text's
length as often as it comes. Texts are read as references to a dictionary first, then written out if they fit.
"""

from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from vehicle_sbi.data.formats.limits import Budget
from vehicle_sbi.data.formats.table import Table, foreign

NUMBER = 8  # [bytes]


def read(path: Path) -> tuple[Table, ...]:
    """The file's columns; InputError if it is not Parquet, or unpacks to too much."""
    with foreign(path, "Parquet"):
        frame = _frame(path, Budget(path))
    return (Table(path=path, columns={str(name): frame[name] for name in frame}, time="time_s"),)


def _frame(path: Path, budget: Budget) -> pd.DataFrame:
    with pq.ParquetFile(path) as file:
        meta, schema = file.metadata, file.schema_arrow
    for group in map(meta.row_group, range(meta.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            budget.take(NUMBER * column.num_values + column.total_uncompressed_size)
    texts = [field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_binary(field.type)]
    with pq.ParquetFile(path, read_dictionary=texts) as file:
        return _written_out(file.read(), budget).to_pandas()


def _written_out(table: pa.Table, budget: Budget) -> pa.Table:
    """The table with its dictionaries' texts in the place of references to them."""
    for i, field in enumerate(table.schema):
        if not pa.types.is_dictionary(field.type):
            continue
        column = table.column(i)
        for chunk in column.chunks:
            lengths = pc.call_function("binary_length", [chunk.dictionary])
            budget.take(pc.call_function("sum", [lengths.take(chunk.indices)]).as_py() or 0)
        if pa.types.is_binary(field.type.value_type) or pa.types.is_string(field.type.value_type):
            table = table.set_column(i, field.name, column.cast(field.type.value_type))
    return table
