"""Gain on conditions that a fit never saw: whole conditions are left out, by what they contrast.

Where the conditions differ in a setting (feed, level, direction, controller ...) all with one value of it are left out
together; without such a contrast each condition by itself. A fold without which the others say next to nothing about
some combination of parameters tests nothing and is left away (known from the slopes, not from the residuals).

Where no condition can be left out because each alone determines some parameter (idle and one feed, say), alternate
blocks of the values of every condition are: that proves interpolation only, so that the gain (:eq:`gain`) asked for is
larger.

The error before and after is the repeatable one: a misfit within the 99 % band of noise counts as none, and what then
remains of it is what the uncertainty of the fitted parameters makes of the prediction, so that no gain is claimed
beyond that floor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from process.types import Real
from smfe.diagnosis.inference.fit import Fit, Target, bounded_step, refit, residuals, stacked
from smfe.diagnosis.inference.misfit import Group, Misfit, assess, decomposed, triangle
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import orthonormal

Fold = tuple[int, ...]
Scheme = tuple[Fold, ...]


@dataclass(frozen=True)
class HeldOut:
    """Errors of predictions of conditions that the fit did not see."""

    squares: Mapping[int, float]  # squares of the whitened residuals of each condition, the mean over the schemes
    floor: Mapping[int, float]  # what the uncertainty of the fit adds to them
    values: Mapping[int, float]  # how many values the condition has: what noise gives
    misfit: Misfit  # the scheme that looks worst, its p-value times the number of schemes
    trusted: bool  # whether all fits converged
    fitted: Mapping[int, tuple[Real, ...]] = field(default_factory=dict)
    """Scaled values that predicted each condition, one for each scheme."""
    along: float = math.inf
    """Most that the variance of their noise is along any direction: one of independent values of a known size, the
    number of conditions where these may miss the same in all of them; infinite: not known."""


@dataclass(frozen=True)
class Gain:
    """What an extension is worth on held-out conditions."""

    db: float  # repeatable error before over after [dB]
    sd: float  # its standard deviation over the conditions (bootstrap) [dB]
    error_db: float  # error with its noise, before over after [dB]
    share: float  # share of the repeatable error explained, ``1 - (E_after^2 - noise^2)/(E_before^2 - noise^2)``
    low: float
    """What it is worth at least [dB]: three standard deviations less where noise alone is left, which the likelihood
    ratio has then been held against; else what all but 0.135 % of the bootstrap exceeds. Near the noise floor the
    decibels of the bootstrap are skewed, and their standard deviation bounds nothing.

    Where the size of that noise is known the bootstrap is not the only measure of it: squares won from white noise
    scatter by twice their root when the same conditions are measured again. That an effect acts in few of them, as a
    worn flank does at the slowest speeds, or in few orders, as a resonance does, is no scatter."""
    held_out: str = "conditions"  # or "blocks of values": what the fit did not use

    @property
    def proven(self) -> bool:
        """At least 1 dB, 3 dB of blocks of values, and a gain however what was held out is drawn again."""
        return self.db >= self.needed and self.low > 0.0

    @property
    def needed(self) -> float:
        """Least gain [dB] that proves something."""
        return 1.0 if self.held_out == "conditions" else RULES.least_within


def schemes(conditions: Sequence[Condition], rows: Sequence[int]) -> list[Scheme]:
    """Return ways to split the conditions `rows`: one a setting that contrasts them, then each by itself."""
    keys = sorted({key for r in rows for key in conditions[r].settings})
    found: list[Scheme] = []
    for key in keys:
        groups: dict[object, list[int]] = {}
        for r in rows:
            groups.setdefault(conditions[r].settings.get(key), []).append(r)
        split = tuple(tuple(g) for g in groups.values())
        if 2 <= len(split) <= RULES.most_values and sorted(split) not in [sorted(s) for s in found]:
            found.append(split)
    single = tuple((r,) for r in rows)
    return [*(s for s in found if sorted(s) != sorted(single)), single]


def usable(
    model: Model, target: Target, fit: Fit, causes: Sequence[int], groups: Sequence[Sequence[int]] = ()
) -> list[Scheme]:
    """Return the schemes, without folds that test nothing, that put some causes of a fit to the test; maybe none.

    So they do with groups of other parameters, by their numbers.
    """
    slope, _ = stacked(model, target, fit.free, fit.u, fit.residual, fit.slope)
    sizes = [y.size for y in target.observed.values()]
    rows = dict(zip(target.observed, np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1]), strict=True))
    basis = orthonormal(slope)
    grams = {r: basis[mine].T @ basis[mine] for r, mine in rows.items()}
    tested = [*(model.of_cause[k] for k in causes), *map(np.array, groups)]
    effects = [_effect(fit, np.isin(fit.free, own), slope, rows) for own in tested]
    every = [
        _testing(scheme, grams, basis.T @ basis, effects) for scheme in schemes(model.conditions, list(target.observed))
    ]
    *contrasts, single = every
    good = [s for s in contrasts if s]
    return good or ([single] if single else [])


def _testing(scheme: Scheme, grams: Mapping[int, Real], whole: Real, effects: Sequence[Mapping[int, float]]) -> Scheme:
    """Return the folds that leave every direction of the fit known; none if they hold too little of an effect."""
    kept = []
    for fold in scheme:
        left = whole - np.sum([grams[r] for r in fold], axis=0)
        if left.size == 0 or float(np.linalg.eigvalsh(left)[0]) >= RULES.retained:
            kept.append(fold)
    tested = {r for fold in kept for r in fold}
    enough = all(sum(v for r, v in e.items() if r in tested) >= RULES.covered * sum(e.values()) for e in effects)
    return tuple(kept) if enough and tested else ()


def _effect(fit: Fit, own: NDArray[np.bool_], slope: Real, rows: Mapping[int, NDArray[np.int64]]) -> dict[int, float]:
    """Squares of the fitted effect of some parameters beyond the others, by condition."""
    effect = slope[:, own] @ fit.u[fit.free][own]
    basis = orthonormal(slope[:, ~own])
    effect = effect - basis @ (basis.T @ effect)
    return {r: float(effect[mine] @ effect[mine]) for r, mine in rows.items()}


def held_out(model: Model, target: Target, fit: Fit, chosen: Sequence[Scheme]) -> HeldOut:
    """Predict every fold from a fit to the others."""
    squares: dict[int, list[float]] = {}
    floors: dict[int, list[float]] = {}
    fitted: dict[int, tuple[Real, ...]] = {}
    misfits: list[Misfit] = []
    trusted = True
    for scheme in chosen:
        groups: list[Group] = []
        for fold in scheme:
            out, u, converged = _apart(model, target, fit, fold)
            trusted &= converged
            spread = _spread(model, target.without(fold), fit, {r: fit.slope[r] for r in fold})
            groups.append((out, spread.load))
            for r in fold:
                squares.setdefault(r, []).append(float(out[r] @ out[r]))
                floors.setdefault(r, []).append(spread.square(r))
                fitted[r] = (*fitted.get(r, ()), u)
        misfits.append(assess(groups, False, model.noise_knowledge, model.kinds))
    worst = min(misfits, key=lambda m: m.p_value, default=Misfit(1.0, 0.0, 0.0, {}))
    worst = replace(worst, p_value=min(1.0, worst.p_value * len(misfits)))
    values = {r: float(target.observed[r].size) for r in squares}
    mean, floor = ({r: float(np.mean(v)) for r, v in x.items()} for x in (squares, floors))
    return HeldOut(mean, floor, values, worst, trusted, fitted, _along(model, list(squares)))


def _along(model: Model, rows: Sequence[int]) -> float:
    """Return the most that the variance of the noise of conditions is along any direction; infinite: not known."""
    family, known = model.family, model.noise_knowledge
    # At a likelihood ratio that is decisive beside what a model misses, what is won is three deviations.
    if family.decisive > 0.0:
        return family.decisive / RULES.proven
    sized = family.bounded_noise or all(math.isinf(known.of(r)) for r in rows)
    if family.model_error > 0.0 or family.roughness > 0.0 or not sized:
        return math.inf
    # What a model may miss it may miss of all conditions alike.
    return float(len(rows)) if _missed(model, rows) else 1.0


def _missed(model: Model, rows: Sequence[int]) -> bool:
    """Whether conditions are whitened by what a model may miss of them, too."""
    return any(model.family.measured_noise(model.conditions[r]) is not None for r in rows)


def within(model: Model, target: Target, fit: Fit) -> HeldOut | None:
    """Predict alternate blocks of values of every condition, one step from the fit to all; None for few values.

    The blocks stand for conditions in what is returned.
    """
    if len(target.observed) < 2 or min(y.size for y in target.observed.values()) < 4 * RULES.blocks:
        return None
    slope, residual = stacked(model, target, fit.free, fit.u, fit.residual, fit.slope)
    values = sum(y.size for y in target.observed.values())
    block = np.concatenate(
        [n * RULES.blocks + np.arange(y.size) * RULES.blocks // y.size for n, y in enumerate(target.observed.values())]
    )
    at, groups = fit.u[fit.free], []
    for fold in range(4):
        apart = block % 4 == fold
        seen = np.concatenate([~apart, np.ones(residual.size - values, dtype=bool)])
        step, _ = bounded_step(slope[seen], residual[seen], model.low[fit.free] - at, model.high[fit.free] - at)
        out = _stepped(model, target, fit, step, seen, residual)
        if out is None:
            return None
        root = _root(slope[seen])
        mine = {int(b): block == b for b in np.unique(block[apart])}
        load = {b: slope[:values][m] @ root[0] for b, m in mine.items()}
        groups.append(({b: out[m] for b, m in mine.items()}, Spread(load, root[1])))
    squares = {b: float(x @ x) for out_, _ in groups for b, x in out_.items()}
    floor = {b: spread.square(b) for _, spread in groups for b in spread.load}
    count = {b: float(x.size) for out_, _ in groups for b, x in out_.items()}
    rows = {n * RULES.blocks + b: r for n, r in enumerate(target.observed) for b in range(RULES.blocks)}
    misfit = assess(
        [(out_, spread.load) for out_, spread in groups], False, model.noise_knowledge.parted(rows, RULES.blocks)
    )
    by_row = {
        r: min(misfit.by_condition[b] for b in range(n * RULES.blocks, (n + 1) * RULES.blocks))
        for n, r in enumerate(target.observed)
    }
    bounded = replace(misfit, by_condition=by_row)
    sized = model.family.bounded_noise or _missed(model, list(target.observed))
    along = _along(model, list(target.observed)) if sized else math.inf
    return HeldOut(squares, floor, count, bounded, fit.converged, along=along)


def _stepped(
    model: Model, target: Target, fit: Fit, step: Real, seen: NDArray[np.bool_], residual: Real
) -> Real | None:
    """Return the residuals (N,) a step from a fit, as much of it as brings what was seen no further off.

    What a few blocks say little of takes a step far beyond where its slopes hold. None where nothing is predicted.
    """
    before, out = float(residual[seen] @ residual[seen]), None
    for fraction in (*RULES.fractions, 0.0):
        u = fit.u.copy()
        u[fit.free] = np.clip(fit.u[fit.free] + fraction * step, model.low[fit.free], model.high[fit.free])
        found = residuals(model, target, u)
        if found is None:
            continue
        whole = stacked(model, target, fit.free, u, found, fit.slope)[1]
        out = np.concatenate(list(found.values()))
        if float(whole[seen] @ whole[seen]) <= before:
            break
    return out


def _apart(model: Model, target: Target, fit: Fit, fold: Fold) -> tuple[Mapping[int, Real], Real, bool]:
    """Predict a fold from a fit to the others; return its residuals, the scaled values, and whether that converged.

    One step from the fit to all, with its slopes; a fit of its own where the prediction does not follow them. Where
    that does not converge, what the fit to all leaves stands for it: that is less, and makes the gain of an extension
    smaller.
    """
    others, mine = target.without(fold), target.only(fold)
    slope, residual = stacked(model, others, fit.free, fit.u, fit.residual, fit.slope)
    at = fit.u[fit.free]
    step, _ = bounded_step(slope, residual, model.low[fit.free] - at, model.high[fit.free] - at)
    u = fit.u.copy()
    u[fit.free] = np.clip(at + step, model.low[fit.free], model.high[fit.free])
    out = residuals(model, mine, u)
    if out is not None:
        expected = sum(float(np.sum((fit.residual[r] + fit.slope[r] @ step) ** 2)) for r in fold)
        found = sum(float(x @ x) for x in out.values())
        noise = sum(model.size(r, u) for r in fold)
        if abs(found - expected) <= max(RULES.followed * expected, RULES.roughly * (expected - noise)):
            return out, u, fit.converged
    apart = refit(model, others, fit)
    out = residuals(model, mine, apart.u)
    if out is None or not apart.converged:
        return {r: fit.residual[r] for r in fold}, fit.u, False
    return out, apart.u, True


def unseen(model: Model, target: Target, fit: Fit, data: Mapping[int, Real]) -> HeldOut:
    """Predict data that no fit has seen, from the fit to all the others."""
    out, slope = residuals(model, Target(data, target.centre), fit.u), model.slopes(list(data), fit.u, fit.free)
    if out is None or slope is None:
        return HeldOut({}, {}, {}, Misfit(1.0, 0.0, 0.0, {}), False)
    spread = _spread(model, target, fit, slope)
    squares, floors = {r: float(x @ x) for r, x in out.items()}, {r: spread.square(r) for r in data}
    values = {r: float(x.size) for r, x in out.items()}
    misfit = assess([(out, spread.load)], False, model.noise_knowledge, model.kinds)
    return HeldOut(squares, floors, values, misfit, fit.converged)


@dataclass(frozen=True)
class Spread:
    """Uncertainty of predictions: covariance ``L L^T`` of each condition, and which columns of L the fit knows."""

    load: Mapping[int, Real]
    known: NDArray[np.bool_]

    def square(self, row: int) -> float:
        """Expected square of the error of a condition through what the fit knows."""
        return float(np.sum(self.load[row][:, self.known] ** 2))


def _spread(model: Model, seen: Target, fit: Fit, slope: Mapping[int, Real]) -> Spread:
    """Uncertainty of predictions with some slopes, from a fit to what was seen; the unknown is very uncertain."""
    jacobian, _ = stacked(model, seen, fit.free, fit.u, {r: fit.residual[r] for r in seen.observed}, fit.slope)
    root, known = _root(jacobian)
    return Spread({r: x @ root for r, x in slope.items()}, known)


def _root(jacobian: Real) -> tuple[Real, NDArray[np.bool_]]:
    """Return a root of the covariance of fitted parameters, and which of its columns the data know."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    unit = jacobian / size
    upper = triangle(unit)
    _, singular, right = decomposed(unit if upper is None else upper)
    unknown = singular < RULES.unknown * max(float(singular.max(initial=0.0)), 1e-300)
    return right.T / np.where(unknown, RULES.unknown, singular) / size[:, None], ~unknown


def compare(before: HeldOut, after: HeldOut, rng: np.random.Generator) -> Gain:
    """Gain of an extension over what it extends, on the conditions that both predicted."""
    rows = [r for r in after.squares if r in before.squares]
    if not rows:
        return Gain(0.0, math.inf, 0.0, 0.0, -math.inf)
    won = np.array([before.squares[r] - after.squares[r] for r in rows])
    floor = np.array([after.floor[r] for r in rows])
    noisy = after.misfit.p_value >= RULES.band
    excess = floor if noisy else np.array([after.squares[r] - after.values[r] for r in rows])
    drawn = np.concatenate([np.arange(len(rows))[None], rng.integers(0, len(rows), (RULES.resamples, len(rows)))])
    gained = won[drawn].sum(axis=1)
    # Noise can make what is left look smaller than what the uncertain parameters alone make of it.
    left = np.maximum(np.maximum(floor[drawn].sum(axis=1), excess[drawn].sum(axis=1)), 1e-9)
    decibels = np.copysign(10.0 * np.log10(1.0 + np.abs(gained) / left), gained)
    db, sd = float(decibels[0]), float(np.std(decibels[1:]))
    low = db - 3.0 * sd if noisy else float(np.quantile(decibels[1:], RULES.three_sigma))
    if noisy and after.along < math.inf and gained[0] > 0.0:
        least = float(gained[0]) - 3.0 * 2.0 * math.sqrt(float(gained[0]) * after.along)
        low = max(low, math.copysign(10.0 * math.log10(1.0 + abs(least) / float(left[0])), least))
    total = [sum(x.squares[r] for r in rows) for x in (before, after)]
    whole = gained[0] + left[0]
    share = max(float(gained[0] / whole), 0.0) if whole > 0.0 else 0.0
    return Gain(db, sd, 10.0 * math.log10(total[0] / total[1]), share, low)
