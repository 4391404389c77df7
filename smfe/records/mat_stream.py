"""MATLAB files of version 5 to 7 as a stream: plain numbers, unpacked a block at a time.

After a header of 128 bytes each variable is an element: a tag of type and size (two 32-bit integers) and its bytes,
which of version 7 are packed (zlib). Within are array flags, dimensions, name and the samples column by column, each an
element again, padded to 8 bytes; one of at most 4 bytes has a tag of 4 (MAT-File Format, The MathWorks, chapter 1).
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

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

    def blocks(self, path: Path, first: int, count: int, block: int) -> Iterator[NDArray[np.float64]]:
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
        """Nothing tells whether they are right."""


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
        """Unpack to the end, where a sum tells whether all was right."""
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
