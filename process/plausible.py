"""Values that no machine tool has: field units given where SI is meant would else pass without a word."""

from __future__ import annotations

from process.errors import InputError

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
