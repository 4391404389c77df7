"""Noise of the force channels, from the air before and after the cut.

Noise on the inputs makes every least squares estimate too small, ``E[Phi_hat] = Phi (1 - N (F F^H)^-1)``. With N known
it is subtracted from the normal equations (bias-compensated least squares: Stoica and Soderstrom 1982); how well N is
known is charged to the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.labels import axis_present, sample_interval
from smfe.spectra import hann

Real = NDArray[np.float64]

MARGIN = 0.1
"""Time that is left out on either side of the cut [s]."""

SHORTEST = 0.2
"""Air in one piece from which a spectrum is taken [s]."""


@dataclass(frozen=True)
class ForceNoise:
    """Power of the noise of each force.

    Parameters
    ----------
    density : ndarray, shape (e,)
        Two-sided power spectral density [N2/Hz], mean over the band.
    freedom : float
        Number of complex lines it is the mean of; its relative standard deviation is ``1/sqrt(freedom)``.
    """

    density: Real
    freedom: float


def in_cut(record: xr.Dataset) -> NDArray[np.bool_]:
    """Mark the samples in the cut: force over 50 ms above a fifth of its upper quartile."""
    level = _level(record)
    return np.asarray(level > 0.2 * np.quantile(level, 0.75))


def _level(record: xr.Dataset) -> Real:
    """Return the magnitude of the force, mean over 50 ms [N]."""
    total = np.zeros(record.sizes["time"])
    for axis in axis_present(record, "force"):
        total += record["force"].sel(axis=axis).values ** 2
    width = max(1, round(0.05 / sample_interval(record)))
    return np.asarray(ndimage.uniform_filter1d(np.sqrt(total, out=total), width))


def air_pieces(record: xr.Dataset) -> list[slice]:
    """Return the samples before and after the cut, at least `SHORTEST` long; none where the record has no air.

    Air is where the force stays below its quietest level and a fifth of the way to that of the cut; a record whose
    force hardly changes has none.
    """
    level = _level(record)
    loud, quiet = float(np.quantile(level, 0.75)), float(level.min())
    if not quiet < 0.5 * loud:
        return []
    cutting = np.flatnonzero(level > quiet + 0.2 * (loud - quiet))
    dt, n = sample_interval(record), level.size
    margin, shortest = round(MARGIN / dt), max(8, round(SHORTEST / dt))
    pieces = slice(0, max(int(cutting[0]) - margin, 0)), slice(min(int(cutting[-1]) + margin, n), n)
    return [p for p in pieces if p.stop - p.start >= shortest]


def force_noise(record: xr.Dataset, axes: list[str], reach: tuple[float, float]) -> ForceNoise | None:
    """Return the noise of the forces of a record within a band [Hz], or None where it has no air."""
    dt = sample_interval(record)
    power, lines = np.zeros(len(axes)), 0.0
    for piece in air_pieces(record):
        samples = record["force"].sel(axis=axes).values[:, piece]
        samples = samples - samples.mean(axis=1, keepdims=True)
        window = hann(samples.shape[1])
        frequency = fft.rfftfreq(samples.shape[1], dt)
        # The lowest lines hold the window and the drift of the charge amplifier.
        inside = (frequency >= max(reach[0], 3.0 * frequency[1])) & (frequency <= reach[1])
        spectrum = dt * fft.rfft(samples * window, axis=1)[:, inside]
        power += np.sum(np.abs(spectrum) ** 2, axis=1) / (dt * float(window @ window))
        lines += float(inside.sum())
    if lines < 1.0:
        return None
    # Neighbouring lines of a Hann window share 1.5 of a line.
    return ForceNoise(power / lines, max(lines / 1.5, 1.0))
