"""Zero-order limits of many candidates at once on the grid of their plant; `stability.zero_order` for the search.

For an eigenvalue ``mu`` of ``A0 Phi(f)`` with ``Re mu > 0`` the depth is ``1/(2 Re mu)`` at the tooth periods
``T = (1/2 + arg(mu)/pi + k)/f``, k = 0, 1, ... (`stability.methods.zero_order`). The least depth over a *range* of
speeds needs no list of speeds: a point of a branch counts when one of its periods lies within the range, and at the two
ends of the range the depth is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from process.types import Complex, Real
from smfe.tuning.rules import RULES
from stability.methods import _zero_order_kernels as kernels


@dataclass(frozen=True)
class Oriented:
    """The directional matrix as it acts on a machine that gives way in some directions only.

    Parameters
    ----------
    directions : tuple of int
        These directions.
    left, right : ndarray
        ``A0 = left right`` on them, of full rank r: shapes (d, r), (r, d).
    """

    directions: tuple[int, ...]
    left: Complex
    right: Complex

    @classmethod
    def of(cls, directional: Complex, directions: tuple[int, ...]) -> Oriented:
        """Return the part of a directional matrix [N/m2], shape (3, 3), for some directions."""
        part = np.asarray(directional, dtype=complex)[np.ix_(directions, directions)]
        u, size, v = np.linalg.svd(part)
        rank = max(1, int(np.sum(size > 1e-12 * size[0])))
        return cls(directions, u[:, :rank] * size[:rank], v[:rank])

    def both(self, tool: Complex) -> Complex:
        """Return compliances, shape (f, 3, 3), as the cut sees them, (f, r, r): their eigenvalues are mu."""
        at = list(self.directions)
        return np.ascontiguousarray(self.right @ tool[:, at][:, :, at] @ self.left)

    def rows(self, reach: Complex) -> Complex:
        """Return motions of the tool, shape (f, 3, a), as the cut sees them, (f, r, a)."""
        return np.ascontiguousarray(self.right @ reach[:, list(self.directions)])

    def columns(self, back: Complex) -> Complex:
        """Return effects of forces on the tool, shape (f, a, 3), as the cut exerts them, (f, a, r)."""
        return np.ascontiguousarray(back[:, :, list(self.directions)] @ self.left)


def branches(matrix: Complex) -> Complex:
    """Return mu [1/m], shape (c, r, f), each row a branch, of matrices that a cut sees, (c, f, r, r)."""
    rank = matrix.shape[-1]
    if rank == 1:
        return np.ascontiguousarray(matrix[..., 0, 0][:, None])
    if rank == 2:
        return _two(matrix)
    flat = kernels.eigenvalues(np.ascontiguousarray(matrix).reshape(-1, rank, rank))
    return np.ascontiguousarray(np.moveaxis(flat.reshape(*matrix.shape[:2], rank), 2, 1))


def _two(m: Complex) -> Complex:
    """Eigenvalues of 2x2 matrices, shape (c, f, 2, 2), as branches that do not swap; shape (c, 2, f)."""
    half = 0.5 * (m[..., 0, 0] + m[..., 1, 1])
    turn = np.sqrt(0.25 * (m[..., 0, 0] - m[..., 1, 1]) ** 2 + m[..., 0, 1] * m[..., 1, 0])
    # The sign of the root is followed: it changes where its real part would jump.
    jumps = (turn[:, 1:] * turn[:, :-1].conj()).real < 0.0
    sign = np.concatenate([np.ones((turn.shape[0], 1)), np.where(np.cumsum(jumps, axis=1) % 2, -1.0, 1.0)], axis=1)
    return np.stack([half + sign * turn, half - sign * turn], axis=1)


def least_depth(frequency: Real, mu: Complex, periods: tuple[float, float]) -> Real:
    """Return the least limit [m] over a range of tooth periods [s], shape (c,), for branches, shape (c, r, f)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(mu.real > 0.0, 0.5 / mu.real, np.inf)
    turns = 0.5 + np.angle(mu) / np.pi
    low, high = frequency * periods[0] - turns, frequency * periods[1] - turns
    within = np.floor(high) >= np.maximum(np.ceil(low), 0.0)
    inside = np.where(within, depth, np.inf).min(axis=(1, 2))
    ends = limits(frequency, mu, np.array(periods)).min(axis=1)
    return np.asarray(np.minimum(np.minimum(inside, ends), RULES.deepest))


def limits(frequency: Real, mu: Complex, period: Real) -> Real:
    """Return the limit [m] at tooth periods [s], shape (c, periods), for branches, shape (c, r, f)."""
    out = np.empty((mu.shape[0], period.size))
    turns = 0.5 + np.angle(mu) / np.pi
    positive = mu.real > 0.0
    both = positive[..., :-1] & positive[..., 1:]
    for i, one in enumerate(period):
        waves = frequency * one - turns
        whole = np.maximum(np.floor(waves[..., :-1]), np.floor(waves[..., 1:]))
        step = waves[..., 1:] - waves[..., :-1]
        crosses = both & (np.floor(waves[..., :-1]) != np.floor(waves[..., 1:])) & (whole >= 0.0)
        share = np.where(crosses, (whole - waves[..., :-1]) / np.where(step == 0.0, 1.0, step), 0.0)
        at = mu.real[..., :-1] + share * (mu.real[..., 1:] - mu.real[..., :-1])
        out[:, i] = np.where(crosses, 0.5 / np.where(crosses, at, 1.0), np.inf).min(axis=(1, 2))
    return np.asarray(np.minimum(out, RULES.deepest))
