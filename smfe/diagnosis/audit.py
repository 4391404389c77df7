"""The data audit: measurement faults are looked for, and excluded, before physics is blamed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import xarray as xr

from process.cut.engagement import engagement
from process.errors import InputError
from smfe.campaign import (
    Campaign,
    CuttingTest,
    LimitsOf,
    Measurement,
    ModesOf,
    RecordEntry,
    RigidDrive,
)
from smfe.campaign.quantities import COMPLIANCE_METHODS
from smfe.diagnosis.cases.drive import unlogged_suspects
from smfe.diagnosis.checks.channels import channel_suspects, clock_suspects, silence_suspects, tone_suspects
from smfe.diagnosis.checks.compliances import factor_suspects, reciprocity_suspects, skew_suspects
from smfe.diagnosis.checks.hammer import hit_suspects
from smfe.diagnosis.checks.same_data import Part, Seen, same_suspects, seen
from smfe.diagnosis.checks.sizes import force_suspects, model_suspects, stiffness_suspects
from smfe.diagnosis.checks.speeds import speed_suspects, tooth_suspects
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.checks.sweep import sweep_suspects
from smfe.identification.drive.drives import drive_of, notes_of
from smfe.identification.drive.loop import summary
from smfe.identification.drive.loops import loop_of
from smfe.identification.errors.result import Identification, Progress, silent
from smfe.identification.levels import levels_of, with_levels
from smfe.identification.measurement import (
    cached_identification,
    check_sweep,
    hammer_settings,
    identify_measurement,
    passes_and_band,
    records_of,
    sign_warnings,
)
from smfe.identification.sweep.passes import SweepPass, prepare
from smfe.identification.sweep.spindle_clock import ADVICE, judge_clock
from smfe.records import read_records
from smfe.results import MEASUREMENT, TEST, Failure, Failures, attempt

_CORRECT = "correct the campaign file or the record; nothing can be computed from it"


@dataclass
class Audit:
    """What an audit found, and what it identified on the way.

    Parameters
    ----------
    suspects : list of Suspect
        Suspicions.
    identified : dict
        Measurement, or level of a sweep -> its identification.
    seen : list of Seen
        Records, by their samples.
    """

    suspects: list[Suspect] = field(default_factory=list)
    identified: dict[str, Identification] = field(default_factory=dict)
    seen: list[Seen] = field(default_factory=list)

    @property
    def excluded(self) -> Failures:
        """Measurements and cutting tests that a fault leaves out, each once, with all that was found about it."""
        reasons: dict[Part, list[str]] = {}
        for s in self.suspects:
            for part in s.excludes:
                text = f"{s.where}: {s.evidence}; {s.advice}"
                kept = reasons.setdefault(part, [])
                text = s.evidence if s.cause == "unusable" else f"left out, {text}"
                if text not in kept:
                    kept.append(text)
        return [Failure(*part, "; ".join(texts)) for part, texts in reasons.items()]


def audit(campaign: Campaign, progress: Progress = silent) -> list[Suspect]:
    """Return every suspicion about the data of a campaign."""
    return audited(campaign, progress).suspects


def audited(campaign: Campaign, progress: Progress = silent, kept: Path | None = None) -> Audit:
    """Audit the data of a campaign.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    progress : callable, optional
        Called with (what, done, of).
    kept : path, optional
        Folder in which identifications are kept, and found again while neither records nor settings have changed.
    """
    out = Audit()
    whole = with_levels(campaign)
    total = len(campaign.measurements) + len(campaign.cutting_tests)
    for done, measurement in enumerate(campaign.measurements):
        progress(f"checking {measurement.name}", done, total)
        part = (MEASUREMENT, measurement.name)
        failures: Failures = []
        with attempt(failures, *part):
            check_sweep(campaign, measurement)
            _identify(out, campaign, whole, measurement, kept)
        with attempt(failures, *part):
            by_axis = _records(out, campaign, measurement)
            if measurement.method == "hammer" and measurement.name in out.identified:
                found = out.identified[measurement.name]
                out.suspects += hit_suspects(measurement.name, by_axis, found, **hammer_settings(measurement))
            out.suspects += _loop_suspects(measurement)
            out.suspects += _drive_suspects(campaign, measurement)
            out.suspects += _compliance_suspects(campaign, measurement, out.identified)
        # What a record cannot be read for is said once, though both steps read it.
        for failure in list(dict.fromkeys(failures))[:1]:
            out.suspects.append(Suspect("unusable", "fault", measurement.name, failure.reason, _CORRECT, (part,)))
    for done, test in enumerate(campaign.cutting_tests, start=len(campaign.measurements)):
        progress(f"checking {test.file.name}", done, total)
        failures = []
        with attempt(failures, TEST, test.file.name):
            _cutting_test(out, campaign, test)
        for failure in failures:
            where = f"cutting test, {test.file.name}"
            out.suspects.append(Suspect("unusable", "fault", where, failure.reason, _CORRECT, ((TEST, failure.name),)))
    out.suspects += same_suspects(out.seen)
    failures = []
    with attempt(failures, "silent records"):
        out.suspects += silence_suspects(campaign)
    with attempt(failures, "drive records"):
        if isinstance(campaign.baseline, RigidDrive):
            out.suspects += unlogged_suspects(campaign, campaign.baseline)
    out.suspects += [Suspect("unusable", "fault", f.part, f.reason, _CORRECT) for f in failures]
    compliances = {m.name: out.identified[m.name].compliance for m in campaign.measurements if m.name in out.identified}
    out.suspects += model_suspects(compliances, campaign.models)
    out.suspects += factor_suspects(compliances, {f.name for f in out.excluded if f.part == MEASUREMENT})
    out.suspects += _missing_entries(campaign, compliances)
    return out


def _identify(out: Audit, campaign: Campaign, whole: Campaign, measurement: Measurement, kept: Path | None) -> None:
    if measurement.method not in COMPLIANCE_METHODS:
        return
    names = {measurement.name, *(m.name for m in levels_of(measurement).values())}
    for m in (m for m in whole.measurements if m.name in names):
        if kept is None:
            out.identified[m.name] = identify_measurement(campaign, m)
        else:
            out.identified[m.name], _ = cached_identification(campaign, m, kept)


def _records(out: Audit, campaign: Campaign, measurement: Measurement) -> dict[str, list[xr.Dataset]]:
    """Audit the records of a measurement one by one; return them by excitation axis."""
    by_axis: dict[str, list[xr.Dataset]] = {}
    if measurement.method == "frf":
        return by_axis
    part = (MEASUREMENT, measurement.name)
    hits = measurement.method == "hammer"
    for entry in measurement.records:
        for record in records_of(entry, entry.excitation):
            where = f"{measurement.name}, {record.attrs['source']}"
            for s in channel_suspects(record, where, pulsed=hits):
                # A hit that is cut off is left out by itself, and said so.
                handled = hits and s.cause == "saturation" and measurement.name in out.identified
                level = "warning" if handled and "all " not in s.evidence else s.level
                excludes = (part,) if level == "fault" else ()
                out.suspects.append(Suspect(s.cause, level, s.where, s.evidence, s.advice, excludes))
            if measurement.method == "silent":
                out.suspects += tone_suspects(record, where)
            if entry.cut is not None:
                out.suspects += clock_suspects(record, where, campaign.tool.teeth if campaign.tool else None)
                out.suspects += speed_suspects(record, where, None, (part,))
                out.suspects += _force_size(campaign, entry, record, where, part)
            if measurement.method in ("hammer", "actuator", "sweep"):
                out.seen.append(seen(record, part, _said(entry), entry.excitation))
            by_axis.setdefault(entry.excitation or "", []).append(record)
    return by_axis


def _said(entry: RecordEntry) -> tuple[object, ...]:
    feed = None if entry.feed is None else tuple(sorted(entry.feed.items()))
    given = (entry.controller, feed, entry.force_level, entry.depth_of_cut, entry.position, entry.added_mass)
    return (*given, entry.repeat, entry.excitation, entry.cut, entry.width_of_cut)


def _force_size(campaign: Campaign, entry: RecordEntry, record: xr.Dataset, where: str, part: Part) -> list[Suspect]:
    tool, work, depth, feed = campaign.tool, campaign.coefficients, entry.depth_of_cut, entry.feed_per_tooth
    if tool is None or work is None or depth is None or feed is None or entry.cut is None or entry.width_of_cut is None:
        return []
    arc = engagement(entry.cut, entry.width_of_cut, tool.diameter)
    return force_suspects(record, where, (tool, arc, work), depth, feed, (part,))


def _cutting_test(out: Audit, campaign: Campaign, test: CuttingTest) -> None:
    where, part, tool = f"cutting test, {test.file.name}", (TEST, test.file.name), campaign.tool
    said = (test.spindle_speed, test.depth_of_cut, test.cut, test.width_of_cut, test.feed_per_tooth, test.controller)
    for record in read_records(test.file, test.channels):
        for s in channel_suspects(record, where):
            # A verdict needs the lines of the record, which a cut-off peak or a dead axis leaves in place.
            level = "warning" if s.cause == "saturation" else s.level
            out.suspects.append(
                Suspect(s.cause, level, s.where, s.evidence, s.advice, (part,) if level == "fault" else ())
            )
        wrong = speed_suspects(record, where, test.spindle_speed, (part,))
        out.suspects += wrong or clock_suspects(record, where, tool.teeth if tool else None)
        out.seen.append(seen(record, part, said))
        if tool is not None and not wrong:
            arc = engagement(test.cut, test.width_of_cut, tool.diameter)
            out.suspects += tooth_suspects(record, where, test.spindle_speed, tool, arc)
            if campaign.coefficients is not None and test.feed_per_tooth is not None:
                cut = (tool, arc, campaign.coefficients)
                out.suspects += force_suspects(record, where, cut, test.depth_of_cut, test.feed_per_tooth)


def _compliance_suspects(
    campaign: Campaign, measurement: Measurement, identified: Mapping[str, Identification]
) -> list[Suspect]:
    if measurement.name not in identified:
        return []
    name, compliance = measurement.name, identified[measurement.name].compliance
    # Lobes of a machine that gives out energy mean nothing; its compliance, of two places perhaps, may still be read.
    sources = {n for request in campaign.lobes for n in request.measurements}
    if isinstance(campaign.baseline, ModesOf | LimitsOf):
        sources.add(campaign.baseline.source)
    part = ((MEASUREMENT, name),) if name in sources else ()
    signs = [
        Suspect("sensor_gain", "fault", name, text, "declare sign = -1 on the channel that is turned round", part)
        for text in sign_warnings(compliance)
    ]
    skew = [] if signs else skew_suspects(name, compliance)
    reciprocal = reciprocity_suspects(name, compliance)
    return [*signs, *skew, *reciprocal, *stiffness_suspects(name, compliance), *_sweep(campaign, measurement)]


def _loop_suspects(measurement: Measurement) -> list[Suspect]:
    """Say what the setpoint of a loop is, what the loop does, and what spoils it."""
    if measurement.method != "loop":
        return []
    found = loop_of(measurement)
    advice = "the response of a loop to its setpoint, without unit; it is no compliance"
    told = [Suspect("loop_response", "note", measurement.name, text, advice) for text in summary(found)]
    return told + [
        Suspect("loop_response", "note", measurement.name, text, "record several periods, not their average")
        for text in found.notes
    ]


def _drive_suspects(campaign: Campaign, measurement: Measurement) -> list[Suspect]:
    """Say what the records of a drive do not determine; a diagnosis of the drive reads them all the same."""
    if measurement.method != "drive":
        return []
    try:
        drives = {measurement.name: drive_of(measurement)}
    except InputError as error:
        if not isinstance(campaign.baseline, RigidDrive):
            raise
        advice = "inertia and friction cannot be identified from it; a diagnosis may still read it"
        return [Suspect("unusable", "warning", measurement.name, str(error), advice)]
    advice = "see drives.csv for what was determined, with its intervals"
    return [Suspect("drive", "note", measurement.name, text, advice) for text in notes_of(drives)]


def _sweep(campaign: Campaign, measurement: Measurement) -> list[Suspect]:
    if measurement.method != "sweep" or campaign.tool is None:
        return []
    passes, band = passes_and_band(campaign, measurement)
    out = _stated_speeds(measurement.name, passes, campaign.tool.teeth)
    if measurement.references == "all":
        out += sweep_suspects(measurement.name, passes, campaign.tool.teeth, band)
    return out


def _stated_speeds(name: str, passes: Sequence[SweepPass], teeth: int) -> list[Suspect]:
    """Compare the stated speeds alone: those of channels are said with their record."""
    bare = [prepare(replace(p, record=p.record[["force"]])) for p in passes]
    clock = judge_clock(name, bare, teeth)
    return [Suspect("time_skew", "warning", name, text, ADVICE["stated"]) for text in clock.warnings]


def _missing_entries(campaign: Campaign, compliances: Mapping[str, xr.Dataset]) -> list[Suspect]:
    """Note sources of lobes without cross terms, and warn of two measurements that hold one tap each."""
    asked = {name for request in campaign.lobes for name in request.measurements}
    known = {n: _known_entries(c) for n, c in compliances.items() if n in asked}
    out = [
        Suspect(
            "cross_terms",
            "note",
            name,
            f"it has {', '.join(sorted(entries))} and no cross terms",
            "lobes take them as zero; measure them where modes lie across the axes",
        )
        for name, entries in known.items()
        if len(entries) > 1 and all(entry[0] == entry[1] for entry in entries)
    ]
    alone: dict[tuple[object, ...], dict[str, str]] = {}
    for m in campaign.measurements:
        if known.get(m.name) in ({"xx"}, {"yy"}):
            feed = None if m.feed is None else tuple(sorted(m.feed.items()))
            alone.setdefault((m.method, m.controller, m.position, feed), {})[known[m.name].copy().pop()] = m.name
    out += [
        Suspect(
            "cross_terms",
            "warning",
            f"{taps['xx']} and {taps['yy']}",
            "one has xx alone, the other yy alone, measured under the same conditions: lobes of each take the other "
            "direction as rigid",
            "make them one [[measurement]] with both records",
        )
        for taps in alone.values()
        if len(taps) == 2
    ]
    return out


def _known_entries(compliance: xr.Dataset) -> set[str]:
    """Return the entries that hold a number other than zero: xx, xy, ..."""
    array = compliance["compliance"]
    return {
        f"{r}{e}"
        for r in array["response"].values
        for e in array["excitation"].values
        if bool(abs(array.sel(response=r, excitation=e)).max() > 0.0)
    }
