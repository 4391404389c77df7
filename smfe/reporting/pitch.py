"""The figure of a pitch design: both limits over the spindle speed, and where the teeth sit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smfe.limits.pitch import Pitch
from smfe.reporting.content.style import CHATTER, CURVE_COLOURS, literal
from smfe.reporting.figures.draw_matplotlib import DPI, save

_GREY = "#9A9A9A"


def write_figure(found: Pitch, path: Path) -> Path:
    """Write the figure as PNG and return its path."""
    return save(draw_pitch(found), path)


def draw_pitch(found: Pitch) -> Figure:
    """Return the figure: limits with the unequal and with equal pitch over the speed, and the teeth of the tool."""
    figure = Figure(figsize=(10.0, 4.4), dpi=DPI, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2.6, 1.0))
    _limits(left, found)
    _teeth(right, found)
    r = found.asked.request
    what = f"{literal(found.asked.source)}, {r.cut}, {1e3 * r.width_of_cut:g} mm wide, semi-discretisation"
    figure.suptitle(f"{r.name}: {what}", fontsize="medium")
    return figure


def _limits(ax: Axes, found: Pitch) -> None:
    table, check = found.table, found.design.check
    speed = table["spindle_speed_rpm"]
    for name, colour, label in (
        ("equal_limit_depth_mm", _GREY, "equal pitch"),
        ("limit_depth_mm", CURVE_COLOURS[0], f"{found.design.pattern} pitch"),
    ):
        if name == "limit_depth_mm" and found.design.pattern == "equal":
            continue
        ax.plot(speed, table[name].replace(np.inf, np.nan), ".-", ms=3, lw=1.6, color=colour, label=label)
    low, high = (found.spindle_speed * (1.0 + s * found.around) for s in (-1.0, 1.0))
    ax.axvspan(low, high, color=CURVE_COLOURS[0], alpha=0.12, lw=0)
    ax.axvline(found.spindle_speed, color=CHATTER, lw=1.0, label=f"asked for: {found.spindle_speed:g} rpm")
    ax.plot(check["spindle_speed_rpm"], check["limit_depth_mm"], "o", color="k", ms=4, label="verified")
    both = table[["limit_depth_mm", "equal_limit_depth_mm"]].to_numpy()
    known = both[np.isfinite(both)]
    near = check["limit_depth_mm"].to_numpy()
    near = near[np.isfinite(near)]
    if known.size:
        # A pocket between two lobes may be many times deeper than all that is of interest.
        top = max(2.0 * float(near.max()) if near.size else 0.0, 3.0 * float(np.median(known)))
        ax.set_ylim(0.0, min(top, 1.08 * float(known.max())))
    ax.set_xlabel("spindle speed [rpm]")
    ax.set_ylabel("limit depth [mm]")
    ax.grid(visible=True, lw=0.3)
    ax.legend(loc="best", fontsize="small")


def _teeth(ax: Axes, found: Pitch) -> None:
    """Draw the tool along its axis, the first tooth at the top, clockwise; each pitch with its angle."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(np.sin(turn), np.cos(turn), color=_GREY, lw=1.0)
    at = found.design.tool.tooth_angles()
    angles = found.design.pitch_angles_deg
    size = 9.0 if len(angles) <= 8 else 6.0
    for where, pitch in zip(at, angles, strict=True):
        ax.plot([0.0, np.sin(where)], [0.0, np.cos(where)], color=_GREY, lw=0.6)
        ax.plot(np.sin(where), np.cos(where), "o", color=CURVE_COLOURS[0], ms=7)
        middle = where + 0.5 * np.radians(pitch)
        ax.annotate(
            f"{pitch:.1f}°", (0.62 * np.sin(middle), 0.62 * np.cos(middle)), ha="center", va="center", size=size
        )
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_title(f"pitch angles, {found.design.pattern}", fontsize="medium")
