"""What MATLAB 7.3, NetCDF-4 and plain HDF5 have in common: data sets that are read through h5py, slice by slice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from process.errors import InputError
from smfe.records.formats.table import Column, Table, as_numbers, guarded, refuse_oversize

_MOST_COMPRESSED = 1100.0
"""Deflate cannot shrink data further than this."""

_CHUNK_CACHE = 1 << 22
"""Bytes of unpacked chunks that h5py keeps a data set, so that a large chunk is not unpacked for every block."""


@dataclass(frozen=True)
class Place:
    """Where a column stands in an HDF5 file.

    Parameters
    ----------
    name : str
        Name of the column.
    dataset : str
        Path of its data set.
    along : int
        Dimension of the data set along which the samples run.
    at : int or None
        Index in the other dimension of a matrix.
    """

    name: str
    dataset: str
    along: int
    at: int | None = None


def open_file(path: Path) -> h5py.File:
    """Open a file for reading."""
    return h5py.File(path, "r", rdcc_nbytes=_CHUNK_CACHE)


def read_places(path: Path, kind: str, places: Mapping[Column, Place], block: int) -> Iterator[Table]:
    """Yield columns of one length, `block` samples at a time.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        What it should be, for messages.
    places : mapping of Column to Place
        The columns wanted.
    block : int
        Samples a table.
    """
    return guarded(path, kind, _blocks(path, places, block))


def _blocks(path: Path, places: Mapping[Column, Place], block: int) -> Iterator[Table]:
    with open_file(path) as file:
        lengths = {column: _checked_length(path, file[place.dataset], place) for column, place in places.items()}
        size = _one_length(path.name, lengths)
        for begin in range(0, max(size, 1), block):
            part = slice(begin, min(begin + block, size))
            yield Table(
                {c: as_numbers(path.name, c, _values(file[place.dataset], place, part)) for c, place in places.items()}
            )


def _checked_length(path: Path, dataset: h5py.Dataset, place: Place) -> int:
    stated = int(np.prod(dataset.shape, dtype=object)) * dataset.dtype.itemsize
    stored = int(dataset.id.get_storage_size())
    refuse_oversize(path, stated, stored, _MOST_COMPRESSED)
    if dataset.dtype.kind in "biuf" and dataset.chunks is None and stated != stored:
        raise InputError(
            f"{path.name}: '{place.dataset}' has {stored} bytes of samples where its header states {stated}; the file "
            "is damaged: copy or export it again"
        )
    return int(dataset.shape[place.along])


def _one_length(source: str, lengths: Mapping[Column, int]) -> int:
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"'{column}' {size}" for column, size in lengths.items())
        raise InputError(
            f"{source}: columns of different length ({found} samples); channels of one record need the same"
        )
    return next(iter(lengths.values()), 0)


def _values(dataset: h5py.Dataset, place: Place, part: slice) -> object:
    if dataset.ndim == 0:
        return dataset[()]
    index: list[int | slice] = [0] * dataset.ndim
    index[place.along] = part
    if place.at is not None:
        index[1 - place.along] = place.at
    return dataset[tuple(index)]


def columns_of(file: h5py.File, names: Sequence[str]) -> list[Place]:
    """Return the columns of data sets: a vector is one, a matrix as many as its shorter side is long.

    They are named as MATLAB would: ``name``, ``name(:,2)`` where the samples run down, ``name(2,:)`` where across.
    """
    places = []
    for name in names:
        shape = file[name].shape
        if int(np.prod(shape, dtype=object)) == max(shape):
            places.append(Place(name, name, int(np.argmax(shape))))
        elif len(shape) == 2:
            along = 0 if shape[0] >= shape[1] else 1
            label = "(:,{})" if along == 0 else "({},:)"
            places += [Place(name + label.format(k + 1), name, along, k) for k in range(shape[1 - along])]
    return places
