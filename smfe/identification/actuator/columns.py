"""What each excitation axis of a shaker gave, and all of them as one compliance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.labels import AXES, make_compliance
from process.types import Complex, Real


@dataclass(frozen=True)
class Column:
    """One excitation; arrays of shape (f, 3), NaN where nothing is claimed.

    Parameters
    ----------
    axis : str
        Of the force.
    compliance : ndarray of complex
        [m/N].
    variance, relation : ndarray
        ``E |d|^2`` and ``E d^2`` of its complex error d [m2/N2].
    degrees_of_freedom, coherence : ndarray
        Of each part of the error; [1].
    table : pandas.DataFrame
        One row a record.
    notes : tuple of str
        Sentences for the report.
    error_lines : float, optional
        Number of neighbouring lines that share an error.
    """

    axis: str
    compliance: Complex
    variance: Real
    relation: Complex
    degrees_of_freedom: Real
    coherence: Real
    table: pd.DataFrame
    notes: tuple[str, ...]
    error_lines: float = 1.0


def joined(
    frequency: Real, columns: Sequence[Column], lines: NDArray[np.int64], attrs: Mapping[str, object]
) -> xr.Dataset:
    """Return the compliance of all columns at some lines, with its errors; responses that no column has are left out.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        [Hz].
    columns : sequence of Column
        Of at least f lines each.
    lines : ndarray of int
        Lines that are kept.
    attrs : mapping
        Attributes of the compliance.
    """
    rows = [r for r in range(len(AXES)) if any(np.isfinite(c.compliance[lines, r]).any() for c in columns)]

    def stack(name: str) -> Complex:
        return np.stack([getattr(c, name)[lines][:, rows] for c in columns], axis=2)

    dims = ("frequency", "response", "excitation")
    extra = {
        "compliance_std": (dims, np.sqrt(stack("variance"))),
        "compliance_relation": (dims, stack("relation")),
        "degrees_of_freedom": (dims, stack("degrees_of_freedom")),
        "coherence": (dims, stack("coherence")),
    }
    names = [AXES[r] for r in rows], [c.axis for c in columns]
    return make_compliance(frequency[lines], stack("compliance"), *names, extra, dict(attrs))
