"""What the cut of a request does over spindle speed and depth: arrays beside its lobes, and rows of a table.

`stability.vibration_maps` computes them; with the lobes they are kept as variables ``map_*(map_speed, map_depth)``.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.types import Real
from smfe.limits.source_modes import AskedCut
from smfe.progress import Progress
from stability import cut_maps
from stability.vibration_maps import depths_within

MOST_SPEEDS, MOST_UNEQUAL, DEPTHS = 161, 81, 40
"""Spindle speeds of a map, of equal and of unequal pitch, a finer range is thinned to it; depths of it."""

REACH = {"deflection_depth": "deflection", "surface_depth": "surface_error"}
"""Variable of lobes over the spindle speed -> key of ``[[lobes]]`` that it is the greatest depth of."""

TITLES = {
    "vibration_x": "vibration in x, peak to peak [um]",
    "vibration_y": "vibration in y, peak to peak [um]",
    "vibration_z": "vibration in z, peak to peak [um]",
    "deflection": "largest deflection [um]",
    "surface_error_up": "error of the wall at entry [um]",
    "surface_error_down": "error of the wall at exit [um]",
    "peak_force": "largest force [N]",
    "mean_torque": "mean torque [N m]",
    "spindle_power": "mean power [kW]",
    "removal_rate": "removal rate [cm3/min]",
}
"""Variable of maps -> what a picture calls it."""

_COLUMNS = {"um": "um", "N": "N", "N m": "Nm", "kW": "kW", "cm3/min": "cm3_min"}

_PREFIX = "map_"


def maps_over(asked: AskedCut, speeds: Real, deepest: float, limits: xr.Dataset, progress: Progress) -> xr.Dataset:
    """Return the maps of a request for one source.

    Parameters
    ----------
    asked : AskedCut
        The cut and the modes.
    speeds : ndarray, shape (speeds,)
        Spindle speeds [rpm], rising; at most `MOST_SPEEDS` of them are looked at, `MOST_UNEQUAL` with unequal pitch.
    deepest : float
        Greatest depth [m].
    limits : xarray.Dataset
        With ``limit_depth`` [mm] at these speeds, which says what is stable.
    progress : callable
        Called with (what, done, of).

    Returns
    -------
    xarray.Dataset
        Variables of `TITLES` and ``stable`` over (spindle_speed, depth_of_cut), and ``limit_depth(spindle_speed)``.
    """
    most = MOST_SPEEDS if asked.tool.equal_pitch else MOST_UNEQUAL
    pick = np.unique(np.linspace(0, speeds.size - 1, min(speeds.size, most)).round().astype(int))
    limit = limits["limit_depth"].sel(spindle_speed=speeds[pick], method="nearest").values.astype(float)
    depth = deepest * np.arange(1, DEPTHS + 1) / DEPTHS
    cut = (asked.tool, asked.arc, asked.coefficients)
    found = cut_maps(
        asked.modes, *cut, depth, asked.request.feed_per_tooth, speeds[pick], 1e-3 * limit, progress=progress
    )
    out = found.drop_dims(["axis", "wall"])
    for name, dim in (("vibration", "axis"), ("surface_error", "wall")):
        for at in found[dim].values:
            one = found[name].sel({dim: at}, drop=True)
            out[f"{name}_{at}"] = one.assign_attrs(found[name].attrs)
    return out.assign(limit_depth=("spindle_speed", limit, {"units": "mm"}))


def packed(maps: xr.Dataset) -> dict[Hashable, Any]:
    """Return maps as variables ``map_*`` of the dataset of lobes."""
    dims = {"spindle_speed": f"{_PREFIX}speed", "depth_of_cut": f"{_PREFIX}depth"}
    variables = {**maps.data_vars, **maps.coords}
    return {
        f"{_PREFIX}{name}": (tuple(dims[str(d)] for d in v.dims), v.values, dict(v.attrs))
        for name, v in variables.items()
    }


def unpacked(lobes: xr.Dataset) -> xr.Dataset | None:
    """Return the maps in a dataset of lobes, None where it has none."""
    if f"{_PREFIX}stable" not in lobes:
        return None
    dims = {f"{_PREFIX}speed": "spindle_speed", f"{_PREFIX}depth": "depth_of_cut"}
    found = {
        str(name).removeprefix(_PREFIX): (tuple(dims[str(d)] for d in v.dims), v.values, dict(v.attrs))
        for name, v in lobes.variables.items()
        if str(name).startswith(_PREFIX) and str(name) not in dims
    }
    coords = {name: found.pop(name) for name in ("spindle_speed", "depth_of_cut")}
    return xr.Dataset(found, coords)


def without(lobes: xr.Dataset) -> xr.Dataset:
    """Return lobes without the maps, which have a file of their own."""
    return lobes.drop_vars([name for name in lobes.variables if str(name).startswith(_PREFIX)])


def rows(maps: xr.Dataset) -> pd.DataFrame:
    """Return maps as a table, one row a speed and depth, units in the names."""
    shape = maps["stable"].shape
    out = {
        "spindle_speed_rpm": np.repeat(maps["spindle_speed"].values, shape[1]),
        "depth_of_cut_mm": np.tile(maps["depth_of_cut"].values, shape[0]),
        "stable": maps["stable"].values.astype(bool).ravel(),
    }
    for name in TITLES:
        if name in maps:
            out[f"{name}_{_COLUMNS[maps[name].attrs['units']]}"] = maps[name].values.ravel()
    return pd.DataFrame(out)


def reach_over(asked: AskedCut, speeds: Real, limits: xr.Dataset, progress: Progress) -> dict[Hashable, Any]:
    """Return the greatest depths [mm] within the deflection and the surface error that a request allows.

    Parameters
    ----------
    asked, limits, progress
        As of `maps_over`.
    speeds : ndarray, shape (speeds,)
        Those of the limits [rpm].

    Returns
    -------
    dict
        Variables `REACH` of the dataset of lobes, those that are asked for.
    """
    request = asked.request
    allowed = {name: getattr(request, key) for name, key in REACH.items()}
    cut = (asked.tool, asked.arc, asked.coefficients, request.feed_per_tooth)
    deflection, wall = (math.inf if value is None else float(value) for value in allowed.values())
    deepest = 1e-3 * limits["limit_depth"].values.astype(float)
    found = depths_within(asked.modes, *cut, speeds, deepest, deflection, wall, progress)
    return {
        name: ("spindle_speed", 1e3 * depths, {"units": "mm"})
        for (name, value), depths in zip(allowed.items(), found, strict=True)
        if value is not None
    }
