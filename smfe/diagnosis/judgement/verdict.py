"""The verdict: consistent, named, ambiguous, unknown or insufficient data, each by a rule fixed beforehand.

Named is a cause whose likelihood ratio (:eq:`likelihood-ratio`) passes the calibrated threshold, that leads every other
cause by a calibrated margin, whose model leaves nothing but noise on held-out conditions and gains there by at least 1
dB however they are drawn, whose parameters are physical and agree between independent sources. Less than what is
material convicts nothing (`smfe.diagnosis.judgement.materiality`). Where more than noise is
left the verdict is "unknown", and a lead counts only if the conditions share it (Vuong, Econometrica 57, 1989): a few
that no model describes must not decide between two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy import stats

from process.types import Real
from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.fit import Fit, Target, stacked
from smfe.diagnosis.inference.misfit import Misfit, carriers
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Tangent, inside, orthonormal
from smfe.diagnosis.inference.thresholds import Detectable, parameters_of, products_of_noise, upper
from smfe.diagnosis.judgement.declared import Strain
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.materiality import EVERYTHING, Worth, residual_of
from smfe.diagnosis.judgement.next_experiment import discrimination
from smfe.diagnosis.judgement.search import Step, on_bound, rivals

Verdict = Literal["consistent", "named", "ambiguous", "unknown", "insufficient_data"]


@dataclass(frozen=True)
class Judgement:
    """A verdict and what it rests on."""

    verdict: Verdict  # one of the five
    reason: str  # why, in a sentence
    sets: Mapping[int, Sequence[Fit]] = field(default_factory=dict)
    """Cause of the fit -> fits that have another in its place and cannot be excluded."""
    misfit: Misfit | None = None  # what the final model leaves: held out where possible
    carriers: tuple[int, ...] = ()  # conditions that carry what is left unexplained
    gain: Gain | None = None  # of all causes together on held-out conditions
    size: float = 0.0  # of what is left beyond noise, relative to what was measured, where it matters [1]
    immaterial: tuple[int, ...] = ()  # causes that are seen, but too small to matter
    refused: Fit | None = None  # the fit they are in, where that is not the one that was judged


def judge(
    bench: Bench,
    at: Fit,
    steps: Sequence[Step],
    sizes: Sequence[Detectable],
    worth: Worth = EVERYTHING,
    released: bool = False,
    objection: str = "",
    strain: Strain | None = None,
    declared: float = 0.0,
) -> Judgement:
    """Judge the fit and the steps that a search ended with, given what would have been seen and what matters.

    `released`: the data contradict what was declared, and it was released; `declared`: the most that one of it changes.
    `objection`: why the fit is no explanation, however well it fits; "" for none. `strain`: what it moves beyond what
    is trusted of it: nothing consistent, and causes and declared values that change less are not what is wrong.
    """
    found = _judged(bench, at, steps, sizes, worth, released)
    if objection and found.verdict in ("consistent", "named", "ambiguous"):
        return replace(found, verdict="unknown", reason=objection, sets={})
    if found.verdict in ("named", "ambiguous") and (stands := _outdone(bench, at, steps)):
        reason = (
            f"{stands} explains far more than {bench.words(at.causes)}, but ends on the limit of what is physical: "
            "what it stands for has no name in the catalogue"
        )
        return replace(found, verdict="unknown", reason=reason, sets={})
    if strain is None:
        return found
    named = [k for k in at.causes if k not in found.immaterial]
    largest = max([declared, *(cause_size(bench, at, k, worth) for k in named)])
    outdone = largest > 0.0 and strain.size > largest
    if found.verdict == "consistent" or (outdone and found.verdict in ("named", "ambiguous")):
        reason = f"it fits only with {strain.said} beyond what is trusted of it, and nothing of the catalogue says why"
        return replace(found, verdict="unknown", reason=reason, sets={})
    return found


def _outdone(bench: Bench, at: Fit, steps: Sequence[Step]) -> str:
    """Return what was refused as it stands for another fault, and beside which the data exclude a fit; "" for nothing.

    A mode inside the peak of a known one is a compliance, or a force, that is wrong there. Where that explains what the
    causes that were found do not, they fit a part of what another fault does.
    """
    model = bench.model
    for s in steps:
        better = None if s.accepted else bench.fits.get(s.causes)
        if better is None or not better.converged or better.chi2 >= at.chi2 - RULES.margin:
            continue
        faults = [c.title for k in s.causes if (c := model.causes[k]).beyond and c.beyond(model.values(better.u))]
        if faults and excluded(bench, better, at, bench.misfit(better)):
            return faults[0]
    return ""


def _judged(
    bench: Bench, at: Fit, steps: Sequence[Step], sizes: Sequence[Detectable], worth: Worth, released: bool
) -> Judgement:
    if not at.causes:
        found = _without_cause(bench, at, steps, sizes, worth)
        if released and found.verdict == "consistent":
            reason = "the data contradict what was declared, and nothing else is wrong"
            return replace(found, verdict="named", reason=reason)
        return found
    gain = bench.gain(bench.null(), at)
    chosen = bench.usable(at, at.causes)
    apart = bench.held_out(at, chosen) if chosen else None
    left = bench.misfit(at) if apart is None else apart.misfit
    how = "" if chosen else "; held out were blocks of values, as no condition can be left out"
    model = bench.model
    known = tuple(k for k in at.causes if bench.as_known(at, k))
    small = tuple(k for k in at.causes if k in known or cause_size(bench, at, k, worth) < worth.material)
    named = [k for k in at.causes if k not in small]
    best = bench.words(named or at.causes)
    sets = {k: fits for k in named if (fits := _open(bench, at, k, left))}
    size = 0.0
    if left.p_value < RULES.band:
        size = worth.left(model, residual_of(model, {} if apart is None else apart.fitted, at), bench.rng(10))
    told = Judgement("named", "", sets, left, (), gain, size, small)
    matters = left.p_value < RULES.band and size >= worth.material
    if matters and not (worth.material > 0.0 and gain is not None and gain.share >= RULES.named_share and named):
        reason = f"the best of the catalogue, {best}, leaves more than noise on conditions it did not see"
        return replace(told, verdict="unknown", reason=reason, carriers=tuple(carriers(left)))
    differing = [model.causes[k].title for k in named if not agrees(bench, at, k)]
    if differing and (worth.material == 0.0 or matters):
        reason = f"parameters of {' and '.join(differing)} differ between independent sources"
        return replace(told, verdict="unknown", reason=reason)
    if sets:
        return replace(told, verdict="ambiguous", reason=f"the data fit more than one cause{how}")
    # Beside what is known within its tolerance a cause may have been refused as it is beside nothing.
    if len(known) == len(at.causes) and not released:
        beside = _without_cause(bench, at, steps, sizes, worth)
        if beside.verdict != "consistent":
            return replace(beside, immaterial=known)
    if not named:
        verdict: Verdict = "named" if released else "consistent"
        said = "no more than what is known of it" if known else "too small to matter"
        return replace(told, verdict=verdict, reason=f"{best} is seen, but {said}{how}")
    rest = f", with a remainder of {_percent(size)} of what was measured" if matters else ""
    return replace(
        told,
        reason=f"{best}{rest or ' and nothing else of the catalogue'}{how}",
        carriers=tuple(carriers(left)) if matters else (),
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def cause_size(bench: Bench, at: Fit, k: int, worth: Worth) -> float:
    """Return what a cause of a fit changes: by itself, or by what else is fitted wrongly without it, whichever is more.

    By itself a dead time may change no depth that friction does not change back; and friction that hardly acts at the
    feed of the cut moves masses and gains of a model that is fitted without it.
    """
    none, rows = at.u.copy(), list(bench.target.observed)
    none[bench.model.of_cause[k]] = 0.0
    measurement = bench.model.causes[k].kind == "measurement"
    without = (none, bench.reduce(at, k).u)
    return max(worth.of_causes(bench.model, rows, u, at.u, measurement) for u in without)


def _beyond_baseline(bench: Bench, at: Fit, found: Fit, worth: Worth) -> float:
    """Return what a fit with causes, accepted or not, predicts otherwise than the baseline fitted to the same data."""
    measurement = all(bench.model.causes[k].kind == "measurement" for k in found.causes)
    return worth.of_causes(bench.model, list(bench.target.observed), at.u, found.u, measurement)


def _without_cause(
    bench: Bench, at: Fit, steps: Sequence[Step], sizes: Sequence[Detectable], worth: Worth
) -> Judgement:
    """Judge a baseline that no cause was added to: what is left of it, or was refused, must matter to convict it."""
    found = _of_baseline(bench, at, steps, sizes)
    if worth.material == 0.0 or found.misfit is None or found.verdict == "consistent":
        return found
    size = worth.left(bench.model, at.residual, bench.rng(10)) if found.misfit.p_value < RULES.band else 0.0
    tried = [bench.fits[s.causes] for s in steps if _refused(s, at) and _borne_out(s, at)]
    best = min((f for f in tried if f.converged), key=lambda f: f.chi2, default=None)
    sized = 0.0 if best is None else _beyond_baseline(bench, at, best, worth)
    if max(size, sized) >= worth.material or (found.verdict == "insufficient_data" and best is None):
        return replace(found, size=size)
    small = () if best is None else best.causes
    words = f"{bench.words(small)}, too" if small else f"{_percent(size)} of what was measured, too"
    reason = f"what the baseline leaves beyond noise is {words} small to matter"
    return Judgement("consistent", reason, {}, found.misfit, (), None, size, small, best)


def _of_baseline(bench: Bench, at: Fit, steps: Sequence[Step], sizes: Sequence[Detectable]) -> Judgement:
    if not at.converged:
        return Judgement("insufficient_data", f"the baseline could not be fitted: {at.reason}")
    left = bench.misfit(at)
    # Noise finds more among all pairs, with their shapes, than the linearised threshold allows for, and so do smooth
    # errors of a simulation with a mode or a gain: what held-out conditions do not bear out convicts only where the
    # misfit itself is more than noise.
    # What was taken in and dropped later, as a release has made it idle, was not refused.
    telling = [s for s in steps if _refused(s, at) and (left.p_value < RULES.band or _borne_out(s, at))]
    telling = [s for s in telling if bench.convicts(at, s.ratio) or bench.proves(s.gain)]
    if telling:
        refused = max(telling, key=lambda s: s.ratio - s.threshold)
        best = bench.words([k for k in refused.causes if k not in at.causes])
        reason = f"the baseline is wrong, but the best explanation, {best}, is refused: {refused.reason}"
        # Enough is explained, but not proven on conditions that the fit did not see: more data, not another cause.
        # Pairs that nothing tests fit whatever is hidden.
        alone = refused.gain is None and len(refused.causes) == len(at.causes) + 1
        untested = alone and not on_bound(bench.model, bench.fits[refused.causes], refused.causes)
        weak = all(s.gain is None for s in telling) or (
            bench.misfit(bench.fits[refused.causes]).p_value >= RULES.band
            and (untested or (refused.gain is not None and refused.gain.db >= 1.0))
        )
        reason += _differing(bench, at)
        return Judgement("insufficient_data" if weak else "unknown", reason, {}, left, tuple(carriers(left)))
    if left.p_value < RULES.false_alarm:
        reason = "the baseline leaves more than noise, and no cause of the catalogue explains it" + _differing(
            bench, at
        )
        return Judgement("unknown", reason, {}, left, tuple(carriers(left)))
    change = changing(bench, at)
    if change is not None and change.certain:
        reason = f"{change.parameter} changes with {change.setting}, and no cause of the catalogue explains it"
        return Judgement("unknown", reason, {}, left)
    if not any(p.admissible for p in sizes):
        return Judgement("insufficient_data", "no cause of the catalogue would be seen in these conditions", {}, left)
    return Judgement("consistent", "the baseline leaves nothing but noise", {}, left)


def _refused(step: Step, at: Fit) -> bool:
    """Whether a step was refused that leads on from a fit."""
    return not step.accepted and set(at.causes) < set(step.causes)


def _borne_out(step: Step, at: Fit) -> bool:
    """Whether held-out conditions do not speak against a single cause more."""
    return len(step.causes) == len(at.causes) + 1 and (step.gain is None or step.gain.low > 0.0)


def _differing(bench: Bench, at: Fit) -> str:
    """Say which parameter of the baseline differs most between the conditions, a trace of what has no name."""
    change = changing(bench, at)
    if change is None or not change.certain:
        return ""
    return f"; what differs most between the conditions is {change.parameter}, with {change.setting}"


def _open(bench: Bench, at: Fit, k: int, left: Misfit) -> list[Fit]:
    """Fits with another cause in place of k that the data do not exclude."""
    found = []
    for rival in rivals(bench, at, k):
        own = set(rival.causes) - set(at.causes)
        possible = rival.converged and not on_bound(bench.model, rival, tuple(own))
        if possible and not excluded(bench, at, rival, left):
            found.append(rival)
    return sorted(found, key=lambda f: f.chi2)


def excluded(bench: Bench, best: Fit, rival: Fit, left: Misfit) -> bool:
    """Whether the data separate a rival from the best hypothesis, which leaves some misfit."""
    ahead = lead(bench, best, rival)
    if ahead <= RULES.margin or (ahead <= most_needed(bench, best, rival) and ahead <= needed_lead(bench, best, rival)):
        return False
    if left.p_value >= RULES.band:
        return True
    own = np.array([float(np.sum(rival.residual[r] ** 2) - np.sum(x**2)) for r, x in best.residual.items()])
    drawn = bench.rng(6, *best.causes, *rival.causes).integers(0, own.size, (RULES.draws // 5, own.size))
    # What a rival moves beyond what was declared counts against it whatever is drawn: no condition carries it.
    beyond = rival.chi2 - best.chi2 - float(own.sum())
    return float(np.quantile(own[drawn].sum(axis=1), RULES.band)) + beyond > 0.0


def lead(bench: Bench, best: Fit, rival: Fit) -> float:
    """Likelihood ratio between two hypotheses, each charged for its parameters."""
    more = parameters_of(bench.model, rival.causes) - parameters_of(bench.model, best.causes)
    return rival.chi2 - best.chi2 + RULES.penalty * more


def most_needed(bench: Bench, best: Fit, rival: Fit) -> float:
    """Return what `needed_lead` cannot exceed: the rival's parameters and the distance itself, all fitted to noise."""
    more = parameters_of(bench.model, best.causes) - parameters_of(bench.model, rival.causes)
    return max(float(stats.chi2.ppf(0.99, rival.free.size + 1)) + RULES.penalty * more, RULES.margin)


def needed_lead(bench: Bench, best: Fit, rival: Fit) -> float:
    """Return the lead that only one in a hundred gets of the wrong one of two hypotheses, by parametric bootstrap.

    Data are drawn from the best hypothesis (linearised about its fit); the rival, re-fitted to what the best predicts,
    is off by d. Both misfits depend on the noise only through their tangents and d.
    """
    model, target = bench.model, bench.target
    apart = discrimination(model, target, best, rival, [])
    if apart is None or not apart.converged:
        return float("inf")
    rows = sum(r.size for r in best.residual.values()) + int(np.sum(model.weight[model.nuisance] > 0.0))
    exact = Target({r: y for r, y in target.observed.items()}, best.u)
    d = stacked(model, exact, apart.free, apart.u, apart.residual, apart.slope)[1][:rows]
    mine, other = (
        orthonormal(stacked(model, target, f.free, f.u, f.residual, f.slope)[0][:rows]) for f in (best, apart)
    )
    every = orthonormal(np.concatenate([mine, other, d[:, None]], axis=1))
    noise = bench.rng(4, *best.causes, *rival.causes).standard_normal((RULES.draws // 5, every.shape[1]))
    a, b, c = noise @ (every.T @ mine), noise @ (every.T @ other), noise @ (every.T @ d)
    wrong = np.sum(b**2, axis=1) - np.sum(a**2, axis=1) - 2.0 * c - float(d @ d)
    wrong += RULES.penalty * (parameters_of(model, best.causes) - parameters_of(model, rival.causes))
    return max(float(np.quantile(wrong, 0.99)), RULES.margin)


# --- Whether independent sources give a cause the same parameters.


def agrees(bench: Bench, at: Fit, k: int) -> bool:
    """Whether a cause has the same parameters in all sources, within their joint 99 % region."""
    sources = sorted({bench.model.conditions[r].source for r in bench.target.observed} - {""})
    if len(sources) < 2:
        return True
    slopes = [_own_slopes(bench, at, k, source) for source in sources]
    informations = [x.T @ x for x in slopes]
    residual = stacked(bench.model, bench.target, at.free, at.u, at.residual, at.slope)[1]
    square = _disagreement(informations, np.stack([-(x.T @ residual) for x in slopes])[:, None, :])[0]
    degrees_of_freedom = sum(_rank(x) for x in informations) - _rank(np.sum(informations, axis=0))
    if degrees_of_freedom < 1 or square <= float(stats.chi2.ppf(RULES.agreed, degrees_of_freedom)):
        return True
    return bool(square <= np.quantile(_by_chance(bench, at, slopes, informations), RULES.agreed))


def _own_slopes(bench: Bench, at: Fit, k: int, source: str) -> Real:
    """Return what the parameters of a cause do in one source and no other fitted parameter there, (N, m).

    The rows are those of all conditions, zero in those of other sources, and of the priors.
    """
    model, target = bench.model, bench.target
    rows = [r for r in target.observed if model.conditions[r].source == source]
    own = np.isin(at.free, model.of_cause[k])
    slope, _ = stacked(model, target.only(rows), at.free, at.u, at.residual, at.slope)
    basis = orthonormal(slope[:, ~own])
    mine = slope[:, own] - basis @ (basis.T @ slope[:, own])
    mine[:, np.linalg.norm(mine, axis=0) < 1e-4 * np.linalg.norm(slope[:, own], axis=0)] = 0.0
    found, begin = [], 0
    for r, residual in at.residual.items():
        end = begin + (residual.size if r in rows else 0)
        found.append(mine[begin:end] if r in rows else np.zeros((residual.size, mine.shape[1])))
        begin = end
    return np.concatenate([*found, mine[begin:]])


def _disagreement(informations: Sequence[Real], vectors: Real) -> Real:
    """Weighted squares of what the sources differ by, shape (d,), for score vectors (sources, d, m)."""
    pooled = np.sum(vectors, axis=0) @ _inverse(np.sum(informations, axis=0))
    square = np.zeros(vectors.shape[1])
    for information, vector in zip(informations, vectors, strict=True):
        away = vector - pooled @ information
        square += np.einsum("dm,mn,dn->d", away, _inverse(information), away)
    return square


def _by_chance(bench: Bench, at: Fit, slopes: Sequence[Real], informations: Sequence[Real]) -> Real:
    """Draw the same of noise that the data could have come from."""
    drawn = products_of_noise(bench.model, bench.tangent(at), slopes, bench.rng(8, *at.causes), RULES.draws)
    return _disagreement(informations, np.stack(drawn))


def _inverse(information: Real) -> Real:
    return np.asarray(np.linalg.pinv(information, rcond=1e-8, hermitian=True))


def _rank(information: Real) -> int:
    return int(np.linalg.matrix_rank(information, rtol=1e-8, hermitian=True))


# --- Whether the parameters of a fit are the same in all conditions: what changes when a cause is not in the catalogue.


@dataclass(frozen=True)
class Change:
    """The parameter that changes most."""

    parameter: str  # what changes
    setting: str  # with what
    ratio: float  # likelihood ratio of letting it change
    threshold: float  # what noise reaches
    effect: Real = field(repr=False)  # shape (N,): what the change does to the whitened data of all conditions

    @property
    def certain(self) -> bool:
        """Whether it is more than noise."""
        return self.ratio > self.threshold


def most_changing(
    model: Model, at: Tangent, rng: np.random.Generator, p_value: float = RULES.changing
) -> Change | None:
    """Return the parameter that differs most between the conditions; None where no setting contrasts them."""
    found = list(_patterns(model, at))
    if not found:
        return None
    columns = [c for _, _, c in found]
    inverses = [np.linalg.pinv(c.T @ c, rcond=1e-10, hermitian=True) for c in columns]
    charges = [RULES.penalty * c.shape[1] for c in columns]
    drawn = products_of_noise(model, at, columns, rng, RULES.draws)
    scores = [np.einsum("di,ij,dj->d", p, inv, p) - q for p, inv, q in zip(drawn, inverses, charges, strict=True)]
    limit = upper(scores, p_value)
    gains = [float(at.residual @ c @ inv @ c.T @ at.residual) for c, inv in zip(columns, inverses, strict=True)]
    k = int(np.argmax(np.array(gains) - charges))
    effect = columns[k] @ inverses[k] @ columns[k].T @ at.residual
    return Change(found[k][0], found[k][1], gains[k], limit + charges[k], effect)


def changing(bench: Bench, at: Fit) -> Change | None:
    """Return the parameter of a fit that differs most between its conditions."""
    return most_changing(bench.model, bench.tangent(at), bench.rng(7, len(at.causes)))


def drifting(bench: Bench, at: Fit, worth: Worth) -> str:
    """Say which parameter of a fit drifts from test to test, by what matters in one of them; "" for none.

    What is fitted to all tests of a machine that warms up, or of an edge that wears, is the mean of what it was.
    """
    rows = list(at.residual)
    if any(c.id == "drift" for c in bench.model.causes):  # then the search has looked for it
        return ""
    if worth.material == 0.0 or not all("order" in bench.model.conditions[r].settings for r in rows):
        return ""
    change = changing(bench, at)
    if change is None or not change.certain or change.setting != "order":
        return ""
    ends = np.cumsum([at.residual[r].size for r in rows])
    parts = np.split(change.effect[: ends[-1]], ends[:-1])
    conditions = [bench.model.conditions[r] for r in rows]
    each = [bench.model.family.squared_size(c, x) for c, x in zip(conditions, parts, strict=True)]
    largest = math.sqrt(max(0.0, *each))
    if largest < worth.material:
        return ""
    of = next((p.said for p in bench.model.parameters if p.name == change.parameter and p.said), change.parameter)
    return f"{of} changes from test to test, by up to {_percent(largest)}, and no cause of the catalogue explains it"


def odd_one(bench: Bench, at: Fit, worth: Worth) -> str:
    """Say which condition asks for another scale than all the others, by what matters; "" for none.

    One cut that was deeper than declared is one of many values that are each known within 5 %: their squares together
    hardly show it.
    """
    model, scales = bench.model, dict[int, float]()
    if worth.material == 0.0 or not model.family.one_scale:
        return ""
    for r, left in at.residual.items():
        predicted = model.predict(r, at.u)
        if predicted is not None and model.conditions[r].settings.get("depth") and np.any(predicted):
            scales[r] = -float(predicted @ left) / float(predicted @ predicted)
    if len(scales) < RULES.odd_from:
        return ""
    middle = float(np.median(list(scales.values())))
    away = {r: abs(x - middle) for r, x in scales.items()}
    spread = max(stats.norm.ppf(0.75) ** -1 * float(np.median(list(away.values()))), RULES.odd_least)
    worst = max(away, key=lambda r: away[r])
    if away[worst] < max(RULES.odd * spread, RULES.odd_matters * worth.material):
        return ""
    more = (1.0 + scales[worst]) / (1.0 + middle) - 1.0
    off = f"{_percent(abs(more))} {'larger' if more > 0.0 else 'smaller'}"
    return (
        f"{model.conditions[worst].name} alone has forces {off} than all the others ask for: its depth, width or feed "
        "may be another than was given"
    )


def _patterns(model: Model, at: Tangent) -> Iterator[tuple[str, str, Real]]:
    """Yield parameter, setting and columns (N, m) of every change that a fit does not imitate."""
    fit = at.fit
    rows = list(fit.residual)
    moving = inside(model, fit)
    lost = at.basis.shape[0] - sum(fit.residual[r].size for r in rows)
    for key in sorted({key for r in rows for key in model.conditions[r].settings}):
        contrast = _contrast([model.conditions[r].settings.get(key) for r in rows])
        for place, j in enumerate(fit.free):
            if contrast is None or not moving[place]:
                continue
            data = np.concatenate([np.outer(fit.slope[r][:, place], s) for r, s in zip(rows, contrast, strict=True)])
            columns = np.concatenate([data, np.zeros((lost, data.shape[1]))])
            before = np.linalg.norm(columns, axis=0)
            columns -= at.basis @ (at.basis.T @ columns)
            seen = np.linalg.norm(columns, axis=0) > np.maximum(RULES.confounded * before, 1e-12)
            if seen.any():
                yield model.names[int(j)], key, columns[:, seen] / before[seen]


def _contrast(settings: Sequence[float | str | None]) -> Real | None:
    """Return numbers for the settings of the conditions, (conditions, m): a slope, or one column for each word."""
    if any(s is None for s in settings) or len(set(settings)) < 2:
        return None
    if all(isinstance(s, (int, float)) for s in settings):
        x = np.array(settings, dtype=float)
        return ((x - x.mean()) / x.std())[:, None] if math.isfinite(float(x.std())) else None
    words = sorted({str(s) for s in settings})[: RULES.most_words + 1]
    return np.array([[float(str(s) == w) for w in words[1:]] for s in settings])
