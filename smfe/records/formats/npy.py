"""NumPy files: .npy and .npz, arrays of numbers and lists of such arrays.

Lists of arrays are pickles, and a pickle may run any code when it is loaded. They are taken apart here without NumPy's
and Python's own constructors: of the four that such a file names, stand-ins note down the arguments; any other is
refused.
"""

from __future__ import annotations

import io
import itertools
import pickle
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import (
    Column,
    Format,
    Table,
    as_numbers,
    damaged,
    find_columns,
    refuse_larger,
    refuse_oversize,
    same_length,
)

_KIND = "a NumPy file"
_MOST_COMPRESSED = 1100.0
_MOST_COLUMNS = 10_000
_TIMES = 3.5
"""Peak of the memory over the size of a file (measured: docs/records.md)."""

Numbers = NDArray[Any]


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a NumPy file; see `smfe.records.read_records`.

    Columns are called as Python would index them, with the samples along the longest dimension: ``u[0,:]`` of an .npz
    file, ``[:,2]`` or ``[1][0,3,:]`` of an .npy file; complex ones with `` real`` and `` imag`` behind.
    """
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the file is empty")
    refuse_larger(path, _TIMES)
    with damaged(path, _KIND):
        columns = dict(itertools.islice(_columns(path), _MOST_COLUMNS))
        names = list(columns)
        at = find_columns(path.name, names, wanted, len(names))
        found = {column: as_numbers(path.name, column, columns[names[index]]) for column, index in at.items()}
    same_length(path.name, found)
    return [Table(found)]


def _columns(path: Path) -> Iterator[tuple[str, Numbers]]:
    if not zipfile.is_zipfile(path):
        yield from _named("", _value(path, path.read_bytes()))
        return
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            refuse_oversize(path, member.file_size, member.compress_size, _MOST_COMPRESSED)
            yield from _named(member.filename.removesuffix(".npy"), _value(path, archive.read(member)))


def _named(name: str, value: Any) -> Iterator[tuple[str, Numbers]]:
    """Yield the vectors in an array or a list of arrays, each with its name."""
    if isinstance(value, list):
        for k, item in enumerate(value):
            yield from _named(f"{name}[{k}]", item)
        return
    if value.dtype.kind not in "biufc" or value.ndim == 0:
        return
    along = int(np.argmax(value.shape))
    others = [range(size) for axis, size in enumerate(value.shape) if axis != along]
    for index in itertools.product(*others):
        place: list[Any] = list(index)
        place.insert(along, slice(None))
        text = ",".join(":" if isinstance(k, slice) else str(k) for k in place)
        label = name if value.ndim == 1 and name else f"{name}[{text}]"
        vector = value[tuple(place)]
        if value.dtype.kind == "c":
            yield f"{label} real", vector.real
            yield f"{label} imag", vector.imag
        else:
            yield label, vector


def _value(path: Path, content: bytes) -> Any:
    """Return the array of an .npy file, or its list of arrays."""
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = header(stream)
    if dtype.hasobject:
        return _plain(_Unpickler(stream).load())
    stated = int(np.prod(shape, dtype=object)) * dtype.itemsize
    refuse_oversize(path, stated, len(content) - stream.tell(), slack=0)
    return np.frombuffer(content, dtype, int(np.prod(shape)), stream.tell()).reshape(
        shape, order="F" if fortran else "C"
    )


class _Type:
    """Stand-in for numpy.dtype."""

    order = "|"

    def __init__(self, code: str, *_: object) -> None:
        self.code = code

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = state[1]


class _Array:
    """Stand-in for numpy.ndarray."""

    state: tuple[Any, ...] = ()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.state = state


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        stand_ins = {
            ("numpy", "ndarray"): _Array,
            ("numpy", "dtype"): _Type,
            ("multiarray", "_reconstruct"): lambda *_: _Array(),
            ("_codecs", "encode"): lambda text, _: text.encode("latin-1"),
        }
        key = module.rpartition(".")[2], name
        if key not in stand_ins:
            raise pickle.UnpicklingError(f"it would call {module}.{name}")
        return stand_ins[key]


def _plain(item: Any) -> Any:
    """Return what a stand-in noted down: an array of numbers, or a list of them."""
    if not isinstance(item, _Array):
        return np.asarray(item if isinstance(item, int | float | complex) else "")
    _, shape, kind, fortran, data = item.state
    if kind.code.startswith("O"):
        return [_plain(child) for child in data]
    if kind.code[0] not in "biufc":
        return np.asarray("")
    return np.frombuffer(data, kind.order + kind.code).reshape(shape, order="F" if fortran else "C")


FORMAT = format_apart(Format((".npy", ".npz"), read_tables, needs_time=lambda path: True))
