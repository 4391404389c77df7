"""What a finding means in the workshop: errors, stable depths and force errors before and after, and its sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from process.cut.engagement import engagement
from process.errors import InputError
from process.labels import make_compliance
from process.units import implausible
from smfe.campaign import Campaign, CuttingTest
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits, Limit
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.inference.finding import BaselineParameter, Finding, ForceError, ForetoldCut, StableDepth
from smfe.diagnosis.inference.problem import Condition, Family, Values
from smfe.diagnosis.story.causes import Friction
from smfe.diagnosis.story.curves import with_curves
from smfe.diagnosis.story.experiments import instruction
from smfe.diagnosis.story.sentences import Setting, told
from smfe.limits.cutting_tests import judge
from stability import zero_order

SPEEDS = 41
"""Spindle speeds of a request at which the depth is computed, at most."""

_STEP, _LOWEST, _REACH = 0.5, 2.0, 4.0  # Hz, Hz, times the locked frequency


def with_consequences(
    campaign: Campaign,
    family: Family,
    finding: Finding,
    held_out: Sequence[str],
    happened: Mapping[str, str] | None = None,
) -> Finding:
    """Return a finding as it is told: what became of the baseline, errors and curves, depths, sentences.

    `happened` says of each cutting test, by the name of its file, whether it was "stable" or "chatter"; without it they
    are judged here.
    """
    finding = _plausible(replace(finding, baseline=tuple(_baseline(family, finding))))
    finding = with_curves(family, finding)
    if finding.causes:
        if isinstance(family, DriveRecordFamily):
            finding = replace(finding, force_error=tuple(_force_errors(family, finding, held_out)))
        depths, why = _stable_depths(campaign, family, finding)
        tested = tuple(_tested(campaign, depths, happened)) if depths else ()
        finding = replace(finding, stable_depth=depths, no_depth=why, tested_depth=tested)
    if finding.next_experiment is not None:
        proposed = [c for c in family.proposals if c.name == finding.next_experiment.name]
        if proposed:
            do = instruction(family, proposed[0])
            finding = replace(finding, next_experiment=replace(finding.next_experiment, do=do))
    return replace(finding, passages=told(finding, Setting(_friction(family, finding))))


def _friction(family: Family, finding: Finding) -> Friction | None:
    """Return what brakes the axis of a baseline by the extended model, at rest and at its fastest feed."""
    if not (isinstance(family, MachineFrfs) and finding.values):
        return None
    baseline = family.baseline
    feeds = [abs(float(c.settings.get("feed", 0.0))) for c in family.conditions]
    fastest = max(feeds, default=0.0)
    side = baseline.effective(finding.values, {}, fastest).friction[0]
    return Friction(baseline.axis, side.force(0.0), 6e4 * fastest, side.force(fastest))


def _stable_depths(campaign: Campaign, family: Family, finding: Finding) -> tuple[tuple[StableDepth, ...], str]:
    """Return the stable depths before and after, or why none is given."""
    if isinstance(family, DriveRecordFamily | CuttingForces):
        what = "drive force" if isinstance(family, DriveRecordFamily) else "cutting force"
        return (), f"No depth in millimetres: the {what} alone says nothing of how far the tool gives way."
    lost = [
        name
        for name, there in (
            ("[tool]", campaign.tool is not None),
            ("[material]", campaign.coefficients is not None),
            ("[[lobes]] or cutting tests with their feed", any(True for _ in _asked(campaign))),
        )
        if not there
    ]
    if lost:
        return (), f"No depth in millimetres: the campaign has no {', no '.join(lost)}."
    if isinstance(family, MachineFrfs):
        return stable_depths(campaign, family.baseline, finding.values), ""
    if isinstance(family, CuttingLimits):
        return tuple(_limits(campaign, family, finding)), ""
    if isinstance(family, ModalFrfs):
        return tuple(_of_modes(campaign, family, finding.values)), ""
    return (), ""


def _of_modes(campaign: Campaign, family: ModalFrfs, values: Values) -> Iterator[StableDepth]:
    """Limit depths of modes as the campaign gives them, and as the extended model has them, by the zero-order method.

    The tool carries no sensor; the spindle turns as it does in the cut.
    """
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    given = {p.name: p.start for p in (*family.nuisances, *(p for c in family.causes for p in c.parameters))}
    f = family.fine_frequency()
    for where, cut, width, feed_per_tooth, speeds in _asked(campaign):
        arc = engagement(cut, width, campaign.tool.diameter)
        for rpm in speeds:
            depths = []
            for v in (given, values):
                phi = make_compliance(f, family.in_the_cut(v, rpm, f))
                found = zero_order(phi, campaign.tool, arc, campaign.coefficients, [rpm])
                depths.append(float(found["limit_depth"].values[0]))
            yield StableDepth(where, rpm, feed_per_tooth * campaign.tool.teeth * rpm * 1e3, *depths)


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


def _limits(campaign: Campaign, family: CuttingLimits, finding: Finding) -> Iterator[StableDepth]:
    """Limit depths of what a campaign asks for, by the zero-order method, before and after."""
    assert campaign.tool is not None
    for where, cut, width, feed_per_tooth, speeds in _asked(campaign):
        arc = engagement(cut, width, campaign.tool.diameter)
        for rpm in speeds:
            limit = Limit(rpm, feed_per_tooth=feed_per_tooth, arc=arc)
            depths = (family.limits_at(limit, v)[0] for v in ({}, finding.values))
            before, after = (1e3 * float(d[0]) if d.size else math.inf for d in depths)
            yield StableDepth(where, rpm, feed_per_tooth * campaign.tool.teeth * rpm * 1e3, before, after)


def _force_errors(family: DriveRecordFamily, finding: Finding, held_out: Sequence[str]) -> Iterator[ForceError]:
    for apart in (False, True):
        part: list[Condition] = [c for c in family.conditions if (c.name in held_out) == apart]
        if part:
            errors = (family.force_error(v, part) for v in (finding.values_before, finding.values))
            yield ForceError(apart, *errors)


def stable_depths(campaign: Campaign, baseline: AxisBaseline, values: Values) -> tuple[StableDepth, ...]:
    """Return the zero-order limit depths at the speeds of the lobes and cutting tests that a campaign asks for.

    The machine is linearised for small vibration about the feed of the cut, ``feed_per_tooth teeth n``; directions
    other than the axis are rigid. `values` are those of the extended model (SI). Without tool, work material, lobes and
    cutting tests nothing is returned.
    """
    given: Mapping[str, float] = {
        p.name: p.start for p in (*baseline.nuisances(), *(p for c in baseline.causes() for p in c.parameters))
    }
    if campaign.tool is None or campaign.coefficients is None:
        return ()
    out = []
    for where, cut, width, feed_per_tooth, speeds in _asked(campaign):
        for rpm in speeds:
            feed = feed_per_tooth * campaign.tool.teeth * rpm / 60.0
            depths = [_limit(campaign, baseline, v, cut, width, feed, rpm) for v in (given, values)]
            out.append(StableDepth(where, rpm, feed * 6e4, *depths))
    return tuple(out)


def _asked(campaign: Campaign) -> Iterator[tuple[str, str, float, float, Sequence[float]]]:
    """Yield what it is for, kind and width of cut, feed per tooth, and speeds [rpm]."""
    for request in campaign.lobes:
        pick = np.unique(np.linspace(0, request.spindle_speed.size - 1, SPEEDS).round().astype(int))
        speeds = request.spindle_speed[pick].tolist()
        yield request.name, request.cut, request.width_of_cut, request.feed_per_tooth, speeds
    for test in (t for t in campaign.cutting_tests if t.feed_per_tooth is not None):
        yield test.file.name, test.cut, test.width_of_cut, test.stated_feed_per_tooth, [test.spindle_speed]


def _limit(
    campaign: Campaign, baseline: AxisBaseline, values: Values, cut: str, width: float, feed: float, rpm: float
) -> float:
    """Limit depth [mm]; infinite without a limit, zero where the axis vibrates without any cut."""
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    axis, high = baseline.axis, _REACH * baseline.drive.locked_frequency
    machine = baseline.machine(baseline.effective(values, {}, feed))
    point = machine.at({axis: feed}, _controller(campaign, baseline))
    if point.unstable_poles() > 0:
        return 0.0
    phi = point.compliance(np.arange(_LOWEST, high, _STEP), [axis], [axis])
    arc = engagement(cut, width, campaign.tool.diameter)
    return float(zero_order(phi, campaign.tool, arc, campaign.coefficients, [rpm])["limit_depth"].values[0])


def _controller(campaign: Campaign, baseline: AxisBaseline) -> str:
    """Return the controller of the first measurement that has one of the baseline's."""
    named = [m.controller for m in campaign.measurements if m.controller in baseline.servos]
    return named[0] if named and named[0] is not None else next(iter(baseline.servos))
