"""Figures of a diagnosis as pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from smfe.reporting.content.style import literal
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.compared import LOOKS, MEASURED, SIMULATION, Block, Panel, blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Picture = Figure
"""What is drawn, for those who do not draw."""

_DASHES: Mapping[str, Literal["-", "--", ":"]] = {"solid": "-", "dash": "--", "dot": ":"}
_WIDTH, _PANEL = 5.0, 1.5  # of a block, and height of a panel [inch]


def draw_compared(curves: xr.Dataset) -> Figure:
    """Draw measured, simulation and extended model of each condition, and what is left, two conditions a row."""
    shown = blocks(curves)
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    tall = max(len(b.panels) for b in shown)
    figure = Figure(figsize=(_WIDTH * columns, (0.9 + _PANEL * (tall + 0.6)) * rows), layout="constrained")
    parts = np.ravel(figure.subfigures(rows, columns, squeeze=False))
    for part, block in zip(parts, shown, strict=False):
        panels = part.subplots(
            len(block.panels), 1, sharex=True, squeeze=False, height_ratios=[1.6] + [1.0] * (len(block.panels) - 1)
        )[:, 0]
        for axes, panel in zip(panels, block.panels, strict=True):
            _draw(axes, panel)
        panels[0].set_title(literal(f"{block.title}\n{block.note}".strip()), fontsize=9, loc="left")
        panels[-1].set_xlabel(block.x_label)
    figure.legend(*_legend(shown), loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


def _draw(axes: Axes, panel: Panel) -> None:
    for line in panel.lines:
        colour, dash, width = LOOKS[line.word]
        if line.marks:
            mark = {MEASURED: "o", SIMULATION: "x"}.get(line.word, ".")
            axes.plot(line.x, line.y, mark, color=colour, markersize=4, label=line.word)
        else:
            axes.plot(line.x, line.y, _DASHES[dash], color=colour, linewidth=0.8 * width, label=line.word)
    if panel.log:
        axes.set_yscale("log")
    axes.set_ylabel(literal(panel.label), fontsize=9)
    axes.grid(color="0.92")
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(shown: tuple[Block, ...]) -> tuple[list[Any], list[str]]:
    words = dict.fromkeys(line.word for b in shown for panel in b.panels for line in panel.lines)
    looks = [LOOKS[word] for word in words]
    return [Line2D([], [], color=c, linestyle=_DASHES[d], linewidth=w) for c, d, w in looks], list(words)


def draw_search(finding: Mapping[str, Any]) -> Figure:
    """Draw the steps of the search and the misfit of each condition, one above the other."""
    names, _ = figure_data.search_steps(finding)
    rows, _ = figure_data.shown_conditions(finding)
    searched = len(names) > 1
    lines = sum(len(_lines(name)) for name in names)
    heights = [0.9 + 0.2 * lines + 0.12 * len(names)] * searched + [1.1 + 0.22 * len(rows)] * bool(rows)
    figure = Figure(figsize=(8.0, sum(heights)), layout="constrained")
    panels = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    painters = [_draw_steps] * searched + [_draw_conditions] * bool(rows)
    for axes, paint in zip(panels, painters, strict=True):
        paint(axes, finding)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _lines(name: str) -> list[str]:
    """Return a name in lines that leave room for what is drawn beside it."""
    return textwrap.wrap(name, 40) or [""]


def _draw_steps(axes: Axes, finding: Mapping[str, Any]) -> None:
    names, heights = figure_data.search_steps(finding)
    places = range(len(names))
    axes.barh(places, heights, color=figure_data.step_colours(names), height=0.6)
    for place, height in zip(places, heights, strict=True):
        axes.text(max(height, 0.0), place, f" {height:.1f} dB", va="center")
    axes.set_yticks(list(places), ["\n".join(_lines(name)) for name in names])
    axes.invert_yaxis()
    axes.set_xlim(min(0.0, *heights), 1.15 * max(*heights, 0.1))
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("misfit over noise [dB], step by step")


def _draw_conditions(axes: Axes, finding: Mapping[str, Any]) -> None:
    rows, title = figure_data.shown_conditions(finding)
    for name, colour, held_out, places, misfit in figure_data.condition_marks(finding):
        axes.plot(misfit, places, "o", color=colour, fillstyle="none" if held_out else "full", label=name)
    axes.set_yticks(range(len(rows)), [literal(str(c["name"])) for c in rows], fontsize="small")
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.grid(axis="y", color="0.93")
    axes.set_axisbelow(True)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize="small", frameon=False)
    axes.set_xlabel(title)


def draw_depths(finding: Mapping[str, Any]) -> Figure:
    """Draw the stable depth over the spindle speed before and after, with the cutting tests."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    styles: dict[str, str] = {}
    for where, word, _, speeds, depths in figure_data.stable_depths(finding):
        colour, dash, width = LOOKS[word]
        styles.setdefault(where, _DASHES[dash])
        axes.plot(speeds, depths, _DASHES[dash], color=colour, linewidth=width, label=f"{word}, {literal(where)}")
    for happened, mark, colour, speeds, depths in figure_data.tested_depths(finding):
        axes.plot(speeds, depths, mark, color=colour, markersize=8, linestyle="none", label=f"cut: {happened}")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("spindle speed [rpm]")
    axes.set_ylabel("limit depth [mm]")
    axes.grid(color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize="small", frameon=False)
    return figure
