"""Reciprocity of a measured compliance: a test, and the symmetric compliance next to it.

A linear structure with force and motion at one point has ``Phi_ij = Phi_ji`` (Maxwell, Betti). The symmetric matrix of
least weighted distance is the constrained weighted least squares: ``theta = (S^T C^-1 S)^-1 S^T C^-1 phi`` with the
nine entries phi, their covariance C (between rows, too, where noise reaches several sensors) and S from six to nine.
A servo, a moving guideway or sensors away from the tool break reciprocity; then the constraint is wrong, and the test
says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from process.errors import InputError
from process.labels import UNITS
from smfe.entry_covariance import entry_covariance, scaled_inverse, with_entries

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Reciprocity:
    """How far a compliance is from symmetric.

    Parameters
    ----------
    size : float
        Rms of the differences ``Phi_ij - Phi_ji`` beyond noise over the rms of these entries [1].
    chance : float
        Probability that noise alone makes as much.
    worst : float
        Frequency at which the difference is most significant [Hz].
    """

    size: float
    chance: float
    worst: float


def reciprocity(compliance: xr.Dataset) -> Reciprocity:
    """Test a compliance for reciprocity.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``; axes that are both response and excitation are used.

    Raises
    ------
    InputError
        With fewer than two such axes or without a standard deviation.
    """
    frequency, value, covariance, axes = _square(compliance)
    pairs = [(i, j) for i in range(len(axes)) for j in range(i)]
    d = np.stack([value[:, i, j] - value[:, j, i] for i, j in pairs], axis=1)
    size = np.stack([0.5 * np.abs(value[:, i, j] + value[:, j, i]) for i, j in pairs], axis=1)
    n = len(axes)
    difference = np.zeros((len(pairs), n * n))
    for k, (i, j) in enumerate(pairs):
        difference[k, i * n + j], difference[k, j * n + i] = 1.0, -1.0
    spread = np.einsum("ka,fab,lb->fkl", difference, covariance, difference)
    # What has been made symmetric differs by rounding, with no error.
    floor = 1e-9 * np.trace(covariance, axis1=1, axis2=2).real / (n * n)
    spread = spread + floor[:, None, None] * np.eye(len(pairs))
    statistic = 2.0 * np.einsum("fk,fkl,fl->f", d.conj(), np.linalg.pinv(spread, hermitian=True), d).real
    # Lines share their errors: as many are independent as there are groups of them.
    shared = max(1.0, float(compliance.attrs.get("error_lines", 1.0)))
    independent = max(1.0, frequency.size / shared)
    freedom = 2.0 * len(pairs) * independent
    chance = float(stats.chi2.sf(statistic.mean() * independent, freedom))
    beyond = max(float(np.sum(np.abs(d) ** 2) - np.trace(spread, axis1=1, axis2=2).real.sum()), 0.0)
    return Reciprocity(
        math.sqrt(beyond / max(float(np.sum(size**2)), 1e-300)), chance, float(frequency[int(np.argmax(statistic))])
    )


def symmetric(compliance: xr.Dataset) -> xr.Dataset:
    """Return the compliance constrained to be symmetric, with the smaller standard deviation that this gives.

    Rows share their errors afterwards: ``entry_covariance`` holds it, ``compliance_covariance`` what is within a row.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``, the same axes for response and excitation.
    """
    frequency, value, covariance, axes = _square(compliance)
    if set(map(str, compliance["response"].values)) != set(axes) or len(axes) != compliance.sizes["excitation"]:
        raise InputError("a symmetric compliance needs the same axes for motion and force; record the missing motion")
    n = len(axes)
    expand = np.zeros((n * n, n * (n + 1) // 2))
    for k, (i, j) in enumerate(zip(*np.tril_indices(n), strict=True)):
        expand[i * n + j, k] = expand[j * n + i, k] = 1.0
    scale = np.sqrt(np.trace(covariance, axis1=1, axis2=2).real / (n * n))[:, None, None]
    # Entries that are the same already have a singular covariance.
    weight = scaled_inverse(covariance / scale**2)
    inner = np.linalg.pinv(np.einsum("ak,fab,bl->fkl", expand, weight, expand), hermitian=True)
    theta = np.einsum("fkl,al,fab,fb->fk", inner, expand, weight, value.reshape(frequency.size, n * n))
    new = (theta @ expand.T).reshape(value.shape)
    spread = np.einsum("ak,fkl,bl->fab", expand, inner, expand) * scale**2
    return _replaced(compliance, axes, new, spread.reshape(frequency.size, n, n, n, n))


def _replaced(compliance: xr.Dataset, axes: list[str], value: Complex, spread: Complex) -> xr.Dataset:
    """Return the dataset with new values; lines that were not all finite stay as they were, without a value."""
    blocks = np.stack([spread[:, r, :, r] for r in range(len(axes))], axis=1)
    finite = _finite(compliance, axes)
    out = compliance.copy(deep=True)
    order = {"response": axes, "excitation": axes}
    full = np.full((finite.size, *value.shape[1:]), np.nan, dtype=complex)
    full[finite] = value
    wide = np.full((finite.size, *blocks.shape[1:]), np.nan, dtype=complex)
    wide[finite] = blocks
    dims = ("frequency", "response", "excitation")
    coords = {"frequency": out["frequency"], **order}
    std = np.sqrt(np.maximum(np.diagonal(wide, axis1=2, axis2=3).real, 0.0))
    for name, array in (("compliance", full), ("compliance_std", std)):
        attrs = out[name].attrs
        out[name] = xr.DataArray(array, coords, dims).reindex_like(out[name]).assign_attrs(attrs)
    if "compliance_covariance" in out:
        old = out["compliance_covariance"]
        new = xr.DataArray(wide, {**coords, "other_excitation": axes}, (*dims, "other_excitation"))
        if "other_excitation" not in old.coords:
            new = new.drop_vars("other_excitation")
        out["compliance_covariance"] = new.assign_attrs(old.attrs)
    whole = np.full((finite.size, *spread.shape[1:]), np.nan, dtype=complex)
    whole[finite] = spread
    columns = [axes.index(str(a)) for a in out["excitation"].values]
    rows = [axes.index(str(a)) for a in out["response"].values]
    whole = whole[:, rows][:, :, columns][:, :, :, rows][..., columns]
    five = (*dims, "other_response", "other_excitation")
    out["entry_covariance"] = (five, whole, {"units": UNITS["entry_covariance"]})
    return out.assign_attrs(reciprocal="constrained")


def _finite(compliance: xr.Dataset, axes: list[str]) -> NDArray[np.bool_]:
    part = compliance.sel(response=axes, excitation=axes)
    good = np.isfinite(part["compliance"].values) & np.isfinite(part["compliance_std"].values)
    return np.asarray(good.all(axis=(1, 2)))


def _square(compliance: xr.Dataset) -> tuple[Real, Complex, Complex, list[str]]:
    """Return frequencies, values (f, n, n), covariance of all entries (f, n n, n n) and the axes."""
    if "compliance_std" not in compliance:
        raise InputError("reciprocity is judged against noise, and the compliance has no compliance_std; identify it")
    axes = [str(a) for a in compliance["excitation"].values if a in compliance["response"].values]
    n = len(axes)
    if n < 2:
        raise InputError(f"{n} axes are both response and excitation; reciprocity needs two or three of them")
    finite = _finite(compliance, axes)
    if not finite.any():
        raise InputError("no frequency has a value and a standard deviation in all entries; nothing can be compared")
    part = with_entries(compliance, axes, axes).isel(frequency=np.flatnonzero(finite))
    value = part["compliance"].transpose("frequency", "response", "excitation").values
    return part["frequency"].values, value, entry_covariance(part), axes
