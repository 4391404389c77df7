"""Speeds that were stated of a ramp, against the spindle when the cut begins and ends.

Stated is the speed at which the cut begins and that at which it ends, by a control with a clock of its own. The record
shows the speed of the spindle at any time, by its own clock, and the force shows when the cut began: not before the
force rises from its level in the air, and not after it has reached half of its level in the cut. A record without air
begins after the cut. So each end bounds ``r = f_found/f_stated``; both must hold, but where they contradict each other
the statement does not belong to the ends of the cut, and r may be anything between.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import sample_interval
from process.types import Real
from smfe.identification.spectra.spindle_angle import force_angle
from smfe.identification.sweep.comb import piece_in_cut
from smfe.identification.sweep.noise import force_level, in_cut

HOLDS = 3e-3
"""Relative difference to which a spindle holds the speed that it is set to."""

TURNS, SECONDS = 3.0, 0.5
"""The speed is the slope of a parabola through the angle over so many turns, and so long at least."""

ABOVE_AIR, IN_CUT = 0.05, 0.5
"""Shares of the level of the cut between which a force rises: above the air, and surely in the cut."""


OTHER_HARMONICS = (0.25, 1.0 / 3.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""By what a path through the forces alone may be off: it may follow every second tooth, or the second harmonic."""

BY_FORCE = 0.2
"""Relative difference from the stated speeds that is believed where only the forces tell the speed."""

ON_PATH = 1.0
"""Rms from a smooth ramp from which a path through the forces is none [rad of the tooth passing]."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of the speed found over that stated, minus 1; infinite where the record leaves a side open."""

    low: float
    high: float

    @property
    def beyond(self) -> float:
        """What no spindle that holds its speed explains; 0 where nothing is beyond."""
        return max(self.low - HOLDS, 0.0) + min(self.high + HOLDS, 0.0)

    @property
    def middle(self) -> float:
        """Middle of the bounds; the bound where one side is open."""
        finite = [v for v in (self.low, self.high) if math.isfinite(v)]
        return float(np.mean(finite)) if finite else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of anything between the bounds."""
        wide = self.high - self.low
        return float(np.hypot(wide / math.sqrt(12.0) if math.isfinite(wide) else 0.0, 0.25 * HOLDS))


def stated_bounds(record: xr.Dataset, angle: Real, stated: tuple[float, float]) -> Bounds | None:
    """Return the bounds that the ends of the cut set, or None where the forces do not tell a cut.

    Parameters
    ----------
    record : xarray.Dataset
        With force.
    angle : ndarray, shape (n,)
        Of the spindle, in step with the teeth [rad].
    stated : (float, float)
        Spindle rotation where the cut begins and ends [rad/s].
    """
    level, dt = force_level(record), sample_interval(record)
    loud, quiet = float(np.median(level[in_cut(record)])), float(level.min())
    if not loud > 0.0 or not np.isfinite(angle).all():
        return None
    begin = _rise(level, quiet, loud)
    back = _rise(level[::-1], quiet, loud)
    last = level.size - 1
    ends = []
    for (earliest, latest), speed, sign in ((begin, stated[0], 1), (back, stated[1], -1)):
        at = np.linspace(latest if earliest is None else earliest, latest, 7)
        seen = [_speed(angle, round(v) if sign > 0 else last - round(v), dt) / speed - 1.0 for v in at]
        low, high = min(seen), max(seen)
        # What lies outside the record is on the far side of what it shows of the ramp.
        if earliest is None and sign * (stated[1] - stated[0]) > 0.0:
            low = -math.inf
        elif earliest is None:
            high = math.inf
        ends.append((low, high))
    (a, b), (c, d) = ends
    if max(a, c) <= min(b, d):
        return Bounds(max(a, c), min(b, d))
    return Bounds(min(a, c), max(b, d))


def angle_of_ramp(record: xr.Dataset, teeth: int, stated: tuple[float, float]) -> Real | None:
    """Return the angle of the spindle [rad] of a ramp that only the forces tell, or None where they do not.

    Which harmonic the path through the forces follows is taken from the stated speeds.

    Parameters
    ----------
    record : xarray.Dataset
        With force.
    teeth : int
        Of the tool.
    stated : (float, float)
        Spindle rotation where the cut begins and ends [rad/s].
    """
    piece, dt = piece_in_cut(record), sample_interval(record)
    with suppress(InputError):
        path = force_angle(record, teeth)
        margin = round(1.0 / dt)
        if piece is None or piece.stop - piece.start < 4 * margin:
            return None
        inner = slice(piece.start + margin, piece.stop - margin)
        middle = 0.5 * (inner.start + inner.stop)
        reach = 0.5 * (inner.stop - inner.start)
        place = (np.arange(path.size) - middle) / reach
        smooth = np.polyfit(place[inner], path[inner], 3)
        if teeth * np.std(path[inner] - np.polyval(smooth, place[inner])) > ON_PATH:
            return None
        ratio = float(smooth[2]) / (reach * dt) / (0.5 * (stated[0] + stated[1]))
        factor = min(OTHER_HARMONICS, key=lambda q: abs(math.log(max(q * ratio, 1e-9))))
        return np.asarray(factor * np.polyval(smooth, place)) if abs(factor * ratio - 1.0) < BY_FORCE else None
    return None


def _rise(level: Real, quiet: float, loud: float) -> tuple[int | None, int]:
    """Return the earliest and the latest sample at which the cut may begin; no earliest where the record has no air."""
    latest = int(np.argmax(level > IN_CUT * loud))
    below = np.flatnonzero(level[:latest] <= max(1.3 * quiet, quiet + ABOVE_AIR * (loud - quiet)))
    if not below.size or not quiet < IN_CUT * loud:
        return None, latest
    # A rise begins in the noise: as long again before it is seen.
    first = int(below[-1]) + 1
    return max(2 * first - latest, 0), latest


def _speed(angle: Real, at: int, dt: float) -> float:
    """Return the rotation [rad/s] at a sample."""
    mean = (angle[-1] - angle[0]) / (dt * (angle.size - 1))
    half = round(0.5 * max(SECONDS, 2.0 * math.pi * TURNS / max(mean, 1e-9)) / dt)
    piece = slice(max(at - half, 0), min(at + half + 1, angle.size))
    time = dt * (np.arange(piece.start, piece.stop) - at)
    return float(np.polyfit(time, angle[piece], 2)[1])
