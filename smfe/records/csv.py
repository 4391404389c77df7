"""Text files: columns of numbers under any number of header lines."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from process.errors import InputError
from smfe.records.table import Column, Table, damaged, find_columns

# In the order of preference where several fit. "12,5" with whitespace around it has a decimal comma; "12,5" in a
# file whose every line splits at the comma has not.
_DIALECTS = [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", "."), (" ", "."), (" ", ",")]

_HEAD_BYTES = 1 << 16


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
    """

    delimiter: str
    decimal: str
    first: int
    count: int
    fields: int
    names: tuple[tuple[str, ...], ...]
    encoding: str


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a text file; see `smfe.records.read_records`."""
    dialect = sniff(path)
    at = find_columns(path.name, _header(dialect, wanted), wanted, dialect.fields)
    frame = _read(path, dialect, sorted(set(at.values())))
    return [Table({column: frame[index] for column, index in at.items()})]


def sniff(path: Path) -> Dialect:
    """Find delimiter, decimal sign and header of a text file from its first 64 kB.

    Raises
    ------
    InputError
        When the file is empty, is no text, or holds no rows of numbers.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    if not head.strip():
        raise InputError(f"{path.name}: the file is empty")
    text, encoding = _decode(path, head)
    lines = re.split(r"\r\n|\r|\n", text)
    if len(head) == _HEAD_BYTES:
        lines.pop()  # cut in its middle
    found = [(*_rows_of_numbers(lines, *dialect), dialect) for dialect in _DIALECTS]
    rows, pattern, (delimiter, decimal) = max(found, key=lambda f: (f[0], sum(f[1]) / max(len(f[1]), 1), len(f[1]) > 1))
    if rows == 0:
        raise InputError(f"{path.name}: no rows of numbers among the first {len(lines)} lines")
    first = next(i for i, line in enumerate(lines) if _pattern(line, delimiter, decimal) == pattern)
    count = len(pattern)
    fields = count if delimiter == " " else lines[first].count(delimiter) + 1
    header = [_names(line, delimiter) for line in lines[:first]]
    names = tuple(line for line in header if count <= len(line) <= fields)
    return Dialect(delimiter, decimal, first, count, fields, names, encoding)


def _decode(path: Path, head: bytes) -> tuple[str, str]:
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head[: len(head) // 2 * 2].decode("utf-16", errors="replace"), "utf-16"
    if b"\0" in head:
        raise InputError(f"{path.name}: the file holds no text; give it the suffix of its format or export it as CSV")
    try:
        # A character may be cut at the end of the head.
        return head[:-4].decode("utf-8-sig") + head[-4:].decode("utf-8", errors="replace"), "utf-8-sig"
    except UnicodeDecodeError:
        return head.decode("latin-1"), "latin-1"


def _fields(line: str, delimiter: str) -> list[str]:
    """Split a line; empty fields at the end are no columns."""
    fields = line.split() if delimiter == " " else [field.strip() for field in line.split(delimiter)]
    while fields and not fields[-1]:
        fields.pop()
    return [field.strip('"') for field in fields]


def _pattern(line: str, delimiter: str, decimal: str) -> tuple[bool, ...]:
    """Return which columns of a line are numbers (or empty); nothing for a line without any number."""
    fields = _fields(line, delimiter)
    pattern = tuple(_is_number(field, decimal) for field in fields)
    return pattern if any(number and field for number, field in zip(pattern, fields, strict=True)) else ()


def _is_number(field: str, decimal: str) -> bool:
    if decimal == ",":
        if "." in field:
            return False
        field = field.replace(",", ".")
    try:
        float(field or "0")
    except ValueError:
        return False
    return True


def _rows_of_numbers(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[int, tuple[bool, ...]]:
    """Return how many lines share the commonest pattern of numbers and text, and the pattern.

    A column of text, such as a clock time, is thereby no hindrance, and a header of numbers no row.
    """
    patterns = Counter(_pattern(line, delimiter, decimal) for line in lines)
    del patterns[()]
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
    return max(dialect.names, key=lambda line: sum(name in line for name in wanted))


def _read(path: Path, dialect: Dialect, indices: Sequence[int]) -> dict[int, NDArray[np.float64]]:
    """Read columns as numbers."""
    with damaged(path, "text"):
        try:
            frame = _parse(path, dialect, indices, np.float64)
        except pd.errors.ParserError:
            raise
        except ValueError:
            _find_text(path, dialect, indices)
            raise
    columns = {index: frame[index].to_numpy() for index in indices}
    if len(frame) > 1 and any(np.isnan(c[-1]) and not np.isnan(c[:-1]).any() for c in columns.values()):
        raise InputError(f"{path.name}: the last row ({len(frame)}) is incomplete; the file is truncated")
    return columns


def _parse(path: Path, dialect: Dialect, indices: Sequence[int], dtype: type) -> pd.DataFrame:
    # No usecols: with it pandas passes over rows that are too long, as a decimal comma in a comma-delimited file makes
    types = {index: dtype if index in indices else str for index in range(dialect.fields)}
    return pd.read_csv(
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
    )


def _find_text(path: Path, dialect: Dialect, indices: Sequence[int]) -> None:
    """Raise for the first field that is no number, with its row; return where there is none."""
    frame = _parse(path, dialect, indices, str)
    for index in indices:
        text = frame[index].str.strip()
        if dialect.decimal == ",":
            text = text.str.replace(",", ".", regex=False)
        bad = (pd.to_numeric(text, errors="coerce").isna() & text.notna()).to_numpy()
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{path.name}: column {index + 1} holds the text '{frame[index].iloc[row]}' in data row {row + 1}; "
                "numbers are needed there"
            )
