"""Modes judged by the lines around them: few poles in a window, everything else a smooth background.

A narrow mode, or a second one within a half-power width, changes little of what a whole record leaves and all of what
its own lines leave. In a window around it, with the fitted poles outside taken away,

    y_g(w) = sum_k [ R_kg/(j w - s_k) + conj(R_kg)/(j w - conj(s_k)) ] + c_g + d_g (f - f_c),

complex R, c, d of every curve solved for, s refined. With chi^2 of m and of m + 1 poles and N independent real numbers,

    T = N (ln v_m - ln v_(m+1)) + chi^2_m/v_m - chi^2_(m+1)/v_(m+1),    v = max(chi^2/N, floor),

is the likelihood ratio of normal errors with their variance known (floor 1), or known to be no smaller, or unknown
(floor 0). By chance alone T is about chi-square of ``2 + 2 g`` degrees of freedom. Where the residual is more than
noise, N counts lines that belong together once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from process.types import Complex, Real
from smfe.modes.pole_fit import (
    LEAST_DAMPING,
    MOST_DAMPING,
    PoleFit,
    Remainders,
    basis_of,
    correlated_lines,
    slopes,
    squares,
    triangular,
)
from smfe.modes.response_matrix import Curves

CHANCE = 1e-9
"""Probability that noise alone calls for a mode: a record has a thousand places to look at."""

DOUBTFUL = 1e-4
"""Probability from which on a second mode is named though it is not taken as one."""

REACH = 8.0
"""Half bandwidths to either side of a mode that belong to its window."""

FEWEST, MOST_LINES = 24, 320
"""Lines of a window."""

MOST_FREE = 5
"""Poles of a window that are refined together."""

LIKE_NOISE = 3.0
"""Power of a residual over that of the scatter of lines up to which it counts as noise."""

TAKEN, TAKEN_BESIDE = 0.5, 0.1
"""Share of a residual that is more than noise which a new pole may leave: alone, and within the width of another."""

GAIN = 1e-5
"""A fit has converged when a step gains no more than this share of chi."""


@dataclass(frozen=True)
class Local:
    """Few poles fitted to a window.

    Parameters
    ----------
    poles : ndarray, shape (m, 2)
        Natural frequency [Hz] and damping ratio.
    coefficient : ndarray, shape (2 m + 4, g)
        Of the columns.
    chi : float
        Weighted sum of squares.
    left : ndarray of complex, shape (g, n)
        Weighted residual.
    """

    poles: Real
    coefficient: Real
    chi: float
    left: Complex


@dataclass(frozen=True)
class Window:
    """A part of a record with the poles that are not its own taken away.

    Parameters
    ----------
    curves : Curves
        Its lines.
    near : tuple of int
        Numbers of the poles that lie in it.
    centre, half : float
        Middle and half width [Hz].
    """

    curves: Curves
    near: tuple[int, ...]
    centre: float
    half: float

    @property
    def floor(self) -> float:
        """Least variance of a weighted real number."""
        return 1.0 if self.curves.noise_known else 0.0


def window(fit: PoleFit, centre: float, half: float) -> Window | None:
    """Return the lines within `half` [Hz] of a frequency, at least `FEWEST`; None where too few are known."""
    f = fit.curves.frequency
    lines = _lines(f, centre, half)
    inside = np.flatnonzero((fit.poles[:, 0] >= f[lines][0]) & (fit.poles[:, 0] <= f[lines][-1]))
    if inside.size > MOST_FREE:
        away = np.abs(fit.poles[inside, 0] - centre)
        rank = np.argsort(away)
        half = min(half, 0.9 * float(away[rank[MOST_FREE]]))
        lines = _lines(f, centre, half)
        inside = inside[rank[:MOST_FREE]]
        inside = inside[(fit.poles[inside, 0] >= f[lines][0]) & (fit.poles[inside, 0] <= f[lines][-1])]
    curves = part(fit.curves, lines)
    known = np.isfinite(curves.std)
    used = known.mean(axis=1) > 0.8
    if not used.any():
        return None
    complete = known[used].all(axis=0)
    if complete.sum() < FEWEST // 2:
        return None
    columns = basis_of(curves, fit.poles, Remainders(False, False))
    own = np.zeros(2 * len(fit.poles), dtype=bool)
    own[2 * inside], own[2 * inside + 1] = True, True
    # Remainders belong to the band of the whole fit; the smooth background takes them.
    far = columns[:, ~own] @ fit.coefficient[:, : own.size][:, ~own].T
    curves = alike(part(curves, complete, curves.values - far.T, used))
    return Window(
        curves, tuple(int(k) for k in inside), centre, 0.5 * float(curves.frequency[-1] - curves.frequency[0])
    )


def alike(curves: Curves) -> Curves:
    """Return curves whose noise levels have one course over frequency: one decomposition serves all."""
    known = np.isfinite(curves.std)
    size = np.sqrt(1.0 / np.mean(1.0 / curves.std**2, axis=1, keepdims=True))
    course = np.sqrt(known.sum(axis=0) / np.sum((size / curves.std) ** 2, axis=0))
    return replace(curves, std=np.where(known, size * course, np.inf))


def _lines(f: Real, centre: float, half: float) -> NDArray[np.int64]:
    low, high = np.searchsorted(f, [centre - half, centre + half])
    middle = int(np.searchsorted(f, centre))
    low, high = min(low, middle - FEWEST // 2), max(high, middle + FEWEST // 2)
    low, high = max(0, low, middle - MOST_LINES // 2), min(f.size, high, middle + MOST_LINES // 2)
    if high - low < FEWEST:  # an end of the record
        low, high = max(0, high - FEWEST), min(f.size, low + FEWEST)
    return np.arange(low, high)


def part(
    curves: Curves, lines: NDArray[np.generic], values: Complex | None = None, used: NDArray[np.bool_] | None = None
) -> Curves:
    """Return some lines of some curves; other values for them where these are given (all curves, all lines)."""
    pick = np.ones(len(curves.values), dtype=bool) if used is None else used
    values = curves.values if values is None else values
    return Curves(
        curves.frequency[lines],
        values[pick][:, lines],
        curves.std[pick][:, lines],
        tuple(p for p, u in zip(curves.pairs, pick, strict=True) if u),
        None,
        curves.error_lines,
        curves.noise_known,
        curves.reciprocity,
        None if curves.rough is None else curves.rough[pick][:, lines],
        width=None if curves.width is None or not curves.width[lines].any() else curves.width[lines],
    )


def fit_window(where: Window, poles: Real, iterations: int = 15) -> Local:
    """Return the poles near given ones that describe a window best (variable projection, Marquardt's damping)."""
    start = np.array(poles, dtype=float).reshape(-1, 2)
    start[:, 1] = np.clip(start[:, 1], LEAST_DAMPING, MOST_DAMPING)
    fit, q = _solved(where, start)
    damping, low, high = 1e-2, where.centre - where.half, where.centre + where.half
    for _ in range(iterations if len(fit.poles) else 0):
        gram, gradient = _normal(where, fit, q)
        width = 2.0 * fit.poles[:, 0] * fit.poles[:, 1]
        for _ in range(7):
            step = np.linalg.lstsq(
                gram + damping * np.diag(np.diag(gram) + 1e-12 * np.trace(gram)), gradient, rcond=None
            )
            change = np.clip(step[0].reshape(-1, 2), -1.0, 1.0)
            moved = np.stack([fit.poles[:, 0] + change[:, 0] * width, fit.poles[:, 1] * np.exp(change[:, 1])], axis=1)
            moved[:, 0] = np.clip(moved[:, 0], low, high)
            moved[:, 1] = np.clip(moved[:, 1], LEAST_DAMPING, MOST_DAMPING)
            tried, further = _solved(where, moved)
            if tried.chi <= fit.chi:
                break
            damping = max(damping, 1e-6) * 8.0
        else:
            return fit
        gain, fit, q, damping = fit.chi - tried.chi, tried, further, damping / 10.0
        if gain <= GAIN * fit.chi:
            break
    return fit


def _columns(where: Window, poles: Real) -> Complex:
    f = where.curves.frequency
    x = (f - where.centre) / where.half
    background = np.stack([np.ones(f.size), 1j * np.ones(f.size), x, 1j * x], axis=1)
    return np.concatenate([basis_of(where.curves, poles, Remainders(False, False)), background], axis=1)


def _solved(where: Window, poles: Real) -> tuple[Local, Real]:
    """Return the best coefficients for given poles, and Q of the columns, weighted as all curves are."""
    curves, columns = where.curves, _columns(where, poles)
    data = (curves.values * curves.weight).T
    stacked = np.concatenate([data.real, data.imag])
    turned = columns * (curves.weight[0] / curves.weight[0].max())[:, None]
    q, r = np.linalg.qr(np.concatenate([turned.real, turned.imag]))
    inside = q.T @ stacked
    coefficient = triangular(r, inside) / curves.weight.max(axis=1)
    left, n = stacked - q @ inside, curves.frequency.size
    return Local(poles, coefficient, float(np.sum(left**2)), (left[:n] + 1j * left[n:]).T), q


def _normal(where: Window, fit: Local, q: Real) -> tuple[Real, Real]:
    """Return Gram matrix and gradient of the projected problem, steps in half-power widths and log of damping."""
    curves, count = where.curves, 2 * len(fit.poles)
    scale = np.stack([2.0 * fit.poles[:, 0] * fit.poles[:, 1], fit.poles[:, 1]], axis=1).ravel()
    square = squares(curves, fit.poles)
    each = [
        slopes(square, fit.poles, own) * w[:, None] for own, w in zip(fit.coefficient.T, curves.weight, strict=True)
    ]
    every = np.stack(each, axis=2) * scale[:, None]
    stacked = np.concatenate([every.real, every.imag]).reshape(len(q), -1)
    outside = (stacked - q @ (q.T @ stacked)).reshape(len(q), count, -1)
    left = np.concatenate([fit.left.real, fit.left.imag], axis=1)
    flat = outside.transpose(1, 2, 0).reshape(count, -1)
    return flat @ flat.T, flat @ left.ravel()


def evidence(where: Window, fewer: Local, more: Local) -> float:
    """Return T of more poles against fewer."""
    numbers, lines = 2.0 * more.left.size, where.curves.error_lines
    freedom = max(numbers / lines - 2.0 * len(more.poles) - more.coefficient.size, 1.0)
    if not where.curves.noise_known or more.chi / lines / freedom > 1.0 + 2.0 * np.sqrt(2.0 / freedom):
        together = max(lines, correlated_lines(more.left))
        lines, freedom = together, max(freedom * lines / together, 1.0)
    # A residual of rounding errors is none: two of them are alike.
    least = 1e-24 * float(np.sum(np.abs(where.curves.values * where.curves.weight) ** 2))
    first, second = (max(fit.chi, least) / lines for fit in (fewer, more))
    if second <= 0.0:
        return 0.0
    v = [max(chi / freedom, where.floor) for chi in (first, second)]
    return float(freedom * np.log(v[0] / v[1]) + first / v[0] - second / v[1])


def takes_enough(where: Window, fewer: Local, more: Local) -> bool:
    """Whether the last pole takes away enough where no noise is known and what is left is more than lines scatter.

    What no linear model describes is described better by any further pole, most of all by one within the width of
    another: that is a mode where it takes away nearly all.
    """
    rough = where.curves.rough
    if rough is None:
        return True
    left = np.sum(np.abs(more.left / where.curves.weight) ** 2 / np.mean(rough**2, axis=1, keepdims=True))
    if left < LIKE_NOISE * more.left.size:
        return True
    half = more.poles[:, 0] * more.poles[:, 1]
    beside = np.abs(more.poles[:-1, 0] - more.poles[-1, 0]) < 2.0 * (half[:-1] + half[-1])
    return bool(more.chi < (TAKEN_BESIDE if beside.any() else TAKEN) * fewer.chi)


def threshold(where: Window, chance: float = CHANCE) -> float:
    """Return the value of T that chance exceeds with this probability."""
    return float(stats.chi2.isf(chance, 2 + 2 * len(where.curves.values)))
