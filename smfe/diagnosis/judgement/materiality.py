"""What is large enough to matter: sizes of misfits and of differences between models, in depth where it is known.

A misfit matters by the relative size that its family gives it (`Abilities.squared_size`), a quadratic form from which
the mean of noise is taken off; what noise alone reaches in one of a hundred cases has no size. What a cause or a
parameter changes is counted by the limit depth of the cuts that the campaign asks for, and without any by the
difference of the predictions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from process.types import Real
from smfe.diagnosis.inference.fit import Fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition, Values
from smfe.diagnosis.inference.rules import RULES

Cost = Callable[[Values, Values], float | None]
"""Largest relative change of a limit depth between two sets of values [1]; None where no cut is given."""


def no_cut(before: Values, after: Values) -> float | None:
    """Where no cut is given no depth is known."""
    return None


@dataclass(frozen=True)
class Worth:
    """What matters in a campaign."""

    material: float = 0.0  # relative size from which on something matters [1]; zero: everything does
    cost: Cost = no_cut  # change of the limit depths
    shown: Cost = no_cut  # the same of the depths that what sensors show would give

    def of_causes(self, model: Model, rows: Sequence[int], before: Real, after: Real, measurement: bool) -> float:
        """Return the size of what lies between two scaled vectors [1]: in depth, of sensors in what they show.

        What sensors show counts by itself as well: an axis that the cut does not push along may be wrong alone.
        """
        known = (self.shown if measurement else self.cost)(model.values(before), model.values(after))
        if known is not None and not measurement:
            return known
        return max(predicted_size(model, rows, before, after), known or 0.0)

    def of_nameless(self, model: Model, rows: Sequence[int], before: Real, after: Real) -> float:
        """Return the size of what lies between two scaled vectors where nobody says what each of it belongs to [1].

        What changes no depth by itself is what a sensor shows, and counts as that.
        """
        machine, given = self.of_causes(model, rows, before, after, False), model.values(before)
        if self.cost(given, model.values(after)) is None:
            return machine
        seen = before.copy()
        for j in np.flatnonzero(before != after):
            one = before.copy()
            one[j] = after[j]
            if self.cost(given, model.values(one)) == 0.0:
                seen[j] = after[j]
        return max(machine, self.of_causes(model, rows, before, seen, True))

    def left(self, model: Model, residual: Mapping[int, Real], rng: np.random.Generator) -> float:
        """Return the size of a misfit beyond noise [1].

        Where each condition counts, those are left out in which noise alone is some times what is material and all
        values together leave no more than noise: how often it is more than that depends on how it is distributed far
        out, which nobody knows.
        """
        found: list[float] = []
        every = len(residual)
        noises = {r: _noise(model, model.conditions[r], x.size, rng) for r, x in residual.items()}
        drowned = [
            r
            for r, noise in noises.items()
            if model.family.each_counts
            and float(np.mean(noise)) > (RULES.drowned * self.material) ** 2 > 0.0
            and float(stats.chi2.sf(float(residual[r] @ residual[r]), residual[r].size)) >= RULES.band
        ]
        for r, x in residual.items():
            condition, noise = model.conditions[r], noises[r]
            if r in drowned and len(drowned) < every:
                found.append(0.0)
                continue
            over = model.family.squared_size(condition, x) - float(np.mean(noise))
            # Where each condition counts the largest of them is looked at.
            level = 1.0 - (1.0 - RULES.noise_quantile) / (every if model.family.each_counts else 1)
            beyond = over > float(np.quantile(noise, level)) - float(np.mean(noise))
            found.append(over if beyond or not model.family.each_counts else 0.0)
        return _together(model, list(residual), found)


EVERYTHING = Worth()
"""Where everything matters."""


def predicted_size(model: Model, rows: Sequence[int], before: Real, after: Real) -> float:
    """Return the size of the difference between two predictions [1]; infinite where there is none."""
    found, values = [], (model.values(before), model.values(after))
    for r in rows:
        a, b = model.predict(r, before), model.predict(r, after)
        if a is None or b is None:
            return math.inf
        found.append(model.family.squared_change(model.conditions[r], *values, b - a))
    return _together(model, rows, found)


def _together(model: Model, rows: Sequence[int], squares: Sequence[float]) -> float:
    """Return the largest size, or the rms over the conditions by the squares of their data."""
    if not squares:
        return 0.0
    if model.family.each_counts:
        return math.sqrt(max(0.0, *squares))
    data = [model.conditions[r].observed for r in rows]
    weight = np.array([1.0 if y is None else float(y @ y) for y in data])
    return math.sqrt(max(float(np.sum(weight * np.array(squares)) / weight.sum()), 0.0))


def _noise(model: Model, condition: Condition, size: int, rng: np.random.Generator) -> Real:
    """Return the size that noise alone has, squared, a few hundred times."""
    draws = rng.standard_normal((RULES.noise_draws, size))
    if (known := model.family.measured_noise(condition)) is not None:
        draws *= known
    return np.array([model.family.squared_size(condition, x) for x in draws])


def residual_of(model: Model, fitted: Mapping[int, Sequence[Real]], fallback: Fit) -> dict[int, Real]:
    """Return prediction - data of conditions that a fit has not seen, the first of each; else of the fit to all."""
    found = dict(fallback.residual)
    for r, us in fitted.items():
        observed = model.conditions[r].observed
        predicted = model.predict(r, us[0]) if us else None
        if predicted is not None and observed is not None:
            found[r] = predicted - observed
    return found
