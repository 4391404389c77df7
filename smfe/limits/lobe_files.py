"""Files that the lobes of a campaign make."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from smfe.campaign import Campaign
from smfe.limits.campaign_lobes import LobeResult
from smfe.limits.cut_maps import rows, without
from smfe.limits.cut_maps import unpacked as maps_of
from smfe.limits.depth_bands import unpacked
from smfe.limits.recommendation import PRESETS, Recommendation, depths_of, recommend
from smfe.limits.widths import over_widths
from smfe.limits.widths import rows as rows_over_widths
from smfe.results import LOBES, Failures, attempt, pack, write_csv, write_groups
from stability import write_presets, write_table
from stability.tables.presets import RECOMMENDED

POCKETS, DEPTHS, BANDS = "pockets.csv", "depth_table.csv", "bands.csv"
MAPS, MAPS_TABLE = "maps.nc", "maps.csv"
WIDTHS, WIDTHS_TABLE = "widths.nc", "widths.csv"
MADE = ("lobes.nc", "lobe_table.csv", POCKETS, PRESETS, DEPTHS, BANDS, MAPS, MAPS_TABLE, WIDTHS, WIDTHS_TABLE)
"""Files that lobes make."""


def joined(results: Sequence[LobeResult]) -> pd.DataFrame:
    """Return the rows of all tables."""
    return pd.concat([r.table for r in results], ignore_index=True)


def bands_table(results: Sequence[LobeResult]) -> pd.DataFrame | None:
    """Return the rows of bands.csv: the bands of every result that has some, None without one."""
    frames = []
    for r in results:
        bands = unpacked(r.lobes)
        if bands is not None:
            bands.insert(0, "source", r.source)
            bands.insert(0, "lobes", r.request)
            frames.append(bands)
    return pd.concat(frames, ignore_index=True) if frames else None


def write_maps(results: Sequence[LobeResult], arrays: Path, table: Path) -> dict[str, xr.Dataset]:
    """Write the maps over speed and depth of every result that has some; without any nothing is written.

    Parameters
    ----------
    results : sequence of LobeResult
        From `all_lobes`.
    arrays, table : Path
        NetCDF file, a group "lobes_1/SOURCE" each; CSV table, a row a speed and depth.

    Returns
    -------
    dict of str to xarray.Dataset
        "lobes_1/SOURCE" -> its maps.
    """
    found = {f"{r.request}/{r.source}": m for r in results if (m := maps_of(r.lobes)) is not None}
    return _write_surfaces(found, arrays, table, rows)


def write_widths(results: Sequence[LobeResult], arrays: Path, table: Path) -> dict[str, xr.Dataset]:
    """Write the limits over width and speed as arrays and as a table; without several widths nothing is written.

    Parameters
    ----------
    results : sequence of LobeResult
        From `all_lobes`.
    arrays, table : Path
        NetCDF file, a group "lobes_1/SOURCE" each; CSV table, a row a width and speed.

    Returns
    -------
    dict of str to xarray.Dataset
        As of `smfe.limits.widths.over_widths`.
    """
    return _write_surfaces(over_widths(results), arrays, table, rows_over_widths)


def _write_surfaces(
    found: dict[str, xr.Dataset], arrays: Path, table: Path, rows_of: Callable[[xr.Dataset], pd.DataFrame]
) -> dict[str, xr.Dataset]:
    if found:
        write_groups(arrays, found)
        frames = []
        for name, one in found.items():
            request, _, source = name.partition("/")
            frame = rows_of(one)
            frame.insert(0, "source", source)
            frame.insert(0, "lobes", request)
            frames.append(frame)
        write_table(pd.concat(frames, ignore_index=True), table)
    return found


def depth_table(
    results: Sequence[LobeResult], campaign: Campaign, answers: Sequence[Recommendation]
) -> pd.DataFrame | None:
    """Return depth over speed and width of cut, for the requests with several widths; None without one.

    Parameters
    ----------
    results : sequence of LobeResult
        From `all_lobes`.
    campaign : Campaign
        What tool and machine can do.
    answers : sequence of Recommendation
        One a request: the source of the best of them is that of the whole table.

    Returns
    -------
    pandas.DataFrame or None
        One row a speed: lobes, source, spindle_speed_rpm, feed_mm_min, ``depth_20mm_mm`` for each width (depth of cut,
        rounded down, 0 where nothing can be cut), best_width_of_cut_mm and removal_rate_cm3_min, the largest of the
        row. A request without a safe depth has no rows.
    """
    frames = []
    for name in dict.fromkeys(r.asked.table for r in results):
        widths = {r.request: r.asked.width_of_cut for r in results if r.asked.table == name}
        given = [a for a in answers if a.lobes in widths and a.status == RECOMMENDED]
        if len(widths) < 2 or not given:
            continue
        source = max(given, key=lambda a: a.removal_rate_cm3_min or 0.0).source
        frames.append(_over_widths(name, [r for r in results if r.request in widths and r.source == source], campaign))
    return pd.concat(frames, ignore_index=True) if frames else None


def _over_widths(name: str, results: Sequence[LobeResult], campaign: Campaign) -> pd.DataFrame:
    """Return the rows of one request for one source, its results one a width."""
    on = ["spindle_speed_rpm", "feed_mm_min"]
    depths, rates = {}, {}
    for r in results:
        width = round(1e3 * r.asked.width_of_cut, 9)
        found = depths_of(r, campaign).set_index(on)
        depths[f"depth_{width:.6g}mm_mm"], rates[width] = found["depth_of_cut_mm"], found["removal_rate_cm3_min"]
    every = pd.concat(rates, axis=1).fillna(0.0)
    out = pd.concat(depths, axis=1).fillna(0.0)
    out = out.assign(best_width_of_cut_mm=every.idxmax(axis=1), removal_rate_cm3_min=every.max(axis=1)).reset_index()
    out.insert(0, "source", results[0].source)
    out.insert(0, "lobes", name)
    return out


def write_lobes(
    folder: Path,
    results: Sequence[LobeResult],
    campaign: Campaign,
    tests: Sequence[Mapping[str, Any]] = (),
    failures: Failures | None = None,
) -> None:
    """Write the files of `MADE`, or remove those of an earlier run when there are no lobes.

    The attribute ``failures`` of ``lobes.nc`` says which requests failed; where all did, this is all that it holds.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    results : sequence of LobeResult
        From `all_lobes`.
    campaign : Campaign
        What was asked for.
    tests : sequence of mapping, optional
        Rows of chatter.csv, by which the sources are judged.
    failures : list of Failure, optional
        What failed before; a recommendation that fails is added. None: it is raised.
    """
    missing = pack(f for f in failures or () if f.part == LOBES)
    if not results:
        for name in MADE:
            (folder / name).unlink(missing_ok=True)
        if missing:
            write_groups(folder / "lobes.nc", {}, missing)
        return
    accuracy = campaign.spindle.accuracy
    groups = {f"{r.request}/{r.source}": without(r.lobes).assign_attrs(spindle_accuracy=accuracy) for r in results}
    write_groups(folder / "lobes.nc", groups, missing)
    write_table(joined(results), folder / "lobe_table.csv")
    for name in MADE[2:]:
        (folder / name).unlink(missing_ok=True)
    bands = bands_table(results)
    if bands is not None:
        write_csv(folder / BANDS, bands)
    write_maps(results, folder / MAPS, folder / MAPS_TABLE)
    write_widths(results, folder / WIDTHS, folder / WIDTHS_TABLE)
    with attempt(failures, "recommendation"):
        found = recommend(results, campaign, tests)
        document = found.document()
        write_csv(folder / POCKETS, found.pockets)
        write_presets(document, folder / PRESETS)
        depths = depth_table(results, campaign, found.each)
        if depths is not None:
            write_csv(folder / DEPTHS, depths)
