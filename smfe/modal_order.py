"""How many modes: poles are added while the whole record says so, and taken away where it does not.

Starting from none, the pole that explains most of what is left is added, all poles are refined together, and the
Bayesian information criterion of the whole matrix decides. Proposals are the candidates of the stabilisation diagram,
a grid over frequency and damping for what the diagram does not show, and a pole split in two for close modes that
look like one. In the end the pole that matters least, and remainders, are taken away as long as the criterion falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from smfe.modal_data import Curves
from smfe.modal_fit import PoleFit as Fit
from smfe.modal_fit import Remainders, basis, refine, solve, sorted_fit, without

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

GRID_DAMPING = (0.005, 0.02, 0.08)
"""Damping ratios of the grid of proposals."""

DIAGRAM_FIRST = 0.7
"""Share of the largest gain from which on a candidate of the diagram is preferred."""

ENOUGH_LINES = 500
"""The number of modes is looked for on every second, third, ... line of a record that has many more."""

SPLITS = ((0.5, 0.7), (1.0, 1.0))
"""Distance of two poles from the one that they replace, in its half bandwidths, and their damping over its."""


@dataclass(frozen=True)
class OrderRules:
    """How many modes are looked for.

    Parameters
    ----------
    most : int, optional
        No more poles than this.
    quick : int, optional
        Iterations after each pole that is added.
    """

    most: int = 24
    quick: int = 8


def choose(curves: Curves, candidates: Real, rules: OrderRules | None = None) -> Fit:
    """Return the fit whose number of poles and remainders has the least information criterion.

    Parameters
    ----------
    curves : Curves
        What was measured.
    candidates : ndarray, shape (c, 2 or more)
        Frequency [Hz] and damping ratio of proposals, e.g. of a stabilisation diagram.
    rules : OrderRules, optional
        How many are looked for.

    Raises
    ------
    InputError
        When no pole explains more than the noise does.
    """
    rules = rules or OrderRules()
    full, curves = curves, curves.thinned(_step(curves, candidates))
    fit = solve(curves, np.empty((0, 2)), Remainders())
    while len(fit.poles) < rules.most and _room(fit):
        better = _added(fit, candidates, rules) or _split(fit, rules)
        if better is None:
            break
        fit = better
    if not len(fit.poles):
        raise InputError(
            "no mode stands out of the noise of this compliance; measure it with more force or more repeats, or give "
            "the band around a resonance"
        )
    fit = _fewer(_fewer_remainders(refine(fit)), rules)
    return fit_poles(full, fit.poles, fit.remainders) if full is not curves else sorted_fit(fit)


def _step(curves: Curves, candidates: Real) -> int:
    """Return how many lines a step may take while the number of modes is looked for: the narrowest keeps a few."""
    if not len(candidates) or curves.frequency.size < 2 * ENOUGH_LINES:
        return 1
    narrowest = float(np.min(2.0 * candidates[:, 0] * candidates[:, 1]))
    spacing = float(np.median(np.diff(curves.frequency)))
    return int(max(1, min(curves.frequency.size // ENOUGH_LINES, narrowest / (6.0 * spacing))))


def fit_poles(curves: Curves, poles: Real, remainders: Remainders | None = None) -> Fit:
    """Return the maximum-likelihood fit near given poles (frequency [Hz], damping ratio), their number kept."""
    return sorted_fit(refine(solve(curves, np.asarray(poles, dtype=float), remainders or Remainders())))


def _room(fit: Fit) -> bool:
    """Whether the data outnumber the unknowns of one pole more."""
    more = 2 + 2 * len(fit.coefficient)
    return fit.curves.real_data > 1.5 * (fit.unknowns + more)


def _added(fit: Fit, candidates: Real, rules: OrderRules) -> Fit | None:
    """Return the fit with the pole that explains most of what is left, None when the criterion says no."""
    proposals = np.concatenate([candidates[:, :2], _grid(fit.curves.frequency)])
    gain = _gains(fit, proposals)
    # The diagram knows poles that the grid only comes near: where it proposes nearly as much, it goes first.
    top, stable = int(np.argmax(gain)), gain[: len(candidates)]
    if stable.size and stable.max() > DIAGRAM_FIRST * gain[top]:
        top = int(np.argmax(stable))
    return _best(fit, [np.concatenate([fit.poles, proposals[[top]]])], rules)


def _split(fit: Fit, rules: OrderRules) -> Fit | None:
    """Return the fit with one of its poles split in two, None when the criterion says no."""
    starts = []
    for number, (natural, damping) in enumerate(fit.poles):
        for shift, factor in SPLITS:
            pair = [[natural * (1.0 + side * shift * damping), factor * damping] for side in (-1.0, 1.0)]
            starts.append(np.concatenate([np.delete(fit.poles, number, axis=0), pair]))
    tried = sorted((solve(fit.curves, start, fit.remainders) for start in starts), key=lambda f: f.chi)
    return _best(fit, [f.poles for f in tried[:2]], rules)


def _best(fit: Fit, starts: list[Real], rules: OrderRules) -> Fit | None:
    """Return the refined start with the least criterion, None when it is not below that of the fit."""
    tried = [refine(solve(fit.curves, start, fit.remainders), rules.quick) for start in starts]
    if not tried:
        return None
    best = min(tried, key=lambda f: f.information)
    return best if best.information < fit.information else None


def _grid(frequency: Real) -> Real:
    """Return frequencies and damping ratios half a bandwidth apart, none narrower than the lines tell."""
    low, high = max(float(frequency[0]), 1e-3 * float(frequency[-1])), float(frequency[-1])
    step = float(np.median(np.diff(frequency)))
    out = []
    for damping in GRID_DAMPING:
        natural = low * (1.0 + damping) ** np.arange(int(np.log(high / low) / np.log1p(damping)) + 1)
        natural = natural[2.0 * damping * natural > step]
        out.append(np.stack([natural, np.full(natural.size, damping)], axis=1))
    return np.concatenate(out)


def _gains(fit: Fit, proposals: Real) -> Real:
    """Return by how much chi falls for each proposal alone, all poles held."""
    curves = fit.curves
    columns = basis(curves.frequency, fit.poles, fit.remainders)
    own = basis(curves.frequency, proposals, Remainders(False, False))
    gain = np.zeros(len(proposals))
    for g, (weight, (q, _)) in enumerate(zip(curves.weight, fit.bases, strict=True)):
        new = _stacked(own * weight[:, None])
        left = _stacked((curves.values[g] - columns @ fit.coefficient[g]) * weight)
        inside = q.T @ new
        seen = (new.T @ left).reshape(-1, 2)
        size = np.sum(new**2, axis=0).reshape(-1, 2)
        cross = np.sum(new[:, ::2] * new[:, 1::2], axis=0) - np.sum(inside[:, ::2] * inside[:, 1::2], axis=0)
        # A proposal that the columns already hold explains nothing: a floor on what is left of it.
        one, two = (np.maximum(size - np.sum(inside**2, axis=0).reshape(-1, 2), 1e-6 * size)).T
        determinant = np.maximum(one * two - cross**2, 1e-6 * one * two)
        gain += (two * seen[:, 0] ** 2 - 2.0 * cross * seen[:, 0] * seen[:, 1] + one * seen[:, 1] ** 2) / determinant
    return gain


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _fewer(fit: Fit, rules: OrderRules) -> Fit:
    """Take away the pole that matters least as long as the criterion falls."""
    while len(fit.poles) > 1:
        shorter = min((without(fit, k) for k in range(len(fit.poles))), key=lambda f: f.chi)
        shorter = refine(shorter, rules.quick)
        if shorter.information >= fit.information:
            return fit
        fit = shorter
    return fit


def _fewer_remainders(fit: Fit) -> Fit:
    """Take away remainders that the data do not ask for."""
    tried = [fit]
    for remainders in (Remainders(False, True), Remainders(True, False), Remainders(False, False)):
        tried.append(refine(solve(fit.curves, fit.poles, remainders)))
    return min(tried, key=lambda f: f.information)
