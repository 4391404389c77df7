"""Lobes that a campaign asks for: from compliances to limits and to the rows of lobe_table.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import xarray as xr

from process.engagement import engagement
from process.errors import InputError
from smfe.campaign import Campaign, LobeRequest
from smfe.identification import Progress
from smfe.store import pack_warnings, write_groups
from stability import lobe_curves, lobe_table, write_table, zero_order


@dataclass(frozen=True)
class LobeResult:
    """Lobes of one request for one source.

    Parameters
    ----------
    request : str
        "lobes_1", "lobes_2", ... in the order of the campaign file.
    source : str
        Name of the measurement or model.
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)`` and the single lobes as ``curve_*(point)``.
    table : pandas.DataFrame
        Rows of lobe_table.csv.
    """

    request: str
    source: str
    lobes: xr.Dataset
    table: pd.DataFrame


def all_lobes(campaign: Campaign, compliances: Mapping[str, xr.Dataset], progress: Progress) -> list[LobeResult]:
    """Compute every lobe that a campaign asks for.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]``.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    progress : callable
        Called with (what, done, of).

    Raises
    ------
    InputError
        When a source is not among the compliances, or a limit cannot be computed from it.
    """
    out = []
    jobs = [(i, r, s) for i, r in enumerate(campaign.lobes, 1) for s in r.measurements]
    for done, (number, request, source) in enumerate(jobs):
        progress(f"lobes {number}: {source}", done, len(jobs))
        if source not in compliances:
            raise InputError(
                f"lobes {number} ask for '{source}', which the compliances do not hold: {', '.join(compliances)}"
            )
        out.append(_lobes_of(campaign, request, f"lobes_{number}", source, compliances[source]))
    return out


def _lobes_of(campaign: Campaign, request: LobeRequest, name: str, source: str, compliance: xr.Dataset) -> LobeResult:
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    arc = engagement(request.cut, request.width_of_cut, campaign.tool.diameter)
    speeds = request.spindle_speed
    dataset = zero_order(compliance, campaign.tool, arc, campaign.coefficients, speeds)
    table = lobe_table(dataset, source, campaign.tool, request.width_of_cut, request.feed_per_tooth)
    curves = lobe_curves(compliance, campaign.tool, arc, campaign.coefficients, (speeds[0], speeds[-1]))
    dataset = dataset.assign(
        {
            f"curve_{short}": ("point", curves[column].to_numpy())
            for short, column in (
                ("spindle_speed", "spindle_speed_rpm"),
                ("limit_depth", "limit_depth_mm"),
                ("chatter_frequency", "chatter_frequency_Hz"),
                ("lobe", "lobe"),
                ("branch", "branch"),
            )
        }
    )
    dataset = pack_warnings(dataset, dataset.attrs.pop("warnings", ()))
    dataset = dataset.assign_attrs(
        source=source,
        cut=request.cut,
        width_of_cut_mm=request.width_of_cut * 1e3,
        feed_per_tooth_mm=request.feed_per_tooth * 1e3,
        method=request.method,
    )
    return LobeResult(name, source, dataset, table)


def joined(results: Sequence[LobeResult]) -> pd.DataFrame:
    """Return the rows of all tables."""
    return pd.concat([r.table for r in results], ignore_index=True)


def write_lobes(folder: Path, results: Sequence[LobeResult]) -> None:
    """Write lobes.nc and lobe_table.csv, or remove those of an earlier run when there are none."""
    if not results:
        for name in ("lobes.nc", "lobe_table.csv"):
            (folder / name).unlink(missing_ok=True)
        return
    write_groups(folder / "lobes.nc", {f"{r.request}/{r.source}": r.lobes for r in results})
    write_table(joined(results), folder / "lobe_table.csv")
