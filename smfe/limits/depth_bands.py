"""All bands of depth of a cut, stable and unstable, islands included, over the spindle speeds of a request.

`stability.stability_bands` finds every crossing of the unit circle up to a depth, and the largest Floquet multiplier in
the middle of each band says what it is. Above the first loss of stability a cut may be stable again: a band of that
kind is an island of stability where it is closed from above; an unstable band below a stable one is an island of
chatter.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.types import Real
from smfe.limits.source_modes import AskedCut
from smfe.progress import Progress
from stability import stability_bands

MOST_SPEEDS = 201
"""Speeds at which bands are sought; a finer range is thinned to it."""

FIRST, LOST, AGAIN = "stable", "chatter", "stable again"
"""What a band is: below the first loss of stability, unstable, or stable above an unstable one."""

_UNITS = {
    "spindle_speed_rpm": "rpm",
    "from_mm": "mm",
    "to_mm": "mm",
    "chatter_frequency_Hz": "Hz",
    "multiplier": "1",
}

COLUMNS = ("spindle_speed_rpm", "from_mm", "to_mm", "band", "kind", "chatter_frequency_Hz", "multiplier")
"""Columns of the bands of one source."""

_PREFIX = "band_"


def bands_over(asked: AskedCut, speeds: Real, deepest: float, progress: Progress) -> tuple[pd.DataFrame, list[str]]:
    """Return all bands of depth over spindle speeds, and what could not be had.

    Parameters
    ----------
    asked : AskedCut
        The cut and the modes.
    speeds : ndarray, shape (speeds,)
        Spindle speeds [rpm], rising; at most `MOST_SPEEDS` of them are looked at.
    deepest : float
        Depth at which the last band ends [m].
    progress : callable
        Called with (what, done, of).

    Returns
    -------
    bands : DataFrame
        Columns `COLUMNS`, by speed and from zero up; ``kind`` and ``chatter_frequency_Hz`` belong to the lower border.
    notes : list of str
        Speeds without bands, and why.

    Raises
    ------
    InputError
        When there are bands at no speed.
    """
    at = np.unique(np.linspace(0, speeds.size - 1, min(speeds.size, MOST_SPEEDS)).round().astype(int))
    frames, failed = [], list[tuple[float, str]]()
    for done, speed in enumerate(speeds[at]):
        progress("bands of depth", done, at.size)
        try:
            cut, worn = (asked.tool, asked.arc, asked.coefficients), asked.request.process_damping
            frame = stability_bands(asked.modes, *cut, float(speed), deepest, process_damping=worn)
        except InputError as error:
            failed.append((float(speed), str(error)))
            continue
        first = (~frame["stable"].to_numpy()).cumsum() == 0
        frame["band"] = np.where(first, FIRST, np.where(frame["stable"], AGAIN, LOST))
        frame.insert(0, "spindle_speed_rpm", float(speed))
        frames.append(frame[list(COLUMNS)])
    if not frames:
        raise InputError(f"no bands of depth: {failed[0][1]}")
    notes = []
    if failed:
        notes.append(f"{len(failed)} of {at.size} spindle speeds have no bands, {failed[0][0]:g} rpm: {failed[0][1]}")
    return pd.concat(frames, ignore_index=True), notes


def packed(bands: pd.DataFrame) -> dict[Hashable, Any]:
    """Return bands as variables ``band_*(band)`` of the dataset of lobes."""
    return {
        f"{_PREFIX}{name}": ("band", bands[name].to_numpy(), {"units": _UNITS[name]} if name in _UNITS else {})
        for name in COLUMNS
    }


def unpacked(lobes: xr.Dataset) -> pd.DataFrame | None:
    """Return the bands in a dataset of lobes, None where it has none."""
    if f"{_PREFIX}from_mm" not in lobes:
        return None
    return pd.DataFrame({name: lobes[f"{_PREFIX}{name}"].values for name in COLUMNS})


def islands_said(bands: pd.DataFrame) -> str:
    """Return in words where a cut is stable again above its first loss of stability."""
    again = bands[bands["band"] == AGAIN]
    deepest = bands["to_mm"].max()
    if again.empty:
        return f"chatter from the limit on, at every speed, up to {deepest:.3g} mm"
    speed = again["spindle_speed_rpm"]
    return (
        f"stable again above the limit at {speed.nunique()} of {bands['spindle_speed_rpm'].nunique()} speeds, "
        f"{speed.min():g} to {speed.max():g} rpm, {again['from_mm'].min():.3g} to {again['to_mm'].max():.3g} mm deep"
    )
