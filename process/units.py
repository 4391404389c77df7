"""Quantities as text, ``"125 mm"`` -> 0.125 and back, and the range that a parameter of a machine tool may have.

This is the only place where field units are converted. Everything inside the packages is SI (angles in rad,
rotation in rad/s). A unit belongs to a dimension, so that ``"g"`` is 9.80665 m/s2 where an acceleration is
expected and 0.001 kg where a mass is. `implausible`, `check_feed` and `check_diameter` find values that no machine
tool has: field units that were given where SI is meant.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from process.errors import InputError
from process.types import Real

_REVOLUTION = 2.0 * math.pi
_POUND_FORCE = 4.4482216152605
_PSI = _POUND_FORCE / 0.0254**2

UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "in": 0.0254, "ft": 0.3048, "thou": 25.4e-6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0},
    "frequency": {"Hz": 1.0, "1/s": 1.0, "kHz": 1e3, "rad/s": 1.0 / _REVOLUTION},
    "speed": {
        "m/s": 1.0,
        "mm/s": 1e-3,
        "mm/min": 1e-3 / 60.0,
        "m/min": 1.0 / 60.0,
        "in/min": 0.0254 / 60.0,
        "ipm": 0.0254 / 60.0,
        "in/s": 0.0254,
        "ft/min": 0.3048 / 60.0,
    },
    "acceleration": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665, "in/s^2": 0.0254, "ft/s^2": 0.3048},
    "rotation": {
        "rad/s": 1.0,
        "rpm": _REVOLUTION / 60.0,
        "1/min": _REVOLUTION / 60.0,
        "Hz": _REVOLUTION,
        "deg/s": math.pi / 180.0,
        "rev/s": _REVOLUTION,
    },
    "rotation_rate": {"rad/s^2": 1.0, "rpm/s": _REVOLUTION / 60.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0, "rev": _REVOLUTION},
    "force": {"N": 1.0, "kN": 1e3, "lbf": _POUND_FORCE},
    "current": {"A": 1.0, "mA": 1e-3},
    "force_constant": {"N/A": 1.0},
    "impulse": {"N s": 1.0, "Ns": 1.0},
    "force_rate": {"N/s": 1.0},
    "power": {"W": 1.0, "kW": 1e3, "hp": 745.69987158227022},
    "torque": {
        "N m": 1.0,
        "Nm": 1.0,
        "N cm": 1e-2,
        "N mm": 1e-3,
        "mN m": 1e-3,
        "kN m": 1e3,
        "lbf ft": _POUND_FORCE * 0.3048,
        "lbf in": _POUND_FORCE * 0.0254,
    },
    "inertia": {"kg m^2": 1.0, "kg cm^2": 1e-4, "g cm^2": 1e-7, "kg mm^2": 1e-6, "g m^2": 1e-3},
    "mass": {"kg": 1.0, "g": 1e-3, "lb": 0.45359237},
    "stiffness": {"N/m": 1.0, "N/mm": 1e3, "N/um": 1e6, "N/µm": 1e6, "lbf/in": _POUND_FORCE / 0.0254},
    "compliance": {
        **{"m/N": 1.0, "mm/N": 1e-3, "um/N": 1e-6, "µm/N": 1e-6, "nm/N": 1e-9},
        **{"m/kN": 1e-3, "mm/kN": 1e-6, "um/kN": 1e-9, "µm/kN": 1e-9, "in/lbf": 0.0254 / _POUND_FORCE},
    },
    "mobility": {
        **{"m/s/N": 1.0, "mm/s/N": 1e-3, "(m/s)/N": 1.0, "(mm/s)/N": 1e-3, "m/(N s)": 1.0, "m/(s N)": 1.0},
        **{"in/s/lbf": 0.0254 / _POUND_FORCE, "(in/s)/lbf": 0.0254 / _POUND_FORCE},
    },
    "accelerance": {
        **{"m/s^2/N": 1.0, "mm/s^2/N": 1e-3, "g/N": 9.80665, "(m/s^2)/N": 1.0, "(mm/s^2)/N": 1e-3, "m/(N s^2)": 1.0},
        **{"m/(s^2 N)": 1.0, "1/kg": 1.0, "kg^-1": 1.0, "g/kN": 9.80665e-3, "g/lbf": 9.80665 / _POUND_FORCE},
    },
    "dynamic_stiffness": {
        **{"N/m": 1.0, "N/mm": 1e3, "N/um": 1e6, "N/µm": 1e6, "N/nm": 1e9, "kN/m": 1e3, "kN/mm": 1e6},
        **{"lbf/in": _POUND_FORCE / 0.0254},
    },
    "impedance": {
        **{"N s/m": 1.0, "Ns/m": 1.0, "N s/mm": 1e3, "Ns/mm": 1e3, "N/(m/s)": 1.0, "N/(mm/s)": 1e3},
        **{"kg/s": 1.0, "lbf s/in": _POUND_FORCE / 0.0254, "lbf/(in/s)": _POUND_FORCE / 0.0254},
    },
    "apparent_mass": {
        **{"kg": 1.0, "N/(m/s^2)": 1.0, "N s^2/m": 1.0, "Ns^2/m": 1.0, "N/g": 1.0 / 9.80665},
        **{"kN/g": 1e3 / 9.80665, "lbf/g": _POUND_FORCE / 9.80665},
    },
    "cubic_stiffness": {"N/m^3": 1.0, "N/mm^3": 1e9},
    "viscosity": {"N s/m": 1.0, "Ns/m": 1.0, "N s/mm": 1e3, "N min/mm": 6e4},
    "steepness": {"s/m": 1.0, "s/mm": 1e3, "min/mm": 6e4},
    "pressure": {"N/m^2": 1.0, "Pa": 1.0, "MPa": 1e6, "N/mm^2": 1e6, "GPa": 1e9, "psi": _PSI, "ksi": 1e3 * _PSI},
    "line_force": {"N/m": 1.0, "N/mm": 1e3, "lbf/in": _POUND_FORCE / 0.0254},
    "temperature": {"degC": 1.0, "°C": 1.0},
    "dimensionless": {"": 1.0, "1": 1.0, "%": 0.01, "ppm": 1e-6},
}
"""Dimension -> unit -> factor to SI."""

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


def _canonical(unit: str) -> str:
    """One spelling for the usual variants: ``m/s2``, ``m/s**2`` and ``m/s²`` are ``m/s^2``."""
    text = unit.strip().replace("²", "^2").replace("**", "^").replace("μ", "µ")
    return re.sub(r"(?<=[a-z])2$", "^2", text)


def factor(unit: str, dimension: str) -> float:
    """Return the number that turns a value in `unit` into SI.

    Parameters
    ----------
    unit : str
        Unit symbol such as ``"mm"`` or ``"N/mm^2"``.
    dimension : str
        A key of `UNITS`.

    Raises
    ------
    InputError
        When the unit does not belong to the dimension.
    """
    table = UNITS[dimension]
    name = _canonical(unit)
    if name not in table:
        raise InputError(
            f"unit '{unit}' is not a unit of {dimension.replace('_', ' ')}; use one of: "
            + ", ".join(repr(known) for known in table if known)
        )
    return table[name]


def known(unit: str, dimension: str) -> bool:
    """Whether a unit belongs to a dimension."""
    return _canonical(unit) in UNITS[dimension]


_NUMBERS: ContextVar[bool] = ContextVar("numbers are SI", default=False)


@contextmanager
def numbers_are_si() -> Iterator[None]:
    """Let `parse` take plain numbers, as SI, inside the block: a program knows its units, a file must state them."""
    token = _NUMBERS.set(True)
    try:
        yield
    finally:
        _NUMBERS.reset(token)


def numbers_count() -> bool:
    """Whether `parse` takes plain numbers here, as SI."""
    return _NUMBERS.get()


_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*[^\d\s,]*\s*$")


def _without_comma(text: str) -> str:
    """Say what a quantity with a comma may be; three digits behind it may be thousands."""
    point, none = text.strip().replace(",", "."), text.strip().replace(",", "")
    perhaps = f' or, if the comma parts thousands, "{none}"' if re.search(r",\d{3}(?!\d)", text) else ""
    return f"'{text}' has a decimal comma; write \"{point}\"{perhaps}"


def parse(text: str, dimension: str) -> float:
    """Turn a quantity written as text into SI.

    Parameters
    ----------
    text : str
        Number and unit, ``"125 mm"``.
    dimension : str
        A key of `UNITS`.

    Returns
    -------
    float
        The value in SI (m, s, Hz, m/s, rad/s, N, ...).

    Raises
    ------
    InputError
        When there is no number, no unit, the unit is of another dimension, or the number is too large to be held.
    """
    if not isinstance(text, str):
        if _NUMBERS.get() and isinstance(text, int | float) and not isinstance(text, bool):
            return float(text)
        raise InputError(f"{text!r} has no unit; write it as text with a unit, e.g. {_example(dimension)}")
    if _DECIMAL_COMMA.match(text):
        raise InputError(_without_comma(text))
    match = _NUMBER.match(text)
    if match is None:
        raise InputError(f"'{text}' is not a number with a unit; write e.g. {_example(dimension)}")
    number, unit = match.groups()
    if not unit and dimension != "dimensionless":
        raise InputError(f"'{text}' has no unit; write e.g. {_example(dimension)}")
    value = float(number) * factor(unit, dimension)
    if not math.isfinite(value):
        raise InputError(f"'{text}' is not finite; write e.g. {_example(dimension)}")
    return value


def si(value: float | str, dimension: str) -> float:
    """Return a number as it is, which is SI, and a text with a unit in SI: ``si("40 mm", "length") == si(0.04, ...)``.

    Raises
    ------
    InputError
        When the text is no quantity of that dimension, or the value is no number.
    """
    if isinstance(value, str):
        return parse(value, dimension)
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{value!r} is neither a number in SI nor a text with a unit, e.g. {_example(dimension)}")
    return float(value)


def show(value: float, unit: str, dimension: str, digits: int = 6) -> str:
    """Write an SI value as text in `unit`: ``show(0.125, "mm", "length") == "125 mm"``."""
    return f"{value / factor(unit, dimension):.{digits}g} {unit}".strip()


def from_si(value: float, unit: str, dimension: str) -> float:
    """Return an SI value as a number in `unit`."""
    return value / factor(unit, dimension)


def _example(dimension: str) -> str:
    unit = list(UNITS[dimension])[1 if len(UNITS[dimension]) > 1 else 0]
    return f'"10 {unit}"'


# --- Plausible values: field units given where SI is meant are refused.


@dataclass(frozen=True)
class Range:
    """Range of a parameter in the field, wide: a value outside is a mistake and not a rare machine.

    Parameters
    ----------
    low, high : float
        Ends, SI.
    shown : float
        Factor to the unit shown.
    unit : str
        That unit.
    source : str
        Where the ends come from.
    """

    low: float
    high: float
    shown: float
    unit: str
    source: str


_SPECIFIC_FORCE = (
    "specific cutting forces at 1 mm chip are 100 (polymers) to 4000 N/mm^2 (nickel, hardened steel) in the tables of "
    "Kienzle and Victor and of Altintas, Manufacturing Automation; chips of some um need five times that"
)
_EDGE = "edge coefficients of sharp and worn inserts are 5 to 250 N/mm (Altintas, Manufacturing Automation; Budak 1996)"

RANGES: dict[str, Range] = {
    "Ktc": Range(30e6, 20e9, 1e-6, "N/mm^2", _SPECIFIC_FORCE),
    "Krc": Range(-10e9, 20e9, 1e-6, "N/mm^2", _SPECIFIC_FORCE),
    "Kac": Range(-10e9, 10e9, 1e-6, "N/mm^2", _SPECIFIC_FORCE),
    "Kte": Range(-50e3, 500e3, 1e-3, "N/mm", _EDGE),
    "Kre": Range(-50e3, 500e3, 1e-3, "N/mm", _EDGE),
    "Kae": Range(-100e3, 500e3, 1e-3, "N/mm", _EDGE),
    "moving_mass": Range(0.1, 1e5, 1.0, "kg", "slides weigh 0.1 kg (micro mills) to 50 t (portals)"),
    "tip_mass": Range(0.01, 1e5, 1.0, "kg", "a tool weighs some 10 g, a ram some 10 t"),
    "stiffness": Range(1e4, 1e10, 1e-6, "N/um", "tool tips and feed drives have 0.1 to 1000 N/um"),
}
"""Parameter -> range that occurs in the field."""

_MOST_RATIO = 3.0
"""Radial or axial over tangential coefficient that no edge reaches: friction and rake angle allow 0.1 to 1."""


def implausible(values: Mapping[str, float]) -> list[str]:
    """Return a sentence for each value that lies outside of `RANGES`.

    Parameters
    ----------
    values : mapping of str to float
        Parameter -> value in SI; names that are not in `RANGES` are passed over.
    """
    out = []
    for name, value in values.items():
        limits = RANGES.get(name)
        if limits is not None and not limits.low <= value <= limits.high:
            ends = f"{limits.low * limits.shown:.3g} to {limits.high * limits.shown:.3g} {limits.unit}"
            out.append(f"{name} is {value * limits.shown:.3g} {limits.unit}, outside of {ends} ({limits.source})")
    tangential = values.get("Ktc", 0.0)
    for name in ("Krc", "Kac"):
        if tangential > 0.0 and abs(values.get(name, 0.0)) > _MOST_RATIO * tangential:
            out.append(
                f"{name} is {values[name] / tangential:.3g} times Ktc; no edge has more than {_MOST_RATIO:g} (friction "
                "and rake angle allow 0.1 to 1)"
            )
    return out


FASTEST_FEED = 10.0
"""Feed [m/s] that no machine tool reaches: linear motors move at 4 m/s."""

LARGEST_TOOL = 5.0
"""Diameter [m] that no milling tool has."""


def check_feed(feed: float) -> None:
    """Refuse a feed that was given in mm/min where m/s is meant.

    Parameters
    ----------
    feed : float
        [m/s].

    Raises
    ------
    InputError
        Above `FASTEST_FEED`.
    """
    if abs(feed) > FASTEST_FEED:
        raise InputError(
            f"a feed of {feed:g} m/s is beyond any machine tool ({FASTEST_FEED:g} m/s); feeds are in m/s, so that "
            f"{feed:g} mm/min are {feed / 6e4:.4g}"
        )


def check_diameter(diameter: float) -> None:
    """Refuse a tool diameter that was given in mm where m is meant.

    Parameters
    ----------
    diameter : float
        [m].

    Raises
    ------
    InputError
        Above `LARGEST_TOOL`.
    """
    if diameter > LARGEST_TOOL:
        raise InputError(
            f"the tool diameter is {diameter:g} m, larger than any milling tool ({LARGEST_TOOL:g} m); lengths are in "
            f"m, so that {diameter:g} mm are {diameter / 1e3:g}"
        )


def displacement_over_acceleration(frequency: ArrayLike) -> Real:
    """Return ``-1/w^2`` [s2], the factor from acceleration to displacement for ``exp(+j w t)``.

    At 0 Hz, where an acceleration says nothing about a displacement, the factor is NaN.
    """
    w = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    with np.errstate(divide="ignore"):
        return np.where(w > 0.0, -1.0 / np.where(w > 0.0, w, 1.0) ** 2, np.nan)
