"""What the tones that were taken off a record may be wrong by, as part of the error of the compliance.

Amplitudes and frequencies of the tones have a covariance (`smfe.steady_tones`). Each of its independent directions is a
small wave of known shape; its transform over the blocks of the hits says what it does to the compliance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.labels import AXES, axis_index, sample_interval
from smfe.spectra import block_spectra, motion_axes
from smfe.steady_tones import NONE, Tones

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def doubts(record: xr.Dataset, starts: Sequence[int], taper: Real, tones: Mapping[str, Tones]) -> Complex:
    """Transform what the tones that were taken off may be wrong by.

    Parameters
    ----------
    record : xarray.Dataset
        With the motion channel that they were taken off.
    starts : sequence of int
        First samples of the blocks.
    taper : ndarray
        Window, as long as a block.
    tones : mapping of str to Tones
        By axis.

    Returns
    -------
    ndarray of complex, shape (f, 3, blocks, p)
        Of the displacement [m s] without the line at 0 Hz, one independent standard error each.
    """
    dt, count, (channel, axes) = sample_interval(record), record.sizes["time"], motion_axes(record)
    out = []
    for axis in axes:
        there = tones.get(axis, NONE)
        for number in range(there.factor.shape[1]):
            wrong = xr.zeros_like(record[channel])
            wrong.loc[{"axis": axis}] = there.doubt(number, count, dt)
            spectra = block_spectra(record.assign({channel: wrong}), starts, taper.size, taper, detrend=True)
            whole = np.zeros((spectra.frequency.size - 1, len(AXES), len(starts)), dtype=complex)
            whole[:, axis_index(spectra.response)] = spectra.displacement[1:]
            out.append(whole)
    return np.stack(out, axis=3) if out else np.zeros((taper.size // 2, len(AXES), len(starts), 0), dtype=complex)


def side_by_side(parts: Sequence[Complex]) -> Complex:
    """Put doubts (f, 3, blocks, p) of several records together: each record has blocks and doubts of its own."""
    f, rows = parts[0].shape[:2]
    out = np.zeros((f, rows, sum(p.shape[2] for p in parts), sum(p.shape[3] for p in parts)), dtype=complex)
    block = number = 0
    for part in parts:
        out[:, :, block : block + part.shape[2], number : number + part.shape[3]] = part
        block, number = block + part.shape[2], number + part.shape[3]
    return out


def shared_doubt(doubt: Complex, force: Complex, leverage: Real) -> Complex:
    """Return what is wrong in all hits alike and their scatter does not show, shape (f, responses, p).

    An error ``dX_m`` of known shape and unit standard deviation moves H1 by ``s = sum_m h_m dX_m/F_m``. The scatter
    already shows ``v = sum_m h_m^2 |dX_m/F_m - s|^2/(1 - h_m)`` of it, on average all where its phase differs from hit
    to hit, and nothing where the hits keep step with it; ``|s|^2 - v`` is left.

    Parameters
    ----------
    doubt : ndarray of complex, shape (f, responses, M, p)
        Errors of the transforms [m s], independent of each other.
    force : ndarray of complex, shape (f, M)
        Transforms of the force [N s].
    leverage : ndarray, shape (f, responses, M)
        Of `Average`.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        each = np.nan_to_num(doubt / force[:, None, :, None])
    h = leverage[..., None]
    whole = np.sum(h * each, axis=2)
    left = np.minimum(h, 1.0 - 1e-12)
    shown = np.sum(h**2 * np.abs(each - whole[:, :, None]) ** 2 / (1.0 - left), axis=2)
    size = np.abs(whole) ** 2
    share = np.sqrt(np.maximum(size - shown, 0.0) / np.where(size > 0.0, size, 1.0))
    return np.asarray(whole * share)
