"""Universal files (UFF, UNV), dataset 58: functions at nodal degrees of freedom, as text or binary (58b).

The layout is that of the Structural Dynamics Research Laboratory, University of Cincinnati, universal dataset 58. Only
what a record or a compliance needs is taken: degrees of freedom, abscissa, ordinate. Everything else in the file is
passed over. Parsed here and not by pyuff, because a header must be able to neither make us allocate what is not there
nor give a step of six digits for the clock of a long record.
"""

from __future__ import annotations

import math
import mmap
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Real
from smfe.records.formats.channels import did_you_mean, listed
from smfe.records.formats.reader import CLASSES, apart, format_apart
from smfe.records.formats.table import (
    Column,
    Format,
    Table,
    UnknownColumn,
    as_numbers,
    damaged,
    find_columns,
    guarded,
    refuse_larger,
    slices,
)

Body = bytes | memoryview
"""Samples of a dataset; of a binary one a view of the mapped file."""

_KIND = "a universal file"
_TIMES = 4.5
"""Peak of the memory over the size of a file of text (measured: docs/records.md)."""

_CLOSES_TEXT = re.compile(rb"^ {4}-1[ ]*\r?$", re.MULTILINE)
_CLOSES_BINARY = re.compile(rb" {4}-1[ ]*\r?$", re.MULTILINE)
_DIRECTIONS = ("", "+X", "+Y", "+Z", "+RX", "+RY", "+RZ")
_ABSCISSA = {17: "time", 18: "frequency"}
FRF, _COHERENCE, _MULTIPLE_COHERENCE = 4, 6, 20
"""Types of functions."""

EXACT = "smfe abscissa: first "
"""Begin of an identification line that says the abscissa in all digits, which the fields of the header cannot."""


@dataclass(frozen=True)
class Function:
    """One dataset 58.

    Parameters
    ----------
    name : str
        ``node:direction`` of the response, followed by ``/node:direction`` of the reference where there is one.
    abscissa : str
        "time", "frequency" or "abscissa".
    first, step : float
        First abscissa and its step; the step is 0 where every value has an abscissa of its own.
    x : ndarray or None
        Abscissae of a function of uneven step.
    y : ndarray, real or complex
        Ordinates.
    kind : int, optional
        Type of the function: 1 time response, 4 frequency response, 6 coherence, ...
    response, reference : (str, str), optional
        Node and direction ("+X", or "").
    numerator, denominator : (int, str), optional
        Type of the quantity (8 displacement, 11 velocity, 12 acceleration, 13 force, ...) and its unit as written.
    notes : tuple of str, optional
        What the user should know of it although it can be read.
    """

    name: str
    abscissa: str
    first: float
    step: float
    x: Real | None
    y: NDArray[Any]
    kind: int = 0
    response: tuple[str, str] = ("", "")
    reference: tuple[str, str] = ("", "")
    numerator: tuple[int, str] = (0, "")
    denominator: tuple[int, str] = (0, "")
    notes: tuple[str, ...] = ()

    def axis(self) -> Real:
        """Return the abscissae."""
        return np.asarray(self.first + self.step * np.arange(self.y.size)) if self.x is None else self.x

    def columns(self) -> dict[str, Real]:
        """Return the function as real columns."""
        if np.iscomplexobj(self.y):
            return {f"{self.name} real": self.y.real.copy(), f"{self.name} imag": self.y.imag.copy()}
        return {self.name: self.y}


CLASSES["Function"] = Function


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted functions of a universal file.

    A real function is the column ``1:+X`` (node and direction of the response) or ``1:+X/2:+Z`` (with the reference), a
    complex one the columns ``1:+X/2:+Z real`` and ``1:+X/2:+Z imag``, a coherence has `` coherence`` behind;
    ``time`` or ``frequency`` is their abscissa. A name that occurs again begins another segment, as do
    functions over another abscissa; segments without the columns wanted are left out.
    """
    return [_loaded(path, table) for table in _tables(path, wanted)]


def read_segments(path: Path, wanted: Sequence[Column], block: int) -> list[Iterator[Table]]:
    """Return the blocks of every segment; of binary datasets nothing is in memory but the block that is asked for."""
    return [guarded(path, _KIND, _sliced(path, table, block)) for table in _tables(path, wanted)]


def _sliced(path: Path, table: Table, block: int) -> Iterator[Table]:
    for part in slices(table, block):
        yield _loaded(path, part)


def _loaded(path: Path, table: Table) -> Table:
    """Return columns as numbers in memory that nothing else shares."""
    columns = {c: as_numbers(path.name, c, np.array(v, dtype=np.float64)) for c, v in table.columns.items()}
    return Table(columns, table.sample_rate, table.start, table.notes)


def _tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Return the wanted columns of every segment as they stand in the file, not yet as numbers of our own."""
    functions = read_functions(path)
    if not functions:
        raise InputError(f"{path.name}: no dataset 58 (functions) in this universal file; export time data or FRFs")
    segments = [_columns(segment) for segment in _segments(functions)]
    chosen = [(s, c) for s, c in segments if all(isinstance(w, int) or w in c for w in wanted)]
    if not chosen:
        names = list(dict.fromkeys(name for _, columns in segments for name in columns))
        absent = next((w for w in wanted if w not in names and not isinstance(w, int)), None)
        if absent is None:
            raise InputError(f"{path.name}: the functions wanted do not share an abscissa; read them one by one")
        text = f"{path.name}: no column '{absent}'{did_you_mean(str(absent), names)}; the file has {listed(names)}"
        raise UnknownColumn(text, names, len(names))
    return [_table(path, first, columns, wanted) for first, columns in chosen]


class _Steps:
    """Abscissae of even steps, computed where they are wanted: of a long record they would be another channel."""

    def __init__(self, function: Function) -> None:
        self.first, self.step, self.size = function.first, function.step, function.y.size

    def __getitem__(self, part: slice) -> Real:
        return np.asarray(self.first + self.step * np.arange(*part.indices(self.size)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self[:].astype(dtype or np.float64)


def _columns(segment: Sequence[Function]) -> tuple[Function, dict[str, Any]]:
    first = segment[0]
    columns: dict[str, Any] = {first.abscissa: _Steps(first) if first.x is None else first.x}
    for function in segment:
        columns |= function.columns()
    return first, columns


def _table(path: Path, first: Function, columns: dict[str, Any], wanted: Sequence[Column]) -> Table:
    names = list(columns)
    at = find_columns(path.name, names, wanted, len(names))
    rate = _rate(first.step) if first.x is None and first.step > 0.0 else None
    return Table({column: columns[names[index]] for column, index in at.items()}, rate, first.first, first.notes)


def _segments(functions: Sequence[Function]) -> list[list[Function]]:
    """Deal functions out: those over one abscissa belong together, a name that occurs again begins another segment."""
    segments: list[list[Function]] = []
    over: dict[object, list[list[Function]]] = {}
    times: dict[object, int] = {}
    for function in functions:
        axis = _axis_of(function)
        # What has come n times over an abscissa is in the first n segments of it.
        before = times.get((axis, function.name), 0)
        times[axis, function.name] = before + 1
        of_axis = over.setdefault(axis, [])
        if before == len(of_axis):
            of_axis.append([])
            segments.append(of_axis[-1])
        of_axis[before].append(function)
    return segments


def _axis_of(function: Function) -> tuple[object, ...]:
    """Return what functions over one abscissa have in common."""
    uneven = None if function.x is None else (np.asarray(function.x, dtype=np.float64) + 0.0).tobytes()
    return function.abscissa, function.first, function.step, function.y.size, uneven


def _rate(step: float) -> float:
    """Return 1/step; where six digits hide a whole number of hertz, that number.

    1.95313E-05 s is 51199.9 Hz as it stands: over ten minutes the clock would be 1.4 ms off.
    """
    rate = 1.0 / step
    spread = rate * 0.6 * 10.0 ** (math.floor(math.log10(step)) - 5) / step
    for digits in range(int(math.log10(rate)) + 1 if rate >= 1.0 else 0, -1, -1):
        round_rate = round(rate / 10.0**digits) * 10.0**digits
        if round_rate > 0.0 and abs(round_rate - rate) <= spread:
            return round_rate
    return rate


def _even_step(step: float) -> float:
    """Return a step of frequencies; where six digits hide a short period, one over that.

    1.95313E-01 Hz is one over 5.12 s. A step that has digits to spare is what it says.
    """
    if f"{step:.5e}".split("e")[0].endswith("0"):
        return step
    period = 1.0 / step
    spread = period * 0.6 * 10.0 ** (math.floor(math.log10(step)) - 5) / step
    near = (round(period, digits) for digits in range(8))
    return next((1.0 / p for p in near if p > 0.0 and abs(p - period) <= spread), step)


# --- the file, dataset by dataset ------------------------------------------------------------------------------------


@apart
def read_functions(path: Path) -> list[Function]:
    """Return every dataset 58 of a universal file.

    Raises
    ------
    InputError
        When the file is empty, is none, is truncated, or one of its datasets cannot be read.
    """
    with path.open("rb") as stream:
        head = stream.read(4096).lstrip()
        if not head:
            raise InputError(f"{path.name}: the file is empty")
        if head[:2] != b"-1":
            raise InputError(f"{path.name}: not a universal file; its first line must be '    -1'")
        # Mapped, not read: the samples of binary datasets stay in the file until a block of them is wanted.
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    with damaged(path, _KIND):
        return [_function(path, header, body, binary) for header, body, binary in _datasets(path, content)]


def _datasets(path: Path, content: mmap.mmap) -> Iterator[tuple[list[str], Body, bytes]]:
    """Yield header lines, body and line of the type of each dataset 58."""
    place = 0
    while place < len(content):
        line, place = _line(content, place)
        if not line.strip():
            continue
        if line.strip() != b"-1":
            raise InputError(f"{path.name}: '    -1' is missing before a dataset; the file is damaged, export it again")
        kind, place = _line(content, place)
        binary = kind.split()[:1] in ([b"58b"], [b"58B"])
        if not binary and kind.split()[:1] != [b"58"]:
            place = _after(path, content, place, _CLOSES_TEXT)[1]
            continue
        header = []
        for _ in range(11):
            text, place = _line(content, place)
            header.append(text.decode("latin-1"))
        size = _binary_size(path, header, content, place) if binary else 0
        end, following = _after(path, content, place + size, _CLOSES_BINARY if binary else _CLOSES_TEXT)
        body = memoryview(content)[place : place + size] if binary else content[place:end]
        yield header, body, kind if binary else b""
        place = following


def _line(content: mmap.mmap, place: int) -> tuple[bytes, int]:
    end = content.find(b"\n", place)
    end = len(content) if end < 0 else end
    return content[place:end].rstrip(b"\r"), end + 1


def _after(path: Path, content: mmap.mmap, place: int, delimiter: re.Pattern[bytes]) -> tuple[int, int]:
    """Return where the delimiter stands that closes a dataset, and where the next line begins."""
    found = delimiter.search(content, place)
    if found is None:
        raise InputError(f"{path.name}: the last dataset is not closed by '    -1'; the file is truncated, copy it")
    return found.start(), found.end() + 1


def _binary_size(path: Path, header: Sequence[str], content: mmap.mmap, place: int) -> int:
    """Return the bytes of a binary body: those of its values, for some writers count bytes wrong.

    Abscissae of uneven step are in single precision after the standard, in that of the ordinates after some writers.
    """
    kind, count, even = _ordinates(header)
    ordinate, single = {2: (4, 4), 4: (8, 8), 5: (8, 4), 6: (16, 8)}[kind]
    sizes = [count * ordinate] if even else [count * (ordinate + abscissa) for abscissa in (4, single)]
    for size in sizes:
        if re.match(rb"\s*? {4}-1[ ]*\r?(?:\n|$)", content[place + size : place + size + 200]):
            return size
    if place + sizes[0] > _end(content) - 2:
        raise InputError(
            f"{path.name}: {len(content) - place} of the {sizes[0]} bytes that the header of a dataset 58 states; the "
            "file is truncated, copy it again"
        )
    raise InputError(
        f"{path.name}: a dataset 58 holds more bytes than the {sizes[0]} of the values its header states; the file "
        "is damaged, copy or export it again"
    )


def _end(content: mmap.mmap) -> int:
    """Return where the white space at the end of a file begins."""
    tail = content[-4096:]
    return len(content) - len(tail) + len(tail.rstrip())


def _ordinates(header: Sequence[str]) -> tuple[int, int, bool]:
    """Return type of the ordinates, their number, and whether their abscissae are even."""
    kind, count, even = (int(header[6][k : k + 10]) for k in (0, 10, 20))
    if kind not in (2, 4, 5, 6) or count < 0 or even not in (0, 1):
        raise ValueError(f"ordinate type {kind}, {count} values, spacing {even}")
    return kind, count, bool(even)


def _function(path: Path, header: Sequence[str], body: Body, binary: bytes) -> Function:
    kind, count, even = _ordinates(header)
    if not binary:
        refuse_larger(path, _TIMES)
    first, step = (_float(header[6][k : k + 13]) for k in (30, 43))
    numbers = _binary_numbers(body, binary, kind, even, count) if binary else _text_numbers(body, kind, even)
    width = (2 if kind in (5, 6) else 1) + (0 if even else 1)
    if numbers.size < count * width:
        raise InputError(
            f"{path.name}: {numbers.size // width} of the {count} values that the header of a dataset 58 states; the "
            "file is truncated, copy it again"
        )
    # Some writers fill up the last line, which holds six numbers at most.
    if numbers.size >= count * width + 6:
        raise InputError(
            f"{path.name}: a dataset 58 holds {numbers.size // width} values where its header states {count}; the "
            "file is damaged, copy or export it again"
        )
    if not binary and np.any(numbers[count * width :] != 0.0):
        raise InputError(
            f"{path.name}: a dataset 58 holds {numbers.size} numbers where its header states {count} values; the "
            "file is damaged, copy or export it again"
        )
    rows = numbers[: count * width].reshape(count, width)
    x = None if even else rows[:, 0].copy()
    values = rows if even else rows[:, 1:]
    y = values[:, 0] + 1j * values[:, 1] if kind in (5, 6) else values[:, 0]
    abscissa = _ABSCISSA.get(_integer(header[7][:10]), "abscissa")
    if even:
        step = _even_step(step) if abscissa == "frequency" and step > 0.0 else step
        first, step = _exact(header, first, step)
    response, reference = (
        (str(_integer(header[5][k : k + 10])), _direction(header[5][k + 10 : k + 14])) for k in (41, 66)
    )
    numerator, denominator = (_quantity(line) for line in header[8:10])
    return Function(
        name=_name(header[5]),
        abscissa=abscissa,
        first=first,
        step=step,
        x=x,
        y=y,
        kind=_integer(header[5][:5]),
        response=response,
        reference=reference,
        numerator=numerator,
        denominator=denominator,
        notes=_stated_bytes(path, binary, len(body)) if binary else (),
    )


def _stated_bytes(path: Path, line: bytes, found: int) -> tuple[str, ...]:
    """Return what is to be said where the line of the type counts other bytes than its values have."""
    words = line.decode("latin-1").lower().split("b", 1)[1].split()
    if words[2:3] not in ([], ["11"]):
        raise ValueError(f"{words[2]} lines of header, and not 11")
    if len(words) < 4 or words[3] in ("0", str(found)):
        return ()
    return (
        f"{path.name}: a dataset 58 counts {words[3]} bytes where its values have {found}; its header may be damaged",
    )


def _quantity(line: str) -> tuple[int, str]:
    """Return type and unit of an ordinate, record 9 or 10: I10, 3I5, 1X, 20A1, 1X, 20A1."""
    code = line[:10].strip()
    return (int(code) if code.isdigit() else 0), line[47:67].strip()


def _integer(text: str) -> int:
    return int(text) if text.strip() else 0


def _float(text: str) -> float:
    return float(text.replace("D", "E").replace("d", "e")) if text.strip() else 0.0


def _exact(header: Sequence[str], first: float, step: float) -> tuple[float, float]:
    """Return first abscissa and step in all digits where our own writer has put them down and they fit the header."""
    line = header[4]
    if line.startswith(EXACT):
        stated = [float(word) for word in line.removeprefix(EXACT).split(" step ")]
        if np.allclose(stated, [first, step], rtol=1e-4, atol=0.0):
            return stated[0], stated[1]
    return first, step


def _name(line: str) -> str:
    """Return the degrees of freedom of record 6: 2(I5,I10),2(1X,10A1,I10,I4)."""
    function = _integer(line[:5])
    response = _degree(line[41:51], line[51:55])
    reference = _degree(line[66:76], line[76:80])
    # A function of time has a reference only where it is a response to something: FRFs, spectra, correlations.
    name = response if function in (0, 1) or not reference else f"{response}/{reference}"
    # A coherence stands beside the response that it belongs to, between the same degrees of freedom.
    return f"{name} coherence" if function in (_COHERENCE, _MULTIPLE_COHERENCE) else name


def _degree(node: str, direction: str) -> str:
    name = _direction(direction)
    return f"{_integer(node)}" + (f":{name}" if name else "")


def _direction(text: str) -> str:
    code = _integer(text)
    if abs(code) >= len(_DIRECTIONS):
        raise ValueError(f"direction {code}")
    name = _DIRECTIONS[abs(code)]
    return name.replace("+", "-") if code < 0 else name


def _binary_numbers(body: Body, line: bytes, kind: int, even: bool, count: int) -> Real:
    """Return the values of a binary dataset."""
    words = line.decode("latin-1").lower().split("b", 1)[1].split()
    if words[1] != "2":
        raise ValueError(f"numbers of floating-point format {words[1]}, and not IEEE 754")
    order = {"1": "<", "2": ">"}[words[0]]
    value = f"{order}f{4 if kind in (2, 5) else 8}"
    if kind in (2, 4) and even:
        return np.frombuffer(body, value)  # a view of the file
    if even or not count:
        return np.frombuffer(body, value).astype(np.float64)
    parts = 2 if kind in (5, 6) else 1
    abscissa = len(body) // count - parts * np.dtype(value).itemsize
    rows = np.frombuffer(body, np.dtype([("x", f"{order}f{abscissa}"), ("y", value, (parts,))]))
    return np.column_stack([rows["x"].astype(np.float64), rows["y"].astype(np.float64)]).ravel()


def _text_numbers(body: Body, kind: int, even: bool) -> Real:
    """Return the values of a dataset in text: by white space, or by the columns of the format where they touch."""
    text = bytes(body).decode("ascii").replace("D", "E").replace("d", "e")
    widths = [13] * 6
    if kind in (4, 6):
        widths = [20] * 4 if even else [13, 20] * 2 if kind == 4 else [13, 20, 20]
    edges = np.cumsum([0, *widths])
    out: list[str] = []
    for line in text.splitlines():
        # A sign that does not follow an exponent letter begins a number; one that touches its neighbour needs columns.
        if re.search(r"\d[-+]", re.sub(r"[eE][-+]", "", line)):
            fields = (line[a:b].strip() for a, b in pairwise(edges))
            out += [field for field in fields if field]
        else:
            out += line.split()
    return np.array(out, dtype=np.float64)


FORMAT = format_apart(Format((".uff", ".unv"), read_tables, read_segments=read_segments))
