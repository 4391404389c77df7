"""Unequal pitch for one machine and one spindle speed: which angles between the teeth raise the limit most.

Waves that neighbouring teeth leave regenerate chatter in phase when the pitch is equal. A difference dP between pitches
shifts the phase by ``f dP / n`` turns (f chatter frequency, n turns a second): alternating pitches cancel each other
when that is half a turn (Slavicek 1965), a pitch that rises from tooth to tooth by dP when N of them make a whole turn
(Budak 2003)::

    alternating  dP = pi n / f        linear  dP = 2 pi n / (N f)          [rad]

Both hold for one frequency, which the unequal pitch itself moves: from them the difference is searched for the largest
limit by semi-discretisation, at the speed and around it. The averaged equation is of no use here: for a pitch that it
finds excellent the converged limit can be several times lower.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
import pandas as pd

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.types import Real
from stability.methods.semi_discretization import LimitDepth, limit_depth
from stability.problem import Machine, check_spindle_speed
from stability.rules import RULES

CHECK_COLUMNS: tuple[str, ...] = (
    "spindle_speed_rpm",
    "limit_depth_mm",
    "equal_limit_depth_mm",
    "chatter_frequency_Hz",
    "kind",
)
"""Columns of `PitchDesign.check`."""


@dataclass(frozen=True)
class PitchDesign:
    """A tool whose teeth are spaced for one machine and speed.

    Parameters
    ----------
    tool : Tool
        The tool with the best pitch; with equal pitch when nothing better is found.
    pattern : {"alternating", "linear", "equal"}
        Where the pitch comes from.
    gain : float
        Smallest limit depth about the speed over that of equal pitch, both by semi-discretisation.
    check : DataFrame
        Columns `CHECK_COLUMNS`: the limit at the speed and around it, converged.
    """

    tool: Tool
    pattern: str
    gain: float
    check: pd.DataFrame

    @property
    def pitch_angles_deg(self) -> tuple[float, ...]:
        """Angle from each tooth to the next [deg]."""
        lag = np.append(self.tool.tooth_angles(), 2.0 * math.pi)
        return tuple(float(p) for p in np.round(np.degrees(np.diff(lag)), 6))


def alternating(teeth: int, difference: float) -> Real:
    """Return pitch angles [rad] that alternate by a difference; `teeth` is even."""
    return np.asarray(2.0 * math.pi / teeth + 0.5 * difference * (-1.0) ** np.arange(teeth))


def linear(teeth: int, difference: float) -> Real:
    """Return pitch angles [rad] that rise from tooth to tooth by a difference."""
    return np.asarray(2.0 * math.pi / teeth + difference * (np.arange(teeth) - 0.5 * (teeth - 1)))


def cancelling_difference(pattern: str, teeth: int, frequency: float, spindle_speed: float) -> float:
    """Return the difference of pitch [rad] at which the waves of all teeth cancel.

    Parameters
    ----------
    pattern : {"alternating", "linear"}
        Half a turn of phase between neighbours, or a whole turn over all teeth.
    teeth : int
        Number of teeth.
    frequency : float
        Chatter frequency [Hz].
    spindle_speed : float
        Spindle speed [rpm].
    """
    turns = 0.5 if pattern == "alternating" else 1.0 / teeth
    return 2.0 * math.pi * turns * spindle_speed / (60.0 * frequency)


def design_pitch(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: float,
    *,
    frequency: float | None = None,
    around: float = 0.03,
    largest_deviation: float = 0.2,
    progress: Callable[[str, int, int], None] | None = None,
) -> PitchDesign:
    """Return the pitch angles with the largest limit depth at a spindle speed and around it.

    Parameters
    ----------
    machine : Machine
        Anything with a ``state_space()``.
    tool : Tool
        Geometry but for the pitch; at least two teeth, straight edges.
    arc, coefficients
        The cut.
    spindle_speed : float
        Spindle speed [rpm].
    frequency : float, optional
        Frequency of the mode that is to be silenced [Hz]. Default: the chatter frequency with equal pitch.
    around : float, optional
        The limit counts at speeds up to this share beside the speed.
    largest_deviation : float, optional
        How far a pitch may depart from the mean, as a share of it: chip thickness and room for chips depart with it.
    progress : callable, optional
        Called with (what, done, of) before each pitch that is tried.

    Returns
    -------
    PitchDesign
        The best of equal, alternating and linearly rising pitch, ground to 0.1 degrees, verified at five speeds.

    Raises
    ------
    InputError
        For one tooth, a share that is not between 0 and 1, and as `stability.limit_depth`.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    if tool.teeth < 2:
        raise InputError("the tool has one tooth; a pitch can be chosen for two or more")
    for name, share in (("around", around), ("largest_deviation", largest_deviation)):
        if not 0.0 < share < 1.0:
            raise InputError(f"{name} is {share:g}; a share between 0 and 1 is needed, e.g. 0.1")
    search = _Search(machine, replace(tool, pitch_angles=None), arc, coefficients, speed, around)
    if progress is not None:
        search = replace(search, progress=progress)
    limit = search.limit(search.tool, speed)
    chatter = limit.chatter_frequency_Hz if frequency is None else frequency
    best = (search.lowest(search.tool, -math.inf), "equal", search.tool)
    if not (math.isinf(best[0]) or math.isnan(chatter)):
        patterns = _patterns(tool.teeth)
        for number, pattern in enumerate(patterns):
            difference = cancelling_difference(pattern, tool.teeth, chatter, speed)
            best = search.improved(pattern, difference, best, largest_deviation, (number, len(patterns)))
    return _checked(search, *best[1:])


Best: TypeAlias = tuple[float, str, Tool]
"""Smallest limit [mm] about the speed, pattern and tool."""


def _patterns(teeth: int) -> tuple[str, ...]:
    """Return the patterns that differ; two teeth alternate and rise alike, odd numbers cannot alternate."""
    if teeth == 2:
        return ("alternating",)
    return ("linear",) if teeth % 2 else ("alternating", "linear")


def _checked(search: _Search, pattern: str, best: Tool) -> PitchDesign:
    """Verify a tool at all speeds, and compare it with equal pitch."""
    speeds = search.speed * (1.0 + search.around * np.linspace(-1.0, 1.0, 5))
    limits = [search.limit(best, float(n), 1e-3) for n in speeds]
    equal = limits if pattern == "equal" else [search.limit(search.tool, float(n), 1e-3) for n in speeds]
    rows = [
        (n, one.limit_depth_mm, other.limit_depth_mm, one.chatter_frequency_Hz, one.kind)
        for n, one, other in zip(speeds, limits, equal, strict=True)
    ]
    check = pd.DataFrame(rows, columns=list(CHECK_COLUMNS))
    gain = 1.0 if pattern == "equal" else float(check["limit_depth_mm"].min() / check["equal_limit_depth_mm"].min())
    return PitchDesign(best, pattern, gain, check)


@dataclass(frozen=True)
class _Search:
    """What stays the same from one pitch to the next; `tool` has equal pitch."""

    machine: Machine
    tool: Tool
    arc: AnyEngagement
    coefficients: CuttingCoefficients
    speed: float
    around: float
    progress: Callable[[str, int, int], None] = field(default=lambda _what, _done, _of: None)

    def limit(self, tool: Tool, speed: float, tolerance: float = RULES.loose_tolerance) -> LimitDepth:
        """Return the converged limit of a tool."""
        return limit_depth(self.machine, tool, self.arc, self.coefficients, speed, tolerance)

    def lowest(self, tool: Tool, enough: float) -> float:
        """Return the smallest limit [mm] at the speed and the ends of its range, or a first one not above `enough`."""
        found = math.inf
        for share in (0.0, -self.around, self.around):
            found = min(found, self.limit(tool, self.speed * (1.0 + share)).limit_depth_mm)
            if found <= enough:
                return found
        return found

    def improved(
        self, pattern: str, difference: float, best: Best, largest_deviation: float, place: tuple[int, int]
    ) -> Best:
        """Return the better of what there is and the best difference of a pattern; `place`: the how-manieth of all."""
        factor, tried = 1.0, set[Tool]()
        rounds = [[f - 1.0 for f in RULES.factors_tried], *([-step, step] for step in RULES.refined_steps)]
        whole = sum(map(len, rounds))
        done = place[0] * whole
        for offsets in rounds:
            centre = factor
            for offset in offsets:
                self.progress(f"{pattern} pitch", done, place[1] * whole)
                done += 1
                tool = self._pitched(pattern, (centre + offset) * difference, largest_deviation)
                if tool is None or tool in tried:
                    continue
                tried.add(tool)
                found = self.lowest(tool, best[0])
                # A limit without bound is not believed: it is the one result that no map has confirmed.
                if best[0] < found < math.inf:
                    best, factor = (found, pattern, tool), centre + offset
        return best

    def _pitched(self, pattern: str, difference: float, largest_deviation: float) -> Tool | None:
        """Return the tool with pitch angles that can be ground, the last takes up the rest; None when out of bounds."""
        teeth = self.tool.teeth
        pitch = (alternating if pattern == "alternating" else linear)(teeth, difference)
        if np.abs(pitch * teeth / (2.0 * math.pi) - 1.0).max() > largest_deviation + 1e-9:
            return None
        steps = np.round(pitch[:-1] / RULES.ground_angle)
        last = round(2.0 * math.pi / RULES.ground_angle) - steps.sum()
        return replace(self.tool, pitch_angles=tuple(float(k) for k in np.append(steps, last) * RULES.ground_angle))
