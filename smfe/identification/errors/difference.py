"""Whether two compliances of one machine differ by more than their noise, and whether one is reciprocal.

With the difference d of n entries at a frequency and its covariance C, ``2 d^H C^-1 d`` of circular errors
(:eq:`difference`) has the mean 2 n (real and imaginary part). Averaged over frequency, it is compared with chi^2. Where
the entries stand in rows, B, the blocks of the rows in C, takes the place of C: the mean of ``2 d^H B^-1 d`` does not
depend on what rows share, so an estimate of that cannot spoil it; the scatter does: it is that of chi^2 with ``2
n^2/tr((B^-1 C)^2)`` degrees of freedom (Satterthwaite 1946). A C that is estimated from nu degrees of freedom makes the
mean larger by nu/(nu - 2).

Reciprocity compares ``Phi_ij`` with ``Phi_ji`` of one compliance; `symmetric` forces them to be equal.
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
from process.types import Complex, Real
from smfe.identification.errors.covariance import entry_covariance, scaled_inverse, with_entries


@dataclass(frozen=True)
class Difference:
    """How far two estimates of one compliance are apart.

    Parameters
    ----------
    size : float
        Root mean square of the differences beyond noise over that of the compliance [1].
    p_value : float
        Probability that noise alone makes as much.
    worst : float
        Frequency at which the difference is most significant [Hz].
    lines : int
        Number of frequencies that were compared.
    """

    size: float
    p_value: float
    worst: float
    lines: int


def compare(
    frequency: Real,
    difference: Complex,
    covariance: Complex,
    magnitude: Real,
    *,
    rows: int = 1,
    inflation: Real | float = 1.0,
    error_lines: float = 1.0,
) -> Difference:
    """Compare differences of entries with their covariance.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        [Hz].
    difference : ndarray of complex, shape (f, n)
        d [m/N].
    covariance : ndarray of complex, shape (f, n, n)
        ``E[d_a conj(d_b)]`` [m2/N2].
    magnitude : ndarray, shape (f, ...)
        Magnitude of the compliance that the size refers to [m/N].
    rows : int, optional
        Number of rows that the entries stand in, of equal length, one after the other.
    inflation : ndarray, shape (f,), or float, optional
        By what the covariance being an estimate multiplies the mean of the statistic.
    error_lines : float, optional
        Number of neighbouring lines that share an error.
    """
    statistic, each = chi_square(difference, covariance, rows)
    statistic = statistic / inflation
    degrees_of_freedom = each * max(1.0, frequency.size / max(1.0, error_lines))
    p_value = float(
        stats.chi2.sf(statistic.mean() / (2.0 * difference.shape[1]) * degrees_of_freedom, degrees_of_freedom)
    )
    noise = float(np.trace(covariance, axis1=1, axis2=2).real.sum())
    beyond = max(float(np.sum(np.abs(difference) ** 2)) - noise, 0.0)
    size = math.sqrt(beyond / max(float(np.sum(magnitude**2)), 1e-300))
    return Difference(size, p_value, float(frequency[int(np.argmax(statistic))]), int(frequency.size))


def chi_square(difference: Complex, covariance: Complex, rows: int = 1) -> tuple[Real, float]:
    """Return ``2 d^H B^-1 d`` at each frequency, shape (f,), and the degrees of freedom of one of them.

    Parameters
    ----------
    difference : ndarray of complex, shape (f, n)
        d.
    covariance : ndarray of complex, shape (f, n, n)
        C = ``E[d_a conj(d_b)]``.
    rows : int, optional
        Number of rows; B holds the blocks of the rows in C and zeros between them. 1: B is C.
    """
    entries = covariance.shape[1]
    inverse = np.zeros_like(covariance)
    for part in np.split(np.arange(entries), rows):
        inverse[:, part[:, None], part] = scaled_inverse(covariance[:, part[:, None], part])
    statistic = 2.0 * np.einsum("fa,fab,fb->f", difference.conj(), inverse, difference).real
    product = inverse @ covariance
    scatter = np.einsum("fab,fba->f", product, product).real
    return statistic, 2.0 * entries**2 / float(np.maximum(scatter, entries).mean())


# --- two compliances -------------------------------------------------------------------------------------------------


def difference_of(a: xr.Dataset, b: xr.Dataset) -> Difference:
    """Compare two compliances of independent records at their common frequencies and entries.

    Parameters
    ----------
    a, b : xarray.Dataset
        With ``compliance_std``, better ``compliance_covariance`` and ``degrees_of_freedom``.

    Returns
    -------
    Difference
        The size refers to the mean of both.

    Raises
    ------
    InputError
        Without a common frequency and entry that both know with an error.
    """
    one, other = _common(a, b)
    value = [_entries(d) for d in (one, other)]
    spread = [entry_covariance(d) for d in (one, other)]
    good = np.all([np.isfinite(v).all(axis=1) for v in (*value, *(s.reshape(len(s), -1) for s in spread))], axis=0)
    if not good.any():
        raise InputError("no frequency has a value and a standard deviation in all entries of both; nothing to compare")
    return compare(
        one["frequency"].values[good],
        (value[1] - value[0])[good],
        (spread[0] + spread[1])[good],
        np.abs(0.5 * (value[0] + value[1])[good]),
        rows=one.sizes["response"],
        inflation=_inflation(one, other)[good],
        error_lines=max(float(x.attrs.get("error_lines", 1.0)) for x in (a, b)),
    )


def _common(a: xr.Dataset, b: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """Return both at the frequencies and entries that they share."""
    one, other = (np.round(d["frequency"].values, 6) for d in (a, b))
    _, first, second = np.intersect1d(one, other, return_indices=True)
    axes = {n: [x for x in a[n].values if x in b[n].values] for n in ("response", "excitation")}
    if not first.size or not all(axes.values()):
        raise InputError("the compliances share no frequency or no entry; identify both over the same band and axes")
    both = [with_entries(d.isel(frequency=at), *axes.values()) for d, at in ((a, first), (b, second))]
    return both[0], both[1]


def _entries(d: xr.Dataset) -> Complex:
    value = d["compliance"].transpose("frequency", "response", "excitation").values
    return np.asarray(value.reshape(len(value), -1), dtype=complex)


def _inflation(a: xr.Dataset, b: xr.Dataset) -> Real:
    """Return the mean of the statistic over that of known covariances, ``nu/(nu - 2)``, the mean of all entries."""
    inflation = np.ones(a.sizes["frequency"])
    for d in (a, b):
        if "degrees_of_freedom" in d:
            known = d["degrees_of_freedom"].transpose("frequency", ...).values.reshape(inflation.size, -1)
            # nu/(nu - 2) is taken at 3 where fewer are known: it has no mean from 2 down.
            known = np.maximum(np.nan_to_num(known, nan=np.inf), 3.0)
            # Each of both variances is about half of the sum.
            inflation += 0.25 * np.mean(known / (known - 2.0) - 1.0, axis=1)
    return inflation


# --- reciprocity -----------------------------------------------------------------------------------------------------


def reciprocity(compliance: xr.Dataset) -> Difference:
    """Test a compliance for reciprocity.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``; axes that are both response and excitation are used.

    Returns
    -------
    Difference
        Of ``Phi_ij - Phi_ji``; the size refers to these entries.

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
    return compare(frequency, d, spread, size, error_lines=float(compliance.attrs.get("error_lines", 1.0)))


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
