"""Frequency and damping of a mode over its level, from the free decay after a hit.

The signal is shifted by the mode's frequency and smoothed with a Gauss window of standard deviation s in time, which
passes ``exp(-(2 pi s df)^2/2)`` of what is df away: what is left is the complex envelope ``A exp(j phi)`` of the one
mode. Over windows of equal length the logarithm of the envelope is a parabola; its slope in the middle is
``-w zeta + j (w - w_0)``, with the standard deviation that the scatter about the parabola gives, of which one value in
``2 sqrt(pi) s`` is independent.

Source: M. Feldman, Non-linear free vibration identification via the Hilbert transform, J. Sound Vib. 208 (1997)
475-489; the Gauss window in place of the Hilbert transform keeps the ends of the record apart from its middle.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.types import Complex, Real

APART = 1e-4
"""Share of a neighbouring mode that the window may pass."""

REACH = 4.5
"""Standard deviations of the Gauss window to either side."""

LEAST_OVER_NOISE = 10.0
"""Amplitude over the noise beside the mode below which a decay is no longer read."""

FEWEST = 4
"""Windows that make a backbone."""


def ring_down(
    signal: ArrayLike,
    sample_rate: float,
    band: tuple[float, float],
    hit: float | None = None,
    window: float | None = None,
) -> xr.Dataset:
    """Return frequency and damping ratio of one mode over the level of its free decay.

    Parameters
    ----------
    signal : array_like, shape (n,)
        Acceleration, velocity or displacement over time; the amplitudes come out in its unit.
    sample_rate : float
        Samples a second [Hz].
    band : tuple of float
        From below to above the mode, with no other mode inside [Hz].
    hit : float, optional
        Time of the hit from the first sample [s]; default: where the signal is largest.
    window : float, optional
        Length of a window [s]; default: four times the reach of the filter to one side.

    Returns
    -------
    xarray.Dataset
        Over ``time`` from the hit to the middle of each window [s]: ``amplitude`` with ``amplitude_std``, ``frequency``
        [Hz] and ``damping`` [1] with ``frequency_std`` and ``damping_std``. In attrs ``noise``, the amplitude of what
        is beside the mode.

    Raises
    ------
    InputError
        For a band without a mode that decays, a record too short or too noisy for four windows, or values that are not
        finite.
    """
    x = np.asarray(signal, dtype=float)
    low, high = band
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise InputError(f"a signal of shape {x.shape}, or with values that are not finite; give one row of numbers")
    if not (sample_rate > 0.0 and 0.0 < low < high < 0.5 * sample_rate):
        raise InputError(
            f"a band of {low:g} to {high:g} Hz at {sample_rate:g} samples a second; it must lie below half"
        )
    x = x - x.mean()
    centre = _frequency_in(x, sample_rate, band)
    edge = min(centre - low, high - centre)
    s = math.sqrt(-2.0 * math.log(APART)) / (2.0 * math.pi * edge)
    length = window if window is not None else 4.0 * REACH * s
    begin = (np.argmax(np.abs(x)) / sample_rate if hit is None else hit) + REACH * s
    envelope = _shifted(x, sample_rate, centre, s)
    noise = _noise_beside(x, sample_rate, centre, edge, s, begin)
    windows = _windows(np.abs(envelope), sample_rate, begin, length, LEAST_OVER_NOISE * noise, REACH * s)
    if len(windows) < FEWEST:
        raise InputError(
            f"{len(windows)} windows of {length:.3g} s lie between the hit and the end or the noise ({noise:.3g}); "
            f"{FEWEST} are needed: give a longer record, a wider band or shorter windows"
        )
    rows = [_slope(np.log(envelope[w]), sample_rate, s) for w in windows]
    time = np.array([0.5 * (w.start + w.stop - 1) for w in windows]) / sample_rate - (begin - REACH * s)
    level, slope, scatter = (np.array(c) for c in zip(*rows, strict=True))
    angular = 2.0 * np.pi * centre + slope.imag
    return xr.Dataset(
        {
            "amplitude": ("time", np.exp(level), {"long_name": "amplitude"}),
            "amplitude_std": ("time", np.full(time.size, noise / math.sqrt(2.0))),
            "frequency": ("time", angular / (2.0 * np.pi), {"units": "Hz"}),
            "frequency_std": ("time", scatter / (2.0 * np.pi), {"units": "Hz"}),
            "damping": ("time", -slope.real / angular, {"units": "1"}),
            "damping_std": ("time", scatter / angular, {"units": "1"}),
        },
        {"time": ("time", time, {"units": "s"})},
        {"noise": noise, "window_s": length, "filter_s": s},
    )


def _frequency_in(x: Real, rate: float, band: tuple[float, float]) -> float:
    """Frequency of the largest line of a band [Hz]."""
    f = np.fft.rfftfreq(x.size, 1.0 / rate)
    inside = np.flatnonzero((f >= band[0]) & (f <= band[1]))
    if inside.size < 3:
        raise InputError(f"a record of {x.size / rate:.3g} s has fewer than three lines in the band; give a longer one")
    lines = np.abs(np.fft.rfft(x * np.hanning(x.size)))[inside]
    best = int(np.argmax(lines))
    if best in (0, inside.size - 1):
        raise InputError(
            f"the largest line from {band[0]:g} to {band[1]:g} Hz is at the edge; move the band to the mode"
        )
    return float(f[inside[best]])


def _shifted(x: Real, rate: float, centre: float, s: float) -> Complex:
    """Complex envelope of what lies about a frequency."""
    reach = math.ceil(REACH * s * rate)
    if 2 * reach + 1 > x.size:
        raise InputError(
            f"the record is shorter than the filter, {2.0 * REACH * s:.3g} s; widen the band or the record"
        )
    g = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (rate * s)) ** 2)
    low = x * np.exp(-2j * np.pi * centre * np.arange(x.size) / rate)
    size = 1 << (x.size + g.size).bit_length()
    out = np.fft.ifft(np.fft.fft(low, size) * np.fft.fft(g / g.sum(), size))[reach : reach + x.size]
    return np.asarray(2.0 * out)


def _noise_beside(x: Real, rate: float, centre: float, edge: float, s: float, begin: float) -> float:
    """Rms of the envelope beside the mode, late in the record, where no mode is left: the quieter side."""
    late = slice(int((begin + 0.7 * max(x.size / rate - begin, 0.0)) * rate), int(x.size - REACH * s * rate))
    sides = []
    for f in (centre - edge, centre + edge):
        beside = _shifted(x, rate, f, s)[late]
        if f > 0.0 and beside.size:
            sides.append(float(np.sqrt(np.mean(np.abs(beside) ** 2))))
    if not sides:
        raise InputError("the record ends with the hit; give the free decay after it, too")
    return min(sides)


def _windows(
    level: Real, rate: float, begin: float, length: float, least: float, margin: float
) -> list[slice[int, int, None]]:
    """Windows one after the other, until the level or the record ends."""
    n, found = max(int(length * rate), 8), []
    for start in range(int(begin * rate), int(level.size - margin * rate) - n, n):
        window = slice(start, start + n)
        if level[window].min() < least:
            break
        found.append(window)
    return found


def _slope(log: Complex, rate: float, s: float) -> tuple[float, complex, float]:
    """Logarithm of the amplitude in the middle, slope of the complex logarithm there [1/s], its standard deviation."""
    log = log.real + 1j * np.unwrap(log.imag)
    t = (np.arange(log.size) - 0.5 * (log.size - 1)) / rate
    shapes = np.stack([np.ones(t.size), t, t**2], axis=1)
    fit, *_ = np.linalg.lstsq(shapes.astype(complex), log, rcond=None)
    away = log - shapes @ fit
    independent = max(t.size / (rate * 2.0 * math.sqrt(math.pi) * s), 1.0)
    # Of as many independent values three went into the parabola; of each part, real and imaginary, half the square.
    spread = float(np.mean(np.abs(away) ** 2)) / 2.0 * independent / max(independent - 3.0, 0.5)
    return float(fit[0].real), complex(fit[1]), math.sqrt(spread / (independent * float(np.mean(t**2))))
