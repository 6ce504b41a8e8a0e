"""Which mappings that others have written, such as those of conf/mapping, name the columns of a file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from vehicle_sbi.data.inspection.contents import Contents
from vehicle_sbi.data.mapping import Candidates, candidates_of, mapping_file


def fitting(tables: Sequence[Contents], folder: Path) -> list[str]:
    """Names of the mappings in a folder that have a column of this file for every channel that is not optional."""
    names = {name for table in tables for column in table.columns for name in (column.name, column.address)}
    mappings = {path.stem: mapping_file(path) for path in sorted(folder.glob("*.yaml"))}
    return [preset for preset, mapping in mappings.items() if mapping and _names(mapping, names)]


def _names(mapping: Mapping[str, Candidates], columns: set[str]) -> bool:
    """Whether a mapping's channels, but for optional ones, are among these columns, and at least one is."""
    channels = [candidates_of(given, "mapping") for given in mapping.values()]
    there = [any(columns.issuperset(one.columns) for one in candidates) for candidates in channels]
    needed = [not all(one.optional for one in candidates) for candidates in channels]
    return any(there) and all(found or not need for found, need in zip(there, needed, strict=True))
