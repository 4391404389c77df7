"""What every identification method returns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.notebook import html_table
from process.types import Real


@dataclass(frozen=True)
class Identification:
    """A compliance found from records.

    Parameters
    ----------
    name : str
        Name of the measurement.
    method : str
        "hammer", "actuator" or "sweep".
    compliance : xarray.Dataset
        Labelled compliance with ``compliance_std`` and ``coherence``, and ``force_condition`` for a sweep.
    tables : mapping of str to pandas.DataFrame
        What the engineer wants to look through: hits, steps, passes. Column names end in their unit.
    warnings : tuple of str
        Sentences for the report.
    hits : mapping of str to xarray.Dataset
        Excitation -> its accepted hits one by one (`impacts.single_hits`), where hits are behind the compliance.
    """

    name: str
    method: str
    compliance: xr.Dataset
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    hits: Mapping[str, xr.Dataset] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        """Return a table for a notebook: each entry with its band, highest magnitude and error there."""
        array = self.compliance["compliance"]
        further = [str(d) for d in array.dims if d not in ("frequency", "response", "excitation")]
        over = "".join(f", over {name}" for name in further)
        title = f"{self.name}: compliance by {self.method}{over}"
        rows = [] if further else list(_entry_rows(self.compliance))
        head = ("entry", "from [Hz]", "to [Hz]", "largest [µm/N]", "at [Hz]", "error there [%]")
        return html_table(title, rows, head, self.warnings)


def _entry_rows(compliance: xr.Dataset) -> Iterator[tuple[object, ...]]:
    """Yield a row for each entry that was measured."""
    frequency = compliance["frequency"].values
    for r in compliance["response"].values:
        for e in compliance["excitation"].values:
            at = {"response": r, "excitation": e}
            size = np.abs(compliance["compliance"].sel(at).values)
            known = np.isfinite(size)
            if not known.any():
                continue
            top = int(np.nanargmax(size))
            error = "not known"
            if "compliance_std" in compliance:
                share = 100.0 * float(compliance["compliance_std"].sel(at).values[top]) / float(size[top])
                error = f"{share:.2g}" if np.isfinite(share) else error
            ends = (float(frequency[known][k]) for k in (0, -1))
            yield (f"{r}{e}", *ends, f"{1e6 * size[top]:.3g}", float(frequency[top]), error)


def bands(frequency: Real, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] where a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def in_words(frequency: Real, mask: NDArray[np.bool_]) -> str:
    """Return the bands of a mask as text."""
    return ", ".join(f"{a:g}-{b:g} Hz" if b > a else f"{a:g} Hz" for a, b in bands(frequency, mask))
