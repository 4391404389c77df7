"""What every interactive figure starts from: plain dictionaries in plotly's JSON schema.

Arrays travel as base64 of 32-bit floats, which plotly.js reads by itself: seven digits in half the space of
five written out, and NaN for a gap.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from process.types import Real
from smfe.reporting.content.style import translucent

Figure = dict[str, Any]

_GRID = "#e4e4e4"
LEGEND = {"orientation": "h", "x": 0, "xanchor": "left", "bgcolor": "rgba(255,255,255,0)"}
_FONT = {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13, "color": "#222"}


def packed(values: ArrayLike) -> dict[str, str]:
    """Return an array as plotly reads it from JSON."""
    array = np.asarray(values, dtype="<f4")
    out = {"dtype": "f4", "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    if array.ndim == 2:
        out["shape"] = f"{array.shape[0]},{array.shape[1]}"
    return out


def scatter(mode: str, x: ArrayLike, y: ArrayLike) -> Figure:
    """Return lines or markers at points."""
    return {"type": "scatter", "mode": mode, "x": packed(x), "y": packed(y)}


def plain(text: str) -> str:
    """Return text so that plotly, which knows a few HTML tags, writes it letter by letter."""
    return html.escape(text, quote=False)


def axis_look(title: str = "", **more: Any) -> dict[str, Any]:
    """Return the settings of an axis: framed, with ticks outside."""
    look = {
        "gridcolor": _GRID,
        "linecolor": "#888",
        "ticks": "outside",
        "tickcolor": "#888",
        "zeroline": False,
    }
    return {"title": {"text": title, "standoff": 6}, "showline": True, "mirror": True, **look, **more}


def base_layout(height: int, **more: Any) -> dict[str, Any]:
    """Return the layout that every figure starts from; the page writes the legend itself, as buttons above."""
    return {
        "height": height,
        "margin": {"l": 70, "r": 20, "t": 12, "b": 50},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "font": _FONT,
        "hovermode": "closest",
        "hoverlabel": {"bgcolor": "#fff", "font": {"color": "#222"}, "namelength": -1},
        "legend": {**LEGEND, "y": 1.0 + 6.0 / (height - 90), "yanchor": "bottom"},
        **more,
    }


def polygons(x: Real, low: Real, high: Real) -> tuple[Real, Real]:
    """Return the outline between two curves, one polygon a run of known values."""
    xs: list[ArrayLike] = []
    ys: list[ArrayLike] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (np.isfinite(low) & np.isfinite(high)).astype(int), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        xs += [x[a:b], x[a:b][::-1], [np.nan]]
        ys += [low[a:b], high[a:b][::-1], [np.nan]]
    if not xs:
        return np.empty(0), np.empty(0)
    return np.concatenate(xs)[:-1], np.concatenate(ys)[:-1]


def filled(outline: tuple[ArrayLike, ArrayLike], colour: str, opacity: float, more: Mapping[str, Any]) -> Figure:
    """Return an outline filled with a translucent colour."""
    return {
        **scatter("lines", outline[0], outline[1]),
        "fill": "toself",
        "fillcolor": translucent(colour, opacity),
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
        **more,
    }


def log_axis(low: float, high: float) -> dict[str, Any]:
    """Return the settings of a logarithmic axis; one of few decades has ticks at 2 and 5 as well."""
    ends = [float(np.log10(low)), float(np.log10(high))]
    step = 1 if ends[1] - ends[0] > 2.2 else "D2"
    return {"type": "log", "range": ends, "dtick": step, "exponentformat": "power"}


def on_panel(number_: int) -> dict[str, str]:
    """Return the axes of panel 1, 2, ... as a trace names them."""
    tail = "" if number_ == 1 else str(number_)
    return {"xaxis": f"x{tail}", "yaxis": f"y{tail}"}
