"""What every estimator of a sweep returns, and the words for bands of frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smfe.sweep_delay import Delay

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Estimate:
    """A compliance before it is labelled.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, r, e)
        [m/N].
    covariance : ndarray of complex, shape (f, r, e, e)
        ``E[d_j conj(d_k)]`` within a row [m2/N2].
    coherence : ndarray, shape (f, r)
        Adjusted multiple coherence.
    condition : ndarray, shape (f,)
        Of the forces.
    error_lines : float
        Lines that share an error.
    half_width : ndarray, shape (f, r), optional
        Half of the band each row comes from [Hz].
    freedom : ndarray, shape (f, r), optional
        Degrees of freedom of Student's t for each part: real ones of the variance, whose errors are circular.
    warnings : tuple of str
        What the user should know.
    between : ndarray of complex, shape (f, r, e, r, e), optional
        Covariance of the errors of two rows, zero within a row [m2/N2].
    delay : Delay, optional
        Of the motion against the force, where the estimator sees it.
    """

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: Real
    error_lines: float
    half_width: Real | None = None
    freedom: Real | None = None
    warnings: tuple[str, ...] = ()
    between: Complex | None = None
    delay: Delay | None = None

    @property
    def std(self) -> Real:
        """Root mean square of the complex error [m/N], shape (f, r, e)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=2, axis2=3).real, 0.0))


def bands(frequency: Real, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] where a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def in_words(frequency: Real, mask: NDArray[np.bool_]) -> str:
    """Return the bands of a mask as text."""
    return ", ".join(f"{a:g}-{b:g} Hz" if b > a else f"{a:g} Hz" for a, b in bands(frequency, mask))
