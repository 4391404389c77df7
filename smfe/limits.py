"""Lobes that a campaign asks for: from compliances to limits, bands, pockets and presets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.compliance import ModalModel
from process.engagement import engagement
from process.errors import InputError
from process.labels import at_tool
from smfe.campaign import Campaign, LobeRequest
from smfe.failures import LOBES, MEASUREMENT, Failures, attempt, pack
from smfe.identification import Progress
from smfe.modal import fit_modes, model_error
from smfe.store import pack_warnings, write_csv, write_groups
from stability import (
    PresetContext,
    Spread,
    best_pockets,
    carries_errors,
    lobe_curves,
    lobe_table,
    multi_frequency,
    operating_point,
    presets,
    sampled_band,
    semi_discretization,
    with_band,
    write_presets,
    write_table,
    zero_order,
)

MADE = ("lobes.nc", "lobe_table.csv", "pockets.csv", "presets.json")
"""Files that lobes make."""

SEVERAL = " + "
"""Between the names of measurements that make one source."""

_CURVES = {
    "spindle_speed": "spindle_speed_rpm",
    "limit_depth": "limit_depth_mm",
    "chatter_frequency": "chatter_frequency_Hz",
    "lobe": "lobe",
    "branch": "branch",
}


@dataclass(frozen=True)
class LobeResult:
    """Lobes of one request for one source.

    Parameters
    ----------
    request : str
        "lobes_1", "lobes_2", ... in the order of the campaign file.
    source : str
        Name of the measurement or model; of an operating point the names of all that it was had from.
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)``, where the errors are known its quantiles and ``safe_depth``, and the single
        lobes as ``curve_*(point)``.
    table : pandas.DataFrame
        Rows of lobe_table.csv.
    cut : str
        Kind of cut.
    maximum_depth : float or None
        Greatest depth that can be cut [m].
    """

    request: str
    source: str
    lobes: xr.Dataset
    table: pd.DataFrame
    cut: str = "down"
    maximum_depth: float | None = None


def all_lobes(
    campaign: Campaign,
    compliances: Mapping[str, xr.Dataset],
    progress: Progress,
    failures: Failures | None = None,
) -> list[LobeResult]:
    """Compute every lobe that a campaign asks for.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]``.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    progress : callable
        Called with (what, done, of).
    failures : list of Failure, optional
        Collects requests that fail, by "lobes_1, SOURCE", and is asked which measurements have failed already. None:
        the first one is raised.

    Raises
    ------
    InputError
        When a source is not among the compliances, or a limit cannot be computed from it.
    """
    out = []
    jobs = [(i, r, names) for i, r in enumerate(campaign.lobes, 1) for names in sources_of(r)]
    for done, (number, request, names) in enumerate(jobs):
        source = SEVERAL.join(names)
        progress(f"lobes {number}: {source}", done, len(jobs))
        with attempt(failures, LOBES, f"lobes_{number}, {source}"):
            check_sources(names, compliances, failures)
            try:
                limits = limits_of(campaign, request, names, compliances)
                if len(names) == 1:
                    limits = _banded(campaign, request, names[0], compliances[names[0]], limits)
                    limits = _with_curves(campaign, request, compliances[names[0]], limits)
            except InputError as error:
                raise InputError(f"lobes {number}, {source}: {error}" if failures is None else str(error)) from error
            out.append(_result(campaign, request, f"lobes_{number}", source, limits))
    return out


def check_sources(names: Sequence[str], compliances: Mapping[str, xr.Dataset], failures: Failures | None) -> None:
    """Refuse sources that are not among the compliances, and say why where that is known."""
    failed = {f.name for f in failures or () if f.part == MEASUREMENT}
    for name in names:
        if name in failed:
            raise InputError(f"measurement '{name}' failed; its own reason says what to do")
        if name not in compliances:
            raise InputError(f"'{name}' is asked for, and the compliances do not hold it: {', '.join(compliances)}")


def sources_of(request: LobeRequest) -> list[tuple[str, ...]]:
    """Return the measurements of each result: an operating point is had from all of them together."""
    return [request.measurements] if request.method == "operating_point" else [(m,) for m in request.measurements]


def limits_of(
    campaign: Campaign, request: LobeRequest, names: Sequence[str], compliances: Mapping[str, xr.Dataset]
) -> xr.Dataset:
    """Return the limits of one request for one source.

    Parameters
    ----------
    campaign : Campaign
        Tool, work material, models.
    request : LobeRequest
        Method, cut and speeds.
    names : sequence of str
        The measurement or model; of an operating point all measurements.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    """
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    tool, work, speeds = campaign.tool, campaign.coefficients, request.spindle_speed
    arc = engagement(request.cut, request.width_of_cut, tool.diameter)
    if request.method == "operating_point":
        together = over_conditions(campaign, {n: compliances[n] for n in names})
        return operating_point(together, tool, arc, work, speeds, request.feed_per_tooth)
    compliance, modal = compliances[names[0]], _modal(campaign, names[0])
    if request.method == "semi_discretization":
        if modal is None:
            return _by_fitted_modes(compliance, request, lambda m: semi_discretization(m, tool, arc, work, speeds))
        found = semi_discretization(modal, tool, arc, work, speeds)
    elif request.method == "multi_frequency":
        found = multi_frequency(compliance if modal is None else modal, tool, arc, work, speeds)
    else:
        found = zero_order(compliance, tool, arc, work, speeds)
    return found


def _by_fitted_modes(
    compliance: xr.Dataset, request: LobeRequest, limits: Callable[[ModalModel], xr.Dataset]
) -> xr.Dataset:
    """Return the limits of the modes that fit a measured compliance, and say how well they do."""
    try:
        fit = fit_modes(at_tool(compliance))
        modal = fit.modal_model()
    except InputError as error:
        raise InputError(
            f"{request.method} needs modes, and none could be fitted to this compliance: {error}. Use multi_frequency, "
            "which takes a compliance as it was measured, or declare its modes as a [[model]]"
        ) from error
    found = limits(modal)
    frequency = ", ".join(f"{f:.4g}" for f in fit.table()["frequency_Hz"])
    told = f"the limits are those of modes fitted to the measured compliance ({frequency} Hz, {model_error(fit)})"
    return found.assign_attrs(warnings=[*found.attrs.get("warnings", ()), told, *fit.warnings])


def _modal(campaign: Campaign, name: str) -> ModalModel | None:
    return next((m.modal for m in campaign.models if m.name == name), None)


def _banded(
    campaign: Campaign, request: LobeRequest, name: str, compliance: xr.Dataset, limits: xr.Dataset
) -> xr.Dataset:
    """Add quantiles and safe depth, where the errors of compliance, modes or coefficients are known."""
    model = next((m for m in campaign.models if m.name == name), None)
    own = Spread() if model is None else model.spread
    spread = Spread((campaign.coefficient_spread,) * 3, own.frequency, own.damping, own.stiffness)
    measured = model is None and carries_errors(compliance)
    if not measured and not spread.modal.any() and campaign.coefficient_spread == 0.0:
        return limits
    if model is None and not measured:
        return limits
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    arc = engagement(request.cut, request.width_of_cut, campaign.tool.diameter)
    of = compliance if model is None else model.modal
    band = sampled_band(of, campaign.tool, arc, campaign.coefficients, request.spindle_speed, spread)
    told = [*limits.attrs.get("warnings", ()), *band.attrs.get("warnings", ())]
    return with_band(limits, band).assign_attrs(warnings=list(dict.fromkeys(told)))


def _with_curves(campaign: Campaign, request: LobeRequest, compliance: xr.Dataset, limits: xr.Dataset) -> xr.Dataset:
    """Add the single lobes, where the method has them."""
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    if request.method != "zero_order" or not campaign.tool.equal_pitch:
        return limits
    arc, speeds = engagement(request.cut, request.width_of_cut, campaign.tool.diameter), request.spindle_speed
    curves = lobe_curves(compliance, campaign.tool, arc, campaign.coefficients, (speeds[0], speeds[-1]))
    return limits.assign({f"curve_{n}": ("point", curves[c].to_numpy()) for n, c in _CURVES.items()})


def over_conditions(campaign: Campaign, compliances: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Return compliances measured at several feeds and levels as one, over ``feed`` [mm/min] and their level.

    Parameters
    ----------
    campaign : Campaign
        Tells the feed and the force level (or depth of cut) of each measurement.
    compliances : mapping of str to xarray.Dataset
        Measurement -> compliance.

    Raises
    ------
    InputError
        When they do not fill a grid of feeds and levels, or have no frequencies in common.
    """
    at = {m.name: m for m in campaign.measurements}
    missing = [name for name in compliances if name not in at]
    if missing:
        raise InputError(f"'{missing[0]}' is a model: it belongs to no feed; give measurements for an operating point")
    feeds = {n: 6e4 * float((at[n].feed or {}).get("x", 0.0)) for n in compliances}
    by_depth = all(at[n].depth_of_cut is not None for n in compliances)
    levels = {n: (1e3 * (at[n].depth_of_cut or 0.0) if by_depth else at[n].force_level) for n in compliances}
    place = {(feeds[n], levels[n]): n for n in compliances}
    feed, level = sorted(set(feeds.values())), sorted(set(levels.values()), key=lambda v: -1.0 if v is None else v)
    if len(place) != len(feed) * len(level) or len(place) != len(compliances) or (None in level and len(level) > 1):
        told = ", ".join(f"{n}: {feeds[n]:g} mm/min at {levels[n]}" for n in compliances)
        raise InputError(
            f"an operating point needs every feed at every level, each once; there are {told}: complete them, or give "
            "the force_level (depth_of_cut for sweeps) of all"
        )
    grid = _common_grid(list(compliances.values()))
    name = "depth_of_cut" if by_depth else "force_level"
    rows = []
    for f in feed:
        row = [_on(compliances[place[f, v]], grid) for v in level]
        over = xr.DataArray(level, dims=name, name=name)
        rows.append(row[0] if level == [None] else xr.concat(row, over, join="outer"))
    at_feed = xr.DataArray(feed, dims="feed", name="feed")
    return xr.concat(rows, at_feed, join="outer").to_dataset(name="compliance")


def _common_grid(compliances: Sequence[xr.Dataset]) -> np.ndarray:
    """Return the frequencies of the finest compliance within the range of all [Hz]."""
    grids = [c["frequency"].values for c in compliances]
    low, high = max(g[0] for g in grids), min(g[-1] for g in grids)
    finest = min(grids, key=lambda g: float(np.median(np.diff(g))))
    grid = finest[(finest >= low) & (finest <= high)]
    if grid.size < 2:
        raise InputError(f"the measurements share no frequencies: {low:g} Hz is above {high:g} Hz")
    return np.asarray(grid)


def _on(compliance: xr.Dataset, grid: np.ndarray) -> xr.DataArray:
    if np.array_equal(compliance["frequency"].values, grid):
        return compliance["compliance"]
    return compliance["compliance"].interp(frequency=grid)


def _result(campaign: Campaign, request: LobeRequest, name: str, source: str, limits: xr.Dataset) -> LobeResult:
    assert campaign.tool is not None
    table = lobe_table(limits, source, campaign.tool, request.width_of_cut, request.feed_per_tooth)
    told = list(limits.attrs.pop("warnings", ()))
    if campaign.missing_coefficients:
        names = " and ".join(campaign.missing_coefficients)
        told.append(f"[material] gives no {names}: taken as zero, with which forces along the normal are missing")
    limits = pack_warnings(limits, told)
    limits = limits.assign_attrs(
        source=source,
        cut=request.cut,
        width_of_cut_mm=request.width_of_cut * 1e3,
        feed_per_tooth_mm=request.feed_per_tooth * 1e3,
        method=request.method,
    )
    return LobeResult(name, source, limits, table, request.cut, request.maximum_depth)


def joined(results: Sequence[LobeResult]) -> pd.DataFrame:
    """Return the rows of all tables."""
    return pd.concat([r.table for r in results], ignore_index=True)


def write_lobes(
    folder: Path, results: Sequence[LobeResult], campaign: Campaign, failures: Failures | None = None
) -> None:
    """Write the files of `MADE`, or remove those of an earlier run when there are no lobes.

    The attribute ``failures`` of ``lobes.nc`` says which requests failed; where all did, this is all that it holds.
    """
    missing = pack(f for f in failures or () if f.part == LOBES)
    if not results:
        for name in MADE:
            (folder / name).unlink(missing_ok=True)
        if missing:
            write_groups(folder / "lobes.nc", {}, missing)
        return
    write_groups(folder / "lobes.nc", {f"{r.request}/{r.source}": r.lobes for r in results}, missing)
    write_table(joined(results), folder / "lobe_table.csv")
    found = []
    for r in results:
        with attempt(failures, "pockets", f"{r.request}, {r.source}"):
            found.append((r, pockets_of(r, campaign)))
    if not found:
        for name in ("pockets.csv", "presets.json"):
            (folder / name).unlink(missing_ok=True)
        return
    write_csv(folder / "pockets.csv", pd.concat([p.assign(request=r.request) for r, p in found], ignore_index=True))
    write_presets(_presets(found, campaign), folder / "presets.json")


def pockets_of(result: LobeResult, campaign: Campaign) -> pd.DataFrame:
    """Return the best pockets of one result; speeds without a limit count only up to the maximum depth, if given."""
    table = result.table
    if result.maximum_depth is None:
        table = table[np.isfinite(table["limit_depth_mm"].to_numpy(float))]
    return best_pockets(table, spindle=campaign.spindle, maximum_depth=result.maximum_depth)


def _presets(found: Sequence[tuple[LobeResult, pd.DataFrame]], campaign: Campaign) -> dict[str, object]:
    assert campaign.tool is not None
    title = f"{1e3 * campaign.tool.diameter:g} mm, {campaign.tool.teeth} teeth"
    documents = [
        presets(
            pockets,
            PresetContext(
                campaign.tool,
                title,
                campaign.material or "work material",
                result.cut,
                result.lobes.attrs.get("safe_probability"),
            ),
        )
        for result, pockets in found
    ]
    return {**documents[0], "presets": [p for d in documents for p in d["presets"]]}
