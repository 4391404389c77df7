"""Lobes that a campaign asks for: from compliances to limits and their bands."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import UNITS
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.types import Real
from smfe.campaign import Campaign, LobeRequest
from smfe.campaign.machine import MACHINE
from smfe.kept import key_of
from smfe.limits.cut_conditions import FIXED, Source, in_motion, kind_of, sources_of, turned, turned_modes
from smfe.limits.cut_maps import REACH, maps_over, reach_over
from smfe.limits.cut_maps import packed as packed_maps
from smfe.limits.depth_bands import bands_over, packed
from smfe.limits.machine_lobes import machine_limits, place_of
from smfe.limits.operating_conditions import over_conditions
from smfe.limits.source_modes import asked_cut, fitted_modes
from smfe.progress import Progress, silent, step
from smfe.results import LOBES, MEASUREMENT, Failures, attempt, pack_warnings
from smfe.stored import Store, digest
from stability import (
    Spread,
    carries_errors,
    converged_band,
    lobe_curves,
    lobe_table,
    operating_point,
    sampled_band,
    with_band,
)
from stability.bands.depth_quantiles import exact_band
from stability.methods.catalogue import METHODS
from stability.tables.lobe_table import Origin

ALLOWED = (
    ("spindle_power", "spindle_power_kW", 1e-3),
    ("spindle_torque", "spindle_torque_Nm", 1.0),
    ("deflection", "deflection_um", 1e6),
    ("surface_error", "surface_error_um", 1e6),
)
"""Key of ``[[lobes]]``, attribute of lobes, and the factor from SI."""

WORN = (
    "these limits are those of a worn flank, and how well process_damping is known is not said: they have no quantiles "
    "and no safe depth. Those of the same [[lobes]] without process_damping hold for a sharp edge"
)
"""Said of limits with a worn flank."""

KICKED_BAND = (
    "the band is that of the operating points of the machine, scaled to these limits; its safe depth is that of "
    'method = "operating_point", below which no kick makes the cut chatter'
)
"""Said of the band of a machine in motion."""

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
        "lobes_1", "lobes_2", ... in the order of the campaign file; "lobes_1_20mm" where it asks for several widths.
    source : str
        Name of the measurement or model; of an operating point the names of all that it was had from, and where the
        request has several results their controller and position.
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)``, where the errors are known its quantiles and ``safe_depth``, and the single
        lobes as ``curve_*(point)``, and where they are asked for all bands of depth as ``band_*(band)``.
    table : pandas.DataFrame
        Rows of lobe_table.csv.
    asked : LobeRequest
        Method and cut.
    kind : str
        How the source was measured ("hammer", "sweep", ...), or "model".
    in_motion : bool
        Whether an axis moved while it was measured.
    near : pandas.DataFrame, optional
        Where single speeds are asked for: the same table with the speeds that the spindle may turn about them.
    reach : xarray.Dataset, optional
        Where deflection or surface error are limited: the depths that these allow over all speeds, `REACH`.
    """

    request: str
    source: str
    lobes: xr.Dataset
    table: pd.DataFrame
    asked: LobeRequest
    kind: str
    in_motion: bool = False
    near: pd.DataFrame | None = None
    reach: xr.Dataset | None = None


def all_lobes(
    campaign: Campaign,
    compliances: Mapping[str, xr.Dataset],
    progress: Progress,
    failures: Failures | None = None,
    kept: Path | None = None,
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
    kept : Path, optional
        Where limits are kept, and found again while neither compliance nor request have changed.

    Raises
    ------
    InputError
        When a source is not among the compliances, or a limit cannot be computed from it.
    """
    out, store = [], Store(kept, "limits")
    jobs = [(request, source) for request in campaign.lobes for source in sources_of(campaign, request)]
    for done, (request, of) in enumerate(jobs):
        source, names, said = of.label, of.names, request.name.replace("_", " ")
        progress(f"{said}: {source}", done, len(jobs))
        with attempt(failures, LOBES, f"{request.name}, {source}"):
            if not is_machine(campaign, names):
                check_sources(names, compliances, failures)
            speeds = _about(request.spindle_speed, campaign.spindle.accuracy) if request.listed else None
            whole = request if speeds is None else replace(request, spindle_speed=speeds)
            whole = replace(whole, controller=of.controller, position=of.position)
            used = {name: compliances[name] for name in names if name in compliances}
            key = "" if kept is None else key_of(digest([_bare(campaign, names), request, whole, used]))
            work = partial(_limits, campaign, request, whole, names, used, step(progress, done, len(jobs)))
            try:
                limits = store.get(key, work)
            except InputError as error:
                raise InputError(f"{said}, {source}: {error}" if failures is None else str(error)) from error
            limits = limits.assign_attrs({k: v for k in FIXED if (v := getattr(of, k)) is not None})
            out.append(_result(campaign, request, of, limits))
    store.forget_others()
    return out


def _limits(
    campaign: Campaign,
    request: LobeRequest,
    whole: LobeRequest,
    names: Sequence[str],
    compliances: Mapping[str, xr.Dataset],
    progress: Progress,
) -> xr.Dataset:
    """Return the limits of a request for one source, with their band and the single lobes, at the speeds of `whole`."""
    limits = limits_of(campaign, whole, names, compliances, progress)
    if request.method == "operating_point":
        return limits
    machine = campaign.machine_model if is_machine(campaign, names) else None
    compliance = None if machine is not None else compliances[names[0]]
    if compliance is None:
        limits = _machine_band(campaign, whole, limits)
    else:
        limits = _banded(campaign, whole, names[0], compliance, limits)
    limited = request.deflection is not None or request.surface_error is not None
    if limited or request.bands_up_to is not None or request.maps_up_to is not None:
        at = replace(request, controller=whole.controller, position=whole.position)
        asked = asked_cut(campaign, at, names[0], compliance)
        if limited or request.maps_up_to is not None:
            limits = _saying(limits, [n.replace("the limits are those", "the vibration is that") for n in asked.notes])
        if limited:
            limits = limits.assign(reach_over(asked, whole.spindle_speed, limits, progress))
        if request.maps_up_to is not None:
            maps = maps_over(asked, request.spindle_speed, request.maps_up_to, limits, progress)
            limits = limits.assign(packed_maps(maps))
        if request.bands_up_to is not None:
            bands, notes = bands_over(asked, request.spindle_speed, request.bands_up_to, progress)
            limits = _saying(limits.assign(packed(bands)), notes)
    return limits if compliance is None else _with_curves(campaign, request, compliance, limits)


def _bare(campaign: Campaign, names: Sequence[str]) -> Campaign:
    """Return what the limits of a source can depend on of a campaign."""
    return replace(
        campaign,
        measurements=tuple(m for m in campaign.measurements if m.name in names),
        models=tuple(m for m in campaign.models if m.name in names),
        lobes=(),
        cutting_tests=(),
        baseline=None,
        plan=None,
        machine_model=campaign.machine_model if MACHINE in names else None,
    )


def is_machine(campaign: Campaign, names: Sequence[str]) -> bool:
    """Return whether a source is the machine of ``[machine]``, of which each cut has a compliance of its own."""
    return isinstance(campaign.machine_model, Machine) and tuple(names) == (MACHINE,)


def _about(speeds: Real, accuracy: float) -> Real:
    """Return speeds with those that a spindle of this accuracy may turn about them, rising [rpm]."""
    return np.unique(np.concatenate([speeds, *(speeds * (1.0 + share * accuracy) for share in (-1.0, -0.5, 0.5, 1.0))]))


def check_sources(names: Sequence[str], compliances: Mapping[str, xr.Dataset], failures: Failures | None) -> None:
    """Refuse sources that are not among the compliances, and say why where that is known."""
    failed = {f.name for f in failures or () if f.part == MEASUREMENT}
    for name in names:
        if name in failed:
            raise InputError(f"measurement '{name}' failed; its own reason says what to do")
        if name not in compliances:
            raise InputError(f"'{name}' is asked for, and the compliances do not hold it: {', '.join(compliances)}")


def limits_of(
    campaign: Campaign,
    request: LobeRequest,
    names: Sequence[str],
    compliances: Mapping[str, xr.Dataset],
    progress: Progress = silent,
) -> xr.Dataset:
    """Return the limits of one request for one source.

    Parameters
    ----------
    campaign : Campaign
        Tool, work material, models.
    request : LobeRequest
        Method, cut, speeds, and the direction of the feed in the axes of the compliance.
    names : sequence of str
        The measurement or model; of an operating point all measurements.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    progress : callable, optional
        Called with (what, done, of), where each speed has a machine of its own.
    """
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    tool, work, speeds = campaign.tool, campaign.coefficients, request.spindle_speed
    arc = request.arc(tool.diameter)
    if is_machine(campaign, names):
        assert isinstance(campaign.machine_model, Machine)
        if request.method == "operating_point":
            return _at_operating_points(campaign, campaign.machine_model, request)
        return machine_limits(campaign.machine_model, request, tool, arc, work, progress)
    if request.method == "operating_point":
        together, notes = over_conditions(campaign, {n: compliances[n] for n in names}, request.feed_direction)
        cut = (tool, arc, work, speeds, request.feed_per_tooth)
        found = operating_point(together, *cut, feed=request.feed, uncertainty=_known_within(campaign))
        return _saying(found, notes)
    compliance, modal, notes = compliances[names[0]], _modal(campaign, names[0]), []
    if request.feed_direction:
        modal = modal and turned_modes(modal, request.feed_direction)
        compliance, notes = turned(compliance, request.feed_direction)
    method = METHODS[request.method]
    limits_with = partial(
        method.limits,
        tool=tool,
        arc=arc,
        coefficients=work,
        spindle_speed=speeds,
        process_damping=request.process_damping,
    )
    machine = method.of(compliance, modal)
    found = _by_fitted_modes(compliance, request, limits_with) if machine is None else limits_with(machine)
    return _saying(found, notes)


def _at_operating_points(campaign: Campaign, machine: Machine, request: LobeRequest) -> xr.Dataset:
    """Return the limits of the machine of a campaign with the friction of vibrations of each size."""
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    return operating_point(
        machine,
        campaign.tool,
        request.arc(campaign.tool.diameter),
        campaign.coefficients,
        request.spindle_speed,
        request.feed_per_tooth,
        feed=request.feed,
        feed_direction=request.feed_direction,
        controller=request.controller,
        position=place_of(request.position),
        uncertainty=campaign.machine_spread and {**campaign.machine_spread, **_known_within(campaign)},
    )


def _known_within(campaign: Campaign) -> dict[str, float]:
    return {"coefficients": campaign.coefficients_known_within}


def _saying(limits: xr.Dataset, notes: Sequence[str]) -> xr.Dataset:
    return limits.assign_attrs(warnings=[*limits.attrs.get("warnings", ()), *notes]) if notes else limits


def _by_fitted_modes(
    compliance: xr.Dataset, request: LobeRequest, limits: Callable[[ModalModel], xr.Dataset]
) -> xr.Dataset:
    """Return the limits of the modes that fit a measured compliance, and say how well they do."""
    try:
        modal, notes = fitted_modes(compliance)
    except InputError as error:
        raise InputError(
            f"{request.method} needs modes, and none could be fitted to this compliance: {error}. Use multi_frequency, "
            "which takes a compliance as it was measured, or declare its modes as a [[model]]"
        ) from error
    return _saying(limits(modal), notes)


def _modal(campaign: Campaign, name: str) -> ModalModel | None:
    return next((m.modal for m in campaign.models if m.name == name), None)


def _banded(
    campaign: Campaign, request: LobeRequest, name: str, compliance: xr.Dataset, limits: xr.Dataset
) -> xr.Dataset:
    """Add quantiles and safe depth, where the uncertainty of the compliance is known.

    That of the coefficients alone makes no limit safe: a limit whose compliance nobody has judged has no band. Nor has
    one with a worn flank: nobody has judged the flank, and the regenerative force that it holds in check moves the
    limit by more than its own share.
    """
    if request.process_damping.coefficient > 0.0:
        return _saying(limits, [WORN])
    model = next((m for m in campaign.models if m.name == name), None)
    if (model is None and not carries_errors(compliance)) or (model is not None and model.spread is None):
        return limits
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    arc = request.arc(campaign.tool.diameter)
    own = Spread() if model is None or model.spread is None else model.spread
    spread = replace(own, common=campaign.coefficients_known_within)
    if model is not None and not spread.modal.any() and spread.common == 0.0:
        return with_band(limits, exact_band(limits))
    of: xr.Dataset | ModalModel = compliance
    if model is not None:
        of = turned_modes(model.modal, request.feed_direction)
    elif request.feed_direction:
        of = turned(compliance, request.feed_direction)[0]
    if request.method != "zero_order":
        cut = campaign.tool, arc, campaign.coefficients
        if request.method == "semi_discretization" and isinstance(of, xr.Dataset):
            limits = converged_band(limits, fitted_modes(of)[0], *cut, spread, measured=of)
        else:
            limits = converged_band(limits, of, *cut, spread)
        none = np.isinf(limits["limit_depth"].values)
        if not none.any():
            return limits
        # Where no crossing limits the depth there is none to derive: how deep one may come up, zero order draws.
        band = sampled_band(of, *cut, limits["spindle_speed"].values[none], spread)
        there = with_band(limits.isel(spindle_speed=none).drop_vars(["limit_depth_quantile", "safe_depth"]), band)
        for name in ("limit_depth_quantile", "safe_depth"):
            limits[name].values[..., none] = there[name].values
        return limits
    band = sampled_band(of, campaign.tool, arc, campaign.coefficients, request.spindle_speed, spread)
    notes = [*limits.attrs.get("warnings", ()), *band.attrs.get("warnings", ())]
    return with_band(limits, band).assign_attrs(warnings=list(dict.fromkeys(notes)))


def _machine_band(campaign: Campaign, request: LobeRequest, limits: xr.Dataset) -> xr.Dataset:
    """Add the band of a machine in motion where its uncertainty is stated: that of its operating points, scaled."""
    if request.process_damping.coefficient > 0.0:
        return _saying(limits, [WORN])
    if campaign.machine_spread is None:
        return limits
    assert isinstance(campaign.machine_model, Machine)
    band = _at_operating_points(campaign, campaign.machine_model, request)
    if "limit_depth_quantile" not in band:
        return limits
    return _saying(with_band(limits, band), [KICKED_BAND])


def _with_curves(campaign: Campaign, request: LobeRequest, compliance: xr.Dataset, limits: xr.Dataset) -> xr.Dataset:
    """Add the single lobes, where the method has them."""
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    worn = request.process_damping.coefficient > 0.0  # its lobes are no explicit curves
    if request.method != "zero_order" or worn or not campaign.tool.equal_pitch or request.spindle_speed.size < 2:
        return limits
    arc, speeds = request.arc(campaign.tool.diameter), request.spindle_speed
    compliance = turned(compliance, request.feed_direction)[0] if request.feed_direction else compliance
    curves = lobe_curves(compliance, campaign.tool, arc, campaign.coefficients, (speeds[0], speeds[-1]))
    return limits.assign(
        {f"curve_{n}": ("point", curves[c].to_numpy(), {"units": UNITS.get(n, "1")}) for n, c in _CURVES.items()}
    )


def _known(limits: xr.Dataset) -> xr.Dataset:
    """Return limits at the speeds at which they are known: an empty depth in a file means that there is no limit."""
    known = ~np.isnan(limits["limit_depth"].values)
    if known.all():
        return limits
    if not known.any():
        raise InputError("; ".join(w for w in limits.attrs["warnings"] if "not known" in w))
    return limits.isel(spindle_speed=known)


def _result(campaign: Campaign, request: LobeRequest, of: Source, limits: xr.Dataset) -> LobeResult:
    assert campaign.tool is not None
    source, kind = of.label, kind_of(campaign, of)
    limits = _known(limits)
    origin = Origin(source, request.name, kind, request.method, request.cut)
    table = lobe_table(limits, origin, campaign.tool, request.width_of_cut, request.feed_per_tooth)
    near, names = None, [name for name in REACH if name in limits]
    reach = limits[names] if names else None
    if request.listed:
        asked = request.spindle_speed[np.isin(request.spindle_speed, limits["spindle_speed"].values)]
        at = np.searchsorted(limits["spindle_speed"].values, asked)
        near, table, limits = table, table.iloc[at].reset_index(drop=True), limits.isel(spindle_speed=at)
    notes = list(limits.attrs.pop("warnings", ()))
    if campaign.missing_coefficients:
        said = " and ".join(campaign.missing_coefficients)
        notes.append(f"[material] gives no {said}: taken as zero, with which forces along the normal are missing")
    limits = pack_warnings(limits, notes)
    limits = limits.assign_attrs(
        source=source,
        cut=request.cut,
        width_of_cut_mm=request.width_of_cut * 1e3,
        feed_per_tooth_mm=request.feed_per_tooth * 1e3,
        method=request.method,
        kind=kind,
        single_speeds=int(request.listed),
        coefficient_uncertainty=campaign.coefficients_known_within,
        feed_direction_deg=round(math.degrees(request.feed_direction), 9),
    )
    for key, attr, factor in ALLOWED:
        if (value := getattr(request, key)) is not None:
            limits = limits.assign_attrs({attr: value * factor})
    if request.engaged is not None:
        arcs = [math.degrees(angle) for part in request.engaged.arcs for angle in (part.entry, part.exit)]
        limits = limits.assign_attrs(arcs_deg=np.array(arcs))
    if request.process_damping.coefficient > 0.0:
        limits = limits.assign_attrs(
            process_damping_N_m=request.process_damping.coefficient, flank_friction=request.process_damping.friction
        )
    return LobeResult(request.name, source, limits, table, request, kind, in_motion(campaign, of), near, reach)
