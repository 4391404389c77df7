"""Pictures of what a cut does over spindle speed and depth: contours, the limit over them, what is unstable shaded."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from process.types import Real
from smfe.limits.cut_maps import TITLES
from smfe.reporting.content.style import literal

DPI = 110


def draw_maps(maps: xr.Dataset, title: str = "") -> Figure:
    """Return the picture of the maps of one source.

    Parameters
    ----------
    maps : xarray.Dataset
        As `smfe.limits.cut_maps.maps_over` returns them.
    title : str, optional
        Which request and source.
    """
    speed, depth = (maps[name].values.astype(float) for name in ("spindle_speed", "depth_of_cut"))
    limit = maps["limit_depth"].values.astype(float)
    # A direction in which the tool hardly moves has no picture.
    largest = max(float(maps[name].max()) for name in TITLES if name.startswith("vibration"))
    shown = [
        name
        for name in TITLES
        if name in maps and not (name.startswith("vibration") and float(maps[name].max()) < 1e-3 * largest)
    ]
    rows = math.ceil(len(shown) / 2)
    figure = Figure(figsize=(11.0, 3.1 * rows + 0.6), dpi=DPI, layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for ax, name in zip(panels, shown, strict=False):
        values = maps[name].values.T.astype(float)
        draw_contours(figure, ax, (speed, depth, values), TITLES[name], maps["stable"].values.T)
        draw_limit(ax, speed, limit, float(depth[-1]))
    for ax in panels[len(shown) :]:
        ax.set_axis_off()
    figure.suptitle(literal(title), fontsize="medium")
    return figure


def draw_widths(limits: xr.Dataset, title: str = "") -> Figure:
    """Return the picture of the limits of one source over spindle speed and width of cut, and of the removal rates.

    Parameters
    ----------
    limits : xarray.Dataset
        As `smfe.limits.widths.over_widths` returns them. Where there is no limit, or one beyond ``maximum_depth_mm``,
        that depth is drawn, else the greatest limit that there is.
    title : str, optional
        Which request and source.
    """
    speed, width = (limits[name].values.astype(float) for name in ("spindle_speed", "width_of_cut"))
    depth, feed = (limits[name].values.astype(float) for name in ("limit_depth", "feed"))
    finite = depth[np.isfinite(depth)]
    deepest = float(limits.attrs.get("maximum_depth_mm", finite.max() if finite.size else math.inf))
    depth = np.minimum(depth, deepest)
    figure = Figure(figsize=(11.0, 4.2), dpi=DPI, layout="constrained")
    left, right = figure.subplots(1, 2)
    for ax, values, name in (
        (left, depth, "limit depth [mm]"),
        (right, 1e-3 * depth * width[:, None] * feed, "removal rate at the limit depth [cm3/min]"),
    ):
        draw_contours(figure, ax, (speed, width, values), name)
        ax.set_ylabel("width of cut [mm]")
    figure.suptitle(literal(title), fontsize="medium")
    return figure


def draw_contours(
    figure: Figure, ax: Axes, surface: tuple[Real, Real, Real], title: str, stable: Real | None = None
) -> None:
    """Draw contours of values (y, x) over x and y; levels are those of the stable part, about zero where it changes."""
    x, y, values = surface
    counted = values[np.isfinite(values)] if stable is None or not stable.any() else values[stable]
    low, high = (float(np.percentile(counted, p)) for p in (0.0, 98.0))
    signed = low < -0.02 * max(abs(low), abs(high))
    if signed:
        high = max(abs(float(np.percentile(counted, 2.0))), abs(high))
        low = -high
    if not high > low:
        low, high = low - 0.5 * abs(low) - 1e-9, high + 0.5 * abs(high) + 1e-9
    levels = MaxNLocator(12, symmetric=signed).tick_values(low, high)
    if x.size < 2 or y.size < 2:
        ax.plot(*((y, values[:, 0]) if x.size < 2 else (x, values[0])), color="k")
        ax.set_xlabel("depth of cut [mm]" if x.size < 2 else "spindle speed [rpm]")
        ax.set_title(title, fontsize=9)
        return
    colours = ax.contourf(x, y, values, levels=levels, cmap="RdBu_r" if signed else "viridis", extend="both")
    lines = ax.contour(x, y, values, levels=levels[::2], colors="white" if not signed else "0.4", linewidths=0.5)
    ax.clabel(lines, fontsize=6)
    figure.colorbar(colours, ax=ax)
    ax.set(xlabel="spindle speed [rpm]", ylabel="depth of cut [mm]")
    ax.set_title(title, fontsize=9)


def draw_limit(ax: Axes, speed: Real, limit: Real, deepest: float) -> None:
    """Draw the limit depth over the speed, and shade what lies above it."""
    if speed.size < 2:
        return
    top = np.where(np.isfinite(limit), np.minimum(limit, deepest), deepest)
    ax.fill_between(speed, top, deepest, color="white", alpha=0.65, lw=0)
    ax.fill_between(speed, top, deepest, facecolor="none", edgecolor="0.35", hatch="////", lw=0)
    ax.plot(speed, np.where(limit <= deepest, limit, np.nan), color="black", lw=1.6)
    ax.set_xlim(float(speed[0]), float(speed[-1]))
    ax.set_ylim(0.0, deepest)
