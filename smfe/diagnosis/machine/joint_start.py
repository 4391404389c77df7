r"""Where a fit with a joint that is not linear begins: which modes move it, of the misfit of hits of several levels.

A joint is a spring somewhere in the machine, ``S = -g v v^T`` in mode space, whose stiffness falls (micro-slip, in
proportion to the level of a hit: Rayleigh's law) or rises (cubic, with its square). To first order the misfit changes
with the entries of S in proportion, ``r + sum_rs A_rs level^n S_rs``; what the nuisances take up is projected out, and
of all symmetric S that of rank one is found which leaves least. From a direction off by a right angle no fit finds the
way: modes that a joint has split are each a little of it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from process.types import Real
from smfe.diagnosis.frf.causes import pairs
from smfe.diagnosis.frf.noise import excited_of
from smfe.diagnosis.inference.fit import Fit, Target, fit, misfit, residuals, stacked
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Parameter
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.machine.rules import RULES

LAWS = {"joint_micro_slip/iwan": (1, -1.0), "joint_hardening": (2, 1.0)}
"""Key of a joint -> power of the level with which it changes, and whether it gives way or stiffens."""


def begun_with_a_joint(family: MachineOfAxes) -> MachineOfAxes:
    """Return a family whose fits with a joint begin where it explains most of what is left, if it does.

    What is left beside the causes that have a begin already, which then is that of all conditions, with what was
    declared held as it is known: with all let go gains and momenta go where no joint leads them back from. As it was
    where not all measurements are hits, or hits have one level only; without a begin of a joint where none explains
    half of what is left.
    """
    every = tuple(c for c in family.conditions if c.observed is not None)
    levels = np.array([abs(excited_of(c).level) for c in every])
    if any(excited_of(c).method != "hammer" for c in every) or levels.max() < RULES.levels_apart * levels.min():
        return family
    model = Model(replace(family, conditions=every, proposals=()), every)
    target = Target({r: c.observed for r, c in enumerate(every) if c.observed is not None}, model.null())
    others = tuple(k for k, c in enumerate(model.causes) if c.begin)
    u = model.scaled(model.causes[others[-1]].begin if others else family.first)
    for _ in range(RULES.begun_times):
        at = fit(model, target, others, u)
        u = at.u
    if not np.isfinite(at.chi2):
        return family
    fitted = model.values(at.u)
    if others:
        last = model.causes[others[-1]].key
        family = replace(family, with_cause={**family.with_cause, last: fitted})
    else:
        family = replace(family, first=fitted)
    noise = sum(y.size for y in target.observed.values())
    found: list[tuple[float, int, Real]] = []
    if at.chi2 > noise + RULES.over_noise * math.sqrt(2.0 * noise):
        laws = {k: LAWS[c.key] for k, c in enumerate(model.causes) if c.key in LAWS}
        found = sorted(_directions(model, target, at, laws), key=lambda x: -x[0])
    if not found or found[0][0] < RULES.joint_promises * (at.chi2 - noise):
        return family
    _, k, v = found[0]
    mine, starts = model.of_cause[k], list[Real]()
    travelled = any(p.name.endswith("_travel") for p in model.causes[k].parameters)
    travels: list[tuple[float, ...]] = [(t,) for t in RULES.joint_travels] if travelled else [()]
    for size, travel in product(RULES.joint_sizes, travels):
        u = at.u.copy()
        u[mine] = (np.array([size, *travel, *_angles(v)]) - model.start[mine]) / model.scale[mine]
        starts.append(u)
    causes = tuple(sorted((*others, k)))
    best = min(starts, key=lambda u: misfit(model, target, model.nuisance, u, residuals(model, target, u)))
    best = fit(model, target, causes, best, only=mine, loose=RULES.begun_to).u
    joined = fit(model, target, causes, best, loose=RULES.begun_to)
    if joined.chi2 - noise > RULES.joint_leaves * (at.chi2 - noise):
        return family
    return replace(family, with_cause={**family.with_cause, model.causes[k].key: model.values(joined.u)})


def _directions(
    model: Model, target: Target, at: Fit, laws: dict[int, tuple[int, float]]
) -> list[tuple[float, int, Real]]:
    """Return what each joint gains to first order, its number, and the unit vector of its displacement."""
    family, rows = model.family, list(target.observed)
    assert isinstance(family, MachineOfAxes)
    names, count = family.springs_names, family.count_of_own
    springs = [Parameter(n, "%", 0.0, 0.01, -0.9, 0.9) for n in names]
    conditions = [model.conditions[r] for r in rows]
    level = np.array([abs(excited_of(c).level) for c in conditions])
    level = level / level.max()
    slopes = family.slopes(conditions, {**model.values(at.u), **dict.fromkeys(names, 0.0)}, springs)
    own = model.slopes(rows, at.u, at.free)
    if slopes is None or own is None or not laws:
        return []
    taken, left = stacked(model, target, at.free, at.u, at.residual, own)
    basis = np.linalg.qr(taken)[0]
    where = list(pairs(range(count)))
    upper = np.array([i for i, _ in where]), np.array([j for _, j in where])
    found = []
    for k, (power, sign) in laws.items():
        shapes = np.concatenate([s * x**power for s, x in zip(slopes, level, strict=True)])
        shapes = np.concatenate([shapes, np.zeros((left.size - len(shapes), shapes.shape[1]))])
        shapes = shapes - basis @ (basis.T @ shapes)
        both = np.asarray(np.linalg.qr(np.column_stack([shapes, left - basis @ (basis.T @ left)]), mode="r"))
        a, aim = sign * both[:, :-1], both[:, -1]

        def misses(v: Real, a: Real = a, aim: Real = aim) -> Real:
            return np.asarray(aim + a @ (v[upper[0]] * v[upper[1]]))

        def slope(v: Real, a: Real = a) -> Real:
            of_v = np.zeros((len(where), count))
            of_v[range(len(where)), upper[0]] += v[upper[1]]
            of_v[range(len(where)), upper[1]] += v[upper[0]]
            return np.asarray(a @ of_v)

        starts = (*np.eye(count), *np.random.default_rng(0).standard_normal((RULES.joint_starts, count)))
        best = min((least_squares(misses, v, slope) for v in starts), key=lambda one: one.cost)
        if (size := float(np.linalg.norm(best.x))) > 0.0:
            found.append((float(aim @ aim) - 2.0 * best.cost, k, best.x / size))
    return found


def _angles(v: Real) -> list[float]:
    """Return the spherical angles of a unit vector (`smfe.diagnosis.frf.causes.vector`)."""
    rest = [float(np.linalg.norm(v[i:])) for i in range(v.size)]
    first = [math.acos(np.clip(v[i] / max(rest[i], 1e-300), -1.0, 1.0)) for i in range(v.size - 2)]
    return [*first, math.atan2(v[-1], v[-2])] if v.size > 1 else []
