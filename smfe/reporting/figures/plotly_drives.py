"""Friction and open loops of drives, responses of drive loops, interactive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from smfe.reporting.content.style import CURVE_COLOURS, DASHES, RECORD, translucent
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import (
    LEGEND,
    Figure,
    axis_look,
    base_layout,
    filled,
    log_axis,
    on_panel,
    packed,
    polygons,
    scatter,
)


def drive_figure(frame: pd.DataFrame) -> Figure:
    """Return the interactive figure of one axis."""
    parts = figure_data.friction_parts(frame)
    data: list[dict[str, Any]] = [
        {
            **scatter("markers", parts["motion"]["velocity"].to_numpy(), parts["motion"]["force"].to_numpy()),
            "name": "record",
            "marker": {"size": 3, "color": RECORD},
        }
    ]
    for way in ("forward", "backward"):
        curve = parts[way]
        if curve.empty:
            continue
        around = np.concatenate([curve["velocity"], curve["velocity"][::-1]])
        band = np.concatenate([curve["high"], curve["low"][::-1]])
        shared = {"type": "scatter", "mode": "lines", "legendgroup": "curve", "hovertemplate": "%{x:.4~g}: %{y:.4~g}"}
        data += [
            shared
            | {
                "x": packed(around),
                "y": packed(band),
                "fill": "toself",
                "line": {"width": 0},
                "fillcolor": translucent(CURVE_COLOURS[0], 0.2),
                "showlegend": False,
                "hoverinfo": "skip",
            },
            shared
            | {
                "x": packed(curve["velocity"].to_numpy()),
                "y": packed(curve["force"].to_numpy()),
                "name": "identified, with 95 % interval",
                "line": {"width": 2, "color": CURVE_COLOURS[0]},
                "showlegend": way == "forward" or parts["forward"].empty,
            },
        ]
    runs = parts["runs"]
    if len(runs):
        data.append(
            {
                **scatter("markers", runs["velocity"].to_numpy(), runs["force"].to_numpy()),
                "error_y": {"type": "data", "array": packed((runs["high"] - runs["force"]).to_numpy())},
                "name": "runs at constant velocity",
                "marker": {"size": 7, "color": CURVE_COLOURS[1]},
            }
        )
    velocity, force = figure_data.friction_titles(frame)
    layout = base_layout(420, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    return {"data": data, "layout": layout | {"xaxis": axis_look(velocity), "yaxis": axis_look(force)}}


def open_loop_figure(curves: Sequence[figure_data.OpenLoopCurve], marks: Mapping[str, float]) -> Figure:
    """Return the interactive figure of an open loop: magnitude and phase, measured with 95 % band, and Eq. (2)."""
    data: list[dict[str, Any]] = []
    for c in curves:
        group = {"legendgroup": c.name}
        size = np.abs(c.measured)
        low = np.maximum(size - c.half, 1e-3 * size)
        data.append(filled(polygons(c.frequency, low, size + c.half), c.colour, 0.25, group | on_panel(1)))
        for panel, of in ((1, np.abs), (2, figure_data.falling_phase)):
            dots = {"name": f"{c.name}, measured", "marker": {"size": 3, "color": c.colour}, "showlegend": panel == 1}
            line = {"name": f"{c.name}, Eq. (2)", "line": {"width": 1.5, "color": "#222"}, "showlegend": panel == 1}
            data.append({**scatter("markers", c.frequency, of(c.measured)), **group, **dots, **on_panel(panel)})
            data.append({**scatter("lines", c.frequency, of(c.fitted)), **group, **line, **on_panel(panel)})
    first, last = (float(end(c.frequency[k] for c in curves)) for end, k in ((min, 0), (max, -1)))
    layout = base_layout(520, legend={**LEGEND, "y": 1.06, "yanchor": "bottom"})
    layout |= {
        "xaxis": axis_look(**log_axis(first, last), matches="x2", showticklabels=False, anchor="y"),
        "xaxis2": axis_look(figure_data.FREQUENCY, **log_axis(first, last), anchor="y2"),
        "yaxis": axis_look(figure_data.OPEN_LOOP, type="log", exponentformat="power", domain=[0.42, 1.0], anchor="x"),
        "yaxis2": axis_look(figure_data.PHASE, domain=[0.0, 0.37], dtick=90, anchor="x2"),
        "shapes": [
            {"type": "line", "x0": f, "x1": f, "y0": 0, "y1": 1, "yref": "paper", "line": {"dash": "dot", "width": 1}}
            for f in marks.values()
        ],
        "annotations": [
            {
                "x": math.log10(f),
                "y": 1.0,
                "xref": "x",
                "yref": "paper",
                "yanchor": "bottom",
                "xanchor": anchor,
                "showarrow": False,
                "text": f"{name} {f:.4g} Hz",
            }
            for (name, f), anchor in zip(marks.items(), ("right", "left"), strict=True)
        ],
    }
    return {"data": data, "layout": layout}


def loop_figure(dataset: xr.Dataset) -> Figure:
    """Return the interactive figure of one measurement."""
    x = packed(dataset["frequency"].values)
    data = []
    for at, (name, colour, gain, phase) in enumerate(figure_data.loop_curves(dataset)):
        for y, panel, shown in ((gain, "", True), (phase, "2", False)):
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": x,
                    "y": packed(y),
                    "name": name,
                    "legendgroup": name,
                    "showlegend": shown,
                    "line": {"width": 1.5, "color": colour, "dash": DASHES[at % len(DASHES)]},
                    "xaxis": f"x{panel}",
                    "yaxis": f"y{panel}",
                    "hovertemplate": "%{x:.5~g} Hz, %{y:.3~g}",
                }
            )
    layout = base_layout(480, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    layout |= {
        "xaxis": axis_look(type="log", matches="x2", showticklabels=False, anchor="y"),
        "xaxis2": axis_look(figure_data.FREQUENCY, type="log", anchor="y2"),
        "yaxis": axis_look(figure_data.GAIN, domain=[0.45, 1.0], anchor="x"),
        "yaxis2": axis_look(figure_data.PHASE, domain=[0.0, 0.4], range=[-180, 180], dtick=90, anchor="x2"),
    }
    return {"data": data, "layout": layout}
