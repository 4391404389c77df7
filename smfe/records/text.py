"""Text files: traces of machine controls that have a layout of their own, and every other table of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from smfe.records.formats import csv
from smfe.records.formats.controls import traces as controls
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import Column, Format, Table, slices


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a text file; see `smfe.records.read_records`."""
    return controls.read_text(path, wanted) if controls.kind_of_text(path) else csv.read_tables(path, wanted)


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted columns of a text file, `block` rows at a time; a trace of a control is read whole."""
    if controls.kind_of_text(path):
        (table,) = controls.read_text(path, wanted)
        return slices(table, block)
    return csv.read_blocks(path, wanted, block)


def stated_units(path: Path) -> dict[str, str]:
    """Return name of a column -> unit that the file states in its header."""
    return controls.stated_units(path) if controls.kind_of_text(path) else csv.stated_units(path)


FORMAT = format_apart(
    Format(
        (".csv", ".txt", ".dat", ".frf", ".log"),
        read_tables,
        read_blocks,
        stated_units=stated_units,
        needs_time=lambda path: not controls.kind_of_text(path),
    )
)
