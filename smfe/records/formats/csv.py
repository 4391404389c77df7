"""Text files: columns of numbers under any number of header lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from process.errors import InputError
from process.units import UNITS, known
from smfe.records.formats.complex_text import complex_column, complex_of
from smfe.records.formats.table import Column, Table, find_columns, guarded, join

# In the order of preference where several fit. "12,5" with whitespace around it has a decimal comma; "12,5" in a
# file whose every line splits at the comma has not.
_DIALECTS = [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", "."), (" ", "."), (" ", ",")]

_HEAD_BYTES = 1 << 16
_LONGEST_HEADER = 1 << 22
_WHOLE = 1 << 20
"""Rows a block where a file is read as a whole: the text of a block lives beside its numbers."""


@dataclass(frozen=True)
class Dialect:
    """How a text file is laid out.

    Parameters
    ----------
    delimiter : str
        ";", tab, ",", or " " for any white space.
    decimal : str
        "." or ",".
    first : int
        Number of lines before the data.
    count : int
        Number of columns.
    fields : int
        Number of fields of a row as the delimiters part them; one more than `count` where a row ends in a delimiter.
    names : tuple of tuple of str
        The header lines that have a name for every column, in their order.
    encoding : str
        Encoding of the text.
    complex : tuple of int
        Columns whose numbers are complex, ``1.2e-6-3e-7j``.
    """

    delimiter: str
    decimal: str
    first: int
    count: int
    fields: int
    names: tuple[tuple[str, ...], ...]
    encoding: str
    complex: tuple[int, ...] = ()


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a text file; see `smfe.records.read_records`."""
    return join(read_blocks(path, wanted, _WHOLE))


def _last_line(path: Path, encoding: str) -> str:
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size // 2 * 2 - 8192))
        lines = stream.read().decode(encoding, errors="ignore").splitlines()
    return next((line for line in reversed(lines) if line.strip()), "")


def read_blocks(path: Path, wanted: Sequence[Column], block: int) -> Iterator[Table]:
    """Yield the wanted columns of a text file, `block` rows at a time."""
    dialect = sniff(path)
    at = _places(path.name, dialect, wanted)
    indices = sorted({index for index, _ in at.values()})
    before = 0
    for frame in guarded(path, "text", _parsed(path, dialect, indices, block)):
        columns = {index: frame[index].to_numpy() for index in indices if index not in dialect.complex}
        for index in set(indices) & set(dialect.complex):
            columns[index], wrong = complex_column(frame[index], dialect.decimal)
            if wrong is not None:
                raise InputError(
                    f"{path.name}: column {index + 1} holds the text '{frame[index].iloc[wrong]}' in data row "
                    f"{before + wrong + 1}; complex numbers are needed there"
                )
        before += len(frame)
        last = len(frame) < block
        odd = last and any(np.isnan(c[-1]) and not np.isnan(c[:-1]).any() for c in columns.values())
        # A response that is divided by zero at its last line says so itself.
        if odd and before > 1 and "nan" not in _last_line(path, dialect.encoding).lower():
            raise InputError(f"{path.name}: the last row ({before}) is incomplete; the file is truncated")
        yield Table({column: np.asarray(getattr(columns[index], part)) for column, (index, part) in at.items()})


def _places(source: str, dialect: Dialect, wanted: Sequence[Column]) -> dict[Column, tuple[int, str]]:
    """Return index and part (real, imag) of each wanted column; a complex one is called by its name and its part."""
    names: list[str] = []
    halves: list[tuple[int, str]] = []
    for index, name in enumerate(_header(dialect, wanted)):
        parts = ("real", "imag") if index in dialect.complex else ("",)
        names += [f"{name} {part}".strip() for part in parts]
        halves += [(index, part or "real") for part in parts]
    named = find_columns(source, names, [c for c in wanted if isinstance(c, str)], dialect.fields)
    placed = find_columns(source, (), [c for c in wanted if isinstance(c, int)], dialect.fields)
    if any(index in dialect.complex for index in placed.values()):
        raise InputError(
            f"{source}: a column that is asked for by its position is complex; name it in the file, and ask for "
            "'NAME real' and 'NAME imag', or for 'NAME' where a response is complex"
        )
    return {c: halves[named[c]] if c in named else (placed[c], "real") for c in wanted}


def sniff(path: Path) -> Dialect:
    """Find delimiter, decimal sign and header of a text file from its first 64 kB, or from more after a long header.

    Raises
    ------
    InputError
        When the file is empty, is no text, or holds no rows of numbers.
    """
    size = _HEAD_BYTES
    while True:
        with path.open("rb") as stream:
            head = stream.read(size)
        if not head.strip():
            raise InputError(f"{path.name}: the file is empty")
        text, encoding = _decode(path, head)
        lines = re.split(r"\r\n|\r|\n", text)
        if len(head) == size:
            lines.pop()  # cut in its middle
        found = [(*_rows_of_numbers(lines, *dialect), dialect) for dialect in _DIALECTS]
        rows, pattern, dialect = max(found, key=lambda f: (f[0], sum(f[1]) / max(len(f[1]), 1), len(f[1]) > 1))
        if rows > 1 or len(head) < size or size >= _LONGEST_HEADER:
            break
        size *= 8
    if rows == 0:
        raise InputError(f"{path.name}: no rows of numbers among the first {len(lines)} lines")
    return _laid_out(lines, pattern, dialect, encoding)


def _laid_out(lines: Sequence[str], pattern: tuple[bool, ...], dialect: tuple[str, str], encoding: str) -> Dialect:
    delimiter, decimal = dialect
    first = next(i for i, line in enumerate(lines) if _pattern(line, delimiter, decimal) == pattern)
    count = len(pattern)
    fields = count if delimiter == " " else lines[first].count(delimiter) + 1
    first -= _starts_with_a_keyword(lines, first, delimiter, decimal)
    header = [_names(line, delimiter) for line in lines[:first]]
    names = tuple(line for line in header if count <= len(line) <= fields)
    parts = next(_fields(line, delimiter) for line in lines[first:] if _pattern(line, delimiter, decimal) == pattern)
    whole = tuple(i for i, field in enumerate(parts) if complex_of(field, decimal) is not None)
    return Dialect(delimiter, decimal, first, count, fields, names, encoding, whole)


def _starts_with_a_keyword(lines: Sequence[str], first: int, delimiter: str, decimal: str) -> bool:
    """Whether the line before the first plain row is a row too, with a keyword where all others have an empty field.

    So begin the data of a dSPACE recording: ``trace_values,0,1.5`` and then ``,0.001,1.6``.
    """
    if first == 0 or delimiter == " ":
        return False
    above, row = (_fields(line, delimiter) for line in (lines[first - 1], lines[first]))
    if len(above) != len(row) or "" not in row:
        return False
    return all(not b or (bool(a) and _is_number(a, decimal)) for a, b in zip(above, row, strict=True))


def _decode(path: Path, head: bytes) -> tuple[str, str]:
    """Return the text of the head and its encoding: UTF-8, UTF-16 with or without a mark, GBK, else Latin-1."""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head[: len(head) // 2 * 2].decode("utf-16", errors="replace"), "utf-16"
    if b"\0" in head:
        return _decode_unmarked(path, head)
    try:
        # A character may be cut at the end of the head.
        return head[:-4].decode("utf-8-sig") + head[-4:].decode("utf-8", errors="replace"), "utf-8-sig"
    except UnicodeDecodeError:
        encoding = "gbk" if _is_gbk(head) else "latin-1"
        return head.decode(encoding, errors="replace"), encoding


def _decode_unmarked(path: Path, head: bytes) -> tuple[str, str]:
    """Numbers in UTF-16 have a zero byte in every second place; other files with zero bytes are no text."""
    even = head[: len(head) // 2 * 2]
    for encoding, zeros in (("utf-16-le", even[1::2]), ("utf-16-be", even[::2])):
        text = even.decode(encoding, errors="replace")
        if zeros.count(0) > 0.8 * len(zeros) and not re.search(r"[\x00-\x08\x0e-\x1f]", text):
            return text, encoding
    raise InputError(f"{path.name}: the file holds no text; give it the suffix of its format or export it as CSV")


def _is_gbk(head: bytes) -> bool:
    """Whether all bytes above ASCII come in pairs of the Chinese plane; an umlaut of Latin-1 stands alone."""
    runs = re.findall(rb"[\x80-\xff]+", head[:-2])
    return all(len(run) % 2 == 0 and all(0xA1 <= byte <= 0xFE for byte in run) for run in runs)


def _fields(line: str, delimiter: str) -> list[str]:
    """Split a line; empty fields at the end are no columns."""
    if delimiter == " ":
        fields = line.split()
    else:
        fields = [field.strip() for field in (_quoted(line, delimiter) if '"' in line else line.split(delimiter))]
    while fields and not fields[-1]:
        fields.pop()
    return [field.strip('"') for field in fields]


def _quoted(line: str, delimiter: str) -> list[str]:
    """Split a line whose fields may hold the delimiter in quotes."""
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return line.split(delimiter)


def _pattern(line: str, delimiter: str, decimal: str) -> tuple[bool, ...]:
    """Return which columns of a line are numbers (or empty); nothing for a line without any number."""
    fields = _fields(line, delimiter)
    pattern = tuple(_is_number(field, decimal) for field in fields)
    return pattern if any(number and field for number, field in zip(pattern, fields, strict=True)) else ()


def _is_number(field: str, decimal: str) -> bool:
    if decimal == "," and "." in field:
        return False
    try:
        float((field.replace(",", ".") if decimal == "," else field) or "0")
    except ValueError:
        return complex_of(field, decimal) is not None
    return True


def _rows_of_numbers(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[int, tuple[bool, ...]]:
    """Return how many lines share the commonest pattern of numbers and text, and the pattern.

    A column of text, such as a clock time, is thereby no hindrance, and a header of numbers no row.
    """
    patterns = Counter(_pattern(line, delimiter, decimal) for line in lines)
    # Sentences that hold a number are no rows.
    patterns = Counter({pattern: rows for pattern, rows in patterns.items() if 3 * sum(pattern) >= len(pattern) > 0})
    if not patterns:
        return 0, ()
    pattern, rows = max(patterns.items(), key=lambda item: (item[1], item[0]))
    return rows, pattern


def _names(line: str, delimiter: str) -> tuple[str, ...]:
    return tuple(_fields(line.lstrip().lstrip("#%"), delimiter))


def _header(dialect: Dialect, wanted: Sequence[Column]) -> tuple[str, ...]:
    """Return the header line that holds the names; a line of units below it holds fewer of those wanted."""
    if not dialect.names:
        return ()
    if not any(name in line for line in dialect.names for name in wanted):
        return name_line(dialect)
    return max(dialect.names, key=lambda line: sum(name in line for name in wanted))


def name_line(dialect: Dialect) -> tuple[str, ...]:
    """Return the last header line that is no line of units or numbers; nothing where there is none."""
    texts = [line for line in dialect.names if not _of_units(line) and not all(_is_number(f, ".") for f in line)]
    return texts[-1] if texts else ()


def stated_units(path: Path) -> dict[str, str]:
    """Return name of a column -> unit, where a header line of units stands below the names."""
    dialect = sniff(path)
    names = name_line(dialect)
    units = next((line for line in reversed(dialect.names) if _of_units(line)), ())
    return {name: unit.strip("[]() ") for name, unit in zip(names, units, strict=False) if unit.strip("[]() ")}


def _of_units(line: Sequence[str]) -> bool:
    """Whether most fields of a header line are units."""
    fields = [field.strip("[]() ") for field in line]
    hits = sum(any(unit and known(unit, d) for d in UNITS) for unit in fields)
    return 2 * hits > sum(map(bool, fields)) > 0


def _parsed(path: Path, dialect: Dialect, indices: Sequence[int], block: int) -> Iterator[pd.DataFrame]:
    """Yield the rows as numbers; a field that is none is named with its row."""
    try:
        yield from _chunks(path, dialect, indices, np.float64, block)
    except pd.errors.ParserError:
        raise
    except ValueError:
        _find_text(path, dialect, indices)
        raise


def _chunks(path: Path, dialect: Dialect, indices: Sequence[int], dtype: type, block: int) -> Iterator[pd.DataFrame]:
    # No usecols: with it pandas passes over rows that are too long, as a decimal comma in a comma-delimited file makes
    kept = [index for index in indices if index not in dialect.complex]
    types = {index: dtype if index in kept else str for index in range(dialect.fields)}
    with pd.read_csv(
        path,
        sep=r"\s+" if dialect.delimiter == " " else dialect.delimiter,
        decimal=dialect.decimal,
        header=None,
        names=list(range(dialect.fields)),
        skiprows=dialect.first,
        dtype=types,
        engine="c",
        encoding=dialect.encoding,
        encoding_errors="replace",
        skipinitialspace=True,
        low_memory=False,
        chunksize=block,
    ) as reader:
        yield from reader


def _find_text(path: Path, dialect: Dialect, indices: Sequence[int]) -> None:
    """Raise for the first field that is no number, with its row; return where there is none."""
    before = 0
    for frame in _chunks(path, dialect, indices, str, 1 << 17):
        for index in (i for i in indices if i not in dialect.complex):
            text = frame[index].str.strip()
            if dialect.decimal == ",":
                text = text.str.replace(",", ".", regex=False)
            bad = (pd.to_numeric(text, errors="coerce").isna() & text.notna()).to_numpy()
            if bad.any():
                row = int(np.argmax(bad))
                raise InputError(
                    f"{path.name}: column {index + 1} holds the text '{frame[index].iloc[row]}' in data row "
                    f"{before + row + 1}; numbers are needed there"
                )
        before += len(frame)
