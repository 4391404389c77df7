"""From a campaign to the diagnosis of cutting forces: its cutting tests as a family."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from process.cut.engagement import engagement
from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, LimitsOf
from smfe.diagnosis.cases.case import Case, modes_named
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.cutting.forces import CuttingForces, cutting_family
from smfe.diagnosis.cutting.limits import Limit, Spread, Trial, bracketed, limit_family
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.identification.errors.result import Identification
from smfe.limits.cut_conditions import FIXED, Source, stated
from smfe.limits.cutting_tests import judge
from smfe.progress import Progress, silent
from smfe.records import read_records

MINUTES = 3.0
"""What a further cut takes."""


def cutting_case(campaign: Campaign) -> Case:
    """Return the case of the cutting tests of a campaign: the forces of ``[tool]`` and ``[material]`` against theirs.

    Raises
    ------
    InputError
        When a record lacks a force or is too short.
    """
    tool, material = campaign.tool, campaign.coefficients
    if tool is None or material is None:
        raise InputError("a mechanistic force needs the tables [tool] and [material]; add them")
    cuts = [_setting(test, tool.diameter) for test in campaign.cutting_tests]
    names = _names(campaign.cutting_tests, cuts)
    records = [read_records(test.file, test.channels)[0] for test in campaign.cutting_tests]
    family = cutting_family(
        dict(zip(names, zip(records, cuts, strict=True), strict=True)),
        tool,
        (material.Ktc, material.Krc, material.Kac),
        {_words(cut): cut for cut in _further(cuts)},
        edge=(material.Kte, material.Kre, material.Kae),
    )
    groups: dict[str, tuple[str, ...]] = {}
    for test, name in zip(campaign.cutting_tests, names, strict=True):
        groups[test.file.name] = (*groups.get(test.file.name, ()), name)
    held_out = tuple(dict.fromkeys(test.file.name for test in campaign.cutting_tests if test.held_out))
    return Case(_priced(family), groups, held_out, family.suspects)


def _setting(test: CuttingTest, diameter: float) -> SteadyCut:
    arc = engagement(test.cut, test.width_of_cut, diameter)
    return SteadyCut(test.spindle_speed * math.pi / 30.0, test.stated_feed_per_tooth, test.depth_of_cut, arc)


def _words(cut: SteadyCut) -> str:
    speed = f"{cut.rotation * 30.0 / math.pi:.6g} rpm"
    if cut.depth == 0.0:
        return f"spindle in air at {speed}"
    return f"cut at {speed}, {cut.feed_per_tooth * 1e3:.4g} mm per tooth, {cut.depth * 1e3:.4g} mm deep"


def _names(tests: Sequence[CuttingTest], cuts: Sequence[SteadyCut]) -> list[str]:
    """Name each cut by its setting, and by its file where another has the same."""
    words = [_words(cut) for cut in cuts]
    return [f"{w}, {t.file.name}" if words.count(w) > 1 else w for w, t in zip(words, tests, strict=True)]


def _further(cuts: Sequence[SteadyCut]) -> Iterable[SteadyCut]:
    """Cuts that could be made next: more and less feed, half the speed, and none at all."""
    real = [c for c in cuts if c.depth > 0.0]
    if not real:
        return
    least, most = (f(real, key=lambda c: c.feed_per_tooth) for f in (min, max))
    yield replace(most, feed_per_tooth=2.0 * most.feed_per_tooth)
    yield replace(least, feed_per_tooth=0.5 * least.feed_per_tooth)
    yield replace(most, rotation=0.5 * min(c.rotation for c in real))
    if all(c.depth > 0.0 for c in cuts):
        yield replace(most, depth=0.0)


def _priced(family: CuttingForces) -> CuttingForces:
    proposals = tuple(replace(p, settings={**p.settings, "minutes": MINUTES}) for p in family.proposals)
    return replace(family, proposals=proposals)


# --- From a campaign to the diagnosis of stability limits: its cutting tests as brackets of the limit depth.

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
