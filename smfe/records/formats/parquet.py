"""Parquet files, read with pyarrow; a row group at most is in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from process.errors import InputError
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import (
    Column,
    Format,
    Table,
    as_numbers,
    damaged,
    find_columns,
    guarded,
    join,
    refuse_oversize,
)

_KIND = "Parquet"
_WHOLE = 1 << 18
_MOST_COMPRESSED = 10_000.0
"""Runs of one value shrink further than deflate would make them."""


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a Parquet file; see `smfe.records.read_records`."""
    return join(read_blocks(path, wanted, _WHOLE))


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted columns of a Parquet file, `block` rows at a time."""
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the file is empty")
    import pyarrow.parquet as parquet  # 45 MB: loaded where a Parquet file is read

    with damaged(path, _KIND), parquet.ParquetFile(path) as file:
        names = [str(name) for name in file.schema_arrow.names]
        at = find_columns(path.name, names, wanted, len(names))
        stated = 8 * int(file.metadata.num_rows) * len(at)
        refuse_oversize(path, stated, path.stat().st_size, _MOST_COMPRESSED)
    return guarded(path, _KIND, _batches(parquet, path, {column: names[index] for column, index in at.items()}, block))


def _batches(parquet: Any, path: Path, names: dict[Column, str], block: int) -> Iterator[Table]:
    # Without these two all row groups are fetched before the first batch comes.
    lazily = {"pre_buffer": False, "buffer_size": 1 << 18}
    with parquet.ParquetFile(path, page_checksum_verification=True, **lazily) as file:
        rows = 0
        empty = True
        for batch in file.iter_batches(block, columns=sorted(set(names.values())), use_threads=False):
            empty = False
            rows += batch.num_rows
            yield Table({column: _numbers(path.name, column, batch.column(name)) for column, name in names.items()})
        if rows != file.metadata.num_rows:
            raise InputError(f"{path.name}: {rows} of the {file.metadata.num_rows} rows that its footer states")
        if empty:
            yield Table({column: np.empty(0) for column in names})


def _numbers(source: str, column: Column, array: Any) -> Any:
    """Return a column as numbers; what is null there is NaN."""
    if array.null_count:
        array = array.cast("float64")
    return as_numbers(source, column, array.to_numpy(zero_copy_only=False))


FORMAT = format_apart(Format((".parquet",), read_tables, read_blocks, needs_time=lambda path: True))
