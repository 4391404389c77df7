"""Traces of machine controls: LinuxCNC halscope (old and new), TwinCAT Scope as text, Sinumerik Edge as JSON.

The layouts were read off what writes them: ``write_log_file`` of LinuxCNC's ``scope_files.c`` (to 2.9, and the form
with a line of names), exports of TwinCAT Scope View 3.4 as published with pytcs, and a capture of the recorder 3.1 of
Sinumerik Edge as published with CaptureDataParser. All state their own clock.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from process.errors import InputError
from process.types import Real
from smfe.records.formats.reader import format_apart
from smfe.records.formats.table import Column, Format, Table, damaged, find_columns, refuse_larger

_TIMES = 12.0
"""Peak of the memory over the size of a file of text that is read whole."""

_PERIOD = re.compile(r"#? ?Sampling period is (\d+) (?:nSec|ns)\b")


def kind_of_text(path: Path) -> str:
    """Return "halscope" or "twincat" for a text file that one of these wrote, else nothing."""
    with path.open("rb") as stream:
        head = stream.read(4096).decode("utf-8-sig", errors="replace")
    if _PERIOD.match(head):
        return "halscope"
    lines = head.splitlines()
    if len(lines) > 2 and lines[0][:4] == "Name" and lines[1][:4] == "File" and lines[2].lstrip('"')[:9] == "Starttime":
        return "twincat"
    return ""


def read_text(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of a trace as text; see `smfe.records.read_records`."""
    refuse_larger(path, _TIMES)
    kind = kind_of_text(path)
    with damaged(path, "a trace of LinuxCNC's halscope" if kind == "halscope" else "an export of TwinCAT Scope"):
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
        return [_halscope(path, text, wanted) if kind == "halscope" else _twincat(path, text, wanted)]


# --- LinuxCNC halscope ------------------------------------------------------------------------------------------------


def _halscope(path: Path, text: str, wanted: Sequence[Column]) -> Table:
    first, *lines = text.splitlines()
    match = _PERIOD.match(first)
    assert match is not None
    period = int(match[1])
    if period <= 0:
        raise InputError(f"{path.name}: a sampling period of {period} ns; the file is damaged: record it again")
    named = first.startswith("#")
    names, values = _rows_below_names(path, lines, text) if named else _pairs(path, lines)
    at = find_columns(path.name, names, wanted, len(names))
    return Table({c: np.ascontiguousarray(values[:, k]) for c, k in at.items()}, 1e9 / period)


def _rows_below_names(path: Path, lines: Sequence[str], text: str) -> tuple[list[str], Real]:
    """The newer form: names in a line, then comments on the screen, then rows, all with semicolons."""
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    if len(rows) < 2:
        raise InputError(f"{path.name}: a halscope trace without rows; it is truncated: record it again")
    names = rows[0].split(";")
    fields = [row.split(";") for row in rows[1:]]
    _refuse_ragged(path, fields, len(names), text.endswith("\n"))
    return names, _numbers(path, fields)


def _pairs(path: Path, lines: Sequence[str]) -> tuple[list[str], Real]:
    """The older form: rows of ``name value name value``; the last one it reads beyond the end of its buffer."""
    fields = [line.split() for line in lines if line.strip()]
    if len(fields) < 3:
        raise InputError(f"{path.name}: a halscope trace without rows; it is truncated: record it again")
    names = fields[0][::2]
    whole = re.fullmatch(r"[-+]?\d+[.,]\d{14}", fields[-1][-1]) is not None
    _refuse_ragged(path, fields, 2 * len(names), whole)
    if any(row[::2] != names for row in fields):
        raise InputError(f"{path.name}: a row names other pins than the first; the file is damaged: record it again")
    return names, _numbers(path, [row[1::2] for row in fields[:-1]])


def _refuse_ragged(path: Path, fields: Sequence[Sequence[str]], count: int, whole: bool) -> None:
    short = next((k for k, row in enumerate(fields) if len(row) != count), None)
    if short is None and whole:
        return
    row = len(fields) if short is None else short + 1
    what = "truncated" if row == len(fields) else "damaged"
    raise InputError(f"{path.name}: data row {row} is incomplete; the file is {what}: record or copy it again")


def _numbers(path: Path, fields: Sequence[Sequence[str]]) -> Real:
    """Return rows of text as numbers; a trace that was written under a locale has decimal commas."""
    try:
        return np.array([[float(f.replace(",", ".")) for f in row] for row in fields])
    except ValueError as error:
        raise InputError(f"{path.name}: {error}; the file is damaged: record or copy it again") from error


# --- TwinCAT Scope ----------------------------------------------------------------------------------------------------


def _twincat(path: Path, text: str, wanted: Sequence[Column]) -> Table:
    """A header block, then for each group of channels its times [ms] and their values, columns of different length."""
    lines = text.splitlines()
    delimiter = lines[0][4:5]
    if delimiter not in ("\t", ";", ",", ":", "|"):
        raise InputError(f"{path.name}: fields are parted by {delimiter!r}; export it with tabs or semicolons")
    begin = next((k for k, line in enumerate(lines[4:], 4) if line.startswith(f"Name{delimiter}")), None)
    # The block of names and settings ends with an empty line; rows follow.
    first = len(lines) if begin is None else begin
    blank = next((k for k in range(first, len(lines)) if not lines[k].strip(delimiter)), len(lines))
    rows = [line for line in lines[blank + 1 :] if line.strip(f"{delimiter} ")]
    if begin is None or not rows:
        raise InputError(f"{path.name}: an export of TwinCAT Scope without rows; it is truncated: export it again")
    if rows[-1].strip() == "EOF":
        rows.pop()
    header = [field.strip().strip('"') for field in lines[begin].rstrip(delimiter).split(delimiter)]
    clocks = np.maximum.accumulate([k if field == "Name" else 0 for k, field in enumerate(header)])
    places = [k for k, field in enumerate(header) if field and field != "Name"]
    at = find_columns(path.name, [header[k] for k in places], wanted, len(places))
    comma = delimiter != "," and any("," in row for row in rows)
    columns: dict[Column, Real] = {}
    times = {}
    fields = pd.DataFrame([row.split(delimiter) for row in rows])
    for column, index in at.items():
        value = _filled(path, fields, places[index], comma)
        clock = _filled(path, fields, int(clocks[places[index]]), comma)
        if value.size != clock.size:
            raise InputError(
                f"{path.name}: '{header[places[index]]}' has {value.size} values and {clock.size} times; the file is "
                "truncated: export it again"
            )
        columns[column], times[column] = value, clock
    return Table(columns, *_one_clock(path, {str(c): t for c, t in times.items()}))


def _filled(path: Path, fields: pd.DataFrame, place: int, comma: bool) -> Real:
    """Return the numbers of a column down to its last; shorter columns are filled up with blanks."""
    if place >= fields.shape[1]:
        raise InputError(f"{path.name}: column {place + 1} has no values; the file is truncated: export it again")
    texts = fields[place].fillna("").str.strip()
    texts = texts[: int(texts.astype(bool).to_numpy().nonzero()[0][-1]) + 1] if texts.astype(bool).any() else texts[:0]
    numbers = pd.to_numeric(texts.str.replace(",", ".", regex=False) if comma else texts, errors="coerce")
    if numbers.isna().any():
        row = int(numbers.isna().to_numpy().argmax())
        raise InputError(f"{path.name}: '{texts.iloc[row]}' in data row {row + 1}, column {place + 1}, is no number")
    return np.asarray(numbers, dtype=np.float64)


def _one_clock(path: Path, times: dict[str, Real]) -> tuple[float, float]:
    """Return sample rate [Hz] and first time [s] of columns that share them.

    Raises
    ------
    InputError
        For columns of different sample times, and for times that do not rise in even steps.
    """
    clocks = {}
    for name, time in times.items():
        if time.size < 2 or not time[-1] > time[0]:
            raise InputError(f"{path.name}: '{name}' has {time.size} samples without rising times; export it again")
        step = float(time[-1] - time[0]) / (time.size - 1)
        if np.max(np.abs(time - time[0] - step * np.arange(time.size))) > 0.6 * step:
            raise InputError(f"{path.name}: the times of '{name}' are not even; samples were lost: record it again")
        clocks[name] = (float(f"{step:.9g}"), float(time[0]), time.size)
    if len(set(clocks.values())) > 1:
        said = ", ".join(f"'{n}' {size} every {step:g} ms from {t0:g} ms" for n, (step, t0, size) in clocks.items())
        raise InputError(
            f"{path.name}: channels of one record need one clock ({said}); declare those of one sample time, and the "
            "others as a file of their own"
        )
    step, start, _ = next(iter(clocks.values()))
    return 1e3 / step, 1e-3 * start


# --- Sinumerik Edge ---------------------------------------------------------------------------------------------------

_CAPTURE = "a capture of Sinumerik Edge"
_COUNTER = "CYCLE"


def read_capture(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted signals of a capture; where cycles are missing another record begins.

    Signals are called as its header calls them, ``ENC_POS|1``. ``HFData`` are rows of one value a signal, one row a
    cycle of ``CycleTimeMs``, counted by the signal CYCLE.
    """
    content = path.read_bytes()
    if not content.strip():
        raise InputError(f"{path.name}: the file is empty")
    refuse_larger(path, _TIMES)
    with damaged(path, _CAPTURE):
        capture = json.loads(content)
        if not isinstance(capture, dict) or not {"Header", "Payload"} <= set(capture):
            raise InputError(f"{path.name}: JSON without Header and Payload; captures of Sinumerik Edge are read")
        header = capture["Header"]
        names = [str(signal["Name"]) for signal in header["SignalListHFData"]]
        at = find_columns(path.name, names, wanted, len(names))
        step = float(header["CycleTimeMs"])
        if not 0.0 < step < 1e6:
            raise InputError(f"{path.name}: a cycle time of {step:g} ms; the file is damaged: copy or export it again")
        rows = [row for message in capture["Payload"] for row in message.get("HFData", ())]
        values = _capture_values(path, rows, len(names))
        cycle = values[:, names.index(_COUNTER)] if _COUNTER in names else np.arange(float(len(rows)))
        return _runs(path, {c: values[:, k] for c, k in at.items()}, cycle, step)


def _capture_values(path: Path, rows: Sequence[Any], count: int) -> Real:
    if len(rows) < 2:
        raise InputError(f"{path.name}: a capture of {len(rows)} cycles; record at least 2")
    short = next((k for k, row in enumerate(rows) if len(row) != count), None)
    if short is not None:
        raise InputError(
            f"{path.name}: cycle {short + 1} has {len(rows[short])} values for {count} signals; the file is damaged: "
            "copy or export it again"
        )
    # A signal that was not there is null.
    return np.array([[np.nan if value is None else float(value) for value in row] for row in rows])


def _runs(path: Path, columns: dict[Column, Real], cycle: Real, step: float) -> list[Table]:
    """Return one table for each run of cycles without a gap; runs of a single cycle are no record."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(cycle) != 1.0) + 1, [cycle.size]])
    runs = [slice(a, b) for a, b in pairwise(edges) if b - a > 1]
    if not runs:
        raise InputError(f"{path.name}: no two cycles follow one another; the counter CYCLE is not one")
    gaps = len(edges) - 2
    note = (f"{path.name}: cycles are missing at {gaps} places; a record ends at each",) if gaps else ()
    start = [1e-3 * step * float(cycle[run.start] - cycle[0]) for run in runs]
    return [
        Table({c: np.ascontiguousarray(v[run]) for c, v in columns.items()}, 1e3 / step, t0, note)
        for run, t0 in zip(runs, start, strict=True)
    ]


def stated_units(path: Path) -> dict[str, str]:
    """Return name of a column -> unit, as TwinCAT writes it in front of a bracket: ``mm (Length)``."""
    if kind_of_text(path) != "twincat":
        return {}
    lines = path.read_bytes().decode("utf-8-sig", errors="replace").splitlines()
    delimiter = lines[0][4:5]
    block = {line.split(delimiter)[0]: line.split(delimiter) for line in lines[4:40] if delimiter in line}
    pairs = zip(block.get("Name", []), block.get("Unit", []), strict=False)
    return {name.strip(): unit.split(" (")[0].strip() for name, unit in pairs if name not in ("Name", "")}


FORMAT = format_apart(Format((".json",), read_capture))
