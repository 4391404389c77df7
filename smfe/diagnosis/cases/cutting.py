"""From a campaign to the diagnosis of cuts: its cutting tests as forces, or as brackets of the limit depth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, LimitsOf
from smfe.diagnosis.cases.case import Case, modes_named
from smfe.diagnosis.cases.experiments import PROPOSALS
from smfe.diagnosis.checks.suspect import Suspect, note
from smfe.diagnosis.cutting.chatter_line import vibrating_line
from smfe.diagnosis.cutting.forces import cutting_family
from smfe.diagnosis.cutting.limits import Limit, Spread, Trial, bracketed, limit_family
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.identification.errors.result import Identification
from smfe.limits.cut_conditions import FIXED, Source, stated
from smfe.limits.cutting_tests import judge
from smfe.progress import Progress, silent
from smfe.records import read_records
from stability.chatter.cut_interval import in_the_cut


def cutting_case(campaign: Campaign) -> Case:
    """Return the case of the forces of ``[tool]`` and ``[material]`` against those of the cutting tests of a campaign.

    Proposed are cuts with more and less feed, one at half the speed, and the spindle in air.
    """
    tool, material = _tool(campaign, "a mechanistic force")
    cuts = [
        SteadyCut(
            test.spindle_speed * math.pi / 30.0,
            test.stated_feed_per_tooth,
            test.depth_of_cut,
            engagement(test.cut, test.width_of_cut, tool.diameter),
        )
        for test in campaign.cutting_tests
    ]
    further: list[SteadyCut] = []
    if real := [c for c in cuts if c.depth > 0.0]:
        least, most = (f(real, key=lambda c: c.feed_per_tooth) for f in (min, max))
        further.append(replace(most, feed_per_tooth=2.0 * most.feed_per_tooth))
        further.append(replace(least, feed_per_tooth=0.5 * least.feed_per_tooth))
        further.append(replace(most, rotation=0.5 * min(c.rotation for c in real)))
    if len(real) == len(cuts) > 0:
        further.append(replace(most, depth=0.0))
    words = [_words(cut) for cut in cuts]
    named: dict[str, tuple[xr.Dataset, SteadyCut]] = {}
    groups: dict[str, tuple[str, ...]] = {}
    notes: list[Suspect] = []
    for test, cut, name in zip(campaign.cutting_tests, cuts, words, strict=True):
        name = f"{name}, {test.file.name}" if words.count(name) > 1 else name
        record = read_records(test.file, test.channels)[0]
        steady = _steady(record, test, cut)
        notes += _left_out(record, steady, test)
        named[name] = steady, cut
        groups[test.file.name] = (*groups.get(test.file.name, ()), name)
    family = cutting_family(
        named,
        tool,
        (material.Ktc, material.Krc, material.Kac),
        {_words(cut): cut for cut in further},
        edge=(material.Kte, material.Kre, material.Kae),
        tolerances=campaign.tolerances,
        missing=campaign.missing_coefficients,
        stated=campaign.coefficient_spread is not None,
    )
    proposals = tuple(replace(p, settings={**p.settings, "minutes": PROPOSALS.cut}) for p in family.proposals)
    of_file = {name: file for file, names in groups.items() for name in names}
    suspects = [
        replace(s, where=f"cutting test, {of_file[s.where]}") if s.where in of_file else s for s in family.suspects
    ]
    compared = {c.name for c in family.conditions}
    groups = {file: kept for file, names in groups.items() if (kept := tuple(n for n in names if n in compared))}
    return Case(replace(family, proposals=proposals), groups, _held_out(campaign, groups), (*notes, *suspects))


def _steady(record: xr.Dataset, test: CuttingTest, cut: SteadyCut) -> xr.Dataset:
    """Return what counts of the record of a test: its interval, else the steady cut in it; less the forces in air."""
    if cut.depth > 0.0 and "force" in record:
        return in_the_cut(record, cut.rotation, test.interval)
    if test.interval is None:
        return record
    time = record["time"].values
    return record.isel(time=np.flatnonzero((time >= test.interval[0]) & (time <= test.interval[1])))


def _left_out(record: xr.Dataset, steady: xr.Dataset, test: CuttingTest) -> Iterator[Suspect]:
    """Yield a note of what a record holds beside the steady cut, where the campaign does not say what to take."""
    if test.interval is not None or steady.sizes["time"] == record.sizes["time"]:
        return
    # Times are those of the record, as `interval` has them.
    begin, end = (float(record["time"].values[i]) for i in (0, -1))
    first, last = (float(steady["time"].values[i]) for i in (0, -1))
    yield note(
        "unusable",
        f"cutting test, {test.file.name}",
        f"the steady cut lasts from {first:.4g} to {last:.4g} s of a record from {begin:.4g} to {end:.4g} s",
        "entry, exit and air are left out; the mean force in the air counts as zero; say interval to take another part",
    )


def _tool(campaign: Campaign, what: str) -> tuple[Tool, CuttingCoefficients]:
    if campaign.tool is None or campaign.coefficients is None:
        raise InputError(f"{what} needs the tables [tool] and [material]; add them")
    return campaign.tool, campaign.coefficients


def _held_out(campaign: Campaign, groups: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(t.file.name for t in campaign.cutting_tests if t.held_out and t.file.name in groups))


def _words(cut: SteadyCut) -> str:
    """Name a cut by its setting."""
    speed = f"{cut.rotation * 30.0 / math.pi:.6g} rpm"
    if cut.depth == 0.0:
        return f"spindle in air at {speed}"
    return f"cut at {speed}, {cut.feed_per_tooth * 1e3:.4g} mm per tooth, {cut.depth * 1e3:.4g} mm deep"


def limit_case(
    campaign: Campaign, baseline: LimitsOf, found: Mapping[str, Identification], progress: Progress = silent
) -> Case:
    """Return the case of the limits that cutting tests bracket, against those of a modal model.

    A test is stable or not as the campaign says (``observed``), else as the spectral criterion judges its record; the
    chatter frequency is that of the record. One that stays undecided bounds nothing.
    """
    modes, (tool, material) = modes_named(campaign, baseline.source, found), _tool(campaign, "a limit depth")
    tests, apart = _of_source(campaign, baseline)
    limits, groups, notes = bracketed_limits(campaign, tests, tool, progress)
    suspects = [*modes.suspects, *apart, *notes]
    arcs = [x.arc for x in limits if x.arc is not None]
    # How well the modes are known: as the campaign says of a model, else the default.
    given = [m.spread for m in campaign.models if m.name == baseline.source and m.spread is not None]
    known = {n: s for n in ("frequency", "damping", "stiffness") for g in given[:1] if (s := getattr(g, n))}
    spread = replace(Spread(), **known)
    stated = ["modal_scale"] if given else []
    stated += ["force_coefficients"] if campaign.coefficient_spread is not None else []
    family = limit_family(
        limits,
        modes.modal,
        tool,
        arcs[0],
        material,
        spread=spread,
        tolerances=campaign.tolerances,
        stated=stated,
    )
    suspects += [
        note(
            "unusable",
            name,
            "zero order, of the mean forces over a turn, does not describe it: few teeth are in the cut",
            f"it counts within {100.0 * std:.2g} % only; bracket limits with more teeth in the cut",
        )
        for name, std in family.roughly()
    ]
    return Case(family, groups, _held_out(campaign, groups), tuple(suspects))


def bracketed_limits(
    campaign: Campaign, tests: Sequence[CuttingTest], tool: Tool, progress: Progress
) -> tuple[list[Limit], dict[str, tuple[str, ...]], list[Suspect]]:
    """Return the limits that cutting tests of one machine bracket, those of each file, and notes of what brackets none.

    Raises InputError without a limit.
    """
    limits: list[Limit] = []
    groups: dict[str, tuple[str, ...]] = {}
    suspects: list[Suspect] = []
    for (cut, width, feed), trials in _trials(campaign, tests, progress).items():
        bounds, notes = bracketed([trial for _, trial in trials], feed)
        arc = engagement(cut, width, tool.diameter)
        where = f"{cut}, {width * 1e3:.4g} mm wide, {feed * 1e3:.4g} mm per tooth"
        named = [replace(x, arc=arc, name=f"limit at {x.spindle_speed:.6g} rpm, {where}") for x in bounds]
        limits += named
        suspects += [note("unusable", f"cutting tests {where}", text, "add a cut on the other side") for text in notes]
        for test, trial in trials:
            used = tuple(x.name for x in named if x.spindle_speed == trial.spindle_speed)
            if used:
                groups[test.file.name] = (*groups.get(test.file.name, ()), *used)
    if not limits:
        why = "; ".join(s.evidence for s in suspects) or "every cutting test stays undecided"
        raise InputError(f"no limit is bracketed between a stable and a chattering cut: {why}")
    return limits, groups, suspects


def _of_source(campaign: Campaign, baseline: LimitsOf) -> tuple[list[CuttingTest], list[Suspect]]:
    """Return the cutting tests of the machine whose modes are tested, under one controller, and notes of the others."""
    measured = next((m for m in campaign.measurements if m.name == baseline.source), None)
    fixed = (None, None) if measured is None else tuple(stated(measured, key) for key in FIXED)
    source = Source((baseline.source,), baseline.source, *fixed)
    kept, notes = [], []
    for test in campaign.cutting_tests:
        if differs := source.differs(test):
            notes.append(note("unusable", f"cutting test, {test.file.name}", differs, "it bounds no limit here"))
        else:
            kept.append(test)
    for key in FIXED:
        values = sorted({v for test in kept if (v := getattr(test, key)) is not None})
        if len(values) > 1:
            raise InputError(
                f"the cutting tests were made with the {key} {' and '.join(values)}, whose limits are not those of one "
                f"machine; diagnose each in a campaign of its own, or from a measurement that states its {key}"
            )
    return kept, notes


def _trials(
    campaign: Campaign, tests: Sequence[CuttingTest], progress: Progress
) -> Mapping[tuple[str, float, float], Sequence[tuple[CuttingTest, Trial]]]:
    """Return the tests that are decided, by kind of cut, width [m] and feed per tooth [m]: those of one limit curve."""
    found: dict[tuple[str, float, float], list[tuple[CuttingTest, Trial]]] = {}
    for done, test in enumerate(tests):
        progress(f"judging {test.file.name}", done, len(tests))
        judged = judge(campaign, test)
        verdict = test.observed or judged.verdict
        if verdict in ("stable", "chatter"):
            measured = verdict == judged.verdict == "chatter" and math.isfinite(judged.chatter_frequency_Hz)
            assert campaign.tool is not None
            frequency = vibrating_line(judged, campaign.tool.teeth) if measured else None
            start, end = judged.interval_s
            # A line is read to a part of the distance of the lines that its record resolves: evenly spread within one.
            read = max(Trial.frequency_std, 1.0 / (math.sqrt(12.0) * (end - start)))
            trial = Trial(test.spindle_speed, test.depth_of_cut, verdict == "chatter", frequency, read)
            found.setdefault((test.cut, test.width_of_cut, test.stated_feed_per_tooth), []).append((test, trial))
    return found
