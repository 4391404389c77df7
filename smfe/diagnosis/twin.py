"""Symmetries of a cause: of two sets of values that fit alike, the one that is nearer to the null."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smfe.diagnosis.fit import Fit, Target, fit
from smfe.diagnosis.model import Model

TWIN = 2.0
"""Chi-square that a twin may fit worse."""


def nearest(model: Model, target: Target, found: Fit, added: Sequence[int]) -> Fit:
    """Return the twin of a fit where it fits as well and is nearer to the null: no more is wrong than need be."""
    for k in added:
        mine = model.of_cause[k]
        twin = model.causes[k].twin
        if twin is None:
            continue
        values = model.values(found.u)
        start = found.u.copy()
        start[mine] = (np.array(twin(values)) - model.start[mine]) / model.scale[mine]
        if np.linalg.norm(start[mine]) < np.linalg.norm(found.u[mine]):
            other = fit(model, target, found.causes, start)
            if other.converged and other.chi2 < found.chi2 + TWIN:
                found = other
    return found
