"""Figures of a diagnosis, interactive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import Figure, axis_look, base_layout, packed, plain


def search_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the misfit of the baseline and of each step that was kept; None without a step."""
    names, heights = figure_data.search_steps(finding)
    if len(names) < 2:
        return None
    bars = {
        "type": "bar",
        "orientation": "h",
        "x": heights,
        "y": [plain(n) for n in names],
        "marker": {"color": [figure_data.BASELINE, *[figure_data.EXTENDED] * (len(names) - 1)]},
        "text": [f"{h:.2f} dB" for h in heights],
        "textposition": "outside",
        "cliponaxis": False,
        "hoverinfo": "skip",
        "showlegend": False,
    }
    layout = base_layout(
        110 + 34 * len(names),
        xaxis=axis_look("misfit over noise [dB]", range=[min(0.0, *heights), 1.15 * max(heights)], zeroline=True),
        yaxis=axis_look(autorange="reversed", automargin=True, type="category"),
    )
    return {"data": [bars], "layout": layout}


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
            "marker": {"color": colour, "size": 9, "symbol": "circle-open" if held_out else "circle"},
        }
        for name, colour, held_out, places, misfit in figure_data.condition_marks(finding)
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
    """Return the stable depth over spindle speed before and after; None without lobes."""
    data = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": f"{word}, {plain(where)}",
            "x": packed(speeds),
            "y": packed(depths),
            "line": {"color": colour, "width": 4 if word == "baseline" else 2},
        }
        for where, word, colour, speeds, depths in figure_data.stable_depths(finding)
    ]
    layout = base_layout(
        360,
        xaxis=axis_look("spindle speed [rpm]"),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", rangemode="tozero"),
    )
    return {"data": data, "layout": layout} if data else None
