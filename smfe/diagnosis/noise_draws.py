"""How well the noise of a drive record is known: noises that the same few moves could as well have come from.

A whitener is learned from the record that it whitens. Records are drawn from it and it is learned again from each of
them (parametric bootstrap; Efron and Tibshirani 1993, chapter 6). As the estimate scatters about the truth in the
draws, so the truth is held to scatter about the estimate: where a draw gives a power density ``S_j`` for ``S``, the
noise may be ``S^2/S_j``, which turns a normal law into Student's and a chi-square into Fisher's F.

In whitened values such a noise is the white one passed through ``A_j(z) sigma/(A(z) sigma_j)``, times what the draws
say of the kind of move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from smfe.diagnosis.drive_noise import Whitener, freedom_left, learned_again
from smfe.diagnosis.drive_signals import Real

_DRAWS = 40
_FADES = 200
"""Values before the first by which the noise has forgotten how it began."""


@dataclass(frozen=True)
class NoiseDraw:
    """One noise that the moves could have come from.

    Parameters
    ----------
    above, below : ndarray, shape (p + 1,)
        Filter from white noise to the whitened values that it would give.
    size : mapping
        Kind of move -> its standard deviation over that of the whitener.
    """

    above: Real
    below: Real
    size: dict[object, float]

    def coloured_products(self, columns: Real) -> Real:
        """Return ``H^T X``, whose squares are the covariance of ``X^T e`` with ``e = H white``; X of shape (n, m)."""
        padded = np.concatenate([columns[::-1], np.zeros((_FADES, columns.shape[1]))])
        return np.asarray(signal.lfilter(self.above, self.below, padded, axis=0))


def noise_draws(
    whitener: Whitener, residuals: Sequence[Real], regressors: Real, kinds: Sequence[object]
) -> tuple[NoiseDraw, ...]:
    """Learn a whitener again from records that it would give.

    Parameters
    ----------
    whitener : Whitener
        As it was learned.
    residuals : sequence of ndarray
        What the reference left in each move.
    regressors : ndarray, shape (n, k)
        The reference.
    kinds : sequence
        Kind of each move.
    """
    below = np.concatenate(([1.0], whitener.coefficients))
    expected: dict[object, float] = {}
    for kind, freedom in zip(kinds, freedom_left(whitener, residuals, regressors), strict=True):
        expected[kind] = expected.get(kind, 0.0) + freedom
    found = []
    for again, moves in learned_again(whitener, residuals, regressors, _DRAWS):
        if not again.stable:
            continue
        squares = dict.fromkeys(expected, 0.0)
        for kind, left in zip(kinds, moves, strict=True):
            squares[kind] += float(np.sum(np.square(again(left))))
        size = {kind: float(np.sqrt(expected[kind] / squares[kind])) for kind in expected}
        above = np.concatenate(([1.0], again.coefficients)) * whitener.sigma / again.sigma
        found.append(NoiseDraw(above, below, size))
    return tuple(found)
