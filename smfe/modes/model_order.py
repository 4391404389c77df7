"""How many modes a record holds: poles are added while the data ask for them, and taken away where they do not.

Two criteria decide. Peaks of what a fit leaves, and single poles that may be two, are tested place by place, each by
the likelihood ratio of its own lines (`smfe.modes.likelihood_ratio`). Candidates of the stabilisation diagram and of a
coarse grid, poles outside the band and remainders are accepted by the information criterion of the whole record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from process.errors import InputError
from process.types import Complex, Real
from smfe.modes.likelihood_ratio import Window, likelihood_ratio, takes_enough, threshold, window
from smfe.modes.pole_fit import NO_REMAINDERS, PoleFit, Remainders, basis_of, refine, solve, sorted_fit, without
from smfe.modes.response_matrix import Curves, running_mean
from smfe.modes.rules import RULES


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


def choose(curves: Curves, candidates: Real, rules: OrderRules | None = None) -> PoleFit:
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
    own, curves = curves, curves.alike()
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


def fit_poles(curves: Curves, poles: Real, remainders: Remainders | None = None) -> PoleFit:
    """Return the maximum-likelihood fit near given poles (frequency [Hz], damping ratio), their number kept."""
    return sorted_fit(refine(solve(curves, np.asarray(poles, dtype=float), remainders or Remainders())))


def _room(fit: PoleFit) -> bool:
    """Whether the data outnumber the unknowns of one pole more."""
    more = 2 + 2 * len(fit.coefficient)
    return fit.curves.real_data > 1.5 * (fit.unknowns + more)


def _added(fit: PoleFit, candidates: Real, rules: OrderRules) -> PoleFit | None:
    """Return the fit with the pole that explains most of what is left, None when the criterion says no."""
    proposals = np.concatenate([candidates[:, :2], _grid(fit.curves.frequency)])
    gain = _gains(fit, proposals)
    # The diagram knows poles that the grid only comes near: where it proposes nearly as much, it goes first.
    top, stable = int(np.argmax(gain)), gain[: len(candidates)]
    if stable.size and stable.max() > RULES.diagram_first * gain[top]:
        top = int(np.argmax(stable))
    return _if_better(fit, proposals[[top]], rules)


def _if_better(fit: PoleFit, more: Real, rules: OrderRules) -> PoleFit | None:
    """Return the refined fit with more poles, None when its criterion is not below that of the fit."""
    tried = refine(solve(fit.curves, np.concatenate([fit.poles, more]), fit.remainders), rules.quick)
    return tried if tried.information < fit.information else None


def _grid(frequency: Real) -> Real:
    """Return frequencies and damping ratios half a bandwidth apart, none narrower than two lines."""
    low, high = max(float(frequency[0]), 1e-3 * float(frequency[-1])), float(frequency[-1])
    step = float(np.median(np.diff(frequency)))
    out = []
    for damping in RULES.grid_damping:
        natural = low * (1.0 + damping) ** np.arange(int(np.log(high / low) / np.log1p(damping)) + 1)
        natural = natural[2.0 * damping * natural > step]
        out.append(np.stack([natural, np.full(natural.size, damping)], axis=1))
    return np.concatenate(out)


def _gains(fit: PoleFit, proposals: Real) -> Real:
    """Return by how much chi falls for each proposal alone, all poles held."""
    curves = fit.curves
    own = basis_of(curves, proposals, NO_REMAINDERS)
    gain = np.zeros(len(proposals))
    for which, q, _ in fit.bases:
        weight = curves.weight[which[0]]
        new = _stacked(own * (weight / weight.max())[:, None])
        inside = q.T @ new
        along = (new.T @ _stacked(fit.residual[which].T)).reshape(len(proposals), 2, -1)
        size = np.sum(new**2, axis=0).reshape(-1, 2)
        cross = np.sum(new[:, ::2] * new[:, 1::2], axis=0) - np.sum(inside[:, ::2] * inside[:, 1::2], axis=0)
        # A proposal that the columns already hold explains nothing: a floor on what is left of it.
        one, two = (np.maximum(size - np.sum(inside**2, axis=0).reshape(-1, 2), 1e-6 * size)).T
        determinant = np.maximum(one * two - cross**2, 1e-6 * one * two)
        (aa, bb), ab = np.sum(along**2, axis=2).T, np.sum(along[:, 0] * along[:, 1], axis=1)
        gain += (two * aa - 2.0 * cross * ab + one * bb) / determinant
    return gain


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _fewer(fit: PoleFit, rules: OrderRules) -> PoleFit:
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


def _surrounded(fit: PoleFit, rules: OrderRules) -> PoleFit:
    """Return the fit with poles outside the band where a remainder is too coarse for modes near its ends."""
    f = fit.curves.frequency
    first, last = float(f[f > 0.0][0]), float(f[-1])
    for natural in (1.15 * last, 0.8 * first):
        if len(fit.poles) < rules.most and _room(fit):
            fit = _if_better(fit, np.array([[natural, 0.02]]), rules) or fit
    return fit


def _fewer_remainders(fit: PoleFit) -> PoleFit:
    """Take away remainders that the data do not ask for."""
    tried = [fit]
    for remainders in (Remainders(False, True), Remainders(True, False), Remainders(False, False)):
        tried.append(refine(solve(fit.curves, fit.poles, remainders), 4))
    return min(tried, key=lambda f: f.information)


# --- place by place --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pair:
    """Two poles in place of one.

    Parameters
    ----------
    where : Window
        The lines around the pole.
    poles : ndarray, shape (m + 1, 2)
        Poles of the window, the pole replaced by two, the second one last [Hz, 1].
    ratio : float
        Likelihood ratio of two against one.
    """

    where: Window
    poles: Real
    ratio: float


def grown(fit: PoleFit, most: int) -> PoleFit:
    """Return the fit with the modes at peaks of its residual, each accepted by the lines around it."""
    refused: list[tuple[float, float]] = []
    for _ in range(RULES.rounds):
        taken: list[Window] = []
        poles = fit.poles.copy()
        for centre, half in _places(fit):
            if len(poles) >= most:
                break
            if any(abs(centre - w.centre) < w.half for w in taken):
                continue
            if any(abs(centre - c) < 0.3 * h and 0.3 < half / h < 3.0 for c, h in refused):
                continue
            longer = _with_mode(fit, centre, half)
            if longer is None:
                refused.append((centre, half))
                continue
            where, local = longer
            if any(abs(where.centre - w.centre) < 0.5 * (w.half + where.half) for w in taken):
                continue
            taken.append(where)
            # The poles that were in the window before moved too; the list keeps the order of the fit.
            poles[list(where.near)] = local.poles[: len(where.near)]
            poles = np.concatenate([poles, local.poles[len(where.near) :]])
        if not taken:
            return fit
        # What was refused is looked at again where something around it has changed.
        refused = [r for r in refused if all(abs(r[0] - w.centre) > w.half for w in taken)]
        fit = refine(solve(fit.curves, poles, fit.remainders), 2)
    return fit


def divided(fit: PoleFit, most: int) -> PoleFit:
    """Return the fit with the poles that are two replaced by two."""
    tried: set[int] = set()
    for _ in range(4):
        pairs: list[tuple[float, Pair]] = []
        for number in range(len(fit.poles)):
            if number not in tried and len(fit.poles) + len(pairs) < most:
                pair = pair_for(fit, number)
                share = 0.0 if pair is None else pair.ratio / threshold(pair.where)
                if pair is not None and share > 1.0:
                    pairs.append((share, pair))
                else:
                    tried.add(number)
        if not pairs:
            return fit
        poles, new, changed = fit.poles.copy(), [], set[int]()
        for _, pair in sorted(pairs, key=lambda p: -p[0]):
            near = pair.where.near
            if not changed & set(near):
                poles[list(near)] = pair.poles[:-1]
                new.append(pair.poles[-1])
                changed |= set(near)
        fit = refine(solve(fit.curves, np.concatenate([poles, new]), fit.remainders), 2)
    return fit


def pair_for(fit: PoleFit, number: int) -> Pair | None:
    """Return the best two poles in place of one; None where too few lines are known or two would be no modes."""
    natural, damping = fit.poles[number]
    half = natural * damping
    where = window(fit, natural, max(RULES.reach * half, 3.0 * _spacing(fit, natural)))
    if where is None or number not in where.near:
        return None
    poles = fit.poles[list(where.near)]
    at = where.near.index(number)
    one = where.fit(poles)
    natural, damping = one.poles[at]
    best: PoleFit | None = None
    for shift, factor in RULES.pairs:
        start = one.poles.copy()
        start[at] = natural * (1.0 - shift * damping), factor * damping
        second = [[natural * (1.0 + shift * damping), factor * damping]]
        tried = where.fit(np.concatenate([start, second]))
        if best is None or tried.chi < best.chi:
            best = tried
    if best is None or not _plausible(where, best, at):
        return None
    return Pair(where, best.poles, likelihood_ratio(one, best) if takes_enough(one, best) else 0.0)


def pair_distance(fit: PoleFit, number: int) -> float:
    """Return the distance [Hz] of the two modes that one may be; NaN where the likelihood ratio is too small."""
    pair = pair_for(fit, number)
    if pair is None or pair.ratio < threshold(pair.where, RULES.p_value_named):
        return float("nan")
    return float(abs(pair.poles[-1, 0] - pair.poles[pair.where.near.index(number), 0]))


def needed(fit: PoleFit, number: int) -> bool:
    """Whether the lines around a pole ask for it."""
    natural, damping = fit.poles[number]
    where = window(fit, natural, max(RULES.reach * natural * damping, 3.0 * _spacing(fit, natural)))
    if where is None or number not in where.near:
        return False
    poles = fit.poles[list(where.near)]
    more = where.fit(poles, 8)
    fewer = where.fit(np.delete(poles, where.near.index(number), axis=0))
    return likelihood_ratio(fewer, more) > threshold(where)


def _spacing(fit: PoleFit, natural: float) -> float:
    f = fit.curves.frequency
    k = int(np.clip(np.searchsorted(f, natural), 1, f.size - 1))
    return float(f[k] - f[k - 1])


def _with_mode(fit: PoleFit, centre: float, half: float) -> tuple[Window, PoleFit] | None:
    """Return the poles around a peak with one more, None where its lines do not ask for it."""
    where = window(fit, centre, max(RULES.reach * half, 3.0 * _spacing(fit, centre)))
    if where is None:
        return None
    old = fit.poles[list(where.near)]
    fewer = where.fit(old)
    best: PoleFit | None = None
    for factor in (1.0, 0.3):
        start = np.concatenate([fewer.poles, [[centre, max(factor * half / centre, 2.0 * RULES.least_damping)]]])
        tried = where.fit(start)
        if best is None or tried.chi < best.chi:
            best = tried
    if best is None or not takes_enough(fewer, best) or not _plausible(where, best, len(old)):
        return None
    if likelihood_ratio(fewer, best) < threshold(where):
        return None
    return where, best


def _plausible(where: Window, found: PoleFit, number: int) -> bool:
    """Whether the new poles of a window are modes in it: inside, no broader than it, and no small share of it.

    Two poles that nearly cancel each other, or one far weaker than what the others leave, describe what is no mode.
    """
    natural, damping = found.poles[[number, -1]].T
    half = natural * damping
    if np.any(np.abs(natural - where.centre) > 0.98 * where.half) or np.any(half > where.half):
        return False
    if not np.all(damping > 1.5 * RULES.least_damping):
        return False
    if where.curves.noise_known:
        return True
    # Height of the mode against the response at its peak, in the curve where it is highest.
    height = np.hypot(found.coefficient[:, 2 * number], found.coefficient[:, 2 * number + 1])
    last = 2 * len(found.poles) - 2
    height = np.minimum(height, np.hypot(found.coefficient[:, last], found.coefficient[:, last + 1]))
    size = np.abs(where.curves.values).max(axis=1)
    return bool(np.any(height > RULES.standing * size))


def _places(fit: PoleFit) -> list[tuple[float, float]]:
    """Return centre and half bandwidth [Hz] of peaks of what a fit leaves, the most significant first."""
    curves = fit.curves
    f, known = curves.frequency, np.isfinite(curves.std)
    power = np.where(known, np.abs(fit.left) ** 2, 0.0)
    power_over_noise = np.sum(power * np.where(known, curves.weight, 0.0) ** 2, axis=0)
    # The same as mobility, every curve over its own size: modes of any frequency and curve count alike.
    whole = np.where(known, np.abs(curves.values) ** 2, np.nan) * f**2
    size = np.nanmedian(whole, axis=1)
    mobility = np.sum(power * f**2 / np.where(size > 0.0, size, np.inf)[:, None], axis=0)
    base = 2.0 * known.sum(axis=0) if curves.noise_known else np.full(f.size, float(np.median(power_over_noise)))
    noise = curves.std if curves.rough is None else curves.rough
    with np.errstate(invalid="ignore"):
        share = np.sqrt(power) - RULES.seen * np.abs(curves.values) - np.where(known, noise, 0.0)
    visible = ndimage.maximum_filter1d(np.max(np.where(known, share, -1.0), axis=0), 5) > 0.0
    found: list[tuple[float, float, float]] = []
    for measure in (power_over_noise, mobility):
        width = 1
        while width <= max(1, f.size // 8):
            smooth = running_mean(measure, width)
            height = np.pad(np.log(np.maximum(smooth, 1e-300)), 1, constant_values=-800.0)
            lines, _ = signal.find_peaks(height, prominence=np.log(RULES.prominent))
            for k in lines - 1:
                inside = slice(max(0, k - width // 2), k + width // 2 + 1)
                significance = float(
                    np.sum(power_over_noise[inside] - base[inside]) / np.sqrt(np.sum(base[inside]) + 1e-300)
                )
                if significance > 4.0 if curves.noise_known else visible[k]:
                    found.append((significance, float(f[k]), _half(f, smooth, int(k))))
            width *= 4
    found.sort(reverse=True)
    out: list[tuple[float, float]] = []
    for _, centre, half in found:
        if all(abs(centre - c) > 0.5 * max(half, h) or not 0.3 < half / h < 3.0 for c, h in out):
            out.append((centre, half))
        if len(out) >= RULES.most_places:
            break
    return out


def _half(f: Real, smooth: Real, k: int) -> float:
    """Return the half bandwidth of a peak [Hz], half a line at least."""
    low, high = k, k
    while low > 0 and smooth[low] > 0.5 * smooth[k] and smooth[low - 1] < 1.2 * smooth[k]:
        low -= 1
    while high < f.size - 1 and smooth[high] > 0.5 * smooth[k] and smooth[high + 1] < 1.2 * smooth[k]:
        high += 1
    return 0.5 * float(max(f[high] - f[low], f[min(k + 1, f.size - 1)] - f[max(k - 1, 0)])) * 0.7
