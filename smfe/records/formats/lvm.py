"""LabVIEW measurement files (.lvm), parsed with lvm_read block by block; each segment is a record."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import lvm_read
import numpy as np

from process.errors import InputError
from process.types import Real
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import Column, Format, Table, damaged, find_columns, guarded, join

_KIND = "a LabVIEW measurement file"
_WHOLE = 1 << 16
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_SHOWN = 3
"""Rows of a segment that tell how many columns it has."""


@dataclass
class _Part:
    """A segment: its lines up to the names of its channels, the byte its rows begin at, and how many there are."""

    header: list[str]
    begin: int = 0
    rows: int = 0


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of every segment of an LVM file; see `smfe.records.read_records`."""
    return [table for blocks in read_segments(path, wanted, _WHOLE) for table in join(blocks)]


def read_segments(path: Path, wanted: Sequence[Column], block: int) -> list[Iterator[Table]]:
    """Return the blocks of every segment; the file is gone through once for its headers, and once for its rows."""
    with damaged(path, _KIND), _open(path) as stream:
        first = stream.readline()
        if not first.strip() and not stream.read(4096).strip():
            raise InputError(f"{path.name}: the file is empty")
        if not first.startswith("LabVIEW Measurement"):
            raise InputError(f"{path.name}: not a LabVIEW measurement file; its first line must say so")
        header, parts = _layout(path)
        if not parts:
            raise ValueError("no data segment found; the separator does not match the file")
        return [_segment(path, header, part, number, wanted, block) for number, part in enumerate(parts)]


def stated_units(path: Path) -> dict[str, str]:
    """Return name of a column -> unit after ``Y_Unit_Label``; the X column is in seconds where it says "Time"."""
    with damaged(path, _KIND):
        header, parts = _layout(path)
        segment = _parsed("".join([*header, *parts[0].header]), _lines(path, parts[0].begin, 1))
        names = [name for name in segment["Channel names"] if name not in ("Comment", "X_Value")]
        found = dict(zip(names, segment.get("Y_Unit_Label", []), strict=False))
        if "Time" in segment.get("X_Dimension", ["Time"]):
            found["X_Value"] = "s"
    return found


def _open(path: Path, begin: int = 0) -> TextIO:
    """Return a file of text from a byte on; of thousands of segments each is gone to, not read up to."""
    stream = path.open("rb")
    stream.seek(begin)
    return TextIOWrapper(stream, encoding="utf-8", errors="ignore")


def _ended_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the byte behind each line of a text file, and the line, whatever ends it."""
    end = 0
    with path.open("rb") as stream:
        for row in stream:
            for raw in _LINE.findall(row) if b"\r" in row[:-2] else (row,):
                end += len(raw)
                text = raw.decode("utf-8", "ignore")
                yield end, text.rstrip("\r\n") + "\n" if text.endswith(("\r", "\n")) else text


def _layout(path: Path) -> tuple[list[str], list[_Part]]:
    """Return the header of the file and its segments: each begins with an empty line, its rows below ``X_Value``."""
    header: list[str] = []
    parts: list[_Part] = []
    separator, in_rows = "\t", False
    for number, (end, line) in enumerate(_ended_lines(path)):
        if number < 20 and line.startswith("Separator"):
            separator = line.strip()[9]
        if line in ("\n", f"{separator}\n"):
            parts.append(_Part([line]))
            in_rows = False
        elif in_rows:
            parts[-1].rows += 1
        elif parts:
            parts[-1].header.append(line)
            in_rows = line.split(separator)[0] == "X_Value"
            parts[-1].begin = end
        else:
            header.append(line)
    return header, [part for part in parts if part.header[-1].startswith("X_Value")]


def _segment(
    path: Path, header: list[str], part: _Part, number: int, wanted: Sequence[Column], block: int
) -> Iterator[Table]:
    prefix = "".join([*header, *part.header])
    segment = _parsed(prefix, _lines(path, part.begin, min(_SHOWN, part.rows)))
    source = f"{path.name}, segment {number}"
    stated = [int(samples) for samples in segment.get("Samples", []) if samples == samples]
    stated_rows = max(stated, default=1)
    names = [name for name in segment["Channel names"] if name != "Comment"]
    at = find_columns(source, names, wanted, min(len(names), np.atleast_2d(segment["data"]).shape[1]))
    clock: tuple[float | None, float, tuple[str, ...]] = (*_clock(segment), ())
    channels = re.search(r"^Channels[^0-9\n]*(\d+)", prefix, re.MULTILINE)
    if channels and int(channels[1]) != sum(name != "X_Value" for name in names):
        raise InputError(
            f"{source}: {sum(name != 'X_Value' for name in names)} channels are named where its header counts "
            f"{channels[1]}; the file is damaged: copy or export it again"
        )
    if part.rows > stated_rows and stated:
        note = f"{source}: {part.rows} rows where its header states {stated_rows}; all are read"
        clock = (*clock[:2], (note,))
    if part.rows < stated_rows:
        clock = _thinned(path, prefix, part, stated_rows, names, source)
    return guarded(path, _KIND, _blocks(path, prefix, part, at, clock, block))


def _thinned(
    path: Path, prefix: str, part: _Part, stated: int, names: Sequence[str], source: str
) -> tuple[float | None, float, tuple[str, ...]]:
    """Return the clock of a segment with fewer rows than its header states, and what is to be said of it.

    Of an export of every k-th sample the X column says the times: they are k ``Delta_X`` apart, which is still that of
    the recorder. Without an X column the clock is not known, and the campaign has to declare it.

    Raises
    ------
    InputError
        When the rows are no export of every k-th sample: the file is truncated.
    """
    said = f"{source}: {part.rows} of the {stated} samples that its header states"
    lines = _lines(path, part.begin, part.rows)
    segment = _parsed(prefix, lines)
    data: Real = np.atleast_2d(segment["data"])
    complete = bool(lines) and lines[-1].endswith("\n") and bool(np.all(np.isfinite(data[-1, : len(names)])))
    factor = _whole(stated / max(part.rows, 1))
    recorded, _ = _clock(segment)
    timed, step = names[:1] == ["X_Value"], 0.0
    if timed and part.rows > 1 and recorded is not None:
        step = float(data[-1, 0] - data[0, 0]) / (part.rows - 1)
        factor = _whole(step * recorded) if step > 0.0 else 0
    if not complete or factor < 2 or abs(part.rows - stated / factor) > 1.0:
        raise InputError(f"{said}; the file is truncated")
    if step > 0.0:
        note = f"{said}: an export of every {factor}. sample by the times of its X column, which is the clock"
        return 1.0 / step, float(data[0, 0]), (f"{note}; frequencies above half that rate are folded",)
    rate = "" if recorded is None else f' (sample_rate = "{recorded / factor:g} Hz" if Delta_X is the recorder\'s)'
    note = f"{said}, and no column of times: the file is truncated, or an export of every {factor}. sample"
    return None, 0.0, (f"{note}, whose clock is then to be declared{rate}",)


def _whole(ratio: float) -> int:
    """Return a ratio as a whole number; 0 where it is none within 2 %."""
    return round(ratio) if abs(ratio - round(ratio)) <= 0.02 * ratio else 0


def _blocks(
    path: Path,
    prefix: str,
    part: _Part,
    at: dict[Column, int],
    clock: tuple[float | None, float, tuple[str, ...]],
    block: int,
) -> Iterator[Table]:
    with _open(path, part.begin) as stream:
        rows = islice(stream, part.rows)
        while lines := list(islice(rows, block)):
            data: Real = np.atleast_2d(_parsed(prefix, lines)["data"])
            yield Table({column: np.ascontiguousarray(data[:, index]) for column, index in at.items()}, *clock)


def _lines(path: Path, begin: int, count: int) -> list[str]:
    with _open(path, begin) as stream:
        return list(islice(stream, count))


def _parsed(prefix: str, lines: Sequence[str]) -> dict[str, Any]:
    """Return one segment with some of its rows, as lvm_read understands them."""
    # read_str and not read: that would load (and leave) a pickle beside the file.
    segment: dict[str, Any] = lvm_read.read_str(prefix + "".join(lines))[0]
    return segment


def _clock(segment: dict[str, Any]) -> tuple[float | None, float]:
    """Return the sample rate [Hz] and the first time [s] where all channels share them."""
    step = {float(value) for value in segment.get("Delta_X", []) if value == value}
    start = {float(value) for value in segment.get("X0", []) if value == value}
    if len(step) != 1 or len(start) > 1 or not min(step) > 0.0:
        return None, 0.0
    return 1.0 / step.pop(), start.pop() if start else 0.0


FORMAT = format_apart(Format((".lvm",), read_tables, read_segments=read_segments, stated_units=stated_units))
