"""NetCDF-4 and HDF5: records in our own layout, or any file with one-dimensional data sets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import xarray as xr

from process.errors import InputError
from process.labels import RECORD_SCALARS, RECORD_VECTORS, UNITS
from smfe.records.table import Column, Table, as_numbers, damaged, find_columns, same_length

_KIND = "NetCDF-4 or HDF5"


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted one-dimensional data sets of an HDF5 file, named by their path (``group/name``)."""
    _check_signature(path)
    with damaged(path, _KIND), h5py.File(path, "r") as file:
        found: list[str] = []

        def visit(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and item.size > 1 and item.size == max(item.shape):
                found.append(name)

        file.visititems(visit)
        at = find_columns(path.name, found, wanted, len(found))
        columns = {column: as_numbers(path.name, column, file[found[index]][()]) for column, index in at.items()}
    same_length(path.name, columns)
    return [Table(columns)]


def read_own_layout(path: Path) -> xr.Dataset | None:
    """Return the record when the file holds one in our own layout (``force(axis, time)`` ...), else None.

    Raises
    ------
    InputError
        When the file cannot be read, or a variable of the layout has another unit than `process.labels` says.
    """
    _check_signature(path)
    with damaged(path, _KIND):
        with h5py.File(path, "r") as file:
            ours = "axis" in file and "time" in file and any(name in file for name in RECORD_VECTORS)
        if not ours:
            return None
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
            record = dataset.load()
    names = [name for name in (*RECORD_VECTORS, *RECORD_SCALARS) if name in record]
    for name in ("time", *names):
        unit = record[name].attrs.get("units")
        if unit != UNITS[name]:
            raise InputError(f"{path.name}: {name} has units {unit!r}; a record in our own layout has '{UNITS[name]}'")
    return record[names]


def _check_signature(path: Path) -> None:
    with path.open("rb") as stream:
        head = stream.read(8)
    if not head:
        raise InputError(f"{path.name}: the file is empty")
    if head[:3] == b"CDF":
        raise InputError(f"{path.name}: a NetCDF-3 file; convert it with: nccopy -k nc4 {path.name} new.nc")
