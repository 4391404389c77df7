"""How wrong the rational model of the default estimator will be: `sweep.rational` on the equations to be expected.

With the energy ``G(f) = sum over records of F F^H`` and noise of density ``s_i^2`` the lines of a bin sum up to
``integral conj(t^p) t^q G df`` and ``integral Phi G df``, whatever the length of the records. The estimator itself is
fitted to these sums: where it ends beside the truth is its systematic error. Its linearised covariance is the bound of
Cramer and Rao where the forces are known; their noise N is in the lines that are summed, which adds N to the middle of
the covariance, and how well N is known from the air adds what is wrong with it (`smfe.identification.sweep.rational`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smfe.identification.sweep.equations import Equations
from smfe.identification.sweep.rational import fit_rational
from smfe.plan_forces import Forces, ForceSensor
from smfe.plan_task import Estimate

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP = 1.0 / 16.0
"""Width of a bin [Hz], that of the estimator."""

POINTS = 3
"""Points of Gauss at which a bin is sampled."""

BEYOND = 1.0
"""How far beyond the band the estimator takes lines for its model [Hz]."""


@dataclass(frozen=True)
class ExpectedModel:
    """What the rational model will be.

    Parameters
    ----------
    variance : ndarray, shape (f, 3, 3)
        Of the noise [m2/N2].
    bias : ndarray of complex, shape (f, 3, 3)
        Systematic error [m/N].
    freedom : ndarray, shape (3, 3)
        Degrees of freedom of the mean square error over the frequencies.
    poles : int
        Number of poles.
    """

    variance: Real
    bias: Complex
    freedom: Real
    poles: int


def expected_model(
    forces: Forces, estimate: Estimate, noise: Real, force_noise: ForceSensor, frequency: Real, order: int
) -> ExpectedModel:
    """Work the rational model out on the sums to be expected.

    Parameters
    ----------
    forces : Forces
        Of the plan.
    estimate : Estimate
        The machine.
    noise : ndarray, shape (f, 3)
        ``s_i^2`` of each row [m2 s].
    force_noise : ForceSensor
        Noise of the forces, and what the air says of it.
    frequency : ndarray, shape (f,)
        Frequencies of the evaluation [Hz].
    order : int
        Order of the polynomial in a bin.
    """
    band = (float(frequency[0]) - BEYOND, float(frequency[-1]) + BEYOND)
    centre = np.arange(band[0] + 0.5 * STEP, band[1], STEP)
    at, share = np.polynomial.legendre.leggauss(POINTS)
    points = centre[:, None] + 0.5 * STEP * at
    compliance, truth = estimate.matrix(points), estimate.matrix(frequency)
    plan = forces.plan
    energy = plan.repeats * np.sum(forces.energy(points), axis=0) * (0.5 * STEP * share)[:, None, None]
    lines = STEP * plan.record * plan.records
    without = _sums(centre, points - centre[:, None], energy, compliance, order, lines)
    power = np.diag(force_noise.density).astype(complex)
    raw = without.without_input_noise(-np.broadcast_to(power, (centre.size, 1, 3, 3)))
    weight = np.stack([1.0 / np.interp(centre, frequency, row) for row in noise.T], axis=1)[:, None, :]
    clean = without if force_noise.subtracted else raw
    fit = fit_rational(clean, raw, weight, band, frequency, 3, known=force_noise.known)
    variance = np.diagonal(fit.covariance, axis1=2, axis2=3).real
    return ExpectedModel(np.asarray(variance), np.asarray(fit.value - truth), fit.entry_freedom, fit.poles.size)


def _sums(centre: Real, shift: Real, energy: Complex, compliance: Complex, order: int, lines: float) -> Equations:
    """Return the sums over bins of shape (b, points, ...) as one test; `lines` a bin."""
    powers = shift[..., None] ** np.arange(order + 1)
    # conj(F_j) F_k is the transpose of F F^H.
    gram = np.einsum("bsp,bsq,bskj->bpjqk", powers, powers, energy, optimize=True)
    cross = np.einsum("bsp,bsrk,bskj->bpjr", powers, compliance, energy, optimize=True)
    joint = np.einsum("bsik,bskj,bslj->bil", compliance, energy, compliance.conj(), optimize=True)
    moment = np.einsum("bsp,bsq->bpq", powers, powers) * lines / shift.shape[1]
    return Equations(centre, STEP, gram[:, None], cross[:, None], joint[:, None], moment[:, None])
