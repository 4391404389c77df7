"""Noise powers of several passes that are each known from few lines.

A pass whose residual is small by chance is weighted more, and weighted residuals then look quieter than they are. The
logarithm of a power that is the mean of n complex lines has the variance ``psi'(n)`` (trigamma; chi^2 of 2 n degrees of
freedom); what the passes scatter by beyond it is their own. Each is drawn towards the mean of all by the share of its
scatter that is chance (Stein; Efron and Morris 1973).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

Real = NDArray[np.float64]


def pooled_noise(power: Real, lines: Real) -> Real:
    """Return noise powers of passes, drawn together by as much as they differ by chance.

    Parameters
    ----------
    power : ndarray, shape (f, tests, r)
        Positive.
    lines : ndarray, shape (f, tests)
        Independent lines that each is the mean of.
    """
    tests = power.shape[1]
    if tests < 2:
        return power
    log = np.log(power)
    chance = special.polygamma(1, np.maximum(lines, 0.5))[..., None]
    away = log - log.mean(axis=1, keepdims=True)
    scatter = np.sum(away**2, axis=1, keepdims=True) / (tests - 1)
    own = np.maximum(1.0 - chance.mean(axis=1, keepdims=True) / np.maximum(scatter, 1e-300), 0.0)
    return np.asarray(np.exp(log.mean(axis=1, keepdims=True) + own * away))


def floored(noise: Real) -> Real:
    """Keep noise powers (f, tests, r) of the passes within 1:1e6, and unknown ones out of the way."""
    largest = np.max(np.nan_to_num(noise), axis=1, keepdims=True)
    floor = np.where(largest > 0.0, 1e-6 * largest, 1.0)
    return np.where(np.isfinite(noise), np.maximum(noise, floor), floor)
