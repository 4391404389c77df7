"""The recommendation of a folder of results, of lobes of a campaign, or of a compliance and a cut."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import xarray as xr

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.arrays.compliances import Compliance, several
from smfe.arrays.requests import Speeds, asked, limits_given
from smfe.campaign import Campaign
from smfe.limits.campaign_lobes import LobeResult, all_lobes
from smfe.limits.recommendation import Recommendation, recommend, recommendation_of
from smfe.modes.fit_modes import ModalFit
from smfe.progress import silent, warn
from smfe.results import unpack_warnings


@overload
def recommendation(source: Path | str) -> Recommendation | None: ...


@overload
def recommendation(
    source: Sequence[LobeResult], campaign: Campaign, tests: Sequence[Mapping[str, Any]] = ()
) -> Recommendation: ...


@overload
def recommendation(
    source: xr.Dataset | Mapping[str, xr.Dataset],
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    *,
    spindle: Mapping[str, Any] | None = None,
    machine: Mapping[str, Any] | None = None,
) -> Recommendation: ...


@overload
def recommendation(
    source: Compliance | ModalModel | ModalFit | Mapping[str, Compliance | ModalModel | ModalFit],
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    *,
    cut: str,
    width_of_cut: float | str,
    spindle_speed: Speeds,
    feed_per_tooth: float | str = "0.1 mm",
    method: str = "zero_order",
    **more: Any,
) -> Recommendation: ...


def recommendation(source: Any, *given: Any, **named: Any) -> Recommendation | None:
    """Return the one cut that is recommended: speed, depth, width, feed, removal rate, and how sure it is.

    ``recommendation(folder)`` reads what `smfe.run` has written, ``recommendation(lobes, campaign)`` takes what
    `smfe.lobes` returns of a campaign, ``recommendation(limits, tool, material)`` what it returns of a compliance, and
    ``recommendation(compliance, tool, material, cut=..., width_of_cut=..., spindle_speed=...)`` its arguments.

    Parameters
    ----------
    source : path, sequence of LobeResult, xarray.Dataset or mapping of them, or as the first argument of `smfe.lobes`
        Where the recommendation stands, or what it is made of. Of several the source is chosen by the rules of
        `smfe.limits.recommendation`.
    campaign : Campaign
        With lobes: tool, work material, spindle and machine.
    tests : sequence of mapping, optional
        With lobes: rows of chatter.csv.
    tool, material, **more
        As of `smfe.lobes`; ``spindle`` and ``machine``, with the keys of those tables, limit speed, depth and feed.

    Returns
    -------
    Recommendation or None
        None where a folder asked for no lobes.

    Raises
    ------
    InputError
        When the folder cannot be read, or an argument is wrong.

    Examples
    --------
    >>> limits = smfe.lobes(frf, tool, steel, cut="down", width_of_cut="40 mm", spindle_speed=(600, 1500))
    >>> smfe.recommendation(limits, tool, steel, spindle={"maximum": "1400 rpm"})
    """
    if isinstance(source, Path | str):
        return recommendation_of(source, *given, **named)
    if isinstance(source, Sequence):
        return _of_lobes(source, *given, **named)
    limits = source if several(source) else {str(getattr(source, "attrs", {}).get("source", "lobes")): source}
    if limits and all(isinstance(one, xr.Dataset) and "limit_depth" in one for one in limits.values()):
        return _of_limits(limits, *given, **named)
    return _of_compliances(source, *given, **named)


def _of_lobes(
    lobes: Sequence[LobeResult], campaign: Campaign, tests: Sequence[Mapping[str, Any]] = ()
) -> Recommendation:
    if not lobes:
        raise InputError("there are no lobes to recommend a cut from; give what smfe.lobes(campaign) returns")
    return recommend(lobes, campaign, tests).best


def _of_limits(
    limits: Mapping[str, xr.Dataset],
    tool: Tool | Mapping[str, Any] | None = None,
    material: CuttingCoefficients | Mapping[str, Any] | None = None,
    **tables: Any,
) -> Recommendation:
    if tool is None or material is None:
        raise InputError("tool and material are missing; a recommendation needs those that the lobes are of")
    campaign, results = limits_given(limits, tool, material, {k: v for k, v in tables.items() if v is not None})
    return recommend(results, campaign).best


def _of_compliances(
    source: object,
    tool: Tool | Mapping[str, Any] | None = None,
    material: CuttingCoefficients | Mapping[str, Any] | None = None,
    **cut: Any,
) -> Recommendation:
    campaign, compliances = asked(source, tool, material, cut)
    results = all_lobes(campaign, compliances, silent)
    warn(f"{r.source}: {w}" for r in results for w in unpack_warnings(r.lobes))
    return recommend(results, campaign).best
