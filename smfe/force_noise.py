"""Noise of the force channels: from the air before and after the cut, bounded by what the cut has between its lines.

Noise on the inputs makes every least squares estimate too small, ``E[Phi_hat] = Phi (1 - N (F F^H)^-1)``. With N known
it is subtracted from the normal equations (bias-compensated least squares: Stoica and Soderstrom 1982); how well N is
known is charged to the estimate.

What is quiet need not be air: a tool that rubs and a cut that fades have lines at the orders of the spindle, and noise
lies between them, too. So N is a median over lines, of the quietest pieces, and at most what the cut itself shows
between its lines: the noise of a sensor does not fall while it cuts. Where no air was recorded that bound is all there
is, and N is anything up to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage

from process.labels import axis_present, sample_interval
from smfe.spectra import hann

Real = NDArray[np.float64]

MARGIN = 0.1
"""Time that is left out on either side of the cut [s]."""

SHORTEST = 0.2
"""Air in one piece from which a spectrum is taken [s]."""


WINDOW = 1.0
"""Pieces of the cut in which its floor is looked for [s]."""

ALIKE = 0.1
"""Relative standard deviation of a noise power that no number of lines takes away: it need not be white."""

BOUNDED = 0.8
"""Relative standard deviation of a noise power of which only a bound is known."""

SAME = 2.5
"""Pieces of air belong to the quietest while they are louder by fewer standard deviations of their logarithm."""


@dataclass(frozen=True)
class ForceNoise:
    """Power of the noise of each force.

    Parameters
    ----------
    density : ndarray, shape (e,)
        Two-sided power spectral density [N2/Hz] over the band.
    spread : float
        Its relative standard deviation.
    air : bool
        Whether it was seen in the air; else it is the bound, and no more than that is known.
    """

    density: Real
    spread: float
    air: bool


def in_cut(record: xr.Dataset) -> NDArray[np.bool_]:
    """Mark the samples in the cut: force over 50 ms above a fifth of its upper quartile."""
    level = force_level(record)
    return np.asarray(level > 0.2 * np.quantile(level, 0.75))


def force_level(record: xr.Dataset) -> Real:
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
    level = force_level(record)
    loud, quiet = float(np.quantile(level, 0.75)), float(level.min())
    if not quiet < 0.5 * loud:
        return []
    cutting = np.flatnonzero(level > quiet + 0.2 * (loud - quiet))
    dt, n = sample_interval(record), level.size
    margin, shortest = round(MARGIN / dt), max(8, round(SHORTEST / dt))
    pieces = slice(0, max(int(cutting[0]) - margin, 0)), slice(min(int(cutting[-1]) + margin, n), n)
    return [p for p in pieces if p.stop - p.start >= shortest]


def force_noise(records: Sequence[xr.Dataset], axes: list[str], reach: tuple[float, float]) -> ForceNoise | None:
    """Return the noise of the forces of records of one sensor within a band [Hz]; None where they are too short.

    Parameters
    ----------
    records : sequence of xarray.Dataset
        With force.
    axes : list of str
        Of the forces.
    reach : (float, float)
        Band [Hz].
    """
    pieces, floors = [], []
    for record in records:
        dt, force = sample_interval(record), record["force"].sel(axis=axes).values
        found = [density_of(force[:, piece], dt, reach, 0.5) for piece in air_pieces(record)]
        pieces += [f for f in found if f[1] >= 1.0]
        floors += _floor_of_cut(force, np.flatnonzero(in_cut(record)), dt, reach)
    bound = np.median(floors, axis=0) if floors else np.full(len(axes), np.inf)
    if not pieces:
        return ForceNoise(bound, BOUNDED, False) if floors else None
    together = [
        _quietest(np.array([p[0][i] for p in pieces]), np.array([p[1] for p in pieces])) for i in range(len(axes))
    ]
    density = np.minimum([value for value, _ in together], bound)
    return ForceNoise(density, float(np.hypot(max(spread for _, spread in together), ALIKE)), True)


def _quietest(power: Real, lines: Real) -> tuple[float, float]:
    """Return the mean power of the pieces that are as quiet as the quietest, and its relative standard deviation."""
    independent = 1.0 / median_spread(lines) ** 2
    total, weight = 0.0, 0.0
    for i in np.argsort(power):
        apart = SAME * np.sqrt(1.0 / independent[i] + (1.0 / weight if weight else 0.0))
        if weight and power[i] * weight > total * np.exp(apart):
            break
        total, weight = total + independent[i] * power[i], weight + independent[i]
    return total / weight, float(1.0 / np.sqrt(max(weight, 1.0)))


def median_spread(lines: ArrayLike) -> Real:
    """Return the relative standard deviation of a noise power that is a median of lines.

    The logarithm of a median of n lines of noise scatters by ``sqrt(pi/2/n)``, and neighbouring lines of a Hann window
    share 1.5 of a line.

    Parameters
    ----------
    lines : array_like
        Lines of a Hann window.
    """
    return np.asarray(np.sqrt(1.5 * 0.5 * np.pi / np.maximum(lines, 1.0)))


def density_of(samples: Real, dt: float, reach: tuple[float, float], quantile: float) -> tuple[Real, float]:
    """Return the density of white noise [N2/Hz] whose lines have the quantile that the samples have; and the lines."""
    samples = samples - samples.mean(axis=1, keepdims=True)
    window = hann(samples.shape[1])
    frequency = fft.rfftfreq(samples.shape[1], dt)
    # The lowest lines hold the window and the drift of the charge amplifier.
    inside = (frequency >= max(reach[0], 3.0 * frequency[1])) & (frequency <= reach[1])
    if not inside.any():
        return np.zeros(samples.shape[0]), 0.0
    power = dt * np.abs(fft.rfft(samples * window, axis=1)[:, inside]) ** 2 / float(window @ window)
    return np.quantile(power, quantile, axis=1) / -np.log1p(-quantile), float(inside.sum())


def _floor_of_cut(force: Real, cutting: NDArray[np.int64], dt: float, reach: tuple[float, float]) -> list[Real]:
    """Return what each piece of the cut has between its lines [N2/Hz]: a lower quartile."""
    size = round(WINDOW / dt)
    if cutting.size < 2 or cutting[-1] - cutting[0] < size:
        return []
    starts = range(int(cutting[0]), int(cutting[-1]) - size + 1, max(1, size // 2))
    return [density_of(force[:, s : s + size], dt, reach, 0.25)[0] for s in starts]
