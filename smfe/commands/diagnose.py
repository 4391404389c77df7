"""`smfe diagnose`: from a campaign with a baseline to ``finding.json``."""

from __future__ import annotations

import contextlib
import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import xarray as xr

from process.errors import InputError
from smfe._version import __version__
from smfe.campaign import AxisModel, Campaign, LimitsOf, ModesOf, load_campaign
from smfe.campaign.datasets import Show
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.diagnosis.audit import Audit, audited
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.cases.known import with_known
from smfe.diagnosis.checks.suspect import Suspect, as_rows
from smfe.diagnosis.consequences import with_consequences, worth_of
from smfe.diagnosis.judgement.diagnose import diagnose as diagnose_family
from smfe.diagnosis.judgement.finding import Finding
from smfe.diagnosis.story.extended import HEAD, NAME, extended_campaign
from smfe.identification.errors.result import Identification
from smfe.identification.levels import with_levels
from smfe.kept import KEPT, file_hash
from smfe.progress import Progress, part, silent, warn
from smfe.reporting.figures.draw_diagnosis import Picture, draw_compared
from smfe.results import (
    MEASUREMENT,
    TEST,
    Failures,
    check_target,
    read_groups,
    write_atomically,
    write_groups,
    write_json,
)

CURVES = ".nc"
"""Suffix of the file beside ``finding.json`` that holds the curves."""

MOST_SAID = 3
"""Reasons for which something was left out that an error lists."""

FORM = 3
"""Number of the form in which findings are kept."""


@dataclass(frozen=True)
class Diagnosis(Finding):
    """A finding that shows itself: in a notebook as its sentences, with `plot` as a figure."""

    def plot(self) -> Picture:
        """Return a matplotlib figure: measured, baseline and extended model of each condition, and what is left.

        Raises
        ------
        InputError
            Where nothing was compared, so that there is nothing to draw.
        """
        if self.curves is None:
            raise InputError("nothing was compared in this finding, so there is nothing to draw")
        return draw_compared(self.curves)

    def _repr_html_(self) -> str:
        """Return the sentences, the verdict in bold and the notes left out."""
        shown = [p for p in self.passages if p.about != "note"]
        said = [html.escape(p.text) for p in shown]
        return "".join(
            f"<p><strong>{text}</strong></p>" if p.about == "verdict" else f"<p>{text}</p>"
            for p, text in zip(shown, said, strict=True)
        )


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
    checked = audited(loaded, part(progress, 0.0, 0.3), None if path is None else path.parent / KEPT)
    suspects = checked.suspects
    try:
        case = case_of(*_usable(loaded, checked.excluded, _identified(loaded, checked)), part(progress, 0.3, 0.4))
    except InputError as error:
        gone = "; ".join(f"{f.name}: {f.reason}" for f in checked.excluded[:MOST_SAID])
        more = len(checked.excluded) - MOST_SAID
        gone += f"; and {more} more" if more > 0 else ""
        raise InputError(f"{error}; left out were {gone}" if gone else str(error)) from error
    how = part(progress, 0.4, 1.0), held_out, workers, None, checked.identified, path
    finding, content = _tested(loaded, case, suspects, seed, *how)
    if path is not None:
        write_finding(path, content, finding.curves)
    told = [*(s for s in suspects if s.level == "fault"), *(s for s in case.suspects if s.level != "note")]
    warn(f"{s.where}: {s.evidence}; {s.advice}" for s in told)
    return finding


def write_finding(path: Path, content: Mapping[str, Any], curves: xr.Dataset | None, extended_too: bool = True) -> None:
    """Write the JSON file of a finding and, beside it, its curves and its campaign; remove curves of another."""
    write_json(path, content)
    extended = content.get("extended") or {}
    if extended_too and extended.get("file"):
        text = str(extended["text"])
        write_atomically(path.with_name(extended["file"]), lambda p: p.write_text(text, encoding="utf-8"))
    beside = path.with_suffix(CURVES)
    if curves is None:
        beside.unlink(missing_ok=True)
    else:
        write_groups(beside, {"curves": curves})


def extended_file(campaign: Campaign, path: Path) -> Path:
    """Return where the extended model of a finding is written: beside it, and never over a campaign that is not one."""
    beside = path.with_suffix(".toml")
    with contextlib.suppress(OSError, UnicodeDecodeError):
        same = beside.exists() and campaign.path.exists() and beside.samefile(campaign.path)
        if same or not beside.read_text(encoding="utf-8").startswith(HEAD):
            return path.with_name(f"{path.stem}_{NAME}.toml")
    return beside


def finding_of(
    campaign: Campaign,
    found: Mapping[str, Identification],
    suspects: Sequence[Suspect],
    progress: Progress = silent,
    kept: Path | None = None,
    happened: Mapping[str, str] | None = None,
) -> tuple[dict[str, Any], xr.Dataset | None]:
    """Return what ``finding.json`` holds, and the curves, of a campaign that was audited and identified already.

    A campaign whose files are those of an earlier run is not diagnosed again: its finding is read back from the folder
    `kept`. `happened` says of the file of each cutting test whether it was "stable" or "chatter".
    """
    path = None if kept is None else kept / f"finding-{_key(campaign, suspects, happened)}.json"
    out = None if kept is None else kept.parent / "finding.json"
    if path is not None and path.is_file():
        with contextlib.suppress(InputError, OSError, ValueError):
            beside = path.with_suffix(CURVES)
            return json.loads(path.read_text(encoding="utf-8")), (
                read_groups(beside)["curves"] if beside.is_file() else None
            )
    case = case_of(*_usable(campaign, Audit(list(suspects)).excluded, found), part(progress, 0.0, 0.1))
    finding, content = _tested(campaign, case, suspects, 0, part(progress, 0.1, 1.0), (), None, happened, found, out)
    if path is not None:
        for old in (*path.parent.glob("finding-*.json"), *path.parent.glob(f"finding-*{CURVES}")):
            old.unlink()
        write_finding(path, content, finding.curves, extended_too=False)
    return content, finding.curves


def _key(campaign: Campaign, suspects: Sequence[Suspect], happened: Mapping[str, str] | None) -> str:
    """Return a hash of all that a finding rests on: the files, what was noticed and judged, and this version."""
    hashes = [file_hash(f) for f in (campaign.path, *campaign.files)]
    settings = repr((__version__, FORM, suspects, sorted((happened or {}).items())))
    return hashlib.sha256("\n".join([settings, *hashes]).encode()).hexdigest()[:16]


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
    happened: Mapping[str, str] | None = None,
    measured: Mapping[str, Identification] | None = None,
    path: Path | None = None,
) -> tuple[Diagnosis, dict[str, Any]]:
    left_out = case.held_out_conditions(held_out)
    compliances = {name: item.compliance for name, item in (measured or {}).items()}
    worth = worth_of(campaign, case.family)
    finding = diagnose_family(with_known(case.family, campaign), seed, progress, left_out, workers, worth)
    # What the comparison had to leave out is said as well as what the audit did.
    faults = [*(s for s in suspects if s.level == "fault"), *(s for s in case.suspects if s.level == "warning")]
    finding = with_consequences(campaign, case.family, finding, left_out, happened, compliances, faults)
    said = Diagnosis(**{f.name: getattr(finding, f.name) for f in fields(finding)})
    made = extended_campaign(campaign, case.family, finding, Path.cwd() if path is None else path.parent)
    file = "" if path is None else extended_file(campaign, path).name
    content = {"campaign": campaign.name, **as_dict(finding, [*suspects, *case.suspects])}
    return said, {**content, "extended": {"file": file, "left_out": list(made.left_out), "text": made.text}}


def as_dict(finding: Finding, suspects: Sequence[Suspect]) -> dict[str, Any]:
    """Return what ``finding.json`` holds."""
    audited = as_rows(suspects)
    summary = list(finding.sentences)
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
