"""Responses of drive loops: gain and phase over frequency, a line a feed; no compliances, never drawn among them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure as Picture

from smfe.reporting.draw_plotly import LEGEND, axis_look, base_layout, packed
from smfe.reporting.style import number

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#4D4D4D")
GAIN, PHASE, FREQUENCY = "gain [dB]", "phase [deg]", "frequency [Hz]"


def lines(dataset: xr.Dataset) -> list[tuple[str, str, Any, Any]]:
    """Return name, colour, gain [dB] and phase [deg] of each feed."""
    out = []
    for k, feed in enumerate(dataset["feed"].values.astype(float)):
        response = dataset["loop_response"].sel(feed=feed).values
        gain = 20.0 * np.log10(np.maximum(np.abs(response), 1e-12))
        out.append((f"{number(feed)} mm/min", _COLOURS[k % 5], gain, np.degrees(np.angle(response))))
    return out


def figure(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the interactive figure of one measurement."""
    x = packed(dataset["frequency"].values)
    data = []
    for name, colour, gain, phase in lines(dataset):
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
                    "line": {"width": 1.5, "color": colour},
                    "xaxis": f"x{panel}",
                    "yaxis": f"y{panel}",
                    "hovertemplate": "%{x:.5~g} Hz, %{y:.3~g}",
                }
            )
    layout = base_layout(480, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    layout |= {
        "xaxis": axis_look(type="log", matches="x2", showticklabels=False, anchor="y"),
        "xaxis2": axis_look(FREQUENCY, type="log", anchor="y2"),
        "yaxis": axis_look(GAIN, domain=[0.45, 1.0], anchor="x"),
        "yaxis2": axis_look(PHASE, domain=[0.0, 0.4], range=[-180, 180], dtick=90, anchor="x2"),
    }
    return {"data": data, "layout": layout}


def draw(dataset: xr.Dataset) -> Picture:
    """Return the same as a picture."""
    picture = Picture(figsize=(6.0, 4.6), dpi=150, layout="constrained")
    upper, lower = picture.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for name, colour, gain, phase in lines(dataset):
        upper.semilogx(dataset["frequency"].values, gain, color=colour, linewidth=1.0, label=name)
        lower.semilogx(dataset["frequency"].values, phase, color=colour, linewidth=1.0)
    upper.axhline(-3.01, color="#888888", linewidth=0.7, linestyle="--")
    upper.set_ylabel(GAIN)
    upper.legend(frameon=False, fontsize=9)
    lower.set(ylabel=PHASE, xlabel=FREQUENCY, ylim=(-180, 180), yticks=(-180, -90, 0, 90, 180))
    for axes in (upper, lower):
        axes.grid(True, color="#dddddd", linewidth=0.5)
    return picture


def section(loops: Mapping[str, xr.Dataset], plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what the page shows, one block a measurement; its figures are put into `plots`."""
    out = []
    for position, (name, dataset) in enumerate(loops.items(), 1):
        plots[f"plot-loop-{position}"] = figure(dataset)
        said = json.loads(dataset.attrs.get("summary", "[]"))
        out.append({"name": name, "plot": f"plot-loop-{position}", "said": said, "loop": dataset.attrs.get("loop", "")})
    return out
