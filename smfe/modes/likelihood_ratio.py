"""Modes tested by the lines around them: few poles in a window, everything else a smooth background.

A narrow mode, or a second one within a half-power width, changes little of what a whole record leaves and all of what
its own lines leave. In a window around it, with the fitted poles outside taken away,

    y_g(w) = sum_k [ R_kg/(j w - s_k) + conj(R_kg)/(j w - conj(s_k)) ] + c_g + d_g (f - f_c),

complex R, c, d of every curve solved for, s refined (`smfe.modes.pole_fit`). With chi^2 of m and of m + 1 poles and N
independent real numbers,

    T = N (ln v_m - ln v_(m+1)) + chi^2_m/v_m - chi^2_(m+1)/v_(m+1),    v = max(chi^2/N, floor),

is the likelihood ratio of normal errors with their variance known (floor 1), or known to be no smaller, or unknown
(floor 0). For noise alone T is about chi-square of ``2 + 2 g`` degrees of freedom. Where the residual is more than
noise, N counts lines that belong together once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from process.types import Real
from smfe.modes.pole_fit import NO_REMAINDERS, Bounds, Descent, PoleFit, Remainders, basis_of, correlated_lines, solve
from smfe.modes.pole_fit import refine as refine_poles
from smfe.modes.response_matrix import Curves
from smfe.modes.rules import RULES


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

    def fit(self, poles: Real, iterations: int = 15) -> PoleFit:
        """Return the poles near given ones (frequency [Hz], damping ratio) that describe the window best."""
        start = np.array(poles, dtype=float).reshape(-1, 2)
        start[:, 1] = np.clip(start[:, 1], RULES.least_damping, RULES.most_damping)
        fit = solve(self.curves, start, Remainders(False, False, line=(self.centre, self.half)))
        # Coarser than a fit that is reported: it is compared with a threshold.
        rules = Descent(iterations, tries=7, share=1e-5, damping=1e-2, growth=8.0)
        # Near the first line half of a window may lie below zero, and a pole of negative frequency fits as well there.
        high = self.centre + self.half
        low = max(self.centre - self.half, float(self.curves.frequency[0]) / RULES.beyond, 1e-6 * high)
        return refine_poles(fit, rules, Bounds(low, high))


def window(fit: PoleFit, centre: float, half: float) -> Window | None:
    """Return the lines within `half` [Hz] of a frequency, a least number of them; None where too few are known."""
    f = fit.curves.frequency
    lines = _lines(f, centre, half)
    inside = np.flatnonzero((fit.poles[:, 0] >= f[lines][0]) & (fit.poles[:, 0] <= f[lines][-1]))
    most = RULES.most_window_poles
    if inside.size > most:
        away = np.abs(fit.poles[inside, 0] - centre)
        rank = np.argsort(away)
        half = min(half, 0.9 * float(away[rank[most]]))
        lines = _lines(f, centre, half)
        inside = inside[rank[:most]]
        inside = inside[(fit.poles[inside, 0] >= f[lines][0]) & (fit.poles[inside, 0] <= f[lines][-1])]
    curves = fit.curves.part(lines)
    known = np.isfinite(curves.std)
    used = known.mean(axis=1) > 0.8
    if not used.any():
        return None
    complete = known[used].all(axis=0)
    if complete.sum() < RULES.fewest_window_lines // 2:
        return None
    columns = basis_of(curves, fit.poles, NO_REMAINDERS)
    own = np.zeros(2 * len(fit.poles), dtype=bool)
    own[2 * inside], own[2 * inside + 1] = True, True
    # Remainders belong to the band of the whole fit; the smooth background takes them.
    far = columns[:, ~own] @ fit.coefficient[:, : own.size][:, ~own].T
    curves = curves.part(complete, curves.values - far.T, used).alike()
    return Window(
        curves, tuple(int(k) for k in inside), centre, 0.5 * float(curves.frequency[-1] - curves.frequency[0])
    )


def _lines(f: Real, centre: float, half: float) -> NDArray[np.int64]:
    fewest, most = RULES.fewest_window_lines, RULES.most_window_lines
    low, high = np.searchsorted(f, [centre - half, centre + half])
    middle = int(np.searchsorted(f, centre))
    low, high = min(low, middle - fewest // 2), max(high, middle + fewest // 2)
    low, high = max(0, low, middle - most // 2), min(f.size, high, middle + most // 2)
    if high - low < fewest:  # an end of the record
        low, high = max(0, high - fewest), min(f.size, low + fewest)
    return np.arange(low, high)


def likelihood_ratio(fewer: PoleFit, more: PoleFit) -> float:
    """Return T of more poles against fewer, both fitted to one window."""
    curves = more.curves
    numbers, lines = 2.0 * more.residual.size, curves.error_lines
    least, most = (fit.chi * curves.counted_lines for fit in (more, fewer))
    dof = max(numbers / lines - 2.0 * len(more.poles) - more.coefficient.size, 1.0)
    if not curves.noise_known or least / lines / dof > 1.0 + 2.0 * np.sqrt(2.0 / dof):
        together = max(lines, correlated_lines(more.residual))
        lines, dof = together, max(dof * lines / together, 1.0)
    # A residual of rounding errors is none: two of them are alike.
    rounding = 1e-24 * float(np.sum(np.abs(curves.values * curves.weight) ** 2))
    first, second = (max(chi, rounding) / lines for chi in (most, least))
    if second <= 0.0:
        return 0.0
    floor = 1.0 if curves.noise_known else 0.0
    v = [max(chi / dof, floor) for chi in (first, second)]
    return float(dof * np.log(v[0] / v[1]) + first / v[0] - second / v[1])


def takes_enough(fewer: PoleFit, more: PoleFit) -> bool:
    """Whether the last pole takes away enough where no noise is known and what is left is more than lines scatter.

    What no linear model describes is described better by any further pole, most of all by one within the width of
    another: that is a mode where it takes away nearly all.
    """
    rough = more.curves.rough
    if rough is None:
        return True
    left = np.sum(np.abs(more.residual / more.curves.weight) ** 2 / np.mean(rough**2, axis=1, keepdims=True))
    if left < RULES.like_noise * more.residual.size:
        return True
    half = more.poles[:, 0] * more.poles[:, 1]
    beside = np.abs(more.poles[:-1, 0] - more.poles[-1, 0]) < 2.0 * (half[:-1] + half[-1])
    return more.chi < (RULES.left_beside if beside.any() else RULES.left_alone) * fewer.chi


def threshold(where: Window, p_value: float = RULES.p_value) -> float:
    """Return the value of T that noise alone exceeds with this probability."""
    return float(stats.chi2.isf(p_value, 2 + 2 * len(where.curves.values)))
