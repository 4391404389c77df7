"""Whether two compliances of one machine differ by more than their noise.

With the difference d of a row of e entries at a frequency and the sum C of its covariances, ``2 d^H C^-1 d`` of
circular errors has the mean 2 e (real and imaginary part). Added up over rows, and averaged over frequency, it is
compared with chi^2. The mean does not depend on what rows share, so an estimate of that cannot spoil it; the scatter
does: with B the blocks of the rows in the whole covariance C of r e entries, the sum scatters like chi^2 of
``2 (r e)^2/tr((B^-1 C)^2)`` degrees of freedom (Satterthwaite 1946). C is estimated from nu degrees of freedom, which
makes the mean larger by nu/(nu - 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from process.errors import InputError
from smfe.entry_covariance import entry_covariance, scaled_inverse, with_entries

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

FEWEST = 3.0
"""Degrees of freedom of a variance below which its mean is not corrected any more."""


@dataclass(frozen=True)
class Difference:
    """How far two compliances are apart.

    Parameters
    ----------
    size : float
        Rms of the differences beyond noise over the rms compliance [1].
    chance : float
        Probability that noise alone makes as much.
    worst : float
        Frequency at which the difference is most significant [Hz].
    """

    size: float
    chance: float
    worst: float


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
    d, covariance = (value[1] - value[0])[good], (spread[0] + spread[1])[good]
    weight = _row_weights(covariance, one.sizes["response"])
    statistic = 2.0 * np.einsum("fa,fab,fb->f", d.conj(), weight, d).real / _growth(one, other)[good]
    product = weight @ covariance
    scatter = np.einsum("fab,fba->f", product, product).real
    lines = max(1.0, *(float(x.attrs.get("error_lines", 1.0)) for x in (a, b)))
    independent = max(1.0, good.sum() / lines)
    entries = d.shape[1]
    freedom = 2.0 * entries**2 / float(np.maximum(scatter, entries).mean()) * independent
    chance = float(stats.chi2.sf(statistic.mean() / (2.0 * entries) * freedom, freedom))
    noise = float(np.trace(covariance, axis1=1, axis2=2).real.sum())
    beyond = max(float(np.sum(np.abs(d) ** 2)) - noise, 0.0)
    size = max(float(np.sum(np.abs(0.5 * (value[0] + value[1])[good]) ** 2)), 1e-300)
    return Difference(math.sqrt(beyond / size), chance, float(one["frequency"].values[good][int(np.argmax(statistic))]))


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


def _row_weights(covariance: Complex, rows: int) -> Complex:
    """Return the inverse of the blocks of the rows, shape (f, r e, r e); zero between rows."""
    out = np.zeros_like(covariance)
    for part in np.split(np.arange(covariance.shape[1]), rows):
        out[:, part[:, None], part] = scaled_inverse(covariance[:, part[:, None], part])
    return out


def _growth(a: xr.Dataset, b: xr.Dataset) -> Real:
    """Return the mean of the distance over that of known covariances, ``nu/(nu - 2)``, the mean of all entries."""
    growth = np.ones(a.sizes["frequency"])
    for d in (a, b):
        if "degrees_of_freedom" in d:
            freedom = d["degrees_of_freedom"].transpose("frequency", ...).values.reshape(growth.size, -1)
            known = np.maximum(np.nan_to_num(freedom, nan=np.inf), FEWEST)
            # Each of both variances is about half of the sum.
            growth += 0.25 * np.mean(known / (known - 2.0) - 1.0, axis=1)
    return growth
