"""Where along the tool's turn the teeth are in the work."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from process.errors import InputError

Cut = Literal["down", "up", "central"]
CUTS: tuple[str, ...] = ("down", "up", "central")


@dataclass(frozen=True)
class Engagement:
    """One arc of engagement; tooth angles from +y towards +x.

    Parameters
    ----------
    entry, exit : float
        Tooth angle at entry and at exit [rad], ``0 <= entry < exit <= pi``.

    Raises
    ------
    InputError
        When the arc is empty or leaves the half in which the tool advances.
    """

    entry: float
    exit: float

    def __post_init__(self) -> None:
        """Refuse an empty arc."""
        if not -1e-9 <= self.entry < self.exit <= math.pi + 1e-9:
            raise InputError(
                f"engagement from {math.degrees(self.entry):g} to {math.degrees(self.exit):g} deg; "
                "0 <= entry < exit <= 180 deg is needed"
            )

    @property
    def arc(self) -> float:
        """Angle in the work [rad]."""
        return self.exit - self.entry


def engagement(cut: str, width_of_cut: float, diameter: float) -> Engagement:
    """Return the engagement of a cut.

    up: ``0 .. acos(1 - 2 a_e/D)``; down: ``pi - acos(1 - 2 a_e/D) .. pi``;
    central: ``pi/2 -+ asin(a_e/D)``. A width equal to the diameter is a slot, 0 to pi, for all three.

    Parameters
    ----------
    cut : {"down", "up", "central"}
        Kind of cut.
    width_of_cut : float
        Radial width a_e [m].
    diameter : float
        Tool diameter D [m].

    Raises
    ------
    InputError
        For an unknown cut, or a width that is not in (0, D].
    """
    if cut not in CUTS:
        raise InputError(f"cut '{cut}' is none of {', '.join(CUTS)}")
    ratio = width_of_cut / diameter
    if not 0.0 < ratio <= 1.0 + 1e-12:
        raise InputError(
            f"a width of cut of {width_of_cut * 1e3:g} mm with a tool of {diameter * 1e3:g} mm; "
            "it must be above zero and at most the diameter"
        )
    ratio = min(ratio, 1.0)
    if cut == "central":
        half = math.asin(ratio)
        return Engagement(math.pi / 2 - half, math.pi / 2 + half)
    arc = math.acos(1.0 - 2.0 * ratio)
    return Engagement(0.0, arc) if cut == "up" else Engagement(math.pi - arc, math.pi)
