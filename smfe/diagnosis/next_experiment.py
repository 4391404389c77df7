"""Which experiment would settle what remains open: T-optimal discrimination (Atkinson, Fedorov, Biometrika 62, 1975).

``D(e) = min over pairs of min |y_i - y_j|^2`` over the parameters and nuisances of j, on what was measured and the
proposal e together, with the data that hypothesis i predicts. The likelihood ratio between the two is then about
normal with mean D and variance 4 D, which gives the chance that the experiment settles the pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from smfe.diagnosis.fit import Fit, Target, refit
from smfe.diagnosis.model import Model

Real = NDArray[np.float64]

MARGIN = float(stats.chi2.ppf(0.99, 1))
"""Likelihood ratio by which the best hypothesis must at least lead."""


@dataclass(frozen=True)
class Proposal:
    """An experiment that could be done next.

    Attributes
    ----------
    name : str
        Of the condition.
    discrimination : float
        D of the pair that it separates worst [chi-square], what was measured included.
    chance : float
        Probability that it settles that pair.
    expected : str
        What to look for.
    """

    name: str
    discrimination: float
    chance: float
    expected: str


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
    """Rank proposals, the most telling first.

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
    for row in rows:
        fits = [discrimination(model, target, a, b, [row]) for a, b in permutations(open_, 2)]
        if not fits or any(f is None or not f.converged for f in fits):
            continue
        worst = min((f for f in fits if f is not None), key=lambda f: f.chi2)
        apart = math.sqrt(float(np.mean(worst.residual[row] ** 2)))
        chance = chance_to_settle(worst.chi2)
        words = (
            f"at {model.conditions[row].name} the predictions of {title or 'the hypotheses'} differ by {apart:.2g} "
            f"times the noise (rms) at least; it settles the question with {100.0 * chance:.0f} %"
        )
        found.append(Proposal(model.conditions[row].name, worst.chi2, chance, words))
    return sorted(found, key=lambda p: -p.discrimination)
