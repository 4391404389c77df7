"""The hits behind a compliance, one by one: the force of each as it was recorded, and what each alone finds.

A machine that is not linear gives the mean of some hits something other than their mean hit; who compares it with a
simulation has to simulate them all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.labels import AXES, sample_interval
from smfe.hits import Hit, quiet_state
from smfe.spectra import force_samples

LEAD = 2e-3
"""Time before a hit is seen [s] from which its force is kept: it begins below the trigger."""

CONTACT = 25e-3
"""Time after that [s] over which it is kept; longer for hits that last longer."""


def single_hits(
    records: Sequence[xr.Dataset],
    hits: Sequence[Hit],
    frequency: NDArray[np.float64],
    motion: NDArray[np.complex128],
    force: NDArray[np.complex128],
    window: float,
) -> xr.Dataset:
    """Return the accepted hits of one excitation.

    Parameters
    ----------
    records : sequence of xarray.Dataset
        Of the excitation; a hit says which of them it is in.
    hits : sequence of Hit
        r hits.
    frequency : ndarray, shape (f,)
        [Hz].
    motion : ndarray, shape (f, 3, r)
        Transforms of the displacement along x, y, z [m s]; NaN where it was not recorded.
    force : ndarray, shape (f, r)
        Transforms of the force [N s].
    window : float
        Time after a hit that was transformed [s].

    Returns
    -------
    xarray.Dataset
        ``force(hit, contact_time)`` [N], its sign that of the channel, and ``compliance(hit, frequency, response)``
        [m/N]; attribute ``window_s``.
    """
    interval = min(sample_interval(records[h.record]) for h in hits)
    lasting = max(CONTACT, 2.0 * max(h.duration for h in hits))
    time = np.linspace(0.0, 1.0, round((LEAD + lasting) / interval) + 1)
    time *= interval * (time.size - 1)
    recorded = np.isfinite(motion[0]).any(axis=1)
    rows = [axis for axis, there in zip(AXES, recorded, strict=True) if there]
    with np.errstate(divide="ignore", invalid="ignore"):
        compliance = (motion[:, recorded] / force[:, None]).transpose(2, 0, 1)
    return xr.Dataset(
        {
            "force": (("hit", "contact_time"), np.stack([_contact(records[h.record], h, time) for h in hits])),
            "compliance": (("hit", "frequency", "response"), compliance),
        },
        {"contact_time": time, "frequency": frequency, "response": rows},
        {"window_s": window},
    )


def _contact(record: xr.Dataset, hit: Hit, time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Force of a hit [N] at times [s] from `LEAD` before it was seen; zero outside the record."""
    samples, interval = force_samples(record, hit.excitation), sample_interval(record)
    level, _, _ = quiet_state(samples)
    first = hit.onset - LEAD / interval
    return np.interp(first + time / interval, np.arange(samples.size), samples - level, left=0.0, right=0.0)
