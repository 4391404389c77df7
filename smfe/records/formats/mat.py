"""MATLAB files: plain numbers of version 5 to 7 as a stream, else through scipy, version 7.3 (HDF5) through h5py."""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from scipy import io

from process.errors import InputError
from process.types import Real
from smfe.records.formats.hdf5 import Place, open_file, read_places
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import (
    Column,
    Format,
    Table,
    as_numbers,
    damaged,
    find_columns,
    guarded,
    join,
    refuse_larger,
    same_length,
    slices,
)

Place_ = tuple[str, str, int | tuple[int | slice, ...] | None]
"""Name of a column, its variable, and where in it: everything, a column, or an index."""

_KIND = "a MATLAB file"
_PARTS = (" real", " imag")
_WHOLE = 1 << 62
_TIMES = 3.5
"""Peak of the memory over the unpacked samples, of version 4 to 7 (measured: docs/records.md)."""


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted variables of a MATLAB file; see `smfe.records.read_records`.

    A matrix of several columns is offered column by column, as ``data(:,2)`` (one that is wider than long also row by
    row, ``data(2,:)``), an array of more dimensions along its longest, ``H(:,1,2)``, a structure field by field, as
    ``data.Fx``, a cell array as ``data{2}``. Of complex numbers ``H real`` and ``H imag`` are columns.
    """
    return join(read_blocks(path, wanted, _WHOLE))


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted variables, `block` at a time; version 4, and files with structures or text, are read whole."""
    with path.open("rb") as stream:
        head = stream.read(520)
    if not head:
        raise InputError(f"{path.name}: the file is empty")
    with damaged(path, _KIND):
        if head[512:] == b"\x89HDF\r\n\x1a\n":
            return _read_hdf5(path, wanted, block)
        _refuse_truncated(path)
        streamed = _stream(path, wanted, block)
        return slices(_read_mat(path, wanted), block) if streamed is None else guarded(path, _KIND, streamed)


def _stream(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table] | None:
    """Return the blocks of a file that holds plain numbers and nothing else; None where it has to be read whole."""
    found = plain_variables(path)
    places = [] if found is None else list(_places((name, variable.shape) for name, variable in found.items()))
    names = [name for name, _, _ in places]
    if found is None or any(isinstance(w, str) and names.count(w) != 1 for w in wanted):
        return None
    at = find_columns(path.name, names, wanted, len(places))
    parts, lengths = {}, {}
    for column, index in at.items():
        _, name, k = places[index]
        rows, columns = found[name].shape
        lengths[column] = rows * columns if k is None else rows
        first = 0 if k is None else k * rows
        parts[column] = found[name].blocks(path, first, lengths[column], block)
    same_length(path.name, lengths)
    return (Table(dict(zip(parts, arrays, strict=True))) for arrays in zip(*parts.values(), strict=True))


def _refuse_truncated(path: Path) -> None:
    """Refuse a version 5 file that ends within a variable: scipy would list the variables before it and say nothing.

    After a header of 128 bytes each variable is a tag of type and size (two 32-bit integers) and as many bytes.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        header = stream.read(128)
        # Version 4 has no such header; its own reader finds out.
        if header[126:128] not in (b"IM", b"MI"):
            return
        order = "<" if header[126:128] == b"IM" else ">"
        place = 128
        while place < size:
            stream.seek(place)
            tag = stream.read(8)
            length = struct.unpack(f"{order}II", tag)[1] if len(tag) == 8 else size
            place += 8 + length
    if place > size:
        raise InputError(
            f"{path.name}: the file is truncated: its last variable needs {place - size} bytes more than the "
            f"{size} that are there; copy it again"
        )


def _read_mat(path: Path, wanted: Sequence[Column]) -> Table:
    kinds = {name: (shape, kind) for name, shape, kind in io.whosmat(path)}
    shapes = {n: shape for n, (shape, kind) in kinds.items() if kind not in ("char", "cell", "struct", "object")}
    structures = [name for name, (_, kind) in kinds.items() if kind in ("struct", "cell")]
    fields: dict[str, Any] = {}
    if any(isinstance(w, int) or _bare(w, shapes) not in shapes for w in wanted) and structures:
        # What a structure holds is known only when it has been read.
        refuse_larger(path, _TIMES)
        content = io.loadmat(path, variable_names=structures)
        fields = {
            name: value for s in structures for name, value in _fields(s, content[s]) if value.dtype.kind in "biufc"
        }
    every = shapes | {name: value.shape for name, value in fields.items()}
    at, places = _found(path, every, wanted)
    needed = sorted({places[index][1] for index, _ in at.values()} - set(fields))
    refuse_larger(path, _TIMES, sum(8 * math.prod(shapes[name]) for name in needed))
    return _table(path, at, places, fields | io.loadmat(path, variable_names=needed) if needed else fields)


def _bare(name: Column, known: Iterable[str]) -> Column:
    """Return the array that "H real" and "H imag" are parts of, and any other name as it is."""
    if isinstance(name, str) and name not in known:
        for part in _PARTS:
            if name.endswith(part):
                return name.removesuffix(part)
    return name


Found = dict[Column, tuple[int, str]]


def _found(path: Path, shapes: Mapping[str, tuple[int, ...]], wanted: Sequence[Column]) -> tuple[Found, list[Place_]]:
    """Return for each wanted column which place it is and which part of its numbers, and the places."""
    places = [*_places(shapes.items()), *_further_places(shapes.items())]
    names = [name for name, _, _ in places]
    bare = {w: _bare(w, names) for w in wanted}
    at = find_columns(path.name, names, list(bare.values()), len(places))
    return {w: (at[b], str(w)[-5:] if w != b else "") for w, b in bare.items()}, places


def _fields(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the arrays in a structure or cell, named as in MATLAB: ``data.Fx``, ``record.Y(2).Data``, ``H{2}``."""
    if value.dtype.kind == "O":
        for k, element in enumerate(value.ravel(order="F")):
            yield from _fields(f"{name}{{{k + 1}}}", np.asarray(element))
        return
    if value.dtype.names is None:
        yield name, value
        return
    for k, element in enumerate(value.ravel(order="F")):
        label = name if value.size == 1 else f"{name}({k + 1})"
        for field in value.dtype.names:
            yield from _fields(f"{label}.{field}", np.asarray(element[field]))


def _read_hdf5(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    with open_file(path) as file:
        # MATLAB stores by column, HDF5 by row: a matrix comes out transposed.
        shapes: dict[str, tuple[int, ...]] = {}
        further: dict[str, tuple[int, ...]] = {}

        def visit(name: str, item: object) -> None:
            if isinstance(item, h5py.Dataset) and item.ndim >= 2 and name[0] != "#":
                # MATLAB writes complex numbers as pairs of real ones.
                if item.dtype.kind in "biuf" and item.ndim == 2:
                    shapes[name.replace("/", ".")] = item.shape[::-1]
                elif item.dtype.kind in "biufc" or item.dtype.names == ("real", "imag"):
                    further[name.replace("/", ".")] = item.shape[::-1]

        file.visititems(visit)
        names = [name for name, _, _ in _places(shapes.items())]
        if any(isinstance(w, str) and w not in names for w in wanted):
            among, whole = _found(path, shapes | further, wanted)
            needed = {whole[index][1] for index, _ in among.values()}
            content = {name: _complex(file[name.replace(".", "/")][()]).T for name in needed}
            return iter(slices(_table(path, among, whole, content), block))
    found = list(_places(shapes.items()))
    at = find_columns(path.name, [name for name, _, _ in found], wanted, len(found))
    places = {}
    for column, index in at.items():
        name, variable, k = found[index]
        rows, columns = shapes[variable]
        places[column] = Place(name, variable.replace(".", "/"), 1 if k is not None or rows >= columns else 0, k)
    return read_places(path, _KIND, places, block)


def _places(shapes: Iterable[tuple[str, tuple[int, ...]]]) -> Iterable[tuple[str, str, int | None]]:
    """Yield (name of the column, variable, column of the matrix) for all that can be a channel."""
    for name, shape in shapes:
        if len(shape) == 2 and min(shape) > 1:
            yield from ((f"{name}(:,{k + 1})", name, k) for k in range(shape[1]))
        elif len(shape) <= 2:
            yield name, name, None


def _further_places(shapes: Iterable[tuple[str, tuple[int, ...]]]) -> Iterable[Place_]:
    """Yield rows of matrices that are wider than long, and the vectors of arrays of more dimensions."""
    for name, shape in shapes:
        if len(shape) < 2 or (len(shape) == 2 and (min(shape) < 2 or shape[0] >= shape[1])):
            continue
        along = int(np.argmax(shape))
        for index in itertools.product(*(range(1 if axis == along else size) for axis, size in enumerate(shape))):
            place = tuple(slice(None) if axis == along else k for axis, k in enumerate(index))
            text = ",".join(":" if isinstance(k, slice) else str(k + 1) for k in place)
            yield f"{name}({text})", name, place


def _complex(values: Any) -> Any:
    """Return pairs of real numbers as complex ones, and any other array as it is."""
    return values["real"] + 1j * values["imag"] if values.dtype.names == ("real", "imag") else values


def _table(path: Path, at: Found, places: Sequence[Place_], content: dict[str, Any]) -> Table:
    columns = {}
    for column, (index, part) in at.items():
        name, variable, k = places[index]
        values = np.asarray(content[variable])
        vector = values if k is None else values[k] if isinstance(k, tuple) else values[:, k]
        if part:
            if vector.dtype.kind != "c":
                raise InputError(
                    f"{path.name}: '{name}' is not complex and has no part '{part.strip()}'; name it alone"
                )
            vector = vector.real if part == _PARTS[0] else vector.imag
        columns[column] = as_numbers(path.name, column, vector)
    same_length(path.name, columns)
    return Table(columns)


# --- MATLAB files of version 5 to 7 as a stream: plain numbers, unpacked a block at a time.

_HEADER = 128
_HEAD = 4096
"""Bytes of a variable in which its flags, dimensions and name are looked for."""

_READ = 1 << 16
_MOST_COMPRESSED = 1100
"""Deflate cannot shrink data further than this."""

_MATRIX, _COMPRESSED = 14, 15
_COMPLEX = 0x0800
_NUMERIC = range(6, 16)
"""Classes of arrays of numbers, from double to 64-bit integers."""

_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of an element -> how its numbers are stored; whole doubles are stored in fewer bytes."""


@dataclass(frozen=True)
class Variable:
    """An array of real numbers in a file.

    Parameters
    ----------
    shape : tuple of int
        Its dimensions.
    place, length : int
        Where its element begins in the file, and its bytes there.
    packed : bool
        Whether it has to be unpacked.
    begin : int
        Where its samples begin in the element, unpacked.
    stored : dtype
        Of the samples.
    """

    shape: tuple[int, ...]
    place: int
    length: int
    packed: bool
    begin: int
    stored: np.dtype[np.generic]

    def blocks(self, path: Path, first: int, count: int, block: int) -> Iterator[Real]:
        """Yield `count` samples from number `first` on, `block` at a time."""
        size = self.stored.itemsize
        with path.open("rb") as file:
            file.seek(self.place)
            stream = _Unpacked(file, self.length) if self.packed else _Plain(file)
            stream.skip(self.begin + first * size)
            for begin in range(0, count, block):
                wanted = min(block, count - begin)
                raw = stream.read(wanted * size)
                if len(raw) != wanted * size:
                    raise ValueError(f"samples end after {begin + len(raw) // size} of {count}")
                yield np.frombuffer(raw, self.stored).astype(np.float64)
            stream.finish()


class _Plain:
    """Bytes as they stand in the file."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file

    def skip(self, count: int) -> None:
        self.file.seek(count, 1)

    def read(self, count: int) -> bytes:
        return self.file.read(count)

    def finish(self) -> None:
        """Do nothing: plain bytes carry no checksum."""


class _Unpacked:
    """Bytes that are unpacked as they are asked for."""

    def __init__(self, file: BinaryIO, length: int) -> None:
        self.file, self.left, self.unpack = file, length, zlib.decompressobj()

    def read(self, count: int) -> bytes:
        out = bytearray()
        while len(out) < count:
            packed = self.unpack.unconsumed_tail
            if not packed:
                packed = self.file.read(min(_READ, self.left))
                self.left -= len(packed)
            part = self.unpack.decompress(packed, count - len(out))
            if not part and not packed:
                break
            out += part
        return bytes(out)

    def skip(self, count: int) -> None:
        while count > 0 and (part := self.read(min(count, _READ))):
            count -= len(part)

    def finish(self) -> None:
        """Unpack to the end, where the checksum of the stream is."""
        while self.read(_READ):
            pass
        if not self.unpack.eof:
            raise ValueError("a packed variable ends before its check sum")


def plain_variables(path: Path) -> dict[str, Variable] | None:
    """Return the arrays of real numbers of a file, None where it holds anything else or is of version 4."""
    size = path.stat().st_size
    found: dict[str, Variable] = {}
    with path.open("rb") as file:
        header = file.read(_HEADER)
        if header[126:128] not in (b"IM", b"MI"):
            return None
        order = "<" if header[126:128] == b"IM" else ">"
        place = _HEADER
        while place < size:
            file.seek(place)
            kind, length = struct.unpack(f"{order}II", file.read(8))
            if kind not in (_MATRIX, _COMPRESSED):
                return None
            named = _variable(file, order, place + 8, length, kind == _COMPRESSED)
            if named is None:
                return None
            found[named[0]] = named[1]
            place += 8 + length
    return found


def _variable(file: BinaryIO, order: str, place: int, length: int, packed: bool) -> tuple[str, Variable] | None:
    """Return name and variable of an element that begins at `place`; None for what is no array of real numbers."""
    raw = file.read(min(length, _HEAD))
    head, at = (zlib.decompressobj().decompress(raw, _HEAD), 8) if packed else (raw, 0)
    if packed and struct.unpack_from(f"{order}I", head)[0] != _MATRIX:
        return None
    _, flags, at = _element(head, at, order)
    word = struct.unpack_from(f"{order}I", flags)[0]
    if word & 0xFF not in _NUMERIC or word & _COMPLEX:
        return None
    _, dims, at = _element(head, at, order)
    shape = tuple(int(n) for n in np.frombuffer(dims, f"{order}i4"))
    _, name, at = _element(head, at, order)
    kind, count, begin = _tag(head, at, order)
    if kind not in _STORED or len(shape) != 2 or min(shape) < 1:
        return None
    stored = np.dtype(f"{order}{_STORED[kind]}")
    if count != math.prod(shape) * stored.itemsize or count > (_MOST_COMPRESSED * length if packed else length - begin):
        return None
    return name.decode("latin-1"), Variable(shape, place, length, packed, begin, stored)


def _tag(head: bytes, at: int, order: str) -> tuple[int, int, int]:
    """Return type of an element, its bytes, and where they begin."""
    kind, count = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:  # a small element: size and type share the first number
        return kind & 0xFFFF, kind >> 16, at + 4
    return kind, count, at + 8


def _element(head: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Return type and bytes of an element, and where the next begins."""
    kind, count, begin = _tag(head, at, order)
    content = head[begin : begin + count]
    if len(content) < count:
        raise ValueError("a variable whose description is longer than any is")
    return kind, content, at + 8 if begin == at + 4 else begin + -(-count // 8) * 8


FORMAT = format_apart(Format((".mat",), read_tables, read_blocks, needs_time=lambda path: True))
