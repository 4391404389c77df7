"""A response that has not decayed when its block ends: how wrong the compliance is for it.

A decay ``exp(-t/tau)`` cut at T leaves an error of ``exp(-T/tau)`` of the compliance near its resonance, in any phase;
a block that begins in the tail of the hit before is wrong by about as much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def leakage(first: Complex, last: Complex) -> tuple[float, int]:
    """Estimate the error of a block that ends before the response has decayed.

    A decay ``exp(-t/tau)`` cut at T leaves an error of ``exp(-T/tau)``. The decay from the first to the last
    quarter of the block, whose centres are 3/4 T apart, is read where the first quarter is above a tenth of
    its maximum, on the mean over hits, where that is above what the scatter of the hits leaves of the noise,
    and raised to 4/3.

    Parameters
    ----------
    first, last : ndarray of complex, shape (f, hits)
        Hann-windowed transforms of the velocity in the first and the last quarter, in any unit.

    Returns
    -------
    error : float
        Relative error of the compliance near the peaks of the response [1].
    line : int
        Index of the frequency that contributes most.
    """
    (early, early_noise), (late, late_noise) = _mean_and_noise(first), _mean_and_noise(last)
    # Ten and six times the noise of the mean: from few hits its estimate is itself uncertain.
    heard = early > 10.0 * early_noise
    strong = heard & (early > 0.01 * np.max(early, where=heard, initial=0.0))
    if not strong.any() or late[strong].sum() <= 6.0 * late_noise[strong].sum():
        return 0.0, 0
    ratio = float(np.sqrt(late[strong].sum() / early[strong].sum()))
    return min(ratio, 1.0) ** (4.0 / 3.0), int(np.argmax(np.where(strong, late, 0.0)))


def leakage_by_line(first: Complex, last: Complex) -> Real:
    """Estimate the error of `leakage` line by line: relative to the compliance at the line, at most 1.

    ``(late/early)^(2/3)`` of the powers over five lines, where the late one is above ten times the noise that the
    scatter of the hits shows; zero elsewhere.

    Parameters
    ----------
    first, last : ndarray of complex, shape (f, hits)
        Hann-windowed transforms of the velocity in the first and the last quarter, in any unit; two hits or more.
    """
    (early, _), (late, noise) = _mean_and_noise(first), _mean_and_noise(last)
    # The running sum of the filter leaves a rounding error that may be negative.
    early, late, noise = (np.maximum(ndimage.uniform_filter1d(p, 5, mode="nearest"), 0.0) for p in (early, late, noise))
    ratio = np.divide(late, early, out=np.zeros_like(late), where=(late > 10.0 * noise) & (early > 0.0))
    return np.asarray(np.minimum(ratio, 1.0) ** (2.0 / 3.0))


def _mean_and_noise(quarter: Complex) -> tuple[Real, Real]:
    """Return the power of the mean over hits, and of the noise in that mean, shape (f,)."""
    hits = quarter.shape[1]
    mean = quarter.mean(axis=1)
    noise = np.sum(np.abs(quarter - mean[:, None]) ** 2, axis=1) / max(hits * (hits - 1), 1)
    return np.abs(mean) ** 2, noise
