"""Sidebands of a chatter line: regeneration in an interrupted cut repeats it one spindle order apart.

A cut that changes with the turn puts lines at ``f_c + k n`` and their mirror images ``k n - f_c``, n being the spindle
frequency. The *sideband rule* (`verdict_rules`) calls a steady line with two sidebands or more chatter from 0.4 of the
threshold on: nothing else puts lines one spindle order apart there.
"""

from __future__ import annotations

import numpy as np

from process.types import Real
from stability.chatter.rules import RULES
from stability.chatter.spindle_speed import windows


def sideband_lines(
    frequency: Real, peaks: Real, line: float, base: float, reach: float, least: float
) -> tuple[tuple[float, float], ...]:
    """Return amplitude and frequency [Hz] of the sidebands of a line, rising.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Grid of the spectrum [Hz].
    peaks : ndarray, shape (n,)
        Amplitude at its local maxima that are no harmonics, zero elsewhere.
    line : float
        The line [Hz].
    base : float
        Spindle frequency n [Hz].
    reach : float
        Distance from ``f_c + k n`` or ``k n - f_c`` up to which a peak is taken [Hz].
    least : float
        Least amplitude of a sideband.
    """
    found = set()
    for sign in (1.0, -1.0):
        for expected in np.arange((sign * line) % base, float(frequency[-1]), base):
            near = np.where(np.abs(frequency - expected) <= reach, peaks, 0.0)
            top = int(np.argmax(near))
            if abs(expected - line) > 0.5 * base and near[top] > least:
                found.add((float(near[top]), float(frequency[top])))
    return tuple(sorted(found))


def sideband_coherence(samples: Real, dt: float, base: float, band: tuple[float, float]) -> float:
    """Return the power of the highest group of lines one order apart over the median of all groups [1].

    The spectrum is folded: all lines one spindle order apart, and their mirror images, are one sum, for each place
    between two orders. Windows of `ChatterRules.short_turns` and of the whole; the highest of their medians.

    Parameters
    ----------
    samples : ndarray, shape (n,)
        Samples of one axis.
    dt : float
        Interval [s].
    base : float
        Spindle frequency [Hz].
    band : (float, float)
        Frequencies [Hz].
    """
    turns = samples.size * dt * base
    best = 0.0
    for length in (*(t for t in RULES.short_turns if 2.0 * t < turns), 0.99 * turns):
        _, orders, phasor = windows(samples[None], dt * base, length, 0.25 * length)
        power = np.abs(phasor[0]) ** 2
        inside = (orders >= band[0] / base) & (orders <= band[1] / base)
        places = np.arange(2.25 / length, 0.5, 0.25 / length)
        folded = np.zeros((power.shape[0], places.size))
        for order in range(int(orders[inside][-1]) + 2):
            for sign in (1.0, -1.0):
                bins = np.rint((order + sign * places) / orders[1]).astype(np.int64)
                known = (bins > 0) & (bins < orders.size)
                known[known] &= inside[bins[known]]
                folded[:, known] += power[:, bins[known]]
        if places.size > 3:
            best = max(best, float(np.median(folded.max(axis=1) / np.maximum(np.median(folded, axis=1), 1e-300))))
    return best
