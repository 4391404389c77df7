"""Where along the tool's turn the teeth are in the work."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

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
        # Plain numbers: arcs are keys of what is kept.
        object.__setattr__(self, "entry", float(self.entry))
        object.__setattr__(self, "exit", float(self.exit))

    @property
    def arc(self) -> float:
        """Angle in the work [rad]."""
        return self.exit - self.entry

    @property
    def arcs(self) -> tuple[Engagement, ...]:
        """Return this arc alone."""
        return (self,)


@dataclass(frozen=True)
class Engagements:
    """Several arcs of engagement: a tooth leaves the work and comes back within one turn.

    Parameters
    ----------
    arcs : tuple of Engagement
        In rising order, without overlap.

    Raises
    ------
    InputError
        When there is none, or two overlap.
    """

    arcs: tuple[Engagement, ...]

    def __post_init__(self) -> None:
        """Refuse no arc and arcs that overlap."""
        object.__setattr__(self, "arcs", tuple(self.arcs))
        if not self.arcs:
            raise InputError("the cut has no arc of engagement; give at least one")
        for before, after in pairwise(self.arcs):
            if after.entry < before.exit - 1e-12:
                raise InputError(
                    f"an arc of engagement begins at {math.degrees(after.entry):g} deg, before the one ahead of it "
                    f"ends at {math.degrees(before.exit):g} deg; give arcs in rising order that do not overlap"
                )

    @property
    def arc(self) -> float:
        """Angle in the work [rad], all arcs together."""
        return sum(part.arc for part in self.arcs)

    @property
    def entry(self) -> float:
        """Raise `InputError`: one entry needs one arc."""
        raise InputError(f"the cut has {len(self.arcs)} arcs of engagement; one is needed here. {_ONE_ARC}")

    @property
    def exit(self) -> float:
        """Raise `InputError`, as `entry`."""
        return self.entry


_ONE_ARC = "The three stability methods take several; a time simulation takes one arc at a time"

AnyEngagement: TypeAlias = Engagement | Engagements
"""Where the teeth cut: one arc or several."""


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


def engagement_of_offset(width_of_cut: float, offset: float, diameter: float) -> Engagement:
    """Return the engagement of a tool whose axis runs beside the middle of the work, as that of a face mill does.

    The work reaches from ``y = -offset - a_e/2`` to ``-offset + a_e/2``, from the tool axis along +y; a tooth at angle
    ``phi`` is at ``y = D/2 cos phi``. No offset is the central cut; ``(D - a_e)/2`` is the down cut of the same width,
    and the negative of it the up cut.

    Parameters
    ----------
    width_of_cut : float
        Radial width a_e [m].
    offset : float
        How far the tool axis lies from the middle of the work along +y [m]; negative: along -y.
    diameter : float
        Tool diameter D [m].

    Raises
    ------
    InputError
        For a width that is not in (0, D], and for work that reaches beyond the tool: it would not be cut there.
    """
    if not 0.0 < width_of_cut <= diameter * (1.0 + 1e-12):
        return engagement("central", width_of_cut, diameter)
    beyond = abs(offset) + 0.5 * width_of_cut - 0.5 * diameter
    if beyond > 1e-9 * diameter:
        raise InputError(
            f"with an offset of {offset * 1e3:g} mm work of {width_of_cut * 1e3:g} mm reaches {beyond * 1e3:.4g} mm "
            f"beyond the tool of {diameter * 1e3:g} mm; the width of cut is what is cut, and such a cut is "
            f"{'a down' if offset > 0.0 else 'an up'} cut"
        )
    low, high = -offset - 0.5 * width_of_cut, -offset + 0.5 * width_of_cut
    entry, leave = (math.acos(min(1.0, max(-1.0, 2.0 * y / diameter))) for y in (high, low))
    return Engagement(entry, leave)


def width_of(arc: AnyEngagement, diameter: float) -> float:
    """Return the radial width of cut of an engagement [m], all arcs together: ``D/2 sum(cos entry - cos exit)``."""
    return 0.5 * diameter * sum(math.cos(part.entry) - math.cos(part.exit) for part in arc.arcs)


def engagement_of_strips(strips: Sequence[tuple[float, float]], diameter: float) -> AnyEngagement:
    """Return the engagement of a tool that advances over strips of work: a tool over a slot, or between two walls.

    A tooth at angle ``phi`` is at ``y = D/2 cos phi``, normal to the feed: a strip from ``y_1`` to ``y_2`` is cut from
    ``acos(2 y_2/D)`` to ``acos(2 y_1/D)``.

    Parameters
    ----------
    strips : sequence of (float, float)
        Lower and upper edge of each strip of work, from the tool axis along +y [m]; parts beyond the tool are left
        out.
    diameter : float
        Tool diameter D [m].

    Raises
    ------
    InputError
        When no strip lies within the tool's path, or two overlap.
    """
    arcs = []
    for low, high in strips:
        if not low < high:
            raise InputError(f"a strip of work from {low * 1e3:g} to {high * 1e3:g} mm; the lower edge comes first")
        near, far = (math.acos(min(1.0, max(-1.0, 2.0 * y / diameter))) for y in (high, low))
        if far > near:
            arcs.append(Engagement(near, far))
    if not arcs:
        raise InputError(f"no strip of work lies within the path of the tool of {diameter * 1e3:g} mm")
    arcs.sort(key=lambda part: part.entry)
    return arcs[0] if len(arcs) == 1 else Engagements(tuple(arcs))
