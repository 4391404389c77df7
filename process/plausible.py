"""Values that no machine tool has: field units given where SI is meant would else pass without a word."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from process.errors import InputError


@dataclass(frozen=True)
class Range:
    """What a parameter of the field may be, wide: outside of it is a mistake and not a rare machine.

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
"""Parameter -> what the field knows of it."""

_MOST_RATIO = 3.0
"""Radial or axial over tangential coefficient that no edge reaches: friction and rake angle allow 0.1 to 1."""


def implausible(values: Mapping[str, float]) -> list[str]:
    """Return a sentence for each value that lies outside of what the field knows.

    Parameters
    ----------
    values : mapping of str to float
        Parameter -> value in SI; names that are not in `RANGES` are passed over.
    """
    out = []
    for name, value in values.items():
        known = RANGES.get(name)
        if known is not None and not known.low <= value <= known.high:
            ends = f"{known.low * known.shown:.3g} to {known.high * known.shown:.3g} {known.unit}"
            out.append(f"{name} is {value * known.shown:.3g} {known.unit}, outside of {ends} ({known.source})")
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
