"""The covariance of all entries of a compliance at each frequency, from as much as a dataset tells of it."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError

Complex = NDArray[np.complex128]


def entry_covariance(compliance: xr.Dataset) -> Complex:
    """Return ``E[d_a conj(d_b)]`` of all entries, row by row, shape (f, r e, r e) [m2/N2].

    Rows and entries whose common error nobody states count as independent.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``, better ``compliance_covariance``.

    Raises
    ------
    InputError
        When it has no standard deviation.
    """
    if "compliance_std" not in compliance:
        raise InputError("differences are judged against noise, and the compliance has no compliance_std; identify it")
    std = compliance["compliance_std"].transpose("frequency", "response", "excitation").values
    f, r, e = std.shape
    out = np.zeros((f, r, e, r, e), dtype=complex)
    for row in range(r):
        if "compliance_covariance" in compliance:
            dims = ("frequency", "excitation", "other_excitation")
            out[:, row, :, row] = compliance["compliance_covariance"].isel(response=row).transpose(*dims).values
        else:
            out[:, row, :, row] = std[:, row, :, None] ** 2 * np.eye(e)
    return out.reshape(f, r * e, r * e)
