"""Neighbouring lines of a fine record merged into their mean wherever the response between them is smooth.

A record of 64,000 lines says most things many times. Blocks of 2, 4, ... lines are merged while no curve departs from
a straight line by more than its noise explains, or by more than a small share of its size. The model of a merged line
is the mean of the model over its lines, by three nodes of Gauss (`Curves.over_lines`), so that merging
moves no pole: for a pole at the distance a from a block of width w the error is ``3.6e-4 (w/a)^6`` of its share.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smfe.modes.response_matrix import Curves
from smfe.modes.rules import RULES


def merged(curves: Curves) -> Curves:
    """Return curves with the mean of neighbouring lines wherever these lie on a straight line.

    Lines stay as they are where they are few, unevenly spaced or share errors.
    """
    n = curves.frequency.size
    spacing = np.diff(curves.frequency)
    if n < RULES.enough_lines or curves.error_lines > 1.0 or np.ptp(spacing) > 1e-3 * float(np.median(spacing)):
        return curves
    start, length = _blocks(curves)
    edges = np.unique(start)
    count = length[edges].astype(float)

    def mean(values: Any, axis: int) -> Any:
        shape = [1] * values.ndim
        shape[axis] = -1
        return np.asarray(np.add.reduceat(values, edges, axis=axis) / count.reshape(shape))

    return replace(
        curves,
        frequency=mean(curves.frequency, 0),
        values=mean(curves.values, 1),
        std=np.sqrt(mean(curves.std**2, 1) / count),
        rough=None if curves.rough is None else np.sqrt(mean(curves.rough**2, 1) / count),
        covariance=None if curves.covariance is None else mean(curves.covariance, 0) / count[:, None, None],
        width=np.sqrt(count**2 - 1.0) * float(np.median(spacing)),
        record_lines=n,
    )


def _blocks(curves: Curves) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for every line the first line of its block, and the length of the block."""
    n = curves.frequency.size
    spacing = float(np.median(np.diff(curves.frequency)))
    noise = curves.std if curves.rough is None else curves.rough
    length, start = np.ones(n, dtype=np.int64), np.arange(n)
    k = 2
    while k <= min(RULES.longest_block, n):
        blocks = n // k
        inside = slice(0, blocks * k)
        x = (np.arange(k) - 0.5 * (k - 1)) / k
        h = curves.values[:, inside].reshape(-1, blocks, k)
        s = noise[:, inside].reshape(-1, blocks, k)
        middle = h.mean(axis=2)
        slope = np.einsum("gbk,k->gb", h, x) / np.sum(x**2)
        # Two points always lie on a line: their own difference has to be small then.
        away = np.mean(np.abs(h) ** 2, axis=2) - np.abs(middle) ** 2
        away = np.maximum(away - (np.abs(slope) ** 2 * np.mean(x**2) if k > 2 else 0.0), 0.0)
        size = np.mean(np.abs(h) ** 2, axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            power = np.mean(s**2, axis=2)
            surprise = RULES.departure_of_few if k <= RULES.few else RULES.departure
            allowed = 1.0 + surprise / np.sqrt(k)
            alone = away <= allowed * power + RULES.smooth**2 * size
            # All curves together see a peak that none sees alone.
            excess = np.mean(np.maximum(away - RULES.smooth**2 * size, 0.0) / power, axis=0)
        smooth = np.isfinite(s).all(axis=(0, 2)) & alone.all(axis=0)
        smooth &= excess < 1.0 + surprise / np.sqrt(k * len(h))
        smooth &= (length[inside].reshape(blocks, k) == k // 2).all(axis=1)
        smooth &= k * spacing < RULES.widest * curves.frequency[inside].reshape(blocks, k)[:, 0]
        at = (np.flatnonzero(smooth)[:, None] * k + np.arange(k)).ravel()
        length[at] = k
        start[at] = at // k * k
        k *= 2
    return start, length
