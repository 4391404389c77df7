"""Which Stribeck curves a record of motion allows, with their probabilities: a grid of speeds and shapes a direction.

``(Fs - Fc) exp(-(|v|/vs)^shape)`` is linear but for vs and the shape, so that for each pair the rest is least squares.
A record rarely shows vs well, often it does not show whether there is a curve at all. Every curve that it allows
therefore counts with its probability (Bayesian model averaging, Hoeting et al. 1999), "none" among them: before the
record, one half none; vs alike on a logarithmic scale; Fs - Fc with a standard deviation of the friction itself, and
positive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from process.types import Real
from smfe.identification.drive.motion import Balance, Kept, fading
from smfe.identification.drive.results import Estimate
from smfe.identification.drive.rules import RULES


class Curve(NamedTuple):
    """One curve: Stribeck speed and shape, or NaN for none."""

    speed: float
    shape: float


NONE = Curve(math.nan, math.nan)


class Grid(NamedTuple):
    """Curves of one direction, without "none": their columns (n, curves), and probability of each before the record."""

    curves: tuple[Curve, ...]
    columns: Real
    prior: Real
    edges: tuple[float, float]


def grid_of(b: Balance, kept: Sequence[Kept], band: float, way: int) -> Grid:
    """Return the curves that may be looked for in one way of motion; none where it hardly moves this way."""
    size = np.abs(b.velocity[way][b.share[way] > 0.5])
    if not size.size:
        return Grid((), np.zeros((b.run.size, 0)), np.zeros(0), (math.nan, math.nan))
    edges = RULES.slowest * float(size.max()), RULES.fastest * float(size.max())
    return _grid(kept, band, way, np.geomspace(*edges, RULES.speeds), edges, RULES.shapes[::5])


def _grid(
    kept: Sequence[Kept], band: float, way: int, speeds: Real, edges: tuple[float, float], shapes: tuple[float, ...]
) -> Grid:
    """Return the curves of these speeds [m/s or rad/s], of all that lie between `edges`.

    Curves that have faded before the slowest motion are left out: for the record they are none.
    """
    curves = [Curve(float(v), d) for d in shapes for v in speeds]
    sign = 1.0 if way == 0 else -1.0
    columns = sign * np.column_stack([fading(kept, band, way, *curve) for curve in curves])
    there = np.flatnonzero(np.abs(columns).max(axis=0) > RULES.faded)
    prior = RULES.curved * np.tile(_widths(speeds), len(shapes)) / math.log(edges[1] / edges[0]) / len(shapes)
    return Grid(tuple(curves[k] for k in there), columns[:, there], prior[there], edges)


def _widths(speeds: Real) -> Real:
    """Return the width of the cell of each speed on a logarithmic scale."""
    log = np.log(speeds)
    ends = np.concatenate([[log[0]], 0.5 * (log[1:] + log[:-1]), [log[-1]]])
    return np.diff(ends)


def refined(grid: Grid, probability: Real, kept: Sequence[Kept], band: float, way: int) -> Grid:
    """Return a grid of the speeds that matter, where the curves (without none) of a coarser one have a probability."""
    speeds = np.unique([c.speed for c in grid.curves])
    if speeds.size < 2:
        return grid
    weight = np.array([sum(p for p, c in zip(probability, grid.curves, strict=True) if c.speed == v) for v in speeds])
    if not weight.sum() > RULES.rare:
        return grid
    there = np.flatnonzero(weight > RULES.negligible * weight.sum())
    low, high = speeds[max(there[0] - 1, 0)], speeds[min(there[-1] + 1, speeds.size - 1)]
    if high / low > RULES.narrow:
        best = speeds[int(np.argmax(weight))]
        around = best * np.geomspace(1.0 / RULES.near, RULES.near, RULES.fine_speeds)
        coarse = np.geomspace(low, high, RULES.fine_speeds)
        fine = np.concatenate([coarse[(coarse < around[0]) | (coarse > around[-1])], around])
        return _grid(kept, band, way, np.sort(fine), grid.edges, RULES.shapes)
    return _grid(kept, band, way, np.geomspace(low, high, RULES.fine_speeds), grid.edges, RULES.shapes)


class Allowed(NamedTuple):
    """Curves of the two directions together: indices into the grids, -1 for none, and their probability."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    probability: Real


def allowed(
    columns: Real, force: Real, grids: tuple[Grid, Grid], boost: float, independent: float, overconfidence: float = 1.0
) -> Allowed:
    """Return the probability of every pair of curves.

    Parameters
    ----------
    columns : ndarray, shape (n, p)
        Of all else.
    force : ndarray, shape (n,)
        What they and the curves explain.
    grids : tuple of Grid
        Curves forward and backward.
    boost : float
        Standard deviation of Fs - Fc before the record.
    independent : float
        Number of independent values in the residual.
    overconfidence : float, optional
        Number of times that slow motion scatters more than all values do (variance): so much less it says which curve
        it is. Whether there is one is decided without.
    """
    q = np.linalg.qr(columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300))[0]
    y, one, two = (x - q @ (q.T @ x) for x in (force, grids[0].columns, grids[1].columns))
    g, a, cross = [one.T @ y, two.T @ y], [np.sum(one**2, axis=0), np.sum(two**2, axis=0)], one.T @ two
    prior = [np.log(np.concatenate([[1.0 - RULES.curved], k.prior])) for k in grids]

    def log_of(values: float) -> Real:
        power, degrees_of_freedom = float(y @ y), max(values - columns.shape[1] - 2, 2.0)
        best = max(float(np.max(gk**2 / np.maximum(ak, 1e-300), initial=0.0)) for gk, ak in zip(g, a, strict=True))
        least, log = power - best, np.zeros(0)
        for _ in range(2):
            noise = max(least, 1e-12 * power) / degrees_of_freedom
            log, least = _evidence(g, a, cross, noise / boost**2, power, degrees_of_freedom, noise)
        return np.asarray(log + prior[0][:, None] + prior[1][None, :])

    whether, which = log_of(independent), log_of(independent / overconfidence)
    weight = np.zeros(whether.shape)
    for part in (np.s_[:1, :1], np.s_[1:, :1], np.s_[:1, 1:], np.s_[1:, 1:]):
        if whether[part].size:
            weight[part] = np.exp(
                special.logsumexp(whether[part]) - special.logsumexp(whether) + special.log_softmax(which[part])
            )
    first, second = np.indices(weight.shape) - 1
    return Allowed(first.ravel(), second.ravel(), (weight / weight.sum()).ravel())


def _evidence(
    g: list[Real], a: list[Real], cross: Real, ridge: float, power: float, degrees_of_freedom: float, noise: float
) -> tuple[Real, float]:
    """Log evidence of no curve, one and two (1 + J, 1 + K), and the least sum of squares."""
    log = np.zeros((1 + g[0].size, 1 + g[1].size))
    left = np.full(log.shape, power)

    def positive(mean: Real, spread: Real) -> Real:
        return np.asarray(special.log_ndtr(mean / np.maximum(spread, 1e-300)) + math.log(2.0))

    for k, (some, rest) in enumerate(((left[1:, 0], log[1:, 0]), (left[0, 1:], log[0, 1:]))):
        full = a[k] + ridge
        some -= g[k] ** 2 / full
        rest += -0.5 * np.log(full / ridge) + positive(g[k] / full, np.sqrt(noise / full))
    full_0, full_1 = (a[0] + ridge)[:, None], (a[1] + ridge)[None, :]
    determinant = np.maximum(full_0 * full_1 - cross**2, 1e-12 * full_0 * full_1)
    mean_0 = (full_1 * g[0][:, None] - cross * g[1][None, :]) / determinant
    mean_1 = (full_0 * g[1][None, :] - cross * g[0][:, None]) / determinant
    left[1:, 1:] -= g[0][:, None] * mean_0 + g[1][None, :] * mean_1
    log[1:, 1:] = -0.5 * np.log(determinant / ridge**2) + positive(mean_0, np.sqrt(noise * full_1 / determinant))
    log[1:, 1:] += positive(mean_1, np.sqrt(noise * full_0 / determinant))
    left = np.maximum(left, 1e-12 * power)
    return log - 0.5 * degrees_of_freedom * np.log(left), float(left.min())


def drawn(probability: Real, count: int) -> tuple[NDArray[np.int64], Real]:
    """Take at most `count` of the curves, in proportion to their probability: indices, and their shares."""
    ticks = (np.arange(count) + 0.5) / count
    at, number = np.unique(np.searchsorted(np.cumsum(probability) / probability.sum(), ticks), return_counts=True)
    return at, number / count


def speed_interval(curves: Sequence[Curve], probability: Real) -> Estimate:
    """Return median and interval of the Stribeck speed, from curves (without none) and their probabilities."""
    speed = np.array([c.speed for c in curves])
    values = np.unique(speed)
    weight = np.array([probability[speed == v].sum() for v in values])
    edges = np.concatenate([[values[0]], np.sqrt(values[1:] * values[:-1]), [values[-1]]])
    below = np.concatenate([[0.0], np.cumsum(weight) / weight.sum()])
    tail = 0.5 * (1.0 - RULES.level)
    middle, low, high = np.exp(np.interp([0.5, tail, 1.0 - tail], below, np.log(edges)))
    spread = math.sqrt(float(weight @ (values - middle) ** 2 / weight.sum()))
    return Estimate(float(middle), spread, float(low), float(high))
