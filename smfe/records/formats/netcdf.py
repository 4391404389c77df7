"""NetCDF-4 and HDF5: records in our own layout, or any file with data sets of one or two dimensions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from process.errors import InputError
from process.labels import RECORD_SCALARS, RECORD_VECTORS, UNITS
from smfe.records.formats.hdf5 import columns_of, end_notes, open_file, read_places
from smfe.records.formats.reader import apart, format_apart
from smfe.records.formats.table import Column, Format, Table, damaged, find_columns, guarded, join

if TYPE_CHECKING:
    import xarray as xr

_KIND = "NetCDF-4 or HDF5"
_WHOLE = 1 << 62


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted data sets of an HDF5 file, named by their path (``group/name``, ``group/matrix(:,2)``)."""
    return join(read_blocks(path, wanted, _WHOLE))


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted data sets of an HDF5 file, `block` samples at a time."""
    _check_signature(path)
    with damaged(path, _KIND), open_file(path) as file:
        found: list[str] = []

        def visit(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and item.shape and item.size > 1:
                found.append(name)

        file.visititems(visit)
        places = columns_of(file, found)
        at = find_columns(path.name, [place.name for place in places], wanted, len(places))
    return read_places(path, _KIND, {column: places[index] for column, index in at.items()}, block)


@apart
def read_own_layout(path: Path, block: int | None = None) -> Iterator[xr.Dataset] | None:
    """Return the blocks of the record when the file holds one in our own layout (``force(axis, time)``), else None.

    Parameters
    ----------
    path : Path
        The file.
    block : int, optional
        Samples a block; None: all at once.

    Raises
    ------
    InputError
        When the file cannot be read, or a variable of the layout has another unit than `process.labels` says.
    """
    return guarded(path, _KIND, _own_blocks(path, block or _WHOLE)) if own_layout(path) else None


@apart
def own_layout(path: Path) -> bool:
    """Whether a NetCDF or HDF5 file holds a record in our own layout, which needs no declaration of channels."""
    _check_signature(path)
    with damaged(path, _KIND), open_file(path) as file:
        return "axis" in file and "time" in file and any(name in file for name in RECORD_VECTORS)


def _own_blocks(path: Path, block: int) -> Iterator[xr.Dataset]:
    import xarray as xr

    with xr.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False) as dataset:
        names = [name for name in (*RECORD_VECTORS, *RECORD_SCALARS) if name in dataset]
        for name in ("time", *names):
            unit = dataset[name].attrs.get("units")
            if unit != UNITS[name]:
                raise InputError(
                    f"{path.name}: {name} has units {unit!r}; a record in our own layout has '{UNITS[name]}'"
                )
        if notes := end_notes(path):
            dataset.attrs["notes"] = "\n".join([*filter(None, [dataset.attrs.get("notes")]), *notes])
        size = dataset.sizes["time"]
        for begin in range(0, max(size, 1), block):
            yield dataset[names].isel(time=slice(begin, min(begin + block, size))).load()


def _check_signature(path: Path) -> None:
    with path.open("rb") as stream:
        head = stream.read(8)
    if not head:
        raise InputError(f"{path.name}: the file is empty")
    if head[:3] == b"CDF":
        raise InputError(f"{path.name}: a NetCDF-3 file; convert it with: nccopy -k nc4 {path.name} new.nc")


def stated_units(path: Path) -> dict[str, str]:
    """Return name of a data set -> unit in its attributes."""
    found: dict[str, str] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            unit = next((item.attrs[key] for key in ("units", "unit", "Unit", "Units") if key in item.attrs), None)
            text = unit.decode("latin-1") if isinstance(unit, bytes) else unit
            if isinstance(text, str):
                found[name] = text

    with damaged(path, "HDF5"), open_file(path) as file:
        file.visititems(visit)
    return found


FORMAT = format_apart(
    Format((".nc", ".h5", ".hdf5"), read_tables, read_blocks, stated_units=stated_units, needs_time=lambda path: True)
)
