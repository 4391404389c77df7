"""NumPy files: .npy and .npz, arrays of numbers and lists of such arrays.

Lists of arrays are pickles, and a pickle may run any code, or ask for any memory, when it is loaded. It is never
loaded: its words are read one by one, and of the four calls that such a file names the arguments are noted down; any
other is refused.
"""

from __future__ import annotations

import io
import itertools
import pickletools
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
        return _plain(_listed(stream))
    stated = int(np.prod(shape, dtype=object)) * dtype.itemsize
    refuse_oversize(path, stated, len(content) - stream.tell(), slack=0)
    return np.frombuffer(content, dtype, int(np.prod(shape)), stream.tell()).reshape(
        shape, order="F" if fortran else "C"
    )


class _Mark:
    """Where a tuple or a list begins on the stack."""


@dataclass
class _Made:
    """What a pickle would make by a call: its name, its arguments and its state."""

    name: str
    arguments: tuple[Any, ...] = ()
    state: tuple[Any, ...] = ()


_KNOWN = {
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    ("multiarray", "_reconstruct"): "array",
    ("_codecs", "encode"): "bytes",
}
"""What a list of arrays names: module (its last part) and name."""

_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_EMPTY: dict[str, Callable[[], Any]] = {"EMPTY_TUPLE": tuple, "EMPTY_LIST": list}
_PUSHED = ("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8")
_BYTES = ("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BINSTRING", "SHORT_BINSTRING")


def _listed(stream: io.BytesIO) -> Any:
    """Return what a list of arrays notes down, read word by word; nothing is called, whatever it names."""
    stack: list[Any] = []
    memo: dict[int, Any] = {}

    def since_mark() -> list[Any]:
        at = max(k for k, item in enumerate(stack) if isinstance(item, _Mark))
        found = stack[at + 1 :]
        del stack[at:]
        return found

    def named(module: str, name: str) -> _Made:
        known = _KNOWN.get((module.rpartition(".")[2], name))
        if known is None:
            raise ValueError(f"it would call {module}.{name}")
        return _Made(known)

    value: Any
    for word, value, _ in pickletools.genops(stream):
        match word.name:
            case "PROTO" | "FRAME":
                pass
            case "STOP":
                return stack.pop()
            case name if name in _CONSTANTS:
                stack.append(_CONSTANTS[name])
            case name if name in _EMPTY:
                stack.append(_EMPTY[name]())
            case name if name in _PUSHED:
                stack.append(value)
            case name if name in _BYTES:
                stack.append(value.encode("latin-1") if isinstance(value, str) else bytes(value))
            case "MARK":
                stack.append(_Mark())
            case "TUPLE":
                stack.append(tuple(since_mark()))
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                count = int(word.name[-1])
                found = tuple(stack[-count:])
                del stack[-count:]
                stack.append(found)
            case "APPENDS":
                found = tuple(since_mark())
                stack[-1].extend(found)
            case "APPEND":
                item = stack.pop()
                stack[-1].append(item)
            case "PUT" | "BINPUT" | "LONG_BINPUT":
                memo[int(value)] = stack[-1]
            case "MEMOIZE":
                memo[len(memo)] = stack[-1]
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(memo[int(value)])
            case "GLOBAL":
                stack.append(named(*value.split(" ")))
            case "STACK_GLOBAL":
                name, module = stack.pop(), stack.pop()
                stack.append(named(module, name))
            case "REDUCE":
                arguments, called = stack.pop(), stack.pop()
                made = _Made(called.name, arguments)
                stack.append(arguments[0].encode("latin-1") if called.name == "bytes" else made)
            case "BUILD":
                state = stack.pop()
                stack[-1].state = state
            case other:
                raise ValueError(f"{other} in a list of arrays")
    raise ValueError("a list of arrays without an end")


def _plain(item: Any) -> Any:
    """Return what was noted down: an array of numbers, or a list of them."""
    if not isinstance(item, _Made) or item.name != "array":
        return np.asarray(item if isinstance(item, int | float | complex) else "")
    _, shape, kind, fortran, data = item.state
    code = kind.arguments[0]
    code = code.decode("latin-1") if isinstance(code, bytes) else code
    if code.startswith("O"):
        return [_plain(child) for child in data]
    if code[0] not in "biufc":
        return np.asarray("")
    return np.frombuffer(data, kind.state[1] + code).reshape(shape, order="F" if fortran else "C")


FORMAT = format_apart(Format((".npy", ".npz"), read_tables, needs_time=lambda path: True))
