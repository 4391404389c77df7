"""Long records, block by block: a few blocks are in memory and never the whole file.

CSV, Parquet, HDF5, NetCDF, MAT 5 to 7.3, TDMS, WAV, LVM and binary universal files are read lazily; of MAT 4, NumPy and
universal files as text the channels wanted are read at once and handed out in blocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import make_record, sample_interval
from process.types import Real
from smfe.records.align import HALF, shift
from smfe.records.formats import netcdf
from smfe.records.formats.channels import Channel, record_channels, split_vector
from smfe.records.formats.table import Table, join, slices
from smfe.records.read import (
    columns_of,
    evened,
    format_of,
    is_rounded,
    named,
    notes_of,
    own_table,
    sources_of,
    time_of,
    values_of,
)

BLOCK = 1 << 16
"""Samples a block."""

Samples = dict[str, Real]
"""Channel, and "time" -> samples in the unit of its label."""


@dataclass(frozen=True)
class Stream:
    """A segment of a file as it comes in.

    Parameters
    ----------
    source : str
        File and segment.
    channels : mapping of str to Channel
        The channels in it, with their corrections.
    blocks : iterator of mapping
        Consecutive blocks, corrected, delays undone; of any length.
    attrs : mapping, optional
        Attributes of a record in our own layout.
    """

    source: str
    channels: Mapping[str, Channel]
    blocks: Iterator[Samples]
    attrs: Mapping[str, Any] = field(default_factory=dict)

    def record(self, samples: Samples) -> xr.Dataset:
        """Return samples as a labelled record."""
        vectors: dict[str, dict[str, Real]] = {}
        scalars: Samples = {}
        for name, values in samples.items():
            vector = split_vector(name)
            if vector is not None:
                vectors.setdefault(vector[0], {})[vector[1]] = values
            elif name != "time":
                scalars[name] = values
        with named(self.source):
            record = make_record(samples["time"], vectors, scalars, {**self.attrs, "source": self.source})
        tacho = self.channels.get("tacho")
        if tacho is not None and tacho.pulses_per_revolution is not None and "tacho" in record:
            record["tacho"].attrs["pulses_per_revolution"] = tacho.pulses_per_revolution
        return record


def read_blocks(path: str | Path, channels: Mapping[str, Channel], block: int = BLOCK) -> Iterator[xr.Dataset]:
    """Read a record as consecutive pieces.

    Parameters
    ----------
    path : str or Path
        A file with one segment.
    channels : mapping of str to Channel
        As for `read_records`.
    block : int, optional
        Samples a piece, at least 2; the last has what is left, up to one more.

    Yields
    ------
    xarray.Dataset
        Put together along time they are the record that `read_records` reads. A spindle angle goes on from piece to
        piece.

    Raises
    ------
    InputError
        As `read_records`, and for a file of several segments.
    """
    if block < 2:
        raise InputError(f"a block of {block} samples; a piece of a record needs at least 2")
    found = streams(path, channels, block)
    if len(found) > 1:
        raise InputError(f"{Path(path).name}: has {len(found)} segments; read them with read_records")
    (stream,) = found
    return map(stream.record, _rebatched(stream.blocks, block))


def streams(path: str | Path, channels: Mapping[str, Channel], block: int = BLOCK) -> list[Stream]:
    """Open a file; return one stream a segment, of which nothing but the header has been read where that is possible.

    Raises
    ------
    InputError
        For anything that is wrong with the file's header or the channels; what is wrong with its samples is raised
        while they come.
    """
    path = Path(path)
    form = format_of(path)
    used = record_channels(channels)
    if form is netcdf.FORMAT and (own := netcdf.read_own_layout(path, block)) is not None:
        return [_own_stream(path.name, own, used)]
    wanted = columns_of(path.name, used)
    if form.read_segments is not None:
        parts = form.read_segments(path, wanted, block)
    elif form.read_blocks is not None:
        parts = [form.read_blocks(path, wanted, block)]
    else:
        parts = [slices(table, block) for table in form.read_tables(path, wanted)]
    return [_stream(source, part, used) for source, part in zip(sources_of(path, parts), parts, strict=True)]


def _own_stream(source: str, own: Iterator[xr.Dataset], declared: Mapping[str, Channel]) -> Stream:
    first = next(own)
    with named(source):
        table, channels = own_table(first, declared)

    def parts() -> Iterator[Table]:
        yield table
        for record in own:
            yield own_table(record, declared)[0]

    return replace(_stream(source, parts(), channels), attrs=first.attrs)


def _stream(source: str, parts: Iterator[Table], channels: Mapping[str, Channel]) -> Stream:
    delay = {name: channel.delay for name, channel in channels.items() if name != "time" and channel.delay != 0.0}
    attrs: dict[str, Any] = {}
    samples = _corrected(source, _evened(source, parts, channels), channels, attrs)
    return Stream(source, channels, _aligned(source, samples, delay) if delay else samples, attrs)


def _evened(source: str, parts: Iterator[Table], channels: Mapping[str, Channel]) -> Iterator[Table]:
    """Pass blocks on; where times are rounded the file is read whole, since one even clock has to fit all of it."""
    first = next(parts, None)
    if first is None:
        return
    if not is_rounded(first, channels):
        yield first
        yield from parts
        return
    (whole,) = join(chain([first], parts))
    yield from slices(evened(source, whole, channels), next(iter(first.columns.values())).size)


def _corrected(
    source: str, parts: Iterator[Table], channels: Mapping[str, Channel], attrs: dict[str, Any]
) -> Iterator[Samples]:
    """Yield the blocks in the units of their labels, with their times, on a clock that does not jump.

    What the reader notices goes to `attrs` with the first block.
    """
    before = 0
    last: dict[str, float] = {}
    for table in parts:
        attrs.update(notes_of(table))
        samples = {n: values_of(source, n, c, table, before) for n, c in channels.items() if n != "time"}
        samples["time"] = time_of(source, table, channels.get("time"), before)
        size = samples["time"].size
        if size == 0:
            continue
        if "spindle_angle" in samples and last:
            angle = samples["spindle_angle"]
            angle -= 2.0 * np.pi * np.round((angle[0] - last["spindle_angle"]) / (2.0 * np.pi))
        _check_clock(source, samples["time"], before, last)
        before += size
        last = {name: float(values[-1]) for name, values in samples.items()}
        yield samples
    if before < 2:
        raise InputError(f"{source}: the record has {before} samples; at least 2 are needed")


def _check_clock(source: str, time: Real, before: int, last: Mapping[str, float]) -> None:
    stamps = np.concatenate([[last["time"]], time]) if last else time
    if stamps.size < 2:
        return
    try:
        sample_interval(xr.Dataset(coords={"time": stamps}))
    except InputError as error:
        raise InputError(f"{source}, from sample {before}: {error}") from error


def _joined(a: Samples, b: Samples) -> Samples:
    return {name: np.concatenate([a[name], b[name]]) for name in a}


def _cut(samples: Samples, begin: int, end: int) -> Samples:
    return {name: values[begin:end] for name, values in samples.items()}


def _rebatched(blocks: Iterator[Samples], block: int) -> Iterator[Samples]:
    """Yield blocks of one length; the last is not shorter than 2 samples."""
    rest: Samples | None = None
    for samples in blocks:
        rest = samples if rest is None else _joined(rest, samples)
        while rest["time"].size >= block + 2:
            yield _cut(rest, 0, block)
            rest = _cut(rest, block, rest["time"].size)
    if rest is None:
        return
    size = rest["time"].size
    cut = block if size > block + 1 else size
    yield _cut(rest, 0, cut)
    if cut < size:
        yield _cut(rest, cut, size)


def _aligned(source: str, blocks: Iterator[Samples], delay: Mapping[str, float]) -> Iterator[Samples]:
    """Undo delays as `smfe.records.align.align` does for a whole record, with the neighbours its kernel needs."""
    held = next(blocks)
    dt = float(held["time"][-1] - held["time"][0]) / max(held["time"].size - 1, 1)
    if dt <= 0.0:
        raise InputError(f"{source}: the record has 1 samples; at least 2 are needed")
    by = {name: value / dt for name, value in delay.items()}
    first = max(0, *(math.ceil(-value - 1e-9) for value in by.values()))
    lost = max(0, *(math.ceil(value - 1e-9) for value in by.values()))
    margin = HALF + 2 + max(abs(round(value)) for value in by.values())
    begin, done = 0, first  # of what is held, and of what has not been handed on, counted in samples of the record
    for samples in blocks:
        held = _joined(held, samples)
        ready = begin + held["time"].size - margin
        if ready > done and ready - begin > HALF:
            yield _shifted(held, by, done - begin, ready - begin)
            done = ready
            keep = max(0, done - margin - begin)
            held, begin = _cut(held, keep, held["time"].size), begin + keep
    size = begin + held["time"].size
    if size - lost - first < 2:
        name, value = max(delay.items(), key=lambda item: abs(item[1]))
        raise InputError(
            f"{source}: the delay of {name}, {value:g} s, is as long as the record of {size * dt:g} s; check its unit"
        )
    if size - lost > done:
        yield _shifted(held, by, done - begin, size - lost - begin)


def _shifted(held: Samples, by: Mapping[str, float], begin: int, end: int) -> Samples:
    out = _cut(held, begin, end)
    for name, value in by.items():
        out[name] = shift(held[name], value, begin, end)
    return out
