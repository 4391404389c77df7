"""Figures of a diagnosis, interactive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from smfe.reporting.figures import figure_data
from smfe.reporting.figures.compared import EXTENDED, LOOKS, MEASURED, REFITTED, SIMULATION, Block
from smfe.reporting.figures.plotly_frame import Figure, axis_look, base_layout, log_axis, on_panel, packed, plain

_GAP = 0.07
_MARKS = {MEASURED: "circle", SIMULATION: "x", REFITTED: "circle-open", EXTENDED: "circle-open"}


def compared_figure(block: Block) -> Figure:
    """Return measured, simulation and extended model of a condition, and what is left, one panel above the other."""
    count = len(block.panels)
    weights = np.array([1.6] + [1.0] * (count - 1))
    tall = (1.0 - _GAP * (count - 1)) * weights / weights.sum()
    data: list[Figure] = []
    layout: dict[str, Any] = {}
    named: set[str] = set()
    top = 1.0
    for place, panel in enumerate(block.panels, 1):
        tail, last = "" if place == 1 else str(place), place == count
        for line in panel.lines:
            colour, dash, width = LOOKS[line.word]
            drawn = {
                "mode": "markers" if line.marks else "lines",
                "line": {"color": colour, "dash": dash, "width": width},
                "marker": {"color": colour, "symbol": _MARKS[line.word], "size": 5},
            }
            data.append(
                {
                    "type": "scatter",
                    "name": line.word,
                    "legendgroup": line.word,
                    "showlegend": line.word not in named,
                    "x": packed(line.x),
                    "y": packed(line.y),
                    "hovertemplate": "%{x:.5~g}: %{y:.3~g}",
                    **drawn,
                    **on_panel(place),
                }
            )
            named.add(line.word)
        bottom = max(top - float(tall[place - 1]), 0.0)
        look: dict[str, Any] = {"domain": [bottom, top], "anchor": f"x{tail}"}
        if panel.log:
            known = np.concatenate([line.y[np.isfinite(line.y) & (line.y > 0.0)] for line in panel.lines])
            if known.size:
                look |= log_axis(float(known.min()) / 1.3, float(known.max()) * 1.3)
        layout[f"yaxis{tail}"] = axis_look(panel.label, automargin=True, **look)
        matched = {} if place == 1 else {"matches": "x"}
        layout[f"xaxis{tail}"] = axis_look(
            block.x_label if last else "", anchor=f"y{tail}", showticklabels=last, **matched
        )
        top = bottom - _GAP
    return {"data": data, "layout": base_layout(150 + 110 * count + 70, **layout)}


def condition_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the misfit of each condition before and after; None without conditions."""
    rows, title = figure_data.shown_conditions(finding)
    if not rows:
        return None
    names = [plain(str(c["name"])) for c in rows]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": misfit,
            "y": [names[i] for i in places],
            "marker": {"color": colour, "size": 9, "symbol": figure_data.condition_symbol(name)},
        }
        for name, colour, _, places, misfit in figure_data.condition_marks(finding)
    ]
    layout = base_layout(
        130 + 22 * len(names),
        xaxis=axis_look(title, zeroline=True, zerolinecolor="#888"),
        yaxis=axis_look(
            autorange="reversed", automargin=True, type="category", categoryorder="array", categoryarray=names
        ),
    )
    return {"data": data, "layout": layout}


def stable_depth_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the stable depth over spindle speed before and after, with the cutting tests; None without lobes."""
    curves, tests = figure_data.stable_depths(finding), figure_data.tested_depths(finding)
    many = len({where for where, *_ in curves}) > 1
    data: list[Figure] = []
    for where, word, _, speeds, depths in curves:
        colour, dash, width = LOOKS[word]
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"{word}, {plain(where)}" if many else word,
                "x": packed(speeds),
                "y": packed(depths),
                "line": {"color": colour, "dash": dash, "width": width},
            }
        )
    symbols = {"stable": "circle", "chatter": "x"}
    for happened, _, colour, speeds, depths in tests:
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"cut: {happened}",
                "x": packed(speeds),
                "y": packed(depths),
                "marker": {"color": colour, "size": 10, "symbol": symbols[happened]},
            }
        )
    layout = base_layout(
        360,
        xaxis=axis_look("spindle speed [rpm]"),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", rangemode="tozero"),
    )
    return {"data": data, "layout": layout} if data else None
