"""Frequency-response measurements of a Sinumerik control (.xml): time series of its signals, as it stored them.

The file is an XML tree of named numbers. A signal is a ``PlatformSignalNode`` with its number and one ``TimeSeries`` a
run (one a direction of motion); what is measured at the same time in all signals is a segment. An array is text to the
base 85, five digits (most significant first, `DIGITS`) for four bytes of big-endian doubles, with a full stop for four
bytes of zeros. No description of the format is published: it was found out on one file, of which the arrays decode to
exactly two setpoints and whose stored spectra are those of its own time series.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from process.errors import InputError
from process.types import Real
from smfe.records.formats.channels import listed
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import Column, Format, Table, damaged, find_columns, same_length

DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
"""Digits of the base 85, in rising order."""

_KIND = "a frequency-response measurement of a Sinumerik control"
_ZERO_WORD = "."
_VALUE = np.full(128, -1, np.int64)
_VALUE[[ord(digit) for digit in DIGITS]] = np.arange(85)


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted signals of a measurement, one table a run; see `smfe.records.read_records`.

    A signal is called by the number of its node, ``"61"``; the clock is that of the file.
    """
    content = path.read_bytes()
    if not content.strip():
        raise InputError(f"{path.name}: the file is empty")
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise InputError(f"{path.name}: an XML file with declarations of its own, which a control does not write")
    with damaged(path, _KIND):
        root = ET.fromstring(content)
        signals = _signals(path, root)
        at = find_columns(path.name, list(signals), wanted, len(signals))
        runs = [list(signals.values())[index] for index in at.values()]
        if len({len(run) for run in runs}) > 1:
            counts = ", ".join(f"'{name}' {len(run)}" for name, run in signals.items())
            raise InputError(f"{path.name}: the signals have different numbers of runs ({counts}); export it again")
        return [_table(path, dict(zip(at, segment, strict=True))) for segment in zip(*runs, strict=True)]


def numbers(text: str) -> Real:
    """Return the doubles of an array as text to the base 85.

    Raises
    ------
    ValueError
        For a character that is no digit, a number of digits that is no whole number of doubles, or a group of five
        digits that is no word of 32 bits.
    """
    plain = "".join(text.split()).replace(_ZERO_WORD, "00000")
    codes = np.frombuffer(plain.encode("latin-1"), np.uint8)
    digits = _VALUE[np.minimum(codes, 127)]
    if np.any(codes > 127) or np.any(digits < 0):
        raise ValueError("an array holds a character that is no digit to the base 85")
    if digits.size % 10:
        raise ValueError(f"an array of {digits.size} digits to the base 85 is no whole number of doubles")
    words = digits.reshape(-1, 5) @ 85 ** np.arange(4, -1, -1)
    if np.any(words >= 2**32):
        raise ValueError("a group of digits to the base 85 is larger than 32 bits")
    return words.astype(">u4").view(">f8").astype(np.float64)


def _signals(path: Path, root: ET.Element) -> dict[str, list[ET.Element]]:
    """Return number of the node -> its time series."""
    nodes = root.iter("PlatformSignalNode")
    found = {_text(node, "m_uNodeId"): list(node.iter("TimeSeries")) for node in nodes}
    found = {name: series for name, series in found.items() if series}
    if not found:
        kinds = listed(dict.fromkeys(child.tag for child in root), 5)
        raise InputError(
            f"{path.name}: an XML file of '{root.tag}' without time series ({kinds}); what is read is a "
            "frequency-response measurement of a Sinumerik control, saved with its time series"
        )
    return found


def _table(path: Path, series: dict[Column, ET.Element]) -> Table:
    columns = {column: _values(path, element) for column, element in series.items()}
    same_length(path.name, columns)
    ends = {(_text(e, "m_TimeVector.start"), _text(e, "m_TimeVector.end")) for e in series.values()}
    if len(ends) > 1:
        raise InputError(f"{path.name}: the signals of one run have different times; export it again")
    start, end = (float(text) for text in ends.pop())
    size = next(iter(columns.values())).size
    if size < 2 or not end > start:
        return Table(columns)
    # The step has more digits than a clock has: 0.00012500000000000001 s is 8000 Hz.
    return Table(columns, float(f"{(size - 1) / (end - start):.12g}"), start)


def _values(path: Path, series: ET.Element) -> Real:
    array = series.find("NumericArray")
    if array is None or array.get("format") != "base85" or array.get("elementtype") != "double":
        raise ValueError("a time series without an array of doubles to the base 85")
    stated, values = int(_text(array, "m_length")), numbers(array.findtext("raw") or "")
    if values.size != stated:
        raise InputError(
            f"{path.name}: {values.size} of the {stated} samples that a time series states; the file is damaged: "
            "copy or export it again"
        )
    return values


def _text(element: ET.Element, name: str) -> str:
    for child in element:
        if child.get("name") == name:
            return (child.text or "").strip()
    raise ValueError(f"{element.tag} without {name}")


FORMAT = format_apart(Format((".xml",), read_tables))
