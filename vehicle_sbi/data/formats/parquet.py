"""Apache Parquet, through pyarrow; row numbers count from 1.

A run of equal values takes a few bytes, so the sizes that count are those of the values: 8 bytes a number, and a text's
length as often as it comes. Texts are read as references to a dictionary first, then written out if they fit. Other
columns (lists, records, bytes, long texts) hold no channel and are not read: a few bytes of them may be gigabytes.
"""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from vehicle_sbi.data.formats.limits import Budget
from vehicle_sbi.data.formats.table import Table, foreign, one_line

NUMBER = 8  # [bytes]


def read(path: Path) -> tuple[Table, ...]:
    """The file's columns; InputError if it is not Parquet, or unpacks to too much."""
    with foreign(path, "Parquet"):
        with pq.ParquetFile(path) as file:
            meta, schema = file.metadata, file.schema_arrow
        read = [field.name for field in schema if _is_number(field.type) or pa.types.is_string(field.type)]
        frame = _frame(path, meta, read, [name for name in read if pa.types.is_string(schema.field(name).type)])
    left_out = [one_line(name) for name in schema.names if name not in read]
    notes = (f"{path}: neither numbers nor texts, not read: {', '.join(left_out)}",) if left_out else ()
    return (Table(path=path, columns={str(name): frame[name] for name in frame}, time="time_s", notes=notes),)


def _is_number(kind: pa.DataType) -> bool:
    """Whether a column holds numbers, times or truth values of a few bytes each."""
    plain = pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_temporal
    return any(is_one(kind) for is_one in plain)


def _frame(path: Path, meta: pq.FileMetaData, read: Sequence[str], texts: Sequence[str]) -> pd.DataFrame:
    """The columns that are read, some of them texts; what pandas called the index is one of them."""
    budget = Budget(path)
    for group in map(meta.row_group, range(meta.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            if column.path_in_schema in read:
                budget.take(NUMBER * column.num_values + column.total_uncompressed_size)
    with pq.ParquetFile(path, read_dictionary=list(texts)) as file:
        return _written_out(file.read(columns=list(read)), budget).to_pandas(ignore_metadata=True)


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
