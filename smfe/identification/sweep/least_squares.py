"""One weighted least squares a frequency: the core that every sweep estimator shares.

``X = Phi F + noise`` with one column a line, segment or harmonic of a test. Rows of Phi are solved one by one because
the noise of x, y and z differs; columns are weighted with the inverse noise level of their test.

Sources: theory of multiple-input least squares, ``Cov(Phi_i) = s_i^2 (F W F^H)^-1`` (Pintelon and Schoukens, System
Identification, 2012); multiple coherence adjusted for the number of columns M and unknowns p,
``1 - (1 - g2) M/(M - p)``, because M columns of pure noise have ``E[g2] = p/M``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real


@dataclass(frozen=True)
class Columns:
    """What one frequency has to be solved from.

    Parameters
    ----------
    regressors : ndarray of complex, shape (p, M)
        The three forces first, then nuisance regressors (slopes over frequency, transients).
    response : ndarray of complex, shape (r, M)
        Displacements.
    test : ndarray of int, shape (M,)
        Which test a column belongs to.
    correlation : ndarray of complex, shape (M, M), optional
        Correlation of the noise between columns (overlapping segments). Default: none.
    """

    regressors: Complex
    response: Complex
    test: NDArray[np.int64]
    correlation: Complex | None = None


@dataclass(frozen=True)
class Solution:
    """Estimate at one frequency.

    Parameters
    ----------
    compliance : ndarray of complex, shape (r, e)
        Compliance [m/N].
    covariance : ndarray of complex, shape (r, e, e)
        Covariance of the complex errors of each row, ``E[d_j conj(d_k)]`` [m2/N2].
    coherence : ndarray, shape (r,)
        Adjusted multiple coherence.
    condition : float
        Largest over smallest singular value of the force columns.
    residual : ndarray, shape (r, tests)
        Mean square residual of each response in each test.
    freedom : ndarray, shape (r,)
        Degrees of freedom of Student's t that the error of each part (real, imaginary) over its standard deviation
        follows: ``2 (M - p)`` for uncorrelated columns, fewer where they share noise.
    """

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: float
    residual: Real
    freedom: Real

    @property
    def std(self) -> Real:
        """Root mean square of the complex error of each entry [m/N], shape (r, e)."""
        variance: Real = np.diagonal(self.covariance, axis1=1, axis2=2).real
        return np.sqrt(variance)


def condition_number(force: Complex) -> float:
    """Return the ratio of largest to smallest singular value of force columns, shape (e, M)."""
    singular = np.linalg.svd(force, compute_uv=False)
    smallest = float(singular[-1]) if force.shape[1] >= force.shape[0] else 0.0
    return float("inf") if smallest == 0.0 else float(singular[0]) / smallest


def solve(columns: Columns, excitations: int, noise: Real | None = None) -> Solution:
    """Solve one frequency.

    Parameters
    ----------
    columns : Columns
        Regressors and responses, M columns.
    excitations : int
        How many of the first regressors are forces.
    noise : ndarray, shape (r, tests), optional
        Mean square noise of each response in each test; columns are weighted with its inverse. Default: equal.

    Returns
    -------
    Solution
        NaN throughout when there are not more columns than unknowns.
    """
    p, m = columns.regressors.shape
    rows, tests = columns.response.shape[0], int(columns.test.max()) + 1
    scale = np.sqrt(np.mean(np.abs(columns.regressors) ** 2, axis=1))
    scale[scale == 0.0] = 1.0
    unit = columns.regressors / scale[:, None]
    shape = (rows, excitations)
    estimate = np.full(shape, np.nan, dtype=complex)
    covariance = np.full((*shape, excitations), np.nan, dtype=complex)
    coherence = np.full(rows, np.nan)
    residual, freedom = np.full((rows, tests), np.nan), np.zeros(rows)
    condition = condition_number(columns.regressors[:excitations])
    if m <= p or not np.isfinite(condition):
        return Solution(estimate, covariance, coherence, condition, residual, freedom)
    for i in range(rows):
        weight = np.ones(m) if noise is None else 1.0 / np.sqrt(noise[i, columns.test])
        x = columns.response[i]
        gain, spread = _row(unit, x, weight, columns.correlation)
        left = x - gain @ unit
        expected, freedom[i] = _freedom(unit, weight, columns.correlation)
        power = float(np.sum(np.abs(weight * left) ** 2)) / expected
        estimate[i] = gain[:excitations] / scale[:excitations]
        forces = scale[:excitations]
        covariance[i] = power * spread[:excitations, :excitations] / np.outer(forces, forces)
        total = float(np.sum(np.abs(weight * x) ** 2))
        coherence[i] = 1.0 - power * m / total if total > 0.0 else np.nan
        for test in range(tests):
            mine = columns.test == test
            residual[i, test] = np.mean(np.abs(left[mine]) ** 2) * m / (m - p) if mine.any() else np.nan
    return Solution(estimate, covariance, np.clip(coherence, 0.0, 1.0), condition, residual, freedom)


def _row(unit: Complex, x: Complex, weight: Real, correlation: Complex | None) -> tuple[Complex, Complex]:
    """Solve one response by QR, never by normal equations; return gains and ``E[d_j conj(d_k)]`` for unit noise."""
    q, r = np.linalg.qr((unit * weight).conj().T)
    turned = np.linalg.lstsq(r, q.conj().T @ (x * weight).conj(), rcond=None)[0]
    gain = np.asarray(turned.conj(), dtype=np.complex128)
    inverse: Complex = np.linalg.pinv(r)
    if correlation is None:
        return gain, (inverse @ inverse.conj().T).conj()
    # gain = x q r^-H =: x M, so E[d_j conj(d_k)] = (M^T R conj(M))_jk for R = E[n_a conj(n_b)].
    middle = q.conj().T @ correlation.conj() @ q
    return gain, (inverse @ middle @ inverse.conj().T).conj()


def _freedom(unit: Complex, weight: Real, correlation: Complex | None) -> tuple[float, float]:
    """Return the expected sum of squares of the residual for unit noise, and its real degrees of freedom.

    With ``P = I - Q Q^H`` and noise of correlation R the sum has the mean ``tr(P R)`` and the variance ``tr(P R P R)``
    of circular noise; a scaled chi^2 of the same mean and variance has ``2 tr(P R)^2/tr(P R P R)`` degrees of freedom
    (Satterthwaite 1946): 2 (M - p) for uncorrelated columns.
    """
    p, m = unit.shape
    if correlation is None:
        return float(m - p), 2.0 * (m - p)
    q = np.linalg.qr((unit * weight).conj().T)[0]
    # R belongs to the noise, P to its conjugate.
    through = correlation.conj() @ q
    inner = q.conj().T @ through
    mean = max(float(m - np.trace(inner).real), 1.0)
    square = np.sum(np.abs(correlation) ** 2) - 2.0 * np.sum(np.abs(through) ** 2) + np.sum(np.abs(inner) ** 2)
    return mean, 2.0 * mean**2 / max(float(square), 1e-300)
