"""Errors that the rows of a compliance share because the noise of their sensors is not independent.

Vibration of the floor, a cable and the noise of the forces reach x, y and z together. Rows solved with weights
``1/s_i^2`` from columns whose noise has the coherence ``rho_ik = E[n_i conj(n_k)]/(s_i s_k)`` have errors with

    E[d_i d_k^H] = rho_ik s_i s_k U_k,   U_k = C_k/s_k^2,

where k is the row whose band is the wider one and C its covariance: the estimate from the wider band is the efficient
one, and the covariance of any other with it is its own variance (Gauss, Markov). For bands of one width that is
``rho_ik sqrt(C_i) sqrt(C_k)``. That the noise of both rows has the same ratio in all passes is assumed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

BY_CHANCE = 1e-3
"""Probability with which independent noise shows a coherence that is taken for one."""


def shared_noise(products: Complex, lines: Real, reach: int) -> Complex:
    """Return the coherence of the noise of two rows, pooled over passes and neighbours, shape (f, r, r).

    Of n lines of independent noise ``2 n |rho|^2`` follows chi^2 with two degrees of freedom; a smaller coherence than
    noise shows with the probability `BY_CHANCE` counts as none. No sum of rows is claimed to be quieter than n lines
    can tell: all coherences shrink until the smallest eigenvalue of their matrix is r/n.

    Parameters
    ----------
    products : ndarray of complex, shape (f, tests, r, r)
        Mean products of the residuals of two rows, NaN where a test has no lines.
    lines : ndarray, shape (f, tests)
        Independent lines within the neighbours that are pooled.
    reach : int
        Neighbours to either side that are pooled.
    """
    power = np.diagonal(products, axis1=2, axis2=3).real
    size = np.sqrt(np.maximum(power[..., :, None] * power[..., None, :], 0.0))
    known = np.isfinite(products) & (size > 0.0)
    count = np.where(known, lines[..., None, None], 0.0)
    ratio = np.where(known, products / np.where(known, size, 1.0), 0.0)
    total = np.sum(count * ratio, axis=1)
    n, real, imaginary = (
        ndimage.uniform_filter1d(part, 2 * reach + 1, axis=0, mode="nearest")
        for part in (count.sum(axis=1), total.real, total.imag)
    )
    rho = (real + 1j * imaginary) / np.maximum(n, 1.0)
    clear = 2.0 * n * np.abs(rho) ** 2 > stats.chi2.isf(BY_CHANCE, 2)
    rows = rho.shape[1]
    own = np.eye(rows, dtype=bool)
    rho = np.where(clear & ~own, rho, 0.0)
    smallest = np.linalg.eigvalsh(rho)[:, 0]
    floor = np.minimum(rows / np.maximum(n[:, 0, 0], 1.0), 1.0)
    shrink = np.minimum(1.0, (1.0 - floor) / np.maximum(-smallest, 1e-12))
    return np.asarray(rho * shrink[:, None, None] + own)


def noise_between(covariance: Complex, shared: Complex, level: Real, width: Real) -> Complex:
    """Return the covariance of the errors of two rows by their noise, shape (f, r, e, r, e); zero within a row.

    Parameters
    ----------
    covariance : ndarray of complex, shape (f, r, e, e)
        Within the rows.
    shared : ndarray of complex, shape (f, r, r)
        Coherence of the noise of two rows.
    level : ndarray, shape (f, r)
        Noise of the rows, in any unit that all share.
    width : ndarray, shape (f, r)
        Of the bands that the rows come from, in any unit.
    """
    f, r, e = covariance.shape[:3]
    out = np.zeros((f, r, e, r, e), dtype=complex)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(covariance).all(axis=(1, 2, 3)))
    known = np.where(finite.reshape(f, 1, 1, 1), covariance, 0.0)
    value, vector = np.linalg.eigh(known)
    root = (vector * np.sqrt(np.maximum(value, 0.0))[..., None, :]) @ vector.conj().swapaxes(2, 3)
    for i in range(r):
        for k in (k for k in range(r) if k != i):
            ratio = (level[:, i] / level[:, k]).reshape(f, 1, 1)
            first, second = width[:, i].reshape(f, 1, 1), width[:, k].reshape(f, 1, 1)
            same = np.where(first < second, known[:, k] * ratio, root[:, i] @ root[:, k])
            alike = np.where(first > second, known[:, i] / ratio, same)
            out[:, i, :, k] = shared[:, i, k, None, None] * alike
    return out


def possible(covariance: Complex, between: Complex, smallest: float = 1e-3) -> Complex:
    """Return covariances between rows that are possible together with those within them, shape (f, r, e, r, e).

    With ``C_i = R_i R_i^H`` and ``K_ik = R_i^-1 C_ik R_k^-H``, ``1 + K`` must have positive eigenvalues. Where
    approximations left one below `smallest`, all of K shrinks.

    Parameters
    ----------
    covariance : ndarray of complex, shape (f, r, e, e)
        Within the rows.
    between : ndarray of complex, shape (f, r, e, r, e)
        Between them.
    smallest : float, optional
        Eigenvalue of a variance that is 1 without what rows share.
    """
    f, r, e = covariance.shape[:3]
    finite = np.isfinite(covariance).all(axis=(1, 2, 3))
    value, vector = np.linalg.eigh(np.where(finite.reshape(f, 1, 1, 1), covariance, np.eye(e)))
    least = 1e-12 * value[..., -1:]
    root = (vector / np.sqrt(np.maximum(value, np.maximum(least, 1e-300)))[..., None, :]) @ vector.conj().swapaxes(2, 3)
    k = np.einsum("fiab,fibkc,fkcd->fiakd", root, between, root, optimize=True).reshape(f, r * e, r * e)
    lowest = np.linalg.eigvalsh(0.5 * (k + k.conj().swapaxes(1, 2)))[:, 0]
    shrink = np.where(lowest < 0.0, np.minimum(1.0, (1.0 - smallest) / np.maximum(-lowest, 1e-12)), 1.0)
    return np.asarray(between * shrink[:, None, None, None, None])
