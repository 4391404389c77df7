"""Limits over the width of cut as well as over the spindle speed, where a request has several widths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from smfe.limits.campaign_lobes import LobeResult

_COLUMNS = {
    "limit_depth": ("limit_depth_mm", "mm", "limit depth"),
    "safe_depth": ("safe_depth_mm", "mm", "depth that is stable with the probability of the lobes"),
    "feed": ("feed_mm_min", "mm/min", "feed"),
    "removal_rate": ("removal_rate_cm3_min", "cm3/min", "removal rate at the limit depth"),
    "chatter_frequency": ("chatter_frequency_Hz", "Hz", "chatter frequency"),
}
"""Variable -> column of the table of lobes, unit, meaning."""


def over_widths(results: Sequence[LobeResult]) -> dict[str, xr.Dataset]:
    """Return limit, safe depth and removal rate over width of cut and spindle speed.

    Parameters
    ----------
    results : sequence of LobeResult
        From `smfe.limits.campaign_lobes.all_lobes`.

    Returns
    -------
    dict of str to xarray.Dataset
        "lobes_1/SOURCE", for the tables of lobes with several widths -> variables over (width_of_cut [mm],
        spindle_speed [rpm]); NaN at speeds at which a width has no known limit, infinite where it has none.
    """
    out = {}
    for key in dict.fromkeys((r.asked.table, r.source) for r in results):
        own = sorted((r for r in results if (r.asked.table, r.source) == key), key=lambda r: r.asked.width_of_cut)
        if len(own) < 2:
            continue
        widths = [round(1e3 * r.asked.width_of_cut, 9) for r in own]
        speeds = np.unique(np.concatenate([r.table["spindle_speed_rpm"].to_numpy(float) for r in own]))
        found = [r.table.set_index("spindle_speed_rpm").reindex(speeds) for r in own]
        data = {
            name: (
                ("width_of_cut", "spindle_speed"),
                np.array([frame[column].to_numpy(dtype=float) for frame in found]),
                {"units": unit, "long_name": meaning},
            )
            for name, (column, unit, meaning) in _COLUMNS.items()
        }
        coords = {"width_of_cut": ("width_of_cut", widths, {"units": "mm"}), "spindle_speed": speeds}
        deepest = own[0].asked.maximum_depth
        attrs: dict[str, Any] = {"method": own[0].asked.method, "cut": own[0].asked.cut}
        if deepest is not None:
            attrs["maximum_depth_mm"] = 1e3 * deepest
        one = xr.Dataset(data, coords, attrs)
        one["spindle_speed"].attrs["units"] = "rpm"
        out["/".join(key)] = one
    return out


def rows(surface: xr.Dataset) -> pd.DataFrame:
    """Return one of `over_widths` as a table, one row a width and speed, units in the names."""
    named = {k: column for k, (column, _, _) in _COLUMNS.items()}
    named |= {"width_of_cut": "width_of_cut_mm", "spindle_speed": "spindle_speed_rpm"}
    return surface.to_dataframe().reset_index().rename(columns=named)
