"""Friction of drives and responses of drive loops, interactive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from smfe.reporting.content.style import CURVE_COLOURS, DASHES, RECORD, translucent
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import LEGEND, Figure, axis_look, base_layout, packed, scatter


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
