"""Whether the parameters of a fit are the same in all conditions: what changes when a cause is not in the catalogue.

A misfit that is spread thinly over many conditions shows in no single one. But where a parameter differs with a setting
(it creeps with time, it is another backwards), the score of that parameter has the pattern of the setting: the slope of
each condition times its setting, with all that the fitted parameters imitate projected off, is tested like the
signature of a cause (tests of parameter constancy; Nyblom, JASA 84, 1989). The largest ratio over all parameters and
settings is held against what noise alone makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smfe.diagnosis.calibration import DRAWS, PENALTY, products_of_noise, upper
from smfe.diagnosis.model import Model
from smfe.diagnosis.signature import CONFOUNDED, Tangent, inside

Real = NDArray[np.float64]

CHANCE = 1e-4
"""Of noise alone to make a parameter change: slow noise, which is known least, looks most like it."""

_MOST_WORDS = 6
"""Words of a setting, such as names of controllers, that are told apart."""


@dataclass(frozen=True)
class Change:
    """The parameter that changes most.

    Attributes
    ----------
    parameter, setting : str
        What changes with what.
    ratio, threshold : float
        Likelihood ratio of letting it change, and what chance reaches.
    """

    parameter: str
    setting: str
    ratio: float
    threshold: float

    @property
    def certain(self) -> bool:
        """Whether it is more than noise."""
        return self.ratio > self.threshold


def most_changing(model: Model, at: Tangent, rng: np.random.Generator, chance: float = CHANCE) -> Change | None:
    """Return the parameter that differs most between the conditions; None where no setting contrasts them.

    Parameters
    ----------
    model : Model
        With the conditions.
    at : Tangent
        The fit.
    rng : numpy.random.Generator
        Draws the threshold.
    chance : float, optional
        Of noise alone to be above the threshold.
    """
    found = list(_patterns(model, at))
    if not found:
        return None
    columns = [c for _, _, c in found]
    inverses = [np.linalg.pinv(c.T @ c, rcond=1e-10, hermitian=True) for c in columns]
    charges = [PENALTY * c.shape[1] for c in columns]
    drawn = products_of_noise(model, at, columns, rng, DRAWS)
    scores = [np.einsum("di,ij,dj->d", p, inv, p) - q for p, inv, q in zip(drawn, inverses, charges, strict=True)]
    limit = upper(scores, chance)
    gains = [float(at.residual @ c @ inv @ c.T @ at.residual) for c, inv in zip(columns, inverses, strict=True)]
    k = int(np.argmax(np.array(gains) - charges))
    return Change(found[k][0], found[k][1], gains[k], limit + charges[k])


def _patterns(model: Model, at: Tangent) -> Iterator[tuple[str, str, Real]]:
    """Yield parameter, setting and columns (N, m) of every change that a fit does not imitate."""
    fit = at.fit
    rows = list(fit.residual)
    moving = inside(model, fit)
    lost = at.basis.shape[0] - sum(fit.residual[r].size for r in rows)
    for key in sorted({key for r in rows for key in model.conditions[r].settings}):
        contrast = _contrast([model.conditions[r].settings.get(key) for r in rows])
        for place, j in enumerate(fit.free):
            if contrast is None or not moving[place]:
                continue
            data = np.concatenate([np.outer(fit.slope[r][:, place], s) for r, s in zip(rows, contrast, strict=True)])
            columns = np.concatenate([data, np.zeros((lost, data.shape[1]))])
            before = np.linalg.norm(columns, axis=0)
            columns -= at.basis @ (at.basis.T @ columns)
            seen = np.linalg.norm(columns, axis=0) > np.maximum(CONFOUNDED * before, 1e-12)
            if seen.any():
                yield model.names[int(j)], key, columns[:, seen] / before[seen]


def _contrast(settings: Sequence[float | str | None]) -> Real | None:
    """Return numbers for the settings of the conditions, (conditions, m): a slope, or one column for each word."""
    if any(s is None for s in settings) or len(set(settings)) < 2:
        return None
    if all(isinstance(s, (int, float)) for s in settings):
        x = np.array(settings, dtype=float)
        return ((x - x.mean()) / x.std())[:, None] if math.isfinite(float(x.std())) else None
    words = sorted({str(s) for s in settings})[: _MOST_WORDS + 1]
    return np.array([[float(str(s) == w) for w in words[1:]] for s in settings])
