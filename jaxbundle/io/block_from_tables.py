"""Making a block from tables in memory: frames, columns as arrays, or files, with the columns of the block folder.

The reader of a block folder makes the same tables from its files. Both ways share all checks and messages. A message
names the table and the row, counted from 1.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from jaxbundle.block.block import Block
from jaxbundle.io.block_folder import block_of
from jaxbundle.io.block_tables import TABLES
from jaxbundle.io.block_toml import FILE, BlockToml, validated
from jaxbundle.io.header import problem_of_columns
from jaxbundle.io.noted import Noted
from jaxbundle.io.schema import TableSchema
from jaxbundle.io.tables import Table, read_table

TableLike = Any  # a polars or pandas frame, a mapping of column names to values, or the path of a CSV file


def block_from_tables(
    tables: Mapping[str, TableLike], sections: Mapping[str, Any], *, check_start: bool = True
) -> Block:
    """Makes the block of tables, named as in [tables] of block.toml, and of the other sections and keys of block.toml.

    Raises: BlockError with all problems.
    """
    noted = Noted(called={FILE: ""})
    raw = {"format": 1, **{key: _plain(value) for key, value in sections.items()}}
    raw["tables"] = {kind: kind for kind in tables}
    toml = validated(raw, "", noted, Path(FILE))
    read: dict[str, Table | None] = {}
    for kind, table in tables.items():
        if kind in TABLES:
            schema = TABLES[kind].in_system(toml.rotation_system)
            if isinstance(table, str | Path):
                read[kind] = read_table(Path(table), schema, noted, toml.half_turn)
            else:
                read[kind] = _table(kind, table, schema, toml, noted)
    return block_of(toml, read, noted, None, check_start=check_start)


def _table(kind: str, columns: TableLike, schema: TableSchema, toml: BlockToml, noted: Noted) -> Table | None:
    """A table of columns as text; None and a note where the columns do not fit the table."""
    noted.files.append(kind)
    series = {str(name): _text(columns[name]) for name in _names(columns)}
    problem = problem_of_columns(list(series), schema, ",".join(series))
    lengths = {len(column) for column in series.values()}
    if not problem and len(lengths) > 1:
        problem = f"the columns have {min(lengths)} to {max(lengths)} rows", "give columns of equal length"
    if not problem and lengths == {0}:
        problem = "the table has no rows", "fill it, or leave it out"
    if problem:
        noted.add(kind, 0, *problem)
        return None
    frame = pl.DataFrame(series).select(pl.all().str.strip_chars())
    return Table(kind, schema, frame, np.arange(1, len(frame) + 1), noted, ",", toml.half_turn)


def _names(columns: TableLike) -> Sequence[Any]:
    return list(columns.keys()) if isinstance(columns, Mapping) else list(columns.columns)


def _text(column: Any) -> pl.Series:
    """A column as text that reads back to the same values; "" for None and NaN."""
    values = column.to_numpy() if hasattr(column, "to_numpy") else np.asarray(column)
    if values.dtype.kind == "f":
        return pl.Series(values.astype(float)).fill_nan(None).cast(pl.String).fill_null("")
    if values.dtype.kind in "iu":
        return pl.Series(values).cast(pl.String)
    return pl.Series(
        ["" if value is None or value != value else str(value) for value in values.tolist()], dtype=pl.String
    )


def _plain(value: Any) -> Any:
    """A value in the types of TOML: dictionaries, lists, text and Python's numbers."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        return [_plain(inner) for inner in value]
    return value
