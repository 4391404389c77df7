"""The unequal pitch for the cut of a campaign: the design, and its limits beside those of equal pitch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from process.cut.tool import Tool
from process.errors import InputError
from process.types import Real
from smfe.limits.source_modes import AskedCut
from smfe.progress import Progress, part
from stability import PitchDesign, design_pitch, semi_discretization

MOST_SPEEDS = 81
"""Speeds of the curves; a finer range is thinned to it."""

_AT_ONCE = 12
"""Speeds between two words of progress."""

COLUMNS = (
    "spindle_speed_rpm",
    "limit_depth_mm",
    "equal_limit_depth_mm",
    "gain",
    "chatter_frequency_Hz",
    "equal_chatter_frequency_Hz",
    "kind",
    "verified",
)
"""Columns of pitch.csv."""


@dataclass(frozen=True)
class Pitch:
    """An unequal pitch for the cut of a campaign.

    Parameters
    ----------
    asked : AskedCut
        The cut and the modes.
    spindle_speed : float
        The speed of interest [rpm].
    around : float
        Share of the speed on both sides within which the design counts.
    design : PitchDesign
        The tool, its gain and the five speeds at which it was verified.
    table : pandas.DataFrame
        Columns `COLUMNS`: both limits over the speeds of the request and about the speed of interest, converged by
        semi-discretisation. ``verified`` is 1 at the five speeds of the design.
    notes : tuple of str
        What must be known of it.
    """

    asked: AskedCut
    spindle_speed: float
    around: float
    design: PitchDesign
    table: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def least_mm(self) -> float:
        """Smallest limit about the speed [mm]."""
        return float(self.design.check["limit_depth_mm"].min())

    @property
    def equal_least_mm(self) -> float:
        """The same with equal pitch [mm]."""
        return float(self.design.check["equal_limit_depth_mm"].min())

    @property
    def largest_chip(self) -> float:
        """Feed of the tooth with the widest pitch, over the mean feed per tooth: ``psi_max N/(2 pi)``."""
        return max(self.design.pitch_angles_deg) * self.design.tool.teeth / 360.0

    def line(self) -> str:
        """Return the key of ``[tool]``, to paste."""
        angles = ", ".join(f'"{a:.1f} deg"' for a in self.design.pitch_angles_deg)
        return f"pitch_angles = [{angles}]"

    def toml(self) -> str:
        """Return a ``[tool]`` that holds the key, with what it was found for."""
        r = self.asked.request
        return (
            f"# {self.design.pattern} pitch for {self.spindle_speed:g} rpm, {r.name}, {self.asked.source}: limit "
            f"{self.least_mm:.3g} mm within {100.0 * self.around:g} % of the speed, {self.equal_least_mm:.3g} mm with "
            f"equal pitch\n[tool]\n{self.line()}\n"
        )


def pitch_of(
    asked: AskedCut,
    spindle_speed: float,
    around: float,
    largest_deviation: float,
    frequency: float | None,
    progress: Progress,
) -> Pitch:
    """Design a pitch, and compare its limits with those of equal pitch over the speeds of the request.

    Parameters
    ----------
    asked : AskedCut
        The cut and the modes.
    spindle_speed : float
        [rpm].
    around, largest_deviation, frequency
        As of `stability.design_pitch`; frequency in Hz.
    progress : callable
        Called with (what, done, of).

    Raises
    ------
    InputError
        As `stability.design_pitch`.
    """
    cut = (asked.arc, asked.coefficients)
    design = design_pitch(
        asked.modes,
        asked.tool,
        *cut,
        spindle_speed,
        frequency=frequency,
        around=around,
        largest_deviation=largest_deviation,
        progress=part(progress, 0.0, 0.6),
    )
    checked = design.check["spindle_speed_rpm"].to_numpy()
    speeds = np.unique(np.concatenate([_thinned(asked.request.spindle_speed), checked]))
    equal, notes = _over(asked, replace(asked.tool, pitch_angles=None), "equal", speeds, part(progress, 0.6, 0.75))
    own, more = _over(asked, design.tool, "", speeds, part(progress, 0.75, 1.0))
    table = own.merge(equal, on="spindle_speed_rpm", how="inner")
    both = np.isfinite(table["limit_depth_mm"]) & np.isfinite(table["equal_limit_depth_mm"])
    table["gain"] = (table["limit_depth_mm"] / table["equal_limit_depth_mm"]).where(both)
    table["verified"] = np.isin(table["spindle_speed_rpm"], checked).astype(int)
    said = [*asked.notes, *dict.fromkeys([*notes, *more])]
    if design.pattern == "equal":
        said.append(
            f"no unequal pitch that departs from equal by {100.0 * largest_deviation:g} % or less is better at "
            f"{spindle_speed:g} rpm: its waves do not cancel there, or the cut has no limit"
        )
    return Pitch(asked, spindle_speed, around, design, table[list(COLUMNS)], tuple(said))


def _thinned(speeds: Real) -> Real:
    """Return at most `MOST_SPEEDS` of some speeds, both ends among them."""
    at = np.unique(np.linspace(0, speeds.size - 1, min(speeds.size, MOST_SPEEDS)).round().astype(int))
    return np.asarray(speeds[at])


def _over(
    asked: AskedCut, tool: Tool, word: str, speeds: Real, progress: Progress
) -> tuple[pd.DataFrame, Sequence[str]]:
    """Return limits over speeds, fastest first: slow ones ask for too many steps, and are left out with a word."""
    prefix = f"{word}_" if word else ""
    frames, notes, down = [], [], speeds[::-1]
    for begin in range(0, down.size, _AT_ONCE):
        some = down[begin : begin + _AT_ONCE]
        progress(f"limits with {word or 'unequal'} pitch", begin, down.size)
        try:
            found = semi_discretization(asked.modes, tool, asked.arc, asked.coefficients, some)
        except InputError as error:
            notes.append(f"no limits at {some[0]:g} rpm and below: {error}")
            break
        data = {
            "spindle_speed_rpm": some,
            f"{prefix}limit_depth_mm": found["limit_depth"].values,
            f"{prefix}chatter_frequency_Hz": found["chatter_frequency"].values,
        }
        frames.append(pd.DataFrame(data if prefix else {**data, "kind": found["kind"].values}))
        notes += [w for w in found.attrs["warnings"] if "spindle speeds have no limit" not in w]
    if not frames:
        raise InputError(notes[-1])
    return pd.concat(frames, ignore_index=True).sort_values("spindle_speed_rpm", ignore_index=True), notes


def settable(speed: float, minimum: float, maximum: float) -> None:
    """Refuse a speed [rpm] that the spindle does not turn at."""
    if not minimum <= speed <= maximum:
        top = "" if math.isinf(maximum) else f" to {maximum:g}"
        raise InputError(f"{speed:g} rpm is not among the speeds of [spindle], {minimum:g}{top} rpm; ask for another")
