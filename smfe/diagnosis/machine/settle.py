"""Where the fits of a machine begin: modes, momenta and contacts that explain the data with all that was declared.

From the modes at rest alone a fit that may move gains and masses too finds other optima: a drive that is too soft
passes for a mode of the structure. So what was declared is held, and the weight of the data grows in steps from that
of the priors on (tempering), each step by Levenberg and Marquardt's method.
"""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import product

import numpy as np

from process.labels import AXES
from process.types import Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.inference.fit import Target, residuals, stacked
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition, Family
from smfe.diagnosis.machine.dynamics import unbounded
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.machine.joint_start import begun_with_a_joint
from smfe.diagnosis.machine.rules import RULES


def settled(family: MachineOfAxes) -> MachineOfAxes:
    """Return a family whose nuisances begin near their best values, alone and with what competes with them.

    Where no fit that holds what was declared comes near the data, what was declared is let go, and friction of
    guideways of which nothing was declared is fitted with all else, and friction that differs between the directions:
    without it modes and drives go far astray. What nobody declared is then expected where it is with friction: priors
    about where it went without would force the gains away in every later fit, and a wrong gain be named to bring them
    back. So would priors about where damping and contacts of guideways go to beside a gain that is declared wrongly,
    where other values of what was declared explain all.
    """
    few = _one_each(family.conditions)
    sure = {f.name: min(RULES.sure, getattr(family.tolerances, f.name)) for f in fields(Tolerances)}
    held = Model(replace(family, conditions=few, proposals=(), tolerances=Tolerances(**sure)), few)
    target = Target({r: c.observed for r, c in enumerate(few) if c.observed is not None}, held.null())
    warm, u, cost = _descended(held, target, ())
    near = _near(target, cost)
    best, begin, with_cause, least = held.values(u), {}, dict[str, dict[str, float]](), np.inf
    loose = Model(replace(family, conditions=few, proposals=()), few, released=[p.name for p in family.nuisances])
    if near and cost > _noisy(target):
        v, least = _cooled(loose, target, warm, ())
        if least > cost:  # with more let go it has come into a worse valley than with all held
            v, least = _at_temperature(loose, target, u, 1.0, ())
        best = loose.values(v) if least <= _noisy(target) else best
    if not near:
        friction = [k for k, c in enumerate(held.causes) if c.id == "guideway_friction"]
        for k in friction:
            begin = {p.name: held.values(u)[p.name] for p in family.nuisances}
            _, v, cost = _descended(held, target, (k,))
            if not _near(target, cost):
                v, cost = _at_temperature(loose, target, v, 1.0, (k,))
            with_cause[held.causes[k].key] = held.values(v)
            if cost < least:
                best, near, least = held.values(v), _near(target, cost), cost
        if not friction:
            v, least = _at_temperature(loose, target, u, 1.0, ())
            best, near = loose.values(v), _near(target, least)
            begin = {p.name: best[p.name] for p in family.nuisances if p.given}
    # Friction that differs between the directions bends stiffnesses and momenta by factors that are let go without it.
    # It counts where it takes half of what is left beyond noise: with more parameters any cause takes some.
    values = sum(y.size for y in target.observed.values())
    for k, cause in enumerate(loose.causes):
        if cause.id == "friction_asymmetry" and _noisy(target) < least < np.inf:
            v, cost = _cooled(loose, target, warm, (k,))
            if cost - values < 0.5 * (least - values):
                best, least, with_cause[cause.key] = loose.values(v), cost, loose.values(v)
                near = near or _near(target, cost)
    free = [p.name for p in family.nuisances if not p.given]
    start = {name: best[name] for name in free if not name.startswith(RULES.usual)}
    begin = {**{name: best[name] for name in free if name not in start}, **begin}
    # No wrong sign and no exchanged axes where all fits nearly: their fits from far away would take the most time.
    gross = [c.key for c in family.causes if c.id in ("sensor_gain", "sensor_axis") and near]
    return begun_with_a_joint(
        replace(family, at=start, first=begin, with_cause=with_cause, without=(*family.without, *gross))
    )


def _near(target: Target, cost: float, share: float = RULES.near) -> bool:
    """Whether a misfit is nearly that of noise, next to the data."""
    noise = sum(y.size for y in target.observed.values())
    return cost - noise < share * (sum(float(y @ y) for y in target.observed.values()) - noise)


def _noisy(target: Target) -> float:
    """Misfit that noise hardly exceeds."""
    values = sum(y.size for y in target.observed.values())
    return float(values + 4.0 * np.sqrt(2.0 * values))


def _one_each(conditions: tuple[Condition, ...]) -> tuple[Condition, ...]:
    """Of the conditions with the same feeds, controller and place the one of the lowest level."""
    lowest: dict[tuple[object, ...], Condition] = {}
    for c in conditions:
        feed = tuple(sorted(c.data.feed.items()))  # type: ignore[attr-defined]
        key = (feed, *(c.settings.get(k) for k in ("controller", "position", "place", "added_mass", "method")))
        if key not in lowest or float(c.settings["level"]) < float(lowest[key].settings["level"]):
            lowest[key] = c
    return tuple(lowest.values())


def _descended(model: Model, target: Target, causes: tuple[int, ...]) -> tuple[Real, Real, float]:
    """Return scaled values near the optimum of a hypothesis, and their misfit, by the best of some starts.

    The values come first as the first temperature has them. A start that leads near the data is enough: momenta of a
    mass at the tool, or of slides that move as a whole, straight away or from higher temperatures on. Without any
    friction, where nobody declared some, none does.
    """
    first = RULES.temperatures[0]
    begun = model.null()
    for k in causes:
        mine = model.of_cause[k]
        begun[mine] = (np.array(model.causes[k].starts[0]) - model.start[mine]) / model.scale[mine]
    small, whole, moving = begun.copy(), begun.copy(), _as_a_whole(model.family)
    for name, momentum in moving.items():
        j = model.names.index(name)
        small[j] = (RULES.small - 1.0) * model.start[j] / model.scale[j]
        whole[j] = (momentum - model.start[j]) / model.scale[j]
    ways = [(begun, ()), (begun, RULES.hot)]
    if moving:
        ways += [(whole, RULES.hot), (small, ())]
    undeclared = not causes and any(c.id == "guideway_friction" for c in model.causes)
    if moving and not undeclared:
        # Each axis has valleys of its own: what leads one of them astray may be right for another.
        axis = np.array([name.split("_")[1] if name.startswith("momentum_") else "" for name in model.names])
        axes = np.unique(axis[axis != ""])
        mixes = [m for m in product((begun, small, whole), repeat=axes.size) if len({id(u) for u in m}) > 1]
        for n, place in enumerate(np.random.default_rng(0).permutation(len(mixes))[: RULES.mixed]):
            u = begun.copy()
            for a, other in zip(axes, mixes[place], strict=True):
                u[axis == a] = other[axis == a]
            ways.append((u, RULES.hot if n % 2 else ()))
    tried: list[tuple[Real, float]] = []
    for u, hot in ways:
        for temperature in (*hot, first):
            u, cost = _at_temperature(model, target, u, temperature, causes)
        tried.append((u, cost))
        if _near(target, first * cost, RULES.near_enough):
            break
    found: list[tuple[Real, Real, float]] = []
    for warm, _ in sorted(tried, key=lambda one: one[1])[: RULES.cooled]:
        found.append((warm, *_cooled(model, target, warm, causes)))
        if undeclared or _near(target, found[-1][2]):
            break
    return min(found, key=lambda one: one[2])


def _as_a_whole(family: Family) -> dict[str, float]:
    """Return momenta with which all modes together move the tool as much as a slide that moves as a whole.

    The modes of the held slide are complete: ``sum_r V_r lambda_ar = e_a / sqrt(m_a)``, V_r the direction of mode r
    over the square root of its mass (Craig and Bampton, AIAA J. 6, 1968). Of the momenta that give this the smallest
    are taken, those of the lower modes counting less: what moves evenly bends its softest springs.
    """
    assert isinstance(family, MachineOfAxes)
    m = family.model
    ease = np.where(m.frequency <= family.top, m.frequency**-RULES.softer, 0.0)
    shape = (m.direction / np.sqrt(m.mass)[:, None]).T
    share = np.zeros((len(family.axes), m.frequency.size))
    for i, (a, axis) in enumerate(family.axes.items()):
        if axis.coupling is not None:
            return {}
        unit = np.eye(3)[AXES.index(a)] / np.sqrt(axis.moving_mass)
        share[i] = ease * np.linalg.lstsq(shape * ease, unit, rcond=RULES.aligned)[0]
    largest = float(np.linalg.eigvalsh(share @ share.T)[-1]) if len(share) else 0.0
    free = unbounded(share * min(1.0, np.sqrt(RULES.most_as_a_whole / max(largest, 1e-300))))
    return {
        f"momentum_{a}_{r + 1}": float(x) for a, row in zip(family.axes, free, strict=True) for r, x in enumerate(row)
    }


def _cooled(model: Model, target: Target, u: Real, causes: tuple[int, ...]) -> tuple[Real, float]:
    """Descend from values of the first temperature through the others."""
    cost = np.inf
    for temperature in RULES.temperatures[1:]:
        u, cost = _at_temperature(model, target, u, temperature, causes)
    return u, cost


def _at_temperature(
    model: Model, target: Target, u: Real, temperature: float, causes: tuple[int, ...]
) -> tuple[Real, float]:
    """Descend as far as it goes; return the values and what they cost."""
    free, rows = model.free(causes), list(target.observed)
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
        if before - cost < max(RULES.little_progress * before, RULES.little_decrease):
            break
    return u, cost
