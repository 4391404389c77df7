"""`smfe diagnose`: from a campaign with a baseline to ``finding.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from process.errors import InputError
from smfe.campaign import AxisModel, Campaign, LimitsOf, ModesOf, load_campaign
from smfe.campaign.datasets import Show
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.diagnosis.audit import Audit, audited
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.consequences import with_consequences
from smfe.diagnosis.inference.diagnose import diagnose as diagnose_family
from smfe.diagnosis.inference.finding import Finding, explain
from smfe.identification.errors.result import Identification
from smfe.identification.levels import with_levels
from smfe.progress import Progress, silent, warn
from smfe.results import KEPT, MEASUREMENT, TEST, Failures, check_target, write_json


def diagnose(
    campaign: Path | str | Campaign,
    output: Path | str | None = None,
    seed: int = 0,
    held_out: Sequence[str] = (),
    progress: Progress = silent,
    licence: Show | None = None,
    workers: int | None = None,
) -> Finding:
    """Say what the baseline of a campaign gets wrong, why, and what the repaired model gains.

    Parameters
    ----------
    campaign : path or Campaign
        Campaign with ``[baseline]``.
    output : path, optional
        JSON file of the finding. Default: of a path ``finding.json``, else nothing is written.
    seed : int, optional
        Of all draws.
    held_out : sequence of str, optional
        Measurements, or files of cutting tests, that no fit uses: they are compared once, at the very end, besides
        those that the campaign marks so.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched.
    workers : int, optional
        Processes that predict where that takes long; default: one a core, at most 8, on Linux, elsewhere one.

    Returns
    -------
    Finding
        Also written to `output`, with the suspicions of the data audit.

    Warns
    -----
    SmfeWarning
        Faults that the data audit found: what they exclude is not compared.

    Raises
    ------
    InputError
        When the campaign file or a record is wrong, there is no baseline, or nothing to compare it with.
    """
    if output is None and not isinstance(campaign, Campaign):
        output = "finding.json"
    loaded, path = load_campaign(campaign, licence), None if output is None else Path(output)
    if path is not None:
        check_target(path)
    if loaded.baseline is None:
        case_of(loaded, {})  # says what is missing, before any record is read
    checked = audited(loaded, progress, None if path is None else path.parent / KEPT)
    suspects = checked.suspects
    case = case_of(*_usable(loaded, checked.excluded, _identified(loaded, checked)), progress)
    finding, content = _tested(loaded, case, suspects, seed, progress, held_out, workers)
    if path is not None:
        write_json(path, content)
    warn(f"{s.where}: {s.evidence}; {s.advice}" for s in suspects if s.level == "fault")
    return finding


def finding_of(
    campaign: Campaign,
    found: Mapping[str, Identification],
    suspects: Sequence[Suspect],
    progress: Progress = silent,
) -> dict[str, object]:
    """Return what ``finding.json`` holds for a campaign with a baseline that was audited and identified already."""
    case = case_of(*_usable(campaign, Audit(list(suspects)).excluded, found), progress)
    return _tested(campaign, case, suspects, 0, progress, ())[1]


def _usable(
    campaign: Campaign, excluded: Failures, found: Mapping[str, Identification]
) -> tuple[Campaign, dict[str, Identification]]:
    """Leave out what a fault excludes."""
    gone = {(f.part, f.name) for f in excluded}
    measurements = tuple(m for m in campaign.measurements if (MEASUREMENT, m.name) not in gone)
    tests = tuple(t for t in campaign.cutting_tests if (TEST, t.file.name) not in gone)
    kept = {name: item for name, item in found.items() if (MEASUREMENT, name) not in gone}
    return replace(campaign, measurements=measurements, cutting_tests=tests), kept


def _tested(
    campaign: Campaign,
    case: Case,
    suspects: Sequence[Suspect],
    seed: int,
    progress: Progress,
    held_out: Sequence[str],
    workers: int | None = None,
) -> tuple[Finding, dict[str, object]]:
    left_out = case.held_out_conditions(held_out)
    finding = diagnose_family(case.family, seed, progress, left_out, workers)
    finding = with_consequences(campaign, case.family, finding, left_out)
    return finding, {"campaign": campaign.name, **as_dict(finding, [*suspects, *case.suspects])}


def as_dict(finding: Finding, suspects: Sequence[Suspect]) -> dict[str, object]:
    """Return what ``finding.json`` holds."""
    audited = [{"cause": s.cause, "level": s.level, "where": s.where, "evidence": s.evidence} for s in suspects]
    summary = explain(finding).splitlines()
    return {**finding.as_dict(), "story": summary, "summary": summary, "data_audit": audited}


def _identified(campaign: Campaign, checked: Audit) -> dict[str, Identification]:
    """Return what the baseline is compared with, or made of, of what the audit identified."""
    baseline = campaign.baseline
    if not isinstance(baseline, AxisModel | ModesOf | LimitsOf):
        return {}
    compared = () if isinstance(baseline, LimitsOf) else ("hammer", "actuator")
    source = "" if isinstance(baseline, AxisModel) else baseline.source
    has_modes = [m for m in with_levels(campaign).measurements if m.method in COMPLIANCE_METHODS]
    wanted = [m for m in has_modes if m.method in compared or m.name == source]
    if compared and not any(m.method in compared for m in wanted):
        raise InputError("the campaign has no hammer or actuator measurement; the baseline has nothing to compare with")
    return {m.name: checked.identified[m.name] for m in wanted if m.name in checked.identified}
