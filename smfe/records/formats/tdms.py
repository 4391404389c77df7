"""National Instruments TDMS files, read with npTDMS, block by block."""

from __future__ import annotations

import logging
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager

from process.errors import InputError
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
    refuse_oversize,
)

_KIND = "TDMS"
_WHOLE = 1 << 20


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted channels of a TDMS file; see `smfe.records.read_records`."""
    return join(read_blocks(path, wanted, _WHOLE))


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted channels, `block` samples at a time.

    A channel is named ``group/channel``, or ``channel`` alone where only one group has it. The clock is that of the
    waveform properties (``wf_increment``, ``wf_start_offset``) where all wanted channels share them.
    """
    with path.open("rb") as stream:
        head = stream.read(4)
    if not head:
        raise InputError(f"{path.name}: the file is empty")
    if head != b"TDSm":
        raise InputError(f"{path.name}: not a TDMS file; it must begin with the letters TDSm")
    _refuse_truncated(path)
    with damaged(path, _KIND), _open(path) as file, _quiet():
        channels = [channel for group in file.groups() for channel in group.channels()]
        plain = Counter(channel.name for channel in channels)
        full = [f"{channel.group_name}/{channel.name}" for channel in channels]
        names = [c.name if plain[c.name] == 1 and c.name in wanted else f for c, f in zip(channels, full, strict=True)]
        at = find_columns(path.name, names, wanted, len(names))
        stated = sum(len(channels[index]) * _item_size(channels[index]) for index in set(at.values()))
    refuse_oversize(path, stated, path.stat().st_size)
    return guarded(path, _KIND, _blocks(path, at, block))


def stated_units(path: Path) -> dict[str, str]:
    """Return ``group/channel`` -> unit after the property ``unit_string`` (or ``Unit``, ``NI_UnitDescription``)."""
    keys = ("unit_string", "Unit", "unit", "NI_UnitDescription")
    found = {}
    with damaged(path, _KIND), _open(path) as file:
        for channel in (c for group in file.groups() for c in group.channels()):
            text = next((str(channel.properties[key]) for key in keys if channel.properties.get(key)), "")
            found[f"{channel.group_name}/{channel.name}"] = text
    return found


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a file as a stream: npTDMS leaves its own open when it fails, and would read an index file beside it."""
    with path.open("rb") as stream:
        with _quiet():
            file = TdmsFile.open(stream)
        with file:
            yield file


class _Refuse(logging.Handler):
    """Makes an exception of what npTDMS only logs: sizes of samples that do not fit together."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name in ("nptdms.tdms_segment", "nptdms.reader") and record.levelno >= logging.WARNING:
            raise ValueError(record.getMessage())


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep npTDMS from writing to the terminal, and refuse what it would read in spite of a warning."""
    terminal, logger, refuse = log_manager.console_handler, logging.getLogger("nptdms"), _Refuse()
    level = terminal.level
    terminal.setLevel(logging.CRITICAL)
    logger.addHandler(refuse)
    try:
        yield
    finally:
        logger.removeHandler(refuse)
        terminal.setLevel(level)


def _refuse_truncated(path: Path) -> None:
    """Refuse a file that ends within a segment: npTDMS would read what is there and only log it.

    A segment begins with 28 bytes: TDSm, contents, version, then how many bytes follow (64 bits); all ones where the
    recorder broke off.
    """
    size = path.stat().st_size
    place = 0
    with path.open("rb") as stream:
        while place < size:
            stream.seek(place)
            lead = stream.read(28)
            order = ">" if len(lead) > 4 and lead[4] & 0x40 else "<"
            follow = struct.unpack(f"{order}Q", lead[12:20])[0] if len(lead) == 28 else size
            place += 28 + follow
            if lead[:4] != b"TDSm" or place > size:
                raise InputError(
                    f"{path.name}: the segment that begins at byte {place - 28 - follow} is damaged or ends after the "
                    f"{size} bytes of the file; it is truncated or its recorder broke off: copy or export it again"
                )


def _item_size(channel: Any) -> int:
    """Return the bytes of one stored number; scaled ones grow when they are read."""
    return 1 if channel.data_type is None or channel.data_type.size is None else int(channel.data_type.size)


def _blocks(path: Path, at: dict[Column, int], block: int) -> Iterator[Table]:
    with _open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        used = {column: channels[index] for column, index in at.items()}
        lengths = {column: len(channel) for column, channel in used.items()}
        size = next(iter(lengths.values()), 0)
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"'{column}' {count}" for column, count in lengths.items())
            raise InputError(
                f"{path.name}: columns of different length ({found} samples); channels of one record need the same"
            )
        rate, start = _clock(list(used.values()))
        for begin in range(0, max(size, 1), block):
            count = min(block, size - begin)
            yield Table({c: _numbers(path, c, channel, begin, count) for c, channel in used.items()}, rate, start)


def _numbers(path: Path, column: Column, channel: Any, begin: int, count: int) -> Any:
    with _quiet():
        values = as_numbers(path.name, column, channel.read_data(begin, count) if count else np.empty(0))
    if values.size != count:
        raise InputError(f"{path.name}: '{column}' ends after {begin + values.size} samples; the file is truncated")
    return values


def _clock(channels: Sequence[Any]) -> tuple[float | None, float]:
    """Return the sample rate [Hz] and the first time [s] where all channels share them."""
    steps = {channel.properties.get("wf_increment") for channel in channels}
    starts = {channel.properties.get("wf_start_offset", 0.0) for channel in channels}
    step, start = steps.pop(), starts.pop()
    if steps or starts or not isinstance(step, int | float) or not 0.0 < step < np.inf:
        return None, 0.0
    return 1.0 / float(step), float(start) if isinstance(start, int | float) and np.isfinite(start) else 0.0


FORMAT = format_apart(Format((".tdms",), read_tables, read_blocks, stated_units=stated_units))
