"""What a set of conditions can tell apart, before any data: cosines between the signatures of the causes.

Two causes whose signatures, with all that the nuisances can imitate taken off, are the same cannot be told apart by
these conditions however good the data; one of them is never named alone. (Structural isolability as in Krysander and
Frisk, here to first order and with the noise as the measure.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from smfe.diagnosis.calibration import threshold
from smfe.diagnosis.fit import Fit, Target
from smfe.diagnosis.model import Model
from smfe.diagnosis.power import Detectable, detectable
from smfe.diagnosis.problem import Condition, Family
from smfe.diagnosis.signature import Tangent, orthonormal, tangent

Real = NDArray[np.float64]

COLLINEAR = 0.95
"""Cosine of two signatures above which they count as one."""


@dataclass(frozen=True)
class Isolability:
    """What conditions can tell apart and see.

    Attributes
    ----------
    causes : tuple of str
        Keys of the causes.
    cosine : ndarray, shape (c, c)
        Between the signatures; zero for a cause without any, or where one can do more than the other.
    groups : tuple of tuple of str
        Causes that cannot be told apart.
    power : tuple of Detectable
        What size of each would be seen.
    """

    causes: tuple[str, ...]
    cosine: Real
    groups: tuple[tuple[str, ...], ...]
    power: tuple[Detectable, ...]


def isolability(family: Family, conditions: Sequence[Condition] | None = None, seed: int = 0) -> Isolability:
    """Say what conditions can tell apart and see; no observed value is used.

    Parameters
    ----------
    family : Family
        Baseline and causes.
    conditions : sequence of Condition, optional
        Measured or proposed ones. Default: the measured ones of the family.
    seed : int, optional
        Of the calibration of the threshold.
    """
    chosen = tuple(family.conditions if conditions is None else conditions)
    if not chosen:
        raise InputError("no condition was given; what can be told apart depends on the conditions that are measured")
    model = Model(family, chosen)
    at = nominal(model, range(len(chosen)))
    limit = threshold(model, at, np.random.default_rng([seed, 1, 0]))
    cosine = cosines(model, at)
    keys = tuple(c.key for c in model.causes)
    together = tuple(tuple(keys[k] for k in g) for g in groups(model, cosine))
    return Isolability(keys, cosine, together, detectable(model, at, limit))


def nominal(model: Model, rows: Sequence[int]) -> Tangent:
    """Linearise the baseline at its most likely nuisances."""
    u = model.null()
    predicted = {r: y for r in rows if (y := model.predict(r, u)) is not None}
    slope = model.slopes(rows, u, model.nuisance)
    if len(predicted) < len(rows) or slope is None:
        raise InputError(
            f"no prediction of the baseline at its most likely values ({model.trouble}); correct the family"
        )
    fit = Fit((), model.nuisance, u, 0.0, {r: np.zeros(y.size) for r, y in predicted.items()}, slope, True)
    return tangent(model, Target(predicted, u), fit)


def cosines(model: Model, at: Tangent) -> Real:
    """Return the cosine of the largest angle between the signatures of any two causes, the nearest of their shapes."""
    found = np.zeros((len(model.causes), len(model.causes)))
    bases = [(s.cause, orthonormal(s.columns)) for s in at.signatures]
    for i, a in bases:
        for j, b in bases:
            if a.shape[1] == b.shape[1] > 0:
                smallest = float(np.linalg.svd(a.T @ b, compute_uv=False).min())
                found[i, j] = max(found[i, j], min(smallest, 1.0))
    return found


def groups(model: Model, cosine: Real) -> list[tuple[int, ...]]:
    """Return causes that are linked by collinear signatures; variants of one cause alone are no group."""
    linked = cosine > COLLINEAR
    left, found = set(range(len(model.causes))), []
    while left:
        group = {left.pop()}
        while more := {j for i in group for j in np.flatnonzero(linked[i]).tolist()} - group:
            group |= more
        left -= group
        if len({model.causes[k].id for k in group}) > 1:
            found.append(tuple(sorted(group)))
    return sorted(found)
