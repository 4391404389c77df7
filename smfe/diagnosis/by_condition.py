"""What the baseline and the best model leave of each condition, those that were set aside included."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from smfe.diagnosis.fit import Fit, Target, residuals
from smfe.diagnosis.model import Model
from smfe.diagnosis.problem import Real


@dataclass(frozen=True)
class ConditionMisfit:
    """Squares of the residuals of a condition over those of noise [dB].

    Attributes
    ----------
    name : str
        Of the condition.
    before_db, after_db : float or None
        Of the baseline, of the best model; None where it predicts nothing there.
    held_out : bool
        Whether no fit has seen it.
    """

    name: str
    before_db: float | None
    after_db: float | None
    held_out: bool


def by_condition(model: Model, before: Fit, after: Fit, aside: Mapping[int, Real]) -> tuple[ConditionMisfit, ...]:
    """Return the misfit of each condition, in the order of the campaign."""
    opened = [residuals(model, Target(aside, f.u), f.u) or {} for f in (before, after)]
    every = [{**f.residual, **more} for f, more in zip((before, after), opened, strict=True)]
    return tuple(
        ConditionMisfit(model.conditions[r].name, _decibel(every[0].get(r)), _decibel(every[1].get(r)), r in aside)
        for r in sorted({*before.residual, *aside})
    )


def _decibel(residual: Real | None) -> float | None:
    return None if residual is None else 10.0 * math.log10(max(float(np.mean(residual**2)), 1e-300))
