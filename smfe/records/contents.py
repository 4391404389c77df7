"""What a file holds before anyone has declared a channel: its columns, their units, its clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from process.errors import InputError
from process.types import Real
from process.units import UNITS, known
from smfe.records.formats import netcdf
from smfe.records.formats.table import Column, UnknownColumn
from smfe.records.read import format_of

_NO_COLUMN = "\0"
"""A name that no column has: readers name theirs in the refusal, so that what is listed is what can be read."""

MOST_SAMPLES = 1 << 22
"""Samples of a column that `contents` keeps."""


@dataclass(frozen=True)
class Contents:
    """A file, or one segment of it, as it stands.

    Parameters
    ----------
    source : str
        File, and segment where there are several.
    columns : mapping of (str or int) to ndarray, shape (n,)
        Name, or position counted from 1, -> the numbers as they stand in the file.
    units : mapping of (str or int) to str
        Units that the file states; columns without one are left out.
    sample_rate : float or None
        Sample rate that the file states [Hz].
    start : float
        Time of the first sample then [s].
    unread : mapping of (str or int) to str
        Columns that hold no numbers or are of another length -> why.
    notes : tuple of str
        What was noticed while reading.
    """

    source: str
    columns: Mapping[Column, Real]
    units: Mapping[Column, str] = field(default_factory=dict)
    sample_rate: float | None = None
    start: float = 0.0
    unread: Mapping[Column, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Samples of a column."""
        return next((values.size for values in self.columns.values()), 0)


def column_names(path: str | Path) -> list[Column]:
    """Return what the columns of a file are called; positions, counted from 1, where it does not name them.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    path = Path(path)
    try:
        format_of(path).read_tables(path, [_NO_COLUMN])
    except UnknownColumn as absent:
        return list(absent.names) or list(range(1, absent.count + 1))
    raise InputError(f"{path.name}: the file names no columns")


def names_itself(path: str | Path) -> bool:
    """Whether a file holds a record in our own layout, which needs no declaration of channels."""
    path = Path(path)
    return format_of(path) is netcdf.FORMAT and netcdf.own_layout(path)


def has_no_clock(path: str | Path) -> bool:
    """Whether a file is of a format that states no sample rate, so that a column of times is needed."""
    path = Path(path)
    return format_of(path).needs_time(path)


def contents(path: str | Path) -> list[Contents]:
    """Read every column of numbers of a file, one item a segment.

    Raises
    ------
    InputError
        When the file cannot be read, or holds no column of numbers.
    """
    path = Path(path)
    read, names = format_of(path).read_tables, column_names(path)
    names = [name if names.count(name) == 1 else k + 1 for k, name in enumerate(names)]
    units, unread = stated_units(path, names), {}
    try:
        tables = read(path, names)
    except InputError:
        groups: list[list[Column]] = []
        sizes: list[int] = []
        for name in names:
            try:
                (table,) = read(path, [name])
            except (InputError, ValueError) as error:
                unread[name] = str(error)
                continue
            size = table.columns[name].size
            if size not in sizes:
                sizes.append(size)
                groups.append([])
            groups[sizes.index(size)].append(name)
        # The columns of one length that hold most numbers are the record: scalars and short tables are settings.
        order = np.argsort([size * len(group) for size, group in zip(sizes, groups, strict=True)])[::-1]
        kept = groups[order[0]] if groups else []
        for k in order[1:]:
            unread.update({name: f"it has {sizes[k]} values where others have {sizes[order[0]]}" for name in groups[k]})
        if not kept:
            raise
        tables = read(path, kept)
    return [
        Contents(
            path.name if len(tables) == 1 else f"{path.name}, segment {k}",
            {column: values[:MOST_SAMPLES] for column, values in table.columns.items()},
            units,
            table.sample_rate,
            table.start,
            unread,
            table.notes,
        )
        for k, table in enumerate(tables)
    ]


# --- units that files state -------------------------------------------------------------------------------------------

_IN_BRACKETS = re.compile(r"^(.*?)[\s_]*[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_AFTER_A_SLASH = re.compile(r"^(.*\w)\s*/\s*([^/\s]+(?:/\S+)?)\s*$")

_SPELLINGS = {
    "newton": "N", "newtons": "N", "kilonewton": "kN", "seconds": "s", "second": "s", "sec": "s", "hertz": "Hz",
    "pascal": "Pa", "pascals": "Pa", "meter": "m", "metre": "m", "meters": "m", "metres": "m", "millimeter": "mm",
    "grad": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "u/min": "rpm",
    "1/min": "rpm", "min^-1": "rpm", "m/s/s": "m/s^2", "m/sec^2": "m/s^2", "g_n": "g", "gn": "g", "lbs": "lbf",
}  # fmt: skip
"""Spellings of units that recorders use -> ours; compared in lower case."""


def plain_unit(text: str) -> str | None:
    """Return a unit as `process.units` spells it, None where it is none of ours."""
    unit = _SPELLINGS.get(text.strip().lower(), text.strip())
    return unit if unit and any(known(unit, dimension) for dimension in UNITS) else None


def without_unit(name: str) -> tuple[str, str | None]:
    """Return a header without its unit, and the unit: ``"Fx [N]"``, ``"t (s)"``, ``"Fx/kN"``."""
    for pattern in (_IN_BRACKETS, _AFTER_A_SLASH):
        match = pattern.match(name)
        if match and (unit := plain_unit(match[2])) is not None and not known(unit, "dimensionless"):
            return match[1].strip(), unit
    return name.strip(), None


def stated_units(path: Path, names: Sequence[Column]) -> dict[Column, str]:
    """Return the units that a file states for its columns: in brackets behind a name, or where its format has them."""
    found: dict[Column, str] = {}
    for name in names:
        if isinstance(name, str) and (unit := without_unit(name)[1]) is not None:
            found[name] = unit
    stated = format_of(path).stated_units
    if stated is not None:
        with suppress(InputError):
            texts = stated(path)
            plain = {name: plain_unit(text) for name, text in texts.items()}
            found |= {name: unit for name, unit in plain.items() if unit is not None and name in names}
    return found
