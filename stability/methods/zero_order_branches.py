"""Eigenvalues of the oriented compliance, followed over frequency and interpolated along each branch."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Complex, Real
from stability.methods import _zero_order_kernels as _kernels
from stability.problem import Samples


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
    newton : ndarray of complex, shape (branches, n - 1, 4)
        Divided differences of each cubic.
    inverse : ndarray of bool, shape (branches, n - 1)
        Whether the cubic is that of sigma.
    """

    samples: Samples
    eigenvalue: Complex
    start: NDArray[np.int64]
    newton: Complex
    inverse: NDArray[np.bool_]

    def envelope(self, period: Real) -> tuple[Real, Real, NDArray[np.int64]]:
        """Return lowest limit depth [m], its frequency [Hz] and its lobe for rising tooth periods [s]."""
        s = self.samples
        depth, chatter, lobe = _kernels.envelope(
            s.frequency, s.bridged, self.start, self.newton, self.inverse, np.ascontiguousarray(period)
        )
        return depth, chatter, lobe

    def first_crossing(self, delay: Real) -> tuple[float, float]:
        """Return lowest limit depth [m] and its frequency [Hz] for the delays of all teeth [s], shape (teeth,)."""
        s = self.samples
        depth, chatter = _kernels.first_crossing(
            s.frequency, s.bridged, self.start, self.newton, self.inverse, self.eigenvalue, delay
        )
        return float(depth), float(chatter)

    def compliance_at(self, frequency: Real) -> Complex:
        """Return the compliance [m/N], shape (m, 3, 3), between samples: a cubic through the four about each."""
        f, matrix = self.samples.frequency, self.samples.matrix
        step = np.clip(np.searchsorted(f, frequency, side="right") - 1, 0, f.size - 2)
        order = np.minimum(3, _stencils(self.samples.bridged)[1])[step]
        index = np.minimum(self.start[step][:, None] + np.arange(4), f.size - 1)
        used = np.arange(4) <= order[:, None]
        weight = np.where(used, 1.0, 0.0)
        for k in range(4):
            for other in range(4):
                apart = used[:, k] & used[:, other] & (k != other)
                gap = np.where(apart, f[index[:, k]] - f[index[:, other]], 1.0)
                weight[:, k] *= np.where(apart, (frequency - f[index[:, other]]) / gap, 1.0)
        return np.asarray(np.einsum("mk,mkij->mij", weight, matrix[index]))

    def refined(self, pieces: int) -> tuple[Real, Complex]:
        """Return frequency [Hz] and mu [1/m], each step cut into `pieces`; NaN in gaps."""
        s = self.samples
        frequency, mu = _kernels.refine(s.frequency, s.bridged, self.start, self.newton, self.inverse, pieces)
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
    left, gain, right = np.linalg.svd(a0)
    rank = max(1, int(np.sum(gain > 1e-12 * gain[0])))
    # What the rank of A0 leaves at zero is left out: A0 Phi has the other eigenvalues of V^H Phi U S.
    oriented = right[:rank] @ samples.matrix @ (left[:, :rank] * gain[:rank])
    mu = _kernels.eigenvalues(np.ascontiguousarray(oriented))
    if not mu.any():
        raise InputError("the compliance is zero wherever the cut acts; there is nothing that could chatter")
    order = np.array(list(permutations(range(rank))), dtype=np.int64)
    _kernels.track(samples.frequency, samples.bridged, order, mu)
    kept = np.ascontiguousarray(mu.T[np.abs(mu).max(axis=0) > 0.0])
    return _interpolated(samples, kept)


def _interpolated(samples: Samples, mu: Complex) -> Branches:
    """Attach to each step the smoother of the two cubics."""
    f = samples.frequency
    start, order = _stencils(samples.bridged)
    direct, roughness = _divided_differences(f, mu, start, order)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(mu == 0.0, np.nan, 1.0 / np.where(mu == 0.0, 1.0, mu))
        reciprocal, sigma_roughness = _divided_differences(f, sigma, start, order)
        inverse = sigma_roughness < roughness
    return Branches(samples, mu, start, np.where(inverse[..., None], reciprocal, direct), inverse)


def _stencils(bridged: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first sample and order of each step's polynomial: not across a gap, centred if possible."""
    i = np.arange(bridged.size)
    breaks = np.flatnonzero(~bridged)
    run_start = np.concatenate([[0], breaks + 1])
    run_end = np.concatenate([breaks, [bridged.size]])
    run = np.searchsorted(breaks, i, side="left")
    order = np.minimum(3, run_end[run] - run_start[run])
    start = np.clip(i - 1, run_start[run], np.maximum(run_end[run] - order, run_start[run]))
    return start, order


def _divided_differences(
    f: Real, values: Complex, start: NDArray[np.int64], order: NDArray[np.int64]
) -> tuple[Complex, Real]:
    """Return Newton's coefficients, shape (branches, n-1, 4), and the relative size of the last term."""
    index = np.minimum(start[:, None] + np.arange(4), f.size - 1)
    x, table = f[index], values[:, index]
    newton = np.zeros((values.shape[0], start.size, 4), dtype=complex)
    newton[..., 0] = table[..., 0]
    for level in range(1, 4):
        span = x[:, level:] - x[:, : 4 - level]
        # Beyond the run's last sample there is nothing to difference: the order stays lower there.
        table = np.diff(table, axis=-1) / np.where(span > 0.0, span, 1.0)
        newton[..., level] = np.where(order >= level, table[..., 0], 0.0)
    middle = 0.5 * (f[:-1] + f[1:])
    term = np.where(np.arange(3) < order[:, None], np.abs(middle[:, None] - x[:, :3]), 1.0).prod(axis=1)
    last = np.take_along_axis(newton, np.broadcast_to(order[None, :, None], (*newton.shape[:2], 1)), axis=2)[..., 0]
    scale = 0.5 * (np.abs(values[:, :-1]) + np.abs(values[:, 1:]))
    return newton, np.abs(last) * term / np.where(scale > 0.0, scale, 1.0)
