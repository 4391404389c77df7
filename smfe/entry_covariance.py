"""The covariance of all entries of a compliance at each frequency, from as much as a dataset tells of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError

Complex = NDArray[np.complex128]


def with_entries(compliance: xr.Dataset, responses: Sequence[str], excitations: Sequence[str]) -> xr.Dataset:
    """Return a compliance of some entries, in the order given, with what its covariances say of them."""
    rows = [list(compliance["response"].values).index(a) for a in responses]
    columns = [list(compliance["excitation"].values).index(a) for a in excitations]
    where = {"response": rows, "excitation": columns, "other_response": rows, "other_excitation": columns}
    return compliance.isel({dim: at for dim, at in where.items() if dim in compliance.dims})


def entry_covariance(compliance: xr.Dataset) -> Complex:
    """Return ``E[d_a conj(d_b)]`` of all entries, row by row, shape (f, r e, r e) [m2/N2].

    Rows and entries whose common error nobody states count as independent.

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
