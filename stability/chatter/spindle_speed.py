"""The spindle speed from the lines of a record: found from their spacing, or followed along a cut.

`spindle_from_lines` finds an unknown speed; `followed_turns` follows a known one by the comb of its orders, so that the
cut can be judged over turns of the spindle instead of time.

A cut has lines at the multiples of the tooth passing frequency, run-out adds lines at the multiples of the spindle
frequency, and chatter comes with sidebands spaced alike. The fundamental f is the one whose multiples explain the most
lines with the fewest orders: it maximises ``sum_k gain(k f) / sqrt(K)``, K orders up to the highest line. Half of it
would need twice as many orders, twice of it explains half of the lines.

Whether f is the spindle or the tooth passing frequency follows from the heights: with run-out, order Z stands out among
its neighbours; without, the multiples of f are tooth harmonics and the first is one of the highest. Where neither is
clear, nothing is returned.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft, ndimage, signal

from process.types import Complex, Real
from stability.chatter.line_spectrum import LineSpectrum
from stability.chatter.rules import RULES


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
    floor = max(RULES.stands_out**2 * float(np.median(power)), float(power.max()) * 1e-8, float(np.finfo(float).tiny))
    gain = np.maximum(np.log(np.maximum(power, floor) / floor), 0.0)
    fundamental = _fundamental(spectrum, gain, bounds[0], bounds[1] * teeth)
    if fundamental is None:
        return None
    return _spindle(spectrum, amplitude, math.sqrt(floor), fundamental, teeth, bounds)


def _fundamental(spectrum: LineSpectrum, gain: Real, low: float, high: float) -> float | None:
    """Return the spacing [Hz] of the comb that explains the lines best, from low to high."""
    grid = spectrum.frequency
    step = float(grid[1] - grid[0])
    top = float(grid[np.flatnonzero(gain > 0.0)[-1]]) if gain.any() else 0.0
    low, high = max(low, 4.0 * spectrum.resolution), min(high, top)
    if not low < high:
        return None
    ratio = 1.0 + spectrum.resolution / (RULES.steps_a_bin * top)
    candidates = low * ratio ** np.arange(int(math.log(high / low) / math.log(ratio)) + 1)
    # A line is taken within half a bin, so that the steps between candidates lose none.
    wide = ndimage.maximum_filter1d(gain, 2 * math.ceil(0.5 * spectrum.resolution / step) + 1)
    orders = np.minimum(np.floor(top / candidates + 1e-9), RULES.most_orders)
    score, lines = np.zeros(candidates.size), np.zeros(candidates.size)
    for k in range(1, int(orders[0]) + 1):
        reach = int(np.searchsorted(-orders, -k, side="right"))
        place = np.rint((k * candidates[:reach] - grid[0]) / step).astype(int)
        found = np.where(place >= 0, wide[np.clip(place, 0, grid.size - 1)], 0.0)
        score[:reach] += found
        lines[:reach] += found > 0.0
    score = np.where(lines >= RULES.fewest_lines, score / np.sqrt(orders), 0.0)
    best = int(np.argmax(score))
    return float(candidates[best]) if score[best] > 0.0 else None


def _spindle(
    spectrum: LineSpectrum,
    amplitude: Real,
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
    spindle = at_tooth > RULES.clear * others and bounds[0] <= fundamental <= bounds[1]
    teeth_only = others > RULES.clear * at_tooth and bounds[0] <= fundamental / teeth <= bounds[1]
    if spindle == teeth_only:
        return None
    return fundamental if spindle else fundamental / teeth


def _height(spectrum: LineSpectrum, amplitude: Real, frequency: float) -> float:
    """Amplitude within a bin of a frequency; 0 beyond the spectrum."""
    if not spectrum.frequency[0] <= frequency <= spectrum.frequency[-1]:
        return 0.0
    return float(amplitude[spectrum.near(frequency, spectrum.resolution)].max())


# --- a cut over turns of the spindle instead of time ------------------------------------------------------------------


def windows(samples: Real, dt: float, length: float, step: float) -> tuple[Real, Real, Complex]:
    """Return short-time spectra with a Hann window, zero-padded four times.

    Parameters
    ----------
    samples : ndarray, shape (axes, n)
        Samples at an interval `dt`.
    dt, length, step : float
        Interval, length of a window and distance of two, in one unit (seconds or turns).

    Returns
    -------
    middle : ndarray, shape (w,)
        Middle of each window.
    frequency : ndarray, shape (f,)
        In one over the unit.
    phasor : ndarray of complex, shape (axes, w, f)
        Peak amplitudes.
    """
    n = max(8, min(samples.shape[1], round(length / dt)))
    starts = np.arange(0, samples.shape[1] - n + 1, max(1, round(step / dt)))
    window = signal.windows.hann(n, sym=False)
    pieces = np.stack([samples[:, s : s + n] for s in starts], axis=1)
    pieces = (pieces - pieces.mean(axis=2, keepdims=True)) * window
    size = fft.next_fast_len(4 * n, real=True)
    phasor = fft.rfft(pieces, size, axis=2) * (2.0 / window.sum())
    return (starts + 0.5 * n) * dt, fft.rfftfreq(size, dt), phasor


def followed_turns(
    samples: Real, dt: float, base: float, teeth: int, tolerance: float, band: tuple[float, float]
) -> Real:
    """Return the turns of the spindle at each sample, shape (n,), from the comb of orders near a speed.

    Parameters
    ----------
    samples : ndarray, shape (axes, n)
        The cut.
    dt : float
        Sample interval [s].
    base : float
        Spindle frequency around which is searched [Hz].
    teeth : int
        Number of teeth: their orders are looked at first.
    tolerance : float
        Relative error of `base` [1].
    band : (float, float)
        Band of the orders [Hz].
    """
    duration = samples.shape[1] * dt
    time = np.arange(samples.shape[1]) * dt
    window = min(duration, max(RULES.first_turns / base, min(0.1, duration)))
    mean, drift = _best_comb(samples, dt, base, teeth, window, tolerance, RULES.drift, band)
    turns = base * ((1.0 + mean) * time + drift * (time * time / (2.0 * duration) - 0.5 * time))
    for share in (0.34, 0.99):
        total = float(turns[-1])
        if share * total < 1.2 * RULES.first_turns:
            continue
        steps = math.ceil(2.2 * band[1] / base)
        even = resampled(samples, turns, steps)
        orders = band[0] / base, band[1] / base
        reach = 1.5 / (min(orders[1], 12.0 * teeth) * (RULES.first_turns if share < 0.5 else 0.34 * total))
        mean, drift = _best_comb(
            even, 1.0 / steps, 1.0, teeth, share * total, reach, reach if share < 0.5 else 0.0, orders
        )
        first = math.ceil(turns[0])
        along = turns - first
        span = even.shape[1] / steps
        turns = first + (1.0 + mean) * along + drift * (along * along / (2.0 * span) - 0.5 * along)
    mean = float(turns[-1] - turns[0]) / (base * (duration - dt))
    return np.asarray(turns * (min(max(mean, 1.0 - tolerance), 1.0 + tolerance) / mean))


def _best_comb(
    samples: Real,
    dt: float,
    base: float,
    teeth: int,
    window: float,
    tolerance: float,
    drift: float,
    band: tuple[float, float],
) -> tuple[float, float]:
    """Return mean departure and drift of the comb that carries most lines, coarse to fine over rising orders."""
    duration = samples.shape[1] * dt
    middle, frequency, phasor = windows(samples, dt, window, 0.5 * window)
    power = np.abs(phasor) ** 2
    floor = RULES.line * np.median(power, axis=2, keepdims=True) + 1e-12 * power.max() + np.finfo(float).tiny
    gain = np.log1p(power / floor)
    if drift == RULES.drift:
        # While the reach is wide, a high line counts as one of many; a tenth of the rest keeps its top from being flat.
        gain = 0.9 * np.minimum(gain, RULES.most_gain) + 0.1 * gain
    gain = gain.sum(axis=0)[:, frequency <= band[1]]
    place = middle / duration - 0.5
    lowest, highest = max(1, math.ceil(band[0] / base)), int(band[1] / base / (1.0 + tolerance))
    found = np.zeros(2)
    reach = limit = np.array([tolerance, drift])
    for top in (4 * teeth, 12 * teeth, 20 * teeth):
        orders = np.arange(lowest, max(lowest, min(highest, top)) + 1)
        orders = orders[np.argsort(orders % teeth != 0, kind="stable")][: RULES.most_turn_orders]
        step = 0.5 / (int(orders.max()) * window * base)
        grids = [
            centre + np.linspace(-r, r, 2 * max(1, math.ceil(2.0 * r / step)) + 1) if r > 0.0 else np.array([centre])
            for centre, r in zip(found, reach, strict=True)
        ]
        means, drifts = np.meshgrid(*grids, indexing="ij")
        score = np.zeros(means.shape)
        for row, at in zip(gain, place, strict=True):
            speed = base / frequency[1] * (1.0 + means + drifts * at)
            for order in orders:
                bins = np.rint(order * speed).astype(np.int64)
                weight = 1.0 if order % teeth == 0 else RULES.other_orders
                score += weight * np.where(bins < row.size, row[np.minimum(bins, row.size - 1)], 0.0)
        best = np.unravel_index(int(np.argmax(score)), score.shape)
        found = np.clip([grids[0][best[0]], grids[1][best[1]]], -limit, limit)
        reach = np.where(reach > 0.0, np.minimum(reach, 3.0 * step), 0.0)
    return float(found[0]), float(found[1])


def resampled(samples: Real, turns: Real, steps: int) -> Real:
    """Return samples at equal steps of the angle over whole turns, shape (axes, whole turns * steps).

    Cubic interpolation on twice the sample rate: 0.3 % at 0.4 sample rates.
    """
    n = samples.shape[1]
    fine = signal.resample(samples, 2 * n, axis=1)
    grid = np.arange(math.ceil(turns[0]) * steps, math.floor(turns[-1]) * steps) / steps
    at = 2.0 * np.interp(grid, turns, np.arange(n))
    return np.stack([ndimage.map_coordinates(row, [at], order=3, mode="nearest") for row in fine])
