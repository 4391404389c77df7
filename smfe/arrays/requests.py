"""A compliance in memory, a tool, a material and a cut -> the campaign that asks for their lobes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from process.cut.engagement import Engagement, Engagements
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.types import Real
from smfe.arrays.compliances import conditions_of, dataset_of, name_of, several
from smfe.arrays.tables import material_table, model_table, tool_table
from smfe.campaign import Campaign, campaign_of_tables
from smfe.campaign.machine import MACHINE
from smfe.campaign.quantities import OTHER_CUTS
from smfe.campaign.schema import ConditionsTable
from smfe.identification.compliances import labelled
from smfe.limits.campaign_lobes import ALLOWED, LobeResult
from smfe.limits.cut_maps import REACH
from smfe.modes.fit_modes import ModalFit, uncertainty
from stability import lobe_table

Speeds = float | str | Sequence[float | str] | Real
"""From, to and perhaps a step, one speed, or an array of speeds; numbers are rpm."""

_TABLES = ("spindle", "machine")
"""Tables of a campaign file that say what limits a cut besides the machine's compliance."""


USUAL = {"method": "zero_order", "feed_per_tooth": "0.1 mm"}
"""What is asked for where nothing is said: the feed per tooth sets feed and removal rate, not the limit."""

_NEEDED = ("tool", "material", "cut")


def asked(
    source: object,
    tool: Tool | Mapping[str, Any] | None,
    material: CuttingCoefficients | Mapping[str, Any] | None,
    request: Mapping[str, Any],
) -> tuple[Campaign, dict[str, xr.Dataset]]:
    """Return a campaign with one request for lobes, and its compliances.

    Parameters
    ----------
    source : xarray.Dataset, Identification, ModalModel, ModalFit, Machine, or mapping of str to the first four
        What the lobes are computed from.
    tool, material
        As of `smfe.lobes`.
    request : mapping
        Keys of ``[[lobes]]`` besides ``measurements``, and mappings ``spindle`` and ``machine``; numbers are SI,
        spindle speeds rpm. What it leaves out of `USUAL` is as there.

    Raises
    ------
    InputError
        When tool, material or cut are not given, and where a campaign file would be refused.
    """
    given = {"tool": tool, "material": material, **request}
    of_cut = OTHER_CUTS.get(str(given.get("cut")), ("width_of_cut",))
    missing = [name for name in (*_NEEDED, *of_cut, "spindle_speed") if given.get(name) is None]
    if tool is None or material is None or missing:
        example = "tool, material, cut='down', width_of_cut='40 mm', spindle_speed=(600, 1500)"
        raise InputError(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing; give {example}")
    width = request.get("width_of_cut", "")
    if not isinstance(width, str) and np.ndim(width):
        raise InputError("width_of_cut: one width at a time is asked for; call once for each")
    request = USUAL | dict(request)
    if isinstance(source, Machine):
        return _of_machine(source, tool, material, request), {}
    tables, compliances = machines(source)
    tables |= {key: request[key] for key in _TABLES if request.get(key) is not None}
    lobes = {key: value for key, value in request.items() if key not in _TABLES}
    lobes["spindle_speed"], speeds = _speeds(request["spindle_speed"])
    names = [table["name"] for key in ("measurement", "model") for table in tables.get(key, ())]
    tables |= {"tool": tool_table(tool), "material": material_table(material)}
    tables["lobes"] = [{"measurements": names, **lobes}]
    campaign = campaign_of_tables(tables, {name: [one] for name, one in compliances.items()}, "lobes")
    how = {name: str(one.attrs.get("method", "frf")) for name, one in compliances.items()}
    measurements = tuple(replace(m, method=how[m.name]) for m in campaign.measurements)
    campaign = replace(campaign, measurements=measurements)
    if speeds is not None:
        campaign = replace(campaign, lobes=(replace(campaign.lobes[0], spindle_speed=speeds),))
    return campaign, labelled(campaign, {}) | compliances


def _of_machine(
    machine: Machine,
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    request: Mapping[str, Any],
) -> Campaign:
    """Return a campaign that asks for the lobes of a machine in motion."""
    # The tables of a file are checked with a mode in its place.
    place = ModalModel(np.ones(1), np.full(1, 0.5), np.ones(1), np.eye(1, 3))
    campaign, _ = asked({MACHINE: place}, tool, material, request)
    return replace(campaign, models=(), machine_model=machine)


def remembering(result: LobeResult) -> LobeResult:
    """Return lobes whose dataset says what `limits_given` needs to know of them."""
    said: dict[str, Any] = {"in_motion": int(result.in_motion)}
    if result.asked.maximum_depth is not None:
        said["maximum_depth_mm"] = 1e3 * result.asked.maximum_depth
    return replace(result, lobes=result.lobes.assign_attrs(said))


def limits_given(
    source: Mapping[str, xr.Dataset],
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    tables: Mapping[str, Any],
) -> tuple[Campaign, list[LobeResult]]:
    """Return lobes in memory as those of a campaign that asked for them.

    Parameters
    ----------
    source : mapping of str to xarray.Dataset
        Lobes as `smfe.lobes` returns them, of one cut.
    tool, material
        As of `smfe.lobes`.
    tables : mapping
        ``spindle`` and ``machine``.

    Raises
    ------
    InputError
        When they are lobes of different cuts, or do not say of which.
    """
    cuts = {tuple(one.attrs.get(key) for key in (*_SAID, "maximum_depth_mm")) for one in source.values()}
    if len(cuts) != 1 or None in (said := cuts.pop())[:-1]:
        raise InputError("lobes of one cut are needed, as smfe.lobes returns them with their attributes")
    keys = dict(zip((*_SAID.values(), "maximum_depth"), said, strict=True))
    for key in ("width_of_cut", "feed_per_tooth", "maximum_depth"):
        keys[key] = None if keys[key] is None else f"{keys[key]!r} mm"
    worn = {(one.attrs.get("process_damping_N_m"), one.attrs.get("flank_friction")) for one in source.values()}
    if len(worn) != 1:
        raise InputError("the lobes have flanks worn differently; give those of one process_damping")
    if (flank := worn.pop())[0] is not None:
        keys |= {"process_damping": f"{flank[0]!r} N/m", "flank_friction": flank[1]}
    arcs = np.atleast_1d(next(iter(source.values())).attrs.get("arcs_deg", ())).reshape(-1, 2)
    if len({tuple(np.atleast_1d(one.attrs.get("arcs_deg", ())).tolist()) for one in source.values()}) != 1:
        raise InputError("the lobes have different arcs of engagement; give those of one cut")
    cut = str(keys["cut"])
    if arcs.size:  # the tables of a file are checked with a slot in its place
        keys["cut"] = "central"
    for key, attr, factor in ALLOWED:
        allowed = {one.attrs.get(attr) for one in source.values()}
        if len(allowed) != 1:
            raise InputError(f"the lobes have different {key}; give those of one request")
        if (value := allowed.pop()) is not None:
            keys[key] = float(value) / factor
    keys["feed_direction"] = f"{keys['feed_direction']!r} deg"
    record = {"file": "lobes", "response": "x", "excitation": "x"}
    speeds = next(iter(source.values()))["spindle_speed"].values
    unknown = set(tables) - set(_TABLES)
    if unknown:
        raise InputError(f"{', '.join(sorted(unknown))} is not read here: the lobes have their cut")
    whole = {
        **tables,
        "tool": tool_table(tool),
        "material": material_table(material),
        "measurement": [{"name": name, "method": "frf", "records": [record]} for name in source],
        "lobes": [{"measurements": list(source), **keys, "spindle_speed": _speeds(np.asarray(speeds))[0]}],
    }
    campaign = campaign_of_tables(whole, {"lobes": []}, "lobes")
    assert campaign.tool is not None
    results = []
    for name, one in source.items():
        listed = bool(one.attrs.get("single_speeds", False))
        asked_for = replace(campaign.lobes[0], spindle_speed=one["spindle_speed"].values, listed=listed, cut=cut)
        if arcs.size:
            engaged = tuple(Engagement(*pair) for pair in np.radians(arcs).tolist())
            asked_for = replace(asked_for, engaged=engaged[0] if len(engaged) == 1 else Engagements(engaged))
        table = lobe_table(one, name, campaign.tool, asked_for.width_of_cut, asked_for.feed_per_tooth)
        kind, moves = str(one.attrs.get("kind", "frf")), bool(one.attrs.get("in_motion", False))
        reach = one[own] if (own := [key for key in REACH if key in one]) else None
        results.append(LobeResult("lobes_1", name, one, table, asked_for, kind, moves, reach=reach))
    return campaign, results


_SAID = {
    "method": "method",
    "cut": "cut",
    "width_of_cut_mm": "width_of_cut",
    "feed_per_tooth_mm": "feed_per_tooth",
    "feed_direction_deg": "feed_direction",
}
"""Attribute of lobes -> key of their request."""


def planned(
    source: object,
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    limits: Mapping[str, Any],
) -> tuple[Campaign, dict[str, xr.Dataset], dict[str, Any]]:
    """Return a campaign that asks for a plan, its compliances, and its tables as a file would hold them.

    Parameters
    ----------
    source : xarray.Dataset, Identification, ModalModel or ModalFit
        Estimate of the machine.
    tool, material
        As of `smfe.plan`.
    limits : mapping
        Keys of ``[plan]``, and a mapping ``spindle``; numbers are SI.
    """
    tables, compliances = machines(source)
    said = {key: value for key, value in limits.items() if key not in _TABLES}
    tables |= {key: limits[key] for key in _TABLES if limits.get(key) is not None}
    tables |= {"tool": tool_table(tool), "material": material_table(material), "plan": said}
    campaign = campaign_of_tables(tables, {name: [one] for name, one in compliances.items()}, "plan")
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    name = {"name": campaign.material} if campaign.material else {}
    written = {"tool": tool_table(campaign.tool), "material": name | material_table(campaign.coefficients)}
    return campaign, compliances, written | {key: tables[key] for key in ("model",) if key in tables}


def machines(source: object) -> tuple[dict[str, Any], dict[str, xr.Dataset]]:
    """Return what holds compliances or modes as tables of a campaign, and the compliances by name."""
    items = dict(source) if several(source) else {_name(source): source}
    models, measurements, compliances = [], [], {}
    for name, item in items.items():
        if isinstance(item, ModalFit):
            models.append(model_table(name, item.modal_model(), uncertainty(item)))
        elif isinstance(item, ModalModel):
            models.append(model_table(name, item))
        else:
            compliances[name] = dataset_of(item)
            # Nothing is read of this record: the compliance is there.
            record = {"file": name, "response": "x", "excitation": "x"}
            measurements.append({"name": name, "method": "frf", "records": [record], **_conditions(compliances[name])})
    tables = {"model": models, "measurement": measurements}
    return {key: found for key, found in tables.items() if found}, compliances


def _name(item: object) -> str:
    return "modes" if isinstance(item, ModalModel | ModalFit) else name_of(item)


def _conditions(compliance: xr.Dataset) -> dict[str, Any]:
    """Return what a compliance was measured under as keys of a measurement."""
    said: dict[str, Any] = {k: v for k, v in conditions_of(compliance).items() if k in ConditionsTable.model_fields}
    feed = str(said.get("feed", ""))
    if "," in feed:  # as compliances are labelled: "x 500 mm/min, y 0 mm/min, z 0 mm/min"
        said["feed"] = {axis: value for axis, _, value in (part.strip().partition(" ") for part in feed.split(","))}
    return said


def _speeds(given: object) -> tuple[Any, Real | None]:
    """Return speeds as a campaign file has them; of an array its ends, and the array itself [rpm]."""
    if isinstance(given, np.ndarray | xr.DataArray):
        speeds = np.asarray(given, dtype=float).ravel()
        if not (speeds.size and np.isfinite(speeds).all() and speeds.min() > 0.0):
            raise InputError("spindle_speed: the speeds must be positive numbers in rpm")
        low = float(speeds.min())
        return _texts([low, max(float(speeds.max()), low * (1.0 + 1e-9))]), speeds
    if isinstance(given, str):
        return given, None
    return (_texts(given) if isinstance(given, Sequence) else _texts([given])[0]), None


def _texts(given: Sequence[Any]) -> list[str]:
    return [value if isinstance(value, str) else f"{float(value)!r} rpm" for value in given]
