"""What every reader returns: the columns of a file as they stand there, before anyone knows what they mean."""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from process.errors import InputError
from process.types import Real
from smfe.records.formats.channels import did_you_mean, listed

Column = str | int


@dataclass(frozen=True)
class Table:
    """Columns of a file, or of one segment of it.

    Parameters
    ----------
    columns : mapping of (str or int) to ndarray, shape (n,)
        Only the columns that were asked for, under the name or position they were asked by.
    sample_rate : float, optional
        Sample rate the file itself states [Hz].
    start : float, optional
        Time of the first sample where the file states a sample rate [s].
    notes : tuple of str, optional
        What the user should know of the file although it can be read.
    """

    columns: Mapping[Column, Real]
    sample_rate: float | None = None
    start: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """A file format: each module of formats makes one and calls it ``FORMAT``; `smfe.records.read` lists them.

    Parameters
    ----------
    suffixes : tuple of str
        Suffixes of its files, in lower case, with the dot.
    read_tables : callable
        (path, wanted columns) -> one table a segment. A column that the file lacks is an `UnknownColumn`, which names
        those that it has.
    read_blocks : callable, optional
        (path, wanted columns, samples a block) -> the tables of the only segment, block by block; default: the file is
        read whole.
    read_segments : callable, optional
        The same for files that may hold several segments: a list of what `read_blocks` returns.
    stated_units : callable, optional
        path -> name of a column -> unit that the file states beside the name.
    needs_time : callable, optional
        path -> whether the file states no sample rate, so that a column of times is needed; default: never.
    """

    suffixes: tuple[str, ...]
    read_tables: Callable[[Path, Sequence[Column]], list[Table]]
    read_blocks: Callable[[Path, Sequence[Column], int], Iterator[Table]] | None = None
    read_segments: Callable[[Path, Sequence[Column], int], list[Iterator[Table]]] | None = None
    stated_units: Callable[[Path], Mapping[str, str]] | None = None
    needs_time: Callable[[Path], bool] = lambda path: False


class UnknownColumn(InputError):
    """A file lacks a column that was asked for.

    Parameters
    ----------
    message : str
        The sentence.
    names : sequence of str
        Names of the columns that it has; empty where it does not name them.
    count : int
        Number of columns.
    """

    def __init__(self, message: str, names: Sequence[str], count: int) -> None:
        super().__init__(message)
        self.names = tuple(names)
        self.count = count


def find_columns(source: str, names: Sequence[str], wanted: Sequence[Column], count: int) -> dict[Column, int]:
    """Return the index of each wanted column.

    Parameters
    ----------
    source : str
        File, for messages.
    names : sequence of str
        Names of the columns in their order; empty for a file without header.
    wanted : sequence of str or int
        Names, or positions counted from 1.
    count : int
        Number of columns.

    Raises
    ------
    UnknownColumn
        When a column is not there.
    InputError
        When a name occurs twice.
    """
    return {column: _find_column(source, names, column, count) for column in wanted}


def _find_column(source: str, names: Sequence[str], column: Column, count: int) -> int:
    if isinstance(column, int):
        if not 1 <= column <= count:
            raise UnknownColumn(
                f"{source}: column {column} is asked for but the file has {count} (positions count from 1)",
                names,
                count,
            )
        return column - 1
    if not names:
        raise UnknownColumn(
            f"{source}: column '{column}' is asked for but no line of the file names its {count} columns; "
            "give positions that count from 1, e.g. column = 1",
            (),
            count,
        )
    hits = [i for i, name in enumerate(names) if name == column]
    if len(hits) > 1:
        at = " and ".join(str(i + 1) for i in hits)
        raise InputError(
            f"{source}: the name '{column}' is that of columns {at}; give the position instead, column = {at[0]}"
        )
    if not hits:
        text = f"{source}: no column '{column}'{did_you_mean(column, names)}; the file has {listed(names)}"
        raise UnknownColumn(text, names, count)
    return hits[0]


def as_numbers(source: str, column: Column, values: object) -> Real:
    """Return an array of a file as real numbers, shape (n,), or say that it holds none."""
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise InputError(
            f"{source}: '{column}' is complex; its columns are '{column} real' and '{column} imag', and a frequency "
            "response may be declared as a whole, e.g. accelerance"
        )
    if array.dtype.kind not in "biuf":
        raise InputError(f"{source}: '{column}' holds no real numbers (its type is {array.dtype})")
    return np.ascontiguousarray(array.reshape(-1), dtype=np.float64)


def join(parts: Iterable[Table]) -> list[Table]:
    """Return the consecutive blocks of one segment as the one table they are parts of."""
    found = list(parts)
    if len(found) == 1:
        return found
    first = found[0]
    columns = {column: np.concatenate([part.columns[column] for part in found]) for column in first.columns}
    return [Table(columns, first.sample_rate, first.start, first.notes)]


def slices(table: Table, block: int) -> Iterator[Table]:
    """Yield a table that is in memory already in blocks."""
    size = next(iter(table.columns.values())).size
    for begin in range(0, size, block):
        columns = {column: values[begin : begin + block] for column, values in table.columns.items()}
        yield Table(columns, table.sample_rate, table.start, table.notes)


def same_length(source: str, columns: Mapping[Column, Real] | Mapping[Column, int]) -> None:
    """Refuse columns, or lengths of them, that differ in length."""
    lengths = {column: values if isinstance(values, int) else values.size for column, values in columns.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"'{column}' {size}" for column, size in lengths.items())
        raise InputError(
            f"{source}: columns of different length ({found} samples); channels of one record need the same"
        )


def refuse_oversize(path: Path, stated: int, stored: int, most: float = 1.0, slack: int = 4096) -> None:
    """Refuse a file whose header states far more bytes than it holds, before anything is allocated for them.

    Parameters
    ----------
    path : Path
        The file.
    stated, stored : int
        Bytes of numbers that the header promises, and bytes that are there.
    most : float, optional
        How many times the numbers may be larger than what is stored: 1 without compression, about 1000 with deflate.
    slack : int, optional
        Bytes that are let pass beyond that.

    Raises
    ------
    InputError
        When it does.
    """
    if stated > most * stored + slack:
        raise InputError(
            f"{path.name}: the header states {stated} bytes of samples and {stored} bytes are there; the file is "
            "truncated or damaged: copy or export it again"
        )


_Item = TypeVar("_Item")


def guarded(path: Path, kind: str, items: Iterator[_Item]) -> Iterator[_Item]:
    """Yield what a reader of a foreign library yields, with its exceptions as in `damaged`."""
    while True:
        with damaged(path, kind):
            try:
                item = next(items)
            except StopIteration:
                return
        yield item


@contextmanager
def damaged(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a reader of a foreign library raises into one sentence with the file's name.

    A damaged file makes the libraries raise nearly any exception there is, so all are caught, here and only here.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (InputError, KeyboardInterrupt):
        raise
    except MemoryError as error:
        raise InputError(too_large(path)) from error
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"{path.name}: cannot be read as {kind}; the file is truncated, damaged or of another kind ({reason}); "
            "copy or export it again"
        ) from error


def too_large(path: Path) -> str:
    """Return what is said of a file that asks for more memory than one of its size is given."""
    return (
        f"{path.name}: reading it takes more memory than a file of {path.stat().st_size / 1e6:.3g} MB is given; the "
        "file is damaged, or unpacks to far more than it is: copy or export it again, or save it less packed"
    )


# --- Files that are read whole: refused in a sentence where the memory would not do, before the machine stands still.

ADVICE = "save it as HDF5, NetCDF, MAT 7.3, TDMS, Parquet or CSV, which are read in pieces, or in several shorter files"


def refuse_larger(path: Path, times: float, size: int | None = None) -> None:
    """Refuse a file that needs more memory than is free.

    Parameters
    ----------
    path : Path
        The file.
    times : float
        Peak of the memory that reading it needs, over its size (measured: docs/records.md).
    size : int, optional
        What is multiplied [bytes], where it is not that of the file: unpacked samples.

    Raises
    ------
    InputError
        When it does. Where the free memory is not known, nothing is refused.
    """
    held = path.stat().st_size if size is None else size
    need, free = times * held, available()
    if free is not None and need > free:
        raise InputError(
            f"{path.name}: a file of this format is read whole; {held / 1e9:.3g} GB need about {need / 1e9:.3g} GB of "
            f"memory and {free / 1e9:.3g} GB are free: {ADVICE}"
        )


def available() -> float | None:
    """Return the free memory [bytes]; None where the system does not say."""
    try:
        with Path("/proc/meminfo").open(encoding="ascii") as stream:
            free = next((line.split()[1] for line in stream if line.startswith("MemAvailable")), None)
        return None if free is None else 1024.0 * float(free)
    except OSError:
        pass
    if sys.platform == "win32":
        return _windows()
    try:  # all of it, where the free memory is not known
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return None


def _windows() -> float | None:
    """Return ullAvailPhys of GlobalMemoryStatusEx: behind two numbers of 32 bits the second of seven of 64."""
    status = (ctypes.c_uint64 * 8)()
    ctypes.cast(status, ctypes.POINTER(ctypes.c_uint32))[0] = ctypes.sizeof(status)
    kernel = getattr(ctypes, "windll", None)
    if kernel is None or not kernel.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None
    return float(status[2])
