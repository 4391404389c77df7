"""Arrays of the page, no more points and bytes than a screen resolves: envelopes, 16 bits a value.

A picture of so many columns shows of the points in one column no more than the first, the last, the lowest and the
highest. So a spectrum keeps the largest amplitude of each column, and no line is lost; a compliance keeps the extremes
of its magnitude, real and imaginary part, and of what is left those points that a straight line between their
neighbours would miss by more than half the width of a line.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real
from smfe.reporting.figures.figure_data import lagging_phase

Index = NDArray[np.intp]

STEPS = 65534
"""Steps between the ends of an array of 16 bits; the code 0 stands for a gap."""

DECADES = 9.0
"""Range of an array of 16 bits over the logarithm: what is smaller becomes the smallest."""


def columns_of(x: Real, span: tuple[float, float], count: int, beyond: int) -> Index:
    """Return the column of each point: `count` within the span of a picture, `beyond` for all that follows it.

    Parameters
    ----------
    x : ndarray
        Rising.
    span : (float, float)
        What is shown first.
    count, beyond : int
        Columns within the span and after it.
    """
    first, last = span
    inside = np.floor((x - first) / max(last - first, 1e-300) * count)
    rest = max(float(x[-1]) - last, 1e-300) if x.size else 1.0
    after = count + np.floor((x - last) / rest * max(beyond, 1))
    return np.where(x < last, np.maximum(inside, -1.0), np.minimum(after, count + max(beyond, 1) - 1)).astype(np.intp)


def largest(columns: Index, y: Real) -> Index:
    """Return the place of the largest value of each column; a column without a known value is left out.

    Parameters
    ----------
    columns : ndarray of int
        Column of each point, rising.
    y : ndarray
        NaN where nothing is known.
    """
    known = np.flatnonzero(np.isfinite(y))
    if not known.size:
        return known
    order = known[np.lexsort((y[known], columns[known]))]
    last = np.flatnonzero(np.diff(columns[order], append=np.iinfo(np.intp).max))
    return np.sort(order[last])


def thinned(
    frequency: Real,
    values: Complex,
    span: tuple[float, float],
    ranges: Sequence[float],
    columns: int,
    also: Sequence[tuple[Real, float]] = (),
) -> Index:
    """Return the places of the points of a compliance that a screen needs to show it.

    Parameters
    ----------
    frequency : ndarray
        [Hz], rising.
    values : ndarray of complex
        NaN where nothing is claimed: one of a run of NaN stays, as a gap.
    span : (float, float)
        Band that is shown first [Hz]. Beyond it the magnitude alone keeps its extremes.
    ranges : (float, float, float)
        Height of the picture as decades of the magnitude, in the unit of the values for the parts, and in degrees.
    columns : int
        Width of the picture in points.
    also : sequence of (ndarray, float), optional
        Curves that belong to it, each with what a straight line may miss of it.
    """
    magnitude = np.abs(values)
    kept = _extremes(frequency, values, magnitude, span, columns)
    # Half a line of 1.5 points in a picture half as high as it is wide.
    share = 0.75 / (0.5 * columns)
    with np.errstate(divide="ignore"):
        level = np.log10(magnitude)
    phase = lagging_phase(values)
    curves = [(level, share * ranges[0]), (values.real, share * ranges[1]), (values.imag, share * ranges[1])]
    curves += [(phase, share * ranges[2]), *also]
    return _bent(frequency, kept, [curve / tolerance for curve, tolerance in curves if tolerance > 0.0])


def _extremes(frequency: Real, values: Complex, magnitude: Real, span: tuple[float, float], columns: int) -> Index:
    """Return the ends and extremes of each column, and what stands beside a gap."""
    at = columns_of(frequency, span, columns, columns)
    edges = np.flatnonzero(np.diff(at))
    shown = frequency <= span[1]
    parts = [np.where(shown, part, np.nan) for part in (values.real, values.imag)]
    curves = [sign * curve for curve in (magnitude, *parts) for sign in (1.0, -1.0)]
    known = np.isfinite(values)
    gap = np.flatnonzero(np.diff(known.astype(int)))
    kept = np.concatenate([*(largest(at, curve) for curve in curves), [0, frequency.size - 1], gap, gap + 1])
    inside = edges[shown[edges]]
    kept = np.unique(np.concatenate([kept, inside, inside + 1])).astype(np.intp)
    # One NaN makes a gap.
    again = ~known[kept[1:]] & ~known[kept[:-1]]
    return np.asarray(np.delete(kept, np.flatnonzero(again) + 1))


def _bent(x: Real, kept: Index, curves: Sequence[Real]) -> Index:
    """Return without the points that lie on a line between their neighbours, all curves in units of what may be missed.

    Each turn looks at every second point and allows half as much as the one before, so that the sum stays below one.
    """
    allowed = 0.5
    while kept.size > 2 and allowed > 1e-3:
        left, middle, right = kept[:-2:2], kept[1:-1:2], kept[2::2]
        part = (x[middle] - x[left]) / (x[right] - x[left])
        on = np.ones(middle.size, dtype=bool)
        for curve in curves:
            with np.errstate(invalid="ignore"):
                on &= np.abs(curve[left] + part * (curve[right] - curve[left]) - curve[middle]) <= allowed
        kept = np.delete(kept, 1 + 2 * np.flatnonzero(on))
        allowed *= 0.5
    return kept


def coded(values: Real, *, logarithmic: bool = False) -> dict[str, Any]:
    """Return an array in 16 bits a value, as report.js reads it; NaN is a gap.

    Parameters
    ----------
    values : ndarray
        Any shape of one dimension.
    logarithmic : bool, optional
        Steps of equal ratio, for values over several decades; what is not positive becomes the smallest step.

    Returns
    -------
    dict
        ``codes`` (base64 of little-endian 16-bit integers, 0 for a gap), ``low``, ``high`` and ``log``.
    """
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    top = float(values[known].max(initial=0.0 if logarithmic else -np.inf)) if known.any() else 0.0
    if logarithmic and top > 0.0:
        floor = 10.0**-DECADES * top
        positive = values[known & (values > floor)]
        low, high = float(positive.min()), top
        scaled = np.log(np.maximum(np.where(known, values, top), low))
        ends = np.log(low), np.log(high)
    else:
        logarithmic = False
        low, high = (float(values[known].min()), top) if known.any() else (0.0, 0.0)
        scaled, ends = np.where(known, values, low), (low, high)
    width = ends[1] - ends[0]
    place = (scaled - ends[0]) / width if width > 0.0 else np.zeros(values.shape)
    codes = np.where(known, 1 + np.round(STEPS * np.clip(place, 0.0, 1.0)), 0).astype("<u2")
    text = base64.b64encode(codes.tobytes()).decode("ascii")
    return {"codes": text, "low": low, "high": high, "log": logarithmic}
