"""What a finding means in the workshop: stable depths and force errors, with the baseline and with what repairs it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from process.cut.engagement import engagement
from process.units import implausible
from smfe.campaign import Campaign
from smfe.diagnosis.cutting.limits import CuttingLimits, Limit
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.inference.finding import BaselineParameter, Finding, ForceError, StableDepth
from smfe.diagnosis.inference.problem import Condition, Family, Values
from stability import zero_order

SPEEDS = 41
"""Spindle speeds of a request at which the depth is computed, at most."""

_STEP, _LOWEST, _REACH = 0.5, 2.0, 4.0  # Hz, Hz, times the locked frequency


def with_consequences(campaign: Campaign, family: Family, finding: Finding, held_out: Sequence[str]) -> Finding:
    """Return a finding with what became of the baseline, and stable depths or force errors where it is repaired."""
    finding = _plausible(replace(finding, baseline=tuple(_baseline(family, finding))))
    if not finding.causes:
        return finding
    if isinstance(family, DriveRecordFamily):
        return replace(finding, force_error=tuple(_force_errors(family, finding, held_out)))
    if isinstance(family, MachineFrfs) and isinstance(family.baseline, AxisBaseline):
        return replace(finding, stable_depth=stable_depths(campaign, family.baseline, finding.values))
    if isinstance(family, CuttingLimits):
        return replace(finding, stable_depth=tuple(_limits(campaign, family, finding)))
    return finding


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
    for number, request in enumerate(campaign.lobes, 1):
        pick = np.unique(np.linspace(0, request.spindle_speed.size - 1, SPEEDS).round().astype(int))
        speeds = request.spindle_speed[pick].tolist()
        yield f"lobes_{number}", request.cut, request.width_of_cut, request.feed_per_tooth, speeds
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
