"""What a lobe diagram holds, whoever draws it: the shaded source, its safe curve, the recommended cut, labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from process.types import Real
from smfe.reporting.content.results import Lobes
from smfe.reporting.content.style import number, spoken
from smfe.reporting.figures import figure_data

SAFE = "safe depth"
"""What the safe curve is called."""

KICKED = "limit after a kick"
"""What the lower limit of an operating point is called."""

LONGEST_NAME = 19
"""A longer one is cut off at the end of its line; the legend has it whole."""

_COLUMNS, _ROWS = 1200, 600
"""Points of a screen that a curve is thinned to."""


@dataclass(frozen=True)
class Diagram:
    """A lobe diagram before anybody draws it.

    Parameters
    ----------
    lobes : sequence of Lobes
        Every source.
    main : Lobes
        The source whose answer is given: shaded, with its safe curve.
    safe : (ndarray, ndarray) or None
        Spindle speed [rpm] and safe depth [mm] of this source, NaN where it is not known.
    floor : ndarray
        Depth over the speeds of `main` below which the cut is called stable [mm]: safe depth, else limit.
    limit : ndarray
        Limit depth over the same speeds [mm], the top of the diagram where there is none.
    point : (float, float, str) or None
        Speed [rpm] and depth [mm] to be marked, and what is written there.
    span : (float, float)
        Ends of the axis of speeds [rpm].
    top : float
        End of the axis of depths [mm].
    """

    lobes: Sequence[Lobes]
    main: Lobes
    safe: tuple[Real, Real] | None
    floor: Real
    limit: Real
    point: tuple[float, float, str] | None
    span: tuple[float, float]
    top: float

    @property
    def single(self) -> bool:
        """Whether the speeds were named one by one: nothing is said between two of them."""
        return self.speed.size < 2 or bool(self.main.data.attrs.get("single_speeds", 0))

    @property
    def width(self) -> float:
        """Width of a bar at one of single speeds [rpm]."""
        near = np.diff(self.speed).min(initial=np.inf)
        return float(0.6 * min(near, 0.12 * (self.span[1] - self.span[0])))

    @property
    def speed(self) -> Real:
        """Spindle speeds of `main` [rpm]."""
        return np.asarray(self.main.data["spindle_speed"].values, dtype=float)

    def ends(self, room: float) -> list[tuple[str, str, float, float]]:
        """Return (source, text, depth where its line ends, depth of its label) of each line [mm], lowest first.

        Parameters
        ----------
        room : float
            Least distance of two labels as a share of the height.
        """
        if self.single:
            return []
        # Of more lines than there is room for, the one that decides is named.
        named = self.lobes if room * len(self.lobes) < 1.0 else [self.main]
        found = [(item.source, spoken(item.source), _last(item.values("limit_depth"), self.top)) for item in named]
        if self.safe is not None:
            found.append((self.main.source, SAFE, _last(self.safe[1], self.top)))
        found.sort(key=lambda end: end[2])
        places = spread([end[2] / self.top for end in found], room)
        return [(*end, self.top * place) for end, place in zip(found, places, strict=True)]

    def places(self, tests: pd.DataFrame | None) -> dict[str, tuple[float, float]]:
        """Return where "stable" and "chatter" are written: where there is most room in each region [rpm, mm]."""
        if self.single:
            return {}
        marks = [] if tests is None else list(zip(tests["spindle_speed_rpm"], tests["depth_of_cut_mm"], strict=True))
        marks += [self.point[:2]] if self.point else []
        zero = np.zeros_like(self.floor)
        regions = {"stable": (zero, self.floor), "chatter": (self.limit, np.full_like(self.limit, self.top))}
        return {word: place for word, ends in regions.items() if (place := self._roomiest(*ends, marks)) is not None}

    def _roomiest(self, low: Real, high: Real, marks: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
        first, last = self.span
        width = max(last - first, 1e-9)
        x = (self.speed - first) / width
        half = 0.07
        best, place = 0.05, None
        for at in np.linspace(0.1, 0.85, 31):
            near = np.abs(x - at) <= half
            if not near.any():
                continue
            bottom, ceiling = float(low[near].max()) / self.top, float(high[near].min()) / self.top
            middle = 0.5 * (bottom + ceiling)
            clear = [np.hypot((n - first) / width - at, 0.6 * (a / self.top - middle)) for n, a in marks]
            room = min([0.5 * (ceiling - bottom), *(float(c) for c in clear)])
            if room > best + 1e-9:
                best, place = room, (first + at * width, self.top * middle)
        return place


def diagram(lobes: Sequence[Lobes], tests: pd.DataFrame | None, advice: Mapping[str, Any] | None) -> Diagram:
    """Return what a diagram holds.

    Parameters
    ----------
    lobes : sequence of Lobes
        The sources of one request.
    tests : pandas.DataFrame or None
        Its cutting tests.
    advice : mapping or None
        Its recommendation.
    """
    advice = advice or {}
    main = next((item for item in lobes if item.source == advice.get("source")), lobes[0])
    depth = advice.get("depth_of_cut_mm")
    limit_only = depth is None
    depth = advice.get("limit_depth_mm") if limit_only else depth
    speed = advice.get("spindle_speed_rpm")
    point = None
    if speed is not None and depth is not None:
        text = f"{number(speed)} rpm, {number(depth, 3 if limit_only else 4)} mm"
        point = (float(speed), float(depth), f"limit: {text}" if limit_only else text)
    top = figure_data.highest_depth(lobes, tests)
    if point is not None:
        top = max(top, 1.12 * point[1])
    limit = np.minimum(np.nan_to_num(main.values("limit_depth"), nan=top, posinf=top), top)
    # Where a cutting test has refuted the safe depth, or nobody knows it, none is drawn.
    safe = None if advice and advice.get("status") != "recommended" else _safe(main)
    lower = main.lower()
    floor = limit if lower is None else np.fmin(limit, lower)
    if safe is not None:
        floor = np.minimum(np.interp(main.data["spindle_speed"].values, *_known(safe)), limit)
    first, last = figure_data.speed_range(lobes)
    if first == last or main.data.attrs.get("single_speeds", 0):
        margin = 0.08 * (last - first) or 0.1 * first
        first, last = first - margin, last + margin
    return Diagram(lobes, main, safe, floor, limit, point, (first, last), top)


def _safe(main: Lobes) -> tuple[Real, Real] | None:
    if "safe_depth_mm" not in main.table:
        return None
    speed, depth = (main.table[name].to_numpy(dtype=float) for name in ("spindle_speed_rpm", "safe_depth_mm"))
    return (speed, depth) if np.isfinite(depth).any() else None


def _known(curve: tuple[Real, Real]) -> tuple[Real, Real]:
    known = np.isfinite(curve[1])
    return curve[0][known], curve[1][known]


def _last(depth: Real, top: float) -> float:
    known = depth[np.isfinite(depth)]
    return float(min(known[-1], top)) if known.size else top


def spread(places: Sequence[float], room: float) -> list[float]:
    """Return rising places between 0 and 1, moved as little as needed so that two are `room` apart."""
    room = min(room, 1.0 / max(len(places), 1))
    out: list[float] = []
    for place in places:
        out.append(max(place, out[-1] + room) if out else max(place, 0.5 * room))
    ceiling = 1.0 - 0.5 * room
    for at in range(len(out) - 1, -1, -1):
        out[at] = min(out[at], ceiling)
        ceiling = out[at] - room
    return out


def advice_name(text: str) -> str:
    """Return what the legend calls the marked point."""
    return "limit, no safe depth known" if text.startswith("limit") else "recommended cut"


def single_lobes(item: Lobes, span: tuple[float, float], top: float) -> tuple[Real, Real] | None:
    """Return speed [rpm] and depth [mm] of the single lobes, no more points than a screen shows, NaN between two."""
    curves = item.curves()
    if curves is None:
        return None
    speed, depth = curves[0], curves[1]
    shown = (speed >= span[0]) & (speed <= span[1]) & (depth <= 1.2 * top)
    # What is not shown is a gap, and one NaN makes a gap.
    depth = np.where(shown, depth, np.nan)
    gap = ~np.isfinite(depth)
    column = np.where(gap, -1.0, np.round((speed - span[0]) / max(span[1] - span[0], 1e-9) * _COLUMNS))
    row = np.where(gap, -1.0, np.round(np.nan_to_num(depth) / top * _ROWS))
    kept = np.concatenate([[True], (np.diff(column) != 0.0) | (np.diff(row) != 0.0)])
    # The end of a run stays, too.
    kept |= np.concatenate([gap[1:] & ~gap[:-1], [not gap[-1]]])
    return np.where(gap, np.nan, speed)[kept], depth[kept]
