"""`smfe run`: from a campaign file to a folder of results.

Everything is computed before the first result is written, and all results become visible together (`smfe.staged`): a
folder of results belongs together. Only measurements and checks are kept at once, so that a second run
continues where the first stopped. Each part (a measurement, the lobes of one source, a cutting test, ...) fails alone:
what is asked of it is missing, every output says so in its place, and the rest is as it would have been.
"""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr

from process.errors import InputError
from smfe._version import __version__
from smfe.campaign import Campaign, Measurement, load_campaign
from smfe.campaign.datasets import Show
from smfe.commands.compare import compared, model_errors, single_levels
from smfe.commands.diagnose import finding_of, write_finding
from smfe.commands.identify import CONDITIONS, conditions_of, identify_all, left_out, with_warnings, write_conditions
from smfe.commands.report import report, report_of
from smfe.comparison.explained import explain
from smfe.comparison.peaks import all_peaks
from smfe.diagnosis.audit import audited
from smfe.diagnosis.checks.suspect import as_rows as suspect_rows
from smfe.identification.compliances import labelled
from smfe.identification.drive.drives import (
    DRIVE_FILE,
    LOOP_FILE,
    OPEN_LOOP_FILE,
    drives_of,
    loops_of,
    notes_of,
    open_loops_of,
    write_drives,
    write_loops,
    write_open_loops,
)
from smfe.identification.errors.result import Identification
from smfe.identification.levels import with_levels
from smfe.kept import (
    KEPT,
    campaign_of,
    file_hash,
    forget,
    inputs_of,
    is_unchanged,
    read_hashes,
    state,
    write_record,
)
from smfe.limits.campaign_lobes import LobeResult, all_lobes
from smfe.limits.cutting_tests import Verdicts, judge_all, write_verdicts
from smfe.limits.lobe_files import MADE, write_lobes
from smfe.limits.ranking import DIFFERENCES, RANKING, ranked, write_ranking
from smfe.limits.recommendation import coefficients_assumption
from smfe.progress import Progress, part, parts, silent, warn
from smfe.results import (
    MEASUREMENT,
    Failures,
    as_rows,
    attempt,
    check_target,
    pack,
    unpack,
    unpack_warnings,
    write_csv,
    write_groups,
    write_json,
)
from smfe.staged import held, together

MAY_BE_GONE = (
    *(*MADE, "chatter.csv", "spectra.nc", RANKING, DIFFERENCES, LOOP_FILE, OPEN_LOOP_FILE, DRIVE_FILE, CONDITIONS),
    *("finding.json", "finding.nc"),
)
"""Files that a folder holds only while the campaign asks for them."""


@dataclass
class Notes:
    """What happened on the way: seconds a stage, warnings, what failed, and what the check of the data found."""

    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    failures: Failures = field(default_factory=list)
    check: list[dict[str, str]] = field(default_factory=list)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 3)


def run(
    campaign: Path | str | Campaign,
    out: Path | str,
    fresh: bool = False,
    progress: Progress = silent,
    licence: Show | None = None,
    draw: bool = True,
    ahead: Callable[[Progress], object] | None = None,
) -> Path:
    """Do everything that a campaign asks for and write the results.

    It starts with the audit of `smfe check`: a measurement or cutting test with a fault is left out, and has failed.

    Parameters
    ----------
    campaign : path or Campaign
        Campaign file, or what `smfe.read_campaign` read.
    out : path
        Folder of the results; made when missing.
    fresh : bool, optional
        Compute everything again instead of reading back what an earlier run has kept. Without it, a folder that holds
        what this run would write is left as it is, and parts of which nothing has changed are read back.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched; without it nothing is fetched.
    draw : bool, optional
        Whether the report and its pictures are written, too; `report` writes them later.
    ahead : callable, optional
        Called with a progress before anything is identified: what it keeps in `KEPT` is read back.

    Returns
    -------
    Path
        The report, or where it would stand. What failed stands in ``provenance.json`` beside it, as a list
        ``failures`` of objects with part, name and reason, and in its place in every other file; the rest is as it
        would have been without.

    Raises
    ------
    InputError
        When the campaign file is wrong or the results cannot be written; no result is then written or touched.

    Warns
    -----
    SmfeWarning
        What must be known of the results, and what failed; both also stand in ``provenance.json`` and in the report.
    """
    folder, notes = Path(out), Notes()
    if isinstance(campaign, Path | str) and not fresh and is_unchanged(Path(campaign), folder):
        said = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
        warn([*said["warnings"], *(f"failed, {failure.sentence}" for failure in unpack(said))])
        page = folder / "report.html"
        return report(folder, progress) if draw and not page.is_file() else page
    loaded = load_campaign(campaign, licence)
    check_folder(folder, loaded, fresh)
    # A campaign in memory may be another than its file.
    inputs = inputs_of(loaded.path, loaded.files) if isinstance(campaign, Path | str) else None
    with held(folder):
        if fresh:
            forget(folder)
        page = _run(loaded, folder, notes, progress, draw, ahead)
        # What failed for want of memory, a disk or a network is tried again by the next run.
        if inputs is not None and not any(failure.outside for failure in notes.failures):
            write_record(folder, inputs)
    warn([*notes.warnings, *(f"failed, {failure.sentence}" for failure in notes.failures)])
    return page


def _run(
    loaded: Campaign,
    folder: Path,
    notes: Notes,
    progress: Progress,
    draw: bool,
    ahead: Callable[[Progress], object] | None,
) -> Path:
    """Compute everything, then write all of it in one step; return the report."""
    failures = notes.failures
    of = parts(progress, costs(loaded, draw))
    with notes.timed("check"):
        if ahead is not None:
            ahead(part(of["check"], 0.0, 0.9))
        read_hashes(folder / KEPT)
        checked = audited(loaded, of["check"], folder / KEPT)
        failures += checked.excluded
        notes.check = suspect_rows(checked.suspects)
        checked.identified.clear()  # kept, and read back below: not twice in memory
    with notes.timed("identify"):
        found, levels = identify_all(loaded, folder / KEPT, of["identify"], failures)
        loops, open_loops = loops_of(loaded, failures), open_loops_of(loaded, failures)
        drives = drives_of(loaded, failures, part(of["identify"], 0.9, 1.0))
    whole = with_levels(loaded)
    compliances = labelled(whole, found)
    cubes, unstacked = conditions_of(loaded, compliances, levels, folder / KEPT, failures)
    comparison, explained, errors = compared({}), explain({}), model_errors({}, ())
    with notes.timed("compare"):
        of["compare"]("comparing", 0, 1)
        single, peaks = single_levels({n: compliances[n] for n in found}), None
        with attempt(failures, "comparison"):
            peaks = all_peaks(single)
            comparison = compared(single, peaks)
        with attempt(failures, "comparison", "what feed, level and method explain"):
            explained = explain(single, peaks)
        with attempt(failures, "comparison", "with the models"):
            errors = model_errors(found, loaded.models)
    with notes.timed("lobes"):
        results = all_lobes(whole, compliances, of["lobes"], failures, folder / KEPT)
    with notes.timed("cutting tests"):
        verdicts = judge_all(whole, compliances, of["cutting tests"], failures, folder / KEPT)
    finding = None
    with notes.timed("diagnosis"), attempt(failures, "diagnosis"):
        if loaded.baseline is not None:
            happened = {r["file"]: str(r.get("observed") or r["verdict"]) for r in verdicts.rows}
            finding = finding_of(loaded, found, checked.suspects, of["diagnosis"], folder / KEPT, happened)
    gone = {f.name for f in failures if f.part == MEASUREMENT}
    told = {*found, *loops, *open_loops, *drives, *gone}
    notes.warnings += [left_out(m) for m in loaded.measurements if m.name not in told]
    notes.warnings += [f"{name}: {note}" for name, loop in loops.items() for note in loop.notes]
    notes.warnings += [f"{name}: {note}" for name, one in open_loops.items() for note in one.notes]
    notes.warnings += notes_of(drives)
    notes.warnings += _warnings(found, results, verdicts)
    if results and not loaded.coefficient_spread:  # a default, or declared to be exact: either way it is said
        notes.warnings.append(coefficients_assumption(loaded))
    notes.warnings += unstacked
    notes.warnings += [
        f"{s.where}: {s.evidence}; {s.advice}"
        for s in checked.suspects
        if s.level == "warning" or (s.level == "fault" and not s.excludes)
    ]
    # From here on nothing depends on the input any more.
    with together(folder, MAY_BE_GONE) as new:
        _write_identifications(new, compliances, found, failures)
        write_loops(new / LOOP_FILE, loops, new / "tables")
        write_open_loops(new / OPEN_LOOP_FILE, open_loops)
        write_drives(new / DRIVE_FILE, drives, new / "tables", open_loops)
        write_conditions(new / CONDITIONS, cubes)
        write_csv(new / "comparison.csv", comparison)
        write_csv(new / "explained.csv", explained)
        write_csv(new / "model_error.csv", errors)
        write_lobes(new, results, loaded, verdicts.rows, failures)
        write_verdicts(new, verdicts)
        write_ranking(new, ranked(whole, verdicts.rows))
        if finding is not None:
            write_finding(new / "finding.json", *finding)
        diagnosed = {} if finding is None else {key: finding[0][key] for key in ("verdict", "summary")}
        write_json(new / "provenance.json", _provenance(loaded, notes, diagnosed))
        if draw:
            report_of(new, of["report"])
        else:
            shutil.rmtree(new / "figures", ignore_errors=True)  # of other results
    return folder / "report.html"


def check_folder(folder: Path, campaign: Campaign, fresh: bool = False) -> None:
    """Refuse a folder that cannot take the results of a campaign; asked before work begins.

    Raises
    ------
    InputError
        When it is a file, cannot be written, holds the results of another campaign (which `fresh` replaces), or a
        folder of another's that a run would clear.
    """
    check_target(folder / "report.html")
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"'{there}' cannot be written by you; name another folder with --out")
    for inside in (KEPT, "figures", "tables"):
        if (folder / inside).is_file():
            raise InputError(f"'{folder / inside}' is a file where a folder is needed; move it away")
    for pattern in ("*.nc", "*.csv", "*.json"):
        for result in folder.glob(pattern):
            check_target(result)
    kept = folder / "provenance.json"
    if not kept.is_file():
        if (folder / "tables").exists():
            raise InputError(
                f"'{folder}' holds a folder 'tables' and no results, and a run would clear it: name another with --out"
            )
        return
    try:
        other = json.loads(kept.read_text(encoding="utf-8")).get("campaign")
    except (ValueError, AttributeError):
        return
    if other != campaign.name and campaign_of(folder) != campaign.path and not fresh:
        raise InputError(
            f"'{folder}' holds the results of another campaign, '{other}'; name another folder with --out, or replace "
            "them with --fresh"
        )


def costs(campaign: Campaign, draw: bool = True) -> dict[str, float]:
    """Return what each part of a run takes beside the others: about its seconds on an ordinary computer.

    The check identifies the measurements, so that their records count there.
    """
    size = sum(state(file)[0] for file in campaign.files) / 1e6
    slow = sum(10.0 for request in campaign.lobes if request.method == "semi_discretization")
    slow += sum(5.0 for r in campaign.lobes if r.maps_up_to or r.deflection or r.surface_error)
    sources = sum(len(request.measurements) for request in campaign.lobes)
    return {
        "check": 1.0 + 0.1 * size + len(campaign.measurements),
        "identify": 0.1 * len(campaign.measurements),
        "compare": 0.2 * len(campaign.measurements),
        "lobes": 0.5 * sources + slow,
        "cutting tests": 0.4 * len(campaign.cutting_tests),
        "diagnosis": 30.0 if campaign.baseline is not None else 0.0,
        "report": 8.0 if draw else 0.0,
    }


def _warnings(found: Mapping[str, Identification], lobes: Sequence[LobeResult], verdicts: Verdicts) -> list[str]:
    out = [f"{name}: {w}" for name, item in found.items() for w in item.warnings]
    out += [f"{r.request}, {r.source}: {w}" for r in lobes for w in unpack_warnings(r.lobes)]
    out += verdicts.warnings
    return out + [f"{r['file']}: undecided: {r['reason']}" for r in verdicts.rows if r["verdict"] == "undecided"]


def _write_identifications(
    folder: Path, compliances: Mapping[str, xr.Dataset], found: Mapping[str, Identification], failures: Failures
) -> None:
    missing = pack(f for f in failures if f.part == MEASUREMENT)
    write_groups(folder / "frf.nc", with_warnings(compliances, found), missing)
    for name, item in found.items():
        for table, frame in item.tables.items():
            write_csv(folder / "tables" / f"{name}.{table}.csv", frame)


def _started(measurement: Measurement) -> str | None:
    """Return when a measurement was made: as it says, else the first of its records that do."""
    said = [measurement.started, *sorted((e.started for e in measurement.records if e.started is not None), key=str)]
    return next((when.isoformat() for when in said if when is not None), None)


def _provenance(campaign: Campaign, notes: Notes, finding: Mapping[str, Any]) -> dict[str, Any]:
    packages = ("smfe", "numpy", "scipy", "numba", "xarray", "pandas", "h5netcdf")
    return {
        "campaign": campaign.name,
        "machine": campaign.machine,
        "tool": campaign.tool_name,
        "material": campaign.material or "",
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {"smfe": __version__, **{p: importlib.metadata.version(p) for p in packages[1:]}},
        "inputs": [{"file": f.name, "sha256": file_hash(f)} for f in (campaign.path, *campaign.files)],
        "settings": {m.name: m.settings() for m in campaign.measurements},
        "started": {m.name: when for m in campaign.measurements if (when := _started(m)) is not None},
        "seconds": notes.seconds,
        "warnings": notes.warnings,
        "failures": as_rows(notes.failures),
        "check": notes.check,
        **({"finding": dict(finding)} if finding else {}),
    }
