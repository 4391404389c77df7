"""`smfe identify`: measurements of a campaign, or records in memory -> compliances with uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

import xarray as xr

from process.cut.tool import Tool
from process.errors import InputError
from smfe.arrays.records import Records, measured
from smfe.campaign import Campaign, Measurement, load_campaign
from smfe.campaign.datasets import Show
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.identification.compliances import labelled
from smfe.identification.drive.drives import (
    DRIVE_FILE,
    LOOP_FILE,
    OPEN_LOOP_FILE,
    drives_of,
    loops_of,
    open_loops_of,
    write_drives,
    write_loops,
    write_open_loops,
)
from smfe.identification.errors.result import Identification
from smfe.identification.levels import belongs, condition_cubes, level_cubes, with_levels
from smfe.identification.measurement import (
    cached_identification,
    check_sweep,
    identify_measurement,
    split_levels,
)
from smfe.kept import KEPT
from smfe.progress import Progress, part, silent, step, warn
from smfe.results import (
    MEASUREMENT,
    Failures,
    attempt,
    check_target,
    pack,
    pack_warnings,
    require_something,
    write_groups,
)

CONDITIONS = "conditions.nc"
"""File of what was measured at several levels or feeds."""


@overload
def identify(
    source: Path | str | Campaign,
    output: Path | str | None = None,
    progress: Progress = silent,
    licence: Show | None = None,
    failures: Failures | None = None,
) -> dict[str, Identification]: ...


@overload
def identify(
    source: Records,
    output: Path | str | None = None,
    progress: Progress = silent,
    *,
    method: str,
    tool: Tool | Mapping[str, Any] | None = None,
    name: str | None = None,
    **settings: Any,
) -> Identification: ...


def identify(
    source: Path | str | Campaign | Records,
    output: Path | str | None = None,
    progress: Progress = silent,
    licence: Show | None = None,
    failures: Failures | None = None,
    *,
    method: str | None = None,
    tool: Tool | Mapping[str, Any] | None = None,
    name: str | None = None,
    **settings: Any,
) -> dict[str, Identification] | Identification:
    """Identify compliances: those of all measurements of a campaign, or that of records in memory.

    Of a campaign the compliances go to one NetCDF file. A sweep at several depths of cut is identified at each of them,
    too. As after `run`, `conditions.nc` beside the file holds what was measured at several levels or feeds,
    ``loops.nc`` and ``open_loops.nc`` the responses of drives and ``drives.csv`` their inertia, friction and open loop,
    which are no compliances; where the campaign has none, such a file of an earlier run is taken away.

    Parameters
    ----------
    source : path, Campaign, xarray.Dataset, sequence of them, or mapping of axis to them
        Campaign; or records, as `smfe.record` and `smfe.read_records` return them. Of hammer and actuator the mapping
        says which axis was excited: ``{"x": taps_x, "y": taps_y}``.
    output : path, optional
        NetCDF file to write. None: nothing is written.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched.
    failures : list of Failure, optional
        With a campaign: collects measurements that cannot be identified, which the file names in its attribute
        ``failures``; the rest is written. None: the first one is raised, and nothing is written.
    method : {"hammer", "actuator", "sweep"}
        Of records: how they were measured.
    tool : Tool or mapping, optional
        Of a sweep: the tool, or the keys of ``[tool]``.
    name : str, optional
        Of records: what the measurement is called; default: the method.
    **settings
        Of records: further keys of a ``[[measurement]]``; numbers are SI, e.g. ``frequency_range=(20, 400)``,
        ``resolution="0.5 Hz"``, ``accelerometer_mass="12 g"``, ``feed="500 mm/min"``.

    Returns
    -------
    dict of str to Identification, or Identification
        Of a campaign by measurement, of records the one. ``Identification.compliance`` is
        ``compliance(frequency, response, excitation)`` [m/N] with its error.

    Raises
    ------
    InputError
        When the campaign or a setting is wrong, the output has the name of one of the files beside it, or nothing at
        all can be identified.

    Warns
    -----
    SmfeWarning
        What must be known of the compliances; it also stands in ``Identification.warnings``.

    Examples
    --------
    >>> taps = smfe.record(51200, force_x=force, acceleration_x=(acceleration, "g"))
    >>> hammer = smfe.identify(taps, method="hammer")
    """
    if isinstance(source, Path | str | Campaign):
        if method is not None or settings:
            raise InputError("a campaign says its methods and settings itself; method and settings are for records")
        every = _of_campaign(source, output, progress, licence, failures)
        warn(f"{n}: {w}" for n, one in every.items() for w in one.warnings)
        return every
    if method is None:
        raise InputError('records need their method: method="hammer", "actuator" or "sweep"')
    campaign, measurement = measured(source, method, tool, name or method, settings)
    check_sweep(campaign, measurement)
    path = None if output is None else Path(output)
    if path is not None:
        check_target(path)
    found = identify_measurement(campaign, measurement, progress)
    said = labelled(campaign, {found.name: found})[found.name].assign_attrs(name=found.name)
    found = replace(found, compliance=said)
    if path is not None:
        write_groups(path, with_warnings({found.name: said}, {found.name: found}))
    warn(found.warnings)
    return found


def _of_campaign(
    campaign: Path | str | Campaign,
    output: Path | str | None,
    progress: Progress,
    licence: Show | None,
    failures: Failures | None,
) -> dict[str, Identification]:
    path = None if output is None else Path(output)
    if path is not None and path.name in (CONDITIONS, LOOP_FILE, OPEN_LOOP_FILE, DRIVE_FILE):
        raise InputError(f"{path.name} is what another file beside the compliances is called; write to frf.nc")
    loaded = load_campaign(campaign, licence)
    if path is None:
        found, _ = identify_all(loaded, None, progress, failures)
        return found
    check_target(path)
    found, levels = identify_all(loaded, path.parent / KEPT, part(progress, 0.0, 0.9), failures)
    loops, open_loops = loops_of(loaded, failures), open_loops_of(loaded, failures)
    drives = drives_of(loaded, failures, part(progress, 0.9, 1.0))
    compliances = labelled(with_levels(loaded), found)
    cubes, _ = conditions_of(loaded, compliances, levels, path.parent / KEPT, failures)
    require_something([*found, *loops, *open_loops, *drives], failures)
    write_groups(path, with_warnings(compliances, found), pack(failures or ()))
    write_loops(path.with_name(LOOP_FILE), loops)
    write_open_loops(path.with_name(OPEN_LOOP_FILE), open_loops)
    write_drives(path.with_name(DRIVE_FILE), drives, None, open_loops)
    write_conditions(path.with_name(CONDITIONS), cubes)
    return found


def identify_all(
    campaign: Campaign, kept: Path | None, progress: Progress, failures: Failures | None = None
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
            progress(left_out(measurement), i, len(possible))
            continue
        progress(f"identifying {measurement.name}", i, len(possible))
        with attempt(failures, MEASUREMENT, measurement.name):
            found[measurement.name], _ = cached_identification(
                campaign, measurement, kept, step(progress, i, len(possible))
            )
    pooled: dict[str, Identification] = {}
    cubes: dict[str, xr.Dataset] = {}
    with attempt(failures, "levels of the sweeps"):
        pooled, cubes = level_cubes(campaign, found)
    return found | pooled, cubes


def conditions_of(
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


def left_out(measurement: Measurement) -> str:
    """Return the sentence that says where the result of a measurement stands that gives no compliance."""
    if measurement.method == "loop":
        return f"{measurement.name}: a loop gives no compliance; its response stands in {LOOP_FILE}"
    if measurement.method == "drive":
        return f"{measurement.name}: a drive gives no compliance; its inertia and friction stand in {DRIVE_FILE}"
    if measurement.method == "open_loop":
        return f"{measurement.name}: an open loop gives no compliance of the tool; it stands in {DRIVE_FILE}"
    return f"{measurement.name}: method '{measurement.method}' gives no compliance; only a diagnosis reads it"


def with_warnings(compliances: Mapping[str, xr.Dataset], found: Mapping[str, Identification]) -> dict[str, xr.Dataset]:
    """Return compliances with the warnings of their identification in an attribute."""
    return {n: pack_warnings(d, found[n].warnings if n in found else ()) for n, d in compliances.items()}


def write_conditions(path: Path, cubes: Mapping[str, xr.Dataset]) -> None:
    """Write ``conditions.nc``, or take that of an earlier run away where there is nothing to stack."""
    if cubes:
        write_groups(path, cubes)
    else:
        path.unlink(missing_ok=True)
