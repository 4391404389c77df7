"""What the single hits of a measurement tell a diagnosis: their scatter, their forces, and how long they were followed.

What the hits do not have in common is noise, line by line, and levels and states at rest, over all lines; a standard
deviation takes both for noise of each line.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import xarray as xr

from smfe.diagnosis.frf_noise import Excited, Hits, freedom_of, scatter_of, smooth_errors

DISCREPANCY = 0.004
"""Root mean square of the smooth relative error by which two simulations of one machine may differ."""

FEWEST = 3
"""Hits whose scatter tells anything."""


def compared(
    excited: Excited, compliance: xr.Dataset, hits: xr.Dataset | None, discrepancy: float, floor: float = 0.002
) -> Excited:
    """Return how a compliance along one axis was excited, as a simulation in time is compared with it.

    Parameters
    ----------
    excited : Excited
        From `excitation_of`, one entry; its level gets the sign of the force.
    compliance : xarray.Dataset
        The mean.
    hits : xarray.Dataset, optional
        What it is the mean of (`smfe.identification.hammer.impacts.single_hits`).
    discrepancy : float
        Root mean square of the smooth relative error of the simulation.
    floor : float, optional
        As of `excitation_of`.
    """
    ((response, excitation),) = excited.entries
    mean = compliance["compliance"].sel(response=response, excitation=excitation).values
    mean = mean[np.searchsorted(compliance["frequency"].values, excited.frequency - 1e-9)]
    smooth = smooth_errors(excited.frequency, mean[:, None], discrepancy)
    if hits is None:
        return replace(excited, shared=smooth)
    f = hits["frequency"].values
    pick = np.searchsorted(f, excited.frequency - 1e-9)
    # A sensor that roves is not along this axis in every hit.
    hits = hits.isel(hit=np.isfinite(hits["compliance"].sel(response=response).values[:, pick]).all(axis=1))
    if hits.sizes["hit"] < FEWEST:
        return replace(excited, shared=smooth)
    each = hits["compliance"].sel(response=response).values
    force, rate = hits["force"].values, 1.0 / float(np.diff(hits["contact_time"].values[:2])[0])
    impulse = force.sum(axis=1) / rate
    known = np.isfinite(each).all(axis=0)
    std, shared = np.full(f.size, np.nan), np.full((len(each), f.size), np.nan, dtype=complex)
    std[known], shared[:, known] = scatter_of(each[:, known], impulse)
    # Whatever was done to the mean (another estimator, the mass of a sensor taken off) is done to the hits.
    plain = (impulse**2 @ each[:, pick]) / np.sum(impulse**2)
    each = each[:, pick] * (mean / plain)
    return replace(
        excited,
        std=np.hypot(std[pick], floor * np.abs(mean))[:, None],
        shared=np.concatenate([shared[:, pick, None], smooth]),
        level=math.copysign(excited.level, impulse.sum()),
        window=float(hits.attrs["window_s"]),
        hits=Hits(force, rate, each[:, :, None]),
        noise_freedom=freedom_of(len(each), pick.size),
    )
