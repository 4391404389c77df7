"""Which column is probably which channel, by the names and units that a file gives."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from process.errors import InputError
from process.labels import AXES, restarting_rate
from process.types import Real
from process.units import known
from smfe.records.contents import (
    Contents,
    column_names,
    has_no_clock,
    names_itself,
    plain_unit,
    stated_units,
    without_unit,
)
from smfe.records.formats.channels import CHANNELS, Channel, listed
from smfe.records.formats.table import Column
from smfe.records.write import OWN_COLUMNS

_WORDS: tuple[tuple[str, str], ...] = (
    ("reference_speed", r"(cmd|des|ref|soll|set)\w*[_ .|]*(speed|vel|geschw)|cmd_speed|vref"),
    ("encoder_speed", r"(enc|act|ist|fb|meas)\w*[_ .|]*(speed|vel|geschw)|venc"),
    (
        "reference_position",
        r"(cmd|des|ref|soll|set|target)\w*[_ .|]*(pos|weg|lage)|des_pos|^ref(?![a-z]{3})|^qg$|pos\w*[_ .-]*(cmd|set)",
    ),
    ("encoder_position", r"(enc|act|ist|fb|meas|motor|joint)\w*[_ .|]*(pos|weg|lage)|^enc|^qm$|^pos|pos\w*[_ .-]*fb"),
    ("drive_force", r"torque|moment|current|strom|^i[qd]$|drive[_ ]?force|^fd|^vir$|tau"),
    ("spindle_speed", r"spindle\w*[_ ]*speed|drehzahl|^n$|^rpm$|^speed$|^nspindle|spindle[_ ]?rpm"),
    ("tacho", r"tacho|once.?per.?rev|keyphasor|trigger.?rev"),
    ("spindle_angle", r"spindle\w*[_ ]*(angle|winkel)|^angle$"),
    ("force", r"^f[_ .-]?\w?$|force|kraft|^fx|^fy|^fz|hammer|dyno|load.?cell"),
    ("acceleration", r"^a[_ .-]?\w?$|acc|beschl|^ax|^ay|^az|ch.*icp"),
    ("displacement", r"^u[_ .-]?\w?$|disp|weg|abstand|laser|eddy|gap"),
    ("sound", r"mic|sound|schall|audio|^p$|noise"),
)
"""Channel -> what the name of its column looks like, the more special first."""

_DIMENSIONS = {
    "force": "force",
    "acceleration": "acceleration",
    "pressure": "sound",
    "rotation": "spindle_speed",
    "angle": "spindle_angle",
}
"""Dimension of the unit -> channel, where the name says nothing."""

_TIME = re.compile(r"^(t|time|zeit|temps|tiempo|tempo|x_value|timestamp|seconds?|t\(s\)|time stamp)$", re.I)
_FREQUENCY = re.compile(r"^(f|freq\w*|frequenz|hz)$", re.I)
_NUMBERED = dict(zip("123", AXES, strict=True))


@dataclass(frozen=True)
class Guess:
    """What a column probably is.

    Parameters
    ----------
    channel : str
        Name of the channel.
    column : str or int
        Its column.
    unit : str
        Unit, that of the file or an assumed one.
    assumed : bool
        Whether the file states no unit, or one that does not fit the channel.
    """

    channel: str
    column: Column
    unit: str
    assumed: bool


def guess_channels(found: Contents) -> tuple[list[Guess], Mapping[Column, str]]:
    """Return the channels that the columns of a file probably are, and the columns that say nothing.

    Parameters
    ----------
    found : Contents
        What `smfe.records.contents` returns of a segment.

    Returns
    -------
    list of Guess
        Each channel at most once, in the order of the columns.
    mapping of (str or int) to str
        Columns that are no channel -> why.
    """
    out: list[Guess] = []
    left: dict[Column, str] = {}
    clock = time_column(found)
    for column, values in found.columns.items():
        unit = found.units.get(column)
        if column == clock:
            fits = unit is not None and known(unit, "time")
            out.append(Guess("time", column, unit if fits and unit else "s", not fits))
            continue
        channel = _channel_of(column, unit, len(found.columns))
        if channel is None and restarting_clock(found) == column:
            left[column] = "it begins anew with each block"
        elif channel is None:
            left[column] = "its name says nothing" if unit is None else f"no channel of a record is in '{unit}'"
        elif not np.all(np.isfinite(values)):
            left[column] = f"{int(np.sum(~np.isfinite(values)))} of its values are missing"
        elif np.ptp(values) == 0.0 and not channel.startswith("spindle"):
            left[column] = "it is constant"
        elif any(g.channel == channel for g in out):
            left[column] = f"{channel} is taken for another column already"
        else:
            usual, fits = _unit_of(channel, unit)
            out.append(Guess(channel, column, usual, not fits))
    return out, left


def time_column(found: Contents) -> Column | None:
    """Return the column of times: one called so, else the first that rises in even steps; None without."""
    rising = [c for c, v in found.columns.items() if v.size > 2 and _even(v)]
    named = [c for c in rising if _TIME.match(without_unit(_plain(c))[0].rpartition("/")[2]) or _timed(found, c)]
    if named:
        return named[0]
    # A column whose name says another thing is no clock: a position at constant feed rises evenly, too.
    unnamed = [c for c in rising if isinstance(c, int) and found.sample_rate is None]
    return unnamed[0] if unnamed and unnamed[0] == next(iter(found.columns)) else None


def restarting_clock(found: Contents) -> Column | None:
    """Return the column of times that begin anew with each block of a triggered recorder; None without."""
    for column, values in found.columns.items():
        called = _TIME.match(without_unit(_plain(column))[0].rpartition("/")[2]) or _timed(found, column)
        if called and restarting_rate(values) is not None:
            return column
    return None


def frequency_column(found: Contents) -> Column | None:
    """Return the column of frequencies, where there is one: called so, even and from zero or more."""
    for column, values in found.columns.items():
        name = without_unit(_plain(column))[0].rpartition("/")[2]
        called = _FREQUENCY.match(name) or found.units.get(column) in ("Hz", "kHz")
        if called and values.size > 2 and values[0] >= 0.0 and _even(values):
            return column
    return None


def _timed(found: Contents, column: Column) -> bool:
    unit = found.units.get(column)
    return unit is not None and known(unit, "time")


def _plain(column: Column) -> str:
    return column if isinstance(column, str) else ""


def _even(values: Real) -> bool:
    """Whether values rise, and depart from even steps by less than a step."""
    if not np.all(np.isfinite(values)) or values[-1] <= values[0]:
        return False
    step = (values[-1] - values[0]) / (values.size - 1)
    even = values[0] + step * np.arange(values.size)
    return bool(np.all(np.diff(values) >= 0.0) and np.max(np.abs(values - even)) <= 1.5 * step)


def _channel_of(column: Column, unit: str | None, count: int) -> str | None:
    name = without_unit(_plain(column))[0].rpartition("/")[2].strip()
    kind = next((channel for channel, pattern in _WORDS if re.search(pattern, name, re.I)), None)
    if unit is not None and (kind is None or not _fits(kind, unit)):
        by_unit = next((channel for dimension, channel in _DIMENSIONS.items() if known(unit, dimension)), None)
        kind = by_unit if by_unit is not None else kind if kind in ("drive_force", "tacho") else None
    if kind is None:
        return None
    if f"{kind}_x" not in CHANNELS:
        return kind
    return f"{kind}_{_axis(name, kind)}"


def _axis(name: str, kind: str) -> str:
    """Return the axis that a name ends with, or begins with, or its number; x where it says none."""
    low = name.lower()
    for pattern in (r"[_ .|:+(-]?([xyz])\d?\)?$", r"^([xyz])\d?(?![a-z])", r"[_ .|:]([xyz])\d?(?![a-z])"):
        match = re.search(pattern, low)
        if match and not (kind == "force" and low == "max"):
            return match[1]
    number = re.search(r"[|_ ]([123])$", low)
    return _NUMBERED[number[1]] if number else "x"


def _fits(kind: str, unit: str) -> bool:
    dimension = CHANNELS.get(kind, CHANNELS.get(f"{kind}_x", ""))
    return dimension == "dimensionless" or (plain_unit(unit) is not None and known(unit, dimension))


def _unit_of(channel: str, unit: str | None) -> tuple[str, bool]:
    """Return the unit to declare, and whether it is the file's."""
    usual = {"force": "N", "acceleration": "m/s^2", "length": "m", "speed": "m/s", "rotation": "rpm", "angle": "rad"}
    dimension = CHANNELS[channel]
    if dimension == "dimensionless":
        return "1", True
    if unit is not None and known(unit, dimension):
        return unit, True
    return usual.get(dimension, "Pa"), False


# --- the channels that a file has where none are declared ----------------------------------------------------------

DEFAULT_CHANNELS: tuple[tuple[str, Channel], ...] = (*OWN_COLUMNS.items(), ("sound", Channel("p", "Pa")))
"""Columns that are looked for in a file when no campaign declares others: those that `smfe convert` and `smfe simulate`
write. A unit that the file states itself takes the place of the one here."""


def default_channels(path: Path) -> dict[str, Channel]:
    """Return those of `DEFAULT_CHANNELS` that a file has, in the units that it states, where it does.

    Raises
    ------
    InputError
        When the file cannot be read, or has the time alone or none of them.
    """
    if names_itself(path):
        return {}
    names = column_names(path)
    units = stated_units(path, names)
    # A channel that only one group has needs no group: "run 1/ax" is "ax".
    inside = [str(name).rpartition("/")[2] for name in names]
    known = {n: full for n, full in zip(inside, names, strict=True) if inside.count(n) == 1} | {n: n for n in names}
    found: dict[str, Channel] = {}
    for name, channel in DEFAULT_CHANNELS:
        if channel.column in known and name not in found:
            column = known[channel.column]
            found[name] = replace(channel, column=column, unit=units.get(column, channel.unit) or channel.unit)
    if not found.keys() - {"time"} or ("time" not in found and has_no_clock(path)):
        raise InputError(_no_default_channels(path))
    return found


def _no_default_channels(path: Path) -> str:
    time, *rest = (f"{channel.column} [{channel.unit}]" for _, channel in DEFAULT_CHANNELS)
    return (
        f"{path.name}: looked for the columns {time}, {', '.join(rest)}; the time and at least one of the others are "
        f"needed, and the file has {listed(column_names(path))}: rename the columns, or give the campaign file whose "
        f"[channels] declare them (smfe look {path.name} writes one)"
    )
