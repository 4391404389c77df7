"""The spindle speed from the lines of a record alone: the spacing of its harmonics.

A cut has lines at the multiples of the tooth passing frequency, run-out adds lines at the multiples of the spindle
frequency, and chatter comes with sidebands spaced alike. The fundamental f is the one whose multiples explain the most
lines with the fewest orders: it maximises ``sum_k gain(k f) / sqrt(K)``, K orders up to the highest line. Half of it
would need twice as many orders, twice of it explains half of the lines.

Whether f is the spindle or the tooth passing frequency shows in the heights: with run-out, order Z stands out among its
neighbours; without, the multiples of f are tooth harmonics and the first is one of the highest. Where neither is clear,
nothing is returned.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from stability.line_spectrum import STANDS_OUT, LineSpectrum

CLEAR = 1.5
"""How much higher a line must stand than another to be called the higher one [1]."""

FEWEST_LINES = 3
"""Lines that make a comb."""

_STEPS_A_BIN = 4
_MOST_ORDERS = 200


def spindle_from_lines(spectrum: LineSpectrum, teeth: int, bounds: tuple[float, float]) -> float | None:
    """Return the spindle frequency that the lines of a spectrum give away.

    Parameters
    ----------
    spectrum : LineSpectrum
        Of the cut.
    teeth : int
        Number of teeth Z.
    bounds : (float, float)
        Spindle frequency from, to [Hz].

    Returns
    -------
    float or None
        [Hz]; None where the lines form no comb, or leave open whether it is that of the spindle or of the teeth.
    """
    amplitude = spectrum.vector_amplitude
    power = amplitude**2
    floor = max(STANDS_OUT**2 * float(np.median(power)), float(power.max()) * 1e-8, float(np.finfo(float).tiny))
    gain = np.maximum(np.log(np.maximum(power, floor) / floor), 0.0)
    fundamental = _fundamental(spectrum, gain, bounds[0], bounds[1] * teeth)
    if fundamental is None:
        return None
    return _spindle(spectrum, amplitude, math.sqrt(floor), fundamental, teeth, bounds)


def _fundamental(spectrum: LineSpectrum, gain: NDArray[np.float64], low: float, high: float) -> float | None:
    """Return the spacing [Hz] of the comb that explains the lines best, from low to high."""
    grid = spectrum.frequency
    step = float(grid[1] - grid[0])
    top = float(grid[np.flatnonzero(gain > 0.0)[-1]]) if gain.any() else 0.0
    low, high = max(low, 4.0 * spectrum.resolution), min(high, top)
    if not low < high:
        return None
    ratio = 1.0 + spectrum.resolution / (_STEPS_A_BIN * top)
    candidates = low * ratio ** np.arange(int(math.log(high / low) / math.log(ratio)) + 1)
    # A line is taken within half a bin, so that the steps between candidates lose none.
    wide = ndimage.maximum_filter1d(gain, 2 * math.ceil(0.5 * spectrum.resolution / step) + 1)
    orders = np.minimum(np.floor(top / candidates + 1e-9), _MOST_ORDERS)
    score, lines = np.zeros(candidates.size), np.zeros(candidates.size)
    for k in range(1, int(orders[0]) + 1):
        reach = int(np.searchsorted(-orders, -k, side="right"))
        place = np.rint((k * candidates[:reach] - grid[0]) / step).astype(int)
        found = np.where(place >= 0, wide[np.clip(place, 0, grid.size - 1)], 0.0)
        score[:reach] += found
        lines[:reach] += found > 0.0
    score = np.where(lines >= FEWEST_LINES, score / np.sqrt(orders), 0.0)
    best = int(np.argmax(score))
    return float(candidates[best]) if score[best] > 0.0 else None


def _spindle(
    spectrum: LineSpectrum,
    amplitude: NDArray[np.float64],
    floor: float,
    fundamental: float,
    teeth: int,
    bounds: tuple[float, float],
) -> float | None:
    """Return the spindle frequency: the spacing itself, or the part that one tooth has of it."""
    if teeth == 1:
        return fundamental if bounds[0] <= fundamental <= bounds[1] else None
    heights = np.array([_height(spectrum, amplitude, k * fundamental) for k in range(1, 2 * teeth + 1)])
    heights = np.where(heights > floor, heights, 0.0)
    at_tooth = heights[teeth - 1 :: teeth].max()
    others = np.delete(heights, [teeth - 1, 2 * teeth - 1]).max()
    spindle = at_tooth > CLEAR * others and bounds[0] <= fundamental <= bounds[1]
    teeth_only = others > CLEAR * at_tooth and bounds[0] <= fundamental / teeth <= bounds[1]
    if spindle == teeth_only:
        return None
    return fundamental if spindle else fundamental / teeth


def _height(spectrum: LineSpectrum, amplitude: NDArray[np.float64], frequency: float) -> float:
    """Amplitude within a bin of a frequency; 0 beyond the spectrum."""
    if not spectrum.frequency[0] <= frequency <= spectrum.frequency[-1]:
        return 0.0
    return float(amplitude[spectrum.near(frequency, spectrum.resolution)].max())
