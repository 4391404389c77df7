"""WAV files (RIFF and RF64): PCM of 8 to 32 bits and floating point, read block by block.

Integers come out as shares of full scale, -1 to 1, floating-point numbers as they stand; the `scale` of a channel says
how much full scale is. The layout is that of the Multimedia Programming Interface 1.0 (IBM, Microsoft 1991), RF64 that
of EBU Tech 3306.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from process.errors import InputError
from process.types import Real
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import Column, Format, Table, damaged, find_columns, guarded, join, refuse_oversize

_KIND = "WAV"
_WHOLE = 1 << 20
_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_UNKNOWN = 0xFFFFFFFF
"""Length of a chunk whose true length stands in the ds64 chunk, or was never written."""


@dataclass(frozen=True)
class _Layout:
    """Format of the samples and where they stand: bytes, all counted from the begin of the file."""

    tag: int
    channels: int
    rate: int
    bytes_each: int
    begin: int
    length: int
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        return self.length // (self.channels * self.bytes_each)


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted channels of a WAV file, by position; see `smfe.records.read_records`."""
    return join(read_blocks(path, wanted, _WHOLE))


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted channels of a WAV file, `block` samples at a time."""
    with damaged(path, _KIND), path.open("rb") as stream:
        layout = _layout(path, stream)
    at = find_columns(path.name, [], wanted, layout.channels)
    return guarded(path, _KIND, _blocks(path, layout, at, block))


def _layout(path: Path, stream: BinaryIO) -> _Layout:
    head = stream.read(12)
    if not head:
        raise InputError(f"{path.name}: the file is empty")
    if head[:4] not in (b"RIFF", b"RF64") or head[8:] != b"WAVE":
        raise InputError(f"{path.name}: not a WAV file; it must begin with RIFF and WAVE")
    size = path.stat().st_size
    stated = 8 + struct.unpack("<I", head[4:8])[0]
    form: tuple[int, ...] | None = None
    long_length = counted = None
    while len(header := stream.read(8)) == 8:
        name, length = header[:4], struct.unpack("<I", header[4:])[0]
        begin = stream.tell()
        if name == b"ds64":
            long_length = struct.unpack("<QQ", stream.read(16))[1]
        elif name == b"fmt ":
            form = _format(stream.read(min(length, 40)))
        elif name == b"fact" and length >= 4:
            counted = struct.unpack("<I", stream.read(4))[0]
        elif name == b"data":
            if form is None:
                break
            if length == _UNKNOWN:
                length = long_length if long_length is not None else size - begin
            refuse_oversize(path, begin + length, size, slack=0)
            layout = _checked(path, form, begin, length)
            if counted not in (None, 0, _UNKNOWN, layout.frames):
                raise InputError(
                    f"{path.name}: {layout.frames} samples a channel where its header counts {counted}; the file is "
                    "damaged: copy or export it again"
                )
            return replace(layout, notes=_end(path, head, stated, begin + length, size))
        stream.seek(begin + length + length % 2)
    raise InputError(f"{path.name}: a WAV file without samples; it is truncated or damaged: copy or export it again")


def _end(path: Path, head: bytes, stated: int, end: int, size: int) -> tuple[str, ...]:
    """Return what is to be said of a file that does not end where its header says; recorders leave it open."""
    if head[:4] == b"RF64" or stated in (8, 8 + _UNKNOWN) or abs(stated - size) <= 1:
        return ()
    if stated < end:
        raise InputError(
            f"{path.name}: its header says that it ends after {stated} bytes, and its samples after {end}; the file is "
            "damaged: copy or export it again"
        )
    return (f"{path.name}: {size} bytes where its header says {stated}; what follows the samples is not read",)


def _format(text: bytes) -> tuple[int, ...]:
    """Return tag, channels, rate, bytes a second, bytes a frame and bits."""
    tag, *others = struct.unpack("<HHIIHH", text[:16])
    if tag == _EXTENSIBLE:
        tag = struct.unpack("<H", text[24:26])[0]
    return tag, *others


def _checked(path: Path, form: tuple[int, ...], begin: int, length: int) -> _Layout:
    tag, channels, rate, each_second, frame, bits = form
    known = {_PCM: (8, 16, 24, 32), _FLOAT: (32, 64)}
    if bits not in known.get(tag, ()):
        raise InputError(
            f"{path.name}: samples of format {tag} with {bits} bits are not read; PCM of 8, 16, 24 or 32 bits and "
            "floating point of 32 or 64 bits are: export it as one of them"
        )
    wrong = frame != channels * bits // 8 or each_second != frame * rate
    if channels < 1 or rate < 1 or wrong or length % frame:
        raise InputError(
            f"{path.name}: {channels} channels of {bits} bits at {rate} Hz, {frame} bytes a frame, {each_second} bytes "
            f"a second and {length} bytes of samples do not fit together; the file is damaged: copy or export it again"
        )
    return _Layout(tag, channels, rate, bits // 8, begin, length)


def _blocks(path: Path, layout: _Layout, at: dict[Column, int], block: int) -> Iterator[Table]:
    with path.open("rb") as stream:
        stream.seek(layout.begin)
        for begin in range(0, max(layout.frames, 1), block):
            count = min(block, layout.frames - begin)
            raw = stream.read(count * layout.channels * layout.bytes_each)
            values = _numbers(raw, layout).reshape(count, layout.channels)
            yield Table(
                {c: np.ascontiguousarray(values[:, k]) for c, k in at.items()}, float(layout.rate), notes=layout.notes
            )


def _numbers(raw: bytes, layout: _Layout) -> Real:
    """Return samples as numbers: integers as shares of full scale (8 bits are unsigned around 128)."""
    if layout.tag == _FLOAT:
        return np.frombuffer(raw, f"<f{layout.bytes_each}").astype(np.float64)
    if layout.bytes_each == 1:
        return (np.frombuffer(raw, np.uint8).astype(np.float64) - 128.0) / 128.0
    if layout.bytes_each == 3:
        wide = np.zeros((len(raw) // 3, 4), np.uint8)
        wide[:, 1:] = np.frombuffer(raw, np.uint8).reshape(-1, 3)
        return wide.view("<i4")[:, 0].astype(np.float64) / 2.0**31
    return np.frombuffer(raw, f"<i{layout.bytes_each}").astype(np.float64) / 2.0 ** (8 * layout.bytes_each - 1)


FORMAT = format_apart(Format((".wav",), read_tables, read_blocks))
