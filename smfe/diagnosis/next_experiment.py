"""Which experiment would settle what remains open: T-optimal discrimination (Atkinson, Fedorov, Biometrika 62, 1975).

``D(e) = min over pairs of min |y_i - y_j|^2`` over the parameters and nuisances of j, on what was measured and the
proposal e together, with the data that hypothesis i predicts. The likelihood ratio between the two is then about
normal with mean D and variance 4 D, which gives the chance that the experiment settles the pair. An experiment that
takes t minutes and settles it with the chance p, repeated until it does, takes t/p: the least of these comes first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from smfe.diagnosis.fit import Fit, Target, refit
from smfe.diagnosis.model import Model

Real = NDArray[np.float64]

MARGIN = float(stats.chi2.ppf(0.99, 1))
"""Likelihood ratio by which the best hypothesis must at least lead."""

TRIED = 5
"""Proposals that are examined with the rivals fitted anew."""

_NOTHING = 0.1  # of chi-square
MINUTES = 5.0
"""What a proposal takes that does not say."""


@dataclass(frozen=True)
class Proposal:
    """An experiment that could be done next.

    Attributes
    ----------
    name : str
        Of the condition.
    discrimination : float
        D of the pair that it separates worst [chi-square], what was measured included; NaN where nothing has to be
        told apart and it is to show what could be hidden.
    chance : float
        Probability that it settles that pair, or shows what it is said to show.
    expected : str
        What to look for.
    minutes : float or None
        What it takes; None where nothing is said about it.
    """

    name: str
    discrimination: float
    chance: float
    expected: str
    minutes: float | None = None


def discrimination(model: Model, target: Target, truth: Fit, rival: Fit, rows: Sequence[int]) -> Fit | None:
    """Fit a rival to what another hypothesis predicts for the measured conditions and `rows`; its chi2 is D."""
    every = [*target.observed, *rows]
    predicted = {r: y for r in every if (y := model.predict(r, truth.u)) is not None}
    slope = model.slopes(rows, rival.u, rival.free)
    if len(predicted) < len(every) or slope is None:
        return None
    centre = np.where(np.isin(np.arange(truth.u.size), truth.free), truth.u, target.centre)
    return refit(model, Target(predicted, centre), replace(rival, slope={**rival.slope, **slope}))


def chance_to_settle(found: float) -> float:
    """Probability that a likelihood ratio of mean D and variance 4 D exceeds the margin."""
    return float(stats.norm.cdf((found - MARGIN) / (2.0 * math.sqrt(found)))) if found > 0.0 else 0.0


def rank(model: Model, target: Target, open_: Sequence[Fit], rows: Sequence[int], title: str = "") -> list[Proposal]:
    """Rank proposals, the one that is expected to settle the matter soonest first.

    Only the `TRIED` that could tell most, if no parameter gave way, are examined.

    Parameters
    ----------
    model, target : Model, Target
        What predicts; the data measured so far.
    open_ : sequence of Fit
        Hypotheses that remain.
    rows : sequence of int
        Conditions that could be measured.
    title : str, optional
        What the hypotheses are about, for the words.
    """
    found = []
    for row in _promising(model, open_, rows):
        pairs = [(a, discrimination(model, target, a, b, [row])) for a, b in permutations(open_, 2)]
        fits = [f for a, f in pairs if f is None or not _imitates(f, a)]
        if not fits or any(f is None or not f.converged for f in fits):
            continue
        worst = min((f for f in fits if f is not None), key=lambda f: f.chi2)
        apart = math.sqrt(float(np.mean(worst.residual[row] ** 2)))
        chance = chance_to_settle(worst.chi2)
        words = (
            f"there the predictions of {title or 'the hypotheses'} differ by {apart:.2g} times the noise (rms) at "
            f"least; the chance that it settles the question is {100.0 * chance:.0f} %"
        )
        found.append(Proposal(model.conditions[row].name, worst.chi2, chance, words, _minutes(model, row)))
    return sorted(found, key=lambda p: ((p.minutes or MINUTES) / max(p.chance, 1e-9), -p.discrimination))


def _imitates(rival: Fit, truth: Fit) -> bool:
    """Return whether a rival with more parameters contains the truth: then no experiment tells, but parsimony does."""
    return rival.converged and rival.chi2 < _NOTHING and rival.free.size > truth.free.size


def _promising(model: Model, open_: Sequence[Fit], rows: Sequence[int]) -> list[int]:
    """Return the rows whose predictions differ most for each minute: a rival that is not fitted anew bounds D."""
    worth: dict[int, float] = {}
    for row in rows:
        predicted = [model.predict(row, f.u) for f in open_]
        known = [y for y in predicted if y is not None]
        if len(known) == len(predicted):
            apart = min((float(np.sum((a - b) ** 2)) for a, b in combinations(known, 2)), default=0.0)
            worth[row] = apart / (_minutes(model, row) or MINUTES)
    return sorted(worth, key=lambda row: -worth[row])[:TRIED]


def _minutes(model: Model, row: int) -> float | None:
    said = model.conditions[row].settings.get("minutes")
    return None if said is None else float(said)
