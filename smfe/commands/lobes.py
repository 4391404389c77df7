"""`smfe lobes`: the lobes that a campaign asks for, or those of a compliance in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import xarray as xr

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from smfe.arrays.compliances import Compliance, several
from smfe.arrays.requests import Speeds, asked, remembering
from smfe.campaign import Campaign, load_campaign
from smfe.commands.identify import identify_all
from smfe.identification.compliances import labelled
from smfe.identification.levels import with_levels
from smfe.kept import KEPT
from smfe.limits.campaign_lobes import LobeResult, all_lobes
from smfe.limits.cut_maps import without
from smfe.limits.lobe_files import bands_table, joined, write_maps, write_widths
from smfe.modes.fit_modes import ModalFit
from smfe.progress import Progress, part, silent, warn
from smfe.results import (
    Failures,
    check_target,
    pack,
    read_groups,
    require_something,
    unpack_warnings,
    write_csv,
    write_groups,
)
from stability import write_table

Lobes = Compliance | ModalModel | ModalFit | Machine
"""What lobes are computed from."""


@overload
def lobes(
    source: Path | str | Campaign,
    output: Path | str | None = None,
    table: Path | str | None = None,
    frf: Path | str | None = None,
    progress: Progress = silent,
    failures: Failures | None = None,
    bands: Path | str | None = None,
    maps: Path | str | None = None,
    widths: Path | str | None = None,
    written: list[Path] | None = None,
) -> list[LobeResult]: ...


@overload
def lobes(
    source: Lobes,
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    *,
    cut: str,
    width_of_cut: float | str | None = None,
    spindle_speed: Speeds,
    feed_per_tooth: float | str = "0.1 mm",
    method: str = "zero_order",
    output: Path | str | None = None,
    table: Path | str | None = None,
    progress: Progress = silent,
    **more: Any,
) -> xr.Dataset: ...


@overload
def lobes(
    source: Mapping[str, Lobes],
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    *,
    cut: str,
    width_of_cut: float | str | None = None,
    spindle_speed: Speeds,
    feed_per_tooth: float | str = "0.1 mm",
    method: str = "zero_order",
    output: Path | str | None = None,
    table: Path | str | None = None,
    progress: Progress = silent,
    **more: Any,
) -> dict[str, xr.Dataset]: ...


def lobes(source: Any, *given: Any, **named: Any) -> list[LobeResult] | xr.Dataset | dict[str, xr.Dataset]:
    """Compute stability lobes: those that a campaign asks for, or those of a compliance for one cut.

    ``lobes(campaign, output, table, frf, progress, failures, bands)`` computes what a campaign asks for, from its
    records or from a compliance file. ``lobes(compliance, tool, material, cut=..., width_of_cut=...,
    spindle_speed=...)`` does the same for a compliance in memory; numbers are SI, texts carry their unit.

    Parameters
    ----------
    source : path, Campaign, xarray.Dataset, Identification, ModalModel, ModalFit, Machine, or mapping of str to some
        Campaign, or what the lobes are computed from; of several, by name, those of each. A machine model for itself.
    output : path, optional
        NetCDF file of the lobes. None: nothing is written.
    table : path, optional
        CSV lobe table.
    frf : path, optional
        With a campaign: compliances of an earlier run.
    failures : list of Failure, optional
        With a campaign: collects measurements and requests that fail, which the file names in its attribute
        ``failures``; the rest is written. None: the first one is raised, and nothing is written.
    bands : path, optional
        With a campaign: CSV table of the bands of depth, where it asks for them with ``bands_up_to``; a picture of each
        source beside it, under its name.
    maps : path, optional
        With a campaign: NetCDF file of the maps over speed and depth, where it asks for them with ``maps_up_to``; a
        CSV table and a picture of each source beside it, under its name.
    widths : path, optional
        With a campaign: NetCDF file of the limits over width of cut and speed, where a request has several widths; a
        CSV table and a picture of each source beside it, under its name.
    written : list of Path, optional
        With a campaign: is told every file that was written.
    tool : Tool or mapping
        The tool, or the keys of ``[tool]``.
    material : CuttingCoefficients or mapping
        Cutting coefficients, or the keys of ``[material]``: name, Ktc, ..., uncertainty.
    cut : {"down", "up", "central", "offset", "angles", "strips"}
        Kind of cut; the last three with ``offset``, ``entry_angle`` and ``exit_angle``, or ``strips``.
    width_of_cut : float or str, optional
        [m]; angles and strips have their own.
    spindle_speed : (float or str, float or str), the same with a step, or numpy.ndarray
        From and to, and the step of the table; one speed, or four and more in a list; or a grid as an array. Numbers
        are rpm.
    feed_per_tooth : float or str, optional
        [m]; sets feed and removal rate, and the limit of an operating point.
    method : str, optional
        "zero_order", "multi_frequency", "semi_discretization" or "operating_point".
    progress : callable, optional
        Called with (what, done, of).
    **more
        Further keys of ``[[lobes]]`` (feed_direction, maximum_depth, process_damping, flank_friction, bands_up_to,
        maps_up_to, spindle_power, spindle_torque, deflection, surface_error; of an operating point and of a machine
        feed, controller, position), and ``spindle`` or ``machine``, mappings with the keys of those tables.

    Returns
    -------
    list of LobeResult, xarray.Dataset or dict of str to xarray.Dataset
        Of a campaign a result for each request and source. Of a compliance ``limit_depth(spindle_speed)`` [mm] and
        ``chatter_frequency`` [Hz]; where the errors are known ``limit_depth_quantile(quantile, spindle_speed)`` [mm]
        and ``safe_depth`` [mm]. Of several, by name.

    Raises
    ------
    InputError
        When the campaign or an argument is wrong, or no lobes at all can be computed.

    Warns
    -----
    SmfeWarning
        What must be known of the limits; it also stands in their attribute ``warnings``.

    Examples
    --------
    >>> tool = smfe.Tool("80 mm", 2)
    >>> steel = smfe.CuttingCoefficients("1900 N/mm^2", "800 N/mm^2", "300 N/mm^2")
    >>> limits = smfe.lobes(frf, tool, steel, cut="down", width_of_cut="40 mm", spindle_speed=(600, 1500))
    """
    if isinstance(source, Path | str | Campaign):
        results = _of_campaign(source, *given, **named)
        warn(f"{r.request}, {r.source}: {w}" for r in results for w in unpack_warnings(r.lobes))
        return results
    found = _of_compliances(source, *given, **named)
    many = several(source)
    warn(f"{name}: {w}" if many else w for name, one in found.items() for w in unpack_warnings(one))
    return found if many else next(iter(found.values()))


def _of_campaign(
    campaign: Path | str | Campaign,
    output: Path | str | None = None,
    table: Path | str | None = None,
    frf: Path | str | None = None,
    progress: Progress = silent,
    failures: Failures | None = None,
    bands: Path | str | None = None,
    maps: Path | str | None = None,
    widths: Path | str | None = None,
    written: list[Path] | None = None,
) -> list[LobeResult]:
    loaded = load_campaign(campaign)
    path = None if output is None else Path(output)
    if not loaded.lobes:
        raise InputError(f"{loaded.path.name}: it asks for no lobes; add a [[lobes]] table")
    if path is not None:
        check_target(path)
    if frf is not None:
        compliances = read_groups(Path(frf))
    else:
        kept = None if path is None else path.parent / KEPT
        found, _ = identify_all(loaded, kept, part(progress, 0.0, 0.7), failures)
        compliances = labelled(with_levels(loaded), found)
    results = all_lobes(with_levels(loaded), compliances, part(progress, 0.7 if frf is None else 0.0, 1.0), failures)
    require_something(results, failures)
    files = _write(results, path, table, failures)
    if bands is not None:
        files += _write_bands(results, Path(bands))
    if maps is not None:
        files += _write_surfaces(results, Path(maps), write_maps, "draw_maps")
    if widths is not None:
        files += _write_surfaces(results, Path(widths), write_widths, "draw_widths")
    if written is not None:
        written += files
    return results


def _write_bands(results: Sequence[LobeResult], path: Path) -> list[Path]:
    """Write the bands of depth, and a picture a source; without any nothing. Return the files."""
    found = bands_table(results)
    if found is None:
        return []
    from smfe.reporting.figures.draw_matplotlib import draw_bands, save
    from smfe.reporting.maps.images import picture_name

    out = [write_csv(path, found)]
    for (request, source), own in found.groupby(["lobes", "source"], sort=False):
        name = picture_name(path.stem, str(request), str(source))
        out.append(save(draw_bands(own, f"{request}, {source}"), path.with_name(name)))
    return out


def _write_surfaces(
    results: Sequence[LobeResult],
    path: Path,
    write: Callable[[Sequence[LobeResult], Path, Path], dict[str, xr.Dataset]],
    draw: str,
) -> list[Path]:
    """Write what a request has over two coordinates as arrays, as a table, and a picture a source; return the files."""
    found = write(results, path, path.with_suffix(".csv"))
    if not found:
        return []
    from smfe.reporting.figures.draw_matplotlib import save
    from smfe.reporting.maps import contours
    from smfe.reporting.maps.images import picture_name

    out = [path, path.with_suffix(".csv")]
    for name, one in found.items():
        request, _, source = name.partition("/")
        picture = path.with_name(picture_name(path.stem, request, source))
        out.append(save(getattr(contours, draw)(one, f"{request}, {source}"), picture))
    return out


def _write(
    results: Sequence[LobeResult], output: Path | None, table: Path | str | None, failures: Failures | None
) -> list[Path]:
    out = []
    if output is not None:
        groups = {f"{r.request}/{r.source}": without(r.lobes) for r in results}
        out.append(write_groups(output, groups, pack(failures or ())))
    if table is not None:
        out.append(write_table(joined(results), Path(table)))
    return out


def _of_compliances(
    source: object,
    tool: Tool | Mapping[str, Any] | None = None,
    material: CuttingCoefficients | Mapping[str, Any] | None = None,
    *,
    output: Path | str | None = None,
    table: Path | str | None = None,
    progress: Progress = silent,
    **cut: Any,
) -> dict[str, xr.Dataset]:
    path = None if output is None else Path(output)
    if path is not None:
        check_target(path)
    campaign, compliances = asked(source, tool, material, cut)
    results = [remembering(r) for r in all_lobes(campaign, compliances, progress)]
    _write(results, path, table, None)
    return {r.source: r.lobes for r in results}
