"""Covariance of least squares whose residual is correlated from value to value."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from process.types import Real


def independent_values(residual: Real, run: NDArray[np.int64]) -> float:
    """Return the number of independent values in a correlated residual (n,) of the records `run` (n,)."""
    return residual.size / (1.0 + 2.0 * float(np.sum(_correlations(residual, run))))


def _correlations(residual: Real, run: NDArray[np.int64]) -> Real:
    """Autocorrelation of a residual from lag 1 on, cut where pairs of it cease to be positive (Geyer 1992)."""
    parts = [residual[run == k] for k in np.unique(run)]
    longest = max(2, min(2000, min(p.size for p in parts) // 4 * 2))
    power = sum(float(p @ p) for p in parts)
    lags, pair = [], 0.0
    for k in range(1, longest):
        lags.append(sum(float(p[k:] @ p[: p.size - k]) for p in parts) / max(power, 1e-300))
        pair += lags[-1]
        if k % 2 == 0:
            if pair <= 0.0:
                lags = lags[:-2]
                break
            pair = 0.0
    return np.asarray(np.maximum(np.array(lags), 0.0))


def covariance_of(columns: Real, residual: Real, run: NDArray[np.int64], prior: Real) -> tuple[Real, float]:
    """Return the covariance of least squares with a correlated residual, and its degrees of freedom.

    Newey and West 1987.

    Parameters
    ----------
    columns : ndarray, shape (n, p)
        Regressors.
    residual : ndarray, shape (n,)
        What they leave.
    run : ndarray of int, shape (n,)
        Record of each value; values of two records are independent.
    prior : ndarray, shape (p,)
        Standard deviation about zero that each unknown had before; infinite for most.

    Returns
    -------
    covariance : ndarray, shape (p, p)
        Of the unknowns.
    degrees_of_freedom : float
        Independent values less unknowns.
    """
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    x = columns / scale
    correlations = _correlations(residual, run)
    spread = 1.0 + 2.0 * float(np.sum(correlations))
    independent = residual.size / spread
    degrees_of_freedom = max(independent - x.shape[1], 1.0)
    variance = float(np.mean(residual**2)) * spread
    ridge = variance / (prior * scale) ** 2
    # The root of the normal matrix, without squaring its condition.
    _, singular, right = np.linalg.svd(np.vstack([x, np.diag(np.sqrt(ridge))]), full_matrices=False)
    inverse = right.T / np.maximum(singular, 1e-9 * singular[0])
    white = x @ inverse
    score = white * residual[:, None]
    span = max(1, min(round(2.0 * spread), residual.size // 4))
    meat = np.zeros((x.shape[1],) * 2)
    for k in np.unique(run):
        part = score[run == k]
        meat += part.T @ part
        for lag in range(1, min(span, part.shape[0])):
            product = part[lag:].T @ part[:-lag]
            meat += (1.0 - lag / span) * (product + product.T)
    # Not below what a residual correlated alike with every column has.
    alike = variance * np.sum(white**2, axis=0)
    raise_by = np.sqrt(np.maximum(alike / np.maximum(np.diag(meat), 1e-300), 1.0))
    meat = meat * np.outer(raise_by, raise_by)
    meat += inverse.T @ np.diag(ridge * variance) @ inverse
    inverse = inverse / scale[:, None]
    return np.asarray(inverse @ meat @ inverse.T * (independent / degrees_of_freedom)), degrees_of_freedom


def underestimate(column: Real, others: Real, residual: Real, run: NDArray[np.int64]) -> float:
    """Return by how much the variance of one unknown exceeds that of a residual correlated alike everywhere, >= 1."""
    whole = np.column_stack([column, others])
    covariance, _ = covariance_of(whole, residual, run, np.full(whole.shape[1], np.inf))
    q = np.linalg.qr(others / np.maximum(np.sqrt(np.mean(others**2, axis=0)), 1e-300))[0]
    own = column - q @ (q.T @ column)
    spread = residual.size / independent_values(residual, run)
    alike = float(np.mean(residual**2)) * spread / max(float(own @ own), 1e-300)
    return max(float(covariance[0, 0]) / max(alike, 1e-300), 1.0)
