"""Types of the campaign file: text with a unit -> SI, patterns -> files, names -> one of a list."""

from __future__ import annotations

import glob
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, ValidationInfo

from process import units
from process.cut.engagement import CUTS
from process.errors import InputError
from process.labels import AXES, place_text
from process.units import FASTEST_FEED
from smfe.campaign import datasets
from smfe.patterns import matches
from smfe.records.formats.channels import did_you_mean, listed
from smfe.records.read import FORMATS
from stability.methods.catalogue import METHODS as STABILITY_METHODS

LOBE_METHODS = (*STABILITY_METHODS, "operating_point")
"""Methods for stability lobes that can be asked for."""


def quantity(dimension: str, low: float = -math.inf, above: float = -math.inf) -> BeforeValidator:
    """Text with a unit of `dimension` -> SI, at least `low` and more than `above`."""

    def parse(value: Any) -> float:
        number = units.parse(value, dimension)
        if not math.isfinite(number):
            raise InputError(f"'{value}' is not finite")
        if number < low or number <= above:
            raise InputError(f"'{value}' is not possible; it must be {'positive' if above == 0.0 else 'zero or more'}")
        return number

    return BeforeValidator(parse)


_SYNONYMS = {
    "conventional": "; conventional milling is up milling: write 'up'",
    "climb": "; climb milling is down milling: write 'down'",
    "slot": "; a slot is any of them with a width equal to the diameter",
}


def one_of(names: Sequence[str], what: str) -> BeforeValidator:
    """One of a list of names."""

    def check(value: Any) -> str:
        if isinstance(value, str) and value in names:
            return value
        near = did_you_mean(value, names) if isinstance(value, str) else ""
        near = _SYNONYMS.get(value, near) if what == "cut" and isinstance(value, str) else near
        raise InputError(f"{what} {value!r} is not known{near}; available: {', '.join(names)}")

    return BeforeValidator(check)


PositiveLength = Annotated[float, quantity("length", above=0.0)]
NoLength = Annotated[float, quantity("length", low=0.0)]
Length = Annotated[float, quantity("length")]
Time = Annotated[float, quantity("time")]
NoTime = Annotated[float, quantity("time", low=0.0)]
Frequency = Annotated[float, quantity("frequency", low=0.0)]
PositiveFrequency = Annotated[float, quantity("frequency", above=0.0)]
Angle = Annotated[float, quantity("angle")]


def _inertia(value: Any) -> tuple[float, str]:
    """A moved mass [kg], or the inertia of a rotary drive [kg m^2], and which of both."""
    for dimension in ("mass", "inertia"):
        with suppress(InputError):
            number = units.parse(value, dimension)
            if number > 0.0:
                return number, dimension
    raise InputError(f"{value!r} is no moved mass or inertia; write e.g. '250 kg' or '12 kg cm^2'")


Inertia = Annotated[tuple[float, str], BeforeValidator(_inertia)]
Force = Annotated[float, quantity("force", low=0.0)]
PositiveForce = Annotated[float, quantity("force", above=0.0)]
Mass = Annotated[float, quantity("mass", low=0.0)]
Stiffness = Annotated[float, quantity("stiffness", above=0.0)]
Pressure = Annotated[float, quantity("pressure")]
LineForce = Annotated[float, quantity("line_force")]
Temperature = Annotated[float, quantity("temperature")]
Rotation = Annotated[float, quantity("rotation", above=0.0)]

Axis = Annotated[str, one_of(AXES, "axis")]


def _place(value: Any) -> str:
    """An axis at the tool tip, or "NODE:axis"; a minus before the axis turns the direction round."""
    if not isinstance(value, str):
        raise InputError(f"{value!r} is no place; write an axis at the tool tip, 'x', or a node and an axis, '21:x'")
    return place_text(value)


Place = Annotated[str, BeforeValidator(_place)]
CutName = Annotated[str, one_of(CUTS, "cut")]

OTHER_CUTS = {"offset": ("width_of_cut", "offset"), "angles": ("entry_angle", "exit_angle"), "strips": ("strips",)}
"""What the engagement of lobes may be besides `CUTS`, and the keys that say it."""

Engaged = Annotated[str, one_of((*CUTS, *OTHER_CUTS), "cut")]


def _ratio(value: Any) -> float:
    """A number, or text in per cent."""
    if isinstance(value, str):
        return units.parse(value, "dimensionless")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{value!r} is not a number; write 0.012 or '1.2 %'")
    return float(value)


Ratio = Annotated[float, BeforeValidator(_ratio)]

MOST_SCALE = 1e15
"""Largest factor on the numbers of a channel, and one over the smallest: what lies beyond is no sensor's."""


def _scale(value: Any) -> float:
    scale = _ratio(value)
    if not 1.0 / MOST_SCALE <= abs(scale) <= MOST_SCALE:
        raise InputError(
            f"{value!r} is the factor of no sensor; give one between {1.0 / MOST_SCALE:g} and {MOST_SCALE:g}"
        )
    return scale


Scale = Annotated[float, BeforeValidator(_scale)]


def _not_negative(value: Any) -> float:
    ratio = _ratio(value)
    if not 0.0 <= ratio < math.inf:
        raise InputError(f"{value!r} is no ratio of two amplitudes; write one of zero or more, e.g. 0.3")
    return ratio


at_least_zero = BeforeValidator(_not_negative)


LEAST_DAMPING = 1e-6
"""Smallest damping ratio of a mode that is taken."""


def _damping(value: Any) -> float:
    ratio = _ratio(value)
    if not 0.0 < ratio < 1.0:
        raise InputError(f"{value!r} is no damping ratio of a mode; write one above 0 and below 1, e.g. 0.02 or '2 %'")
    if ratio < LEAST_DAMPING:
        raise InputError(
            f"{value!r} is the damping ratio of no structure: a steel bar in vacuum has more than {LEAST_DAMPING:g}; "
            "a peak so narrow has no limits that can be computed; measure it, or write 0.001"
        )
    return ratio


DampingRatio = Annotated[float, BeforeValidator(_damping)]


def _share(value: Any) -> float:
    share = _ratio(value)
    if not 0.0 <= share < 1.0:
        raise InputError(f"{value!r} is no share of a value; write a number from 0 to below 1, e.g. 0.05 or '5 %'")
    return share


Share = Annotated[float, BeforeValidator(_share)]


def _feed(value: Any) -> dict[str, float]:
    """One speed for all axes, or a table of axes; axes that are left out rest. -> axis -> m/s."""
    if not isinstance(value, dict):
        return dict.fromkeys(AXES, _speed(value))
    unknown = [axis for axis in value if axis not in AXES]
    if unknown:
        raise InputError(f"axis {unknown[0]!r} is none of {', '.join(AXES)}")
    return {axis: _speed(value[axis]) if axis in value else 0.0 for axis in AXES}


def _speed(value: Any) -> float:
    speed = units.parse(value, "speed")
    if abs(speed) > FASTEST_FEED:
        raise InputError(
            f"{value!r} is beyond any machine tool ({FASTEST_FEED:g} m/s); give the feed with its unit, e.g. "
            '"3000 mm/min"'
        )
    return speed


Feed = Annotated[dict[str, float], BeforeValidator(_feed)]

_COMPASS = {"x": 0.0, "y": 0.5 * math.pi, "-x": math.pi, "-y": -0.5 * math.pi}


def _feed_direction(value: Any) -> float:
    """An axis with its sign, or the angle from +x towards +y -> rad, above -pi and at most pi."""
    if isinstance(value, str) and value in _COMPASS:
        return _COMPASS[value]
    try:
        angle = units.parse(value, "angle")
    except InputError:
        angle = math.nan
    if not math.isfinite(angle):
        raise InputError(
            f"{value!r} is no direction of a feed; write 'x', 'y', '-x', '-y', or the angle from +x towards +y, "
            "e.g. '30 deg'"
        )
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


FeedDirection = Annotated[float, BeforeValidator(_feed_direction)]


def _list_of(value: Any, dimension: str, sizes: Sequence[int], example: str) -> list[float]:
    if not isinstance(value, list) or len(value) not in sizes:
        raise InputError(f"{value!r} is not a list of {' or '.join(map(str, sizes))} quantities; write e.g. {example}")
    return [units.parse(item, dimension) for item in value]


def _frequency_range(value: Any) -> tuple[float, float]:
    low, high = _list_of(value, "frequency", (2,), '["20 Hz", "80 Hz"]')
    if not 0.0 <= low < high:
        raise InputError(f"from {value[0]} to {value[1]} is no range; the first must be below the second")
    return low, high


FrequencyRange = Annotated[tuple[float, float], BeforeValidator(_frequency_range)]


def _interval(value: Any) -> tuple[float, float]:
    begin, end = _list_of(value, "time", (2,), '["2 s", "6 s"]')
    if not begin < end:
        raise InputError(f"from {value[0]} to {value[1]} is no interval; the first must be before the second")
    return begin, end


Interval = Annotated[tuple[float, float], BeforeValidator(_interval)]

FLOORS = {"acceleration": "acceleration", "displacement": "length", "force": "force", "sound": "pressure"}
"""Quantity that a cut is judged by -> dimension of the least amplitude that counts."""


def _floor(value: Any) -> tuple[float, str]:
    """An amplitude of one of the quantities a cut is judged by -> SI, and the quantity."""
    for name, dimension in FLOORS.items():
        try:
            number = units.parse(value, dimension)
        except InputError:
            continue
        if number > 0.0:
            return number, name
    raise InputError(
        f"{value!r} is no amplitude of {', '.join(FLOORS)}; write e.g. '0.05 m/s^2', '1 um', '5 N' or '0.002 Pa'"
    )


Floor = Annotated[tuple[float, str], BeforeValidator(_floor)]

_MOST_SPEEDS = 100_000

LOBE_POINTS = 200
"""Spindle speeds of a lobe diagram where the campaign gives no step."""

_HOW_SPEEDS = (
    'write ["600 rpm", "1500 rpm", "5 rpm"] (from, to, step), "1200 rpm", or { speeds = ["800 rpm", "1200 rpm"] }'
)


@dataclass(frozen=True)
class SpindleSpeeds:
    """Spindle speeds of a request for lobes.

    Parameters
    ----------
    values : tuple of float
        Rising [rpm].
    listed : bool
        Each was named, as a shop names the speeds that it uses; else they are the steps of a range.
    """

    values: tuple[float, ...]
    listed: bool


def _speeds(value: Any) -> SpindleSpeeds:
    """A speed, {speeds = [...]}, four speeds or more, [from, to] or [from, to, step] -> rpm."""
    if isinstance(value, dict):
        if set(value) != {"speeds"}:
            raise InputError(f"{value!r} is no list of spindle speeds; {_HOW_SPEEDS}")
        return _listed(value["speeds"])
    if not isinstance(value, list) or len(value) == 1:
        return _listed(value)
    if len(value) > 3:
        found = _listed(value)
        if [_rpm(item) for item in value] != list(found.values):
            raise InputError(f"{value!r} is neither from, to and step nor a rising list of speeds; {_HOW_SPEEDS}")
        return found
    rpm = tuple(_rpm(item) for item in value)
    if len(rpm) < 2:
        raise InputError(f"{value!r} names no spindle speed; {_HOW_SPEEDS}")
    low, high = rpm[:2]
    if not 0.0 < low < high:
        raise InputError(f"from {value[0]} to {value[1]} is no range; the first must be positive and below the second")
    if len(rpm) == 2:
        return SpindleSpeeds(tuple(np.linspace(low, high, LOBE_POINTS).tolist()), listed=False)
    if not (high - low) / _MOST_SPEEDS < rpm[2] <= (high - low) * (1.0 + 1e-9):
        listed = "" if rpm[2] <= high else "; three speeds are { speeds = [...] }"
        raise InputError(
            f"a step of {value[2]} does not divide {value[0]} to {value[1]} into 2 to {_MOST_SPEEDS} speeds{listed}"
        )
    count = int((high - low) / rpm[2] * (1.0 + 1e-9)) + 1
    return SpindleSpeeds(tuple((low + rpm[2] * np.arange(count)).tolist()), listed=False)


def _rpm(value: Any) -> float:
    # What was written as a whole number of rpm is one again, whatever it was in rad/s.
    return round(units.from_si(units.parse(value, "rotation"), "rpm", "rotation"), 9)


def _listed(value: Any) -> SpindleSpeeds:
    rpm = [_rpm(item) for item in (value if isinstance(value, list) else [value])]
    if not rpm or min(rpm) <= 0.0:
        raise InputError(f"{value!r} names no spindle speed that turns; {_HOW_SPEEDS}")
    if len(set(rpm)) < len(rpm):
        raise InputError(f"{value!r} names a spindle speed twice; name each once")
    return SpindleSpeeds(tuple(sorted(rpm)), listed=True)


LobeSpeeds = Annotated[SpindleSpeeds, BeforeValidator(_speeds)]


_MOST_WIDTHS = 60
"""Widths of a range, at most: each is a request of its own."""


def _widths(value: Any) -> tuple[float, ...]:
    """A width, a list of them, or from, to and step -> rising [m], each once.

    Three values of which the last is below the second are a range: three widths are written rising.
    """
    found = [units.parse(item, "length") for item in (value if isinstance(value, list) else [value])]
    if not found:
        raise InputError("is empty; at least one width is needed")
    if min(found) <= 0.0 or not math.isfinite(max(found)):
        raise InputError(f"{value!r} is not possible; a width of cut must be positive")
    if len(found) == 3 and found[0] < found[1] > found[2]:
        low, high, step = found
        count = int((high - low) / step * (1.0 + 1e-9)) + 1
        if not 2 <= count <= _MOST_WIDTHS:
            raise InputError(
                f"a step of {value[2]} does not divide {value[0]} to {value[1]} into 2 to {_MOST_WIDTHS} widths; three "
                "widths are written rising"
            )
        return tuple(round(low + k * step, 12) for k in range(count))
    if len({round(w, 12) for w in found}) < len(found):
        raise InputError(f"{value!r} names a width twice; name each once")
    return tuple(sorted(found))


Widths = Annotated[tuple[float, ...], BeforeValidator(_widths)]


def _strips(value: Any) -> tuple[tuple[float, float], ...]:
    """Edges of strips of work, [[from, to], ...] from the tool axis along +y -> [m]."""
    example = '[["-30 mm", "-10 mm"], ["5 mm", "25 mm"]]'
    if not isinstance(value, list) or not value or not all(isinstance(item, list) for item in value):
        raise InputError(f"{value!r} names no strips; write the edges of each from the tool axis along +y, {example}")
    found = []
    for item in value:
        low, high = _list_of(item, "length", (2,), '["-30 mm", "-10 mm"]')
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(f"{item!r} is no strip of work; the lower edge comes first, along +y")
        found.append((low, high))
    return tuple(sorted(found))


Strips = Annotated[tuple[tuple[float, float], ...], BeforeValidator(_strips)]


def _ramp(value: Any) -> tuple[float, float]:
    """[from, to] -> rad/s, rising or falling."""
    first, last = _list_of(value, "rotation", (2,), '["600 rpm", "1500 rpm"]')
    if not (first > 0.0 and last > 0.0):
        raise InputError(f"from {value[0]} to {value[1]} is no sweep; both speeds must be positive")
    return first, last


Ramp = Annotated[tuple[float, float], BeforeValidator(_ramp)]


def _files(value: Any, info: ValidationInfo) -> tuple[Path, ...]:
    """A name, a pattern or ``dataset:NAME/FILE`` -> files, sorted. The context holds `path`, `show`, perhaps `held`."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{value!r} is not the name of a file")
    context: dict[str, Any] = info.context or {}
    if value in context.get("held", ()):
        return (Path(value),)  # a record in memory, under this name
    campaign: Path = context["path"]
    if value.startswith(datasets.PREFIX):
        found = [datasets.resolve(value, context.get("show"))]
    else:
        found = _matches(campaign.parent, value)
    unread = sorted({file.suffix for file in found if file.suffix.lower() not in FORMATS})
    if unread:
        raise InputError(f"'{value}': files with suffix '{unread[0]}' are not read; known are {', '.join(FORMATS)}")
    return tuple(found)


def _matches(folder: Path, pattern: str) -> list[Path]:
    exact = folder / pattern
    if exact.is_file():
        return [exact]
    escaped = {c: e for c, e in zip("\b\f\n\r\t", "bfnrt", strict=True) if c in pattern}
    if escaped or ("\\" in pattern and os.sep == "/"):
        meant = pattern
        for character, letter in escaped.items():
            meant = meant.replace(character, f"/{letter}")
        meant = meant.replace("\\", "/")
        why = "a backslash in double quotes begins an escape" if escaped else "a backslash parts no folders here"
        raise InputError(f'no file {pattern!r} in {folder}: {why}; write "{meant}"')
    if glob.has_magic(pattern):
        files = [path for path in matches(folder, pattern) if path.is_file()]
        if files:
            return files
    there = sorted(path.name for path in exact.parent.iterdir() if path.is_file()) if exact.parent.is_dir() else []
    readable = [name for name in there if Path(name).suffix.lower() in FORMATS]
    raise InputError(
        f"no file '{pattern}' in {folder}{did_you_mean(exact.name, readable)}; "
        + (f"the records there are {listed(readable, 8)}" if readable else "there are no records there")
    )


Files = Annotated[tuple[Path, ...], BeforeValidator(_files)]


def _one_file(value: Any, info: ValidationInfo) -> Path:
    found = _files(value, info)
    if len(found) != 1:
        raise InputError(f"'{value}' matches {len(found)} files; name one")
    return found[0]


OneFile = Annotated[Path, BeforeValidator(_one_file)]


def _not_empty(value: Any) -> Any:
    """Refuse an empty list; pydantic's own minimum counts only the entries that are right."""
    if value == []:
        raise InputError("is empty; at least one entry is needed")
    return value


NotEmpty = BeforeValidator(_not_empty)


def _column(value: Any) -> str | int:
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        raise InputError(f"{value!r} is neither a header name nor a position")
    if isinstance(value, int) and value < 1:
        raise InputError(f"column {value} is not possible; positions count from 1")
    return value


Column = Annotated[str | int, BeforeValidator(_column)]


def _sign(value: Any) -> float:
    if isinstance(value, bool) or value not in (1, -1):
        raise InputError(f"{value!r} is no sign; write 1 or -1, and use scale for a factor")
    return float(value)


Sign = Annotated[float, BeforeValidator(_sign)]


LONGEST_NAME = 150
"""Bytes of a name: file systems take 255, and more stands before and behind it."""


def _name(value: Any) -> str:
    named = isinstance(value, str) and value.strip(". ") and value.isprintable()
    if not isinstance(value, str) or not named or "/" in value or "\\" in value:
        raise InputError(
            f"{value!r} is no name; one line of text without '/' is needed, since results are stored under it"
        )
    if len(value.encode()) > LONGEST_NAME:
        raise InputError(f"'{value[:40]}...' has {len(value)} characters; files are called after it, shorten it")
    return value


Name = Annotated[str, BeforeValidator(_name)]
