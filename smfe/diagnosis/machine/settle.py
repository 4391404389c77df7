"""Where the fits of a machine begin: modes, momenta and contacts that explain the data with all that was declared.

From the modes at rest alone a fit that may move gains and masses too finds other optima: a drive that is too soft
passes for a mode of the structure. So what was declared is held, and the weight of the data grows in steps from that
of the priors on (tempering), each step by Levenberg and Marquardt's method.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from process.types import Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.inference.fit import Target, residuals, stacked
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.machine.rules import RULES


def settled(family: MachineOfAxes) -> MachineOfAxes:
    """Return a family whose nuisances that nobody declared begin near their best values."""
    sure = {f.name: min(RULES.sure, getattr(family.tolerances, f.name)) for f in fields(Tolerances)}
    few = _one_each(family.conditions)
    model = Model(replace(family, conditions=few, proposals=(), tolerances=Tolerances(**sure)), few)
    data = {r: c.observed for r, c in enumerate(few) if c.observed is not None}
    u, cost = _descended(model, Target(data, model.null()))
    values = model.values(u)
    begin = {p.name: values[p.name] for p in family.nuisances if not p.given}
    # No wrong sign and no exchanged axes where all fits nearly: their fits from far away would take the most time.
    noise = sum(y.size for y in data.values())
    near = cost - noise < RULES.near * (sum(float(y @ y) for y in data.values()) - noise)
    gross = [c.key for c in family.causes if c.id in ("sensor_gain", "sensor_axis") and near]
    return replace(family, begin=begin, without=(*family.without, *gross))


def _one_each(conditions: tuple[Condition, ...]) -> tuple[Condition, ...]:
    """Of the conditions with the same feeds, controller and place the one of the lowest level."""
    lowest: dict[tuple[object, ...], Condition] = {}
    for c in conditions:
        feed = tuple(sorted(c.data.feed.items()))  # type: ignore[attr-defined]
        key = (feed, *(c.settings.get(k) for k in ("controller", "position", "place", "added_mass", "method")))
        if key not in lowest or float(c.settings["level"]) < float(lowest[key].settings["level"]):
            lowest[key] = c
    return tuple(lowest.values())


def _descended(model: Model, target: Target) -> tuple[Real, float]:
    """Return scaled values near the optimum of the baseline, by the best of some starts, and their misfit."""
    first, *others = RULES.temperatures
    moments = [j for j, name in enumerate(model.names) if name.startswith("momentum_")]
    tried = []
    for share in RULES.shares:
        u = model.null()
        u[moments] = (share - 1.0) * model.start[moments] / model.scale[moments]
        tried.append(_at_temperature(model, target, u, first))
    u = min(tried, key=lambda one: one[1])[0]
    cost = np.inf
    for temperature in others:
        u, cost = _at_temperature(model, target, u, temperature)
    return u, temperature * cost


def _at_temperature(model: Model, target: Target, u: Real, temperature: float) -> tuple[Real, float]:
    """Descend as far as it goes; return the values and what they cost."""
    free, rows = model.free(()), list(target.observed)
    damping, cost = RULES.damping, np.inf
    for _ in range(RULES.most_steps):
        residual, slope = residuals(model, target, u), model.slopes(rows, u, free, rough=True)
        if residual is None or slope is None:
            return u, np.inf
        jacobian, whole = stacked(model, target, free, u, residual, slope)
        weight = np.ones(whole.size)
        weight[: sum(r.size for r in residual.values())] = temperature**-0.5
        jacobian, whole = jacobian * weight[:, None], whole * weight
        normal, pull = jacobian.T @ jacobian, jacobian.T @ whole
        before = cost = float(whole @ whole)
        for _ in range(RULES.most_dampings):
            trial = u.copy()
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -pull)
            trial[free] = np.clip(u[free] + step, model.low[free], model.high[free])
            found = residuals(model, target, trial)
            if found is not None:
                away = ((trial - target.centre) * model.weight)[free]
                cost = sum(float(r @ r) for r in found.values()) / temperature + float(away @ away)
            if cost < before:
                break
            damping *= 8.0
        if not cost < before:
            return u, before
        u, damping = trial, 0.2 * damping
        if cost > (1.0 - RULES.little_progress) * before:
            break
    return u, cost
