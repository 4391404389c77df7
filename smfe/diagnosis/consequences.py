"""What a finding means in the workshop: errors, stable depths and force errors before and after, and its sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import xarray as xr

from process.errors import InputError
from process.units import implausible
from smfe.campaign import Campaign, CuttingTest
from smfe.diagnosis.cases.known import known_of, known_values, reaching
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.cutting.limits import CuttingLimits
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.inference.problem import Condition, Family
from smfe.diagnosis.judgement.finding import (
    BaselineParameter,
    Finding,
    ForceError,
    ForetoldCut,
    GivenParameter,
    StableDepth,
)
from smfe.diagnosis.judgement.materiality import Worth, no_cut
from smfe.diagnosis.judgement.next_experiment import Proposal
from smfe.diagnosis.judgement.verdict import Verdict
from smfe.diagnosis.story.blocks import block_of, repeated
from smfe.diagnosis.story.causes import Friction
from smfe.diagnosis.story.curves import with_curves
from smfe.diagnosis.story.experiments import instruction
from smfe.diagnosis.story.facts import facts_of
from smfe.diagnosis.story.millimetres import (
    FEW_SPEEDS,
    Depths,
    cost_of,
    depths_of,
    given_values,
    largest_change,
    pockets,
    stable_depths,
    stands_of,
)
from smfe.diagnosis.story.sentences import Setting, told
from smfe.diagnosis.story.to_do import action
from smfe.limits.cutting_tests import judge

_EXPECTED: Mapping[Verdict, str] = {
    "consistent": "the simulation predicts it, so that it is one more test of it",
    "named": "the extended model predicts it, so that it is a test of the whole",
    "ambiguous": "it separates them best of all that is known here, but hardly alone",
    "unknown": "it shows whether what is left depends on what is changed there",
    "insufficient_data": "it adds what is missing: a further condition that a fit can be held against",
}
"""What an experiment is for where the search itself has none to propose."""


def worth_of(campaign: Campaign, family: Family) -> Worth:
    """Return what is large enough to matter: in limit depth where the campaign asks for one that the family predicts.

    Of drive and cutting forces a depth is one thing among others: run-out changes none, and matters.
    """
    has_depth = isinstance(family, MachineFrfs | ModalFrfs | CuttingLimits)
    if not has_depth:
        return Worth(campaign.tolerances.material)
    shown = cost_of(campaign, family, as_shown=True) if isinstance(family, ModalFrfs) else no_cut
    return Worth(campaign.tolerances.material, cost_of(campaign, family), shown)


def with_consequences(
    campaign: Campaign,
    family: Family,
    finding: Finding,
    held_out: Sequence[str],
    happened: Mapping[str, str] | None = None,
    compliances: Mapping[str, xr.Dataset] | None = None,
    faults: Sequence[Suspect] = (),
) -> Finding:
    """Return a finding as it is told: what became of the baseline, errors and curves, depths, sentences.

    `happened` says of each cutting test, by the name of its file, whether it was "stable" or "chatter"; without it they
    are judged here. `compliances` are those of measurements that lobes are asked of, `faults` those of the data.
    """
    known = known_of(campaign)
    before = {**given_values(family), **known_values(reaching(family, campaign), known)} if known else None
    finding = _plausible(replace(finding, baseline=tuple(_baseline(family, finding))))
    finding = with_curves(family, finding)
    depths, why = depths_of(campaign, family, compliances)
    if depths is not None and finding.given:
        finding = replace(finding, given=tuple(_costs(campaign, family, finding, depths)))
    if finding.causes:
        if isinstance(family, DriveRecordFamily):
            finding = replace(finding, force_error=tuple(_force_errors(family, finding, held_out)))
        rows = (
            () if depths is None else stable_depths(campaign, depths, finding.values, before, stands=stands_of(family))
        )
        tested = tuple(_tested(campaign, rows, happened)) if rows else ()
        best = pockets(campaign, rows)
        finding = replace(finding, stable_depth=rows, no_depth=why, tested_depth=tested, pockets=best)
    finding = replace(finding, next_experiment=_next(campaign, family, finding))
    facts = facts_of(family, finding.values)
    finding = replace(finding, to_do=tuple(action(c, facts) for c in finding.causes))
    return replace(finding, passages=told(finding, Setting(_friction(family, finding), faults)))


def _next(campaign: Campaign, family: Family, finding: Finding) -> Proposal | None:
    """Return the next experiment, whatever the verdict, with what to do and what to append to the campaign file.

    Where the search has none: a measurement that carries what is not explained, made once more, tells whether it
    repeats; else the first thing that can be done and was not.
    """
    found, carriers = finding.next_experiment, () if finding.remainder is None else finding.remainder.carriers
    if found is None and (carriers or not family.proposals):
        name = _made_of(campaign, family, [*carriers, *(c.name for c in family.conditions)])
        block = repeated(campaign, name)
        if not block:
            return None
        expected = "whether what is left is there again tells the machine from noise and drift"
        do = f"Make {name.replace('_', ' ')} once more, at the end of the session"
        return Proposal(name, math.nan, math.nan, expected, None, do=do, block=block)
    if found is None:
        first = family.proposals[0]
        said = first.settings.get("minutes")
        minutes = None if said is None else float(said)
        found = Proposal(first.name, math.nan, math.nan, _EXPECTED[finding.verdict], minutes)
    proposed = [c for c in family.proposals if c.name == found.name]
    if not proposed:
        return found
    block = block_of(campaign, family, proposed[0], finding.values or given_values(family))
    return replace(found, do=instruction(family, proposed[0]), block=block)


def _made_of(campaign: Campaign, family: Family, conditions: Sequence[str]) -> str:
    """Return the measurement, or the file of the cutting test, that the first of some conditions belongs to."""
    names = [*(m.name for m in campaign.measurements), *(t.file.name for t in campaign.cutting_tests)]
    for condition in conditions:
        for name in sorted(names, key=len, reverse=True):
            if name in condition:
                return name
    return names[-1] if names else ""


def _costs(campaign: Campaign, family: Family, finding: Finding, depths: Depths) -> Iterator[GivenParameter]:
    """Say of each declared parameter what its difference is worth in depth, the others as they were found."""
    shown = {p.name: p for p in family.nuisances}
    for g in finding.given:
        p = shown.get(g.name)
        if g.cost_mm is None and p is not None and g.found != g.given and math.isfinite(g.found):
            try:
                as_given = {**finding.values, g.name: p.start}
                rows = stable_depths(campaign, depths, finding.values, as_given, FEW_SPEEDS, stands_of(family))
            except InputError:  # no machine has these values
                yield g
                continue
            if (change := largest_change(rows)) is not None:
                g = replace(g, cost=change[0] if g.cost is None else g.cost, cost_mm=change[1])
        yield g


def _friction(family: Family, finding: Finding) -> Friction | None:
    """Return what brakes the axis of a baseline by the extended model, at rest and at its fastest feed."""
    if not (isinstance(family, MachineFrfs) and finding.values):
        return None
    baseline = family.baseline
    feeds = [abs(float(c.settings.get("feed", 0.0))) for c in family.conditions]
    fastest = max(feeds, default=0.0)
    # A declared force that is another one is named as friction, too.
    known = {p.name: p for p in (*family.nuisances, *(p for c in family.causes for p in c.parameters))}
    found = [(known[e.name], e) for c in finding.causes if c.id == "guideway_friction" for e in c.parameters]
    low, high = (
        {p.name: min(max(x / p.shown, p.low), p.high) for p, x in ((p, getattr(e, end)) for p, e in found)}
        for end in ("low", "high")
    )
    ends = [baseline.effective({**finding.values, **at}, {}, fastest).friction[0] for at in ({}, low, high)]
    rest, moving = ([side.force(speed) for side in ends] for speed in (0.0, fastest))
    return Friction(baseline.axis, rest[0], 6e4 * fastest, moving[0], (rest[1], rest[2]), (moving[1], moving[2]))


def _tested(
    campaign: Campaign, depths: Sequence[StableDepth], happened: Mapping[str, str] | None
) -> Iterator[ForetoldCut]:
    """Yield the cutting tests that are decided, with the stable depths of both models."""
    rows = {row.where: row for row in depths}
    for test in campaign.cutting_tests:
        row = rows.get(test.file.name)
        if row is None:
            continue
        verdict = test.observed or (_judged(campaign, test) if happened is None else happened.get(test.file.name, ""))
        if verdict in ("stable", "chatter"):
            depth = 1e3 * test.depth_of_cut
            yield ForetoldCut(test.file.name, test.spindle_speed, depth, verdict, row.before_mm, row.after_mm)


def _judged(campaign: Campaign, test: CuttingTest) -> str:
    try:
        return judge(campaign, test).verdict
    except InputError:
        return ""


def _plausible(finding: Finding) -> Finding:
    """Return a finding whose fitted parameters are possible: with one that is not, the data are not consistent.

    A parameter that is free to follow the data can make any model fit them: forces of turning, declared as those of
    milling, are "explained" by coefficients of 5 N/mm^2.
    """
    wrong = implausible(finding.values)
    if not wrong:
        return finding
    said = "; ".join(wrong)
    if finding.verdict != "consistent":
        return replace(finding, reason=f"{finding.reason}. Of the fitted parameters, {said}")
    reason = f"it fits only with parameters that are not possible: {said}. Check cut, channels, units, signs"
    return replace(finding, verdict="unknown", reason=reason)


def _baseline(family: Family, finding: Finding) -> Iterator[BaselineParameter]:
    """The baseline's parameters that something outside of these records says; the others are found from them."""
    for p in family.nuisances:
        if math.isfinite(p.prior) and p.name in finding.values:
            fitted = finding.values[p.name]
            yield BaselineParameter(p.name, p.start * p.shown, fitted * p.shown, p.prior * p.shown, p.unit)


def _force_errors(family: DriveRecordFamily, finding: Finding, held_out: Sequence[str]) -> Iterator[ForceError]:
    for apart in (False, True):
        part: list[Condition] = [c for c in family.conditions if (c.name in held_out) == apart]
        if part:
            models = (finding.values_before, finding.values, finding.values_refitted)
            errors = (family.force_error(v, part) for v in models)
            yield ForceError(apart, *errors)
