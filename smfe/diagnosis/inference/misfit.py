"""Whether residuals are more than noise: in all, smooth along a condition, or gathered in one condition or one kind.

Every test is of squares of residuals over the covariance that they have when the model is right, so that each has a
chi-square law, or Fisher's F where the noise was measured itself; the smallest of their p-values counts, times the
number of tests (Bonferroni). The smooth part is the slowest cosines of every second value, which are smooth too where
real and imaginary parts alternate: white noise has little there, a missing effect much. Of a kind of values, such as
one order of the spindle, the mean of the squares over the conditions is held against the law of one condition: what a
model may miss of it it misses in all of them alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from process.types import Real
from smfe.diagnosis.inference.rules import RULES


@dataclass(frozen=True)
class Misfit:
    """What residuals look like against noise."""

    p_value: float  # probability that noise alone looks as bad in any of the tests
    chi2: float
    degrees_of_freedom: float  # chi2 that noise would give
    by_condition: Mapping[int, float]  # p-value of each condition by itself

    @property
    def ratio(self) -> float:
        """``chi2/degrees_of_freedom``: one for noise."""
        return self.chi2 / max(self.degrees_of_freedom, 1.0)


Group = tuple[Mapping[int, Real], Mapping[int, Real]]
"""Whitened residuals of some conditions, (n,), and the rows of L, (n, p), that they share an error through."""

Kinds = Mapping[int, NDArray[np.int64]]
"""Condition -> kind of each of its values, (n,)."""


@dataclass(frozen=True)
class NoiseKnowledge:
    """Degrees of freedom with which the noise that residuals are whitened by is known."""

    common: float = math.inf  # of what all conditions have in common: their slow noise
    own: Mapping[int, float] = field(default_factory=dict)
    """Of each condition by itself, whose noise was measured with it; none: it is known."""

    def of(self, row: int) -> float:
        """Of one condition."""
        return min(self.common, self.own.get(row, math.inf))

    def together(self, sizes: Mapping[int, int]) -> float:
        """Of the sum over conditions of some sizes, by their own: ``(sum n)^2/sum(n^2/nu)`` (Satterthwaite)."""
        spread = sum(n**2 / self.own.get(row, math.inf) for row, n in sizes.items())
        return float(sum(sizes.values()) ** 2 / spread) if spread > 0.0 else math.inf

    def parted(self, rows: Mapping[int, int], parts: int) -> NoiseKnowledge:
        """Of parts of the conditions, one of `parts` equal ones each: part -> its condition."""
        return NoiseKnowledge(self.common, {k: self.own[r] / parts for k, r in rows.items() if r in self.own})


KNOWN = NoiseKnowledge()
"""Of noise that is known."""


def assess(groups: Sequence[Group], shrinks: bool, noise: NoiseKnowledge = KNOWN, kinds: Kinds | None = None) -> Misfit:
    """Test residuals whose covariance is ``I - L L^T`` (fitted: it shrinks) or ``I + L L^T`` (held out).

    Where the noise was measured itself, Fisher's F takes the place of chi-square. Of conditions whose values are of
    several `kinds` each of these is tested, too.
    """
    sign = -1.0 if shrinks else 1.0
    whole = slow = np.zeros(2)
    own: dict[int, float] = {}
    sizes: dict[int, int] = {}
    for residual, load in groups:
        filters = {k: _slow(residual[k].size) for k in residual}
        parts = {k: (f @ residual[k], f @ load[k]) for k, f in filters.items()}
        whole = whole + _square(*_joined([(residual[k], load[k]) for k in residual]), sign)
        slow = slow + _square(*_joined(list(parts.values())), sign)
        for k in residual:
            both = _square(residual[k], load[k], sign), _square(*parts[k], sign)
            own[k] = min(1.0, 2.0 * min(_p_value(b, noise.of(k)) for b in both))
            sizes[k] = residual[k].size
    if not own:
        return Misfit(1.0, 0.0, 0.0, {})
    known = noise.together(sizes)
    tests = [_p_value(whole, known), _p_value(slow, min(noise.common, known)), min(own.values()) * len(own)]
    if kinds:
        tests.append(_of_kinds(groups, kinds, sign, min(noise.of(r) for r in own)))
    return Misfit(min(1.0, len(tests) * min(tests)), float(whole[0]), float(whole[1]), own)


def _of_kinds(groups: Sequence[Group], kinds: Kinds, sign: float, degrees_of_freedom: float) -> float:
    """Return the p-value of the kind of values that looks worst, times the number of kinds."""
    squares: dict[int, list[Real]] = {}
    for residual, load in groups:
        for r in residual.keys() & kinds.keys():
            for kind in np.unique(kinds[r]):
                mine = kinds[r] == kind
                squares.setdefault(int(kind), []).append(_square(residual[r][mine], load[r][mine], sign))
    every = (_p_value(np.mean(s, axis=0), degrees_of_freedom) for s in squares.values())
    return min(every, default=1.0) * len(squares)


def _joined(parts: Sequence[tuple[Real, Real]]) -> tuple[Real, Real]:
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _p_value(square: Real, degrees_of_freedom: float = math.inf) -> float:
    if square[1] <= 0.0:
        return 1.0
    if math.isinf(degrees_of_freedom):
        return float(stats.chi2.sf(square[0], square[1]))
    return float(stats.f.sf(square[0] / square[1], square[1], degrees_of_freedom))


def _square(r: Real, load: Real, sign: float) -> Real:
    """Squares over the covariance ``I +- L L^T`` and their degrees of freedom; without what a fit took."""
    if load.shape[1] == 0:
        return np.array([float(r @ r), float(r.size)])
    # The squares of the singular values of L, and of what r has along its directions times those: by the smaller of
    # the products of L with itself.
    if load.shape[0] > load.shape[1]:
        size, vectors = _eigen(load.T @ load)
        along = (vectors.T @ (load.T @ r)) ** 2
    else:
        size, vectors = _eigen(load @ load.T)
        along = (vectors.T @ r) ** 2 * size
    variance = 1.0 + sign * size
    # Where the fit has taken nearly all the noise, what is left is how well it has converged.
    lost = variance < RULES.least_left
    taken = np.sum(along[lost] / size[lost]) + sign * np.sum(along[~lost] / variance[~lost])
    return np.array([max(float(r @ r - taken), 0.0), float(r.size - lost.sum())])


def _eigen(square: Real) -> tuple[Real, Real]:
    """Return the eigenvalues of a matrix of products, none below zero, and its eigenvectors."""
    values, vectors = np.linalg.eigh(square)
    return np.maximum(values, 0.0), vectors


def decomposed(matrix: Real) -> tuple[Real, Real, Real]:
    """Return the singular value decomposition of a matrix, as `numpy.linalg.svd` without what is not needed.

    Divide and conquer gives up on some matrices that are nothing special; iteration by QR does not.
    """
    try:
        left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        left, singular, right = linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return left, singular, right


def triangle(columns: Real) -> Real | None:
    """Return R of ``columns = Q R`` of many rows, by the products of the columns; None where these hardly differ.

    That takes a sixth of the time, and costs the square of the condition of the columns times rounding.
    """
    if columns.shape[0] < RULES.many:
        return None
    square = columns.T @ columns
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    try:
        upper = np.asarray(np.linalg.cholesky(square / np.outer(size, size)).T)
    except np.linalg.LinAlgError:
        return None
    return upper * size if np.diag(upper).min(initial=1.0) > RULES.independent else None


def _slow(n: int) -> Real:
    """Return the slowest cosines of the even and of the odd values, orthonormal, (2 RULES.slow_cosines, n)."""
    rows = np.zeros((2, RULES.slow_cosines, n))
    for first in (0, 1):
        count = rows[first, :, first::2].shape[1]
        order = np.arange(min(RULES.slow_cosines, count))[:, None]
        cosines = np.cos(np.pi * (np.arange(count) + 0.5) * order / max(count, 1))
        rows[first, : order.size, first::2] = cosines * np.sqrt((2.0 - (order == 0)) / max(count, 1))
    flat = rows.reshape(2 * RULES.slow_cosines, n)
    return np.asarray(flat[np.any(flat != 0.0, axis=1)])


def carriers(found: Misfit, most: int = 5) -> Sequence[int]:
    """Return the conditions that carry a misfit, the worst first: those that would be rare by themselves."""
    ordered = sorted(found.by_condition, key=lambda k: found.by_condition[k])
    rare = [k for k in ordered if found.by_condition[k] * len(ordered) < 0.05]
    return (rare or ordered[:1])[:most]
