"""What each cause would do to the data, to first order, beyond what the nuisances can imitate.

The slopes of a cause at its null value, with the tangent of all fitted parameters (priors included) projected off.
A parameter that does nothing at the null (a Stribeck speed without Stribeck friction) is a shape: the signature is
taken at several of its values, and the best of them counts (Davies, Biometrika 64, 1977).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from process.types import Real
from smfe.diagnosis.inference.fit import Fit, Target, stacked
from smfe.diagnosis.inference.misfit import decomposed, triangle
from smfe.diagnosis.inference.model import Index, Model
from smfe.diagnosis.inference.rules import RULES


@dataclass(frozen=True)
class Signature:
    """First-order effect of one cause, for one value of its shape."""

    cause: int  # number of the cause
    free: Index  # shape (m,): its parameters that act
    u: Real  # scaled parameters it was taken at, the shape included
    columns: Real  # shape (N, m): slopes after the projection: all data, then the priors of the fit
    raw: Real  # shape (m,): norms before it
    slope: Mapping[int, Real]  # slopes of the conditions, (n, parameters of the cause), before it


@dataclass(frozen=True)
class Tangent:
    """A fit, linearised."""

    fit: Fit  # where
    basis: Real  # shape (N, r): orthonormal basis of all that the fitted parameters do
    residual: Real  # shape (N,): residuals, then prior deviations
    signatures: tuple[Signature, ...]  # of the causes that are not in the fit
    silent: tuple[int, ...]  # causes whose slopes the family could not give

    @cached_property
    def acting(self) -> tuple[Signature, ...]:
        """Those of the causes that do something to these data which the fitted parameters do not."""
        return tuple(s for s in self.signatures if np.any(s.columns))


def orthonormal(columns: Real) -> Real:
    """Return an orthonormal basis of the columns, as many as are independent."""
    if columns.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    size = np.linalg.norm(columns, axis=0)
    unit = columns[:, size > 0.0] / size[size > 0.0]
    if unit.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    if (upper := triangle(unit)) is not None:
        return np.asarray(solve_triangular(upper, unit.T, trans="T").T)
    left, singular, _ = decomposed(unit)
    return np.asarray(left[:, singular > 1e-7 * singular[0]])


def inside(model: Model, fit: Fit) -> NDArray[np.bool_]:
    """Which fitted parameters are not on a bound; those on one cannot imitate anything, to first order."""
    u, low, high = fit.u[fit.free], model.low[fit.free], model.high[fit.free]
    return np.asarray((u > low + 1e-9) & (u < high - 1e-9) | np.isin(fit.free, model.nuisance))


def tangent(model: Model, target: Target, fit: Fit, causes: Sequence[int] | None = None) -> Tangent:
    """Linearise a fit and take the signatures of all other causes there, or of some of them."""
    slope, residual = stacked(model, target, fit.free, fit.u, fit.residual, fit.slope)
    basis = orthonormal(slope[:, inside(model, fit)])
    found: list[Signature] = []
    silent: list[int] = []
    for k in range(len(model.causes)) if causes is None else causes:
        if k not in fit.causes:
            own = _signatures(model, target, fit, k, basis)
            found += own
            if not own:
                silent.append(k)
    return Tangent(fit, basis, residual, tuple(found), tuple(silent))


def widened(model: Model, target: Target, fit: Fit, known: Tangent, row: int, causes: Sequence[int]) -> Tangent:
    """Linearise a fit whose target has one condition more, `row`, than the one of which the tangent is `known`.

    What the causes do to the conditions before is known: only in the new one slopes are taken, but of a cause of which
    more acts there than anywhere else.
    """
    slope, residual = stacked(model, target, fit.free, fit.u, fit.residual, fit.slope)
    basis = orthonormal(slope[:, inside(model, fit)])
    found: list[Signature] = []
    for k in causes:
        mine, own = model.of_cause[k], [s for s in known.signatures if s.cause == k and s.raw.any()]
        more = [_slope_of(model, fit, s, row, mine) for s in own]
        acting = [np.isin(mine, s.free) for s in own]
        if not own:
            found += _signatures(model, target, fit, k, basis, (row,))
        elif all(x is not None and _silent(x, a) for x, a in zip(more, acting, strict=True)):
            wider = [{**s.slope, row: x} for s, x in zip(own, more, strict=True) if x is not None]
            for s, x, a in zip(own, wider, acting, strict=True):
                found.append(_signature(model, target, k, s.free, s.u, x, a, basis))
        else:
            found += _signatures(model, target, fit, k, basis)
    return Tangent(fit, basis, residual, tuple(found), ())


def _slope_of(model: Model, fit: Fit, s: Signature, row: int, mine: Index) -> Real | None:
    """Return what a signature is in another condition: slopes, or from a step of what has no slope at its null."""
    if np.array_equal(s.u[s.free], fit.u[s.free]):
        slope = model.slopes([row], s.u, mine)
        return None if slope is None else slope[row]
    (j,) = s.free
    before, after = model.predict(row, fit.u), model.predict(row, s.u)
    if before is None or after is None:
        return None
    out = np.zeros((before.size, mine.size))
    out[:, j - mine[0]] = (after - before) / (s.u[j] - fit.u[j])
    return out


def _silent(slope: Real, acting: NDArray[np.bool_]) -> bool:
    """Whether nothing but what acts has a slope."""
    norms = np.linalg.norm(slope, axis=0)
    return not np.any(norms[~acting] > RULES.silent * max(1.0, float(norms.max(initial=0.0))))


def _signatures(
    model: Model, target: Target, fit: Fit, k: int, basis: Real, only: Sequence[int] = ()
) -> list[Signature]:
    """Return the signatures of a cause for each of its shapes; it may be known to act in some conditions `only`."""
    rows, mine = list(only or target.observed), model.of_cause[k]
    none = {r: np.zeros((y.size, mine.size)) for r, y in target.observed.items() if r not in rows}
    slope = model.slopes(rows, fit.u, mine)
    if slope is None:
        return []
    norms = np.linalg.norm(np.concatenate([slope[r] for r in rows]), axis=0)
    acting = norms > RULES.silent * max(1.0, float(norms.max()))
    if not acting.any():
        return [] if only else _secants(model, target, fit, k, basis)
    found = []
    for shape in _shapes(model, fit, k, mine[~acting]):
        at = fit.u.copy()
        at[mine[~acting]] = shape
        here = slope if np.array_equal(at, fit.u) else model.slopes(rows, at, mine)
        if here is not None:
            found.append(_signature(model, target, k, mine[acting], at, none | here, acting, basis))
    return found


def _signature(
    model: Model,
    target: Target,
    k: int,
    free: Index,
    at: Real,
    slope: Mapping[int, Real],
    acting: NDArray[np.bool_],
    basis: Real,
) -> Signature:
    data = np.concatenate([slope[r][:, acting] for r in target.observed])
    columns = np.concatenate([data, np.zeros((basis.shape[0] - data.shape[0], data.shape[1]))])
    raw = np.linalg.norm(columns, axis=0)
    if raw.any():
        columns = columns - basis @ (basis.T @ columns)
        columns[:, np.linalg.norm(columns, axis=0) < RULES.confounded * raw] = 0.0
    return Signature(k, free, at, columns, raw, slope)


def _shapes(model: Model, fit: Fit, k: int, silent: Index) -> list[Real]:
    """Values of the shape parameters to take the signature at."""
    own = fit.u[silent]
    if silent.size == 0:
        return [own]
    position = silent - model.of_cause[k][0]
    given = [np.array(s, dtype=float)[position] for s in model.causes[k].starts]
    found = [own, *((g - model.start[silent]) / model.scale[silent] for g in given)]
    if not given and silent.size <= RULES.jointly_varied:
        found += [own + np.array(step) for step in product((-2.0, -1.0, 0.0, 1.0, 2.0), repeat=silent.size)]
    inside_bounds = [np.clip(f, model.low[silent], model.high[silent]) for f in found]
    return list({f.tobytes(): f for f in inside_bounds}.values())


def _secants(model: Model, target: Target, fit: Fit, k: int, basis: Real) -> list[Signature]:
    """Signatures of a cause without slope at its null, such as the square of a parameter: from a step of one scale.

    Where all its parameters together change nothing, as those of a spindle that never turned, one stands for all.
    """
    rows, mine = list(target.observed), model.of_cause[k]
    if mine.size > 1 and _nothing(model, fit, rows, mine):
        none = {r: np.zeros((y.size, mine.size)) for r, y in target.observed.items()}
        return [_signature(model, target, k, mine, fit.u, none, np.ones(mine.size, dtype=bool), basis)]
    found = []
    for j, sign in product(mine, (1.0, -1.0)):
        at = fit.u.copy()
        at[j] = np.clip(at[j] + sign, model.low[j], model.high[j])
        before, after = ({r: model.predict(r, u) for r in rows} for u in (fit.u, at))
        step = at[j] - fit.u[j]
        if step == 0.0 or any(after[r] is None or before[r] is None for r in rows):
            continue
        slope = {r: np.zeros((target.observed[r].size, mine.size)) for r in rows}
        for r in rows:
            slope[r][:, j - mine[0]] = (np.asarray(after[r]) - np.asarray(before[r])) / step
        found.append(_signature(model, target, k, np.array([j]), at, slope, mine == j, basis))
    return found


def _nothing(model: Model, fit: Fit, rows: Sequence[int], mine: Index) -> bool:
    """Whether steps of some parameters together, either way, leave every prediction exactly as it is.

    No two of the steps are alike: what one of two does must not be what the other undoes.
    """
    steps = np.linspace(1.0, 0.5, mine.size)
    for sign in (1.0, -1.0):
        at = fit.u.copy()
        at[mine] = np.clip(at[mine] + sign * steps, model.low[mine], model.high[mine])
        for r in rows:
            before, after = model.predict(r, fit.u), model.predict(r, at)
            if before is None or after is None or not np.array_equal(before, after):
                return False
    return True


def cosines(model: Model, at: Tangent) -> Real:
    """Return the cosine of the largest angle between the signatures of any two causes, the nearest of their shapes."""
    found = np.zeros((len(model.causes), len(model.causes)))
    bases = [(s.cause, orthonormal(s.columns)) for s in at.signatures]
    for n, (i, a) in enumerate(bases):
        for j, b in bases[n:]:
            if a.shape[1] == b.shape[1] > 0:
                smallest = float(decomposed(a.T @ b)[1].min())
                found[i, j] = found[j, i] = max(found[i, j], min(smallest, 1.0))
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
