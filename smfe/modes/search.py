"""Modes looked for place by place: peaks of what a fit leaves, and poles that are two, each judged by its own lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from process.types import Real
from smfe.modes.local import DOUBTFUL, REACH, Local, Window, evidence, fit_window, takes_enough, threshold, window
from smfe.modes.pole_fit import LEAST_DAMPING, PoleFit, refine, solve
from smfe.modes.response_matrix import running_mean

MOST_PLACES = 24
"""Places that are looked at in one round, largest first."""

ROUNDS = 10

PROMINENT = 2.0
"""Height of a peak over its surroundings [1, power] from which on it is looked at."""

STANDING = 0.02
"""Where no noise is known: share of the response around it that a mode must have: no linear model describes all."""

SEEN = 0.002
"""Where no noise is known: share of the response that the residual has where it is looked at."""

TWINS = ((0.15, 1.0), (0.5, 0.8), (1.0, 1.0))
"""Distance of two poles from the one that they replace, in its half bandwidths, and their damping over its."""


@dataclass(frozen=True)
class Twin:
    """A mode that may be two.

    Parameters
    ----------
    number : int
        Of the pole.
    poles : ndarray, shape (m + 1, 2)
        Poles of its window, the pole replaced by two [Hz, 1].
    surprise : float
        Evidence over what chance explains: 1 where it is as much.
    """

    number: int
    poles: Real
    surprise: float


def grown(fit: PoleFit, most: int) -> PoleFit:
    """Return the fit with the modes that its residual shows, each accepted by the lines around it."""
    refused: list[tuple[float, float]] = []
    for _ in range(ROUNDS):
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
        pairs: list[tuple[Window, Twin]] = []
        for number in range(len(fit.poles)):
            if number not in tried and len(fit.poles) + len(pairs) < most:
                twin = twin_of(fit, number)
                if twin is not None and twin[1].surprise > 1.0:
                    pairs.append(twin)
                else:
                    tried.add(number)
        if not pairs:
            return fit
        poles, new, changed = fit.poles.copy(), [], set[int]()
        for where, pair in sorted(pairs, key=lambda t: -t[1].surprise):
            if not changed & set(where.near):
                poles[list(where.near)] = pair.poles[:-1]
                new.append(pair.poles[-1])
                changed |= set(where.near)
        fit = refine(solve(fit.curves, np.concatenate([poles, new]), fit.remainders), 2)
    return fit


def twin_of(fit: PoleFit, number: int) -> tuple[Window, Twin] | None:
    """Return the best two poles in place of one, and how much the lines around them speak for them."""
    natural, damping = fit.poles[number]
    half = natural * damping
    where = window(fit, natural, max(REACH * half, 3.0 * _spacing(fit, natural)))
    if where is None or number not in where.near:
        return None
    poles = fit.poles[list(where.near)]
    at = where.near.index(number)
    one = fit_window(where, poles)
    natural, damping = one.poles[at]
    best: Local | None = None
    for shift, factor in TWINS:
        start = one.poles.copy()
        start[at] = natural * (1.0 - shift * damping), factor * damping
        second = [[natural * (1.0 + shift * damping), factor * damping]]
        tried = fit_window(where, np.concatenate([start, second]))
        if best is None or tried.chi < best.chi:
            best = tried
    if best is None or not _plausible(where, best, at):
        return None
    told = evidence(where, one, best) if takes_enough(where, one, best) else 0.0
    return where, Twin(number, best.poles, told / threshold(where))


def doubtful(fit: PoleFit, number: int) -> float:
    """Return the distance [Hz] of the two modes that one may be; NaN where nothing speaks for two."""
    twin = twin_of(fit, number)
    if twin is None:
        return float("nan")
    where, pair = twin
    if pair.surprise * threshold(where) < threshold(where, DOUBTFUL):
        return float("nan")
    return float(abs(pair.poles[-1, 0] - pair.poles[where.near.index(number), 0]))


def needed(fit: PoleFit, number: int) -> bool:
    """Whether the lines around a pole ask for it."""
    natural, damping = fit.poles[number]
    where = window(fit, natural, max(REACH * natural * damping, 3.0 * _spacing(fit, natural)))
    if where is None or number not in where.near:
        return False
    poles = fit.poles[list(where.near)]
    more = fit_window(where, poles, 8)
    fewer = fit_window(where, np.delete(poles, where.near.index(number), axis=0))
    return evidence(where, fewer, more) > threshold(where)


def _spacing(fit: PoleFit, natural: float) -> float:
    f = fit.curves.frequency
    k = int(np.clip(np.searchsorted(f, natural), 1, f.size - 1))
    return float(f[k] - f[k - 1])


def _with_mode(fit: PoleFit, centre: float, half: float) -> tuple[Window, Local] | None:
    """Return the poles around a peak with one more, None where its lines do not ask for it."""
    where = window(fit, centre, max(REACH * half, 3.0 * _spacing(fit, centre)))
    if where is None:
        return None
    old = fit.poles[list(where.near)]
    fewer = fit_window(where, old)
    best: Local | None = None
    for factor in (1.0, 0.3):
        start = np.concatenate([fewer.poles, [[centre, max(factor * half / centre, 2.0 * LEAST_DAMPING)]]])
        tried = fit_window(where, start)
        if best is None or tried.chi < best.chi:
            best = tried
    if best is None or not takes_enough(where, fewer, best) or not _plausible(where, best, len(old)):
        return None
    if evidence(where, fewer, best) < threshold(where):
        return None
    return where, best


def _plausible(where: Window, found: Local, number: int) -> bool:
    """Whether the new poles of a window are modes in it: inside, no broader than it, and no small share of it.

    Two poles that nearly cancel each other, or one far weaker than what the others leave, describe what is no mode.
    """
    natural, damping = found.poles[[number, -1]].T
    half = natural * damping
    if np.any(np.abs(natural - where.centre) > 0.98 * where.half) or np.any(half > where.half):
        return False
    if not np.all(damping > 1.5 * LEAST_DAMPING):
        return False
    if where.curves.noise_known:
        return True
    # Height of the mode against the response at its peak, in the curve that shows it best.
    height = np.hypot(found.coefficient[2 * number], found.coefficient[2 * number + 1])
    last = 2 * len(found.poles) - 2
    height = np.minimum(height, np.hypot(found.coefficient[last], found.coefficient[last + 1]))
    size = np.abs(where.curves.values).max(axis=1)
    return bool(np.any(height > STANDING * size))


def _places(fit: PoleFit) -> list[tuple[float, float]]:
    """Return centre and half bandwidth [Hz] of peaks of what a fit leaves, the most surprising first."""
    curves = fit.curves
    f, known = curves.frequency, np.isfinite(curves.std)
    power = np.where(known, np.abs(fit.left) ** 2, 0.0)
    surprise = np.sum(power * np.where(known, curves.weight, 0.0) ** 2, axis=0)
    # The same as mobility, every curve over its own size: modes of any frequency and curve count alike.
    whole = np.where(known, np.abs(curves.values) ** 2, np.nan) * f**2
    size = np.nanmedian(whole, axis=1)
    mobility = np.sum(power * f**2 / np.where(size > 0.0, size, np.inf)[:, None], axis=0)
    base = 2.0 * known.sum(axis=0) if curves.noise_known else np.full(f.size, float(np.median(surprise)))
    noise = curves.std if curves.rough is None else curves.rough
    with np.errstate(invalid="ignore"):
        share = np.sqrt(power) - SEEN * np.abs(curves.values) - np.where(known, noise, 0.0)
    visible = ndimage.maximum_filter1d(np.max(np.where(known, share, -1.0), axis=0), 5) > 0.0
    found: list[tuple[float, float, float]] = []
    for measure in (surprise, mobility):
        width = 1
        while width <= max(1, f.size // 8):
            smooth = running_mean(measure, width)
            height = np.pad(np.log(np.maximum(smooth, 1e-300)), 1, constant_values=-800.0)
            lines, _ = signal.find_peaks(height, prominence=np.log(PROMINENT))
            for k in lines - 1:
                inside = slice(max(0, k - width // 2), k + width // 2 + 1)
                told = float(np.sum(surprise[inside] - base[inside]) / np.sqrt(np.sum(base[inside]) + 1e-300))
                if told > 4.0 if curves.noise_known else visible[k]:
                    found.append((told, float(f[k]), _half(f, smooth, int(k))))
            width *= 4
    found.sort(reverse=True)
    out: list[tuple[float, float]] = []
    for _, centre, half in found:
        if all(abs(centre - c) > 0.5 * max(half, h) or not 0.3 < half / h < 3.0 for c, h in out):
            out.append((centre, half))
        if len(out) >= MOST_PLACES:
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
