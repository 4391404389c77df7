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
from smfe.modal_fit import Remainders, basis_of, refine, solve, sorted_fit, without
from smfe.modal_local import alike
from smfe.modal_search import divided, grown, needed

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

GRID_DAMPING = (0.02, 0.08)
"""Damping ratios of the grid of proposals: narrower modes are found place by place."""

DIAGRAM_FIRST = 0.7
"""Share of the largest gain from which on a candidate of the diagram is preferred."""


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

    most: int = 60
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
    # While poles are looked for, all curves share the course of their weights: they share a decomposition then.
    own, curves = curves, alike(curves)
    fit = grown(solve(curves, np.empty((0, 2)), Remainders()), rules.most)
    fit = divided(fit, rules.most)
    fit = _surrounded(fit, rules)
    while len(fit.poles) < rules.most and _room(fit):
        better = _added(fit, candidates, rules)
        if better is None:
            break
        fit = divided(better, rules.most)
    if not len(fit.poles):
        raise InputError(
            "no mode stands out of the noise of this compliance; measure it with more force or more repeats, or give "
            "the band around a resonance"
        )
    fit = _fewer(_fewer_remainders(refine(fit, rules.quick)), rules)
    return fit_poles(own, fit.poles, fit.remainders)


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
    own = basis_of(curves, proposals, Remainders(False, False))
    gain = np.zeros(len(proposals))
    for g, (weight, (q, _)) in enumerate(zip(curves.weight, fit.bases, strict=True)):
        new = _stacked(own * weight[:, None])
        left = _stacked(fit.left[g] * weight)
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
    """Take away poles that their own lines do not ask for, the least first, as long as the criterion falls."""
    first, last = fit.curves.frequency[[0, -1]]
    spare = [float(f) for k, f in enumerate(fit.poles[:, 0]) if not first < f < last or not needed(fit, k)]
    while spare and len(fit.poles) > 1:
        # Refining moves poles: the one next to where it was.
        numbers = {int(np.argmin(np.abs(fit.poles[:, 0] - f))) for f in spare}
        rest = {k: without(fit, k) for k in numbers}
        gone = min(rest, key=lambda k: rest[k].chi)
        shorter = refine(rest[gone], rules.quick)
        if shorter.information >= fit.information:
            return fit
        spare.remove(min(spare, key=lambda f: abs(f - float(fit.poles[gone, 0]))))
        fit = shorter
    return fit


def _surrounded(fit: Fit, rules: OrderRules) -> Fit:
    """Return the fit with poles outside the band where a remainder is too coarse for modes near its ends."""
    f = fit.curves.frequency
    first, last = float(f[f > 0.0][0]), float(f[-1])
    for natural in (1.15 * last, 0.8 * first):
        if len(fit.poles) < rules.most and _room(fit):
            fit = _best(fit, [np.concatenate([fit.poles, [[natural, 0.02]]])], rules) or fit
    return fit


def _fewer_remainders(fit: Fit) -> Fit:
    """Take away remainders that the data do not ask for."""
    tried = [fit]
    for remainders in (Remainders(False, True), Remainders(True, False), Remainders(False, False)):
        tried.append(refine(solve(fit.curves, fit.poles, remainders), 4))
    return min(tried, key=lambda f: f.information)
