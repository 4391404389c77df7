"""The diagnosis: how wrong a baseline is beyond noise, why, what the repaired model gains, and what to measure next."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from threadpoolctl import threadpool_limits

from process.errors import InputError
from process.types import Complex, Real
from smfe.diagnosis.inference.cross_validation import Gain, HeldOut, compare, unseen, usable, within
from smfe.diagnosis.inference.fit import Fit, Target, fit, residuals, stacked
from smfe.diagnosis.inference.misfit import Misfit, decomposed
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition, Family
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import cosines, groups, inside
from smfe.diagnosis.inference.thresholds import charge, combined_gain, covariances_of_noise, detectable, parameters_of
from smfe.diagnosis.inference.workers import Helpers
from smfe.diagnosis.judgement.declared import Released, Size, Strain, contradicted, masking, slightly_off, strained
from smfe.diagnosis.judgement.finding import (
    Estimate,
    Finding,
    FoundCause,
    GivenParameter,
    Remainder,
    SearchStep,
    by_condition,
)
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.materiality import EVERYTHING, Worth, predicted_size
from smfe.diagnosis.judgement.next_experiment import Proposal, rank, revealing
from smfe.diagnosis.judgement.search import Step, on_bound, search
from smfe.diagnosis.judgement.verdict import Judgement, cause_size, drifting, excluded, judge, odd_one
from smfe.progress import Progress, silent

MEASURED = frozenset({"sensor_gain", "sensor_axis", "sensor_offset", "time_skew", "cross_talk", "accelerometer_mass"})
"""Ids of what is declared of sensors: it changes what they show, and no limit depth."""


IMPOSSIBLE = "the data contradict what was declared, but {} ends on the limit of what is physical"
"""Why the best fit is no explanation."""

UNFITTED = "the data contradict what was declared, and no fit with other values converged"
"""Why what slopes alone promise is none."""


def diagnose(
    family: Family,
    seed: int = 0,
    progress: Progress = silent,
    held_out: Sequence[str] = (),
    workers: int | None = None,
    worth: Worth = EVERYTHING,
) -> Finding:
    """Diagnose a baseline.

    Where the data of a family rest on a simulation (`Family.prepares_data`) that is known to miss something
    (`Abilities.decisive`), they are prepared anew with what fits them before causes are looked for, as long as that
    leaves more than noise and then leaves less. Where they rest on one and a cause was found, they are prepared
    once more, with that cause, and searched again from the fits that are known by then; a third time if that search
    finds other causes. Where the data contradict what was declared, that is released and all searched once more; it
    stays so if conditions that no fit uses bear it out. What was declared wrongly also stands in for causes that fit no
    better for their parameters. Where neither a cause nor a declared value alone is it, each may hide the
    other (`Abilities.masks`): what is declared is released while causes are looked for, and stays so with one that
    explains the rest.

    Parameters
    ----------
    family : Family
        Baseline, causes, measured conditions and proposals.
    seed : int, optional
        Of all draws; the same seed gives the same finding.
    progress : callable, optional
        Called with what is being done.
    held_out : sequence of str, optional
        Names of measured conditions that no fit uses and that are predicted once, at the very end.
    workers : int, optional
        Processes that predict where that takes long; default: one a core, at most 8, on Linux, elsewhere one. The
        finding is the same with any number.
    worth : Worth, optional
        What is large enough to matter; default: everything.

    Returns
    -------
    Finding
        Verdict, causes, gains, detectable sizes and the next experiment.

    Raises
    ------
    InputError
        For a family that contradicts itself, a condition to be held out that was not measured, or no worker.
    """
    # Many small matrices: threads of the algebra wait for each other, and sum in another order each time.
    with threadpool_limits(1, "blas"), Helpers(workers) as helpers:
        conditions: Sequence[Condition] = family.conditions
        known, assumed = dict[tuple[int, ...], Fit](), tuple[int, ...]()
        for last in (not family.prepares_data, False, True):
            bench, apart = _prepared(family, conditions, seed, progress, held_out, helpers, worth)
            bench.known = known
            for _ in range(RULES.preparations if family.decisive > 0.0 and not assumed and not last else 0):
                # What was put right by a simulation that is off leads a search to what does the same to all of it.
                null = bench.null()
                if not null.converged or not (bench.bad(null) or _contradicted(bench, null, worth)):
                    break
                anew = family.as_found(bench.model.values(null.u))
                again, left_out = _prepared(family, anew, seed, progress, held_out, helpers, worth)
                again.known = dict(bench.fits)
                if not again.null().converged or again.null().chi2 > (1.0 - RULES.prepared_better) * null.chi2:
                    break
                bench, apart, conditions = again, left_out, anew

            def promised(at: Fit, bench: Bench = bench) -> float:
                return sum(r.ratio - RULES.penalty * len(r.values[0]) for r in _contradicted(bench, at, worth))

            # A parameter that is known within a prior asks for no value of its own.
            values, nuisances = _values(bench), int(np.sum(bench.model.weight[bench.model.nuisance] == 0.0))
            if values <= nuisances:
                return Finding("insufficient_data", f"{values} values for {nuisances} parameters of the baseline")
            at, steps = bench.null(), list[Step]()
            # As long as the data are prepared without a cause, one is enough to prepare them better.
            if at.converged or bench.hopeless(at):
                at, steps = search(bench, RULES.most_causes if last or assumed else 1, released=promised)
            if not at.converged:
                return Finding("insufficient_data", f"the baseline could not be fitted: {at.reason}")
            if last or at.causes == assumed:
                break
            assumed, known = at.causes, dict(bench.fits)
            conditions = family.as_found(bench.model.values(at.u))
        given = bench
        declared, objection = _contradicted(bench, at, worth), ""
        masked = not declared and not at.causes and family.masks and bench.bad(at)
        if masked:
            declared = masking(bench.model, bench.target, at, _size_of(bench, worth), worth.material)
        unproven: list[Released] = []

        def released_bench(released: Sequence[Released], like: Bench = bench) -> Bench:
            other, _ = _prepared(family, conditions, seed, progress, held_out, helpers, worth, released)
            other.known = dict(like.fits)
            return other

        if declared:
            declared, again = _one_by_one(released_bench, at, declared, worth)
            # Far from the data, without a cause that is known, no fit need end.
            if again.null().converged or (at.causes and again.extend(again.null(), at.causes).converged):
                found, more = search(again, begin=at.causes)
                if masked and (not found.causes or again.bad(found) or not _borne_out(again, found, declared)):
                    declared = []
                elif not masked and (as_given := _as_declared_again(bench, at, found, declared, worth)) is not None:
                    at, more = search(bench, begin=as_given.causes)
                    steps, declared = [*(s for s in steps if s.accepted), *more], []
                elif (limit := _at_limit(again, found)) and (
                    switched := mounted_otherwise(bench, found, declared, worth)
                ):
                    at, more = search(bench, begin=switched.causes)
                    steps, declared = [*(s for s in steps if s.accepted), *more], []
                elif limit:
                    # What no value of it explains is a remainder, where causes explain nearly all.
                    objection = "" if bench.named(at) else IMPOSSIBLE.format(limit)
                    declared = []
                elif _empty(at, found, declared) or _too_small(again, at, found, declared, worth):
                    declared = []
                elif not _borne_out(again, found, declared):
                    told = bench.decided(at, at.chi2 - found.chi2)
                    declared, unproven = [], declared if told else []
                elif (other := _instead(bench, at, again.fits.get(at.causes, found), declared, steps)) is not None:
                    at, declared = bench.fits[other.causes], []
                    steps = [replace(s, accepted=True, reason="") if s is other else s for s in steps]
                else:
                    bench, at, steps = again, found, [*(s for s in steps if s.accepted), *more]
            else:
                objection, declared = "" if masked else UNFITTED, []
        elif at.causes and (declared := _contradicted(bench, bench.null(), worth)):
            # What was declared wrongly may do what the causes found do, with fewer parameters.
            count = sum(len(r.values[0]) for r in declared)
            most = at.chi2 + charge(bench.model, at.causes) - RULES.penalty * count
            again = released_bench(declared)
            found = again.null(most)
            better = found.chi2 < most and not _at_limit(again, found)
            if found.converged and better and _borne_out(again, found, declared):
                bench, at, steps = again, found, []
            else:
                declared = []
        if family.masks and not declared and len(at.causes) > 1:
            bench, at, declared = _in_place(bench, at, released_bench, worth)
        at, steps = _told(bench, at, steps, worth)
        # What a cause that is gone had moved is as declared again.
        plain = given.fits.get(at.causes)
        if declared and plain is not None and plain.converged and _too_small(bench, plain, at, declared, worth):
            bench, at, declared = given, plain, []
        if not objection and (name := _at_limit(bench, at)):
            objection = IMPOSSIBLE.format(name)
        objection = objection or odd_one(bench, at, worth) or drifting(bench, at, worth)
        finding = _finding(bench, apart, at, steps, declared, worth, objection)
        if finding.verdict == "named" and declared and not at.causes:
            rivals = _stand_ins(given, at, declared, worth)
            finding = _open_between(finding, bench, at, given, rivals, worth) if rivals else finding
        if unproven and finding.verdict == "consistent":
            return replace(finding, verdict="insufficient_data", reason=_not_borne_out(bench, unproven))
        return finding


def _in_place(
    bench: Bench, at: Fit, prepared: Callable[[Sequence[Released]], Bench], worth: Worth
) -> tuple[Bench, Fit, list[Released]]:
    """Return a fit with what was declared released in the place of one of its causes, where that does as much.

    A cause that came in beside another may stand for a declared value which only that other one was hiding.
    """
    for k in reversed(at.causes):
        smaller = bench.reduce(at, k)
        if not smaller.converged or not (declared := _contradicted(bench, smaller, worth)):
            continue
        again = prepared(declared)
        if not again.null().converged:
            continue
        found = again.extend(again.null(), smaller.causes)
        count = sum(len(r.values[0]) for r in declared)
        most = at.chi2 + charge(bench.model, at.causes) - charge(bench.model, smaller.causes) - RULES.penalty * count
        better = found.chi2 < most and not _at_limit(again, found)
        if found.converged and better and _borne_out(again, found, declared):
            return again, found, declared
    return bench, at, []


def _one_by_one(
    prepared: Callable[[Sequence[Released]], Bench], at: Fit, declared: list[Released], worth: Worth
) -> tuple[list[Released], Bench]:
    """Return what is contradicted where each is fitted anew before the next is looked at, and its hypotheses.

    To first order a large value leaves its square to others: a sensor turned by 22 degrees shows 7 % less. What came
    first may have stood in for what came after it, and is taken back where it then fits as it was declared.
    """

    def fitted(released: Sequence[Released]) -> tuple[Bench, Fit]:
        again = prepared(released)
        return again, again.extend(again.null(), at.causes) if at.causes else again.null()

    kept = declared[:1]
    while len(declared) > 1:
        again, found = fitted(kept)
        if not found.converged:
            break
        known = {g for r in kept for g in r.given}
        more = [r for r in _contradicted(again, found, worth) if r.given[0] not in known]
        if more:
            kept = [*kept, more[0]]
            continue
        for r in kept[:-1]:
            fewer = [x for x in kept if x is not r]
            without, as_given = fitted(fewer)
            if as_given.chi2 - found.chi2 < stats.chi2.isf(RULES.contradicted, len(r.values[0])):
                kept, again, found = fewer, without, as_given
        # Beside what a model misses the smaller of two counts by the same measure as one does alone.
        for r in sorted(kept, key=lambda x: x.ratio) if again.model.family.decisive > 0.0 else ():
            fewer = [x for x in kept if x is not r]
            if not fewer:
                break
            without, as_given = fitted(fewer)
            if as_given.converged and not without.decided(as_given, as_given.chi2 - found.chi2):
                kept, again, found = fewer, without, as_given
        return kept, again
    return declared, prepared(declared)


def _as_declared_again(bench: Bench, at: Fit, found: Fit, released: Sequence[Released], worth: Worth) -> Fit | None:
    """Return the fit with causes found beside a release where all then fits as declared; None where not.

    What a fit without these causes had moved was theirs: for want of a mode hits leaned by 45 degrees.
    """
    if set(found.causes) <= set(at.causes):
        return None
    again = bench.refitted(found)
    count = sum(len(r.values[0]) for r in released)
    needless = again.chi2 - found.chi2 < stats.chi2.ppf(RULES.agreed, count)
    return again if again.converged and needless and not _contradicted(bench, again, worth) else None


def mounted_otherwise(bench: Bench, found: Fit, released: Sequence[Released], worth: Worth) -> Fit | None:
    """Return the fit of a switch with which all is as declared, where a release does the same beyond what is physical.

    Sensors that are turned by 45 degrees about three axes show what two that are exchanged do.
    """
    model = bench.model
    given = {g for r in released for g in r.given}
    count = sum(len(r.values[0]) for r in released)
    fits = []
    for k in (k for k, cause in enumerate(model.causes) if cause.id in given and cause.starts):
        for values in model.causes[k].starts:
            u = bench.target.centre.copy()
            mine = model.of_cause[k]
            u[mine] = (np.array(values) - model.start[mine]) / model.scale[mine]
            fits.append(fit(model, bench.target, (k,), u))
    ended = [f for f in fits if f.converged and not _at_limit(bench, f)]
    best = min(ended, key=lambda f: f.chi2 + charge(model, f.causes), default=None)
    if best is None or best.chi2 + charge(model, best.causes) > found.chi2 + RULES.penalty * count:
        return None
    return bench.keep(best) if not _contradicted(bench, best, worth) else None


def _instead(bench: Bench, at: Fit, found: Fit, released: Sequence[Released], steps: Sequence[Step]) -> Step | None:
    """Return the step that does what a release does, with fewer parameters or far better; None where none does.

    What acts in all conditions alike is hardly tested by leaving some of them out, be it a cause or a declared value.
    """
    count = sum(len(r.values[0]) for r in released)
    most = found.chi2 + RULES.penalty * count + charge(bench.model, found.causes)
    refused = [s for s in steps if not s.accepted and set(at.causes) < set(s.causes) and s.ratio > s.threshold]
    known = parameters_of(bench.model, at.causes)
    fits = {s.causes: bench.fits[s.causes] for s in refused}
    # Held-out conditions speak against a cause if its gain is below zero by more than it scatters.
    able = [s for s in refused if s.gain is not None and (2.0 * s.gain.db > s.gain.low or alike(at, fits[s.causes]))]
    able = [s for s in able if bench.decided(at, s.ratio) or bench.proves(s.gain)]
    able = [s for s in able if fits[s.causes].converged and not on_bound(bench.model, fits[s.causes], s.causes)]
    merit = {s.causes: fits[s.causes].chi2 + charge(bench.model, s.causes) for s in able}
    fewer = {s.causes: parameters_of(bench.model, s.causes) - known < count for s in able}
    able = [s for s in able if merit[s.causes] < most - (0.0 if fewer[s.causes] else RULES.margin)]
    return min(able, key=lambda s: merit[s.causes], default=None)


def _stand_ins(given: Bench, at: Fit, released: Sequence[Released], worth: Worth) -> list[Fit]:
    """Return the fits with a cause, all else as declared, that the data do not separate from a release alone.

    Limits of depth tell that all are lower by a third, and not whether coefficients, a coupling or a mode are why.
    """
    count = sum(len(r.values[0]) for r in released)
    most = at.chi2 + RULES.penalty * count + RULES.margin
    # The same fault in another form is no other.
    model, wrong = given.model, {g for r in released for g in r.given}
    other = [f for c, f in given.fits.items() if len(c) == 1 and model.causes[c[0]].id not in wrong]
    alone = [f for f in other if f.converged]
    null = given.null()
    near = [f for f in alone if f.chi2 + charge(model, f.causes) < most and not on_bound(model, f, f.causes)]
    near = [f for f in near if given.decided(null, null.chi2 - f.chi2)]
    found = [f for f in near if not _contradicted(given, f, worth) and not _at_limit(given, f)]
    return sorted(found, key=lambda f: f.chi2 + charge(model, f.causes))


def _open_between(
    finding: Finding, bench: Bench, at: Fit, given: Bench, rivals: Sequence[Fit], worth: Worth
) -> Finding:
    """Return a finding of what was declared wrongly that is open between this and causes, with what separates them."""
    model, wrong = bench.model, finding.causes
    rows = [r for r, c in enumerate(model.conditions) if c.observed is None]
    found = [
        _found(given, f, k, Judgement("named", "", misfit=given.misfit(f)), worth) for f in rivals for k in f.causes
    ]
    contenders = [at, *rivals[: RULES.contenders - 1]]
    titles = " and ".join(c.title for c in (wrong[0], *found[: RULES.contenders - 1]))
    models = [model, *[given.model] * (len(contenders) - 1)]
    freed = [j for j in model.nuisance if model.weight[j] != given.model.weight[j]]
    ranked = rank(model, bench.target, contenders, rows, titles, models, freed)
    return replace(
        finding,
        verdict="ambiguous",
        reason=f"the data do not tell {wrong[0].title} from {found[0].title}",
        alternatives=((*wrong, *found),),
        next_experiment=ranked[0] if ranked and ranked[0].probability > 0.5 else None,
    )


def _told(bench: Bench, at: Fit, steps: list[Step], worth: Worth) -> tuple[Fit, list[Step]]:
    """Return a fit without the causes that it does not tell from nothing, and the steps with them refused.

    Beside a remainder a likelihood ratio counts what the model misses as noise, and what it misses of each reversal
    alike it misses on conditions left out, too. Wald's statistic with the deviations of the intervals, which count
    the remainder, takes its place: half a chi-square for a size of one sign. A cause that it does not tell from zero
    is none where the fit without it is no other by what matters, and contradicts nothing that was declared.
    """
    if worth.material == 0.0 or not at.causes or bench.misfit(at).p_value >= RULES.band:
        return at, steps
    model, rows = bench.model, list(bench.target.observed)
    sd = deviations(bench, at, bench.misfit(at))
    for k in at.causes:
        smaller = bench.reduce(at, k)
        sizes = {int(j) for s in bench.tangent(smaller).signatures if s.cause == k for j in s.free}
        own = [place for place, j in enumerate(at.free) if int(j) in sizes]
        seen = any(math.isinf(sd[n]) or abs(at.u[at.free[n]]) > RULES.interval * sd[n] for n in own)
        if not own or seen or not smaller.converged:
            continue
        measurement = model.causes[k].kind == "measurement"
        changed = worth.of_causes(model, rows, smaller.u, at.u, measurement)
        if max(changed, predicted_size(model, rows, smaller.u, at.u)) >= worth.material:
            continue
        if _contradicted(bench, smaller, worth):
            continue
        reason = "its interval holds zero, and the fit without it is no other by what matters"
        change = "+ " + bench.title((k,))
        if any(s.accepted and s.change == change for s in steps):
            fewer = [replace(s, accepted=False, reason=reason) if s.change == change else s for s in steps]
        else:
            ratio, needed = smaller.chi2 - at.chi2, bench.threshold(smaller) + charge(model, (k,))
            dropped = "- " + bench.title((k,))
            fewer = [*steps, Step(smaller.causes, dropped, ratio, needed, None, smaller.chi2, True, reason)]
        return _told(bench, smaller, fewer, worth)
    return at, steps


def _not_borne_out(bench: Bench, released: Sequence[Released]) -> str:
    """Say what the data contradict that conditions no fit used do not bear out: neither right nor wrong is shown."""
    said = [
        bench.model.parameters[max(values, key=lambda j: abs(values[j]) / _prior(bench.model, j))].said or given
        for r in released
        for given, values in zip(r.given, r.values, strict=True)
    ]
    return (
        f"the data contradict what was declared ({' or '.join(said)}), but other values predict conditions that they "
        "were not fitted to no better: more of them tell which"
    )


def _contradicted(bench: Bench, at: Fit, worth: Worth) -> list[Released]:
    """Return what was declared and is not so."""
    return contradicted(bench.model, bench.target, at, _size_of(bench, worth), worth.material)


def _strained(bench: Bench, at: Fit, worth: Worth) -> Strain | None:
    """Return the nuisance without a name that a fit moves beyond what is trusted of it."""
    return strained(bench.model, bench.target, at, _size_of(bench, worth), worth.material)


def _size_of(bench: Bench, worth: Worth) -> Size:
    rows = list(bench.target.observed)

    def size(before: Real, after: Real, given: str) -> float:
        if not given:
            return worth.of_nameless(bench.model, rows, before, after)
        return worth.of_causes(bench.model, rows, before, after, given in MEASURED)

    return size


def _at_limit(bench: Bench, at: Fit) -> str:
    """Return what was declared and ends on a limit of what is physical, far beyond what is trusted of it."""
    model = bench.model
    for j in map(int, model.nuisance):
        near = min(abs(at.u[j] - model.low[j]), abs(model.high[j] - at.u[j])) < 1e-6
        # What only shapes an effect is no objection to what it does (`on_bound`).
        near = near and not model.parameters[j].secondary
        if near and abs(at.u[j]) > RULES.beyond * _prior(model, j):
            return model.parameters[j].said or str(model.names[j])
    return ""


def _empty(at: Fit, found: Fit, released: Sequence[Released]) -> bool:
    """Whether a release, fitted, gains next to nothing of what it promised to first order.

    In a curved valley, as of dry and viscous friction and the period of a control, slopes promise what no step gives.
    """
    gained = at.chi2 - found.chi2
    return found.causes == at.causes and gained < RULES.delivered * min(r.ratio for r in released)


def _too_small(bench: Bench, at: Fit, found: Fit, released: Sequence[Released], worth: Worth) -> bool:
    """Whether a release, fitted, changes less than matters of what its first order promised.

    Neither its values nor all that moves with them: then the simulation is as it was declared, for what it is asked.
    A sensor that alone is at fault is not: turned by 12 degrees it shows 2 % less along its own axis, which is what
    counts, and is turned. Beside a joint sensors take up a little of what the joint's model leaves.
    """
    if found.causes != at.causes or worth.material == 0.0:
        return False
    if not at.causes and any(g in MEASURED for r in released for g in r.given):
        return False
    size = _size_of(bench, worth)
    moved = max(size(at.u, found.u, g) for r in released for g in r.given)
    own = max((c.size or 0.0 for c in _declared(bench, released, worth, found)), default=0.0)
    return max(moved, own) < worth.material


def _borne_out(bench: Bench, at: Fit, released: Sequence[Released]) -> bool:
    """Whether conditions left out bear out that what was declared is not so, all other causes being as they are.

    A fit whose model is a little off moves what it may: that fits, and predicts nothing. Values within their own
    intervals of what was declared, and those that only blocks of values test, have to be proven as a cause has; others
    to predict no worse than what was declared. Where only noise is left, or the predictions are the same, no decibels
    can show a gain that is there. Then the likelihood ratio decides, which has to be large where much can look alike
    (`Abilities.supple`), unless what was left out speaks against it.
    """
    before, as_given = as_declared(bench, at, released)
    groups = [list(r.values[0]) for r in released]
    # Only what was released is on trial: a cause that one condition shows would leave none to be left out.
    chosen = tuple(usable(bench.model, bench.target, at, (), groups))
    smaller, larger = (
        b.held_out(f, chosen) if chosen else within(b.model, b.target, f) for b, f in ((before, as_given), (bench, at))
    )
    # What has all but ended where the difference is much larger may be held against it.
    hopeless = not as_given.converged and as_given.promised >= min(r.ratio for r in released)
    if hopeless or smaller is None or larger is None:
        return True
    gain = compare(smaller, larger, bench.rng(12, len(at.causes)))
    gain = gain if chosen else replace(gain, held_out="blocks of values")
    proven, counts = bench.proves(gain), before.decided(as_given, as_given.chi2 - at.chi2)
    same = not proven and alike(as_given, at)
    if same and not bench.model.family.supple:
        return counts and not bench.bad(at)
    decided = as_given.converged and as_given.chi2 - at.chi2 > RULES.decisive and gain.db > -gain.sd
    if same:
        return decided and not (bench.bad(at) and bench.matters(at, 1.0))
    if bench.model.family.supple and decided and not chosen and not bench.bad(at):
        return True
    sd = dict(zip(at.free.tolist(), deviations(bench, at, None).tolist(), strict=True))
    beyond = any(abs(at.u[j]) > RULES.interval * sd[j] for r in released for j in r.values[0])
    return gain.db > 0.0 if beyond and chosen and counts else proven


def alike(one: Fit, other: Fit) -> bool:
    """Whether two fits predict the same, so that no condition left out could tell between them.

    Then what they differ by is how far each has to be from what was declared: of four gains and all stiffnesses, say.
    """
    return sum(float(np.sum((one.residual[r] - x) ** 2)) for r, x in other.residual.items()) < RULES.proven


def as_declared(bench: Bench, at: Fit, released: Sequence[Released]) -> tuple[Bench, Fit]:
    """Return the same data under the baseline as it was declared, and their fit with the same causes.

    It begins at the fit with what was released: one that had found another minimum would convict what was declared. So
    would this one on a dry guideway, which has many: there the better of both counts.
    """
    before = _as_given(bench, released)
    start = at.u.copy()
    start[~np.isin(np.arange(start.size), before.model.free(at.causes))] = 0.0
    found = fit(before.model, before.target, at.causes, start)
    if found.converged and bench.model.family.decisive == 0.0:
        return before, found
    other = before.extend(before.null(), at.causes)
    if found.converged and other.converged:
        return before, min(found, other, key=lambda f: f.chi2)
    return before, found if found.promised > 0.0 and found.chi2 < other.chi2 else other


def _prepared(
    family: Family,
    conditions: Sequence[Condition],
    seed: int,
    progress: Progress,
    held_out: Sequence[str],
    helpers: Helpers,
    worth: Worth,
    released: Sequence[Released] = (),
) -> tuple[Bench, dict[int, Real]]:
    """Return the conditions ready for a search, and the data that no fit may use."""
    measured = [c for c in conditions if c.observed is not None]
    missing = sorted(set(held_out) - {c.name for c in measured})
    if missing:
        raise InputError(f"{missing[0]!r} cannot be held out: it is not one of the measured conditions")
    model = Model(family, [*measured, *family.proposals], helpers, _open(family, released))
    data = {r: np.asarray(c.observed, dtype=float) for r, c in enumerate(measured)}
    for r, y in data.items():
        if y.ndim != 1 or y.size == 0 or not np.all(np.isfinite(y)):
            raise InputError(
                f"{model.conditions[r].name}: data of shape {y.shape}, or with values that are not finite; give one "
                "row of finite whitened values"
            )
    apart = {r: y for r, y in data.items() if measured[r].name in held_out}
    target = Target({r: y for r, y in data.items() if r not in apart}, model.null())
    return Bench(model, target, seed, progress, worth=worth), apart


def _open(family: Family, released: Sequence[Released]) -> set[str]:
    """Return the names of the parameters that are released: of each set those of the first id."""
    names = [p.name for p in (*family.nuisances, *(p for cause in family.causes for p in cause.parameters))]
    return {names[j] for r in released for j in r.values[0]}


def _values(bench: Bench) -> int:
    return sum(y.size for y in bench.target.observed.values())


def _finding(
    bench: Bench,
    apart: Mapping[int, Real],
    at: Fit,
    steps: Sequence[Step],
    released: Sequence[Released] = (),
    worth: Worth = EVERYTHING,
    objection: str = "",
) -> Finding:
    model, values, null = bench.model, _values(bench), bench.null()
    limit = bench.threshold(null)
    sizes = detectable(model, bench.tangent(null), limit)
    together = groups(model, cosines(model, bench.tangent(null)))
    strain, off_by = _strained(bench, at, worth), [c.size or 0.0 for c in _declared(bench, released, worth, at)]
    judged = judge(bench, at, steps, sizes, worth, bool(released), objection, strain, max(off_by, default=0.0))
    if judged.verdict in ("unknown", "insufficient_data"):
        released = ()  # what is not understood may have moved them
    before = _as_given(bench, released) if released else bench
    declared = _declared_values(bench)
    conditions, compared = by_condition(model, declared, before.null(), at, apart, _in_turn(before, bench, at))
    named = [k for k in at.causes if k not in judged.immaterial]
    understood = judged.verdict in ("consistent", "named")
    off = slightly_off(model, bench.target, at) if understood else []
    return Finding(
        verdict=judged.verdict,
        reason=judged.reason,
        causes=(*_declared(bench, released, worth, at), *(_found(bench, at, k, judged, worth) for k in named)),
        alternatives=_alternatives(bench, at, judged, worth),
        search_steps=tuple(_search_step(model, s, values) for s in steps),
        misfit_before_db=_misfit_at(bench, declared, values),
        misfit_refitted_db=_decibel(before.null().chi2, values),
        misfit_after_db=_decibel(at.chi2, values),
        gain=_whole_gain(before, bench, at) if released else judged.gain,
        held_out_gain=_held_out_gain(before, bench, at, apart),
        remainder=_remainder(bench, judged),
        detectable=sizes,
        inseparable=tuple(tuple(model.causes[k].key for k in g) for g in together),
        unconverged=tuple(sorted(bench.unconverged.items())),
        next_experiment=_separating(bench, at, released) or _next_experiment(bench, at, steps, judged),
        threshold=limit if math.isfinite(limit) else None,
        conditions=conditions,
        compared=compared,
        values=model.values(at.u),
        values_before=model.values(declared),
        values_refitted=model.values(before.null().u),
        given=_given(bench, at, released, worth),
        immaterial=(
            # One that is large and not borne out is neither wrong nor too small to matter.
            *(c for c in _declared(bench, off, worth) if c.size is not None and c.size < worth.material),
            *(_found(bench, judged.refused or at, k, judged, worth) for k in judged.immaterial),
        ),
        material=worth.material,
    )


def _as_given(bench: Bench, released: Sequence[Released]) -> Bench:
    """Return the same data under the baseline as it was declared, with what was released fixed."""
    fixed = {g for r in released for g in r.given}
    model = Model(bench.model.family, bench.model.conditions, bench.model.helpers, fixed=fixed)
    return Bench(model, bench.target, bench.seed, bench.progress)


def _declared_values(bench: Bench) -> Real:
    """Return the scaled values of the simulation as it is declared, without any cause and with nothing refitted.

    What nobody declares, and no workshop holds to (the friction of an axis that only its records know), has the values
    that fit best with all the others as declared: a simulation has no others.
    """
    model = bench.model
    own = range(len(model.family.nuisances))
    open_ = np.array([j for j in own if math.isinf(model.parameters[j].prior)], dtype=np.int64)
    if not open_.size:
        return model.null()
    found = fit(model, bench.target, (), model.null(), only=open_)
    return found.u if found.converged else model.null()


def _misfit_at(bench: Bench, u: Real, values: int) -> float | None:
    """Return the misfit of scaled values over noise [dB]; None where nothing is predicted with them."""
    found = residuals(bench.model, bench.target, u)
    return None if found is None else _decibel(sum(float(x @ x) for x in found.values()), values)


def _whole_gain(before: Bench, bench: Bench, at: Fit) -> Gain | None:
    """Return what releasing and all causes are worth on conditions left out in turn."""
    found = _in_turn(before, bench, at)
    if not found:
        return None
    return compare(*found[0], bench.rng(9, len(at.causes)))


def _declared(bench: Bench, released: Sequence[Released], worth: Worth, at: Fit | None = None) -> Iterator[FoundCause]:
    """Yield what was declared and is not so, each of a set that the data do not separate.

    `at` is the fit in which the first of each set is free: it has its values; those of the others are to first order.
    """
    model, rows = bench.model, list(bench.target.observed)
    start = bench.null().u
    fitted = {} if at is None else dict(zip(at.free.tolist(), deviations(bench, at, None).tolist(), strict=True))
    for number, r in enumerate(released, 1):
        together = number if len(r.given) > 1 else None
        for given, first_order, spread in zip(r.given, r.values, r.deviations, strict=True):
            values, sd = first_order, spread
            if at is not None and given == r.given[0] and set(first_order) <= set(fitted):
                values, sd = {j: float(at.u[j]) for j in first_order}, fitted
            parameters = []
            u = start.copy()
            for j, value in values.items():
                p, half = model.parameters[j], RULES.interval * sd[j]
                u[j] = value
                middle, low, high = ((p.start + p.scale * x) * p.shown for x in (value, value - half, value + half))
                parameters.append(Estimate(p.name, middle, low, high, p.unit))
            declared = u.copy()
            declared[list(values)] = 0.0
            kind = "measurement" if given in MEASURED else "declared"
            off = max(values, key=lambda j: abs(values[j]) / _prior(model, j))
            away = [j for j in values if j == off or abs(values[j]) > RULES.trusted * _prior(model, j)]
            title = " and ".join(dict.fromkeys(model.parameters[j].said or model.names[j] for j in away))
            size = worth.of_causes(model, rows, declared, u, kind == "measurement")
            yield FoundCause(given, "declared", title, kind, tuple(parameters), r.ratio, None, None, together, size)


def _prior(model: Model, j: int) -> float:
    """Return the scaled standard deviation with which a declared parameter was trusted."""
    p = model.parameters[j]
    return p.prior / p.scale


def _given(bench: Bench, at: Fit, released: Sequence[Released], worth: Worth) -> tuple[GivenParameter, ...]:
    """Return each declared parameter beside what the data say of it."""
    model = bench.model
    sd = deviations(bench, at, None)
    beyond = {j for r in released for values in r.values for j in values}
    rows, found = list(bench.target.observed), []
    for place, j in enumerate(at.free):
        p = model.parameters[j]
        if not p.given:
            continue
        declared = at.u.copy()
        declared[j] = 0.0
        half = RULES.interval * float(sd[place])
        # Who cuts takes no value of a sensor, and no depth depends on it.
        cost = worth.cost(model.values(declared), model.values(at.u)) if p.given not in MEASURED else None
        if cost is None and p.given not in MEASURED and abs(at.u[j]) > half:
            cost = worth.of_causes(model, rows, declared, at.u, False)
        value, half = p.start + p.scale * float(at.u[j]), p.scale * half
        value, low, high = ((value + x) * p.shown for x in (0.0, -half, half))
        trusted = p.prior * p.shown
        known = (p.name, p.said, p.given, p.start * p.shown, trusted, value, low, high, p.unit)
        found.append(GivenParameter(*known, int(j) in beyond and not p.nameless, cost))
    return tuple(found)


def _in_turn(before: Bench, bench: Bench, at: Fit) -> list[tuple[HeldOut, HeldOut]]:
    """Return what baseline and best model predict of conditions left out in turn, where any can be."""
    chosen = bench.usable(at, at.causes) if at.causes or before is not bench else ()
    return [(before.held_out(before.null(), chosen), bench.held_out(at, chosen))] if chosen else []


def _decibel(chi2: float, values: int) -> float:
    """Return a misfit over what noise gives [dB]."""
    return 10.0 * math.log10(max(chi2, 1e-300) / values)


def _search_step(model: Model, step: Step, values: int) -> SearchStep:
    db, sd = (None, None) if step.gain is None else (step.gain.db, step.gain.sd)
    misfit = _decibel(step.chi2, values)
    titles = {cause.key: cause.title for cause in model.causes}
    changed = " and ".join(titles[key] for key in step.change[2:].split(" + "))
    words = f"{'with' if step.change[0] == '+' else 'without'} {changed}"
    return SearchStep(step.change, step.ratio, step.threshold, db, sd, misfit, step.accepted, step.reason, words)


def _found(bench: Bench, at: Fit, k: int, judged: Judgement, worth: Worth) -> FoundCause:
    cause, smaller = bench.model.causes[k], bench.reduce(at, k)
    gain = bench.gain(smaller, at)
    db, sd = (None, None) if gain is None else (gain.db, gain.sd)
    values, size = estimates(bench, at, k, judged), cause_size(bench, at, k, worth)
    ratio = smaller.chi2 - at.chi2
    return FoundCause(cause.id, cause.variant, cause.title, cause.kind, values, ratio, db, sd, None, size)


def _remainder(bench: Bench, judged: Judgement) -> Remainder | None:
    """Describe what the best model leaves, where that is more than noise."""
    left = judged.misfit
    if left is None or left.p_value >= RULES.band:
        return None
    share = None if judged.gain is None else 1.0 - judged.gain.share
    names = tuple(bench.model.conditions[r].name for r in judged.carriers)
    return Remainder(10.0 * math.log10(max(left.ratio, 1e-300)), left.p_value, judged.size, share, names)


def _alternatives(bench: Bench, at: Fit, judged: Judgement, worth: Worth) -> tuple[tuple[FoundCause, ...], ...]:
    found = []
    for k, fits in judged.sets.items():
        others = [(f, next(iter(set(f.causes) - set(at.causes)))) for f in fits]
        found.append((_found(bench, at, k, judged, worth), *(_found(bench, f, o, judged, worth) for f, o in others)))
    return tuple(found)


def _held_out_gain(before: Bench, bench: Bench, at: Fit, data: Mapping[int, Real]) -> Gain | None:
    """Return the gain on the conditions that no fit has seen."""
    if not data or not (at.causes or before is not bench):
        return None
    first, last = (unseen(b.model, b.target, f, data) for b, f in ((before, before.null()), (bench, at)))
    if not (first.squares and last.squares):
        return None
    return compare(first, last, bench.rng(5, parameters_of(bench.model, at.causes)))


def _unproven(bench: Bench, steps: Sequence[Step]) -> list[Fit]:
    """Return the best hypotheses that were refused for want of a condition that tests them; one alone with the null.

    What the data exclude beside the best needs no experiment, nor does what ends on the limit of what is physical
    beside what does not.
    """
    refused = {s.causes: bench.fits[s.causes] for s in steps if not s.accepted}
    bound = {causes for causes, f in refused.items() if on_bound(bench.model, f, causes)}
    kept: list[Fit] = []
    for f in sorted(refused.values(), key=lambda f: (f.causes in bound, f.chi2 + charge(bench.model, f.causes))):
        # More of the same is not another hypothesis, nor is another law of it.
        known = {bench.model.causes[k].id for g in kept for k in g.causes}
        if not f.converged or known & {bench.model.causes[k].id for k in f.causes}:
            continue
        if kept and (f.causes in bound or excluded(bench, kept[0], f, bench.misfit(kept[0]))):
            continue
        kept.append(f)
    return kept[: RULES.contenders] if len(kept) > 1 else [*kept, bench.null()]


def _separating(bench: Bench, at: Fit, released: Sequence[Released]) -> Proposal | None:
    """Return the proposal that tells which of a set of declared values is wrong; None where none does, or none is open.

    Each is released in the place of the first, and the data are fitted once more.
    """
    model = bench.model
    rows = [r for r, c in enumerate(model.conditions) if c.observed is None]
    for chosen in (r for r in released if len(r.given) > 1):
        others = _open(model.family, [r for r in released if r is not chosen])
        models, fits, titles = [], [], []
        for values in chosen.values[: RULES.contenders]:
            start = at.u.copy()
            start[list(chosen.values[0])] = 0.0
            start[list(values)] = list(values.values())
            one = Model(model.family, model.conditions, model.helpers, {*(model.names[j] for j in values), *others})
            found = fit(one, bench.target, at.causes, np.clip(start, one.low, one.high))
            if found.converged:
                models.append(one)
                fits.append(found)
                worst = max(values, key=lambda j: abs(values[j]) / _prior(model, j))
                titles.append(model.parameters[worst].said or model.names[worst])
        if len(fits) > 1:
            open_ = sorted({j for values in chosen.values for j in values})
            ranked = rank(model, bench.target, fits, rows, " and ".join(titles), models, open_)
            if ranked and ranked[0].probability > 0.5:
                return ranked[0]
    return None


def _next_experiment(bench: Bench, at: Fit, steps: Sequence[Step], judged: Judgement) -> Proposal | None:
    """Return the proposal that best separates the first open set, or reveals what could be hidden."""
    model = bench.model
    rows = [r for r, c in enumerate(model.conditions) if c.observed is None]
    if judged.verdict in ("consistent", "named"):
        return revealing(model, bench.target, bench.tangent(at), bench.threshold(at), rows)
    if judged.verdict == "insufficient_data":
        ranked = rank(model, bench.target, _unproven(bench, steps), rows, "what was refused") if steps else []
        return ranked[0] if ranked else None
    if not judged.sets:
        return None
    # The best and the next of what fits as well: pairs of six, each fitted to five proposals, took as long as all else.
    k, fits = next(iter(judged.sets.items()))
    fits = fits[: RULES.contenders - 1]
    titles = [model.causes[j].title for j in (k, *(j for f in fits for j in set(f.causes) - set(at.causes)))]
    ranked = rank(model, bench.target, [at, *fits], rows, " and ".join(titles))
    return ranked[0] if ranked and ranked[0].probability > 0.5 else None


# --- Intervals of the fitted parameters: from noise, from what the best model leaves, and from errors of predictions.


def estimates(bench: Bench, at: Fit, k: int, judged: Judgement) -> tuple[Estimate, ...]:
    """Return parameters of a cause with 95 % intervals, infinite where the data do not separate it from others."""
    model = bench.model
    sd = deviations(bench, at, judged.misfit)
    found = []
    for j in model.of_cause[k]:
        place, p = int(np.flatnonzero(at.free == j)[0]), model.parameters[j]
        value, half = p.start + p.scale * float(at.u[j]), RULES.interval * p.scale * float(sd[place])
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
    slope, misses = stacked(bench.model, bench.target, at.free, at.u, at.residual, at.slope)
    size = np.linalg.norm(slope, axis=0)
    moving = inside(bench.model, at) & (size > 0.0)
    rotated, singular, right = decomposed((slope / np.where(size > 0.0, size, 1.0))[:, moving])
    known = singular > RULES.determined * singular.max(initial=0.0)
    inverse = (right[known].T / singular[known]) @ rotated[:, known].T / size[moving, None]
    sd = np.where(size > 0.0, 0.0, np.inf)
    covariances = covariances_of_noise(bench.model, at.residual, inverse.T)
    sd[moving] = np.sqrt(np.mean([np.diag(c) for c in covariances], axis=0))
    if left is not None and left.p_value < RULES.band:
        ends = np.cumsum([r.size for r in at.residual.values()])
        data, prior = inverse[:, : ends[-1]], inverse[:, ends[-1] :]
        pulls = [a @ r for a, r in zip(np.split(data, ends[:-1], axis=1), at.residual.values(), strict=True)]
        scatter = np.sum(np.square(pulls), axis=0) * len(pulls) / max(len(pulls) - 1, 1)
        robust = np.sqrt(scatter + np.sum(np.square(prior), axis=1))
        sd[moving] = np.maximum(sd[moving] * math.sqrt(max(left.ratio, 1.0)), robust)
        sd[moving] = np.hypot(sd[moving], inverse @ _omitted(bench, at))
    # A fit that has not quite ended is off by the step that it has not taken.
    sd[moving] = np.hypot(sd[moving], inverse @ misses)
    sd[moving] = np.hypot(sd[moving], _off(bench.model, at, moving))
    # Parameters that are seen only together have no interval each: their variance would come out as zero.
    sd[moving] = np.where(1.0 - np.sum(np.square(right[known]), axis=0) > RULES.shared**2, np.inf, sd[moving])
    # One on its bound moves away from it alone: what the others cannot imitate of it says how far.
    over = max(left.ratio, 1.0) if left is not None and left.p_value < RULES.band else 1.0
    for j in np.flatnonzero(~moving & (size > 0.0)):
        unit = slope[:, j] / size[j]
        own = float(np.linalg.norm(unit - rotated[:, known] @ (rotated[:, known].T @ unit)))
        sd[j] = math.sqrt(over) / (size[j] * own) if own > RULES.shared else np.inf
    return sd


def _omitted(bench: Bench, at: Fit) -> Real:
    """Return what the further cause that explains most of what a fit leaves does to the data, shape (N,).

    The fitted parameters have taken what they can imitate of it; nothing where noise explains as much.
    """
    here = bench.tangent(at)
    gains = {n: combined_gain(bench.model, here, (s,)) for n, s in enumerate(here.acting)}
    best = max(gains, key=lambda n: gains[n], default=None)
    if best is None or gains[best] <= bench.threshold(at) + charge(bench.model, (here.acting[best].cause,)):
        return np.zeros(here.residual.size)
    s = here.acting[best]
    own = np.isin(bench.model.of_cause[s.cause], s.free)
    step = np.linalg.lstsq(s.columns, -here.residual, rcond=RULES.determined)[0]
    effect = np.concatenate([x[:, own] @ step for x in s.slope.values()])
    return np.concatenate([effect, np.zeros(here.residual.size - effect.size)])


def _off(model: Model, at: Fit, moving: NDArray[np.bool_]) -> Real:
    """Return the standard deviations that errors of the predictions add to some scaled fitted parameters."""
    family, count = model.family, int(moving.sum())
    if family.model_error == 0.0 or count == 0:
        return np.zeros(count)
    rows = list(at.slope)
    predicted = {r: y for r in rows if (y := model.predict(r, at.u)) is not None}
    each = [family.relative(model.conditions[r], y, at.slope[r][:, moving]) for r, y in predicted.items()]
    labels = family.alike([model.conditions[r] for r in rows])
    shared = {k: np.mean([x for x, label in zip(each, labels, strict=True) if label == k], axis=0) for k in set(labels)}
    slope, wrong = (_real(x) for x in (each, [shared[k] for k in labels]))
    # Errors of this size, all in what the parameters can imitate. Priors hold what the data hardly know, as in a fit.
    off = family.model_error * math.sqrt(len(slope) / 2.0 / count)
    slope = np.concatenate([slope, off * np.diag(model.weight[at.free][moving])])
    size = np.linalg.norm(slope, axis=0)
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv(slope / size, rcond=RULES.determined) / size[:, None]
    return np.asarray(off * np.sqrt(np.sum(np.square(inverse @ inverse.T @ wrong.T), axis=1)))


def _real(each: Sequence[Complex]) -> Real:
    """Complex rows of several conditions as real ones: real parts, then imaginary ones."""
    whole = np.concatenate(list(each))
    return np.concatenate([whole.real, whole.imag])
