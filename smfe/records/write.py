"""Records to files: NetCDF in our own layout, CSV and MATLAB with the field's column names.

Every file is written under a temporary name and moved into place.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import io

from process.labels import UNITS, axis_present, check_record
from smfe.records.channels import Channel

_VECTOR_HEADERS = {
    "force": "F",
    "acceleration": "a",
    "displacement": "u",
    "encoder_position": "enc",
    "drive_force": "Fd",
    "reference_position": "ref",
}
_SCALAR_HEADERS = {"spindle_angle": "angle", "spindle_speed": "n", "tacho": "tacho"}


def write_record_netcdf(record: xr.Dataset, path: str | Path) -> Path:
    """Write a record as NetCDF-4 in our own layout; `read_records` needs no channels for it."""
    with _in_place(Path(path)) as temporary:
        check_record(record).to_netcdf(temporary, engine="h5netcdf")
    return Path(path)


def write_record_csv(
    record: xr.Dataset, path: str | Path, delimiter: str = ",", decimal: str = ".", digits: int = 10
) -> Path:
    """Write a record as text with one header line ``t,Fx,Fy,Fz,ax,ay,az``; see `record_columns` for the names.

    Parameters
    ----------
    record : xarray.Dataset
        A record.
    path : str or Path
        File to write.
    delimiter, decimal : str, optional
        ";" and "," as on a German shop floor, for example.
    digits : int, optional
        Significant digits.
    """
    columns = _named_columns(record)
    # One format for a whole row: several times faster than pandas writes, with the same text.
    row = delimiter.join([f"%.{digits}g"] * len(columns)) + "\n"
    rows = zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
    with _in_place(Path(path)) as temporary, Path(temporary).open("w", encoding="utf-8", newline="") as stream:
        stream.write(delimiter.join(columns) + "\n")
        text = "".join(map(row.__mod__, rows))
        stream.write(text if decimal == "." else text.replace(".", decimal))
    return Path(path)


def write_record_mat(record: xr.Dataset, path: str | Path) -> Path:
    """Write a record as a MATLAB file of version 5 with one variable a channel, named as in `write_record_csv`."""
    with _in_place(Path(path)) as temporary:
        io.savemat(temporary, _named_columns(record), appendmat=False, do_compression=True)
    return Path(path)


def record_columns(record: xr.Dataset) -> dict[str, Channel]:
    """Return the channels with which `read_records` reads back what `write_record_csv` and `write_record_mat` wrote."""
    channels = {"time": Channel(column="t", unit="s")}
    for variable in map(str, record.data_vars):
        if variable in _SCALAR_HEADERS:
            channels[variable] = Channel(column=_SCALAR_HEADERS[variable], unit=UNITS[variable])
            continue
        for axis in axis_present(record, variable):
            channels[f"{variable}_{axis}"] = Channel(column=_VECTOR_HEADERS[variable] + axis, unit=UNITS[variable])
    return channels


def _named_columns(record: xr.Dataset) -> dict[str, NDArray[np.float64]]:
    check_record(record)
    columns = {"t": record["time"].values}
    for variable in map(str, record.data_vars):
        if variable in _SCALAR_HEADERS:
            columns[_SCALAR_HEADERS[variable]] = record[variable].values
            continue
        for axis in axis_present(record, variable):
            columns[_VECTOR_HEADERS[variable] + axis] = record[variable].sel(axis=axis).values
    return columns


@contextmanager
def _in_place(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; what was written there takes the place of `path` when all went well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
