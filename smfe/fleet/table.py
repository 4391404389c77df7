"""The catalogue of a folder of many results: made of the rows of each, in the order of their names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from process.errors import InputError
from smfe.fleet.columns import COLUMNS, schema
from smfe.fleet.rows import ROWS, are_written, read_rows, refused_rows, rows_of, write_rows
from smfe.kept import KEPT
from smfe.results import is_outside, write_atomically

if TYPE_CHECKING:
    import pyarrow as pa

REFUSED = "refused.json"
"""File of `KEPT` that says why a campaign was refused."""


def refuse(folder: Path, campaign: str, reason: str) -> None:
    """Keep why a campaign was refused, for the catalogue; results of an earlier run stay as they are."""
    (folder / KEPT).mkdir(parents=True, exist_ok=True)
    text = json.dumps({"campaign": campaign, "reason": reason})
    write_atomically(folder / KEPT / REFUSED, lambda p: p.write_text(text, encoding="utf-8"))


def accept(folder: Path) -> None:
    """Forget that a campaign was refused."""
    (folder / KEPT / REFUSED).unlink(missing_ok=True)


def write_catalogue(root: Path) -> Path:
    """Write the catalogue of all folders of results in a folder, in one step.

    It holds nothing of the run that made it: the same results give the same file, byte by byte.
    """
    import pyarrow as pa
    from pyarrow import parquet

    tables = []
    for folder in sorted(p for p in root.iterdir() if (p / KEPT).is_dir() and not p.name.startswith(".")):
        refused = folder / KEPT / REFUSED
        try:
            if refused.is_file():
                rows = refused_rows(folder.name, *_refusal(refused, folder.name))
            elif (folder / "provenance.json").is_file():
                if not are_written(folder):
                    write_rows(folder)
                tables.append(read_rows(folder))
                continue
            else:
                continue
        except InputError as error:
            if is_outside(error):  # a full disk, a lost network: the results are not at fault
                raise
            # One folder that is damaged is one to doubt, and no end of the catalogue.
            rows = refused_rows(folder.name, folder.name, str(error))
        tables.append(pa.Table.from_pylist(rows, schema=schema()))
    # One chunk: how the rows came together must not show in the file.
    whole = pa.concat_tables(tables).combine_chunks() if tables else schema().empty_table()
    return write_atomically(root / ROWS, lambda p: parquet.write_table(whole, p))


def _refusal(file: Path, name: str) -> tuple[str, str]:
    """Return the campaign that was refused, and why, as far as that can still be read."""
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        return str(said["campaign"]), str(said["reason"])
    except (OSError, ValueError, LookupError, TypeError):
        return name, f"'{file}' says that it was refused, but can no longer be read; run the campaign again"


def read_catalogue(path: Path) -> pa.Table:
    """Return a catalogue: that of a folder of many results, a file, or what one folder of results would give.

    Raises
    ------
    InputError
        When there is none, or it is not one of this program.
    """
    import pyarrow as pa
    from pyarrow import ArrowException, parquet

    file = path / ROWS if path.is_dir() else path
    if path.is_dir() and not file.is_file() and (path / "provenance.json").is_file():
        return pa.Table.from_pylist(rows_of(path.absolute()), schema=schema())
    if not file.is_file():
        raise InputError(f"'{path}' holds no {ROWS}; `smfe run CAMPAIGNS --out {path}` of several campaigns writes it")
    try:
        found = parquet.read_table(file)
    except (OSError, ArrowException, ValueError) as error:
        raise InputError(f"'{file}' cannot be read as a catalogue ({error}); run the campaigns again") from error
    if missing := [name for name in COLUMNS if name not in found.column_names]:
        raise InputError(f"'{file}' is no catalogue of this program: it has no column {missing[0]}")
    return found.select(list(COLUMNS)).cast(schema())
