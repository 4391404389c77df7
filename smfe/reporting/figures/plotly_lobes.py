"""Lobes with their cutting tests, interactive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.results import Lobes
from smfe.reporting.content.style import CHATTER, Line, number, translucent
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import Figure, axis_look, base_layout, filled, packed, plain, polygons

_SYMBOLS = {
    "stable": {"symbol": "circle", "color": "#000", "size": 10},
    "chatter": {"symbol": "x", "color": CHATTER, "size": 11, "line": {"width": 1, "color": "#fff"}},
    "undecided": {"symbol": "triangle-up-open", "color": "#000", "size": 11, "line": {"width": 2}},
}


def lobes_figure(lobes: Sequence[Lobes], tests: pd.DataFrame | None, looks: Mapping[str, Line]) -> Figure:
    """Return limit depth over speed with the cutting tests, and the chatter frequency below."""
    top, frequencies = figure_data.highest_depth(lobes, tests), figure_data.chatter_range(lobes)
    data: list[Figure] = []
    for item in lobes:
        data += _lobe_traces(item, looks[item.source], top)
    if tests is not None:
        data += _test_traces(tests)
    shared = {"range": list(figure_data.speed_range(lobes)), "anchor": "y2", "mirror": "all"}
    below = {"range": list(frequencies)} if frequencies else {}
    layout = base_layout(
        640,
        xaxis=axis_look("spindle speed [rpm]", **shared),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", domain=[0.36, 1.0], range=[0.0, top]),
        yaxis2=axis_look("chatter frequency [Hz]", domain=[0.0, 0.3], **below),
    )
    return {"data": data, "layout": layout}


def _lobe_traces(item: Lobes, look: Line, top: float) -> list[Figure]:
    name, group = plain(item.source), item.source
    speed, finite = item.data["spindle_speed"].values.astype(float), figure_data.finite_depth(item)
    frequency, lobe = item.values("chatter_frequency"), item.values("lobe")
    out = []
    band = item.band()
    if band is not None:
        low, high = (np.where(np.isinf(v), 20.0 * top, v) for v in band[:2])
        out.append(filled(polygons(speed, low, high), look.colour, 0.18, {"legendgroup": group}))
    curves = item.curves()
    if curves is not None:
        thin = {
            "type": "scatter",
            "mode": "lines",
            "line": {"width": 0.7, "color": translucent(look.colour, 0.45)},
        }
        hidden = {"hoverinfo": "skip", "showlegend": False, "legendgroup": group}
        x = packed(curves[0])
        out.append({**thin, **hidden, "x": x, "y": packed(curves[1])})
        out.append({**thin, **hidden, "x": x, "y": packed(curves[2]), "yaxis": "y2"})
    shared = {
        "type": "scatter",
        "x": packed(speed),
        "name": name,
        "legendgroup": group,
        "customdata": packed(np.column_stack([finite, frequency, np.where(lobe >= 0, lobe, np.nan)])),
        "hovertemplate": "%{x:.5~g} rpm<br>limit depth %{customdata[0]:.4~g} mm<br>"
        "chatter frequency %{customdata[1]:.4~g} Hz<br>lobe %{customdata[2]:.0f}",
    }
    out.append(
        {
            **shared,
            "mode": "lines",
            "y": packed(finite),
            "line": {"width": 2.4, "color": look.colour, "dash": look.dash},
        }
    )
    points = {"mode": "markers", "marker": {"size": 3.5, "color": look.colour}, "showlegend": False}
    out.append({**shared, **points, "y": packed(frequency), "yaxis": "y2"})
    return out


def _test_traces(tests: pd.DataFrame) -> list[Figure]:
    """Return the cutting tests by outcome, and the frequencies of those that chattered."""
    happened = outcomes(tests)
    out: list[Figure] = []
    for outcome, marker in _SYMBOLS.items():
        rows = tests[happened == outcome]
        if rows.empty:
            continue
        shared = {
            "type": "scatter",
            "mode": "markers",
            "marker": marker,
            "x": packed(rows["spindle_speed_rpm"]),
            "name": f"cutting test: {outcome}",
            "legendgroup": outcome,
            "text": [_test_text(row) for row in rows.to_dict("records")],
            "hovertemplate": "%{text}<extra></extra>",
        }
        out.append({**shared, "y": packed(rows["depth_of_cut_mm"])})
        if outcome == "chatter" and "chatter_frequency_Hz" in rows:
            out.append({**shared, "y": packed(rows["chatter_frequency_Hz"]), "yaxis": "y2", "showlegend": False})
    return out


def _test_text(row: Mapping[Any, Any]) -> str:
    lines = [
        plain(str(row["file"])),
        f"{number(row['spindle_speed_rpm'])} rpm, depth {number(row['depth_of_cut_mm'])} mm",
        f"verdict: {plain(str(row['verdict']))}",
    ]
    if isinstance(row.get("observed"), str) and row["observed"]:
        lines.append(f"observed: {plain(row['observed'])}")
    said = [(key, row.get(key)) for key in ("controller", "position")]
    lines += [f"{key}: {plain(value)}" for key, value in said if isinstance(value, str) and value]
    if np.isfinite(row.get("chatter_frequency_Hz", np.nan)):
        lines.append(f"line at {number(row['chatter_frequency_Hz'])} Hz")
    return "<br>".join(lines)
