"""What MATLAB 7.3, NetCDF-4 and plain HDF5 have in common: data sets that are read through h5py, slice by slice."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
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


@contextmanager
def open_file(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading, if all that it holds is in it.

    Raises
    ------
    InputError
        When its samples, or a group, are those of another file: that may be any file of this machine.
    """
    with h5py.File(path, "r", rdcc_nbytes=_CHUNK_CACHE) as file:
        _refuse_elsewhere(path, file)
        yield file


def _refuse_elsewhere(path: Path, file: h5py.File) -> None:
    seen: set[int] = set()
    groups: list[tuple[str, h5py.Group]] = [("", file)]
    while groups:
        above, group = groups.pop()
        at = h5py.h5o.get_info(group.id).addr
        if at in seen:
            continue
        seen.add(at)
        for key in group:
            name, elsewhere = f"{above}{key}", None
            link = group.get(key, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                elsewhere = link.filename
            elif isinstance(link, h5py.HardLink):
                try:
                    item = group[key]
                except Exception:  # what cannot be opened is refused where it is asked for
                    continue
                if isinstance(item, h5py.Group):
                    groups.append((f"{name}/", item))
                elif isinstance(item, h5py.Dataset):
                    elsewhere = _other_file(path, item)
            if elsewhere is not None:
                raise InputError(
                    f"{path.name}: '{name}' stands in another file, '{elsewhere}'; only what is in the file itself is "
                    "read: write it into one file (h5repack, or h5py's copy with expand_external)"
                )


def _other_file(path: Path, item: h5py.Dataset) -> str | None:
    """Return the file outside that holds samples of a data set; None where there is none."""
    if item.external:
        return str(item.external[0][0])
    if item.is_virtual:
        names = (source.file_name for source in item.virtual_sources())
        return next((name for name in names if name not in (".", path.name)), None)
    return None


_SMALL = 1 << 16
"""Data sets of fewer bytes are read by `walk`: names of axes, scalars, texts."""


def walk(path: Path) -> None:
    """Look at everything in a file but the samples, where damaged ones keep the library for ever or end it.

    Its time does not depend on the samples: the index of their pieces is gone through, they are not read.
    """
    seen: set[int] = set()

    def visit(item: object) -> None:
        """Look at an object and what is in it; one that cannot be opened does not keep from its neighbours."""
        if not isinstance(item, h5py.HLObject) or (at := h5py.h5o.get_info(item.id).addr) in seen:
            return
        seen.add(at)
        for look in (_attributes, _scales, _index, _content) if isinstance(item, h5py.Dataset) else (_attributes,):
            with suppress(Exception):
                look(item)
        if isinstance(item, h5py.Group):
            for name in item:
                with suppress(Exception):
                    visit(item[name])

    try:
        with open_file(path) as file:
            visit(file)
            file.visititems(lambda name, item: None)
    except InputError:
        raise
    except Exception:  # the reader meets it as well, and says it
        return


def _attributes(item: h5py.HLObject) -> None:
    for name in item.attrs:
        with suppress(Exception):
            item.attrs[name]


def _scales(item: h5py.Dataset) -> None:
    for dimension in item.dims:
        len(dimension)
        dimension.values()


def _index(item: h5py.Dataset) -> None:
    item.id.get_storage_size()
    if item.chunks is not None:
        item.id.get_num_chunks()


def _content(item: h5py.Dataset) -> None:
    if item.size and item.size * item.dtype.itemsize <= _SMALL:
        item[()]


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
        notes = end_notes(path)
        for begin in range(0, max(size, 1), block):
            part = slice(begin, min(begin + block, size))
            yield Table(
                {c: as_numbers(path.name, c, _values(file[place.dataset], place, part)) for c, place in places.items()},
                notes=notes,
            )


def end_notes(path: Path) -> tuple[str, ...]:
    """Return what is to be said of a file that is longer than its superblock says; a shorter one h5py refuses."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        place = 0
        while place < size:  # behind a block of the user's, whose length is a power of two
            stream.seek(place)
            head = stream.read(64)
            if head[:8] == b"\x89HDF\r\n\x1a\n":
                break
            place = max(512, 2 * place)
    if place >= size or len(head) < 56:
        return ()
    version, width = head[8], head[13] if head[8] < 2 else head[9]
    if width != 8:
        return ()
    # Version 0 and 1: base, free space, end of file; 2 and 3: base, extension, end of file.
    end = struct.unpack_from("<Q", head, {0: 40, 1: 44}.get(version, 28))[0]
    if end == size:
        return ()
    return (f"{path.name}: {size} bytes where its superblock says {end}; the file, or its begin, may be damaged",)


def _checked_length(path: Path, dataset: h5py.Dataset, place: Place) -> int:
    stated = int(np.prod(dataset.shape, dtype=object)) * dataset.dtype.itemsize
    if dataset.is_virtual:  # its samples are those of others
        return int(dataset.shape[place.along])
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
