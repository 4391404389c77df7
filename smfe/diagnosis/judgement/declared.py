"""Whether what somebody declared is right: parameters with a prior that the data put beyond it, before any cause.

Parameters with the same `Parameter.given` are judged together. About a fit, with the information D of the data and the
priors W (diagonal, inverse variances) on scaled parameters u, the fit to any other priors W' is to first order

    u' = (D + W')^(-1) y,    y = (D + W) u,    chi2(W') = constant - y^T (D + W')^(-1) y.

If the declared values scatter as their priors say, the fitted ones have the covariance ``S - P``, that of the prior
less that of the posterior, so that the pull ``u^T (S - P)^(-1) u`` of a group is a chi-square (Demortier and Lyons, CDF
note 5776, 2002). A group beyond it is released: its priors are made so wide that they say nothing. Groups that would do
as well in its place make one set with it: the data do not say which of them it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from process.types import Real
from smfe.diagnosis.inference.fit import Fit, Target, stacked
from smfe.diagnosis.inference.model import Index, Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import orthonormal

SEPARATE = frozenset({"sensor_gain", "sensor_axis", "servo_gains", "loop_delay"})
"""Ids whose parameters are faults of their own, of one channel or axis: none says that another is there."""

Size = Callable[[Real, Real, str], float]
"""What the difference of two scaled vectors costs, relative, for a group: (before, after, id) -> size."""


@dataclass(frozen=True)
class Released:
    """Declared parameters that the data contradict."""

    given: tuple[str, ...]  # ids that the data do not separate, the one that fits best first
    ratio: float  # likelihood ratio of taking its priors off
    values: tuple[Mapping[int, float], ...]
    """For each id: its parameters that have to be released, index -> scaled value where they alone are; first order."""
    deviations: tuple[Mapping[int, float], ...]  # their standard deviations, scaled


@dataclass(frozen=True)
class Strain:
    """What has no name and is moved beyond what is trusted of it."""

    said: str  # the nuisance that is furthest off, in words
    size: float  # of what all of them together change [1]


@dataclass(frozen=True)
class Declared:
    """A fit, linearised in all its parameters, under any priors."""

    model: Model
    free: Index  # shape (p,): fitted parameters
    u: Real  # all scaled parameters of the fit
    data: Real  # shape (p, p): information of the data
    weight: Real  # shape (p,): inverse variances of the priors
    score: Real  # shape (p,): y above, of the data
    held: Real  # shape (p,): y above, of the priors where a bound holds a value
    groups: Mapping[str, Index]  # id -> places in `free` of its parameters
    over: float  # what is left over noise when nothing is declared; one where it is noise

    @classmethod
    def of(cls, model: Model, target: Target, at: Fit, named: bool = True) -> Declared:
        """Linearise a fit, with the groups of what has a name, or with one of all nuisances that have none ("")."""
        slope, residual = stacked(model, target, at.free, at.u, at.residual, at.slope)
        values = sum(y.size for y in target.observed.values())
        fitted = model.weight[at.free] ** 2
        # What a cause moves no further than is known of it is known so well, too: it makes room for no other value.
        weight = fitted.copy()
        for k in (k for k in at.causes if as_known(model, target, at, k)):
            weight[np.isin(at.free, model.of_cause[k])] = _trusted(model, k) ** -2.0
        variance = _variance(model, target, slope[:values], residual[:values], weight)
        data = slope[:values].T @ (slope[:values] / variance[:, None])
        groups: dict[str, list[int]] = {}
        unsettled = frozenset().union(*(model.causes[k].unsettles for k in at.causes))
        for place, j in enumerate(at.free):
            given = "" if model.parameters[j].nameless else model.parameters[j].given
            # What only shapes an effect that is known is trusted of nobody, nor what was found with a cause at work.
            shapes = model.parameters[j].secondary or model.names[j] in unsettled
            counts = named or (j in model.nuisance and not shapes)
            if bool(given) == named and weight[place] > 0.0 and counts:
                groups.setdefault(given, []).append(place)
        centred = (at.u - target.centre)[at.free]
        off = slope[:values].T @ (residual[:values] / variance)
        # Where a fit has stopped a little short of its optimum, released priors would make much of that little.
        inside = _within(model, at)
        score, held = data @ centred - np.where(inside, off, 0.0), np.where(inside, 0.0, fitted * centred)
        found = cls(model, at.free, at.u, data, weight, score, held, {g: np.array(p) for g, p in groups.items()}, 1.0)
        free = weight.copy()
        for g in groups:
            free = found.without(free, found.groups[g])
        chi2 = at.chi2 + float(np.sum(residual[:values] ** 2 * (1.0 / variance - 1.0)))
        left = chi2 - found.merit(free) + found.merit(fitted)
        # A parameter that keeps its prior takes one of the values and gives one, that prior. Few values leave much more
        # or less than their number by chance.
        ruled = int(np.count_nonzero(weight)) - sum(map(len, groups.values()))
        known = float(max(values - at.free.size + ruled, 1))
        over = left / known if float(stats.chi2.sf(left, known)) < RULES.band else 1.0
        return replace(found, over=max(over, 1.0))

    def solve(self, weight: Real) -> tuple[Real, Real]:
        """Return the fitted values, (p,), and their covariance, (p, p), under other priors."""
        # Scales differ by many orders of magnitude: the inverse is taken of a matrix with a unit diagonal.
        # Noise that is larger than it was counted lessens what the data say, and leaves the priors as they are.
        whole = self.data / self.over + np.diag(weight)
        size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        inverse = np.linalg.pinv(whole / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
        return inverse @ self._asked, inverse

    @property
    def _asked(self) -> Real:
        return np.asarray(self.score / self.over + self.held)

    def merit(self, weight: Real) -> float:
        """Return what priors gain over none, up to a constant: minus chi-square."""
        return float(self._asked @ self.solve(weight)[0])

    def without(self, weight: Real, place: Index) -> Real:
        """Return priors of which some are so wide that they say nothing where the data say something."""
        less = weight.copy()
        less[place] = self.weight[place] * RULES.released**2
        return less

    def informed(self, weight: Real, place: Index) -> int:
        """Return of how many directions of some parameters the data say something."""
        return max(int(self._told(weight, place)[0].sum()), 1)

    def fewest(self, weight: Real, group: str) -> Index:
        """Return the places of those of a group that have to be released.

        Channels are instruments of their own: where one does what all of them do, the others are as declared. What
        belongs together, as the coefficients of a material, is released together.
        """
        place = self.groups[group]
        if group not in SEPARATE or place.size == 1:
            return place
        whole, directions = self.merit(self.without(weight, place)), self.informed(weight, place)
        chosen = place[:0]
        for _ in place:
            tried = [np.append(chosen, p) for p in place if p not in chosen]
            merits = [self.merit(self.without(weight, t)) for t in tried]
            chosen = np.sort(tried[int(np.argmax(merits))])
            more = directions - self.informed(weight, chosen)
            if more <= 0 or whole - max(merits) < self.over * float(stats.chi2.ppf(RULES.agreed, more)):
                break
        return chosen

    def impossible(self, weight: Real, group: str, place: Index) -> bool:
        """Whether channels that do what others do would have to be off by more than any is."""
        u = self.solve(weight)[0]
        return group in SEPARATE and bool(np.any(np.abs(u - self.possible(u))[place] > 0.0))

    def _told(self, weight: Real, place: Index) -> tuple[NDArray[np.bool_], Real, Real]:
        """Return directions of some that the data say something of, what they say (0: nothing, 1: all), and all."""
        covariance = self.solve(weight)[1]
        scale = np.sqrt(weight[place])
        told = (np.diag(1.0 / weight[place]) - covariance[np.ix_(place, place)]) * np.outer(scale, scale)
        known, vectors = np.linalg.eigh(told)
        return known > RULES.informed, known, vectors

    def pull(self, weight: Real, group: str) -> tuple[float, float]:
        """Return the p-value of a group's pull, together or of its worst, and its largest z against the data alone.

        Where more than noise is left that no declared value explains, noise counts as that much larger.
        """
        place = self.groups[group]
        u = self.possible(self.solve(weight)[0])
        seen, known, vectors = self._told(weight, place)
        if not seen.any():
            return 1.0, 0.0
        along = (vectors.T @ (u[place] * np.sqrt(weight[place])))[seen]
        square = float(np.sum(along**2 / known[seen]))
        # With the prior taken off, an estimate with the variance 1/told - 1 (over that of the prior) remains.
        alone = np.abs(along / known[seen]) / np.sqrt(np.maximum(1.0 / known[seen] - 1.0, 1e-12))
        together = float(stats.chi2.sf(square, int(seen.sum())))
        p_value = together if place.size == 1 else min(1.0, 2.0 * min(together, self._worst(u, weight, group)))
        return p_value, float(alone.max())

    def _worst(self, u: Real, weight: Real, group: str) -> float:
        """Return the p-value of the one of a group that is furthest off: among many it hardly moves their sum."""
        place = self.groups[group]
        told = 1.0 - np.diag(self.solve(weight)[1])[place] * weight[place]
        seen = told > RULES.informed
        if not seen.any():
            return 1.0
        z = np.abs(u[place] * np.sqrt(weight[place]))[seen] / np.sqrt(told[seen])
        return float(2.0 * stats.norm.sf(z.max()) * seen.sum())

    def away(self, weight: Real, group: str) -> Real:
        """Return the scaled vector with a group where priors put it, all others as fitted."""
        u = self.u.copy()
        place = self.groups[group]
        mine = self.free[place]
        # A linear step may ask for what no machine has.
        u[mine] = np.clip(self.solve(weight)[0][place], self.model.low[mine], self.model.high[mine])
        return u

    def possible(self, u: Real) -> Real:
        """Return fitted values within their bounds: what the data say little of a straight line takes anywhere."""
        return np.clip(u, self.model.low[self.free], self.model.high[self.free])

    def at_declared(self, group: str, u: Real) -> Real:
        """Return a scaled vector with a group at its declared values."""
        back = u.copy()
        back[self.free[self.groups[group]]] = 0.0
        return back


def _variance(model: Model, target: Target, slope: Real, residual: Real, weight: Real) -> Real:
    """Return the variance of the noise in whitened values, (n,): of what a model may miss, the share that it does miss.

    That share is what a fit leaves beyond the noise that was measured. Each value counts by what it says of declared
    parameters, over their priors: orders at which there is no force leave nothing, whatever the others do.
    """
    sizes = {r: y.size for r, y in target.observed.items()}
    measured = {r: model.family.measured_noise(model.conditions[r]) for r in sizes}
    if all(m is None for m in measured.values()):
        return np.ones(residual.size)
    known = np.concatenate([np.ones(n) if (m := measured[r]) is None else m**2 for r, n in sizes.items()])
    ruled = weight > 0.0
    told = np.sum(slope[:, ruled] ** 2 / weight[ruled], axis=1)
    left = told * np.maximum(1.0 - np.sum(orthonormal(slope) ** 2, axis=1), 0.0)
    missed = float(told @ residual**2 - left @ known) / max(float(left @ (1.0 - known)), 1e-300)
    return np.asarray(known + min(max(missed, RULES.least_filled), 1.0) * (1.0 - known))


def as_known(model: Model, target: Target, at: Fit, k: int) -> bool:
    """Whether a fit has a cause no further from nothing than is known of it (`Cause.known`).

    Its parameters p with the covariance C of the fit are zero to within s: ``p^T (C + s^2)^-1 p`` is a chi-square.
    """
    if not model.causes[k].known:
        return False
    own = np.isin(at.free, model.of_cause[k])
    slope, _ = stacked(model, target, at.free, at.u, at.residual, at.slope)
    spread = np.linalg.pinv(slope.T @ slope, hermitian=True)[np.ix_(own, own)]
    off = at.u[at.free][own]
    pull = float(off @ np.linalg.solve(spread + np.diag(_trusted(model, k) ** 2), off))
    return pull <= float(stats.chi2.isf(RULES.contradicted, off.size))


def _trusted(model: Model, k: int) -> Real:
    """Return within what the parameters of a cause are known, scaled."""
    mine = model.of_cause[k]
    return np.asarray([model.causes[k].known[model.names[j]] for j in mine] / model.scale[mine])


def _within(model: Model, at: Fit) -> NDArray[np.bool_]:
    """Return which fitted parameters are not on a bound: there a slope may be left."""
    u, low, high = at.u[at.free], model.low[at.free], model.high[at.free]
    return np.asarray((u > low + 1e-9) & (u < high - 1e-9))


def contradicted(model: Model, target: Target, at: Fit, size: Size, material: float) -> list[Released]:
    """Return the groups of declared parameters that the data contradict and that matter, the clearest first."""
    return _released(Declared.of(model, target, at), size, material)


def masking(model: Model, target: Target, at: Fit, size: Size, material: float) -> list[Released]:
    """Return what would be contradicted if all that a fit leaves were the work of causes that are not in it yet."""
    return _released(replace(Declared.of(model, target, at), over=1.0), size, material)[:1]


def slightly_off(model: Model, target: Target, at: Fit) -> list[Released]:
    """Return the groups that the data put beyond what was declared, whatever that is worth."""
    linear = Declared.of(model, target, at)
    beyond = [g for g in linear.groups if linear.pull(linear.weight, g)[0] < RULES.contradicted]
    return _released(replace(linear, groups={g: linear.groups[g] for g in beyond}), lambda *_: 0.0, 0.0)


def strained(model: Model, target: Target, at: Fit, size: Size, material: float) -> Strain | None:
    """Return the nuisance without a name that the data put furthest beyond what is trusted of it; None for none.

    A fit that all but has it at its limit is not the baseline that was declared, and what it stands for is not known.
    It counts only where the values that the data ask for change what matters.
    """
    linear = Declared.of(model, target, at, named=False)
    if not linear.groups or linear.pull(linear.weight, "")[0] >= RULES.contradicted:
        return None
    # With these free all others go back to what was declared of them.
    asked = linear.u.copy()
    asked[linear.free] = linear.possible(linear.solve(linear.without(linear.weight, linear.groups[""]))[0])
    changed = size(linear.at_declared("", asked), asked, "")
    if changed < material:
        return None
    place = linear.groups[""]
    worst = at.free[place][int(np.argmax(np.abs(at.u[at.free[place]]) * np.sqrt(linear.weight[place])))]
    return Strain(model.parameters[worst].said or str(model.names[worst]), changed)


def _released(linear: Declared, size: Size, material: float) -> list[Released]:
    weight, found, left = linear.weight.copy(), list[Released](), set(linear.groups)
    while left:
        beyond = {g: _beyond(linear, weight, g, size, material) for g in left}
        open_ = [g for g in sorted(left) if beyond[g] > 0.0]
        if not open_:
            break
        parts = {g: linear.fewest(weight, g) for g in left}
        # Each is charged for its parameters; what fits best has fitted what they differ by within their priors, too.
        without = {g: linear.without(weight, parts[g]) for g in left}
        merits = {g: linear.merit(without[g]) - RULES.penalty * linear.informed(weight, parts[g]) for g in left}
        first = max(open_, key=lambda g: (merits[g], beyond[g]))
        own, instead = linear.away(without[first], first), [first]
        margin = float(stats.chi2.ppf(RULES.agreed, linear.informed(weight, parts[first])))
        for g in sorted(left - {first}):
            if merits[g] < merits[first] - margin or linear.impossible(without[g], g, parts[g]):
                continue
            # It stands for the first where, with it released, the first is as declared again.
            back = linear.away(without[g], first)
            if not _beyond(linear, without[g], first, size, material) and _length(linear, first, back) < (
                RULES.stands_for * _length(linear, first, own)
            ):
                instead.append(g)
        # Of those that fit alike, but for the charge of a parameter, the one leads that leaves its tolerance least.
        alike = [g for g in instead if g in open_ and merits[g] >= merits[first] - 1.01 * RULES.penalty]
        first = min(alike, key=lambda g: _length(linear, g, linear.away(without[g], g)))
        instead.sort(key=lambda g: (g != first, -merits[g]))
        values, deviations = [], []
        for g in instead:
            u, covariance = linear.solve(without[g])
            u, place = linear.possible(u), parts[g]
            values.append(dict(zip(linear.free[place].tolist(), u[place].tolist(), strict=True)))
            spread = np.sqrt(np.maximum(np.diag(covariance)[place], 0.0))
            deviations.append(dict(zip(linear.free[place].tolist(), spread.tolist(), strict=True)))
        gained = linear.merit(without[first]) - linear.merit(weight)
        found.append(Released(tuple(instead), gained, tuple(values), tuple(deviations)))
        weight = without[first]
        left -= set(instead)
    return found


def _length(linear: Declared, group: str, u: Real) -> float:
    """Return how far a group is from what was declared, in standard deviations of its priors."""
    place = linear.groups[group]
    return float(np.linalg.norm(u[linear.free[place]] * np.sqrt(linear.weight[place])))


def _beyond(linear: Declared, weight: Real, group: str, size: Size, material: float) -> float:
    """Return by how many z a group is beyond what was declared of it, where that matters; zero: it is not."""
    p_value, alone = linear.pull(weight, group)
    parameters = [linear.model.parameters[j] for j in linear.free[linear.groups[group]]]
    stated = all(p.stated for p in parameters)
    if p_value >= RULES.contradicted and (stated or alone < RULES.told):
        return 0.0
    # What no declared value explains is not white: its size says too little of what it makes of a value.
    if linear.over > 1.0 and alone < RULES.told:
        return 0.0
    # What a value costs that its prior holds back is that of the one which the data ask for.
    asked = linear.without(weight, linear.groups[group]) if p_value < RULES.contradicted else weight
    u = linear.away(asked, group)
    cost = size(linear.at_declared(group, u), u, group)
    needed = material if p_value < RULES.contradicted else RULES.unstated * material
    return alone if cost >= needed else 0.0
