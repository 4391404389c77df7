"""The page of a plan: which passes to cut, what is expected of them, and why the others were rejected."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.planning import operator
from smfe.planning.forces import Pass, orders_within
from smfe.planning.recommend import Plan
from smfe.reporting.content.style import AXIS_COLOURS, CHATTER
from smfe.reporting.figures.draw_matplotlib import DPI, save
from smfe.results import write_atomically

_HERE = Path(__file__).parent

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#4D4D4D")
_UNITS = {
    "_mm_min": "mm/min",
    "_rpm_s": "rpm/s",
    "_percent": "%",
    **{f"_{u}": u for u in ("mm", "rpm", "s", "N", "Nm", "kW")},
}
"""Ending of a column -> its unit, the longer endings first."""

_DASHES = ("-", "--", ":", "-.")

CAPTIONS = {
    "plan_top_view.png": "From above: work (grey) before each pass, path of the tool centre (dashed), where the "
    "inserts cut (thick). Feed to the right, spindle clockwise.",
    "plan_band.png": "What covers the band: harmonics of the tooth passing frequency at the speeds of the sweep.",
    "plan_error.png": "Compliance of the estimate, and the error to be expected of what the sweep will find (noise and "
    "what resonances bend).",
    "plan_forces.png": "Transform of the force of each pass: what the sweep puts at each frequency.",
    "plan_condition.png": "Condition number of the forces; above 30 badly conditioned, above 200 not solved.",
    "plan_level.png": "Force level over the depth of cut at the start of the sweep: largest resultant and mean.",
    "plan_chatter.png": "Limit depth of each pass at the speeds of the sweep, and the planned depth.",
}
"""Picture -> its caption, in the order of the page."""


def write_page(found: Plan, passes: pd.DataFrame, folder: Path) -> Path:
    """Write ``plan.html`` and ``figures/plan_*.png``.

    Parameters
    ----------
    found : Plan
        The plan.
    passes : pandas.DataFrame
        `smfe.planning.sweep_files.passes_table`.
    folder : Path
        Where to.

    Returns
    -------
    Path
        The page: one file that needs nothing else.
    """
    draws = (draw_top_view, draw_band, draw_error, draw_forces, draw_condition, draw_level, draw_chatter)
    drawn = dict(zip(CAPTIONS, (draw(found) for draw in draws), strict=True))
    images = []
    for name, figure in drawn.items():
        path = save(figure, folder / "figures" / name)
        images.append({"data": base64.b64encode(path.read_bytes()).decode("ascii"), "caption": CAPTIONS[name]})
    environment = Environment(loader=FileSystemLoader(_HERE / "templates"), autoescape=True, undefined=StrictUndefined)
    text = environment.get_template("plan.html.j2").render(**_context(found, passes), images=images)
    return write_atomically(folder / "plan.html", lambda path: path.write_text(text, encoding="utf-8"))


def _context(found: Plan, passes: pd.DataFrame) -> dict[str, Any]:
    error = 100.0 * found.prediction["relative_error"].values
    low, high = found.task.limits.frequency_range
    return {
        "name": found.task.name,
        "band": f"{low:g} to {high:g} Hz",
        "worst": f"{100.0 * found.worst:.2g}",
        "median": f"{100.0 * found.median:.2g}",
        "bands": f"{100.0 * float(found.prediction['bands_relative_error'].max()):.2g}",
        "estimate": found.task.estimate.name,
        "examined": found.examined,
        "warnings": found.warnings,
        "errors": [[f"{v:.2g}" for v in row] for row in error],
        "repeats": found.sweep.repeats,
        "passes": _turned(passes[passes["repeat"] == 1].drop(columns=["repeat", "file"])),
        "before": operator.before(found),
        "at_the_machine": [_pass_of(found, number, one) for number, one in enumerate(found.sweep.passes, 1)],
        "goes_wrong": operator.what_goes_wrong(found),
        "alternatives": _table(found.alternatives),
        "rejected": _table(found.rejected),
    }


def _pass_of(found: Plan, number: int, one: Pass) -> dict[str, Any]:
    """Return title, work and steps of a pass."""
    steps = [
        (f"{s.time:.1f}", f"{1e3 * s.position:.0f}", f"{s.speed * 30.0 / np.pi:.0f}", s.text)
        for s in operator.steps(found.sweep, one)
    ]
    title = f"Pass {number}: {one.cut} milling, {1e3 * one.width:g} mm wide, {1e3 * found.sweep.depth:g} mm deep"
    return {
        "title": title,
        "work": operator.side_cuts(found.sweep, one),
        "feed": f"{6e4 * found.sweep.feed_rate:.4g} mm/min",
        "steps": steps,
    }


def _table(frame: pd.DataFrame) -> dict[str, Any]:
    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False)]
    return {"head": [_head(str(c)) for c in frame.columns], "rows": rows}


def _turned(frame: pd.DataFrame) -> dict[str, Any]:
    """Return the table with a column a pass: there are more quantities than passes."""
    rows = [[_head(str(c)), *(_cell(v) for v in frame[c])] for c in frame.columns]
    return {"head": rows[0], "rows": rows[1:]}


def _head(column: str) -> str:
    """Return a column name with its unit in brackets."""
    for ending, unit in _UNITS.items():
        if column.endswith(ending):
            return f"{column.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return column.replace("_", " ")


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.4g}"
    return str(value)


# --- figures --------------------------------------------------------------------------------------------------------


def _plain(axes: Axes) -> None:
    axes.grid(True, color="#dddddd", linewidth=0.5)
    axes.tick_params(labelsize=8, direction="in", which="both")


def _new(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def draw_top_view(found: Plan) -> Figure:
    """Draw each pass from above: x to the right is the feed, y up, the tool centre in the origin."""
    passes, diameter = found.sweep.passes, 1e3 * found.sweep.tool.diameter
    radius = 0.5 * diameter
    figure = _new(3.1 * len(passes), 3.3)
    panels = figure.subplots(1, len(passes), squeeze=False)[0]
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    far = 2.0 * diameter
    for k, (axes, one) in enumerate(zip(panels, passes, strict=True)):
        low, high = operator.strip(one, found.sweep.tool.diameter)
        axes.axhspan(max(1e3 * low, -far), min(1e3 * high, far), color="#cfcfcf")
        # What is behind the tool is cut already.
        axes.fill_between([-far, 0.0], -radius, radius, color="white", linewidth=0)
        axes.fill(radius * np.sin(turn), radius * np.cos(turn), color="white", linewidth=0)
        axes.plot(radius * np.sin(turn), radius * np.cos(turn), color="black", linewidth=1.0)
        arc = one.engagement(found.sweep.tool.diameter)
        for part in arc.arcs:
            phi = np.linspace(part.entry, part.exit, 60)
            axes.plot(radius * np.sin(phi), radius * np.cos(phi), color=CHATTER, linewidth=3.5)
        axes.axhline(0.0, color="black", linewidth=0.8, linestyle="--")
        axes.annotate(
            "", (1.15 * radius, 0.0), (0.35 * radius, 0.0), arrowprops={"arrowstyle": "-|>", "color": "black"}
        )
        axes.set_title(f"pass {k + 1}: {one.cut}, {1e3 * one.width:g} mm", fontsize=9)
        axes.set_xlim(-1.4 * radius, 1.8 * radius)
        axes.set_ylim(-1.5 * radius, 1.5 * radius)
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]", fontsize=9)
        axes.tick_params(labelsize=8, direction="in")
    panels[0].set_ylabel("y [mm]", fontsize=9)
    return figure


def draw_band(found: Plan) -> Figure:
    """Draw the harmonics of the tooth passing frequency over the spindle speed."""
    low, high = found.task.limits.frequency_range
    ends = np.array([found.sweep.start, found.sweep.end]) * 30.0 / np.pi
    figure = _new(6.5, 3.2)
    axes = figure.subplots()
    axes.axhspan(low, high, color="#e8eef4", label="band asked for")
    for h in orders_within(found.sweep.tooth_passing, high):
        axes.plot(ends, h * np.array(found.sweep.tooth_passing), color="black", linewidth=1.4 if h < 3 else 0.8)
        axes.annotate(
            str(h),
            (ends[0], h * found.sweep.tooth_passing[0]),
            xytext=(-3, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=8,
            annotation_clip=True,
        )
    axes.set_ylim(0.0, 1.25 * high)
    axes.set_xlabel("spindle speed [rpm]", fontsize=9)
    axes.set_ylabel("frequency [Hz]", fontsize=9)
    _plain(axes)
    figure.legend(loc="outside upper center", frameon=False, fontsize=8)
    return figure


def draw_level(found: Plan) -> Figure:
    """Draw peak and mean force over the depth of cut."""
    p = found.prediction
    depth = p["depth_of_cut"].values
    figure = _new(6.5, 3.4)
    axes = figure.subplots()
    for k, name in enumerate(p["pass"].values):
        mean = np.linalg.norm(p["mean_force"].values[k], axis=0)
        axes.plot(depth, p["peak_force"].values[k], color=_COLOURS[k % 5], linewidth=1.4, label=f"{name}, peak")
        axes.plot(depth, mean, color=_COLOURS[k % 5], linewidth=1.4, linestyle="--", label=f"{name}, mean")
    axes.axvline(1e3 * found.sweep.depth, color="black", linewidth=1.6, label="planned depth")
    if found.task.limits.largest_force is not None:
        axes.axhline(
            found.task.limits.largest_force, color=CHATTER, linestyle=":", linewidth=1.2, label="largest force"
        )
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("depth of cut [mm]", fontsize=9)
    axes.set_ylabel("force [N]", fontsize=9)
    _plain(axes)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=8)
    return figure


def draw_error(found: Plan) -> Figure:
    """Draw the nine compliances with their expected error."""
    p = found.prediction
    frequency = p["frequency"].values
    size = 1e6 * np.abs(p["compliance"].values)
    std, bands = (1e6 * p[name].values for name in ("compliance_std", "bands_std"))
    figure = _new(9.0, 7.0)
    panels = figure.subplots(3, 3, sharex=True, sharey=True)
    share = 100.0 * p["relative_error"].values
    top = size.max()
    for i, r in enumerate("xyz"):
        for j, e in enumerate("xyz"):
            axes = panels[i, j]
            axes.semilogy(frequency, np.maximum(size[:, i, j], 1e-9 * top), color="black", linewidth=1.3)
            axes.semilogy(frequency, std[:, i, j], color=_COLOURS[0], linestyle="--", linewidth=1.3)
            axes.semilogy(frequency, bands[:, i, j], color=_COLOURS[1], linestyle=":", linewidth=1.0)
            axes.set_title(f"{r}{e}: error {share[i, j]:.2g} %", fontsize=9)
            _plain(axes)
    panels[0, 0].set_ylim(0.3 * std.min(), 2.0 * top)
    for axes in panels[2]:
        axes.set_xlabel("frequency [Hz]", fontsize=9)
    for axes in panels[:, 0]:
        axes.set_ylabel("[µm/N]", fontsize=9)
    lines = panels[0, 0].get_lines()
    figure.legend(
        lines,
        ["compliance (estimate)", "expected error", "with narrow bands alone"],
        loc="outside upper center",
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    return figure


def draw_forces(found: Plan) -> Figure:
    """Draw the transforms of the forces of each pass."""
    spectrum = found.prediction["force_spectrum"]
    frequency = found.prediction["frequency"].values
    labels = [str(v) for v in spectrum["pass"].values]
    figure = _new(9.0, 3.2)
    panels = figure.subplots(1, len(labels), sharey=True, squeeze=False)[0]
    for k, axes in enumerate(panels):
        for a, name in enumerate("xyz"):
            axes.semilogy(frequency, spectrum.values[k, a], color=AXIS_COLOURS[name], linestyle=_DASHES[a], label=name)
        axes.set_title(labels[k], fontsize=9)
        axes.set_xlabel("frequency [Hz]", fontsize=9)
        _plain(axes)
    panels[0].set_ylabel("|F(f)| [N s]", fontsize=9)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, [f"force {n}" for n in names], loc="outside upper center", ncols=3, frameon=False, fontsize=9
    )
    return figure


def draw_condition(found: Plan) -> Figure:
    """Draw the condition number of the forces."""
    p = found.prediction
    figure = _new(6.5, 3.0)
    axes = figure.subplots()
    axes.semilogy(p["frequency"].values, p["force_condition"].values, color="black", linewidth=1.3)
    for level, text in (
        (SWEEP_RULES.warn_condition, "badly conditioned"),
        (SWEEP_RULES.refuse_condition, "not solved"),
    ):
        axes.axhline(level, color=CHATTER, linewidth=0.9, linestyle="--")
        axes.annotate(
            f"above: {text}", (1.0, level), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8
        )
    axes.set_ylim(1.0, max(1.6 * SWEEP_RULES.refuse_condition, 1.2 * float(p["force_condition"].max())))
    axes.set_xlabel("frequency [Hz]", fontsize=9)
    axes.set_ylabel("condition number", fontsize=9)
    _plain(axes)
    return figure


def draw_chatter(found: Plan) -> Figure:
    """Draw the limit depth of each pass over the speeds of the sweep."""
    limits = found.prediction["limit_depth"]
    speed = limits["spindle_speed"].values
    depth = 1e3 * found.sweep.depth
    safe = depth / found.task.limits.chatter_margin
    figure = _new(6.5, 3.4)
    axes = figure.subplots()
    finite = limits.values[np.isfinite(limits.values)]
    top = min(4.0 * safe, 1.1 * float(finite.max())) if finite.size else 2.0 * safe
    top = max(top, 1.3 * safe)
    for k, name in enumerate(limits["pass"].values):
        values = np.minimum(limits.values[k], 10.0 * top)
        axes.plot(speed, values, color=_COLOURS[k % 5], linestyle=_DASHES[k % 4], linewidth=1.4, label=str(name))
    axes.axhline(depth, color="black", linewidth=1.6, label="planned depth")
    axes.axhline(safe, color=CHATTER, linewidth=1.0, linestyle="--", label="least limit asked for")
    axes.set_ylim(0.0, top)
    axes.set_xlabel("spindle speed [rpm]", fontsize=9)
    axes.set_ylabel("limit depth [mm]", fontsize=9)
    _plain(axes)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=8)
    return figure
