"""Forces over the angle of the spindle, and the comb of lines at its orders.

Over the angle all that repeats with the spindle lies at whole orders, however the speed changes. Over an angle that is
wrong by a ratio r the lines are at ``k r``.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.labels import axis_present
from process.types import Real
from smfe.identification.spectra.spectra import hann
from smfe.identification.sweep.noise import in_cut

REACH = 0.08
"""Ratios that are looked for lie within 1 and this [1]."""

PASSAGES = 80
"""Tooth passages of a window over the angle."""

STANDS_OUT = 6.0
"""The comb stands above the median of all ratios by so many times what their lower half scatters by."""

LIFTED = 1.3
"""And it is so many times the median [1]."""


def piece_in_cut(record: xr.Dataset) -> slice | None:
    """Return the samples from the first to the last in the cut; None where there are too few."""
    cutting = np.flatnonzero(in_cut(record))
    return slice(int(cutting[0]), int(cutting[-1]) + 1) if cutting.size >= 32 else None


def turns_of(teeth: int | None) -> int:
    """Return the turns of a window: some `PASSAGES` of teeth, a multiple of four."""
    return 4 * max(2, round(0.25 * PASSAGES / (teeth or 6)))


def force_over_angle(record: xr.Dataset, piece: slice, angle: Real, cells: int) -> Real:
    """Return the mean force in each of `cells` equal parts of every turn, shape (axes, cells of all turns).

    Parameters
    ----------
    record : xarray.Dataset
        With force.
    piece : slice
        Samples that are used.
    angle : ndarray, shape (n,)
        At these samples, rising [rad].
    cells : int
        Of a turn.
    """
    force = record["force"].sel(axis=axis_present(record, "force")).values[:, piece]
    rising = np.maximum.accumulate(angle + 1e-9 * np.arange(angle.size))
    turns = int((rising[-1] - rising[0]) / (2.0 * np.pi))
    edges = rising[0] + 2.0 * np.pi / cells * np.arange(turns * cells + 1)
    at = np.interp(edges, rising, np.arange(angle.size))
    total = np.concatenate([np.zeros((force.shape[0], 1)), np.cumsum(force, axis=1)], axis=1)
    sums = np.array([np.interp(at + 0.5, np.arange(angle.size + 1), row) for row in total])
    return np.asarray(np.diff(sums, axis=1) / np.maximum(np.diff(at), 1e-9))


def windows(force: Real, cells: int, turns: int, hop: int) -> Real:
    """Return windows of some turns, every so many turns, shape (axes, windows, cells of all turns)."""
    return np.lib.stride_tricks.sliding_window_view(force, turns * cells, axis=1)[:, :: hop * cells]


def find_comb(force: Real, cells: int, turns: int, highest: int) -> tuple[float, NDArray[np.int64]] | None:
    """Return the ratio whose comb stands out, and the orders that have lines; None where none does."""
    size, pad = turns * cells, 8
    pieces = windows(force, cells, turns, turns // 2)
    power = np.zeros(pad * size // 2 + 1)
    for row in pieces:
        power += np.sum(np.abs(np.fft.rfft(row * hann(size), pad * size, axis=1)) ** 2, axis=0)
    amplitude = np.sqrt(power)
    step = cells / (pad * size)
    reach = REACH
    ratios = 1.0 + np.arange(-reach, reach, 0.5 * step / highest)
    each = [np.interp(k * ratios, step * np.arange(amplitude.size), amplitude) for k in range(1, highest + 1)]
    score = np.sum(each, axis=0)
    best = int(score.argmax())
    typical = float(np.median(score))
    # Beside strong lines the upper half holds their leakage.
    scatter = (typical - float(np.quantile(score, 0.1))) / 1.28
    clear = score[best] > LIFTED * typical and score[best] - typical > STANDS_OUT * min(scatter, 0.2 * typical)
    if not clear or best in (0, ratios.size - 1):
        return None
    heights = np.array([e[best] for e in each])
    floor = np.array([np.median(e) for e in each])
    loud = (heights > 2.0 * floor) & (heights > 0.1 * heights.max())
    if not loud.any():
        return None
    return float(ratios[best]), np.flatnonzero(loud) + 1


def local_ratios(
    force: Real, cells: int, turns: int, orders: NDArray[np.int64], ratio: float
) -> tuple[Real, Real, Real]:
    """Return middle [turns], ratio and weight between successive windows, from the phases of the orders."""
    hop = turns // 4
    pieces = windows(force, cells, turns, hop)
    shape, place = hann(turns * cells), np.arange(turns * cells) / cells
    starts = hop * np.arange(pieces.shape[1])
    for limit in (float(orders.min()), float(orders.max())):
        # The lowest order first: its phase does not come round.
        used = orders[orders <= max(limit, float(orders.min()))]
        drift, weight = np.zeros(starts.size - 1), np.full(starts.size - 1, 1e-300)
        for k in used:
            line = (pieces * shape) @ np.exp(-2j * np.pi * k * ratio * place)
            line = line * np.exp(-2j * np.pi * k * ratio * starts)
            between = np.sum(line[:, 1:] * line[:, :-1].conj(), axis=0)
            drift += k * np.abs(between) * np.angle(between)
            weight += k**2 * np.abs(between)
        local = ratio + drift / weight / (2.0 * np.pi * hop)
        ratio = float(np.sum(weight * local) / np.sum(weight))
    return np.asarray(starts[:-1] + 0.5 * (turns + hop), dtype=float), np.asarray(local), np.asarray(weight)
