"""Records to files: NetCDF in our own layout, CSV and MATLAB with the field's column names.

Every file is written under a temporary name and moved into place.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import xarray as xr
from scipy import io

from process.labels import AXES, UNITS, axis_present, check_record
from process.types import Real
from smfe.records.formats.channels import Channel

_VECTOR_HEADERS = {
    "force": "F",
    "acceleration": "a",
    "displacement": "u",
    "encoder_position": "enc",
    "drive_force": "Fd",
    "reference_position": "ref",
    "encoder_speed": "venc",
    "reference_speed": "vref",
    "encoder_angle": "phi",
    "encoder_rotation": "omega",
    "drive_torque": "Td",
}
_SCALAR_HEADERS = {"spindle_angle": "angle", "spindle_speed": "n", "tacho": "tacho", "sound": "sound"}

OWN_COLUMNS: dict[str, Channel] = {
    "time": Channel("t", "s"),
    **{f"{name}_{a}": Channel(header + a, UNITS[name]) for name, header in _VECTOR_HEADERS.items() for a in AXES},
    **{name: Channel(header, UNITS[name]) for name, header in _SCALAR_HEADERS.items()},
}
"""Every channel of a record -> its column in a file that we write."""


def write_record_netcdf(record: xr.Dataset, path: str | Path) -> Path:
    """Write a record as NetCDF-4 in our own layout; `read_records` needs no channels for it."""
    with in_place(Path(path)) as temporary:
        # In memory first: on a full disk the HDF5 library ends the process when it closes its file.
        temporary.write_bytes(check_record(record).to_netcdf(engine="h5netcdf"))
    return Path(path)


def write_pieces_netcdf(pieces: Iterable[xr.Dataset], path: str | Path) -> Path:
    """Write a record that comes in consecutive pieces as `write_record_netcdf` would write the whole."""
    with in_place(Path(path)) as temporary, h5netcdf.File(temporary, "w") as file:
        size = 0
        for piece in pieces:
            check_record(piece)
            if size == 0:
                _lay_out(file, piece)
            part = slice(size, size + piece.sizes["time"])
            size = part.stop
            file.resize_dimension("time", size)
            file.variables["time"][part] = piece["time"].values
            for name, array in piece.data_vars.items():
                file.variables[str(name)][..., part] = array.transpose(..., "time").values
    return Path(path)


def _lay_out(file: h5netcdf.File, piece: xr.Dataset) -> None:
    """Create dimensions and variables of our own layout in an empty file."""
    file.dimensions = {"time": None} | ({"axis": piece.sizes["axis"]} if "axis" in piece.dims else {})
    chunk = piece.sizes["time"]
    file.create_variable("time", ("time",), np.float64, chunks=(chunk,)).attrs["units"] = UNITS["time"]
    if "axis" in piece.dims:
        text = h5py.string_dtype()
        file.create_variable("axis", ("axis",), text)[...] = np.array(piece["axis"].values, dtype=object)
    for name, array in piece.data_vars.items():
        dims = ("axis", "time") if "axis" in array.dims else ("time",)
        chunks = (piece.sizes["axis"], chunk) if "axis" in array.dims else (chunk,)
        variable = file.create_variable(str(name), dims, np.float64, chunks=chunks, fillvalue=np.nan)
        for key, value in array.attrs.items():
            variable.attrs[str(key)] = value
    for key, value in piece.attrs.items():
        file.attrs[str(key)] = value


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
    return write_pieces_csv([record], path, delimiter, decimal, digits)


def write_pieces_csv(
    pieces: Iterable[xr.Dataset], path: str | Path, delimiter: str = ",", decimal: str = ".", digits: int = 10
) -> Path:
    """Write a record that comes in consecutive pieces as `write_record_csv` would write the whole."""
    # One format for a whole row: several times faster than pandas writes, with the same text.
    with in_place(Path(path)) as temporary, Path(temporary).open("w", encoding="utf-8", newline="") as stream:
        for number, columns in enumerate(map(_named_columns, pieces)):
            row = delimiter.join([f"%.{digits}g"] * len(columns)) + "\n"
            if number == 0:
                stream.write(delimiter.join(columns) + "\n")
            rows = zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
            text = "".join(map(row.__mod__, rows))
            stream.write(text if decimal == "." else text.replace(".", decimal))
    return Path(path)


def write_record_mat(record: xr.Dataset, path: str | Path) -> Path:
    """Write a record as a MATLAB file of version 5 with one variable a channel, named as in `write_record_csv`."""
    with in_place(Path(path)) as temporary:
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


def _named_columns(record: xr.Dataset) -> dict[str, Real]:
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
def in_place(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; what was written there takes the place of `path` when all went well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
