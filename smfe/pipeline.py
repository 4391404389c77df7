"""From a campaign file to a folder of results.

Each verb here is a command of the same name: `run`, `demo`, `identify`, `modal`, `compare`, `lobes`, `chatter`,
`report`.
Everything is computed before the first result is written, and every file is written to a temporary name and moved into
place: a folder of results belongs together. Only identified measurements are kept at once, so that a second run
continues where the first stopped. Each part (a measurement, the lobes of one source, a cutting test, ...) fails alone:
what is asked of it is missing, every output says so in its place, and the rest is as it would have been.
"""

from __future__ import annotations

import datetime
import importlib.metadata
import math
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import AXES, full_matrix, make_compliance, not_measured
from process.units import parse
from smfe import __version__
from smfe.campaign import Campaign, Measurement, Model, load_campaign, load_channels
from smfe.campaign.datasets import Show
from smfe.campaign.quantities import COMPLIANCE_METHODS
from smfe.commands.diagnose import finding_of
from smfe.comparison.compare import compare as compare_compliances
from smfe.comparison.compliances import labelled
from smfe.comparison.explained import explain
from smfe.demo_campaign import DEMO_SEED, write_demo
from smfe.diagnosis.audit import audited
from smfe.diagnosis.checks.suspect import as_rows as suspect_rows
from smfe.identification.drive.drives import FILE as DRIVE_FILE
from smfe.identification.drive.drives import drives_of, notes_of, write_drives
from smfe.identification.drive.loops import FILE as LOOP_FILE
from smfe.identification.drive.loops import loops_of, write_loops
from smfe.identification.errors.result import Identification, Progress, silent
from smfe.identification.levels import belongs, condition_cubes, level_cubes, with_levels
from smfe.identification.measurement import cached_identification, check_sweep, file_hash, split_levels
from smfe.limits.campaign_lobes import LobeResult, all_lobes, joined, write_lobes
from smfe.limits.cutting_tests import Verdicts, judge_all, write_verdicts
from smfe.modal_verb import modal as modal
from smfe.records import OWN_COLUMNS, Channel, column_names, names_itself, read_records
from smfe.records.contents import has_no_clock, stated_units
from smfe.records.formats.channels import listed
from smfe.results import (
    MEASUREMENT,
    Failures,
    as_rows,
    attempt,
    check_target,
    pack,
    pack_warnings,
    read_groups,
    unpack_warnings,
    write_csv,
    write_groups,
    write_json,
)
from stability import ChatterVerdict, chatter_verdict, write_table
from stability.chatter.criterion import FREQUENCY_RANGE

CONDITIONS = "conditions.nc"
"""File of what was measured at several levels or feeds."""

KEPT = ".kept"
"""Folder, inside the results, of what a second run reads back."""

DEFAULT_CHANNELS: tuple[tuple[str, Channel], ...] = (*OWN_COLUMNS.items(), ("sound", Channel("p", "Pa")))
"""Columns that are looked for in a file when no campaign declares others: those that `smfe convert` and `smfe simulate`
write. A unit that the file states itself takes the place of the one here."""


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
    campaign: Path | str,
    out: Path | str,
    fresh: bool = False,
    progress: Progress = silent,
    licence: Show | None = None,
) -> Path:
    """Do everything that a campaign asks for and write the results.

    It starts with the audit of `smfe check`: a measurement or cutting test with a fault is left out, and has failed.

    Parameters
    ----------
    campaign : path
        Campaign file.
    out : path
        Folder of the results; made when missing.
    fresh : bool, optional
        Identify every measurement again instead of reading back what an earlier run has kept.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched; without it nothing is fetched.

    Returns
    -------
    Path
        The report. What failed stands in ``provenance.json`` beside it, as a list ``failures`` of objects with part,
        name and reason, and in its place in every other file; the rest is as it would have been without.

    Raises
    ------
    InputError
        When the campaign file is wrong or the results cannot be written; no result is then written or touched.
    """
    loaded, folder, notes = load_campaign(Path(campaign), licence), Path(out), Notes()
    failures = notes.failures
    check_target(folder / "report.html")
    if fresh:
        shutil.rmtree(folder / KEPT, ignore_errors=True)
    with notes.timed("check"):
        checked = audited(loaded, progress, folder / KEPT)
        failures += checked.excluded
        notes.check = suspect_rows(checked.suspects)
    with notes.timed("identify"):
        found, levels = _identify_all(loaded, folder / KEPT, progress, failures)
        loops = loops_of(loaded, failures)
        drives = drives_of(loaded, failures, progress)
    whole = with_levels(loaded)
    compliances = labelled(whole, found)
    cubes, unstacked = _conditions_of(loaded, compliances, levels, folder / KEPT, failures)
    comparison, explained, errors = _comparison({}), explain({}), model_errors({}, ())
    with notes.timed("compare"):
        progress("comparing", 0, 1)
        told = _told_apart({n: compliances[n] for n in found})
        with attempt(failures, "comparison"):
            comparison = _comparison(told)
        with attempt(failures, "comparison", "what feed, level and method explain"):
            explained = explain(told)
        with attempt(failures, "comparison", "with the models"):
            errors = model_errors(found, loaded.models)
    with notes.timed("lobes"):
        results = all_lobes(whole, compliances, progress, failures)
    with notes.timed("cutting tests"):
        verdicts = judge_all(whole, compliances, progress, failures)
    finding = None
    with notes.timed("diagnosis"), attempt(failures, "diagnosis"):
        finding = finding_of(loaded, found, checked.suspects, progress) if loaded.baseline is not None else None
    gone = {f.name for f in failures if f.part == MEASUREMENT}
    notes.warnings += [_left_out(m) for m in loaded.measurements if m.name not in {*found, *loops, *drives, *gone}]
    notes.warnings += [f"{name}: {note}" for name, loop in loops.items() for note in loop.notes]
    notes.warnings += notes_of(drives)
    notes.warnings += _warnings(found, results, verdicts)
    notes.warnings += unstacked
    notes.warnings += [
        f"{s.where}: {s.evidence}; {s.advice}"
        for s in checked.suspects
        if s.level == "warning" or (s.level == "fault" and not s.excludes)
    ]
    # From here on nothing depends on the input any more.
    _write_identifications(folder, compliances, found, failures)
    write_loops(folder / LOOP_FILE, loops, folder / "tables")
    write_drives(folder / DRIVE_FILE, drives, folder / "tables")
    _write_cubes(folder / CONDITIONS, cubes)
    write_csv(folder / "comparison.csv", comparison)
    write_csv(folder / "explained.csv", explained)
    write_csv(folder / "model_error.csv", errors)
    write_lobes(folder, results, loaded, failures)
    write_verdicts(folder, verdicts)
    if finding is None:
        (folder / "finding.json").unlink(missing_ok=True)
    else:
        write_json(folder / "finding.json", finding)
    write_json(folder / "provenance.json", _provenance(loaded, notes))
    return report(folder, progress)


def demo(out: Path | str, seed: int = DEMO_SEED, progress: Progress = silent) -> Path:
    """Simulate a whole measuring campaign, write it to ``out/`` and run it into ``out/results``.

    Records and campaign file are made anew each time; the same seed makes the same records.
    """
    folder = Path(out)
    return run(write_demo(folder, seed, progress), folder / "results", progress=progress)


def report(folder: Path | str, progress: Progress = silent) -> Path:
    """Write the report of a folder of results again."""
    # Drawing stays out of the numerics: only the composition imports it, and only where it is called.
    from smfe.reporting import write_report

    progress("writing the report", 0, 1)
    return write_report(Path(folder))


def identify(
    campaign: Path | str,
    output: Path | str,
    progress: Progress = silent,
    licence: Show | None = None,
    failures: Failures | None = None,
) -> dict[str, Identification]:
    """Identify every measurement of a campaign and write the compliances to one NetCDF file.

    A sweep at several depths of cut is identified at each of them, too. As after `run`, `conditions.nc` beside the file
    holds what was measured at several levels or feeds, ``loops.nc`` the responses of drive loops and ``drives.csv`` the
    inertia and friction of drives, which are no compliances; where the campaign has none, such a file of an earlier run
    is taken away.

    Parameters
    ----------
    campaign, output : path
        Campaign file; file to write.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched.
    failures : list of Failure, optional
        Collects measurements that cannot be identified, which the file names in its attribute ``failures``; the rest
        is written. None: the first one is raised, and nothing is written.

    Raises
    ------
    InputError
        When the campaign file is wrong, the output has the name of one of the files beside it, or nothing at all can
        be identified.
    """
    path = Path(output)
    if path.name in (CONDITIONS, LOOP_FILE, DRIVE_FILE):
        raise InputError(f"{path.name} is what another file beside the compliances is called; write to frf.nc")
    loaded = load_campaign(Path(campaign), licence)
    check_target(path)
    found, levels = _identify_all(loaded, path.parent / KEPT, progress, failures)
    loops, drives = loops_of(loaded, failures), drives_of(loaded, failures, progress)
    compliances = labelled(with_levels(loaded), found)
    cubes, _ = _conditions_of(loaded, compliances, levels, path.parent / KEPT, failures)
    _require_something([*found, *loops, *drives], failures)
    write_groups(path, _groups(compliances, found), pack(failures or ()))
    write_loops(path.with_name(LOOP_FILE), loops)
    write_drives(path.with_name(DRIVE_FILE), drives)
    _write_cubes(path.with_name(CONDITIONS), cubes)
    return found


def compare(frf: Path | str, output: Path | str | None = None) -> pd.DataFrame:
    """Compare the measurements of a compliance file peak by peak; optionally write the table.

    Beside it, `explained.csv` says what feed, level, controller and method explain of the differences. Of a sweep at
    several depths of cut these are compared, and not the estimate of all its passes together.
    """
    groups = _told_apart({n: d for n, d in read_groups(Path(frf)).items() if d.attrs.get("method") != "model"})
    table = compare_compliances(groups)
    if output is not None:
        write_csv(Path(output), table)
        write_csv(Path(output).with_name("explained.csv"), explain(groups))
    return table


def lobes(
    campaign: Path | str,
    output: Path | str,
    table: Path | str | None = None,
    frf: Path | str | None = None,
    progress: Progress = silent,
    failures: Failures | None = None,
) -> list[LobeResult]:
    """Compute the lobes that a campaign asks for, from its records or from a compliance file.

    Parameters
    ----------
    campaign, output : path
        Campaign file; file of the lobes.
    table : path, optional
        CSV lobe table.
    frf : path, optional
        Compliances of an earlier run.
    progress : callable, optional
        Called with (what, done, of).
    failures : list of Failure, optional
        Collects measurements and requests that fail, which the file names in its attribute ``failures``; the rest is
        written. None: the first one is raised, and nothing is written.

    Raises
    ------
    InputError
        When the campaign file is wrong, or no lobes at all can be computed.
    """
    loaded, path = load_campaign(Path(campaign)), Path(output)
    if not loaded.lobes:
        raise InputError(f"{campaign}: it asks for no lobes; add a [[lobes]] table")
    check_target(path)
    if frf is not None:
        compliances = read_groups(Path(frf))
    else:
        found, _ = _identify_all(loaded, path.parent / KEPT, progress, failures)
        compliances = labelled(with_levels(loaded), found)
    results = all_lobes(with_levels(loaded), compliances, progress, failures)
    _require_something(results, failures)
    write_groups(path, {f"{r.request}/{r.source}": r.lobes for r in results}, pack(failures or ()))
    if table is not None:
        write_table(joined(results), Path(table))
    return results


def chatter(
    record: Path | str,
    speed: str | None,
    teeth: int,
    campaign: Path | str | None = None,
    *,
    quantity: str | None = None,
    interval: tuple[float, float] | None = None,
    axes: Sequence[str] | None = None,
    frequency_range: tuple[float, float] | None = None,
    floor: float | None = None,
    half_order_reference: float | None = None,
) -> ChatterVerdict:
    """Judge one record of a cut by the spectral criterion.

    Parameters
    ----------
    record : path
        File of the record.
    speed : str or None
        Spindle speed with its unit, "500 rpm"; None: what the record states or its lines give away.
    teeth : int
        Number of teeth.
    campaign : path, optional
        Campaign file whose [channels] tell the columns; default: those of `DEFAULT_CHANNELS` that the file has, and the
        first channel of a WAV file as sound.
    quantity, interval, axes, frequency_range, floor, half_order_reference
        As of `stability.chatter_verdict`.

    Raises
    ------
    InputError
        For a record that cannot be read or judged; where no column is known, the columns of the file are listed.
    """
    rotation = None if speed is None else parse(speed, "rotation")
    path = Path(record)
    if campaign is not None:
        records = read_records(path, load_channels(Path(campaign)))
    elif path.suffix.lower() == ".wav":
        # Shares of full scale: how many Pa that is does not matter to a ratio.
        records = read_records(path, {"sound": Channel(1, "Pa")})
    else:
        records = read_default_channels(path)
    return chatter_verdict(
        records[0],
        rotation,
        teeth,
        quantity=quantity,
        axes=axes,
        frequency_range=frequency_range or FREQUENCY_RANGE,
        floor=floor,
        interval=interval,
        half_order_reference=half_order_reference,
    )


def read_default_channels(path: Path) -> list[xr.Dataset]:
    """Read those of `DEFAULT_CHANNELS` that a file has; anything else that is wrong with it stays an error."""
    return read_records(path, default_channels(path))


def default_channels(path: Path) -> dict[str, Channel]:
    """Return those of `DEFAULT_CHANNELS` that a file has, in the units that it states, where it does.

    Raises
    ------
    InputError
        When the file cannot be read, or has the time alone or none of them.
    """
    if names_itself(path):
        return {}
    names = column_names(path)
    units = stated_units(path, names)
    # A channel that only one group has needs no group: "run 1/ax" is "ax".
    inside = [str(name).rpartition("/")[2] for name in names]
    known = {n: full for n, full in zip(inside, names, strict=True) if inside.count(n) == 1} | {n: n for n in names}
    found: dict[str, Channel] = {}
    for name, channel in DEFAULT_CHANNELS:
        if channel.column in known and name not in found:
            column = known[channel.column]
            found[name] = replace(channel, column=column, unit=units.get(column, channel.unit) or channel.unit)
    if not found.keys() - {"time"} or ("time" not in found and has_no_clock(path)):
        raise InputError(_no_default_channels(path))
    return found


def _no_default_channels(path: Path) -> str:
    time, *rest = (f"{channel.column} [{channel.unit}]" for _, channel in DEFAULT_CHANNELS)
    return (
        f"{path.name}: looked for the columns {time}, {', '.join(rest)}; the time and at least one of the others are "
        f"needed, and the file has {listed(column_names(path))}: rename the columns, or give the campaign file whose "
        f"[channels] declare them (smfe look {path.name} writes one)"
    )


def _require_something(found: Sequence[object], failures: Failures | None) -> None:
    """Refuse to write a file in which everything failed: an older one says more."""
    if failures and not found:
        raise InputError("\n  ".join(["nothing could be computed", *(f.sentence for f in failures)]))


def _identify_all(
    campaign: Campaign, kept: Path, progress: Progress, failures: Failures | None = None
) -> tuple[dict[str, Identification], dict[str, xr.Dataset]]:
    """Return all measurements and levels of sweeps, and the latter as arrays over the depth of cut."""
    whole = with_levels(campaign)
    possible = []
    for measurement in whole.measurements:
        if any(f.part == MEASUREMENT and belongs(campaign, measurement.name, f.name) for f in failures or ()):
            continue
        with attempt(failures, MEASUREMENT, measurement.name):
            check_sweep(whole, measurement)
            possible.append(measurement)
    found = {}
    for i, measurement in enumerate(possible):
        if measurement.method not in COMPLIANCE_METHODS:
            progress(_left_out(measurement), i, len(possible))
            continue
        progress(f"identifying {measurement.name}", i, len(possible))
        with attempt(failures, MEASUREMENT, measurement.name):
            found[measurement.name], _ = cached_identification(campaign, measurement, kept, progress)
    pooled: dict[str, Identification] = {}
    cubes: dict[str, xr.Dataset] = {}
    with attempt(failures, "levels of the sweeps"):
        pooled, cubes = level_cubes(campaign, found)
    return found | pooled, cubes


def _conditions_of(
    campaign: Campaign,
    compliances: Mapping[str, xr.Dataset],
    levels: Mapping[str, xr.Dataset],
    kept: Path,
    failures: Failures | None,
) -> tuple[dict[str, xr.Dataset], list[str]]:
    """Return what ``conditions.nc`` holds, and what could not be stacked.

    Measurements are stacked by the depth of cut of their records; levels of one sweep are stacked already.
    """
    names = {m.name for m in campaign.measurements}
    whole = [m for m in with_levels(campaign).measurements if m.name in names]
    stacked, notes = condition_cubes(whole, compliances)
    return {**levels, **stacked, **split_levels(campaign, kept, failures)}, notes


def _told_apart(compliances: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Leave out estimates of several levels together, whose passes are in those of the single levels."""
    return {name: dataset for name, dataset in compliances.items() if "levels" not in dataset.attrs}


def _left_out(measurement: Measurement) -> str:
    if measurement.method == "loop":
        return f"{measurement.name}: a loop gives no compliance; its response stands in {LOOP_FILE}"
    if measurement.method == "drive":
        return f"{measurement.name}: a drive gives no compliance; its inertia and friction stand in {DRIVE_FILE}"
    return f"{measurement.name}: method '{measurement.method}' gives no compliance; only a diagnosis reads it"


def _comparison(measured: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Compare; without any measurement the table has its columns and no rows, as it has with a single one."""
    nothing = make_compliance([0.0], np.full((1, 1, 1), complex(math.nan)), AXES[:1], AXES[:1])
    return compare_compliances(measured or {"": nothing})


def _groups(compliances: Mapping[str, xr.Dataset], found: Mapping[str, Identification]) -> dict[str, xr.Dataset]:
    return {n: pack_warnings(d, found[n].warnings if n in found else ()) for n, d in compliances.items()}


def _warnings(found: Mapping[str, Identification], lobes: Sequence[LobeResult], verdicts: Verdicts) -> list[str]:
    out = [f"{name}: {w}" for name, item in found.items() for w in item.warnings]
    out += [f"{r.request}, {r.source}: {w}" for r in lobes for w in unpack_warnings(r.lobes)]
    out += verdicts.warnings
    return out + [f"{r['file']}: undecided: {r['reason']}" for r in verdicts.rows if r["verdict"] == "undecided"]


def _write_cubes(path: Path, cubes: Mapping[str, xr.Dataset]) -> None:
    if cubes:
        write_groups(path, cubes)
    else:
        path.unlink(missing_ok=True)


def _write_identifications(
    folder: Path, compliances: Mapping[str, xr.Dataset], found: Mapping[str, Identification], failures: Failures
) -> None:
    missing = pack(f for f in failures if f.part == MEASUREMENT)
    write_groups(folder / "frf.nc", _groups(compliances, found), missing)
    shutil.rmtree(folder / "tables", ignore_errors=True)
    for name, item in found.items():
        for table, frame in item.tables.items():
            write_csv(folder / "tables" / f"{name}.{table}.csv", frame)


def model_errors(found: Mapping[str, Identification], models: Sequence[Model]) -> pd.DataFrame:
    """Return how far each measured entry is from each declared model.

    ``error = sqrt(mean |measured - model|^2 / mean |model|^2)`` over the frequencies where the entry was measured.

    Parameters
    ----------
    found : mapping of str to Identification
        Measurements.
    models : sequence of Model
        Declared modal models.

    Returns
    -------
    pandas.DataFrame
        measurement, model, response, excitation, from_Hz, to_Hz, error_percent.
    """
    rows: list[dict[str, Any]] = []
    for model in models:
        for name, item in found.items():
            array = item.compliance["compliance"]
            truth = model.modal.matrix(item.compliance["frequency"].values)
            measured = full_matrix(item.compliance)
            missing = not_measured(item.compliance)
            for i, r in enumerate(AXES):
                for j, e in enumerate(AXES):
                    if r not in array["response"].values or e not in array["excitation"].values:
                        continue
                    if missing.sel(response=r, excitation=e):
                        continue
                    valid = np.isfinite(measured[:, i, j])
                    f = item.compliance["frequency"].values[valid]
                    error = np.mean(np.abs(measured[valid, i, j] - truth[valid, i, j]) ** 2)
                    rows.append(
                        {
                            "measurement": name,
                            "model": model.name,
                            "response": r,
                            "excitation": e,
                            "from_Hz": f[0],
                            "to_Hz": f[-1],
                            "error_percent": 100.0 * math.sqrt(error / np.mean(np.abs(truth[valid, i, j]) ** 2)),
                        }
                    )
    columns = ["measurement", "model", "response", "excitation", "from_Hz", "to_Hz", "error_percent"]
    return pd.DataFrame(rows, columns=columns)


def _provenance(campaign: Campaign, notes: Notes) -> dict[str, Any]:
    packages = ("smfe", "numpy", "scipy", "numba", "xarray", "pandas", "h5netcdf")
    return {
        "campaign": campaign.name,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {"smfe": __version__, **{p: importlib.metadata.version(p) for p in packages[1:]}},
        "inputs": [{"file": f.name, "sha256": file_hash(f)} for f in (campaign.path, *campaign.files)],
        "settings": {m.name: m.settings() for m in campaign.measurements},
        "seconds": notes.seconds,
        "warnings": notes.warnings,
        "failures": as_rows(notes.failures),
        "check": notes.check,
    }
