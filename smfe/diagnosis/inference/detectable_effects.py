"""What size of each cause would have been seen: the other half of "nothing was found".

A cause of size s has the noncentrality ``s^2 g`` with g the square of its signature; seen with 95 % is the size at
which the noncentral distribution of the likelihood ratio lies above the threshold with that probability. Where the
effect has a shape (the speed of a Stribeck effect, the frequency of a mode), the least visible one counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from process.types import Real
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Signature, Tangent, orthonormal
from smfe.diagnosis.inference.thresholds import parameters_of, score


@dataclass(frozen=True)
class Detectable:
    """Smallest size of one parameter of a cause that is seen with 95 %."""

    cause: str
    title: str
    parameter: str
    size: float  # change from the null, as shown; infinite where it has no effect in these conditions
    proven_size: float
    """The size that is named with 95 %: its gain on held-out conditions is three standard deviations as well."""
    unit: str  # of the sizes
    admissible: bool  # whether the parameter can get that large


def detectable(model: Model, at: Tangent, limit: float) -> tuple[Detectable, ...]:
    """Return the detectable size of each parameter of each cause that is not in the fit, at a limit of ``LR - 2 p``."""
    found = []
    for k, cause in enumerate(model.causes):
        own = [s for s in at.signatures if s.cause == k]
        if k in at.fit.causes:
            continue
        for j, parameter in zip(model.of_cause[k], cause.parameters, strict=True):
            acting = [s for s in own if j in s.free]
            if own and not acting:
                continue
            level = limit + RULES.penalty * parameters_of(model, [k])
            seen, proven = (
                max((_size(model, s, int(j), x) for s in acting), default=math.inf)
                for x in (level, max(level, RULES.proven))
            )
            unit = parameter.scale * parameter.shown
            possible = bool(seen <= max(model.high[j], -model.low[j]))
            found.append(
                Detectable(cause.key, cause.title, parameter.name, seen * unit, proven * unit, parameter.unit, possible)
            )
    return tuple(found)


def _size(model: Model, signature: Signature, j: int, level: float) -> float:
    """Size of a scaled parameter whose likelihood ratio exceeds a level with 95 %."""
    place = int(np.flatnonzero(signature.free == j)[0])
    own = score(model, [signature])
    square = float(signature.columns[:, place] @ signature.columns[:, place])
    if square <= 0.0:
        return math.inf
    one_sided = bool(own.gram.shape[0] == 1 and not (own.up[0] and own.down[0]))
    return math.sqrt(noncentrality(max(level, 1e-6), own.gram.shape[0], one_sided) / square)


def noncentrality(level: float, degrees_of_freedom: int, one_sided: bool = False) -> float:
    """Return the noncentrality with which a chi-square statistic exceeds a level with 95 %."""
    if one_sided:
        return (math.sqrt(level) + float(stats.norm.ppf(RULES.seen))) ** 2
    return float(special.chndtrinc(level, degrees_of_freedom, 1.0 - RULES.seen))


# --- Causes that do nearly the same in these conditions: cosines between their signatures.


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
    linked = cosine > RULES.collinear
    left, found = set(range(len(model.causes))), []
    while left:
        group = {left.pop()}
        while more := {j for i in group for j in np.flatnonzero(linked[i]).tolist()} - group:
            group |= more
        left -= group
        if len({model.causes[k].id for k in group}) > 1:
            found.append(tuple(sorted(group)))
    return sorted(found)
