"""Joint fit of nuisances and causes: bounded least squares of whitened residuals and priors.

Gauss-Newton steps inside the bounds, each slope used as long as it serves and corrected after every step
(Broyden, Math. Comp. 19, 1965); where they do not converge damped steps that bend with the misfit take over (Transtrum
and Sethna, arXiv:1201.5885). What has converged is said by the decrement, the decrease of the misfit that a bounded
linear step still predicts: it is a likelihood ratio and can be compared with thresholds. A fit that has not converged
is never evidence: one such baseline in 24 was seen to raise a false alarm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from process.types import Real
from smfe.diagnosis.inference.misfit import triangle
from smfe.diagnosis.inference.model import Index, Model
from smfe.diagnosis.inference.rules import RULES


@dataclass(frozen=True)
class Target:
    """What is fitted: data by condition number, and the scaled values that the priors are centred on."""

    observed: Mapping[int, Real]
    centre: Real

    def without(self, rows: Sequence[int]) -> Target:
        """Leave conditions out."""
        return Target({r: y for r, y in self.observed.items() if r not in rows}, self.centre)

    def only(self, rows: Sequence[int]) -> Target:
        """Keep some conditions."""
        return Target({r: self.observed[r] for r in rows}, self.centre)


@dataclass(frozen=True)
class Fit:
    """Best values of one hypothesis."""

    causes: tuple[int, ...]  # numbers of the causes in it
    free: Index  # shape (p,): fitted parameters
    u: Real  # all scaled parameters
    chi2: float  # misfit: squares of the whitened residuals and of the deviations from the priors
    residual: Mapping[int, Real]  # prediction - data of each condition
    slope: Mapping[int, Real]  # slopes of each condition with the fitted parameters, (n, p)
    converged: bool  # whether it may be used as evidence
    reason: str = ""  # why not
    provisional: bool = False
    """Whether the slopes are those of another fit nearby: good enough to lose by, not to win by."""
    promised: float = 0.0  # decrease of the misfit that a linear step still promises


def residuals(model: Model, target: Target, u: Real) -> dict[int, Real] | None:
    """Prediction - data of each condition; None where the family predicts nothing."""
    found: dict[int, Real] = {}
    model.prepare([(row, u) for row in target.observed])
    for row, observed in target.observed.items():
        predicted = model.predict(row, u)
        if predicted is None:
            return None
        found[row] = predicted - observed
    return found


def stacked(
    model: Model, target: Target, free: Index, u: Real, residual: Mapping[int, Real], slope: Mapping[int, Real]
) -> tuple[Real, Real]:
    """Slopes (N, p) and residuals (N,) of all conditions, then of the priors."""
    ruled = np.flatnonzero(model.weight[free] > 0.0)
    prior = np.zeros((ruled.size, free.size))
    prior[np.arange(ruled.size), ruled] = model.weight[free][ruled]
    away = (u - target.centre)[free][ruled] * model.weight[free][ruled]
    rows = list(target.observed)
    return np.concatenate([*(slope[r] for r in rows), prior]), np.concatenate([*(residual[r] for r in rows), away])


def misfit(model: Model, target: Target, free: Index, u: Real, residual: Mapping[int, Real] | None) -> float:
    """Squares of all residuals and prior deviations; infinite where nothing is predicted."""
    if residual is None:
        return float("inf")
    away = ((u - target.centre) * model.weight)[free]
    return float(sum(float(r @ r) for r in residual.values()) + away @ away)


def bounded_step(slope: Real, residual: Real, low: Real, high: Real) -> tuple[Real, float]:
    """Solve ``min |residual + slope step|^2`` for ``low <= step <= high``; return the step and the decrease."""
    if slope.shape[1] == 0:
        return np.zeros(0), 0.0
    r, aim = _triangle(slope, residual)
    size = np.linalg.norm(r, axis=0)
    size[size == 0.0] = 1.0
    step = _least(r / size, aim) / size
    if np.any(step < low) or np.any(step > high):
        step = lsq_linear(r, aim, bounds=(low, high + 1e-12 * (high <= low)), method="bvls").x
    left = r @ step - aim
    return np.asarray(step), max(float(aim @ aim - left @ left), 0.0)


def _triangle(slope: Real, residual: Real) -> tuple[Real, Real]:
    """Return R of ``slope = Q R``, and ``-Q^T residual``."""
    if (upper := triangle(slope)) is not None:
        return upper, -solve_triangular(upper, slope.T @ residual, trans="T")
    # Of Q only its product with the residual is needed: that of a further column.
    whole = np.asarray(np.linalg.qr(np.column_stack([slope, residual]), mode="r"))
    count = min(slope.shape)
    return whole[:count, :-1], -whole[:count, -1]


def _least(r: Real, aim: Real) -> Real:
    """Solve an upper triangular system, of least norm where parameters are not separable."""
    diagonal = np.abs(np.diag(r))
    if r.shape[0] == r.shape[1] and diagonal.min() > 1e-6 * diagonal.max():
        return np.asarray(solve_triangular(r, aim))
    return np.asarray(np.linalg.lstsq(r, aim, rcond=1e-9)[0])


def tolerance(target: Target, chi2: float) -> float:
    """Return by how much a misfit need not be known better."""
    values = sum(y.size for y in target.observed.values())
    bad = max(RULES.bad_tolerance * (chi2 - 2.0 * values), RULES.left_tolerance * (chi2 - values))
    return max(RULES.tolerance, RULES.relative_tolerance * chi2, bad)


@dataclass
class _State:
    """Where a fit stands."""

    model: Model
    target: Target
    free: Index
    u: Real
    residual: dict[int, Real] | None
    chi2: float
    loose: float = 0.0  # share of the misfit that it need not be known better, at the least

    @classmethod
    def at(cls, model: Model, target: Target, free: Index, u: Real) -> _State:
        residual = residuals(model, target, u)
        return cls(model, target, free, u, residual, misfit(model, target, free, u, residual))

    @classmethod
    def begin(
        cls, model: Model, target: Target, causes: Sequence[int], start: Real, only: Index | None = None
    ) -> _State:
        free, u = model.free(causes) if only is None else only, np.array(start)
        u[free] = np.clip(u[free], model.low[free], model.high[free])
        return cls.at(model, target, free, u)

    def take(self, u: Real) -> float:
        """Go to some values if the misfit falls; return by how much."""
        trial = _State.at(self.model, self.target, self.free, u)
        gained = self.chi2 - trial.chi2
        if not gained > 0.0:
            return 0.0
        self.u, self.residual, self.chi2 = trial.u, trial.residual, trial.chi2
        return gained

    @property
    def tolerance(self) -> float:
        return max(tolerance(self.target, self.chi2), self.loose * self.chi2)

    @property
    def rough(self) -> float:
        """Decrease that slopes may promise where no step brings any.

        Roughness of the predictions is a misfit in proportion to the residual: ``2 r . d`` for a distance d.
        """
        values = sum(y.size for y in self.target.observed.values())
        over = math.sqrt(max(self.chi2 / max(values, 1), 1.0)) if self.model.roughness > 0.0 else 1.0
        return max(self.tolerance, RULES.rough * over)

    def step(self, slope: Mapping[int, Real]) -> tuple[Real, float]:
        assert self.residual is not None
        jacobian, residual = stacked(self.model, self.target, self.free, self.u, self.residual, slope)
        at = self.u[self.free]
        return bounded_step(jacobian, residual, self.model.low[self.free] - at, self.model.high[self.free] - at)

    def advance(self, step: Real) -> float:
        """Go along a step as far as the misfit falls; return by how much it fell."""
        low, high = self.model.low[self.free], self.model.high[self.free]
        for fraction in RULES.fractions:
            u = self.u.copy()
            u[self.free] = np.clip(u[self.free] + fraction * step, low, high)
            if gained := self.take(u):
                return gained
        return 0.0

    def descend(self, slope: Mapping[int, Real], most: float = np.inf) -> tuple[Mapping[int, Real], float]:
        """Take steps while they serve and, after the first, while a misfit of `most` is in reach.

        Return the slopes as corrected on the way and the decrement left.
        """
        promised = 0.0
        for n in range(RULES.steps):
            step, promised = self.step(slope)
            if promised < 0.1 * self.tolerance or (n and self.chi2 - RULES.optimism * promised > most):
                break
            u, residual = self.u, self.residual
            came_true = self.advance(step) / promised
            slope = self._corrected(slope, u, residual)
            if came_true < 0.3:
                break
        return slope, promised

    def _corrected(self, slope: Mapping[int, Real], u: Real, residual: Mapping[int, Real] | None) -> Mapping[int, Real]:
        """Slopes that explain the step from u, where the residual was another."""
        step = (self.u - u)[self.free]
        square = float(step @ step)
        if square == 0.0 or residual is None or self.residual is None:
            return slope
        now, less = self.residual, step / square
        return {r: x + np.outer(now[r] - residual[r] - x @ step, less) for r, x in slope.items()}

    def probe(self, slope: Mapping[int, Real]) -> tuple[Mapping[int, Real], float]:
        """Correct slopes of rough predictions along what they promise in vain; return them and what is left of it.

        Each column is off by the roughness over its step. Where columns cancel (stiffness, mass and gain in proportion)
        what is left of them is less than that error, and against a large residual it promises much. A difference along
        the step itself is that much more exact. Its surprise is shared among the columns as they are uncertain:
        recursive least squares, each column known with the inverse square of its step (Ljung, System Identification,
        1999, section 11.2).
        """
        steps = self.model.slope_steps(self.free)
        unsure = np.diag(0.5 / steps**2)
        step, promised = self.step(slope)
        for _ in range(self.free.size + 1):
            if promised < self.rough:
                break
            found = self._along(step, slope)
            if found is None:
                break
            length, seen = found
            gain = unsure @ step / (step @ unsure @ step + 0.5 / length**2)
            slope = {r: x + np.outer(seen[r] - x @ step, gain) for r, x in slope.items()}
            unsure = unsure - np.outer(gain, step @ unsure)
            step, promised = self.step(slope)
            if promised >= self.rough:
                self.advance(step)
                step, promised = self.step(slope)
        return slope, promised

    def _along(self, step: Real, slope: Mapping[int, Real]) -> tuple[float, dict[int, Real]] | None:
        """Return what a step changes by differences, and the part of it that they were taken over.

        Where one end predicts nothing, or is out of bounds, the difference is one-sided.
        """
        change = math.sqrt(sum(float(np.sum(np.square(x @ step))) for x in slope.values()))
        if change == 0.0 or self.residual is None:
            return None
        length = min(1.0, RULES.above_roughness * self.model.roughness / change)
        low, high = self.model.low[self.free], self.model.high[self.free]
        ends: list[tuple[float, dict[int, Real]]] = []
        for sign in (length, -length):
            u = self.u.copy()
            u[self.free] += sign * step
            if np.all(u[self.free] >= low) and np.all(u[self.free] <= high):
                found = residuals(self.model, self.target, u)
                if found is not None:
                    ends.append((sign, found))
        if not ends:
            return None
        if len(ends) == 1:
            ends.append((0.0, self.residual))
        (a, one), (b, other) = ends
        return 0.5 * abs(a - b), {r: (one[r] - other[r]) / (a - b) for r in one}

    def done(self, causes: tuple[int, ...], slope: Mapping[int, Real], reason: str = "") -> Fit:
        residual: Mapping[int, Real] = {} if self.residual is None else self.residual
        return Fit(causes, self.free, self.u, self.chi2, residual, slope, not reason, reason)


def fit(
    model: Model,
    target: Target,
    causes: Sequence[int],
    start: Real,
    slope: Mapping[int, Real] | None = None,
    most: float = np.inf,
    loose: float = 0.0,
    only: Index | None = None,
) -> Fit:
    """Fit the nuisances and some causes, beginning with slopes of another hypothesis where they are given.

    The misfit is found to the share `loose` of it, or as well as a likelihood ratio needs it where that is more.

    All other causes stay where `start` has them, and where `only` some parameters are fitted all others. A fit that has
    not converged, and may not be used, says why. One that would not come below `most` with all that its steps promise
    has lost and is followed no further.
    """
    chosen, state = tuple(sorted(causes)), _State.begin(model, target, causes, start, only)
    state.loose = loose
    if state.residual is None:
        return state.done(chosen, {}, f"no prediction ({model.trouble})")
    if slope is not None:
        state.descend(slope)
    rows, free = list(target.observed), state.free
    fresh: Mapping[int, Real] = {}
    for cycle in range(RULES.cycles + 1 + RULES.last_cycles):
        slopes = model.slopes(rows, state.u, free)
        if slopes is None:
            return state.done(chosen, {}, f"no prediction beside the optimum ({model.trouble})")
        fresh = slopes
        decrement = state.step(fresh)[1]
        if decrement < state.tolerance:
            return state.done(chosen, fresh)
        if state.chi2 - RULES.hope * decrement > most:
            return replace(state.done(chosen, fresh), provisional=True, promised=decrement)
        before = state.chi2
        if cycle != RULES.cycles:  # where so many plain steps did not end, damped ones take them near the end
            state.descend(fresh)
        if before - state.chi2 < 0.1 * decrement:
            if model.roughness > 0.0:
                fresh, decrement = state.probe(fresh)
            if decrement < state.rough:
                return state.done(chosen, fresh)
            if state.chi2 - decrement > most:
                return replace(state.done(chosen, fresh), provisional=True, promised=decrement)
            _valley(state, fresh)
        if state.chi2 >= before:
            break
    reason = f"not converged: a linear step still promises {decrement:.3g} of chi-square"
    return replace(state.done(chosen, fresh, reason), promised=decrement)


def approach(
    model: Model, target: Target, causes: Sequence[int], start: Real, slope: Mapping[int, Real], most: float = np.inf
) -> Fit | None:
    """Fit with given slopes only, corrected on the way; None where nothing is predicted.

    A fit that will not come below `most`, the largest misfit that would matter, has lost and is followed no further.
    """
    chosen, state = tuple(sorted(causes)), _State.begin(model, target, causes, start)
    if state.residual is None:
        return None
    slope, promised = state.descend(slope, most)
    done = promised <= state.rough or state.chi2 - RULES.optimism * promised > most
    left = "" if done else f"a linear step still promises {promised:.3g}"
    return replace(state.done(chosen, slope, left), provisional=True, promised=promised)


def part(model: Model, target: Target) -> Target:
    """Return a few of many conditions, those that have the most settings which none before them has.

    What the first, fifth and ninth condition have in common (all three at rest) would be all that their fit knows.
    """
    rows = list(target.observed)
    if len(rows) < RULES.several:
        return target
    settings = {r: set(model.conditions[r].settings.items()) for r in rows}
    chosen, seen = rows[:1], set(settings[rows[0]])
    while len(chosen) < -(-2 * len(rows) // RULES.several):
        new = max((r for r in rows if r not in chosen), key=lambda r: len(settings[r] - seen))
        chosen.append(new)
        seen |= settings[new]
    return target.only(sorted(chosen))


def roughly(model: Model, target: Target) -> Real:
    """Return scaled values near the optimum of the baseline, fitted to a part of the conditions where they are many.

    Where what is declared is far off in units of noise, priors lead at first: their weight is lowered in steps to what
    it is (tempering). What the data say little of would otherwise run away before the rest is in place.
    """
    rows, only = list(target.observed), part(model, target)
    u, weight, values = model.null(), model.weight, sum(y.size for y in only.observed.values())
    off = misfit(model, only, model.nuisance, u, residuals(model, only, u)) / max(values, 1)
    try:
        for temperature in (t for t in RULES.temperatures if 1.0 < t < off < np.inf):
            model.weight = weight * np.sqrt(temperature)
            warmer = fit(model, only, (), u, loose=RULES.warm)
            u = warmer.u if np.isfinite(warmer.chi2) else u
    finally:
        model.weight = weight
    found = fit(model, only, (), u)
    if len(only.observed) < len(rows) and residuals(model, target, found.u) is None:
        found = fit(model, target, (), model.null(), loose=RULES.warm)
    return found.u if np.isfinite(found.chi2) else model.null()


def plausibly(model: Model, target: Target, causes: Sequence[int] = (), start: Real | None = None) -> Real:
    """Return scaled values, with some causes, that fit some conditions while what they leave counts as noise.

    All that is not fitted stays where `start` has it; default: at its null.

    Where something is hidden that no nuisance explains the best fit moves all of them to where nobody would believe
    them. With the noise as large as what is left, priors hold what the data are not that clear about.
    """
    only, u, weight = part(model, target), model.null() if start is None else start, model.weight
    values = sum(y.size for y in only.observed.values())
    try:
        for _ in range(RULES.plausible):
            found = residuals(model, only, u)
            left = np.inf if found is None else sum(float(x @ x) for x in found.values()) / values
            model.weight = weight * np.sqrt(max(left, 1.0)) if left < np.inf else weight
            u = fit(model, only, causes, u, loose=RULES.warm).u
    finally:
        model.weight = weight
    return u if residuals(model, target, u) is not None else model.null()


def refit(model: Model, target: Target, near: Fit) -> Fit:
    """Fit a hypothesis to less or other data than `near` was fitted to, starting there and with its slopes."""
    if all(r in near.slope for r in target.observed):
        found = approach(model, target, near.causes, near.u, {r: near.slope[r] for r in target.observed})
        if found is not None and found.converged:
            return found
    return fit(model, target, near.causes, near.u)


def _valley(state: _State, slope: Mapping[int, Real]) -> None:
    """Follow a curved valley of the misfit where plain steps do not: damped steps, bent as the residual is curved.

    To Levenberg and Marquardt's step v, ``J v = -r``, comes half of the acceleration a of the path on which the linear
    part of the residual goes to zero, ``J a = -r_vv``, both damped alike; the second derivative along v takes one more
    prediction. A step that is bent too much is damped more (Transtrum and Sethna, arXiv:1201.5885, sections 2 and 4).
    """
    model, target, free = state.model, state.target, state.free
    rows, damping, size = list(target.observed), RULES.damping, np.zeros(free.size)
    flat = dict.fromkeys(rows, np.zeros((0, free.size)))

    def at(step: Real) -> tuple[Real, Real | None]:
        u = state.u.copy()
        u[free] = np.clip(u[free] + step, model.low[free], model.high[free])
        found = residuals(model, target, u)
        return u, None if found is None else stacked(model, target, free, u, found, flat)[1]

    for _ in range(RULES.valley_steps):
        assert state.residual is not None
        jacobian, residual = stacked(model, target, free, state.u, state.residual, slope)
        r, aim = _triangle(jacobian, residual)
        size = np.maximum(size, np.linalg.norm(r, axis=0))
        bounds = model.low[free] - state.u[free], model.high[free] - state.u[free]
        gained = 0.0
        for _ in range(RULES.dampings):
            held = np.concatenate([r, math.sqrt(damping) * np.diag(np.maximum(size, 1e-12))])
            v, _ = bounded_step(held, np.concatenate([-aim, np.zeros(free.size)]), *bounds)
            if float(aim @ aim - np.sum((r @ v - aim) ** 2)) < 0.1 * state.tolerance:
                return
            damping *= RULES.more_damping
            ahead = at(RULES.ahead * v)[1]
            if ahead is None:
                continue
            bent = 2.0 / RULES.ahead * ((ahead - residual) / RULES.ahead - jacobian @ v)
            upper = np.asarray(np.linalg.qr(held, mode="r"))
            a = cho_solve((upper, False), -(jacobian.T @ bent))
            if 2.0 * np.linalg.norm(size * a) > RULES.bent * np.linalg.norm(size * v):
                continue
            if gained := state.take(at(v + 0.5 * a)[0]):
                damping /= RULES.more_damping * RULES.less_damping
                break
        if gained < 0.1 * state.tolerance:
            return
        taken = model.slopes(rows, state.u, free, rough=True)
        if taken is None:
            return
        slope = taken


# --- Symmetries of a cause: of two sets of values that fit alike, the one that is nearer to the null.


def nearest(model: Model, target: Target, found: Fit, added: Sequence[int]) -> Fit:
    """Return the equivalent parameters of a fit where they fit as well and are nearer to the null."""
    for k in added:
        mine = model.of_cause[k]
        equivalent = model.causes[k].equivalent
        if equivalent is None:
            continue
        values = model.values(found.u)
        start = found.u.copy()
        start[mine] = (np.array(equivalent(values)) - model.start[mine]) / model.scale[mine]
        if np.linalg.norm(start[mine]) < np.linalg.norm(found.u[mine]):
            other = fit(model, target, found.causes, start)
            if other.converged and other.chi2 < found.chi2 + RULES.equivalent:
                found = other
    return found
