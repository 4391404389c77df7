"""The funnel: whatever the format, columns become a record here and only here (a compliance: `smfe.records.frf`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import UNITS, axis_present, make_record
from process.types import Real
from smfe.records import text
from smfe.records.align import align
from smfe.records.formats import lvm, mat, netcdf, npy, parquet, tdms, uff, wav
from smfe.records.formats.channels import Channel, record_channels, split_vector
from smfe.records.formats.controls import sinumerik
from smfe.records.formats.controls import traces as controls
from smfe.records.formats.table import Column, Format, Table

FORMATS: dict[str, Format] = {
    suffix: module.FORMAT
    for module in (text, controls, parquet, netcdf, mat, lvm, npy, tdms, uff, wav, sinumerik)
    for suffix in module.FORMAT.suffixes
}
"""Suffix of a file -> its format."""


def read_records(path: str | Path, channels: Mapping[str, Channel]) -> list[xr.Dataset]:
    """Read the records of a file.

    Parameters
    ----------
    path : str or Path
        A file with one of the suffixes in `FORMATS`.
    channels : mapping of str to Channel
        Channel name ("time", "force_x", ...) -> where it stands and in which unit. A NetCDF file in our own layout
        (``force(axis, time)`` ...) names its channels and units itself: every channel it holds is read, and only
        `sign`, `scale` and `delay` of those declared are applied.

    Returns
    -------
    list of xarray.Dataset
        One record; of a file with several segments, one a segment. ``attrs["source"]`` is the name of the file, with
        ", segment 0" and so on behind it where there are several. A spindle angle is unwrapped. ``attrs["notes"]``,
        where there is one, says a line each what was noticed while reading.

    Raises
    ------
    InputError
        For anything that is wrong with the file or its channels, in one sentence with the file's name.
    """
    path = Path(path)
    form = format_of(path)
    used = record_channels(channels)
    if form is netcdf.FORMAT and (own := netcdf.read_own_layout(path)) is not None:
        (record,) = own
        with named(path.name):  # a damaged file may call an axis what none is called
            table, own_channels = own_table(record, used)
        return [_record(path.name, table, own_channels, record.attrs)]
    tables = form.read_tables(path, columns_of(path.name, used))
    return [_record(source, table, used) for source, table in zip(sources_of(path, tables), tables, strict=True)]


def read_record(path: str | Path, channels: Mapping[str, Channel]) -> xr.Dataset:
    """Read a file that holds one record; arguments as of `read_records`.

    Raises
    ------
    InputError
        When the file holds several records, and as `read_records`.
    """
    records = read_records(path, channels)
    if len(records) > 1:
        raise InputError(f"{Path(path).name}: it holds {len(records)} segments; read them with read_records")
    return records[0]


def format_of(path: Path) -> Format:
    """Return the format of a file, by its suffix."""
    if not path.is_file():
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name one of its files")
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path.name}: files with suffix '{path.suffix}' are not read; known are {', '.join(FORMATS)}")
    return FORMATS[path.suffix.lower()]


def sources_of(path: Path, segments: Sequence[object]) -> list[str]:
    """Return what the segments of a file are called."""
    return [path.name if len(segments) == 1 else f"{path.name}, segment {k}" for k in range(len(segments))]


def columns_of(source: str, channels: Mapping[str, Channel]) -> list[Column]:
    """Return the columns that the channels stand in."""
    if all(name == "time" for name in channels):
        raise InputError(f"{source}: no channels are declared; say in [channels] which column is which")
    columns: list[Column] = []
    for name, channel in channels.items():
        if channel.column is not None:
            columns.append(channel.column)
        elif not (name == "time" and channel.sample_rate is not None):
            raise InputError(
                f'{source}: channel {name} has no column; add column = "its name" or a position, column = 1'
            )
    return columns


LARGEST = 1e15
"""What no channel reaches in its SI unit; the squares of larger numbers may be none."""


def values_of(source: str, name: str, channel: Channel, table: Table, before: int = 0) -> Real:
    """Return a channel in the unit of its label, all finite; `before` samples came before this block of it."""
    assert channel.column is not None
    numbers = table.columns[channel.column]
    # What is not finite shows in the extremes.
    if numbers.size and not (np.isfinite(numbers.min()) and np.isfinite(numbers.max())):
        bad = ~np.isfinite(numbers)
        raise InputError(
            f"{source}: channel {name} (column '{channel.column}') is empty, NaN or infinite in {int(bad.sum())} "
            f"samples, the first at sample {before + int(np.argmax(bad))} (counted from 0); repair or cut the record"
        )
    with named(source):
        values = channel.to_si(name, numbers)
    if values.size and max(values.max(), -values.min()) > LARGEST:
        at = int(np.argmax(np.abs(values)))
        raise InputError(
            f"{source}: channel {name} (column '{channel.column}') is {numbers[at]:.3g} at sample {before + at} "
            "(counted from 0), more than any sensor measures; repair or cut the record, or check its unit and scale"
        )
    return np.unwrap(values) if name == "spindle_angle" else values


def _record(
    source: str, table: Table, channels: Mapping[str, Channel], attrs: Mapping[str, Any] | None = None
) -> xr.Dataset:
    table = evened(source, table, channels)
    vectors: dict[str, dict[str, Real]] = {}
    scalars: dict[str, Real] = {}
    for name, channel in channels.items():
        if name == "time":
            continue
        values = values_of(source, name, channel, table)
        vector = split_vector(name)
        if vector is None:
            scalars[name] = values
        else:
            vectors.setdefault(vector[0], {})[vector[1]] = values
    time = time_of(source, table, channels.get("time"))
    with named(source):
        record = make_record(time, vectors, scalars, {**(attrs or {}), **notes_of(table), "source": source})
        return finish(record, channels)


def notes_of(table: Table) -> dict[str, str]:
    """Return the attribute that holds what is to be said of a record; nothing where all is well."""
    return {"notes": "\n".join(table.notes)} if table.notes else {}


def time_of(source: str, table: Table, channel: Channel | None, before: int = 0) -> Real:
    """Return the times of a table [s], of which `before` samples came before."""
    if channel is not None and channel.column is not None:
        return values_of(source, "time", channel, table, before)
    size = next(iter(table.columns.values())).size
    if channel is not None and channel.sample_rate is not None:
        return np.arange(before, before + size) / channel.sample_rate
    if table.sample_rate is not None:
        return table.start + np.arange(before, before + size) / table.sample_rate
    said = "".join(f"{note}; " for note in table.notes) or f"{source}: "
    raise InputError(
        f'{said}no time; declare time = {{ column = "t", unit = "s" }}, or time = {{ sample_rate = "51200 Hz" }} '
        "for a file without a time column"
    )


def own_table(record: xr.Dataset, declared: Mapping[str, Channel]) -> tuple[Table, dict[str, Channel]]:
    """Return a record in our own layout as columns, each named after its channel, with the corrections declared."""
    columns: dict[Column, Real] = {"time": record["time"].values.astype(float)}
    for variable, array in record.data_vars.items():
        if "axis" not in array.dims:
            columns[str(variable)] = array.values.astype(float)
            continue
        for axis in axis_present(record, str(variable)):
            columns[f"{variable}_{axis}"] = array.sel(axis=axis).values.astype(float)
    channels = {}
    for name in map(str, columns):
        vector = split_vector(name)
        unit = UNITS[name if vector is None else vector[0]]
        channels[name] = replace(declared.get(name, Channel()), column=name, unit=unit)
    return Table(columns), channels


@contextmanager
def named(source: str) -> Iterator[None]:
    """Put the name of the file before a message that lacks it."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


def finish(record: xr.Dataset, channels: Mapping[str, Channel]) -> xr.Dataset:
    """Note the pulses of a tacho and undo the delays of the channels."""
    tacho = channels.get("tacho")
    if tacho is not None and tacho.pulses_per_revolution is not None and "tacho" in record:
        record["tacho"].attrs["pulses_per_revolution"] = tacho.pulses_per_revolution
    return align(record, {name: channel.delay for name, channel in channels.items() if name != "time"})


# --- times that were printed with too few digits: an even clock through them ------------------------------------------


def is_rounded(table: Table, channels: Mapping[str, Channel]) -> bool:
    """Whether the column of times of a table repeats its values, as times printed with too few digits do."""
    clock = channels.get("time")
    if clock is None or clock.column is None or clock.column not in table.columns:
        return False
    steps = np.diff(table.columns[clock.column])
    return bool(steps.size and steps.min() == 0.0 and steps.max() > 0.0)


def evened(source: str, table: Table, channels: Mapping[str, Channel]) -> Table:
    """Return a table whose rounded times are those of the even clock that fits them, and say so.

    A line ``a + b k`` through the times t_k of n samples that were rounded to q has a step b that is uncertain by
    ``q/n^1.5``. It takes their place only where no time departs from it by more than 0.8 q: rounding departs by
    0.5 q, and lost samples show as a jump. Other tables come back as they are.
    """
    if not is_rounded(table, channels):
        return table
    column = channels["time"].column
    assert column is not None
    times = table.columns[column]
    steps = np.diff(times)
    quantum = float(np.min(steps[steps > 0.0]))
    k = np.arange(times.size) - 0.5 * (times.size - 1)
    step = float(k @ times) / float(k @ k)
    even = times.mean() + step * k
    if step <= 0.0 or np.max(np.abs(times - even)) > 0.8 * quantum:
        return table
    note = (
        f"{source}: the times of '{column}' are printed in steps of {quantum:.3g}; an even clock with a step of "
        f"{step:.6g} fits all of them and is used. Samples lost within one printed step would not show"
    )
    return replace(table, columns={**table.columns, column: even}, notes=(*table.notes, note))
