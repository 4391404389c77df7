"""From a campaign to the diagnosis of stability limits: its cutting tests as brackets of the limit depth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from process.cut.engagement import engagement
from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, LimitsOf
from smfe.diagnosis.campaign_case import Case
from smfe.diagnosis.campaign_modes import modes_named
from smfe.diagnosis.cutting_limits import Limit, Spread, Trial, bracketed, limit_family
from smfe.diagnosis.suspect import Suspect
from smfe.identification.errors.result import Identification, Progress, silent
from smfe.limits.cut_conditions import FIXED, Source, stated
from smfe.limits.cutting_tests import judge

Cut = tuple[str, float, float]
"""Kind of cut, width [m], feed per tooth [m]: what the tests of one limit have in common besides the speed."""


def limit_case(
    campaign: Campaign, baseline: LimitsOf, found: Mapping[str, Identification], progress: Progress = silent
) -> Case:
    """Return the case of the limits that cutting tests bracket, against those of a modal model.

    A test is stable or not as the campaign says (``observed``), else as the spectral criterion judges its record; the
    chatter frequency is that of the record. One that stays undecided bounds nothing.

    Raises
    ------
    InputError
        When the source has no modes, a record cannot be judged, or no limit is bracketed.
    """
    modes, tool, material = modes_named(campaign, baseline.source, found), campaign.tool, campaign.coefficients
    if tool is None or material is None:
        raise InputError("a limit depth needs the tables [tool] and [material]; add them")
    belonging, suspects = _of_source(campaign, baseline)
    trials = _trials(campaign, belonging, progress)
    limits: list[Limit] = []
    groups: dict[str, tuple[str, ...]] = {}
    suspects = [*modes.suspects, *suspects]
    for (cut, width, feed), tests in trials.items():
        bounds, notes = bracketed([trial for _, trial in tests], feed)
        arc = engagement(cut, width, tool.diameter)
        where = f"{cut}, {width * 1e3:.4g} mm wide, {feed * 1e3:.4g} mm per tooth"
        named = [replace(x, arc=arc, name=f"limit at {x.spindle_speed:.6g} rpm, {where}") for x in bounds]
        limits += named
        suspects += [
            Suspect("unusable", "note", f"cutting tests {where}", note, "add a cut on the other side") for note in notes
        ]
        for test, trial in tests:
            used = tuple(x.name for x in named if x.spindle_speed == trial.spindle_speed)
            if used:
                groups[test.file.name] = (*groups.get(test.file.name, ()), *used)
    if not limits:
        told = "; ".join(s.evidence for s in suspects) or "every cutting test stays undecided"
        raise InputError(f"no limit is bracketed between a stable and a chattering cut: {told}")
    arcs = [x.arc for x in limits if x.arc is not None]
    family = limit_family(limits, modes.modal, tool, arcs[0], material, spread=_spread(campaign, baseline))
    held_out = tuple(dict.fromkeys(t.file.name for t in campaign.cutting_tests if t.held_out and t.file.name in groups))
    return Case(family, groups, held_out, tuple(suspects))


def _spread(campaign: Campaign, baseline: LimitsOf) -> Spread:
    """How well the modes are known: as the campaign says of a model, else the default."""
    usual = Spread()
    for model in campaign.models:
        if model.name == baseline.source:
            given = model.spread
            return Spread(
                given.frequency or usual.frequency, given.damping or usual.damping, given.stiffness or usual.stiffness
            )
    return usual


def _of_source(campaign: Campaign, baseline: LimitsOf) -> tuple[list[CuttingTest], list[Suspect]]:
    """Return the cutting tests of the machine whose modes are questioned: one controller, one position."""
    measured = next((m for m in campaign.measurements if m.name == baseline.source), None)
    fixed = (None, None) if measured is None else tuple(stated(measured, key) for key in FIXED)
    source = Source((baseline.source,), baseline.source, *fixed)
    kept = [test for test in campaign.cutting_tests if not source.differs(test)]
    for key in FIXED:
        values = sorted({v for test in kept if (v := getattr(test, key)) is not None})
        if len(values) > 1:
            raise InputError(
                f"the cutting tests were made with the {key} {' and '.join(values)}, whose limits are not those of one "
                f"machine; diagnose each in a campaign of its own, or from a measurement that states its {key}"
            )
    notes = [
        Suspect("unusable", "note", f"cutting test, {test.file.name}", source.differs(test), "it bounds no limit here")
        for test in campaign.cutting_tests
        if source.differs(test)
    ]
    return kept, notes


def _trials(
    campaign: Campaign, tests: Sequence[CuttingTest], progress: Progress
) -> Mapping[Cut, Sequence[tuple[CuttingTest, Trial]]]:
    found: dict[Cut, list[tuple[CuttingTest, Trial]]] = {}
    for done, test in enumerate(tests):
        progress(f"judging {test.file.name}", done, len(tests))
        judged = judge(campaign, test)
        verdict = test.observed or judged.verdict
        if verdict in ("stable", "chatter"):
            heard = judged.chatter_frequency_Hz if verdict == judged.verdict == "chatter" else math.nan
            frequency = heard if math.isfinite(heard) else None
            trial = Trial(test.spindle_speed, test.depth_of_cut, verdict == "chatter", frequency)
            found.setdefault((test.cut, test.width_of_cut, test.stated_feed_per_tooth), []).append((test, trial))
    return found
