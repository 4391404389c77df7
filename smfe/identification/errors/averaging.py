"""Averages of hits or periods: H1, H2 and Hv, and what each hit says about the error of the average.

The error is learnt by leaving one hit out at a time. It holds for every estimator and for whatever is done to a
compliance afterwards (a window taken off, a mass taken off), and it asks nothing of the noise but that hits are
independent: noise of the response, noise of the force, and hits that differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from process.types import Complex, Real

ESTIMATORS: tuple[str, ...] = ("H1", "H2", "Hv")
"""Ways to average; see `average`."""


@dataclass(frozen=True)
class Average:
    """An average of M hits, and the averages that lack one of them.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, responses)
        [m/N]; NaN where no hit has the response.
    left_out : ndarray of complex, shape (f, responses, M)
        The same without hit m [m/N]; NaN where fewer than two hits have the response, or hit m lacks it.
    leverage : ndarray, shape (f, responses, M)
        Share of hit m in the average, ``h_m = |F_m|^2 / sum |F|^2``; zero where it lacks the response.
    coherence : ndarray, shape (f, responses)
        ``|S_XF|^2 / (S_XX S_FF)``; NaN for fewer than two hits, where it is 1 by construction.
    """

    compliance: Complex
    left_out: Complex
    leverage: Real
    coherence: Real


def average(motion: Complex, force: Complex, estimator: str = "H1", noise_ratio: Real | None = None) -> Average:
    """Average hits, :eq:`averages`.

    ``H1 = S_XF/S_FF`` with ``S_XF = sum X conj(F)``: unbiased for noise on the response, low by ``S_nn/S_FF`` for noise
    on the force. ``H2 = S_XX/S_FX``: the other way round. ``Hv``: total least squares, the H that minimises ``sum
    |X - H F0|^2/k + |F - F0|^2`` over H and the forces F0, unbiased when k is the ratio of the noise variances of
    response and force:

        Hv = (S_XX - k S_FF + sqrt((S_XX - k S_FF)^2 + 4 k |S_XF|^2)) / (2 S_FX),

    H1 for an infinite k, H2 for zero, ``sqrt(H1 H2)`` for ``k = S_XX/S_FF``.

    Parameters
    ----------
    motion : ndarray of complex, shape (f, responses, M)
        Transforms X of the displacement [m s]; NaN where a hit lacks the response.
    force : ndarray of complex, shape (f, M)
        Transforms F of the force [N s].
    estimator : {"H1", "H2", "Hv"}, optional
        Which.
    noise_ratio : ndarray, shape (f, responses), optional
        k of Hv [m2/N2], which needs it.
    """
    there = np.isfinite(motion)
    x = np.where(there, motion, 0.0)
    f = np.where(there, force[:, None, :], 0.0)
    k = np.full(x.shape[:2], np.inf) if noise_ratio is None else noise_ratio
    parts = np.abs(x) ** 2, x * f.conj(), np.abs(f) ** 2
    sxx, sxf, sff = (part.sum(axis=2) for part in parts)
    count = there.sum(axis=2)
    whole = _ratio(estimator, sxx, sxf, sff, k)
    without = [total[..., None] - part for total, part in zip((sxx, sxf, sff), parts, strict=True)]
    several = (count > 1)[..., None] & there
    left_out = np.where(several, _ratio(estimator, without[0], without[1], without[2], k[..., None]), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        leverage = np.where(there, np.abs(f) ** 2 / sff[..., None], 0.0)
        coherence = np.minimum(np.abs(sxf) ** 2 / (sxx * sff), 1.0)
    unknown = (count < 2) | ~(sxx > 0.0)
    return Average(np.where(count > 0, whole, np.nan), left_out, leverage, np.where(unknown, np.nan, coherence))


def _ratio(estimator: str, sxx: Real, sxf: Complex, sff: Real, k: Real) -> Complex:
    with np.errstate(invalid="ignore", divide="ignore"):
        if estimator == "H1":
            return np.asarray(sxf / sff)
        if estimator == "H2":
            return np.asarray(sxx / sxf.conj())
        least = np.where(np.isfinite(k), k, 0.0)
        a = sxx - least * sff
        root = np.sqrt(a**2 + 4.0 * least * np.abs(sxf) ** 2)
        # Two forms of the same root: each loses its digits where the other keeps them.
        found = np.where(a > 0.0, (a + root) / (2.0 * sxf.conj()), 2.0 * least * sxf / (root - a))
        return np.asarray(np.where(np.isfinite(k), found, sxf / sff))


def noise_ratio(motion: Complex, force: Complex, force_noise: float) -> Real:
    """Return the ratio k of the noise variances of response and force that the hits themselves show [m2/N2].

    What the hits do not have in common has the power ``R = N_x + |H|^2 N_f`` a hit; N_f is known from where the force
    is quiet, so ``N_x = R - |H|^2 N_f``: all that the noise of the force does not explain. R is a mean over 19 lines.
    Infinite (H1) where the force has no noise or fewer than two hits have the response.

    Parameters
    ----------
    motion : ndarray of complex, shape (f, responses, M)
        Transforms of the displacement [m s].
    force : ndarray of complex, shape (f, M)
        Transforms of the force [N s].
    force_noise : float
        N_f: expected ``|F|^2`` of the noise of the force in one block [N2 s2].
    """
    there = np.isfinite(motion)
    count = there.sum(axis=2)
    k = np.full(count.shape, np.inf)
    if force_noise <= 0.0:
        return k
    for row in np.flatnonzero((count > 1).all(axis=0)):
        here = there[0, row]
        power = np.sum(np.abs(force[:, here]) ** 2, axis=1)
        # Without the noise of the force, which would make the response look noisier than it is.
        power = np.maximum(power - np.count_nonzero(here) * force_noise, 0.1 * power)
        h = np.sum(motion[:, row][:, here] * force[:, here].conj(), axis=1) / power
        own = motion[:, row][:, here] - h[:, None] * force[:, here]
        residual = np.sum(np.abs(own) ** 2, axis=1) / (count[:, row] - 1)
        explained = np.abs(h) ** 2 * force_noise
        # In parts of what the force noise makes, which varies less from line to line than either.
        excess = ndimage.uniform_filter1d(residual / explained, 19, mode="nearest") - 1.0
        k[:, row] = np.maximum(excess, 1e-3) * np.abs(h) ** 2
    return k


def deviations(averaged: Average, compliance: Complex | None = None, left_out: Complex | None = None) -> Complex:
    """Return what each hit contributes to the error: a factor of its covariance, shape (f, responses, M).

    ``D_m = sqrt(1 - h_m) (H_without_m - H)``, so that ``cov(d_i, d_j) = sum_m D_mi conj(D_mj)`` over any responses and
    frequencies, and ``E d^2 = sum_m D_m^2``. For H1 that is ``sum |F_m|^2 |X_m - H F_m|^2 / (1 - h_m) / (sum
    |F|^2)^2``: unbiased for noise that is the same in all hits, however their forces differ, and not misled by noise
    that grows with the force (MacKinnon and White 1985, HC2). NaN where fewer than two hits have the response.

    Parameters
    ----------
    averaged : Average
        The average.
    compliance, left_out : ndarray of complex, optional
        What was made of ``averaged.compliance`` and ``averaged.left_out`` since, hit by hit the same way.
    """
    h = averaged.compliance if compliance is None else compliance
    without = averaged.left_out if left_out is None else left_out
    known = np.isfinite(without)
    with np.errstate(invalid="ignore"):
        d = np.sqrt(1.0 - np.minimum(averaged.leverage, 1.0)) * (without - h[..., None])
    return np.where(known, d, np.where(known.any(axis=2, keepdims=True), 0.0, np.nan))


def degrees_of_freedom(leverage: Real) -> Real:
    """Return the degrees of freedom of the variance that `deviations` give, shape (f, responses).

    ``nu = 1/tr(B^2)`` with ``tr(B^2) = sum h^2 + (sum q)^2 - sum q^2``, ``q = h^2/(1 - h)`` (Bell and McCaffrey 2002,
    for one regressor): M - 1 for M hits of equal force, fewer where few hits carry the average. The real and the
    imaginary part have as many each. NaN for fewer than two hits.

    Parameters
    ----------
    leverage : ndarray, shape (f, responses, M)
        Of `Average`.
    """
    several = np.count_nonzero(leverage > 0.0, axis=2) > 1
    h = np.minimum(leverage, 1.0 - 1e-12)
    q = h**2 / (1.0 - h)
    trace = np.sum(h**2, axis=2) + np.sum(q, axis=2) ** 2 - np.sum(q**2, axis=2)
    with np.errstate(divide="ignore"):
        return np.where(several, 1.0 / trace, np.nan)
