"""What a measured estimate says of a machine without its noise: a rational model of the band that is planned for.

A plan asks how a resonance bends within a band; noise of a hammer test would be taken for many of them. The model is
that of `smfe.identification.sweep.rational` with a force of one newton in every direction.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.labels import AXES, full_matrix, make_compliance
from smfe.identification.sweep.equations import Equations
from smfe.identification.sweep.rational import fit_rational

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP = 1.0 / 16.0
"""Step of the frequency axis that comes back [Hz]."""

MARGIN = 4.0
"""How far beyond the band it reaches, where something was measured there [Hz]."""

TERMS = 4
"""Terms of the expansion about the edge of a bin."""

LEAST = 1e-3
"""Error over the rms of a row that a measured compliance has at least."""


def without_noise(source: xr.Dataset, band: tuple[float, float]) -> xr.Dataset | None:
    """Return a measured compliance as a rational model has it.

    Parameters
    ----------
    source : xarray.Dataset
        With ``compliance`` and, where it is known, ``compliance_std``; else the scatter between lines counts.
    band : (float, float)
        That is planned for [Hz].

    Returns
    -------
    xarray.Dataset or None
        On a fine frequency axis, what was not measured as zero; None where fewer than 16 lines were measured in the
        band.
    """
    full = full_matrix(source)
    known = np.isfinite(full).all(axis=(1, 2))
    known &= np.abs(source["frequency"].values - 0.5 * sum(band)) <= 0.5 * (band[1] - band[0]) + MARGIN
    at, compliance = source["frequency"].values[known], full[known]
    if at.size < 16:
        return None
    step = float(np.median(np.diff(at)))
    lines = _one_line_each(at, compliance, step)
    weight = 1.0 / _variance(source, known, compliance)[:, None, :]
    fine = np.arange(at[0], at[-1] + 0.5 * STEP, STEP)
    fine[-1] = at[-1]
    fit = fit_rational(lines, lines, weight, (at[0] - 0.5 * step, at[-1] + 0.5 * step), fine, 3)
    return make_compliance(fine, fit.value, AXES, attrs={"poles": fit.poles.size})


def _one_line_each(at: Real, compliance: Complex, step: float) -> Equations:
    """Return bins that hold one line each, at the centre; the terms let the fit expand about the edge of a bin."""
    gram = np.zeros((at.size, 1, TERMS, 3, TERMS, 3), dtype=complex)
    gram[:, 0, 0, :, 0, :] = np.eye(3)
    cross = np.zeros((at.size, 1, TERMS, 3, 3), dtype=complex)
    cross[:, 0, 0] = compliance.swapaxes(1, 2)
    joint = (compliance @ compliance.conj().swapaxes(1, 2))[:, None]
    moment = np.zeros((at.size, 1, TERMS, TERMS))
    moment[:, 0, 0, 0] = 3.0
    return Equations(at, step, gram, cross, joint, moment)


def _variance(source: xr.Dataset, known: NDArray[np.bool_], compliance: Complex) -> Real:
    """Return the mean square error of each row, shape (lines, 3)."""
    size = np.mean(np.abs(compliance) ** 2, axis=(0, 2))
    least = np.maximum(LEAST**2 * size, 1e-8 * size.max())
    if "compliance_std" in source:
        std = full_matrix(source.assign(compliance=source["compliance_std"].astype(complex))).real[known]
        told = np.mean(np.nan_to_num(std) ** 2, axis=2)
    else:
        # Of white noise the second difference has six times the variance; a median passes over the resonances.
        bend = np.abs(np.diff(compliance, 2, axis=0)) ** 2 / 6.0 / np.log(2.0)
        told = np.broadcast_to(np.median(bend, axis=0).mean(axis=1), (compliance.shape[0], 3))
    return np.asarray(np.maximum(told, least))
