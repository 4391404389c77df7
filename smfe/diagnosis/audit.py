"""The data audit: faults of a measurement are looked for, and excluded, before a cause is sought in the physics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import xarray as xr

from process.cut.engagement import engagement
from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, LimitsOf, Measurement, ModesOf, RecordEntry, RigidDrive
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.diagnosis.cases.drive import unlogged_suspects
from smfe.diagnosis.checks.channels import channel_suspects, gravity_suspects, silence_suspects, tone_suspects
from smfe.diagnosis.checks.compliances import (
    factor_suspects,
    model_suspects,
    mounting_suspects,
    reciprocity_suspects,
    skew_suspects,
    stiffness_suspects,
)
from smfe.diagnosis.checks.cuts import clock_suspects, force_suspects, speed_suspects, tooth_suspects
from smfe.diagnosis.checks.hammer import hit_suspects
from smfe.diagnosis.checks.same_data import Seen, same_suspects, seen
from smfe.diagnosis.checks.suspect import Part, Suspect, fault, note, warning
from smfe.diagnosis.checks.sweep import sweep_suspects
from smfe.identification.drive.drives import drive_of, loop_of, notes_of, open_loop_of
from smfe.identification.drive.loop import summary
from smfe.identification.errors.result import Identification
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
from smfe.identification.sweep.passes import prepare
from smfe.identification.sweep.spindle_clock import ADVICE, judge_clock
from smfe.kept import Parts, file_hash, key_of
from smfe.progress import Progress, silent, step
from smfe.records import read_records
from smfe.results import MEASUREMENT, TEST, Failure, Failures, attempt

_CORRECT = "correct the campaign file or the record; nothing can be computed from it"


@dataclass
class Audit:
    """What an audit found, and what it identified on the way."""

    suspects: list[Suspect] = field(default_factory=list)  # suspicions
    identified: dict[str, Identification] = field(default_factory=dict)
    """Measurement, or level of a sweep -> its identification."""
    seen: list[Seen] = field(default_factory=list)  # records, by their samples
    outside: set[Part] = field(default_factory=set)  # left out for what lies outside of input and program

    def add(self, parts: Parts, name: str, key: str, files: Iterable[Path], check: Callable[[Audit], None]) -> None:
        """Add what a check of one measurement or cutting test finds, or what was kept of it for the same files."""
        if parts.folder is None:
            check(self)
            return

        def checked() -> dict[str, list[Any]]:
            own = Audit(identified=self.identified)
            try:
                check(own)
            except Exception:
                self.suspects += own.suspects
                self.seen += own.seen
                raise
            return {"suspects": [astuple(s) for s in own.suspects], "seen": [astuple(s) for s in own.seen]}

        found = parts.get(name, key_of(key, *(file_hash(f) for f in files)), checked)
        for cause, level, where, evidence, advice, excludes in found["suspects"]:
            gone = tuple((kind, of) for kind, of in excludes)
            self.suspects.append(Suspect(cause, level, where, evidence, advice, gone))
        self.seen += [Seen((kind, of), file, tuple(said), digest) for (kind, of), file, said, digest in found["seen"]]

    @property
    def excluded(self) -> Failures:
        """Measurements and cutting tests that a fault leaves out, each once, with all that was found about it."""
        reasons: dict[Part, list[str]] = {}
        for s in self.suspects:
            text = s.evidence if s.cause == "unusable" else f"left out, {s.where}: {s.evidence}; {s.advice}"
            for part in s.excludes:
                reasons.setdefault(part, []).append(text)
        return [
            Failure(*part, "; ".join(dict.fromkeys(texts)), part in self.outside) for part, texts in reasons.items()
        ]


def audit(campaign: Campaign, progress: Progress = silent) -> list[Suspect]:
    """Return every suspicion about the data of a campaign."""
    return audited(campaign, progress).suspects


def audited(campaign: Campaign, progress: Progress = silent, kept: Path | None = None) -> Audit:
    """Audit the data of a campaign.

    Identifications and suspicions are kept in the folder `kept`, and found again while neither records nor settings
    have changed.
    """
    out, parts = Audit(), Parts(kept, "check")
    total = len(campaign.measurements) + len(campaign.cutting_tests)
    for done, measurement in enumerate(campaign.measurements):
        progress(f"checking {measurement.name}", done, total)
        audit_measurement(campaign, measurement, out, parts, step(progress, done, total))
    for number, test in enumerate(campaign.cutting_tests):
        progress(f"checking {test.file.name}", number + len(campaign.measurements), total)
        audit_test(campaign, number, test, out, parts)
    parts.forget_others()
    out.suspects += same_suspects(out.seen)
    failures: Failures = []
    with attempt(failures, "silent records"):
        out.suspects += silence_suspects(campaign)
    with attempt(failures, "drive records"):
        if isinstance(campaign.baseline, RigidDrive):
            out.suspects += unlogged_suspects(campaign, campaign.baseline)
    out.suspects += [fault("unusable", f.part, f.reason, _CORRECT) for f in failures]
    compliances = {m.name: out.identified[m.name].compliance for m in campaign.measurements if m.name in out.identified}
    named = rightly_named(compliances, out.suspects)
    out.suspects += model_suspects(named, campaign.models)
    out.suspects += factor_suspects(named, {f.name for f in out.excluded if f.part == MEASUREMENT})
    out.suspects += _missing_entries(campaign, compliances)
    return out


def rightly_named(compliances: Mapping[str, xr.Dataset], suspects: Sequence[Suspect]) -> dict[str, xr.Dataset]:
    """Return the compliances without those whose channels are exchanged: their driving points are cross terms.

    Which factor of a unit or gain they happen to be of a model says nothing; the exchange is what is to be mended.
    """
    exchanged = {s.where for s in suspects if (s.level, s.cause) == ("fault", "sensor_axis")}
    return {name: compliance for name, compliance in compliances.items() if name not in exchanged}


def audit_measurement(
    campaign: Campaign, measurement: Measurement, out: Audit, parts: Parts, progress: Progress = silent
) -> None:
    """Identify a measurement and the levels of a sweep, audit its records, and keep both where `parts` are kept."""
    whole, kept = with_levels(replace(campaign, measurements=(measurement,))), parts.folder
    part = (MEASUREMENT, measurement.name)
    failures: Failures = []
    with attempt(failures, *part):
        check_sweep(campaign, measurement)
        names = {measurement.name, *(m.name for m in levels_of(measurement).values())}
        for m in whole.measurements:
            if measurement.method in COMPLIANCE_METHODS and m.name in names:
                out.identified[m.name] = (
                    identify_measurement(campaign, m, progress)
                    if kept is None
                    else cached_identification(campaign, m, kept, progress)[0]
                )
    with attempt(failures, *part):
        asked = (_is_source(campaign, measurement.name), measurement.name in out.identified)
        key = key_of(measurement, campaign.tool, campaign.coefficients, *asked)
        files = (*(f for entry in measurement.records for f in entry.all_files), *measurement.background)
        # Records in memory have no file by which they could be known again.
        known = Parts(None, "check") if any(entry.held for entry in measurement.records) else parts
        out.add(known, f"measurement {measurement.name}", key, files, partial(_measurement, campaign, measurement))
    # What a record cannot be read for is said once, though both steps read it.
    out.suspects += [fault("unusable", measurement.name, f.reason, _CORRECT, part) for f in failures[:1]]
    out.outside |= {part for f in failures[:1] if f.outside}


def audit_test(campaign: Campaign, number: int, test: CuttingTest, out: Audit, parts: Parts) -> None:
    """Audit the record of a cutting test, the one of this number in its campaign."""
    where, part = f"cutting test, {test.file.name}", (TEST, test.file.name)
    failures: Failures = []
    with attempt(failures, *part):
        key = key_of(test, campaign.tool, campaign.coefficients)
        check = partial(_cutting_test, campaign, test, where, part)
        out.add(parts, f"cutting test {number} {test.file.name}", key, [test.file], check)
    out.suspects += [fault("unusable", where, f.reason, _CORRECT, part) for f in failures]
    out.outside |= {part for f in failures if f.outside}


def _measurement(campaign: Campaign, measurement: Measurement, out: Audit) -> None:
    """Audit the records of a measurement one by one, and what was identified from them."""
    name, method, part = measurement.name, measurement.method, (MEASUREMENT, measurement.name)
    found, tool = out.identified.get(name), campaign.tool
    by_axis: dict[str, list[xr.Dataset]] = {}
    declared: dict[str, list[tuple[str, xr.Dataset]]] = {}
    for entry in measurement.records if method != "frf" else ():
        for record in records_of(entry, entry.excitation):
            where = f"{name}, {record.attrs['source']}"
            for s in channel_suspects(record, where, pulsed=method == "hammer"):
                # A hit that is cut off is left out by itself, and said so.
                handled = method == "hammer" and s.cause == "saturation" and found is not None
                # A drive is read from its encoder and its force: accelerometers that are not there are none of its.
                if method not in ("drive", "open_loop", "loop") or "acceleration" not in f"{s.where} {s.evidence}":
                    out.suspects.append(_excluding(s, part, handled and "all " not in s.evidence))
            if method == "silent":
                out.suspects += tone_suspects(record, where)
            if entry.cut is not None:
                out.suspects += clock_suspects(record, where, tool.teeth if tool else None)
                out.suspects += speed_suspects(record, where, None, part)
                out.suspects += _force_size(campaign, entry, record, where, part)
            if method in ("hammer", "actuator", "sweep"):
                feed = None if entry.feed is None else tuple(sorted(entry.feed.items()))
                given = (entry.controller, feed, entry.force_level, entry.depth_of_cut, entry.position)
                more = (entry.added_mass, entry.repeat, entry.excitation, entry.cut, entry.width_of_cut)
                out.seen.append(seen(record, part, (*given, *more), entry.excitation))
            by_axis.setdefault(entry.excitation or "", []).append(record)
            declared.setdefault(repr(entry.channels), []).append((where, record))
    for alike in declared.values() if method not in ("drive", "open_loop", "loop") else ():
        out.suspects += gravity_suspects(alike)
    if method == "hammer" and found is not None:
        out.suspects += hit_suspects(name, by_axis, found, **hammer_settings(measurement))
    if method == "loop":
        loop, advice = loop_of(measurement), "the response of a loop to its setpoint, without unit; it is no compliance"
        out.suspects += [note("loop_response", name, text, advice) for text in summary(loop)]
        advice = "record several periods, not their average"
        out.suspects += [note("loop_response", name, text, advice) for text in loop.notes]
    if method == "open_loop":
        advice = "see drives.csv for the masses, stiffness and dead time, with their intervals"
        out.suspects += [note("drive", name, text, advice) for text in open_loop_of(measurement).notes]
    if method == "drive":
        out.suspects += _drive_suspects(campaign, measurement)
    if found is not None:
        moves = measurement.feed is not None and any(v != 0.0 for v in measurement.feed.values())
        out.suspects += _compliance_suspects(campaign, name, found.compliance, moves)
        if method == "sweep" and tool is not None:
            passes, band = passes_and_band(campaign, measurement)
            # The stated speeds alone: those of channels are compared with their record.
            bare = [prepare(replace(p, record=p.record[["force"]])) for p in passes]
            out.suspects += [
                warning("time_skew", name, text, ADVICE["stated"])
                for text in judge_clock(name, bare, tool.teeth).warnings
            ]
            if measurement.references == "all":
                out.suspects += sweep_suspects(name, passes, tool.teeth, band)


def _excluding(suspect: Suspect, part: Part, mild: bool) -> Suspect:
    """Return a suspicion about a record as one about its part: a fault leaves it out, one that is mild only warns."""
    level = "warning" if mild else suspect.level
    return replace(suspect, level=level, excludes=(part,) if level == "fault" else ())


def _force_size(
    campaign: Campaign, cut: RecordEntry | CuttingTest, record: xr.Dataset, where: str, *excludes: Part
) -> Iterator[Suspect]:
    """Compare the force of a record with that of the cut it is said to hold, where all of the cut is stated."""
    tool, work, depth, feed = campaign.tool, campaign.coefficients, cut.depth_of_cut, cut.feed_per_tooth
    if tool is None or work is None or depth is None or feed is None or cut.cut is None or cut.width_of_cut is None:
        return
    arc = engagement(cut.cut, cut.width_of_cut, tool.diameter)
    yield from force_suspects(record, where, (tool, arc, work), depth, feed, *excludes)


def _cutting_test(campaign: Campaign, test: CuttingTest, where: str, part: Part, out: Audit) -> None:
    tool = campaign.tool
    said = (test.spindle_speed, test.depth_of_cut, test.cut, test.width_of_cut, test.feed_per_tooth, test.controller)
    for record in read_records(test.file, test.channels):
        # A verdict needs the lines of the record, which a cut-off peak or a dead axis leaves in place.
        out.suspects += [_excluding(s, part, s.cause == "saturation") for s in channel_suspects(record, where)]
        out.suspects += gravity_suspects([(where, record)])
        wrong = list(speed_suspects(record, where, test.spindle_speed, part))
        out.suspects += wrong or clock_suspects(record, where, tool.teeth if tool else None)
        out.seen.append(seen(record, part, said))
        if tool is not None and not wrong and test.depth_of_cut > 0.0:
            arc = engagement(test.cut, test.width_of_cut, tool.diameter)
            # Chatter may lie on an order of the spindle.
            if test.observed != "chatter":
                out.suspects += tooth_suspects(record, where, test.spindle_speed, tool, arc)
            out.suspects += _force_size(campaign, test, record, where)


def _compliance_suspects(
    campaign: Campaign, name: str, compliance: xr.Dataset, moves: bool = False
) -> Iterator[Suspect]:
    # Lobes of a machine that gives out energy mean nothing; its compliance, of two places perhaps, may still be read.
    part = ((MEASUREMENT, name),) if _is_source(campaign, name) else ()
    mounted = list(mounting_suspects(name, compliance, *part))
    yield from mounted
    signs = () if mounted else sign_warnings(compliance)
    for text in signs:
        advice = (
            "hit and measure at the same point, and declare sign = -1 on force or motion if one of them is turned "
            "round; where two axes may be exchanged, knock on the tool along x, y and z, one at a time"
        )
        yield fault("sensor_gain", name, text, advice, *part)
    # A drive that answers late and friction that falls with speed give out energy where an axis moves.
    if not signs and not mounted and not moves:
        yield from skew_suspects(name, compliance, campaign.tolerances)
    if not mounted:
        yield from reciprocity_suspects(name, compliance, campaign.tolerances)
    yield from stiffness_suspects(name, compliance)


def _is_source(campaign: Campaign, name: str) -> bool:
    """Return whether lobes or the baseline of a diagnosis come from a measurement."""
    sources = {n for request in campaign.lobes for n in request.measurements}
    if isinstance(campaign.baseline, ModesOf | LimitsOf):
        sources.add(campaign.baseline.source)
    return name in sources


def _drive_suspects(campaign: Campaign, measurement: Measurement) -> Iterator[Suspect]:
    """Say what the records of a drive do not determine; a diagnosis of the drive reads them all the same."""
    try:
        drives = {measurement.name: drive_of(measurement)}
    except InputError as error:
        if not (isinstance(campaign.baseline, RigidDrive) or "drive" in getattr(campaign.baseline, "evidence", ())):
            raise
        advice = "inertia and friction cannot be identified from it; a diagnosis may still read it"
        yield warning("unusable", measurement.name, str(error), advice)
        return
    for text in notes_of(drives):
        advice = "see drives.csv for what was determined, with its intervals"
        yield note("drive", measurement.name, text, advice)


def _missing_entries(campaign: Campaign, compliances: Mapping[str, xr.Dataset]) -> Iterator[Suspect]:
    """Note sources of lobes without cross terms, and warn of two measurements that hold one tap each."""
    asked = {name for request in campaign.lobes for name in request.measurements}
    known = {n: _known_entries(c) for n, c in compliances.items() if n in asked}
    for name, entries in known.items():
        if len(entries) > 1 and all(entry[0] == entry[1] for entry in entries):
            evidence = f"it has {', '.join(sorted(entries))} and no cross terms"
            advice = "lobes take them as zero; measure them where modes lie across the axes"
            yield note("cross_terms", name, evidence, advice)
    alone: dict[tuple[object, ...], dict[str, str]] = {}
    for m in campaign.measurements:
        for tap in ("xx", "yy"):
            if known.get(m.name) == {tap}:
                feed = None if m.feed is None else tuple(sorted(m.feed.items()))
                alone.setdefault((m.method, m.controller, m.position, feed), {})[tap] = m.name
    for taps in alone.values():
        if len(taps) == 2:
            yield warning(
                "cross_terms",
                f"{taps['xx']} and {taps['yy']}",
                "one has xx alone, the other yy alone, measured under the same conditions: lobes of each take the "
                "other direction as rigid",
                "make them one [[measurement]] with both records",
            )


def _known_entries(compliance: xr.Dataset) -> set[str]:
    """Return the entries that hold a number other than zero: xx, xy, ..."""
    array = compliance["compliance"]
    pairs = product(array["response"].values, array["excitation"].values)
    return {f"{r}{e}" for r, e in pairs if bool(abs(array.sel(response=r, excitation=e)).max() > 0.0)}
