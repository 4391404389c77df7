"""Counting unstable poles: the argument principle on an adaptively refined imaginary axis."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError

_PHASE_STEP = 0.3
_ROUNDS = 60


def right_half_plane_zeros(
    characteristic: Callable[[NDArray[np.complex128]], NDArray[np.complex128]],
    scales: NDArray[np.float64],
    longest_delay: float = 0.0,
) -> int:
    """Return how many zeros of a monic retarded quasi-polynomial lie in Re s > 0.

    ``r(w) = D(jw)/(jw + w0)^n`` tends to 1 for w to infinity, and its phase changes by ``-pi Z`` from 0 to there. The
    grid is refined until no step of phase exceeds 0.3 rad. A zero on the axis itself counts as unstable.

    Parameters
    ----------
    characteristic : callable
        Complex s [rad/s], shape (n,), to ``D(s)/(s + w0)^n``, n the degree of D and w0 a typical frequency.
    scales : ndarray, shape (m,)
        Frequencies [rad/s] where D changes quickly (poles without dead time).
    longest_delay : float, optional
        Longest dead time [s].
    """
    w = _contour(characteristic, scales, longest_delay)
    for _ in range(_ROUNDS):
        r = characteristic(np.asarray(1j * w, dtype=np.complex128))
        if np.any(r == 0.0):
            return max(1, _count(r[r != 0.0]))
        wide = np.abs(np.angle(r[1:] / r[:-1])) > _PHASE_STEP
        if not wide.any():
            return _count(r)
        w = np.sort(np.concatenate([w, 0.5 * (w[1:] + w[:-1])[wide]]))
    return max(1, _count(characteristic(np.asarray(1j * w, dtype=np.complex128))))


def _count(r: NDArray[np.complex128]) -> int:
    turn = float(np.sum(np.angle(r[1:] / r[:-1]))) - float(np.angle(r[-1]))
    return round(-turn / math.pi)


def _contour(
    characteristic: Callable[[NDArray[np.complex128]], NDArray[np.complex128]],
    scales: NDArray[np.float64],
    longest_delay: float,
) -> NDArray[np.float64]:
    """First grid [rad/s]: dense around every scale, fine against the delay, far enough for r to be 1."""
    far = 20.0 * float(scales.max())
    for _ in range(60):
        if np.abs(characteristic(1j * np.array([far, 3.0 * far])) - 1.0).max() <= 0.3:
            break
        far *= 2.0
    else:
        raise InputError("the poles cannot be counted: the characteristic function does not settle at high frequency")
    near = np.outer(scales, 1.0 + np.array([-0.1, -0.03, -0.01, -0.003, 0.0, 0.003, 0.01, 0.03, 0.1])).ravel()
    even = np.arange(0.0, far, 0.25 / longest_delay)[:20000] if longest_delay > 0.0 else np.zeros(1)
    w = np.concatenate([[0.0], np.geomspace(1e-6 * float(scales.max()), far, 1500), near, even])
    return np.unique(np.clip(w, 0.0, far))
