"""What the measured conditions do not show, and which experiment would: the next step where nothing was found.

A cause counts as hidden where an effect of the size that matters (one scale of its parameter) would not be seen with
95 %. A proposal is worth what it does to these sizes, ``sum log(before / after)``, no size counted below one scale, for
each minute that it takes. Both come from the linearised null (`smfe.diagnosis.power`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from smfe.diagnosis.fit import Fit, Target
from smfe.diagnosis.model import Model
from smfe.diagnosis.next_experiment import MINUTES, Proposal
from smfe.diagnosis.power import SEEN, Detectable, detectable
from smfe.diagnosis.signature import tangent

_BLIND = 100.0
"""Scales that a cause counts with that would never be seen."""

_TOLD = 1.5
"""Ratio of a hidden size before and after from which a proposal is worth its time, and a cause is told of."""

_MOST = 6
"""Causes that are told of."""


def revealing(model: Model, target: Target, null: Fit, limit: float, rows: Sequence[int]) -> Proposal | None:
    """Return the proposal that shows most of what the measured conditions hide; None where none does.

    Parameters
    ----------
    model, target : Model, Target
        What predicts; the data measured so far.
    null : Fit
        The baseline, fitted.
    limit : float
        Threshold of ``LR - 2 parameters``.
    rows : sequence of int
        Conditions that could be measured.
    """
    before = _sizes(model, detectable(model, tangent(model, target, null), limit))
    hidden = {key: size for key, size in before.items() if size > 1.0}
    best: tuple[float, int, dict[tuple[str, str], float]] | None = None
    for row in rows if hidden else ():
        after = _with(model, target, null, limit, row, {key for key, _ in hidden})
        if after is None:
            continue
        worth = sum(math.log(size / max(after.get(key, size), 1.0)) for key, size in hidden.items())
        rate = worth / _minutes(model, row)
        if worth > math.log(_TOLD) and (best is None or rate > best[0]):
            best = rate, row, after
    return None if best is None else _proposal(model, best[1], hidden, best[2])


def _minutes(model: Model, row: int) -> float:
    return float(model.conditions[row].settings.get("minutes", MINUTES))


def _sizes(model: Model, seen: Sequence[Detectable]) -> dict[tuple[str, str], float]:
    """Cause and parameter -> size that is seen [scales]."""
    unit = {p.name: p.scale * p.shown for c in model.causes for p in c.parameters}
    return {(d.cause, d.parameter): min(d.size / unit[d.parameter], _BLIND) for d in seen}


def _with(
    model: Model, target: Target, null: Fit, limit: float, row: int, causes: set[str]
) -> dict[tuple[str, str], float] | None:
    """Sizes that would be seen if a condition were measured as well and showed what the baseline predicts."""
    predicted, slope = model.predict(row, null.u), model.slopes([row], null.u, null.free)
    if predicted is None or slope is None:
        return None
    more = Target({**target.observed, row: predicted}, target.centre)
    fit = replace(null, residual={**null.residual, row: np.zeros_like(predicted)}, slope={**null.slope, **slope})
    wanted = [k for k, c in enumerate(model.causes) if c.key in causes]
    return _sizes(model, detectable(model, tangent(model, more, fit, wanted), limit))


def _proposal(
    model: Model,
    row: int,
    before: Mapping[tuple[str, str], float],
    after: Mapping[tuple[str, str], float],
) -> Proposal:
    gains = {key: size / max(after.get(key, size), 1.0) for key, size in before.items()}
    told = [key for key in sorted(gains, key=lambda key: -gains[key]) if gains[key] > _TOLD][:_MOST]
    words = "; ".join(_words(model, key, before[key], after[key]) for key in told)
    minutes = model.conditions[row].settings.get("minutes")
    return Proposal(
        model.conditions[row].name,
        math.nan,
        SEEN,
        f"there would be seen with {100 * SEEN:.0f} % what the data so far hide: {words}",
        None if minutes is None else float(minutes),
    )


def _words(model: Model, key: tuple[str, str], before: float, after: float) -> str:
    cause, p = next((c, p) for c in model.causes for p in c.parameters if (c.key, p.name) == key)
    unit = "" if p.unit == "1" else f" {p.unit}"
    now, then = (f"{size * p.scale * p.shown:.2g}{unit}" for size in (before, after))
    return f"{cause.title} ({p.name}) of {then}" + (f", so far {now}" if before < _BLIND else "")
