"""A low-pass that differentiates: the Gaussian-windowed sinc, whose response is known in closed form.

``g(t) = sin(2 pi fc t)/(pi t) exp(-(pi w t)^2)``, ``G(f) = [erf((f + fc)/w) - erf((f - fc)/w)]/2``, ``w = fc/8``.

It has no phase, is flat to 1.2e-5 up to 5/8 of fc and is 1/2 at fc. Its analytic derivatives differentiate a record
within its band.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import signal

from process.types import Real

_ROLL = 8.0
"""Cutoff over the width w of the Gaussian window."""

_REACH = 1.25
"""Half width of the kernel in units of 1/w."""


def half_width(cutoff: float) -> float:
    """Return the time [s] beyond which the kernel of a cutoff [Hz] is less than 2e-7 of its top."""
    return _REACH * _ROLL / cutoff


def kernel(time: Real, cutoff: float, order: int = 0) -> Real:
    """Return the kernel [1/s] at times [s] of any shape, or its derivative of order 1 or 2 [1/s^(1 + order)]."""
    b, c = 2.0 * math.pi * cutoff, math.pi * cutoff / _ROLL
    zero = np.abs(time) < 1e-6 / cutoff
    t = np.where(zero, 1.0, time)
    sine = np.where(zero, b / math.pi, np.sin(b * t) / (math.pi * t))
    window = np.exp(-np.square(c * time))
    if order == 0:
        return np.asarray(sine * window)
    slope = np.where(zero, 0.0, (b * np.cos(b * t) / math.pi - sine) / t)
    if order == 1:
        return np.asarray((slope - 2.0 * c * c * time * sine) * window)
    bend = np.where(zero, -(b**3) / (3.0 * math.pi), -b * b * sine - 2.0 * slope / t)
    curvature = bend - 4.0 * c * c * time * slope + (4.0 * c**4 * np.square(time) - 2.0 * c * c) * sine
    return np.asarray(curvature * window)


def filtered(samples: Real, step: float, cutoff: float, order: int = 0) -> Real:
    """Return a record low-passed and differentiated `order` times; `half_width` of either end is not valid.

    Parameters
    ----------
    samples : ndarray, shape (n,)
        Record.
    step : float
        Sample interval [s].
    cutoff : float
        Cutoff of the kernel [Hz].
    order : {0, 1, 2}, optional
        Derivative.
    """
    reach = math.ceil(half_width(cutoff) / step)
    times = step * np.arange(-reach, reach + 1, dtype=np.float64)
    padded = np.pad(samples, reach, mode="edge")
    return np.asarray(signal.oaconvolve(padded, step * kernel(times, cutoff, order), mode="valid"))
