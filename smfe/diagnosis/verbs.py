"""`smfe diagnose`: from a campaign with a baseline to ``finding.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from process.errors import InputError
from smfe.campaign import AxisModel, Campaign, LimitsOf, ModesOf, load_campaign
from smfe.campaign.quantities import COMPLIANCE_METHODS
from smfe.datasets import Show
from smfe.diagnosis.audit import audit
from smfe.diagnosis.campaign_case import Case
from smfe.diagnosis.campaign_family import case_of
from smfe.diagnosis.consequences import with_consequences
from smfe.diagnosis.engine import diagnose as diagnose_family
from smfe.diagnosis.finding import Finding, explain
from smfe.diagnosis.suspect import Suspect
from smfe.identification import Identification, Progress, silent
from smfe.measurements import cached_identification
from smfe.store import check_target, write_json
from smfe.sweep_levels import with_levels

KEPT = ".kept"


def diagnose(
    campaign: Path | str,
    output: Path | str = "finding.json",
    seed: int = 0,
    held_out: Sequence[str] = (),
    progress: Progress = silent,
    licence: Show | None = None,
    workers: int | None = None,
) -> Finding:
    """Say what the baseline of a campaign gets wrong, why, and what the repaired model gains.

    Parameters
    ----------
    campaign : path
        Campaign file with ``[baseline]``.
    output : path, optional
        JSON file of the finding.
    seed : int, optional
        Of all draws.
    held_out : sequence of str, optional
        Measurements, or files of cutting tests, that are set aside and opened once, at the very end, besides those
        that the campaign marks so.
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

    Raises
    ------
    InputError
        When the campaign file or a record is wrong, there is no baseline, or nothing to compare it with.
    """
    loaded, path = load_campaign(Path(campaign), licence), Path(output)
    check_target(path)
    if loaded.baseline is None:
        case_of(loaded, {})  # says what is missing, before any record is read
    suspects = audit(loaded, progress)
    case = case_of(loaded, _identified(loaded, path.parent / KEPT, progress), progress)
    finding, content = _questioned(loaded, case, suspects, seed, progress, held_out, workers)
    write_json(path, content)
    return finding


def finding_of(
    campaign: Campaign, found: Mapping[str, Identification], progress: Progress = silent
) -> dict[str, object]:
    """Return what ``finding.json`` holds for a campaign with a baseline whose measurements are identified already."""
    return _questioned(campaign, case_of(campaign, found, progress), audit(campaign, progress), 0, progress, ())[1]


def _questioned(
    campaign: Campaign,
    case: Case,
    suspects: Sequence[Suspect],
    seed: int,
    progress: Progress,
    held_out: Sequence[str],
    workers: int | None = None,
) -> tuple[Finding, dict[str, object]]:
    aside = case.set_aside(held_out)
    finding = diagnose_family(case.family, seed, progress, aside, workers)
    finding = with_consequences(campaign, case.family, finding, aside)
    return finding, {"campaign": campaign.name, **as_dict(finding, [*suspects, *case.suspects])}


def as_dict(finding: Finding, suspects: Sequence[Suspect]) -> dict[str, object]:
    """Return what ``finding.json`` holds."""
    audited = [{"cause": s.cause, "level": s.level, "where": s.where, "evidence": s.evidence} for s in suspects]
    return {**finding.as_dict(), "story": explain(finding).splitlines(), "data_audit": audited}


def _identified(campaign: Campaign, kept: Path, progress: Progress) -> dict[str, Identification]:
    baseline = campaign.baseline
    if not isinstance(baseline, AxisModel | ModesOf | LimitsOf):
        return {}
    compared = () if isinstance(baseline, LimitsOf) else ("hammer", "actuator")
    source = "" if isinstance(baseline, AxisModel) else baseline.source
    has_modes = [m for m in with_levels(campaign).measurements if m.method in COMPLIANCE_METHODS]
    wanted = [m for m in has_modes if m.method in compared or m.name == source]
    if compared and not any(m.method in compared for m in wanted):
        raise InputError("the campaign has no hammer or actuator measurement; the baseline has nothing to compare with")
    out = {}
    for done, measurement in enumerate(wanted):
        progress(f"identifying {measurement.name}", done, len(wanted))
        out[measurement.name] = cached_identification(campaign, measurement, kept, progress)[0]
    return out
