"""The diagnosis: how wrong a baseline is beyond noise, why, what the repaired model gains, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from process.errors import InputError
from process.types import Complex, Real
from smfe.diagnosis.inference.cross_validation import BAND, Gain, compare, opened
from smfe.diagnosis.inference.finding import Estimate, Finding, FoundCause, Remainder, Rung, by_condition
from smfe.diagnosis.inference.fit import Fit, Target, stacked
from smfe.diagnosis.inference.misfit import Misfit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.next_experiment import Proposal, rank, revealing
from smfe.diagnosis.inference.power import cosines, detectable, groups
from smfe.diagnosis.inference.problem import Condition, Family, Values
from smfe.diagnosis.inference.search import MOST_CAUSES, Bench, Step, search
from smfe.diagnosis.inference.signature import inside
from smfe.diagnosis.inference.thresholds import PENALTY, covariances_of_noise, parameters_of
from smfe.diagnosis.inference.verdict import Judgement, judge
from smfe.diagnosis.inference.workers import Helpers
from smfe.identification.errors.result import Progress, silent


def diagnose(
    family: Family,
    seed: int = 0,
    progress: Progress = silent,
    held_out: Sequence[str] = (),
    workers: int | None = None,
) -> Finding:
    """Diagnose a baseline.

    Where the data of a family rest on a simulation (its method ``as_found``: values to conditions) and a cause was
    found, they are prepared once more, with that cause, and searched again, from the fits that are known by then; and
    a third time if that finds others.

    Parameters
    ----------
    family : Family
        Baseline, causes, measured conditions and proposals.
    seed : int, optional
        Of all draws; the same seed gives the same finding.
    progress : callable, optional
        Told what is being done.
    held_out : sequence of str, optional
        Names of measured conditions that are set aside and opened once, at the very end.
    workers : int, optional
        Processes that predict where that takes long; default: one a core, at most 8, on Linux, elsewhere one. The
        finding is the same with any number.

    Returns
    -------
    Finding
        Verdict, causes, gains, power and the next experiment.

    Raises
    ------
    InputError
        For a family that contradicts itself, a condition to be held out that was not measured, or no worker.
    """
    # Many small matrices: threads of the algebra wait for each other, and sum in another order each time.
    with threadpool_limits(1, "blas"), Helpers(workers) as helpers:
        return _diagnosed(family, seed, progress, held_out, helpers)


def _diagnosed(family: Family, seed: int, progress: Progress, held_out: Sequence[str], helpers: Helpers) -> Finding:
    again: Callable[[Values], Sequence[Condition]] | None = getattr(family, "as_found", None)
    conditions: Sequence[Condition] = family.conditions
    known, prepared = dict[tuple[int, ...], Fit](), tuple[int, ...]()
    for last in (again is None, False, True):
        laid = _laid_out(family, conditions, seed, progress, held_out, helpers)
        laid.bench.known = known
        refused = _refused(laid.bench)
        if refused is not None:
            return refused
        # As long as the data are prepared without a cause, one is enough to prepare them better.
        at, ladder = search(laid.bench, MOST_CAUSES if last or prepared else 1)
        if again is None or last or at.causes == prepared:
            break
        prepared, known, conditions = at.causes, dict(laid.bench.fits), again(laid.bench.model.values(at.u))
    return _finding(laid, at, ladder)


@dataclass(frozen=True)
class _Laid:
    """Conditions laid out for a search: those to fit, those that are set aside, those that could be measured."""

    bench: Bench
    aside: dict[int, Real]
    proposals: range


def _laid_out(
    family: Family,
    conditions: Sequence[Condition],
    seed: int,
    progress: Progress,
    held_out: Sequence[str],
    helpers: Helpers,
) -> _Laid:
    measured = [c for c in conditions if c.observed is not None]
    missing = sorted(set(held_out) - {c.name for c in measured})
    if missing:
        raise InputError(f"{missing[0]!r} cannot be held out: it is not one of the measured conditions")
    model = Model(family, [*measured, *family.proposals], helpers)
    data = {r: np.asarray(c.observed, dtype=float) for r, c in enumerate(measured)}
    _refuse_gaps(model, data)
    aside = {r: y for r, y in data.items() if measured[r].name in held_out}
    target = Target({r: y for r, y in data.items() if r not in aside}, model.null())
    return _Laid(Bench(model, target, seed, progress), aside, range(len(measured), len(model.conditions)))


def _values(bench: Bench) -> int:
    return sum(y.size for y in bench.target.observed.values())


def _refused(bench: Bench) -> Finding | None:
    """Say why there is nothing to be found out, if so."""
    values, nuisances = _values(bench), bench.model.nuisance.size
    if values <= nuisances:
        return Finding("insufficient_data", f"{values} values for {nuisances} parameters of the baseline")
    if not bench.null().converged:
        return Finding("insufficient_data", f"the baseline could not be fitted: {bench.null().reason}")
    return None


def _finding(laid: _Laid, at: Fit, ladder: Sequence[Step]) -> Finding:
    bench, model, values = laid.bench, laid.bench.model, _values(laid.bench)
    null = bench.tangent(bench.null())
    limit = bench.threshold(bench.null())
    power = detectable(model, null, limit)
    together = groups(model, cosines(model, null))
    judged = judge(bench, at, ladder, power)
    return Finding(
        verdict=judged.verdict,
        reason=judged.reason,
        causes=tuple(_found(bench, at, k, judged) for k in at.causes),
        alternatives=_alternatives(bench, at, judged),
        ladder=tuple(_rung(s, values) for s in ladder),
        misfit_before_db=_decibel(bench.null(), values),
        misfit_after_db=_decibel(at, values),
        gain=judged.gain,
        opened=_opened(bench, at, laid.aside),
        remainder=_remainder(bench, judged),
        power=power,
        inseparable=tuple(tuple(model.causes[k].key for k in g) for g in together),
        unconverged=tuple(sorted(bench.unconverged.items())),
        next_experiment=_next(bench, at, ladder, judged, laid.proposals),
        threshold=limit if math.isfinite(limit) else None,
        conditions=by_condition(model, bench.null(), at, laid.aside),
        values=model.values(at.u),
        values_before=model.values(bench.null().u),
    )


def _refuse_gaps(model: Model, data: dict[int, Real]) -> None:
    for r, y in data.items():
        if y.ndim != 1 or y.size == 0 or not np.all(np.isfinite(y)):
            raise InputError(
                f"{model.conditions[r].name}: data of shape {y.shape}, or with values that are not finite; give one "
                "row of finite whitened values"
            )


def _decibel(found: Fit, values: int) -> float:
    """Misfit over what noise gives."""
    return 10.0 * math.log10(max(found.chi2, 1e-300) / values)


def _rung(step: Step, values: int) -> Rung:
    gain = step.gain
    return Rung(
        step.change,
        step.ratio,
        step.threshold,
        None if gain is None else gain.db,
        None if gain is None else gain.sd,
        10.0 * math.log10(max(step.chi2, 1e-300) / values),
        step.accepted,
        step.reason,
    )


def _found(bench: Bench, at: Fit, k: int, judged: Judgement) -> FoundCause:
    """Describe a cause of a fit."""
    cause = bench.model.causes[k]
    smaller = bench.reduce(at, k)
    gain = bench.gain(smaller, at)
    return FoundCause(
        cause.id,
        cause.variant,
        cause.title,
        cause.kind,
        estimates(bench, at, k, judged),
        smaller.chi2 - at.chi2,
        None if gain is None else gain.db,
        None if gain is None else gain.sd,
    )


def _remainder(bench: Bench, judged: Judgement) -> Remainder | None:
    """Describe what the best model leaves."""
    left = judged.misfit
    if left is None:
        return None
    share = None if judged.gain is None else 1.0 - judged.gain.share
    names = tuple(bench.model.conditions[r].name for r in judged.carriers)
    return Remainder(10.0 * math.log10(max(left.ratio, 1e-300)), left.chance, left.chance < BAND, share, names)


def _alternatives(bench: Bench, at: Fit, judged: Judgement) -> tuple[tuple[FoundCause, ...], ...]:
    found = []
    for k, fits in judged.sets.items():
        others = []
        for f in fits:
            (other,) = set(f.causes) - set(at.causes)
            others.append(_found(bench, f, other, judged))
        found.append((_found(bench, at, k, judged), *others))
    return tuple(found)


def _opened(bench: Bench, at: Fit, aside: dict[int, Real]) -> Gain | None:
    """Gain on the conditions that were set aside."""
    if not aside or not at.causes:
        return None
    before, after = (opened(bench.model, bench.target, f, aside) for f in (bench.null(), at))
    if not (before.squares and after.squares):
        return None
    return compare(before, after, bench.rng(5, parameters_of(bench.model, at.causes)))


_CONTENDERS = 3


def _unproven(bench: Bench, ladder: Sequence[Step]) -> list[Fit]:
    """Return the best hypotheses that were refused for want of a condition that tests them; one alone with the null."""
    steps = {s.causes: bench.fitted(s.causes) for s in ladder if not s.accepted}
    kept: list[Fit] = []
    for f in sorted(steps.values(), key=lambda f: f.chi2 + PENALTY * parameters_of(bench.model, f.causes)):
        # More of the same is not another hypothesis.
        if f.converged and not any(set(g.causes) & set(f.causes) for g in kept):
            kept.append(f)
    return kept[:_CONTENDERS] if len(kept) > 1 else [*kept, bench.null()]


def _next(bench: Bench, at: Fit, ladder: Sequence[Step], judged: Judgement, rows: Sequence[int]) -> Proposal | None:
    """Return the proposal that settles best which of the first open set is right, or shows what could be hidden."""
    if judged.verdict == "consistent":
        return revealing(bench.model, bench.target, at, bench.threshold(bench.null()), rows)
    if judged.verdict == "insufficient_data":
        ranked = rank(bench.model, bench.target, _unproven(bench, ladder), rows, "what was refused") if ladder else []
        return ranked[0] if ranked else None
    if not judged.sets:
        return None
    k, fits = next(iter(judged.sets.items()))
    titles = [bench.model.causes[k].title]
    titles += [bench.model.causes[j].title for f in fits for j in set(f.causes) - set(at.causes)]
    ranked = rank(bench.model, bench.target, [at, *fits], rows, " and ".join(titles))
    return ranked[0] if ranked and ranked[0].chance > 0.5 else None


# --- Intervals of the fitted parameters: from noise, from what the best model leaves, and from what it may do wrong.

_INTERVAL = 1.959964

_TOLD, _SHARED = 1e-9, 1e-3
"""Singular value, relative, below which the data say nothing of a direction; its share in a parameter that counts."""


def estimates(bench: Bench, at: Fit, k: int, judged: Judgement) -> tuple[Estimate, ...]:
    """Return parameters of a cause with 95 % intervals, infinite where the data do not tell a parameter from others."""
    model = bench.model
    sd = deviations(bench, at, judged.misfit)
    found = []
    for j in model.of_cause[k]:
        place, p = int(np.flatnonzero(at.free == j)[0]), model.parameters[j]
        value, half = p.start + p.scale * float(at.u[j]), _INTERVAL * p.scale * float(sd[place])
        low, high = (max(value - half, p.low), min(value + half, p.high)) if half < math.inf else (-half, half)
        found.append(Estimate(p.name, value * p.shown, low * p.shown, high * p.shown, p.unit))
    return tuple(found)


def deviations(bench: Bench, at: Fit, left: Misfit | None) -> Real:
    """Return the standard deviations of the scaled fitted parameters.

    They are those of white noise, or the mean over the noises that the data could have come from. Where more than that
    is left, the remainder is not white and not the same in all conditions: the larger counts of the noise scaled to its
    size and of the scatter of what each condition by itself does to the estimate (sandwich with the conditions as
    clusters; Liang and Zeger, Biometrika 73, 1986). What the family says that its predictions may be off comes on top.
    """
    slope, _ = stacked(bench.model, bench.target, at.free, at.u, at.residual, at.slope)
    size = np.linalg.norm(slope, axis=0)
    moving = inside(bench.model, at) & (size > 0.0)
    rotated, singular, right = np.linalg.svd((slope / np.where(size > 0.0, size, 1.0))[:, moving], full_matrices=False)
    told = singular > _TOLD * singular.max(initial=0.0)
    inverse = (right[told].T / singular[told]) @ rotated[:, told].T / size[moving, None]
    sd = np.where(size > 0.0, 0.0, np.inf)
    covariances = covariances_of_noise(bench.model, at.residual, inverse.T)
    sd[moving] = np.sqrt(np.mean([np.diag(c) for c in covariances], axis=0))
    if left is not None and left.chance < BAND:
        ends = np.cumsum([r.size for r in at.residual.values()])
        data, prior = inverse[:, : ends[-1]], inverse[:, ends[-1] :]
        pulls = [a @ r for a, r in zip(np.split(data, ends[:-1], axis=1), at.residual.values(), strict=True)]
        scatter = np.sum(np.square(pulls), axis=0) * len(pulls) / max(len(pulls) - 1, 1)
        robust = np.sqrt(scatter + np.sum(np.square(prior), axis=1))
        sd[moving] = np.maximum(sd[moving] * math.sqrt(max(left.ratio, 1.0)), robust)
    sd[moving] = np.hypot(sd[moving], _off(bench.model, at, moving))
    # What is seen of several only together says nothing of each: its variance would come out as zero.
    sd[moving] = np.where(1.0 - np.sum(np.square(right[told]), axis=0) > _SHARED**2, np.inf, sd[moving])
    return sd


def _off(model: Model, at: Fit, moving: NDArray[np.bool_]) -> Real:
    """Return the standard deviations that errors of the predictions add to some scaled fitted parameters."""
    family, count = model.family, int(moving.sum())
    share = float(getattr(family, "model_error", 0.0))
    if share == 0.0 or count == 0:
        return np.zeros(count)
    rows = list(at.slope)
    each = [
        family.relative(model.conditions[r], model.predict(r, at.u), at.slope[r][:, moving])  # type: ignore[attr-defined]
        for r in rows
    ]
    labels = family.alike([model.conditions[r] for r in rows])  # type: ignore[attr-defined]
    shared = {k: np.mean([x for x, label in zip(each, labels, strict=True) if label == k], axis=0) for k in set(labels)}
    slope, wrong = (_real(x) for x in (each, [shared[k] for k in labels]))
    size = np.linalg.norm(slope, axis=0)
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv(slope / size, rcond=_TOLD) / size[:, None]
    taken = inverse @ inverse.T @ wrong.T
    return np.asarray(share * np.sqrt(len(slope) / 2.0 / count * np.sum(np.square(taken), axis=1)))


def _real(each: Sequence[Complex]) -> Real:
    """Complex rows of several conditions as real ones: real parts, then imaginary ones."""
    whole = np.concatenate(list(each))
    return np.concatenate([whole.real, whole.imag])
