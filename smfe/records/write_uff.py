"""Records and compliances to universal files, dataset 58b (binary, double precision): nothing is rounded.

Binary, because the text of dataset 58 has 13 digits and a double needs 17. The abscissa stands twice: in the header
with the digits that fit there, and in the last identification line with all of them, which our own reader takes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import AXES, RECORD_SCALARS, RECORD_VECTORS, UNITS, axis_present, check_record, sample_interval
from process.types import Complex, Real
from smfe.records.formats.channels import Channel
from smfe.records.formats.uff import EXACT
from smfe.records.write import in_place

_TIME_RESPONSE, _FRF = 1, 4
_QUANTITY = {
    "force": 13,
    "drive_force": 13,
    "acceleration": 12,
    "displacement": 8,
    "encoder_position": 8,
    "reference_position": 8,
    "encoder_speed": 11,
    "reference_speed": 11,
    "encoder_angle": 1,
    "encoder_rotation": 1,
    "drive_torque": 1,
}
"""Vector of a record -> specific data type of dataset 58: 1 general, 8 displacement, 11 velocity, 12 acceleration, 13
force."""

_FIRST_SCALAR_NODE = 101


def write_record_uff(record: xr.Dataset, path: str | Path) -> Path:
    """Write a record as a universal file with one dataset 58b a channel; see `uff_columns` for their names.

    Each vector has a node of its own, numbered in the order of `process.labels.RECORD_VECTORS` from 1, each scalar one
    from 101: ``force_x`` is ``1:+X``.

    Raises
    ------
    InputError
        For what is no record.
    """
    check_record(record)
    time = record["time"].values
    step = sample_interval(record)
    functions = []
    for name, (node, direction) in _degrees(record).items():
        variable = name.rpartition("_")[0] if direction else name
        samples = record[variable].sel(axis=AXES[direction - 1]) if direction else record[variable]
        unit = UNITS[variable]
        kind = _QUANTITY.get(variable, 0)
        degrees = _record_6(_TIME_RESPONSE, (node, direction), (0, 0))
        labels = (_axis_line(17, "Time", "s"), _axis_line(kind, variable[:20], unit), _axis_line(0, "NONE", "NONE"))
        functions.append(_dataset(name, degrees, labels, time[0], step, samples.values.astype(np.float64)))
    return _write(path, functions)


def uff_columns(record: xr.Dataset) -> dict[str, Channel]:
    """Return the channels with which `read_records` reads back what `write_record_uff` wrote."""
    channels = {}
    for name, (node, direction) in _degrees(record).items():
        column = f"{node}" + (f":+{AXES[direction - 1].upper()}" if direction else "")
        channels[name] = Channel(column=column, unit=UNITS[name.rpartition("_")[0] if direction else name])
    return channels


def write_compliance_uff(compliance: xr.Dataset, path: str | Path) -> Path:
    """Write the entries of a compliance [m/N] as FRFs, one dataset 58b each: ``1:+X/1:+Y`` is x over y.

    Parameters
    ----------
    compliance : xarray.Dataset
        ``compliance(frequency, response, excitation)`` over an even frequency axis.
    path : str or Path
        File to write.

    Raises
    ------
    InputError
        For frequencies that are not evenly spaced: dataset 58b keeps those in single precision only.
    """
    frequency = compliance["frequency"].values.astype(np.float64)
    step = (frequency[-1] - frequency[0]) / max(frequency.size - 1, 1)
    if frequency.size < 2 or np.abs(np.diff(frequency) - step).max() > 1e-9 * frequency[-1]:
        raise InputError(
            f"the {frequency.size} frequencies are not evenly spaced, and a universal file keeps such an axis to seven "
            "digits only; choose an even axis, or write NetCDF"
        )
    functions = []
    for response in map(str, compliance["response"].values):
        for excitation in map(str, compliance["excitation"].values):
            values = compliance["compliance"].sel(response=response, excitation=excitation).values
            degrees = _record_6(_FRF, (1, AXES.index(response) + 1), (1, AXES.index(excitation) + 1))
            labels = (
                _axis_line(18, "Frequency", "Hz"),
                _axis_line(8, "displacement", "m"),
                _axis_line(13, "force", "N"),
            )
            name = f"compliance {response}{excitation}"
            functions.append(_dataset(name, degrees, labels, frequency[0], step, values.astype(np.complex128)))
    return _write(path, functions)


def _degrees(record: xr.Dataset) -> dict[str, tuple[int, int]]:
    """Return channel -> (node, direction), direction 0 for a scalar."""
    found = {}
    for node, vector in enumerate(RECORD_VECTORS, 1):
        for axis in axis_present(record, vector):
            found[f"{vector}_{axis}"] = (node, AXES.index(axis) + 1)
    for node, scalar in enumerate(RECORD_SCALARS, _FIRST_SCALAR_NODE):
        if scalar in record:
            found[scalar] = (node, 0)
    return found


def _write(path: str | Path, functions: list[bytes]) -> Path:
    with in_place(Path(path)) as temporary:
        temporary.write_bytes(b"".join(functions))
    return Path(path)


def _dataset(
    name: str,
    degrees: str,
    labels: tuple[str, str, str],
    first: float,
    step: float,
    values: Real | Complex,
) -> bytes:
    """Return one dataset 58b: delimiter, header of 11 lines, little-endian doubles, delimiter."""
    body = values.astype("<c16" if np.iscomplexobj(values) else "<f8").tobytes()
    kind = 6 if np.iscomplexobj(values) else 4
    lines = [
        "    -1",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *(name, "NONE", "NONE", "NONE", f"{EXACT}{float(first)!r} step {float(step)!r}"),
        degrees,
        f"{kind:10d}{values.size:10d}{1:10d}{_e13(first)}{_e13(step)}{_e13(0.0)}",
        *labels,
        _axis_line(0, "NONE", "NONE"),
    ]
    return "\n".join(lines).encode("ascii") + b"\n" + body + b"\n    -1\n"


def _record_6(function: int, response: tuple[int, int], reference: tuple[int, int]) -> str:
    ends = "".join(f" {'NONE':<10}{node:10d}{direction:4d}" for node, direction in (response, reference))
    return f"{function:5d}{0:10d}{0:5d}{0:10d}{ends}"


def _axis_line(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}"


def _e13(value: float) -> str:
    """Return a number in 13 characters with one digit more than E13.5 and a space before it."""
    for digits in range(8, 4, -1):
        text = f"{value:.{digits}E}"
        if len(text) <= 12:
            break
    return f"{text:>13}"
