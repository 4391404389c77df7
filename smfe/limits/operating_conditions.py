"""Compliances of several measurements as one, over the feed along the cut and the force that each feed was tried with.

What is stacked must be comparable: one controller and one position (`cut_conditions`), a motion along the cut, and
a level that is the amplitude of a sine. A hit is not: its level is had from its spectrum (`hammer.level`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, Measurement
from smfe.identification.hammer.level import impact_level
from smfe.limits.cut_conditions import ALIKE, Feed, apart, direction_text, feed_of, turned


def over_conditions(
    campaign: Campaign, compliances: Mapping[str, xr.Dataset], direction: float = 0.0
) -> tuple[xr.Dataset, list[str]]:
    """Return compliances measured at several feeds and levels as one.

    Parameters
    ----------
    campaign : Campaign
        With feed and force level (or depth of cut) of each measurement.
    compliances : mapping of str to xarray.Dataset
        Measurement -> compliance, of one controller and position.
    direction : float, optional
        Direction in which the cut is fed, from +x towards +y [rad].

    Returns
    -------
    compliance : xarray.Dataset
        ``compliance(feed, level, frequency, response, excitation)`` in the axes of the cut, ``feed`` [mm/min] along it,
        with the coordinate ``force_level(feed, level)`` [N] (or ``depth_of_cut`` [mm]); without levels where none are
        stated, or known.
    warnings : list of str
        What was assumed.

    Raises
    ------
    InputError
        For a model, a motion across the cut, one condition twice, levels that cannot be compared, or measurements
        without frequencies in common.
    """
    at = {m.name: m for m in campaign.measurements}
    missing = [name for name in compliances if name not in at]
    if missing:
        raise InputError(f"'{missing[0]}' is a model: it belongs to no feed; give measurements for an operating point")
    members = [at[name] for name in compliances]
    feeds, notes = _feeds(members, direction)
    members = [m for m in members if m.name in feeds]
    levels, name, said = _levels(members, feeds, compliances)
    notes += said
    place: dict[float, dict[float, str]] = {}
    for m in members:
        row = place.setdefault(feeds[m.name], {})
        level = levels.get(m.name, math.nan)
        other = next((o for v, o in row.items() if v == level or (math.isnan(v) and math.isnan(level))), None)
        if other is not None:
            at_level = "" if math.isnan(level) else f" and level {level:.4g}"
            raise InputError(
                f"an operating point needs every condition once; '{other}' and '{m.name}' both have the feed "
                f"{feeds[m.name]:g} mm/min{at_level}: leave one out, or give the force_level (depth_of_cut for sweeps) "
                "of all"
            )
        row[level] = m.name
    found = {}
    for m in members:
        found[m.name], why = turned(compliances[m.name], direction) if direction else (compliances[m.name], [])
        notes += why
    grid = _common_grid([found[m.name] for m in members])
    order = sorted(place)
    rows = []
    for feed in order:
        parts = [_on(found[place[feed][v]], grid) for v in sorted(place[feed])]
        rows.append(xr.concat(parts, "level", join="outer", coords="minimal", compat="override"))
    at_feed = xr.DataArray(order, dims="feed", name="feed")
    out = xr.concat(_padded(rows), at_feed, join="outer", coords="minimal", compat="override")
    if name is None:
        return out.isel(level=0).to_dataset(name="compliance"), list(dict.fromkeys(notes))
    table = np.full((len(order), out.sizes["level"]), math.nan)
    for i, feed in enumerate(order):
        table[i, : len(place[feed])] = sorted(place[feed])
    whole = out.assign_coords({name: (("feed", "level"), table)}).to_dataset(name="compliance")
    return whole, list(dict.fromkeys(notes))


def _feeds(members: Sequence[Measurement], direction: float) -> tuple[dict[str, float], list[str]]:
    """Return the feed of each measurement along the cut [mm/min], and what was assumed of it."""
    silent = [m.name for m in members if m.feed is None and all(e.feed is None for e in m.records)]
    if silent and len(silent) < len(members):
        raise InputError(
            f"measurement '{silent[0]}' does not say its feed, and others of this operating point do; add feed = "
            '"0 mm/min" where the axes rest'
        )
    own = {m.name: _feed(m) for m in members}
    across = [
        n for n, f in own.items() if f.direction is not None and ALIKE < apart(f.direction, direction) < math.pi - ALIKE
    ]
    if across:
        moves = own[across[0]].direction
        assert moves is not None
        raise InputError(
            f"measurement '{across[0]}' moves along {direction_text(moves)}, and the cut is fed along "
            f"{direction_text(direction)}; give these [[lobes]] the feed_direction of the motion, and measurements "
            "that move across it [[lobes]] of their own"
        )
    against = {
        n for n, f in own.items() if f.reverse or (f.direction is not None and apart(f.direction, direction) > ALIKE)
    }
    forward = {n: f for n, f in own.items() if n not in against}
    if len(forward) == len(own) or not any(f.speed for f in forward.values()):
        kept, notes = own, []
        if len(forward) < len(own):
            notes = ["all motions are against the feed of the cut: friction is taken as that of the other sense"]
    else:
        kept = forward
        names = ", ".join(n for n in own if n not in forward)
        notes = [f"{names} moved against the feed of the cut and is left out: others moved with it"]
    return {n: round(6e4 * f.speed, 6) for n, f in kept.items()}, notes


def _feed(m: Measurement) -> Feed:
    vectors = {tuple(sorted((e.feed or {}).items())) for e in m.records} or {tuple(sorted((m.feed or {}).items()))}
    if len(vectors) > 1:
        raise InputError(f"the records of '{m.name}' state several feeds; make each a measurement of its own")
    found = feed_of(dict(next(iter(vectors))))
    if found is None:
        moves = ", ".join(f"{axis} {6e4 * v:g}" for axis, v in (m.feed or {}).items())
        raise InputError(
            f"measurement '{m.name}' moves along the tool axis ({moves} mm/min); the feed of a cut lies in the plane "
            "of x and y: leave it out of the operating point"
        )
    return found


def _levels(
    members: Sequence[Measurement], feeds: Mapping[str, float], compliances: Mapping[str, xr.Dataset]
) -> tuple[dict[str, float], str | None, list[str]]:
    """Return the level of each measurement [N or mm], the name of the dimension, and what is to be said about them."""
    if all(m.depth_of_cut is not None for m in members):
        return {m.name: round(1e3 * (m.depth_of_cut or 0.0), 6) for m in members}, "depth_of_cut", []
    several = len({feeds[m.name] for m in members}) < len(members)
    if not several and all(m.force_level is None for m in members):
        return {}, None, []
    levels: dict[str, float] = {}
    notes = []
    for m in members:
        level, why = _level(m, compliances[m.name])
        if level is not None:
            levels[m.name] = level
            notes += why
        elif several:
            raise InputError(f"measurement '{m.name}' {why[0]}; the levels of an operating point must be comparable")
        else:
            notes.append(f"'{m.name}' {why[0]}: the compliance of each feed is taken at any force of the cut")
    return (levels, "force_level", notes) if len(levels) == len(members) else ({}, None, notes)


def _level(m: Measurement, compliance: xr.Dataset) -> tuple[float | None, list[str]]:
    """Return the level as the amplitude of a sine [N] with what was assumed, or None and why there is none."""
    if m.method == "hammer":
        found = impact_level(compliance)
        if found is None and "force_spectrum" not in compliance:
            return None, [
                "holds no spectrum of its hits, without which their level is not that of a sine: identify again"
            ]
        if found is None:
            return None, ["has no clear mode, without which the level of its hits is not that of a sine"]
        stated = "" if m.force_level is None else f" of {m.force_level:g} N"
        text = (
            f"the hits{stated} of '{m.name}' count as a sine of {found.force:.3g} N: at {found.frequency:.4g} Hz and "
            f"{100.0 * found.damping:.3g} % damping it moves the mode alike"
        )
        if found.highest > 1.5 * found.lowest:
            text += f" (other modes: {found.lowest:.3g} to {found.highest:.3g} N)"
        return float(f"{found.force:.4g}"), [text]
    if m.period is not None or "broadband" in compliance.attrs:
        return None, ["is excited at all frequencies at once, which has no amplitude of a sine"]
    if m.force_level is None:
        return None, ["states no force_level"]
    sine = "its first tooth passing harmonic" if m.method == "sweep" else "a sine"
    assumed = f"the force_level of '{m.name}' is taken as the amplitude of {sine}"
    return float(m.force_level), [] if m.method == "actuator" else [assumed]


def _padded(rows: Sequence[xr.DataArray]) -> list[xr.DataArray]:
    most = max(row.sizes["level"] for row in rows)
    return [row.pad(level=(0, most - row.sizes["level"])) for row in rows]


def _common_grid(compliances: Sequence[xr.Dataset]) -> np.ndarray:
    """Return the frequencies of the finest compliance within the range of all [Hz]."""
    grids = [c["frequency"].values for c in compliances]
    low, high = max(g[0] for g in grids), min(g[-1] for g in grids)
    finest = min(grids, key=lambda g: float(np.median(np.diff(g))))
    grid = finest[(finest >= low) & (finest <= high)]
    if grid.size < 2:
        raise InputError(f"the measurements share no frequencies: {low:g} Hz is above {high:g} Hz")
    return np.asarray(grid)


def _on(compliance: xr.Dataset, grid: np.ndarray) -> xr.DataArray:
    if np.array_equal(compliance["frequency"].values, grid):
        return compliance["compliance"]
    return compliance["compliance"].interp(frequency=grid)
