"""Eigenvalues of the oriented compliance, followed over frequency and interpolated along each branch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Complex, Real
from stability.methods import _zero_order_kernels as _kernels
from stability.problem import NO_LOBE, Samples


@dataclass(frozen=True)
class Branches:
    """Eigenvalues mu of ``A0 Phi(f)`` [1/m] as continuous branches, with a local cubic between the samples.

    Between two samples either mu or ``sigma = 1/mu`` is a cubic through four samples, whichever is smoother
    there: near a resonance sigma is nearly a parabola (exactly one, for one mode), near an anti-resonance mu
    is smooth.

    Parameters
    ----------
    samples : Samples
        The compliance behind the branches.
    eigenvalue : ndarray of complex, shape (branches, n)
        mu at the samples [1/m]; zero where it is negligible.
    start : ndarray of int, shape (n - 1,)
        First of the four samples of each cubic.
    order : ndarray of int, shape (n - 1,)
        Degree of each polynomial: 3, or less where a run has fewer than four samples.
    """

    samples: Samples
    eigenvalue: Complex
    start: NDArray[np.int64]
    order: NDArray[np.int64]

    @cached_property
    def cubics(self) -> tuple[Complex, NDArray[np.bool_]]:
        """Divided differences of each cubic, shape (branches, n-1, 4), and whether it is that of sigma."""
        newton = np.empty((self.eigenvalue.shape[0], self.start.size, 4), dtype=complex)
        inverse = np.empty(newton.shape[:2], dtype=bool)
        _kernels.interpolants(self.samples.frequency, self.start, self.order, self.eigenvalue, newton, inverse)
        return newton, inverse

    def envelope(self, period: Real) -> tuple[Real, Real, NDArray[np.int64]]:
        """Return lowest limit depth [m], its frequency [Hz] and its lobe for rising tooth periods [s]."""
        s = self.samples
        depth, chatter = np.full(period.size, np.inf), np.full(period.size, np.nan)
        lobe = np.full(period.size, NO_LOBE)
        _kernels.envelope(
            s.frequency,
            s.bridged,
            self.start,
            self.order,
            self.eigenvalue,
            np.ascontiguousarray(period),
            depth,
            chatter,
            lobe,
        )
        return depth, chatter, lobe

    def first_crossing(self, delay: Real) -> tuple[float, float]:
        """Return lowest limit depth [m] and its frequency [Hz] for the delays of all teeth [s], shape (teeth,)."""
        s = self.samples
        depth, chatter = _kernels.first_crossing(
            s.frequency, s.bridged, self.start, *self.cubics, self.eigenvalue, delay
        )
        return float(depth), float(chatter)

    def compliance_at(self, frequency: Real) -> Complex:
        """Return the compliance [m/N], shape (m, 3, 3), between samples: a cubic through the four about each."""
        f, matrix = self.samples.frequency, self.samples.matrix
        step = np.clip(np.searchsorted(f, frequency, side="right") - 1, 0, f.size - 2)
        out = np.empty((step.size, 3, 3), dtype=complex)
        _kernels.compliance_between(f, np.ascontiguousarray(matrix), self.start, self.order, frequency, step, out)
        return out

    def refined(self, pieces: int) -> tuple[Real, Complex]:
        """Return frequency [Hz] and mu [1/m], each step cut into `pieces`; NaN in gaps."""
        s = self.samples
        frequency, mu = _kernels.refine(s.frequency, s.bridged, self.start, *self.cubics, pieces)
        return frequency, mu


def eigenvalue_branches(samples: Samples, directional: Complex) -> Branches:
    """Return the branches of ``eig(A0 Phi(f))``.

    Parameters
    ----------
    samples : Samples
        Compliance [m/N].
    directional : ndarray of complex, shape (3, 3)
        Mean directional matrix A0 [N/m2].

    Raises
    ------
    InputError
        When the directional matrix is not finite or all eigenvalues vanish.
    """
    a0 = np.asarray(directional, dtype=complex)
    if a0.shape != (3, 3) or not np.isfinite(a0).all():
        raise InputError(f"a directional matrix of shape {a0.shape}; a finite 3x3 matrix [N/m2] is needed")
    # The mean over a turn is real but for rounding; a real matrix halves the products.
    real = np.abs(a0.imag).max() <= 1e-15 * np.abs(a0).max()
    left, gain, right = np.linalg.svd(a0.real if real else a0)
    rank = max(1, int(np.sum(gain > 1e-12 * gain[0])))
    # What the rank of A0 leaves at zero is left out: A0 Phi has the other eigenvalues of V^H Phi U S.
    factors = np.ascontiguousarray(right[:rank]), np.ascontiguousarray(left[:, :rank] * gain[:rank])
    mu = _kernels.oriented_eigenvalues(np.ascontiguousarray(samples.matrix), *factors)
    there = mu.any(axis=1)
    if not there.any():
        raise InputError("the compliance is zero wherever the cut acts; there is nothing that could chatter")
    order = np.array(list(permutations(range(rank))), dtype=np.int64)
    _kernels.track(samples.frequency, samples.bridged, order, mu)
    # Tracking moves the zeros of a missing rank to branches of their own.
    there = mu.any(axis=1)
    return Branches(samples, mu if there.all() else mu[there], *_stencils(samples.bridged))


def _stencils(bridged: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first sample and order of each step's polynomial: not across a gap, centred if possible."""
    i = np.arange(bridged.size)
    if bridged.all():
        whole = min(3, bridged.size)
        return np.clip(i - 1, 0, bridged.size - whole), np.full(bridged.size, whole)
    breaks = np.flatnonzero(~bridged)
    run_start = np.concatenate([[0], breaks + 1])
    run_end = np.concatenate([breaks, [bridged.size]])
    run = np.searchsorted(breaks, i, side="left")
    order = np.minimum(3, run_end[run] - run_start[run])
    start = np.clip(i - 1, run_start[run], np.maximum(run_end[run] - order, run_start[run]))
    return start, order
