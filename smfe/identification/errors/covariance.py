"""The covariance of a measured compliance: as its factors, what each hit contributes to the error, and of all entries.

``deviation(hit, frequency, response, excitation)`` [m/N]: the covariance of the errors of any two entries at any two
frequencies is ``sum_hits D conj(D)``, their relation ``sum_hits D D``. Responses of the same hits share errors, and so
do neighbouring and distant frequencies where hits differ by a factor; a standard deviation alone does not know either.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.types import Complex

Variables = dict[str, tuple[tuple[str, ...], ArrayLike]]

ENTRY = ("frequency", "response", "excitation")


def error_variables(deviation: Complex, keep: bool = True) -> Variables:
    """Return the variables of a compliance that say how wrong it may be.

    Parameters
    ----------
    deviation : ndarray of complex, shape (hits, f, responses, excitations)
        What each hit contributes to the error [m/N]; NaN in all hits where an entry has no error estimate.
    keep : bool, optional
        Keep the factors themselves.

    Returns
    -------
    dict
        ``compliance_std`` (root mean square of the complex error), ``compliance_relation`` (``E d^2``),
        ``compliance_covariance`` (``E d_j conj(d_k)`` of the errors in one row, as a sweep has it) and ``deviation``.
    """
    covariance = np.einsum("hfri,hfrj->frij", deviation, deviation.conj())
    # A column whose error is unknown must not hide that of the others.
    own = np.sum(np.abs(deviation) ** 2, axis=0)
    index = np.arange(own.shape[2])
    covariance[..., index, index] = own
    out: Variables = {
        "compliance_std": (ENTRY, np.sqrt(own)),
        "compliance_relation": (ENTRY, np.sum(deviation**2, axis=0)),
        "compliance_covariance": ((*ENTRY, "other_excitation"), covariance),
    }
    if keep:
        out["deviation"] = (("hit", *ENTRY), deviation)
    return out


def deviation_of(compliance: xr.Dataset) -> Complex | None:
    """Return the factors of the errors of a compliance, shape (hits, f, responses, excitations); None without any.

    Where only a standard deviation is known, errors of different entries are independent and circular: two factors an
    entry, ``std/sqrt 2`` and ``j std/sqrt 2``.
    """
    if "deviation" in compliance:
        return np.asarray(compliance["deviation"].transpose("hit", *ENTRY).values, dtype=complex)
    if "compliance_std" not in compliance:
        return None
    std = compliance["compliance_std"].transpose(*ENTRY).values
    _, rows, columns = std.shape
    out = np.zeros((2 * rows * columns, *std.shape), dtype=complex)
    for number, (r, c) in enumerate(np.ndindex(rows, columns)):
        out[2 * number, :, r, c] = std[:, r, c] / np.sqrt(2.0)
        out[2 * number + 1, :, r, c] = 1j * std[:, r, c] / np.sqrt(2.0)
    return np.where(np.isnan(std), np.nan, out)


# --- covariance of all entries at each frequency, from as much as a dataset knows ------------------------------------


def with_entries(compliance: xr.Dataset, responses: Sequence[str], excitations: Sequence[str]) -> xr.Dataset:
    """Return a compliance of some entries, in the order given, with what its covariances say of them."""
    rows = [list(compliance["response"].values).index(a) for a in responses]
    columns = [list(compliance["excitation"].values).index(a) for a in excitations]
    where = {"response": rows, "excitation": columns, "other_response": rows, "other_excitation": columns}
    return compliance.isel({dim: at for dim, at in where.items() if dim in compliance.dims})


def entry_covariance(compliance: xr.Dataset) -> Complex:
    """Return ``E[d_a conj(d_b)]`` of all entries, row by row, shape (f, r e, r e) [m2/N2].

    Rows and entries whose common error is unknown count as independent.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``, better ``compliance_covariance``, best ``entry_covariance``.

    Raises
    ------
    InputError
        When it has no standard deviation.
    """
    if "compliance_std" not in compliance:
        raise InputError("differences are judged against noise, and the compliance has no compliance_std; identify it")
    std = compliance["compliance_std"].transpose("frequency", "response", "excitation").values
    f, r, e = std.shape
    if "entry_covariance" in compliance:
        five = ("frequency", "response", "excitation", "other_response", "other_excitation")
        whole = compliance["entry_covariance"].transpose(*five).values
        return np.asarray(whole.reshape(f, r * e, r * e), dtype=complex)
    out = np.zeros((f, r, e, r, e), dtype=complex)
    for row in range(r):
        if "compliance_covariance" in compliance:
            dims = ("frequency", "excitation", "other_excitation")
            out[:, row, :, row] = compliance["compliance_covariance"].isel(response=row).transpose(*dims).values
        else:
            out[:, row, :, row] = std[:, row, :, None] ** 2 * np.eye(e)
    return out.reshape(f, r * e, r * e)


def scaled_inverse(covariance: Complex) -> Complex:
    """Return the pseudo-inverse of covariances (..., n, n) whose entries may differ by orders of magnitude.

    In units of the standard deviations: what is no more than 1e-10 of a variance then is counted as no error of its
    own, as that of an entry which is the same as another.
    """
    own = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1).real, 0.0))
    largest = own.max(axis=-1, keepdims=True)
    size = np.where(own > 1e-15 * largest, own, np.where(largest > 0.0, 1e-15 * largest, 1.0))
    sizes = size[..., :, None] * size[..., None, :]
    return np.asarray(np.linalg.pinv(covariance / sizes, rcond=1e-10, hermitian=True) / sizes)
