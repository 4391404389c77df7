"""Tones that go on unchanged, fitted jointly to the samples where nothing else moves: values and their covariance.

``x(t) = c + sum_i a_i cos w_i t + b_i sin w_i t``. Frequencies are fitted together (Gauss and Newton), because one that
is fitted alone takes the leakage of its neighbours for its own. Ripple of screw, rack and motor is periodic in position
and at constant feed in time: tones that lie at multiples of one frequency are tied to it, so that the strong ones place
the weak ones. Stretches that do not fit, such as the start of the motion, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from process.types import Complex, Real
from smfe.identification.spectra.rules import RULES

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Tones:
    """Fitted tones.

    Parameters
    ----------
    frequency, cosine, sine : ndarray, shape (n,)
        Frequency [Hz], amplitudes of cosine and sine from the first sample on.
    multiple : ndarray, shape (n, p)
        ``frequency = multiple @ free frequencies``.
    factor : ndarray, shape (2 n + p, 2 n + p)
        Square root L of the covariance ``L L^T`` of cosines, sines and free frequencies about the middle `origin`.
    origin : float
        Sample from which the time of `factor` counts.
    """

    frequency: Real
    cosine: Real
    sine: Real
    multiple: Real
    factor: Real
    origin: float

    def wave(self, count: int, dt: float) -> Real:
        """Return the tones over a record of `count` samples."""
        out = np.zeros(count)
        size = self.cosine - 1j * self.sine
        for first in range(0, count, RULES.chunk):
            turning = _turning(self.frequency, 0.0, first, min(RULES.chunk, count - first), dt)
            out[first : first + RULES.chunk] = (turning @ size).real
        return out

    @property
    def clear(self) -> Real:
        """Amplitude of each tone over its standard deviation."""
        n = self.frequency.size
        variance = np.sum(self.factor**2, axis=1)
        spread = np.sqrt(variance[:n] + variance[n : 2 * n])
        return np.asarray(np.hypot(self.cosine, self.sine) / np.maximum(spread, 1e-300))

    def standard_error(self, number: int, count: int, dt: float) -> Real:
        """Return the error of the wave for one independent standard error of its parameters, shape (count,)."""
        a, b = _turned(self.frequency, self.cosine, self.sine, self.origin * dt)
        n, part = self.frequency.size, self.factor[:, number]
        away = 2.0 * np.pi * (self.multiple @ part[2 * n :])
        still, drifting = part[:n] - 1j * part[n : 2 * n], away * (b + 1j * a)
        out = np.zeros(count)
        for first in range(0, count, RULES.chunk):
            here = slice(first, min(first + RULES.chunk, count))
            turning = _turning(self.frequency, self.origin, first, here.stop - first, dt)
            t = dt * (np.arange(first, here.stop) - self.origin)
            out[here] = (turning @ still).real + t * (turning @ drifting).real
        return out


NONE = Tones(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), 0.0)
"""No tone."""


def fit_tones(samples: Real, mask: Mask, dt: float, frequencies: Sequence[float]) -> Tones:
    """Fit tones near given frequencies to the samples of a mask.

    Parameters
    ----------
    samples : ndarray
        Record without trend.
    mask : ndarray of bool
        Which samples count.
    dt : float
        Sampling interval [s].
    frequencies : sequence of float
        First guess [Hz], within a line or so.
    """
    if not len(frequencies):
        return NONE
    index = np.flatnonzero(mask)
    origin = 0.5 * float(index[0] + index[-1])
    start = np.asarray(frequencies, dtype=float)
    free = _fitted(samples, index, dt, start, np.eye(start.size), origin)
    multiple, base = _ties(free, index.size, (index[-1] - index[0]) * dt)
    found = free if multiple.shape[1] == start.size else _fitted(samples, index, dt, base, multiple, origin)
    a, b = _turned(found.frequency, found.cosine, found.sine, -origin * dt)
    rest = np.zeros(samples.size)
    tones = Tones(found.frequency, a, b, found.multiple, np.zeros((0, 0)), origin)
    rest[index] = samples[index] - tones.wave(samples.size, dt)[index] - found.offset
    return Tones(found.frequency, a, b, found.multiple, _factor(found, rest, index.size, dt), origin)


def multiples(tones: Tones, most: int, highest: float) -> list[float]:
    """Return the lowest multiples [Hz] of what the tones are multiples of, else of the strongest, that are missing.

    Parameters
    ----------
    tones : Tones
        Found so far.
    most : int
        How many are returned at most.
    highest : float
        Frequency up to which they are [Hz].
    """
    if not tones.frequency.size:
        return []
    strongest = int(np.argmax(np.hypot(tones.cosine, tones.sine)))
    tied = np.flatnonzero(tones.multiple[:, 0] > 0.0) if tones.multiple.shape[1] < tones.frequency.size else [strongest]
    order = tones.multiple[tied[0], 0] if len(tied) > 1 else 1.0
    base = float(tones.frequency[tied[0]] / order)
    every = base * np.arange(1, RULES.highest_multiple + 1)
    missing = [f for f in every if f < highest and np.abs(tones.frequency - f).min() > 0.01 * base]
    return [float(f) for f in missing[: max(most, 0)]]


def alike(rest: Real, mask: Mask, dt: float) -> Mask:
    """Return the mask without the stretches whose rest is unlike that of most."""
    length = max(1, round(RULES.stretch / dt))
    number = np.arange(rest.size) // length
    count = np.bincount(number, mask)
    power = np.bincount(number, np.where(mask, rest, 0.0) ** 2) / np.maximum(count, 1.0)
    judged = count > 0
    if not judged.any():
        return mask
    keep = ~judged | (power <= RULES.unlike**2 * np.median(power[judged]))
    # What most do not share is no exception.
    return mask & keep[number] if np.sum(count[keep]) > 0.5 * np.sum(count) else mask


@dataclass(frozen=True)
class _Fit:
    """Amplitudes about the origin, offset, and the inverse of the normal matrix of all but the offset."""

    frequency: Real
    cosine: Real
    sine: Real
    multiple: Real
    offset: float
    inverse: Real


def _fitted(samples: Real, index: NDArray[np.int64], dt: float, base: Real, multiple: Real, origin: float) -> _Fit:
    """Fit with frequencies ``multiple @ base``; in each step amplitudes and frequencies together."""
    half = max((index[-1] - index[0]) * dt / 2.0, dt)
    n, p = multiple.shape
    amplitude = np.zeros(2 * n)
    for step in range(RULES.tone_steps):
        f = multiple @ base
        # The first step has no amplitudes yet, so that nothing moves the frequencies.
        normal, right = _normal(samples, index, dt, f, amplitude if step else None, multiple, origin, half)
        solved = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        amplitude, offset = solved[: 2 * n], float(solved[2 * n])
        if not step:
            continue
        change = np.clip(solved[2 * n + 1 :] / (2.0 * np.pi * half), -0.25 / half, 0.25 / half)
        base = base + change
        if np.abs(change).max() * half < 1e-5:
            break
    keep = np.delete(np.arange(normal.shape[0]), 2 * n)
    scale = np.ones(2 * n + p)
    scale[2 * n :] = 1.0 / (2.0 * np.pi * half)
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)[np.ix_(keep, keep)] * np.outer(scale, scale)
    return _Fit(multiple @ base, amplitude[:n], amplitude[n:], multiple, offset, inverse)


def _normal(
    samples: Real,
    index: NDArray[np.int64],
    dt: float,
    f: Real,
    amplitude: Real | None,
    multiple: Real,
    origin: float,
    half: float,
) -> tuple[Real, Real]:
    """Return normal matrix and right side for cosines, sines, an offset and, with amplitudes, the frequencies."""
    n = f.size
    size = 2 * n + 1 + (0 if amplitude is None else multiple.shape[1])
    normal, right = np.zeros((size, size)), np.zeros(size)
    for first in range(int(index[0]), int(index[-1]) + 1, RULES.chunk):
        inside = slice(*np.searchsorted(index, [first, first + RULES.chunk]))
        here = index[inside]
        if not here.size:
            continue
        t = dt * (here - origin)
        turning = _turning(f, origin, first, int(here[-1]) + 1 - first, dt)[here - first]
        c, s = turning.real, turning.imag
        columns = [c, s, np.ones((here.size, 1))]
        if amplitude is not None:
            columns.append((t / half)[:, None] * (c * amplitude[n:] - s * amplitude[:n]) @ multiple)
        matrix = np.concatenate(columns, axis=1)
        normal += matrix.T @ matrix
        right += matrix.T @ samples[here]
    return normal, right


def _ties(found: _Fit, samples: int, length: float) -> tuple[Real, Real]:
    """Return which tones are multiples of one frequency, as a matrix, and the free frequencies."""
    f, n = found.frequency, found.frequency.size
    size = np.hypot(found.cosine, found.sine)
    near = RULES.tied / max(length, 1e-300)
    best: tuple[list[int], float] = ([], 0.0)
    for part in (1, 2, 3):
        base = float(f[int(np.argmax(size))]) / part
        order = np.maximum(np.round(f / base), 1.0)
        # Distances of a multiple grow with its order as far as the base itself is wrong.
        members = [
            i
            for i in range(n)
            if order[i] <= RULES.highest_multiple and abs(f[i] - order[i] * base) < near * (1.0 + order[i] / part)
        ]
        if len(members) > len(best[0]):
            best = (members, base)
    members, base = best
    if len(members) < 2:
        return np.eye(n), f
    alone = [i for i in range(n) if i not in members]
    multiple = np.zeros((n, 1 + len(alone)))
    order = np.round(f / base)
    for i in members:
        multiple[i, 0] = order[i]
    for k, i in enumerate(alone, 1):
        multiple[i, k] = 1.0
    weight = (size[members] * order[members]) ** 2
    first = float(np.sum(weight * f[members] / order[members]) / np.sum(weight))
    return multiple, np.array([first, *f[alone]])


def _turning(f: Real, origin: float, first: int, count: int, dt: float) -> Complex:
    """Return ``exp(j w t)`` at `count` samples from `first` on, shape (count, n); time counts from the origin.

    A product of two short series: several times faster than as many sines.
    """
    starts = first + RULES.piece * np.arange(-(-count // RULES.piece))
    coarse = np.exp(2j * np.pi * dt * np.outer(starts - origin, f))
    fine = np.exp(2j * np.pi * dt * np.outer(np.arange(RULES.piece), f))
    return np.asarray((coarse[:, None] * fine).reshape(starts.size * RULES.piece, f.size)[:count])


def _turned(f: Real, a: Real, b: Real, by: float) -> tuple[Real, Real]:
    """Return the amplitudes for a time that begins `by` seconds later."""
    c, s = np.cos(2.0 * np.pi * f * by), np.sin(2.0 * np.pi * f * by)
    return a * c + b * s, b * c - a * s


def _factor(found: _Fit, rest: Real, samples: int, dt: float) -> Real:
    """Return the square root of the covariance, with the noise that the rest has about each tone."""
    power = np.abs(fft.rfft(rest)) ** 2 / samples
    line = 1.0 / (rest.size * dt)
    noise = []
    for f in found.frequency:
        # A line of its own is what the fit has taken out.
        at = round(f / line)
        around = np.r_[max(at - 60, 1) : max(at - 2, 1), at + 3 : at + 61]
        noise.append(float(np.mean(power[around[around < power.size]])))
    level = np.sqrt(np.asarray(noise))
    shared = np.sqrt((found.multiple != 0.0).T @ level**2 / np.maximum(np.sum(found.multiple != 0.0, axis=0), 1))
    each = np.concatenate([level, level, shared])
    covariance = found.inverse * np.outer(each, each)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
