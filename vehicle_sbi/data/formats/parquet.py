"""Apache Parquet, through pyarrow; row numbers count from 1.

A column is read when it is asked for, and only then counts to what a file may unpack to: a logger's file may have
hundreds of constant columns, which take no room in it. A run of equal values takes a few bytes, so the sizes that count
are those of the values: 8 bytes a number, and a text's length as often as it comes. Texts are read as references to a
dictionary first, then written out if they fit. Other columns (lists, records, bytes, long texts) hold no channel and
are not read: a few bytes of them may be gigabytes.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from vehicle_sbi.data.formats.limits import Budget
from vehicle_sbi.data.formats.table import Table, foreign, one_line

NUMBER = 8  # [bytes]


class Columns(Mapping[str, pd.Series]):
    """The columns of a file by their place in its schema, each read when it is asked for and counted once."""

    def __init__(self, path: Path, meta: pq.FileMetaData, schema: pa.Schema, places: Mapping[str, int]) -> None:
        self.path, self.meta, self.schema, self.places = path, meta, schema, places
        self.sizes, self.budget = _sizes(meta), Budget(path)

    def __getitem__(self, name: str) -> pd.Series:
        place = self.places[name]
        texts = [name] if pa.types.is_string(self.schema.field(place).type) else []
        with foreign(self.path, "Parquet"), self._opened(texts) as file:
            is_new = name in self.sizes
            self.budget.take(self.sizes.get(name, 0))
            column = file.reader.read_column(place)
            self.budget.take(_size_of_texts(column) if is_new else 0)
            self.sizes.pop(name, None)
            return _written_out(column).to_pandas()

    def _opened(self, texts: list[str]) -> pq.ParquetFile:
        """The file, with these columns as references to a dictionary."""
        return pq.ParquetFile(self.path, metadata=self.meta, read_dictionary=texts)

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


def read(path: Path) -> tuple[Table, ...]:
    """The file's columns, what pandas called the index among them; InputError if it is not Parquet."""
    with foreign(path, "Parquet"):
        with pq.ParquetFile(path) as file:
            meta, schema = file.metadata, file.schema_arrow
        places = {field.name: i for i, field in enumerate(schema) if _is_read(field.type)}
        columns = Columns(path, meta, schema, places)
    left_out = [one_line(name) for name in schema.names if name not in places]
    notes = (f"{path}: neither numbers nor texts, not read: {', '.join(left_out)}",) if left_out else ()
    return (Table(path=path, columns=columns, time="time_s", notes=notes),)


def _is_read(kind: pa.DataType) -> bool:
    """Whether a column holds numbers, times or truth values of a few bytes each, or plain texts."""
    read = pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_temporal, pa.types.is_string
    return any(is_one(kind) for is_one in read)


def _sizes(meta: pq.FileMetaData) -> dict[str, int]:
    """What each column unpacks to [bytes], texts as references."""
    sizes: dict[str, int] = {}
    for group in map(meta.row_group, range(meta.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            size = NUMBER * column.num_values + column.total_uncompressed_size
            sizes[column.path_in_schema] = sizes.get(column.path_in_schema, 0) + size
    return sizes


def _size_of_texts(column: pa.ChunkedArray) -> int:
    """What a dictionary's texts take where they are written out in the place of references to them [bytes]."""
    if not pa.types.is_dictionary(column.type):
        return 0
    lengths = [pc.call_function("binary_length", [chunk.dictionary]).take(chunk.indices) for chunk in column.chunks]
    return sum(pc.call_function("sum", [one]).as_py() or 0 for one in lengths)


def _written_out(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """A column with its dictionary's texts in the place of references to them."""
    return column.cast(column.type.value_type) if pa.types.is_dictionary(column.type) else column
